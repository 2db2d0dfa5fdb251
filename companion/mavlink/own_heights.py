"""The vehicle's own heights: GLOBAL_POSITION_INT in, ALTITUDE with these heights out."""

import math
from typing import NamedTuple

from companion.mavlink.codec import Message, mavlink


class OwnHeights(NamedTuple):
    """The vehicle's own heights."""

    time_us: int
    altitude_amsl_m: float
    height_above_home_m: float


def own_heights(message: Message) -> OwnHeights:
    """GLOBAL_POSITION_INT: millimetres AMSL and above home."""
    return OwnHeights(message.time_boot_ms * 1000, message.alt * 1e-3, message.relative_alt * 1e-3)


def own_altitude(own: OwnHeights, origin_m: float) -> Message:
    """ALTITUDE with the vehicle's own heights, and nothing of a sensor.

    Parameters
    ----------
    origin_m : altitude at which ``altitude_local`` is zero.
    """
    return mavlink.MAVLink_altitude_message(
        own.time_us,
        math.nan,
        own.altitude_amsl_m,
        own.altitude_amsl_m - origin_m,
        own.height_above_home_m,
        math.nan,
        math.nan,
    )
