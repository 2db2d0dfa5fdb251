"""The compiled rules of the vehicle's clock (`companion.intake.vehicle_clock`): reboots, gaps,
wrapped and foreign stamps, and the unit and skew of each message's stamps.

Instants and differences that are not known are `NONE_US`.
"""

import numpy as np

from companion.jit import step
from companion.samples import Record, Rows

NONE_US = -(1 << 62)
WRAP_MS = 1 << 32
WRAP_MARGIN_MS = 600_000
UNIX_STAMP_US = 1_000_000_000_000_000
"""time stamp above which it counts from 1970 (2001 as UNIX time, 31 years as boot time)"""
SESSION_US = 3_600_000_000
"""excess of elapsed time over boot time that shows a restart within a gap"""
ALONE_US = 1_000_000
LARGEST_STAMP_US = 1 << 61
SOURCES = 64
"""number of messages and sensors with stamps of their own"""

UNIT_WINDOW_US = 2_000_000
UNIT_LOW, UNIT_HIGH = 500.0, 2000.0
"""ratio of rates above which time stamps are in another unit than that of their field"""
UNIT_WINDOWS = 2
UNIT_START_US = 60_000_000
SECOND_US = 1_000_000
SECONDS = 3
SKEW_US = 500_000
"""largest delay of a receiver, and of a message behind the boot clock"""

BOOT, EITHER, NO_STAMP = 0, 1, 2
"""what a stamp counts from: boot, boot or 1970, no stamp"""
TICK, DOUBT, REBOOT = 0, 1, 2
"""effect of a stamp on the clock"""
BY_BOOT, BY_UNIX, BY_OWN, BY_NOTHING = 0, 1, 2, -1
RIGHT, TOO_FAST, TOO_SLOW = 0, 1, 2
"""a unit: right, microseconds in milliseconds, milliseconds in microseconds"""

SOURCE = np.dtype(
    [
        ("number", "i8"),  # of the message or sensor; -1 is a free place
        ("unit", "i8"),
        ("stamp_us", "i8"),  # at the start of the window; NONE_US before the first
        ("arrival_us", "i8"),
        ("windows", "i8"),
        ("offset_us", "i8"),  # of a base of its own
        ("origin", "i8"),
        ("doubt_us", "i8"),  # the first stamp that was ahead of the clock; NONE_US before one
        ("doubt_boot_us", "i8"),  # and the newest stamp from boot then
        ("repeat_us", "i8"),  # the last stamp, and its time
        ("repeat_time_us", "i8"),
        ("seconds", "i8"),  # how many of the following are in use
        ("start_us", "i8", (SECONDS,)),
        ("behind_us", "i8", (SECONDS,)),  # the least delay behind now
        ("ahead_us", "i8", (SECONDS,)),  # the least lead on boot stamps
    ],
    align=True,
)
CLOCK = np.dtype(
    [
        ("now_us", "i8"),  # the newest boot time; -1 before the first
        ("boot_us", "i8"),  # the newest stamp that surely counts from boot
        ("reboots", "i8"),
        ("late_from_us", "i8"),  # the first late stamp since the last fresh one
        ("beside_us", "i8"),  # by how much the newest late stamp beside fresh ones was late
        ("is_copy", "i8"),  # whether the late stamps are copies over a second path
        ("arrival_us", "i8"),
        ("unconfirmed_us", "i8"),
        ("wraps", "i8"),
        ("unix_us", "i8"),  # UNIX time minus boot time
        ("wrong_units", "i8"),  # how many sources have stamps in the wrong unit,
        ("wrong_unit_of", "i8"),  # and the place of the newest of them
        ("sources", SOURCE, (SOURCES,)),
    ],
    align=True,
)
CLOCK_PARAMS = np.dtype([("reorder_us", "i8"), ("gap_us", "i8"), ("late_us", "i8")], align=True)


@step
def begin(c: Rows) -> None:
    """Know nothing."""
    c[0].now_us = c[0].boot_us = -1
    c[0].reboots = c[0].wraps = c[0].arrival_us = c[0].is_copy = 0
    c[0].wrong_units = c[0].wrong_unit_of = 0
    c[0].late_from_us = c[0].beside_us = c[0].unconfirmed_us = NONE_US
    for i in range(SOURCES):
        s = c[0].sources[i]
        s.number, s.unit, s.windows, s.stamp_us = -1, RIGHT, 0, NONE_US
    _forget(c)


@step
def _forget(c: Rows) -> None:
    """Forget what was learned of the bases other than boot."""
    c[0].unix_us = NONE_US
    for i in range(SOURCES):
        s = c[0].sources[i]
        s.offset_us, s.origin, s.repeat_us, s.seconds = NONE_US, BY_NOTHING, NONE_US, 0
        s.doubt_us, s.doubt_boot_us = NONE_US, NONE_US


@step
def place(
    c: Rows, p: Rows, base: int, stamp_us: int, source: int, arrival_us: int
) -> tuple[int, int]:
    """(effect on the clock, time on the vehicle's clock) of a stamp."""
    stamp_us = min(stamp_us, LARGEST_STAMP_US)
    slot = _slot(c, source)
    s = c[0].sources[slot]
    if base != NO_STAMP and stamp_us != 0:
        if _note_unit(s, stamp_us, arrival_us):
            c[0].wrong_units, c[0].wrong_unit_of = c[0].wrong_units + 1, slot
        if s.unit != RIGHT:
            base = NO_STAMP
    if base == NO_STAMP or stamp_us == 0:
        return (TICK if c[0].now_us >= 0 else DOUBT), c[0].now_us
    if base == BOOT:
        return tick(c, p, unwrapped(c, stamp_us), arrival_us)
    if c[0].now_us < 0:
        return DOUBT, -1
    return _mapped(c, p, s, stamp_us)


@step
def is_near(c: Rows, p: Rows, base: int, stamp_us: int) -> bool:
    """Whether the clock is known and a stamp cannot restart it: most are near it."""
    if c[0].now_us < 0 or c[0].wraps:
        return False
    is_wrapping = c[0].now_us > (WRAP_MS - WRAP_MARGIN_MS) * 1000
    is_late_or_early = abs(stamp_us - c[0].now_us) > p[0].reorder_us
    return base != BOOT or not (is_wrapping or is_late_or_early)


@step
def _slot(c: Rows, number: int) -> int:
    """The place of a source; the last one is shared when there are too many."""
    for i in range(SOURCES - 1):
        s = c[0].sources[i]
        if s.number < 0:
            s.number = number
        if s.number == number:
            return i
    return SOURCES - 1


@step
def tick(c: Rows, p: Rows, time_us: int, arrival_us: int) -> tuple[int, int]:
    """Take a boot time as heard."""
    if c[0].now_us < 0:
        c[0].now_us = c[0].boot_us = time_us
    if -p[0].late_us <= time_us - c[0].now_us <= p[0].reorder_us:
        if _is_alone(c, p, time_us):
            return _restart(c, time_us)
        c[0].now_us = max(c[0].now_us, time_us)
        if time_us >= c[0].boot_us:
            c[0].boot_us, c[0].unconfirmed_us, c[0].arrival_us = time_us, NONE_US, arrival_us
        return TICK, time_us
    unconfirmed_us = c[0].unconfirmed_us
    c[0].unconfirmed_us = time_us
    if unconfirmed_us == NONE_US or not -p[0].reorder_us <= time_us - unconfirmed_us <= p[0].gap_us:
        return DOUBT, time_us
    c[0].unconfirmed_us = NONE_US
    passed_us = arrival_us - c[0].arrival_us
    c[0].arrival_us = arrival_us
    ahead_us = time_us - c[0].now_us
    if ahead_us > 0 and passed_us - ahead_us < SESSION_US:
        c[0].now_us = c[0].boot_us = time_us
        return TICK, time_us
    return _restart(c, time_us)


@step
def _is_alone(c: Rows, p: Rows, time_us: int) -> bool:
    """Whether late stamps have gone on for a second without a fresh one.

    Late copies come beside fresh stamps, a vehicle that restarted sends no fresh one any more.
    Copies that were late by as much before go on when the other path ends: no restart.
    """
    if time_us >= c[0].now_us - p[0].reorder_us:
        c[0].late_from_us = NONE_US
        return False
    if c[0].late_from_us == NONE_US:
        late_us, before_us = c[0].now_us - time_us, c[0].beside_us
        is_copy = before_us != NONE_US and abs(late_us - before_us) < ALONE_US
        c[0].is_copy, c[0].late_from_us, c[0].beside_us = 1 if is_copy else 0, time_us, late_us
    c[0].late_from_us = min(c[0].late_from_us, time_us)
    return not c[0].is_copy and time_us - c[0].late_from_us >= ALONE_US


@step
def _restart(c: Rows, time_us: int) -> tuple[int, int]:
    """The vehicle's clock began anew."""
    time_us -= c[0].wraps * WRAP_MS * 1000
    c[0].now_us = c[0].boot_us = time_us
    c[0].reboots += 1
    c[0].wraps = 0
    c[0].late_from_us = c[0].beside_us = NONE_US
    _forget(c)
    return REBOOT, time_us


@step
def note_unix(c: Rows, unix_us: int, boot_us: int) -> None:
    """SYSTEM_TIME: what to take from stamps that count from 1970; 0 before the vehicle knows the
    date."""
    if unix_us > UNIX_STAMP_US:
        c[0].unix_us = min(unix_us, LARGEST_STAMP_US) - unwrapped(c, boot_us)


@step
def unwrapped(c: Rows, stamp_us: int) -> int:
    """time_boot_ms is 32 bits wide and wraps after 49.7 days."""
    stamp_ms = stamp_us // 1000
    last_ms = c[0].now_us // 1000 - c[0].wraps * WRAP_MS
    if last_ms > WRAP_MS - WRAP_MARGIN_MS and stamp_ms < WRAP_MARGIN_MS:
        c[0].wraps += 1
    elif c[0].wraps and stamp_ms > WRAP_MS - WRAP_MARGIN_MS and last_ms < WRAP_MARGIN_MS:
        return stamp_us + (c[0].wraps - 1) * WRAP_MS * 1000
    return stamp_us + c[0].wraps * WRAP_MS * 1000


@step
def _mapped(c: Rows, p: Rows, s: Record, stamp_us: int) -> tuple[int, int]:
    """A stamp that may count from boot, from 1970 or from anything, on the boot clock.

    The base that served this source last, even if the stamp is late; else the first under which it
    is near the clock; else one learned from this stamp, unless the stamp may follow a gap. A stamp
    that repeats stays where it was: a dead GNSS receiver repeats its last fix.
    """
    if s.repeat_us == stamp_us:
        return TICK, s.repeat_time_us
    served, base, time_us = s.origin, BY_NOTHING, 0
    for i in range(-1, 3):  # the base that served first, then the others
        name = served if i < 0 else i
        if name == BY_NOTHING or (i >= 0 and name == served) or base != BY_NOTHING:
            continue
        offset_us = _offset_us(c, s, name)
        late_us = p[0].late_us if name == served else p[0].reorder_us
        ahead_us = p[0].reorder_us // 2 if name == BY_OWN else p[0].reorder_us
        if offset_us != NONE_US:
            candidate_us = stamp_us - offset_us
            if c[0].now_us - late_us <= candidate_us <= c[0].boot_us + ahead_us:
                base, time_us = name, candidate_us
    if base == BY_NOTHING:
        if _awaits_boot(c, s, stamp_us):
            return DOUBT, stamp_us
        base, time_us = BY_OWN, c[0].now_us
        s.offset_us, s.seconds = stamp_us - c[0].now_us, 0
    if s.doubt_boot_us != c[0].boot_us:
        s.doubt_us = NONE_US
    s.origin = base
    time_us = _corrected(s, time_us, c[0].now_us, c[0].boot_us)
    c[0].now_us = max(c[0].now_us, time_us)
    s.repeat_us, s.repeat_time_us = stamp_us, time_us
    return TICK, time_us


@step
def _offset_us(c: Rows, s: Record, base: int) -> int:
    """What to take from a stamp of this source, under a base."""
    if base == BY_UNIX:
        return c[0].unix_us
    return s.offset_us if base == BY_OWN else 0


@step
def _awaits_boot(c: Rows, s: Record, stamp_us: int) -> bool:
    """Whether a stamp ahead of the clock, under the base that served, may follow a gap: a stamp
    from boot is then awaited, for up to a second of the source's own stamps."""
    if s.origin == BY_NOTHING:
        return False
    offset_us = _offset_us(c, s, s.origin)
    if offset_us == NONE_US or stamp_us - offset_us <= c[0].now_us:
        return False
    if s.doubt_us == NONE_US:
        s.doubt_us, s.doubt_boot_us = stamp_us, c[0].boot_us
    return c[0].boot_us == s.doubt_boot_us and 0 <= stamp_us - s.doubt_us < ALONE_US


@step
def _corrected(s: Record, time_us: int, now_us: int, boot_us: int) -> int:
    """The time without the part that every stamp of the last 2 to 3 s has in common.

    A receiver's time that was set 1 s ahead and then right again is 1 s behind what was learned.
    """
    behind_us, ahead_us, count = time_us - now_us, time_us - boot_us, s.seconds
    if count and not 0 <= now_us - s.start_us[count - 1] <= 2 * SECOND_US:
        count = 0
    if count and now_us - s.start_us[count - 1] < SECOND_US:
        s.behind_us[count - 1] = max(s.behind_us[count - 1], behind_us)
        s.ahead_us[count - 1] = min(s.ahead_us[count - 1], ahead_us)
    else:
        if count == SECONDS:
            for i in range(1, SECONDS):
                s.start_us[i - 1] = s.start_us[i]
                s.behind_us[i - 1], s.ahead_us[i - 1] = s.behind_us[i], s.ahead_us[i]
            count -= 1
        s.start_us[count], s.behind_us[count], s.ahead_us[count] = now_us, behind_us, ahead_us
        count += 1
    s.seconds = count
    if count < SECONDS:
        return time_us
    newest_us, oldest_us = s.behind_us[0], s.ahead_us[0]
    for i in range(1, SECONDS):
        newest_us = max(newest_us, s.behind_us[i])
        oldest_us = min(oldest_us, s.ahead_us[i])
    if newest_us < -SKEW_US:
        return time_us - newest_us
    return time_us - oldest_us if oldest_us > SKEW_US else time_us


@step
def _note_unit(s: Record, stamp_us: int, arrival_us: int) -> bool:
    """Compare how stamps and arrivals advance, over windows of 2 s: stamps in microseconds where
    milliseconds belong, or the reverse. True when that is found."""
    elapsed_us = arrival_us - s.arrival_us
    if s.stamp_us == NONE_US or not 0 <= elapsed_us <= UNIT_START_US:
        s.stamp_us, s.arrival_us, s.windows = stamp_us, arrival_us, 0
        return False
    if s.unit != RIGHT or elapsed_us < UNIT_WINDOW_US:
        return False
    ratio = (stamp_us - s.stamp_us) / elapsed_us
    s.stamp_us, s.arrival_us = stamp_us, arrival_us
    fast = UNIT_LOW < ratio < UNIT_HIGH
    slow = UNIT_LOW < (1.0 / ratio if ratio > 0.0 else 0.0) < UNIT_HIGH
    s.windows = s.windows + 1 if fast or slow else 0
    if s.windows >= UNIT_WINDOWS:
        s.unit = TOO_FAST if fast else TOO_SLOW
    return s.unit != RIGHT
