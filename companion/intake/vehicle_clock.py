"""The vehicle's boot clock: reboots, gaps, wrapped and foreign stamps."""

from enum import StrEnum

from companion.intake.settings import IntakeSettings
from companion.mavlink.convert import Reading, TimeBase

WRAP_MS = 1 << 32
WRAP_MARGIN_MS = 600_000
UNIX_STAMP_US = 1_000_000_000_000_000
"""A stamp above this (2001 as UNIX time, 31 years as boot time) counts from 1970."""


class Clockwork(StrEnum):
    """What a stamp did to the vehicle's clock."""

    TICK = "tick"
    DOUBT = "doubt"
    REBOOT = "reboot"


class VehicleClock:
    """The vehicle's boot clock as its stamps tell it.

    A discontinuity needs two witnesses: one stamp far from the clock is set aside; a second one
    that agrees with it moves the clock. Backwards is a reboot, forwards a gap in what we heard.
    Only stamps that surely count from boot are witnesses; the others may run ahead of them, but not
    away.
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
        """What `reading`'s stamp does to the clock, and its time. `source` tells messages with own
        clocks apart."""
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
        """SYSTEM_TIME: what to take from stamps that count from 1970; 0 before the vehicle knows
        the date."""
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

        The first base under which it is near the clock; else the base is learned from this stamp. A
        stamp that repeats stays where it was: a dead GNSS receiver repeats its last fix.
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
        """Within reordering of the clock, and not so far ahead of the boot stamps that these would
        seem old."""
        ahead_us = self._reorder_us // 2 if is_learned else self._reorder_us
        return time_us >= self.now_us - self._reorder_us and time_us <= self._boot_us + ahead_us
