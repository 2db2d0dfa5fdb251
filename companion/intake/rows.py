"""What live and replay share before an estimator: the vehicle's clock, reboots, latency, and
screening.

A `Reading` (SI units, some stamp) becomes a sample row on the vehicle's boot clock, or is left out
and counted. Nothing here depends on the host's clock.
"""

import logging
import math
from collections import Counter
from enum import StrEnum

from companion.intake.screening import DatumScreen
from companion.intake.settings import IntakeSettings
from companion.intake.vehicle_clock import Clockwork, VehicleClock
from companion.mavlink.convert import ZERO_CELSIUS_K, Reading
from companion.samples import DTYPES, MAX_INSTANCES, Kind, Rows, rows

logger = logging.getLogger("kollsman.intake")


class SampleReject(StrEnum):
    """Why a reading did not become a sample."""

    NO_CLOCK = "no boot clock yet"
    CLOCK = "clock jumped, unconfirmed"
    REPLACED = "a better source of the same"


class Intake:
    """Readings in, sample rows out."""

    def __init__(self, settings: IntakeSettings) -> None:
        self.clock = VehicleClock(settings)
        self.datum = DatumScreen(settings)
        self.counters: Counter[SampleReject] = Counter()
        self._latency_us = round(settings.gnss_latency_s * 1e6)
        self._rows = {kind: rows(dtype) for kind, dtype in DTYPES.items()}

    def place(
        self, reading: Reading, source: int, arrival_us: int
    ) -> tuple[int | None, Rows | None]:
        """Place a reading on the vehicle's clock.

        Returns
        -------
        time_us : of the reading; None when it is left out (counted).
        reboot : a STATUS row that must go to the estimator first; None when the clock did not restart.
        """
        clockwork, time_us = self.clock.place(reading, source, arrival_us)
        if clockwork is Clockwork.DOUBT or not 0 <= reading.instance < MAX_INSTANCES:
            self.counters[
                SampleReject.NO_CLOCK if self.clock.now_us < 0 else SampleReject.CLOCK
            ] += 1
            return None, None
        return time_us, self._reboot(time_us, arrival_us) if clockwork is Clockwork.REBOOT else None

    def row(self, reading: Reading, time_us: int, arrival_us: int) -> Rows:
        """The sample row, shape (1,), of a reading that was placed at `time_us`; valid until the
        next of its kind."""
        row = self._rows[reading.kind]
        if reading.kind is Kind.GNSS:
            time_us -= self._latency_us
        row[0] = (time_us, arrival_us, reading.instance, *reading.values)
        if reading.kind is Kind.PRESSURE:
            self.datum.pressure(row)
        elif reading.kind is Kind.GNSS:
            self.datum.gnss(row)
        return row

    def air(self, qnh_hpa: float | None, temperature_c: float | None, at: Rows) -> Rows:
        """The sample row, shape (1,), of what is known of the air, at the time of another row."""
        row = self._rows[Kind.AIR]
        air_k = math.nan if temperature_c is None else temperature_c + ZERO_CELSIUS_K
        row[0] = (
            at[0]["time_us"],
            at[0]["arrival_us"],
            0,
            air_k,
            math.nan if qnh_hpa is None else qnh_hpa * 100.0,
            math.nan,
        )
        return row

    def _reboot(self, time_us: int, arrival_us: int) -> Rows:
        logger.warning("the vehicle's clock restarted at %.1f s: starting anew", time_us * 1e-6)
        self.datum.restart()
        return restart_row(time_us, arrival_us)


def restart_row(time_us: int, arrival_us: int) -> Rows:
    """The STATUS row, shape (1,), that lets an estimator start anew."""
    row = rows(DTYPES[Kind.STATUS])
    row[0] = (time_us, arrival_us, 0, -1, -1, 1)
    return row
