"""Makes sample rows of readings: vehicle clock, reboots, latency, and plausibility check.

A `Reading` (SI units, any time stamp) becomes a sample row on the vehicle's boot clock, or is left
out and counted. Nothing here depends on the host's clock.
"""

import logging
import math
from collections import Counter
from enum import StrEnum

from companion.checker import ELLIPSOID
from companion.intake.primary import Primary
from companion.intake.receivers import Receiver
from companion.intake.row_steps import INTAKE, INTAKE_PARAMS, LARGEST_DOUBT_M, air_time
from companion.intake.screening import DatumScreen
from companion.intake.settings import IntakeSettings
from companion.intake.simulation import Simulation
from companion.intake.vehicle_clock import Clockwork, VehicleClock
from companion.known_air import Known
from companion.mavlink.convert import ZERO_CELSIUS_K, Reading
from companion.samples import DTYPES, MAX_INSTANCES, Kind, Rows, rows

logger = logging.getLogger("kollsman.intake")


class SampleReject(StrEnum):
    """Why a reading did not become a sample."""

    NO_CLOCK = "no boot clock yet"
    CLOCK = "clock jumped, unconfirmed"
    REPLACED = "a better source of the same"


# Looked up in its class, a member of an enum costs ten times as much (Python 3.11).
_PRESSURE, _GNSS, _AIR, _STATUS = (
    Kind.PRESSURE,
    Kind.GNSS,
    Kind.AIR,
    Kind.STATUS,
)


class Intake:
    """Readings in, sample rows out."""

    def __init__(self, settings: IntakeSettings) -> None:
        self.clock = VehicleClock(settings)
        self.datum = DatumScreen(settings)
        self.simulation = Simulation()
        self._settings = settings
        self._begin()
        self.counters: Counter[SampleReject] = Counter()
        self.state: Rows = rows(INTAKE)
        self.state["air_us"] = -1
        self.params: Rows = rows(INTAKE_PARAMS)
        self.params["latency_us"] = round(settings.gnss_latency_s * 1e6)
        self.params["air_excess_k"] = settings.air_temperature_excess_k
        self._rows = {kind: rows(dtype) for kind, dtype in DTYPES.items()}

    @property
    def objection(self) -> tuple[int, float] | None:
        """The reason why no altitude of this receiver may be published, as a code of
        `companion.checker.OBJECTIONS` and a size; None when there is none."""
        doubt_m = self.receivers[0].doubt_m
        return (ELLIPSOID, doubt_m) if doubt_m > LARGEST_DOUBT_M else None

    @property
    def notes(self) -> list[str]:
        """What was found to be wrong with the receivers' heights, one line each."""
        return [note for receiver in self.receivers for note in receiver.notes]

    def _begin(self) -> None:
        """Forget the sensors: the vehicle starts."""
        self.primaries = {kind: Primary(kind) for kind in (_PRESSURE, _GNSS)}
        self.receivers = [
            Receiver(k, self._settings, self.simulation) for k in range(MAX_INSTANCES)
        ]

    def place(
        self, reading: Reading, source: int, arrival_us: int
    ) -> tuple[int | None, Rows | None]:
        """Place a reading on the vehicle's clock.

        Returns
        -------
        time_us : of the reading; None when it is left out (counted).
        reboot : a STATUS row that must go to the estimator first; None when the clock did not
            restart.
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
        if reading.kind is _GNSS:
            time_us -= int(self.params["latency_us"][0])
        elif reading.kind is _AIR:
            time_us = self._air_time(time_us)
        row[0] = (time_us, arrival_us, reading.instance, *reading.values, *unsaid(reading))
        if reading.kind is _GNSS:
            self.receivers[reading.instance].check(row, self.datum.baro_m(time_us))
        if reading.kind in self.primaries:
            self.primaries[reading.kind].number(row)
        if reading.kind is _AIR:
            row["air_temperature_k"] -= self.params["air_excess_k"]
        if reading.kind is _PRESSURE:
            self.datum.pressure(row)
        elif reading.kind is _GNSS:
            self.datum.gnss(row)
        return row

    def tell(self, primary: Kind | None) -> None:
        """Log what compiled steps have found; `primary` is the kind whose primary sensor is
        another one now."""
        self.clock.tell()
        if primary is not None:
            self.primaries[primary].tell()
        self.datum.tell()

    def newest(self, kind: Kind) -> Rows:
        """The row, shape (1,), of the newest sample of a kind; NaN and 0 before the first."""
        return self._rows[kind]

    def air(self, known: Known, at: Rows) -> Rows:
        """The sample row, shape (1,), of the known values of the air, at the time of another
        row."""
        row = self._rows[_AIR]
        row[0] = (
            self._air_time(at[0]["time_us"]),
            at[0]["arrival_us"],
            0,
            _or_nan(known.temperature_c) + ZERO_CELSIUS_K,
            _or_nan(known.qnh_hpa) * 100.0,
            _or_nan(known.field_elevation_m),
            _or_nan(known.qnh_elevation_m),
            _or_nan(known.qnh_sd_pa),
        )
        return row

    def _air_time(self, time_us: int) -> int:
        """Samples of the air come from several sources: each is newer than the one before."""
        return int(air_time(self.state, time_us))

    def _reboot(self, time_us: int, arrival_us: int) -> Rows:
        logger.warning("the vehicle's clock restarted at %.1f s: starting anew", time_us * 1e-6)
        self.datum.restart()
        self._begin()
        return restart_row(time_us, arrival_us)


def restart_row(time_us: int, arrival_us: int) -> Rows:
    """The STATUS row, shape (1,), that lets an estimator start anew."""
    row = rows(DTYPES[_STATUS])
    row[0] = (time_us, arrival_us, 0, -1, -1, 1)
    return row


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def unsaid(reading: Reading) -> tuple[float, ...]:
    """The last fields of a row, which no message says: of a fix, doubt in its datum."""
    return (math.nan,) if reading.kind is _GNSS else ()
