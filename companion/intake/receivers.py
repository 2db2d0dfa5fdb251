"""Checks of one GNSS height: is it above the ellipsoid, never filled in, or in a wrong unit?

========================  =======================================================================
`alt` and `alt_ellipsoid`  one of the fields is wrong, nobody can say which: the undulation of the
equal to the millimetre    geoid is added to the reported accuracy, and beyond 30 m nothing is
                           published; ``intake.equal_heights`` says otherwise
exactly 0 again and again  no height: NaN
height moves 10 or 100     a wrong unit (0.1, 0.01 likewise): NaN
times as the barometer's
no accuracy reported       no height until it moved as the barometer for 5 s, within 35 hPa and a
                           tenth of the height: such a fix slid by 700 m on the ground
========================  =======================================================================
"""

import logging
import math

from companion.intake.geoid import undulation_m
from companion.intake.settings import IntakeSettings
from companion.kernels.gnss import gnss_sd_m
from companion.samples import Rows

logger = logging.getLogger("kollsman.intake")

LEAST_UNDULATION_M = 1.0
CLIMB_M = 20.0
"""change of the barometer's height over which the ratio of the two changes is checked"""
FACTORS = (0.01, 0.1, 10.0, 100.0)
TOLERANCE = 0.2
UNKNOWN_SD_M = 10.0
SETTLING_US = 5_000_000
SETTLED_SPREAD_M = 10.0
WEATHER_M, TEMPERATURE_RATIO = 300.0, 0.1
"""largest difference of barometer and true height: 35 hPa, and a column 10 % too warm or cold"""
MEETS_MIN = 2


class Receiver:
    """One receiver's heights."""

    def __init__(self, instance: int, settings: IntakeSettings) -> None:
        self._equal_heights = settings.equal_heights
        self.doubt_m = 0.0
        """largest common error of the heights"""
        self._name = f"GNSS receiver {instance + 1}"
        self._zeros = self._scaled = 0
        self._start: tuple[float, float] | None = None
        self._settled = False
        self._apart: tuple[int, float, float] | None = None
        """start and bounds of the difference of GNSS and barometer height"""
        self._told: dict[str, str] = {}

    @property
    def notes(self) -> list[str]:
        """What was found to be wrong with its heights, one line each."""
        return list(self._told.values())

    def check(self, row: Rows, baro_m: float) -> None:
        """Correct, widen or void the height of a fix, shape (1,), beside the barometer's height."""
        value = row[0]
        if value["fix_type"] < 3 or math.isnan(value["altitude_amsl_m"]):
            return
        self._check_zero(row)
        self._check_unit(row, baro_m)
        self._check_ellipsoid(row)
        self._check_unreported(row, baro_m)

    def _check_zero(self, row: Rows) -> None:
        is_zero = row[0]["altitude_amsl_m"] == 0.0 and math.isnan(row[0]["altitude_ellipsoid_m"])
        self._zeros = self._zeros + 1 if is_zero else 0
        if self._zeros >= MEETS_MIN:
            self._tell("sends heights of exactly 0 with a fix: they are not used")
        if is_zero:
            row["altitude_amsl_m"] = math.nan

    def _check_unit(self, row: Rows, baro_m: float) -> None:
        height_m = float(row[0]["altitude_amsl_m"])
        if not math.isfinite(baro_m + height_m):
            return
        if self._start is None:
            self._start = baro_m, height_m
        climb_m, moved_m = baro_m - self._start[0], height_m - self._start[1]
        if abs(climb_m) >= CLIMB_M:
            self._start = baro_m, height_m
            factor = next((f for f in FACTORS if _is_near(moved_m / climb_m, f)), 1.0)
            self._scaled = self._scaled + 1 if factor != 1.0 else 0
            if self._scaled >= MEETS_MIN:
                self._tell(f"climbs {factor:g} times as the barometer: its heights are not used")
        if self._scaled >= MEETS_MIN:
            row["altitude_amsl_m"] = math.nan

    def _check_unreported(self, row: Rows, baro_m: float) -> None:
        """A receiver that reports no accuracy must first move as the barometer does, if there is
        one."""
        height_m, time_us = float(row[0]["altitude_amsl_m"]), int(row[0]["time_us"])
        difference_m = height_m - baro_m
        if self._settled or not math.isfinite(difference_m) or gnss_sd_m(row, 0.0, 0.0) > 0.0:
            return
        since_us, low_m, high_m = self._apart or (time_us, difference_m, difference_m)
        low_m, high_m = min(low_m, difference_m), max(high_m, difference_m)
        near = abs(difference_m) <= WEATHER_M + TEMPERATURE_RATIO * abs(height_m)
        if not near or high_m - low_m > SETTLED_SPREAD_M or time_us < since_us:
            self._apart = time_us, difference_m, difference_m
        else:
            self._apart = since_us, low_m, high_m
            self._settled = time_us - since_us >= SETTLING_US
        if not self._settled:
            row["altitude_amsl_m"] = math.nan

    def _check_ellipsoid(self, row: Rows) -> None:
        value = row[0]
        self.doubt_m = 0.0
        if self._equal_heights == "sea_level" or (
            value["altitude_amsl_m"] != value["altitude_ellipsoid_m"]
        ):
            return
        above_m = undulation_m(float(value["latitude_deg"]), float(value["longitude_deg"]))
        if not abs(above_m) >= LEAST_UNDULATION_M:
            return
        text = (
            "gives the same height above sea level and above the ellipsoid, which are "
            f"{abs(above_m):.0f} m apart here: "
        )
        if self._equal_heights == "ellipsoid":
            self._tell(text + "it is the ellipsoid's, and was corrected")
            row["altitude_amsl_m"] = value["altitude_ellipsoid_m"] - above_m
        else:
            self._tell(
                text + "the altitude is in doubt by as much; set intake.equal_heights to "
                "sea_level (a simulation such as ArduPilot SITL) or ellipsoid, whichever it is"
            )
            self.doubt_m = abs(above_m)
            sd_m = float(gnss_sd_m(row, 0.0, UNKNOWN_SD_M))
            row["vertical_sd_m"], row["datum_sd_m"] = math.hypot(sd_m, above_m), abs(above_m)

    def _tell(self, text: str) -> None:
        if text[:12] not in self._told:  # heights and ratios in the rest vary
            self._told[text[:12]] = f"{self._name} {text}"
            logger.warning("%s %s", self._name, text)


def _is_near(ratio: float, factor: float) -> bool:
    return abs(ratio / factor - 1.0) <= TOLERANCE
