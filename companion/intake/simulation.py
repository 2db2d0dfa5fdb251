"""Whether the vehicle is simulated in a world without a geoid, where the height above the ellipsoid
is the height above sea level.

ArduPilot SITL and PX4's simulators send one height in `alt` and `alt_ellipsoid`. A vehicle that
tells its true state is simulated: SIMSTATE of ArduPilot, which holds no altitude, answers at once;
SIM_STATE, HIL_STATE_QUATERNION and the truth of a log hold the true altitude, which must meet the
heights of five fixes in a row better than these heights less the undulation would.
"""

import logging

logger = logging.getLogger("kollsman.intake")

MEETS_MIN = 5


class Simulation:
    """One vehicle's world; once it is known to have no geoid that stays."""

    def __init__(self) -> None:
        self.is_flat = False
        """whether sea level is the ellipsoid there"""
        self.in_question = False
        """whether a fix has had equal heights where sea level and ellipsoid are apart"""
        self._fix: tuple[float, float] | None = None
        self._meets = 0

    def equal_heights(self, altitude_m: float, undulation_m: float) -> None:
        """A fix has one height for sea level and ellipsoid, which are apart by `undulation_m`."""
        self.in_question = not self.is_flat
        self._fix = altitude_m, undulation_m

    def truth(self, altitude_amsl_m: float | None) -> None:
        """The vehicle has told its true state; None for a message without an altitude."""
        if self.is_flat:
            return
        if altitude_amsl_m is None:
            self._settle()
        elif self._fix is not None:
            altitude_m, undulation_m = self._fix
            self._fix = None  # each fix counts once
            off_m = altitude_m - altitude_amsl_m
            self._meets = self._meets + 1 if abs(off_m) < abs(off_m - undulation_m) else 0
            if self._meets >= MEETS_MIN:
                self._settle()

    def _settle(self) -> None:
        self.is_flat = True
        if self.in_question:
            logger.info("the vehicle is simulated, without a geoid: its GNSS heights are used")
        self.in_question = False
