"""What live and replay share before an estimator: the vehicle's clock, reboots, latency, and screening.

A `Reading` (SI units, some stamp) becomes a sample row on the vehicle's boot clock, or is left out and counted. Nothing
here depends on the host's clock.
"""

import logging
import math
from collections import Counter
from enum import StrEnum

from pydantic import Field

from companion.config import Settings
from companion.mavlink.convert import ZERO_CELSIUS_K, Reading, TimeBase
from companion.samples import DTYPES, MAX_INSTANCES, Kind, Rows, rows
from companion.screening import DatumScreen

logger = logging.getLogger("kollsman.intake")

WRAP_MS = 1 << 32
WRAP_MARGIN_MS = 600_000
UNIX_STAMP_US = 1_000_000_000_000_000
"""A stamp above this (2001 as UNIX time, 31 years as boot time) counts from 1970."""


class IntakeSettings(Settings):
    """Section ``intake``."""

    gnss_latency_s: float = Field(0.12, ge=0, le=1)
    """age of a GNSS height when the autopilot stamps it: receivers of the u-blox class take 0.1 to 0.2 s"""
    reorder_s: float = Field(2.0, gt=0, le=10)
    """a stamp that is this far from the newest one, either way, is a restart, a gap or damaged: it needs a witness"""
    gap_s: float = Field(10.0, gt=0, le=3600)
    """how soon after such a stamp a second one must agree with it"""
    datum_limit_m: float = Field(700.0, gt=0, le=10_000)
    """barometer and GNSS may differ by this, more than twice what the deepest low can do, ..."""
    datum_limit_ratio: float = Field(0.15, ge=0, le=1)
    """... plus this share of the height, which is what an arctic winter can do"""
    datum_time_s: float = Field(10.0, gt=0, le=600)
    """how long they must contradict each other before one is disbelieved, or agree before it is believed again"""
    credible_gnss_sd_m: float = Field(20.0, gt=0, le=1000)
    """a fix that admits more than this accuses nobody"""
    step_limit_m: float = Field(60.0, gt=0, le=10_000)
    """barometer and GNSS may move apart by this at once, beyond what speed and accuracy explain"""


class Cause(StrEnum):
    """Why a reading did not become a sample."""

    NO_CLOCK = "no boot clock yet"
    CLOCK = "clock jumped, unconfirmed"
    REPLACED = "a better source of the same"


class Clockwork(StrEnum):
    """What a stamp did to the vehicle's clock."""

    TICK = "tick"
    DOUBT = "doubt"
    REBOOT = "reboot"


class VehicleClock:
    """The vehicle's boot clock as its stamps tell it.

    A discontinuity needs two witnesses: one stamp far from the clock is set aside; a second one that agrees with it
    moves the clock. Backwards is a reboot, forwards a gap in what we heard. Only stamps that surely count from boot are
    witnesses; the others may run ahead of them, but not away.
    """

    def __init__(self, settings: IntakeSettings) -> None:
        self.now_us = -1
        self.reboots = 0
        self._reorder_us = round(settings.reorder_s * 1e6)
        self._gap_us = round(settings.gap_s * 1e6)
        self._witness_us: int | None = None
        self._wraps = 0
        self._boot_us = -1
        """the newest stamp that surely counts from boot"""
        self._unix_offset_us: int | None = None
        self._offsets: dict[int, int] = {}
        self._repeats: dict[int, tuple[int, int]] = {}

    def place(self, reading: Reading, source: int) -> tuple[Clockwork, int]:
        """What `reading`'s stamp does to the clock, and its time. `source` tells messages with own clocks apart."""
        if reading.base is TimeBase.NONE:
            return (Clockwork.TICK if self.now_us >= 0 else Clockwork.DOUBT), self.now_us
        if reading.base is TimeBase.BOOT:
            return self.tick(self._unwrapped(reading.stamp_us))
        if self.now_us < 0:
            return Clockwork.DOUBT, -1
        return Clockwork.TICK, self._mapped(reading.stamp_us, source)

    def tick(self, time_us: int) -> tuple[Clockwork, int]:
        """Take a boot time as heard."""
        if self.now_us < 0:
            self.now_us = self._boot_us = time_us
            return Clockwork.TICK, time_us
        if abs(time_us - self.now_us) <= self._reorder_us:
            self.now_us = max(self.now_us, time_us)
            self._witness_us = None if time_us >= self._boot_us else self._witness_us
            self._boot_us = max(self._boot_us, time_us)
            return Clockwork.TICK, time_us
        witness_us, self._witness_us = self._witness_us, time_us
        if witness_us is None or not -self._reorder_us <= time_us - witness_us <= self._gap_us:
            return Clockwork.DOUBT, time_us
        self._witness_us = None
        went_back = time_us < self.now_us
        if not went_back:
            self.now_us = self._boot_us = time_us
            return Clockwork.TICK, time_us
        self.now_us = self._boot_us = time_us = time_us - self._wraps * WRAP_MS * 1000
        self.reboots += 1
        self._wraps = 0
        self._unix_offset_us = None
        self._offsets.clear()
        self._repeats.clear()
        return Clockwork.REBOOT, time_us

    def note_unix(self, unix_us: int, boot_us: int) -> None:
        """SYSTEM_TIME: what to take from stamps that count from 1970; 0 before the vehicle knows the date."""
        if unix_us > UNIX_STAMP_US:
            self._unix_offset_us = unix_us - self._unwrapped(boot_us)

    def _unwrapped(self, stamp_us: int) -> int:
        """time_boot_ms is 32 bits wide and wraps after 49.7 days."""
        stamp_ms = stamp_us // 1000
        last_ms = self.now_us // 1000 - self._wraps * WRAP_MS
        if last_ms > WRAP_MS - WRAP_MARGIN_MS and stamp_ms < WRAP_MARGIN_MS:
            self._wraps += 1
        elif self._wraps and stamp_ms > WRAP_MS - WRAP_MARGIN_MS and last_ms < WRAP_MARGIN_MS:
            return stamp_us + (self._wraps - 1) * WRAP_MS * 1000
        return stamp_us + self._wraps * WRAP_MS * 1000

    def _mapped(self, stamp_us: int, source: int) -> int:
        """A stamp that may count from boot, from 1970 or from anything, on the boot clock.

        The first base under which it is near the clock; else the base is learned from this stamp. A stamp that repeats
        stays where it was: a dead GNSS receiver repeats its last fix.
        """
        if stamp_us == 0:
            return self.now_us
        last = self._repeats.get(source)
        if last is not None and last[0] == stamp_us:
            return last[1]
        time_us = self.now_us
        bases = ((0, False), (self._unix_offset_us, False), (self._offsets.get(source), True))
        for offset_us, is_learned in bases:
            if offset_us is not None and self._is_near(stamp_us - offset_us, is_learned):
                time_us = stamp_us - offset_us
                break
        else:
            self._offsets[source] = stamp_us - self.now_us
        self.now_us = max(self.now_us, time_us)
        self._repeats[source] = (stamp_us, time_us)
        return time_us

    def _is_near(self, time_us: int, is_learned: bool) -> bool:
        """Within reordering of the clock, and not so far ahead of the boot stamps that these would seem old."""
        ahead_us = self._reorder_us // 2 if is_learned else self._reorder_us
        return time_us >= self.now_us - self._reorder_us and time_us <= self._boot_us + ahead_us


class Intake:
    """Readings in, sample rows out."""

    def __init__(self, settings: IntakeSettings) -> None:
        self.clock = VehicleClock(settings)
        self.datum = DatumScreen(settings)
        self.counters: Counter[Cause] = Counter()
        self._latency_us = round(settings.gnss_latency_s * 1e6)
        self._rows = {kind: rows(dtype) for kind, dtype in DTYPES.items()}

    def place(self, reading: Reading, source: int, arrival_us: int) -> tuple[int | None, Rows | None]:
        """Place a reading on the vehicle's clock.

        Returns
        -------
        time_us : of the reading; None when it is left out (counted).
        reboot : a STATUS row that must go to the estimator first; None when the clock did not restart.
        """
        clockwork, time_us = self.clock.place(reading, source)
        if clockwork is Clockwork.DOUBT or not 0 <= reading.instance < MAX_INSTANCES:
            self.counters[Cause.NO_CLOCK if self.clock.now_us < 0 else Cause.CLOCK] += 1
            return None, None
        return time_us, self._reboot(time_us, arrival_us) if clockwork is Clockwork.REBOOT else None

    def row(self, reading: Reading, time_us: int, arrival_us: int) -> Rows:
        """The sample row, shape (1,), of a reading that was placed at `time_us`; valid until the next of its kind."""
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
        row[0] = (at[0]["time_us"], at[0]["arrival_us"], 0, air_k, math.nan if qnh_hpa is None else qnh_hpa * 100.0)
        return row

    def _reboot(self, time_us: int, arrival_us: int) -> Rows:
        logger.warning("the vehicle's clock restarted at %.1f s: starting anew", time_us * 1e-6)
        self.datum.restart()
        row = rows(DTYPES[Kind.STATUS])
        row[0] = (time_us, arrival_us, 0, -1, -1, 1)
        return row
