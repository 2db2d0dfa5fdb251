"""The Earth's magnetic field at the compass of the simulated vehicle."""

from math import cos, sin

from sim.aircraft_state import Truth

_EARTH_FIELD_MGAUSS = (215.0, 8.0, 425.0)
"""north, east, down; World Magnetic Model at 47 N 8 E"""


def field_b_mgauss(truth: Truth) -> tuple[float, float, float]:
    """The Earth's magnetic field in the body's axes, milligauss."""
    north, east, down = _EARTH_FIELD_MGAUSS
    roll, pitch, yaw = truth[7:10]
    cr, sr, cp, sp, cy, sy = cos(roll), sin(roll), cos(pitch), sin(pitch), cos(yaw), sin(yaw)
    ahead, right = cy * north + sy * east, cy * east - sy * north
    below = sp * ahead + cp * down
    return cp * ahead - sp * down, cr * right + sr * below, cr * below - sr * right
