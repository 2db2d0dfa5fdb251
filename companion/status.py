"""What the status line and the live page show of a service."""

import math
from dataclasses import dataclass
from typing import NamedTuple, Self

from companion.health import Health
from companion.mavlink.codec import Message

KEPT_TEXTS = 30
"""STATUSTEXT of the vehicle and of ours that are shown"""


@dataclass(frozen=True)
class Status:
    """What the status line shows."""

    health: Health
    reason: str
    vehicle: str
    altitude_amsl_m: float
    altitude_sd_m: float
    protection_level_m: float
    climb_mps: float
    rates_hz: dict[str, float]
    """rates of each sensor kind and of our ALTITUDE since the last status"""
    link: str
    traffic: dict[str, dict[str, dict[str, float]]]
    """for each link and sender: frames, lost, jitter_s"""
    rejected: dict[str, int]
    """bad input by cause"""
    round_trip_s: float = math.nan
    """of TIMESYNC to the vehicle and back; NaN before its first answer"""
    age_s: float = math.nan
    """of the newest time stamp of the vehicle; NaN before its first answer to TIMESYNC"""


class Text(NamedTuple):
    """A STATUSTEXT."""

    time_us: int
    """when it was heard or sent, host's clock"""
    who: str
    """vehicle or Kollsman"""
    severity: int
    """MAV_SEVERITY"""
    text: str

    @classmethod
    def of(cls, message: Message, who: str, time_us: int) -> Self:
        """What a STATUSTEXT says."""
        return cls(time_us, who, int(message.severity), str(message.text).rstrip("\0"))
