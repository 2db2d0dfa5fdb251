"""The vehicle's boot clock: reboots, gaps, wrapped and foreign stamps."""

from enum import StrEnum

from companion.intake.settings import IntakeSettings
from companion.intake.source_clock import Skew, Unit
from companion.mavlink.convert import Reading, TimeBase

WRAP_MS = 1 << 32
WRAP_MARGIN_MS = 600_000
UNIX_STAMP_US = 1_000_000_000_000_000
"""time stamp above which it counts from 1970 (2001 as UNIX time, 31 years as boot time)"""
SESSION_US = 3_600_000_000
"""excess of elapsed time over boot time that shows a restart within a gap"""


class Clockwork(StrEnum):
    """Effect of a time stamp on the vehicle's clock."""

    TICK = "tick"
    DOUBT = "doubt"
    REBOOT = "reboot"


ALONE_US = 1_000_000


class VehicleClock:
    """The vehicle's boot clock, from its time stamps.

    A discontinuity needs a second stamp that agrees with the first. Forwards it is a gap in what we
    heard, or another session when the recorder's clock says that hours passed; backwards by more
    than `late_s` it is a reboot. Less is a late copy over a second path: it keeps its time. Only
    stamps that surely count from boot move the clock; the others may run ahead of them, but not
    away: after a gap they wait up to a second for one. A stamp of 0, or in the wrong unit, is none.
    """

    def __init__(self, settings: IntakeSettings) -> None:
        self.now_us = -1
        self.reboots = 0
        self._reorder_us = round(settings.reorder_s * 1e6)
        self._gap_us = round(settings.gap_s * 1e6)
        self._late_us = round(settings.late_s * 1e6)
        self._late_from_us: int | None = None
        """the first late stamp since the last fresh one"""
        self._beside_us: int | None = None
        """by how much the newest late stamp beside fresh ones was late"""
        self._is_copy = False
        """whether the late stamps since the last fresh one are copies over a second path"""
        self._arrival_us = 0
        self._unconfirmed_us: int | None = None
        self._wraps = 0
        self._boot_us = -1
        """the newest stamp that surely counts from boot"""
        self._units: dict[int, Unit] = {}
        self._forget()

    def _forget(self) -> None:
        """Forget what was learned of the other bases."""
        self._unix_offset_us: int | None = None
        self._offsets: dict[int, int] = {}
        self._bases: dict[int, str] = {}
        self._repeats: dict[int, tuple[int, int]] = {}
        self._skews: dict[int, Skew] = {}
        self._ahead: dict[int, tuple[int, int]] = {}
        """for each source the first stamp that was ahead of the clock, and the newest stamp from
        boot then"""

    def place(self, reading: Reading, source: int, arrival_us: int = 0) -> tuple[Clockwork, int]:
        """What `reading`'s stamp does to the clock, and its time. `source` tells messages with own
        clocks apart; `arrival_us` is the host's or recorder's clock."""
        base = reading.base
        if base is not TimeBase.NONE and reading.stamp_us != 0:
            unit = self._units.setdefault(source, Unit(source))
            unit.note(reading.stamp_us, arrival_us)
            base = TimeBase.NONE if unit.is_wrong else base
        if base is TimeBase.NONE or reading.stamp_us == 0:
            return (Clockwork.TICK if self.now_us >= 0 else Clockwork.DOUBT), self.now_us
        if base is TimeBase.BOOT:
            return self.tick(self._unwrapped(reading.stamp_us), arrival_us)
        if self.now_us < 0:
            return Clockwork.DOUBT, -1
        return self._mapped(reading.stamp_us, source)

    def tick(self, time_us: int, arrival_us: int = 0) -> tuple[Clockwork, int]:
        """Take a boot time as heard."""
        if self.now_us < 0:
            self.now_us = self._boot_us = time_us
        if -self._late_us <= time_us - self.now_us <= self._reorder_us:
            if self._is_alone(time_us):
                return self._restart(time_us)
            self.now_us = max(self.now_us, time_us)
            if time_us >= self._boot_us:
                self._boot_us, self._unconfirmed_us, self._arrival_us = time_us, None, arrival_us
            return Clockwork.TICK, time_us
        unconfirmed_us, self._unconfirmed_us = self._unconfirmed_us, time_us
        if (
            unconfirmed_us is None
            or not -self._reorder_us <= time_us - unconfirmed_us <= self._gap_us
        ):
            return Clockwork.DOUBT, time_us
        self._unconfirmed_us = None
        passed_us, self._arrival_us = arrival_us - self._arrival_us, arrival_us
        ahead_us = time_us - self.now_us
        if ahead_us > 0 and passed_us - ahead_us < SESSION_US:
            self.now_us = self._boot_us = time_us
            return Clockwork.TICK, time_us
        return self._restart(time_us)

    def _is_alone(self, time_us: int) -> bool:
        """Whether late stamps have gone on for a second without a fresh one.

        Late copies come beside fresh stamps, a vehicle that restarted sends no fresh one any more.
        Copies that were late by as much before go on when the other path ends: no restart.
        """
        if time_us >= self.now_us - self._reorder_us:
            self._late_from_us = None
            return False
        if self._late_from_us is None:
            late_us, before_us = self.now_us - time_us, self._beside_us
            self._is_copy = before_us is not None and abs(late_us - before_us) < ALONE_US
            self._late_from_us, self._beside_us = time_us, late_us
        self._late_from_us = min(self._late_from_us, time_us)
        return not self._is_copy and time_us - self._late_from_us >= ALONE_US

    def _restart(self, time_us: int) -> tuple[Clockwork, int]:
        """The vehicle's clock began anew."""
        self.now_us = self._boot_us = time_us = time_us - self._wraps * WRAP_MS * 1000
        self.reboots += 1
        self._wraps = 0
        self._late_from_us = self._beside_us = None
        self._forget()
        return Clockwork.REBOOT, time_us

    def note_unix(self, unix_us: int, boot_us: int) -> None:
        """SYSTEM_TIME: what to take from stamps that count from 1970; 0 before the vehicle knows
        the date."""
        if unix_us > UNIX_STAMP_US:
            self._unix_offset_us = unix_us - self._unwrapped(boot_us)

    @property
    def unix_offset_us(self) -> int | None:
        """UNIX time minus boot time, as the vehicle's SYSTEM_TIME says; None before it knows the
        date."""
        return self._unix_offset_us

    def _unwrapped(self, stamp_us: int) -> int:
        """time_boot_ms is 32 bits wide and wraps after 49.7 days."""
        stamp_ms = stamp_us // 1000
        last_ms = self.now_us // 1000 - self._wraps * WRAP_MS
        if last_ms > WRAP_MS - WRAP_MARGIN_MS and stamp_ms < WRAP_MARGIN_MS:
            self._wraps += 1
        elif self._wraps and stamp_ms > WRAP_MS - WRAP_MARGIN_MS and last_ms < WRAP_MARGIN_MS:
            return stamp_us + (self._wraps - 1) * WRAP_MS * 1000
        return stamp_us + self._wraps * WRAP_MS * 1000

    def _mapped(self, stamp_us: int, source: int) -> tuple[Clockwork, int]:
        """A stamp that may count from boot, from 1970 or from anything, on the boot clock.

        The base that served this source last, even if the stamp is late; else the first under which
        it is near the clock; else one learned from this stamp, unless the stamp may follow a gap. A
        stamp that repeats stays where it was: a dead GNSS receiver repeats its last fix.
        """
        last = self._repeats.get(source)
        if last is not None and last[0] == stamp_us:
            return Clockwork.TICK, last[1]
        offsets = {"boot": 0, "unix": self._unix_offset_us, "own": self._offsets.get(source)}
        served = self._bases.get(source)
        for name in sorted(offsets, key=lambda name: name != served):
            offset_us = offsets[name]
            late_us = self._late_us if name == served else self._reorder_us
            if offset_us is not None and self._is_near(stamp_us - offset_us, late_us, name):
                break
        else:
            if self._awaits_boot(stamp_us, offsets.get(served or ""), source):
                return Clockwork.DOUBT, stamp_us
            name, offset_us = "own", stamp_us - self.now_us
            self._offsets[source] = offset_us
            self._skews.pop(source, None)
        if source in self._ahead and self._ahead[source][1] != self._boot_us:
            del self._ahead[source]
        self._bases[source] = name
        skew = self._skews.setdefault(source, Skew())
        time_us = skew.correct(stamp_us - (offset_us or 0), self.now_us, self._boot_us)
        self.now_us = max(self.now_us, time_us)
        self._repeats[source] = (stamp_us, time_us)
        return Clockwork.TICK, time_us

    def _is_near(self, time_us: int, late_us: int, base: str) -> bool:
        """Not later than `late_us` on the clock, and not so far ahead of the boot stamps that these
        would seem old."""
        ahead_us = self._reorder_us // 2 if base == "own" else self._reorder_us
        return self.now_us - late_us <= time_us <= self._boot_us + ahead_us

    def _awaits_boot(self, stamp_us: int, offset_us: int | None, source: int) -> bool:
        """Whether a stamp ahead of the clock, under the base that served, may follow a gap: a stamp
        from boot is then awaited, for up to a second of the source's own stamps."""
        if offset_us is None or stamp_us - offset_us <= self.now_us:
            return False
        first_us, boot_us = self._ahead.setdefault(source, (stamp_us, self._boot_us))
        return self._boot_us == boot_us and 0 <= stamp_us - first_us < ALONE_US
