"""Whether the vehicle is simulated in a world without a geoid, where the height above the ellipsoid
is the height above sea level.

ArduPilot SITL and PX4's simulators send one height in `alt` and `alt_ellipsoid`. A vehicle that
tells its true state is simulated: SIMSTATE of ArduPilot, which holds no altitude, answers at once;
SIM_STATE, HIL_STATE_QUATERNION and the truth of a log hold the true altitude, which must meet the
heights of five fixes in a row better than these heights less the undulation would.
"""

import logging

import numpy as np

from companion.jit import step
from companion.samples import Rows, rows

logger = logging.getLogger("kollsman.intake")

MEETS_MIN = 5
SIMULATION = np.dtype(
    [
        ("has_fix", "i8"),  # 1 when the following is of a fix that no truth has met yet
        ("altitude_m", "f8"),
        ("undulation_m", "f8"),
        ("meets", "i8"),  # how many fixes in a row were met
    ],
    align=True,
)


class Simulation:
    """One vehicle's world; once it is known to have no geoid that stays."""

    def __init__(self) -> None:
        self.is_flat = False
        """whether sea level is the ellipsoid there"""
        self.in_question = False
        """whether a fix has had equal heights where sea level and ellipsoid are apart"""
        self.state: Rows = rows(SIMULATION)

    def equal_heights(self, altitude_m: float, undulation_m: float) -> None:
        """A fix has one height for sea level and ellipsoid, which are apart by `undulation_m`."""
        self.in_question = not self.is_flat
        note_fix(self.state, altitude_m, undulation_m)

    def truth(self, altitude_amsl_m: float | None) -> None:
        """The vehicle has told its true state; None for a message without an altitude."""
        if not self.is_flat and (altitude_amsl_m is None or is_met(self.state, altitude_amsl_m)):
            self._settle()

    def _settle(self) -> None:
        self.is_flat = True
        if self.in_question:
            logger.info("the vehicle is simulated, without a geoid: its GNSS heights are used")
        self.in_question = False


@step
def note_fix(s: Rows, altitude_m: float, undulation_m: float) -> None:
    """A fix has one height for sea level and ellipsoid."""
    s[0].has_fix, s[0].altitude_m, s[0].undulation_m = 1, altitude_m, undulation_m


@step
def is_met(s: Rows, altitude_amsl_m: float) -> bool:
    """Whether the true altitude has met enough fixes in a row; each fix counts once."""
    if s[0].has_fix == 0:
        return False
    s[0].has_fix = 0
    off_m = s[0].altitude_m - altitude_amsl_m
    s[0].meets = s[0].meets + 1 if abs(off_m) < abs(off_m - s[0].undulation_m) else 0
    return bool(s[0].meets >= MEETS_MIN)
