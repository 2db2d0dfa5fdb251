"""A barometer at rest at a known elevation: the QNH here, always fresh.

`ReferenceBarometer` turns the pressures of a ground station into a QNH. A window's median becomes a
value every ten seconds of the vehicle's clock; a value is handed on when it has changed by half a
metre of air, and once a minute. What cannot be weather is counted and left out:

============================  ====================================================================
a step or a ramp              the median is 5 m and more ahead of what the weather can have carried
                              it to (31 m/h, the most of a year); until it is back
a contradiction               the estimate's QNH is apart by more than five spreads and a column's
                              error of 5 %, for a minute; until it agrees for a minute
silence of 30 s               told; the last QNH ages as any other
============================  ====================================================================

The station's own error, of sensor and elevation, is constant: an estimator learns from the change
of the QNH more than from its value.
"""

import logging
import math
from collections import Counter
from enum import StrEnum
from statistics import median

from companion.kernels.atmosphere import qnh_pa
from companion.samples import Rows

logger = logging.getLogger("kollsman.air")

LOWEST_PA, HIGHEST_PA = 30_000.0, 110_000.0
LOWEST_QNH_PA, HIGHEST_QNH_PA = 85_000.0, 110_000.0
WINDOW_US = 10_000_000
TELL_US, TELL_PA = 60_000_000, 6.0
SILENT_US = 30_000_000
PA_PER_M = 12.0
STEP_PA = 5.0 * PA_PER_M
WEATHER_PA_PER_S = 31.0 * PA_PER_M / 3600.0
SIGMAS, COLUMN_RATIO = 5.0, 0.05
CONTRADICTIONS = 6
"""values in a row"""


class ReferenceReject(StrEnum):
    """Why a pressure of the reference was not used."""

    RANGE = "reference out of range"
    STEP = "reference stepped"
    CONTRADICTION = "reference contradicted"


class ReferenceBarometer:
    """The QNH by a barometer at `elevation_m`, good to `sd_pa`."""

    def __init__(self, elevation_m: float, sd_pa: float) -> None:
        self.elevation_m, self.sd_pa = elevation_m, sd_pa
        self.counters: Counter[ReferenceReject] = Counter()
        self.qnh_pa = math.nan
        """newest value that is plausible"""
        self._fault: ReferenceReject | None = None
        self._pressures: list[float] = []
        self._begun_us = self._heard_us = self._valued_us = self._told_us = self._since_us = -1
        self._told_pa = math.nan
        self._carried_pa = math.nan
        """the QNH as far as the weather can have carried it, by the values until now"""
        self._votes = 0
        self._silent = False

    def restart(self) -> None:
        """The vehicle's clock or its estimator started anew: tell the newest value again."""
        self._begun_us = self._valued_us = self._told_us = -1
        self._pressures, self._told_pa, self._carried_pa = [], math.nan, math.nan

    def hear(self, pressure_pa: float, now_us: int) -> None:
        """A pressure of the station, at `now_us` of the vehicle's clock."""
        if now_us < 0:
            return
        if not LOWEST_PA <= pressure_pa <= HIGHEST_PA:
            self.counters[ReferenceReject.RANGE] += 1
            return
        if self._begun_us < 0 or not 0 <= now_us - self._heard_us <= SILENT_US:
            self._begun_us, self._pressures = now_us, []
        self._heard_us = now_us
        self._pressures.append(pressure_pa)

    def tell(self, now_us: int, estimate: Rows) -> float | None:
        """The QNH (Pa) to hand on now; None when there is nothing new."""
        self._watch_silence(now_us)
        if self._begun_us < 0 or now_us - self._begun_us < WINDOW_US or not self._pressures:
            return None
        value_pa = float(qnh_pa(median(self._pressures), self.elevation_m))
        self._begun_us, self._pressures = now_us, []
        if not self._is_plausible(value_pa, now_us, estimate[0]):
            return None
        self.qnh_pa, self._valued_us = value_pa, now_us
        changed = not abs(value_pa - self._told_pa) < TELL_PA
        if not changed and 0 <= now_us - self._told_us < TELL_US:
            return None
        self._told_pa, self._told_us = value_pa, now_us
        return value_pa

    def age_s(self, now_us: int) -> float:
        """Age of its newest pressure, s; infinite before the first."""
        return (now_us - self._heard_us) * 1e-6 if self._heard_us >= 0 else math.inf

    @property
    def problem(self) -> str:
        """What is wrong with it now, for the user; empty when nothing is."""
        if self._fault is not None:
            return f"{self._fault}: not used"
        return "reference barometer silent" if self._silent else ""

    def _is_plausible(self, value_pa: float, now_us: int, estimate: Rows) -> bool:
        """Whether a value can be weather and is not contradicted; what is not is counted."""
        fault, carried_pa = None, self._carry(value_pa, now_us)
        if not LOWEST_QNH_PA <= value_pa <= HIGHEST_QNH_PA:
            fault = ReferenceReject.RANGE
        elif abs(value_pa - carried_pa) > STEP_PA:
            fault = ReferenceReject.STEP
        elif self._is_contradicted(value_pa, estimate):
            fault = ReferenceReject.CONTRADICTION
        if fault is not None:
            self.counters[fault] += 1
            self._valued_us = now_us if self._valued_us >= 0 else -1  # no time for the weather
        else:
            self._carried_pa = carried_pa
        if fault is not None and fault is not self._fault:
            logger.warning("%s, %.1f hPa: not used", fault, value_pa * 0.01)
        elif fault is None and self._fault is not None:
            logger.info("the reference barometer is used again")
        self._fault = fault
        return fault is None

    def _carry(self, value_pa: float, now_us: int) -> float:
        """Where the weather can have carried the QNH on its way to a value."""
        if math.isnan(self._carried_pa):
            return value_pa
        most_pa = WEATHER_PA_PER_S * max(0, now_us - self._valued_us) * 1e-6
        return self._carried_pa + max(-most_pa, min(most_pa, value_pa - self._carried_pa))

    def _is_contradicted(self, value_pa: float, estimate: Rows) -> bool:
        """Whether the estimate's QNH has been elsewhere for as long as counts."""
        apart_pa = abs(value_pa - float(estimate["qnh_pa"]))
        column_m = abs(float(estimate["altitude_amsl_m"]) - self.elevation_m)
        spread_pa = SIGMAS * math.hypot(float(estimate["qnh_sd_pa"]), self.sd_pa)
        apart = apart_pa > spread_pa + COLUMN_RATIO * PA_PER_M * column_m  # unknown: not apart
        was = self._fault is ReferenceReject.CONTRADICTION
        self._votes = self._votes + 1 if apart != was else 0
        if self._votes >= CONTRADICTIONS:
            self._votes = 0
            return not was
        return was

    def _watch_silence(self, now_us: int) -> None:
        self._since_us = now_us if self._since_us < 0 else self._since_us
        silent = now_us - max(self._heard_us, self._since_us) > SILENT_US
        if silent and not self._silent:
            logger.warning("the reference barometer is silent for 30 s; a QNH of it ages")
        elif self._silent and not silent:
            logger.info("the reference barometer is heard again")
        self._silent = silent
