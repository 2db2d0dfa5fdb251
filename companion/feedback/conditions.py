"""What must hold while the parameter is written."""

import math
from enum import Enum
from typing import NamedTuple

from companion.feedback.settings import FeedbackSettings
from companion.health import Health
from companion.samples import FaultySensor, Rows

STALE_US = 3_000_000


class Hold(Enum):
    """Why nothing is written now."""

    NONE = ""
    HEALTH = "health is not OK"
    EXCLUDED = "a sensor is excluded"
    LEVEL = "protection level above feedback.level_m"
    NO_HEIGHT = "the vehicle's own altitude (GLOBAL_POSITION_INT) is not heard"
    UNFOLLOWED = "the vehicle's altitude does not follow its barometer"
    UNSETTLED = "not settled yet"
    DISARMED = "disarmed"
    LOW = "below feedback.floor_m"
    ENOUGH = "no further change is proven"
    BOUND = "feedback.bound_m is reached"


class Situation(NamedTuple):
    """What the feedback looks at, besides what it heard."""

    health: Health
    estimate: Rows
    """ESTIMATE, shape (1,)"""
    vehicle: tuple[int, int]
    """system and component id"""
    autopilot: int
    """MAV_AUTOPILOT"""


class OwnHeight(NamedTuple):
    """The vehicle's own altitude."""

    time_us: int
    altitude_amsl_m: float
    relative_m: float
    """height above home"""


def objection(
    settings: FeedbackSettings, now_us: int, situation: Situation, height: OwnHeight | None
) -> Hold:
    """What speaks against a comparison of the vehicle's altitude with ours."""
    value = situation.estimate[0]
    names = ("baro_offset_m", "climb_mps", "altitude_sd_m")
    known = all(math.isfinite(value[name]) for name in names)
    if situation.health is not Health.OK or not known:
        return Hold.HEALTH
    if value["faulty"] != FaultySensor.NONE:
        return Hold.EXCLUDED
    if not value["protection_level_m"] <= settings.level_m:  # NaN too
        return Hold.LEVEL
    if height is None or abs(now_us - height.time_us) > STALE_US:
        return Hold.NO_HEIGHT
    return Hold.NONE
