"""Which of barometer and GNSS is wrong, by the difference of their heights alone.

The difference on which both last agreed can drift only so far (`companion.agreed_difference`).
Beyond that one of them is wrong: the one that left the common trend within 2.5 s is excluded, else
none is. A new difference that has lasted as long as the old one, a minute at least, counts as
agreed; but where the receiver was seen to leave, it is as probable as the old one and no more
(`has_lasted`): a receiver that was seen to jump is right again when it has jumped back.

A new difference lasts while the median of 10 s stays near it: one noisy fix ends nothing.
"""

import math

import numpy as np

from companion.agreed_difference import (
    DIFFERENCE,
    agree_on,
    agreed_m,
    by_height_m,
    difference_start,
    drift_m,
    follow,
    let_pass,
    note_speed,
    shown,
)
from companion.jit import step
from companion.kernels.atmosphere import baro_altitude_m
from companion.kernels.gnss import HIGHEST_GNSS_M, LOWEST_GNSS_M, gnss_sd_m
from companion.samples import Kind, Rows, rows

SIGMAS, LEAST_SD_M, UNKNOWN_SD_M, LEVEL_M = 5.0, 4.0, 10.0, 10.0
NEVER_US, FRESH_US, FAST_US = -(1 << 60), 2_000_000, 2_500_000
YOUNG_US, STEADY_US = 10_000_000, 60_000_000
BACK_RATIO, NEWEST = 1000.0, 3
BAROS, PAIRS = 64, 256
NONE, BARO, GNSS = -1, int(Kind.PRESSURE), int(Kind.GNSS)

AGREEMENT = np.dtype(
    [
        ("is_suspect", "i8"),  # the barometer's height is none
        ("excluded", "i8"),  # Kind of the sensor that is known to be wrong; -1 none
        ("agree", "i8"),
        ("has_lasted", "i8"),  # 1: an excluded receiver stayed as long as before it left, and is
        # there now
        ("baro_us", "i8"),
        ("baro_m", "f8"),
        ("gnss_us", "i8"),
        ("gnss_m", "f8"),
        ("agreed", DIFFERENCE),
        ("gap_m", "f8"),  # deviation of the last fix from the agreed difference
        ("gnss_limit_m", "f8"),
        ("sd_m", "f8"),
        ("level_m", "f8"),  # deviation from the agreed difference that is there since `level_us`
        ("level_unknown_m", "f8"),
        ("jump_m", "f8"),
        ("mover", "i8"),  # Kind of the sensor that moved fast by half of the limit; -1 none
        ("moved_m", "f8"),  # to this gap
        ("since_us", "i8"),
        ("until_us", "i8"),
        ("level_us", "i8"),
        ("changed_us", "i8"),
        ("baro_instance", "i8"),
        ("gnss_instance", "i8"),
        ("baros_us", "i8", (BAROS,)),  # rings: the newest value is before `..._next`
        ("baros_m", "f8", (BAROS,)),
        ("baros_next", "i8"),
        ("baros_count", "i8"),
        ("pairs_us", "i8", (PAIRS,)),
        ("pairs_m", "f8", (PAIRS, 3)),  # barometer, GNSS, gap
        ("pairs_next", "i8"),
        ("pairs_count", "i8"),
    ],
    align=True,
)


class Agreement:
    """Follows one barometer and one receiver: the first of each kind that is alive."""

    def __init__(self) -> None:
        self.state: Rows = rows(AGREEMENT)
        begin(self.state)

    @property
    def baro(self) -> tuple[int, float]:
        """Time and height of the barometer's last sample."""
        return int(self.state["baro_us"][0]), float(self.state["baro_m"][0])

    @property
    def gnss(self) -> tuple[int, float]:
        """Time and height of the last fix."""
        return int(self.state["gnss_us"][0]), float(self.state["gnss_m"][0])


@step
def begin(a: Rows) -> None:
    """Know nothing."""
    a[0].is_suspect = 0
    a[0].excluded, a[0].agree, a[0].has_lasted = NONE, 1, 0
    a[0].baro_us = a[0].gnss_us = NEVER_US
    difference_start(a[0].agreed)
    a[0].baro_m = a[0].gnss_m = a[0].gnss_limit_m = math.nan
    a[0].level_m = a[0].jump_m = a[0].moved_m = math.nan
    a[0].mover, a[0].gap_m, a[0].sd_m, a[0].level_unknown_m = NONE, 0.0, math.inf, 0.0
    a[0].since_us = a[0].until_us = a[0].level_us = a[0].changed_us = 0
    a[0].baro_instance = a[0].gnss_instance = 0
    a[0].baros_us[0], a[0].baros_m[0] = NEVER_US, math.nan
    a[0].baros_next = a[0].baros_count = 1
    a[0].pairs_us[0] = 0
    for k in range(3):
        a[0].pairs_m[0, k] = 0.0
    a[0].pairs_next = a[0].pairs_count = 1


@step
def limit_m(a: Rows) -> float:
    """Largest deviation from the agreed difference that is no fault, m."""
    return SIGMAS * max(a[0].sd_m, a[0].agreed.sd_m) + drift_m(a[0].agreed, a[0].baro_m)


@step
def follow_pressure(a: Rows, row: Rows) -> None:
    """Follow the barometer, and how far its error can have drifted.

    A suspect one (`companion.intake.screening`) says nothing of a height, but is followed: it may
    be believed again.
    """
    time_us, height_m = row[0].time_us, baro_altitude_m(row[0].pressure_pa)
    last_us, last_m = a[0].baro_us, a[0].baro_m
    if not math.isfinite(height_m):
        return
    if row[0].instance != a[0].baro_instance:
        if time_us - last_us <= FRESH_US:
            return
        a[0].baro_instance, a[0].agreed.metres = row[0].instance, math.nan
    if time_us < last_us:
        return
    a[0].is_suspect = 1 if row[0].suspect else 0
    if height_m != last_m:
        a[0].changed_us = time_us
    let_pass(a[0].agreed, max(0, time_us - max(0, last_us)) * 1e-6)
    a[0].baro_us, a[0].baro_m = time_us, height_m
    place = a[0].baros_next
    a[0].baros_us[place], a[0].baros_m[place] = time_us, height_m
    a[0].baros_next = (place + 1) % BAROS
    a[0].baros_count = min(BAROS, a[0].baros_count + 1)


@step
def follow_fix(a: Rows, row: Rows) -> None:
    """Follow the receiver, and compare it with the barometer of the same instant."""
    time_us, height_m = row[0].time_us, row[0].altitude_amsl_m
    if row[0].fix_type < 3 or not LOWEST_GNSS_M <= height_m <= HIGHEST_GNSS_M:
        return
    if row[0].instance != a[0].gnss_instance:
        if time_us - a[0].gnss_us <= FRESH_US:
            return
        a[0].gnss_instance, a[0].agreed.metres = row[0].instance, math.nan
    if time_us < a[0].gnss_us:
        return
    a[0].gnss_us, a[0].gnss_m = time_us, height_m
    a[0].sd_m = gnss_sd_m(row, LEAST_SD_M, UNKNOWN_SD_M)
    a[0].gnss_limit_m = SIGMAS * a[0].sd_m
    note_speed(a[0].agreed, row[0].ground_speed_mps)
    baro_us, baro_m = a[0].baro_us, a[0].baro_m
    for back in range(a[0].baros_count):
        place = (a[0].baros_next - 1 - back) % BAROS
        if a[0].baros_us[place] <= time_us:
            baro_us, baro_m = a[0].baros_us[place], a[0].baros_m[place]
            break
    if abs(time_us - baro_us) <= FRESH_US and math.isfinite(baro_m):
        _compare(a, time_us, baro_m, height_m)


@step
def _compare(a: Rows, time_us: int, baro_m: float, gnss_m: float) -> None:
    difference_m = gnss_m - baro_m
    a[0].gap_m = difference_m - agreed_m(a[0].agreed, baro_m)
    left = NONE
    if abs(a[0].gap_m) <= 0.5 * limit_m(a):
        a[0].mover = NONE
    else:
        left = _mover(a, time_us, baro_m, gnss_m)
        if a[0].mover == NONE:
            a[0].mover, a[0].moved_m = left, a[0].gap_m
    if math.isnan(a[0].gap_m):
        _latch(a, difference_m, baro_m, time_us)
    elif _is_back(a, time_us):
        _agree_again(a, difference_m, baro_m, time_us)
    elif a[0].agree:
        a[0].excluded = left
        if left == NONE and abs(a[0].gap_m - a[0].moved_m) <= LEVEL_M:
            a[0].excluded = a[0].mover  # it moved fast before, and stayed there
        a[0].agree, a[0].jump_m = 0, a[0].gap_m
        _start_level(a, time_us)
    else:
        _stay(a, baro_m, time_us)
    place = a[0].pairs_next
    a[0].pairs_us[place] = time_us
    a[0].pairs_m[place, 0], a[0].pairs_m[place, 1] = baro_m, gnss_m
    a[0].pairs_m[place, 2] = a[0].gap_m
    a[0].pairs_next = (place + 1) % PAIRS
    a[0].pairs_count = min(PAIRS, a[0].pairs_count + 1)


@step
def _start_level(a: Rows, time_us: int) -> None:
    """They differ by a new difference, which this fix shows first."""
    a[0].level_m, a[0].level_unknown_m = a[0].gap_m, a[0].sd_m
    a[0].level_us, a[0].has_lasted = time_us, 0


@step
def _stay(a: Rows, baro_m: float, time_us: int) -> None:
    """They still differ: whether by the same difference, and for how long now.

    Until it has lasted, it must be steady; then it may change as the agreed one may.
    """
    is_old = time_us - a[0].level_us >= max(STEADY_US, a[0].until_us - a[0].since_us)
    near_m = limit_m(a) if is_old and a[0].excluded == GNSS else LEVEL_M
    if _has_left(a, time_us, near_m):
        _start_level(a, time_us)
        return
    off_m = a[0].gap_m - a[0].level_m
    moved_m, a[0].level_unknown_m = shown(off_m, a[0].level_unknown_m, a[0].sd_m)
    a[0].level_m += moved_m
    is_there = is_old and abs(off_m) <= near_m
    if a[0].excluded == GNSS:
        a[0].has_lasted = 1 if is_there else 0
    elif is_there:
        difference_m = agreed_m(a[0].agreed, baro_m) + a[0].level_m
        _latch(a, difference_m, baro_m, time_us)


@step
def _has_left(a: Rows, time_us: int, near_m: float) -> bool:
    """Whether the median deviation of the last 10 s is further than `near_m` from the level."""
    above = 1 if a[0].gap_m > a[0].level_m + near_m else 0
    below = 1 if a[0].gap_m < a[0].level_m - near_m else 0
    count = 1
    for back in range(a[0].pairs_count):
        place = (a[0].pairs_next - 1 - back) % PAIRS
        since_us = time_us - a[0].pairs_us[place]
        if since_us > YOUNG_US or a[0].pairs_us[place] < a[0].level_us:
            break
        count += 1
        above += 1 if a[0].pairs_m[place, 2] > a[0].level_m + near_m else 0
        below += 1 if a[0].pairs_m[place, 2] < a[0].level_m - near_m else 0
    return 2 * max(above, below) > count


@step
def _agree_again(a: Rows, difference_m: float, baro_m: float, time_us: int) -> None:
    """The two agree."""
    a[0].excluded, a[0].agree, a[0].has_lasted = NONE, 1, 0
    a[0].until_us = time_us
    follow(a[0].agreed, difference_m, a[0].sd_m, baro_m)
    if time_us - a[0].since_us < YOUNG_US or a[0].sd_m < 0.5 * a[0].agreed.sd_m:
        _latch(a, difference_m, baro_m, a[0].since_us)


@step
def _latch(a: Rows, difference_m: float, baro_m: float, since_us: int) -> None:
    """This difference is agreed, and has been since then."""
    agree_on(a[0].agreed, difference_m, a[0].sd_m, baro_m)
    a[0].excluded, a[0].agree, a[0].has_lasted = NONE, 1, 0
    a[0].gap_m, a[0].since_us = 0.0, since_us


@step
def _mover(a: Rows, time_us: int, baro_m: float, gnss_m: float) -> int:
    """The sensor that left the common trend; NONE when neither left it alone and fast."""
    if time_us - a[0].changed_us > 2 * FRESH_US:
        return BARO  # it repeats one value
    near_m = 0.5 * limit_m(a)
    start = before = -1  # the newest pair near the agreement, and the oldest within `FAST_US` of it
    for back in range(a[0].pairs_count):
        place = (a[0].pairs_next - 1 - back) % PAIRS
        if abs(a[0].pairs_m[place, 2]) <= near_m:
            if start < 0:
                start = place
            if a[0].pairs_us[start] - a[0].pairs_us[place] <= FAST_US:
                before = place
    if start < 0 or time_us - a[0].pairs_us[start] > FAST_US:
        return NONE
    climbed_m = a[0].pairs_m[start, 0] - a[0].pairs_m[before, 0]
    rate = climbed_m / max(1, a[0].pairs_us[start] - a[0].pairs_us[before])
    trend_m = rate * (time_us - a[0].pairs_us[start])
    baro_off_m = abs(baro_m - a[0].pairs_m[start, 0] - trend_m)
    gnss_off_m = abs(gnss_m - a[0].pairs_m[start, 1] - trend_m)
    if max(baro_off_m, gnss_off_m) < max(near_m, 2.0 * min(baro_off_m, gnss_off_m)):
        return NONE
    return GNSS if gnss_off_m > baro_off_m else BARO


@step
def _is_back(a: Rows, time_us: int) -> bool:
    """Whether both agree: a jump that was seen ends by a jump back, not by drift; and what once
    disagreed is not explained by a later change of height."""
    gap_m, most_m = abs(a[0].gap_m), limit_m(a)
    if gap_m > most_m:
        return False
    if a[0].excluded != NONE and _has_jumped_back(a, time_us):
        return True
    if not a[0].agree:
        most_m -= by_height_m(a[0].agreed, a[0].baro_m)
    return gap_m <= (most_m if a[0].excluded == NONE else min(most_m, _near_m(a)))


@step
def _has_jumped_back(a: Rows, time_us: int) -> bool:
    """Whether the newest three fixes are all nearer by half of the jump than most of the fixes in
    the 10 s before them: noise of one fix is no jump."""
    sign, count, farther = math.copysign(1.0, a[0].jump_m), 0, 0
    now_m = sign * a[0].gap_m
    for back in range(a[0].pairs_count):
        place = (a[0].pairs_next - 1 - back) % PAIRS
        before_m = sign * a[0].pairs_m[place, 2]
        if back < NEWEST - 1:
            now_m = max(now_m, before_m)
        elif time_us - a[0].pairs_us[place] <= YOUNG_US:
            count += 1
            farther += 1 if before_m - now_m >= 0.5 * abs(a[0].jump_m) else 0
    return 2 * farther > count


@step
def _near_m(a: Rows) -> float:
    """Gap up to which an agreement is `BACK_RATIO` times as probable as the jump that was seen,
    where both have drifted since (two normal distributions, 0 and the jump away)."""
    drifted_m = math.hypot(math.sqrt(2.0) * a[0].sd_m, 0.5 * drift_m(a[0].agreed, a[0].baro_m))
    jump_m = abs(a[0].jump_m)
    near_m = 0.5 * jump_m - drifted_m * drifted_m * math.log(BACK_RATIO) / jump_m
    return min(SIGMAS * a[0].sd_m, near_m)
