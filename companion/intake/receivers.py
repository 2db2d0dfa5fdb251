"""Checks of one GNSS height: is it above the ellipsoid, never filled in, or in a wrong unit?

========================  =======================================================================
`alt` and `alt_ellipsoid`  one of the fields is wrong, nobody can say which: the undulation of the
equal to the millimetre    geoid is added to the reported accuracy, and beyond 30 m nothing is
                           published; a vehicle that is simulated (`simulation`) or
                           ``intake.equal_heights`` says otherwise
exactly 0 again and again  no height: NaN
height moves 10 or 100     a wrong unit (0.1, 0.01 likewise): NaN
times as the barometer's
no accuracy reported       no height until it moved as the barometer for 5 s, within 35 hPa and a
                           tenth of the height: such a fix slid by 700 m on the ground
========================  =======================================================================
"""

import logging

from companion.intake import receiver_steps as steps
from companion.intake.geoid import undulation_m
from companion.intake.receiver_steps import NONE_US, RECEIVER
from companion.intake.settings import IntakeSettings
from companion.intake.simulation import Simulation
from companion.samples import Rows, rows

logger = logging.getLogger("kollsman.intake")

EQUAL = "gives the same height"


class Receiver:
    """One receiver's heights."""

    def __init__(self, instance: int, settings: IntakeSettings, simulation: Simulation) -> None:
        self._equal_heights = settings.equal_heights
        self._simulation = simulation
        self._name = f"GNSS receiver {instance + 1}"
        self.state: Rows = rows(RECEIVER)
        self.state["apart_us"], self.state["doubt_m"] = NONE_US, 0.0
        self._told: dict[str, str] = {}

    @property
    def doubt_m(self) -> float:
        """Largest common error of the heights."""
        return float(self.state["doubt_m"][0])

    @property
    def notes(self) -> list[str]:
        """What was found to be wrong with its heights, one line each."""
        if self._simulation.is_flat:
            self._told.pop(EQUAL, None)
        return list(self._told.values())

    def check(self, row: Rows, baro_m: float) -> None:
        """Correct, widen or void the height of a fix, shape (1,), beside the barometer's height."""
        if not steps.is_height(row):
            return
        found = steps.check_height(self.state, row, baro_m)
        self.state["told"] |= 1 << found
        if found == steps.ZEROS:
            self._tell("sends heights of exactly 0 with a fix: they are not used")
        elif found == steps.UNIT:
            factor = self.state["factor"][0]
            self._tell(f"climbs {factor:g} times as the barometer: its heights are not used")
        self._check_ellipsoid(row)
        steps.check_unreported(self.state, row, baro_m)

    def _check_ellipsoid(self, row: Rows) -> None:
        value = row[0]
        if self._equal_heights == "sea_level" or (
            value["altitude_amsl_m"] != value["altitude_ellipsoid_m"]
        ):
            return
        if self._simulation.is_flat:
            return
        above_m = undulation_m(float(value["latitude_deg"]), float(value["longitude_deg"]))
        if not abs(above_m) >= steps.LEAST_UNDULATION_M:
            return
        text = (
            f"{EQUAL} above sea level and above the ellipsoid, which are {abs(above_m):.0f} m "
            "apart here: "
        )
        if self._equal_heights == "ellipsoid":
            self._tell(text + "it is the ellipsoid's, and was corrected")
            row["altitude_amsl_m"] = value["altitude_ellipsoid_m"] - above_m
            return
        self._simulation.equal_heights(float(value["altitude_amsl_m"]), above_m)
        steps.doubt(self.state, row, above_m)
        if self.state["doubts"][0] == steps.DOUBTS_MIN:
            self._tell(
                text + "the altitude is in doubt by as much; set intake.equal_heights to "
                "sea_level (a simulation without a geoid) or ellipsoid, whichever it is"
            )

    def _tell(self, text: str) -> None:
        start = text[: len(EQUAL)]  # heights and ratios in the rest vary
        if start not in self._told:
            self._told[start] = f"{self._name} {text}"
            logger.warning("%s %s", self._name, text)
