"""What a receiver reports about its height: a white and a slow part of its spread, by fix type, and
what a change of the report means.

===========================  ==========  ===========  ==============================================
fix type                     slow floor  white floor  source
===========================  ==========  ===========  ==============================================
RTK fixed (6)                .02 m       .02 m        receivers of 1-3 cm on the recorded RTK flight
RTK float (5)                .3 m        .1 m         decimetres, by data sheets
DGPS (4)                     1.5 m       .4 m         SBAS without its slow ionosphere error
3D (3)                       settings    settings     metres, whatever is reported
===========================  ==========  ===========  ==============================================

A better fix type is believed until a fix is off by more than it allows, and by no more than a plain
fix may be wrong: then it counts as a plain fix, until it has not been claimed for `DISCREDIT_US`.
More than that is a fault.

The white part is what the stream shows: the median of what consecutive heights differ by beyond the
motion. The slow part is the rest of the reported spread, or what the heights of a vehicle that
rests before its take-off vary by, if that is more: a receiver that stood still reported .8 m and
swung by 5 m. A vehicle that is carried upstairs moves, and a barometer at rest is disturbed by
wind, so what the heights vary by themselves and against the barometer counts, the smaller of the
two. The expected variance counts in it like one more correlation time. Where
only a dilution of precision is reported, what is shown may also be less. Such swings are quicker
than the slow error of a good receiver: their correlation time follows from how much of them a
high-pass of a minute leaves.

Doubt in the datum is constant: it widens what is published, and does not make drift of the pressure
more probable.
"""

import math

import numpy as np

from companion.estimators.vertical_bank.channel import GNSS_BIAS, shrink
from companion.estimators.vertical_bank.mixture import N, gnss_is_wrong
from companion.jit import step
from companion.kernels.gnss import gnss_sd_m
from companion.samples import Record, Rows

MUCH_BETTER = 2.0
RTK_FLOAT, RTK_FIXED = 5, 6
RTK_STAMP_RATIO = 0.06
NOISE_STEP = 0.05
MEDIAN_TO_SD = 1.4826
DISCREDIT_US = 600_000_000
DISCREDIT_SIGMA, DISCREDIT_LEAST_M, DISCREDIT_PROBABILITY = 3.0, 1.0, 0.05
LONGEST_REST_STEP_S = 1.0
SWING_TIME_S = 60.0
"""of the high-pass, and the least correlation time of swings: reflections off the ground and off
buildings last for a minute and more at a receiver that stands still"""
PLAIN = 3
DGPS_SLOW_M, DGPS_WHITE_M = 1.5, 0.4
FLOAT_SLOW_M, FLOAT_WHITE_M = 0.3, 0.1
FIXED_SLOW_M, FIXED_WHITE_M = 0.02, 0.02

RECEIVER = np.dtype(
    [
        ("seen", "i8"),
        ("used_us", "i8"),  # newest fix that was fused
        ("median_m", "f8"),  # of the differences between consecutive heights beyond the motion
        ("differences", "i8"),  # how many of them were seen
        ("height_m", "f8"),  # newest, and the path then
        ("path_m", "f8"),
        ("innovation_m", "f8"),
        ("plain_until_us", "i8"),  # until then a fix counts as a plain one
        ("datum_m2", "f8"),  # variance of a constant error of its datum
        ("against_m", "f8"),  # by how much a receiver that is back contradicts the height, else 0
        ("ground_speed_mps", "f8"),
        ("rest_s", "f8"),  # at rest in this stretch; its mean height, and that above the barometer
        ("rest_m", "f8", (2,)),
        ("rests_s", "f8"),  # of all stretches, and the integrals of the squares about their means
        ("rests_m2s", "f8", (2,)),
        ("rest_smooth_m", "f8"),  # height over a minute
        ("rests_quick_m2s", "f8"),  # integral of the squares about that
        ("rest_type", "i8"),  # fix type and reported spread then
        ("rest_reported_m", "f8"),
    ],
    align=True,
)


@step
def receiver_start(gnss: Record) -> None:
    """No fix heard."""
    gnss.plain_until_us, gnss.median_m, gnss.differences = -1, math.nan, 0
    gnss.rest_type, gnss.rest_reported_m = 0, 0.0
    forget_rests(gnss)
    receiver_restart(gnss)


@step
def receiver_restart(gnss: Record) -> None:
    """No fix heard, by an estimator that begins anew; what its fixes have shown of the receiver is
    known."""
    gnss.seen, gnss.used_us, gnss.height_m, gnss.path_m = 0, -1, math.nan, 0.0
    gnss.against_m, gnss.datum_m2 = 0.0, 0.0
    gnss.innovation_m, gnss.ground_speed_mps = math.nan, math.nan
    note_motion(gnss)


@step
def credited_type(gnss: Record, sample: Rows, now_us: int) -> int:
    """Fix type that is believed. One that was discredited must not be claimed for `DISCREDIT_US`
    before it is believed again."""
    fix_type = sample[0].fix_type
    if now_us >= gnss.plain_until_us or fix_type <= PLAIN:
        return int(fix_type)
    gnss.plain_until_us = now_us + DISCREDIT_US
    return PLAIN


@step
def discredit(
    gnss: Record, p: Record, fix_type: int, error_m: float, least_m: float, now_us: int
) -> bool:
    """Whether an error of `least_m` or more says that a fix is a plain one: its type is better, and
    a plain fix may be wrong by so much."""
    most_m = DISCREDIT_SIGMA * p.gnss_slow_floor_m
    if fix_type <= PLAIN or not least_m <= abs(error_m) < most_m:
        return False
    gnss.plain_until_us = now_us + DISCREDIT_US
    return True


@step
def slow_floor_m(p: Record, fix_type: int) -> float:
    """Least slow error of a fix of this type."""
    if fix_type >= RTK_FIXED:
        return FIXED_SLOW_M
    if fix_type == RTK_FLOAT:
        return FLOAT_SLOW_M
    return min(DGPS_SLOW_M, p.gnss_slow_floor_m) if fix_type == 4 else p.gnss_slow_floor_m


@step
def white_floor_m(p: Record, fix_type: int) -> float:
    """Least white noise of a fix of this type."""
    if fix_type >= RTK_FIXED:
        return FIXED_WHITE_M
    if fix_type == RTK_FLOAT:
        return FLOAT_WHITE_M
    return min(DGPS_WHITE_M, p.gnss_white_floor_m) if fix_type == 4 else p.gnss_white_floor_m


@step
def datum_m2(sample: Rows) -> float:
    """Variance of a constant error of the height's datum."""
    sd_m = sample[0].datum_sd_m
    return sd_m * sd_m if sd_m > 0.0 else 0.0


@step
def reported_m2(p: Record, sample: Rows) -> float:
    """Reported variance of a fix, without the doubt in its datum."""
    reported_m = gnss_sd_m(sample, 0.0, p.gnss_sd_unknown_m)
    return max(0.0, reported_m * reported_m - datum_m2(sample))


@step
def stamp_ratio(fix_type: int) -> float:
    """Share of the jitter of time stamps in a fix of this type. RTK solutions are stamped by the
    receiver's own clock, but ArduPilot's stamp is the time of parsing, and latency is known to some
    20 ms: 0.1 m in a climb of 4 m/s, where the solution is good to 2 cm."""
    return RTK_STAMP_RATIO if fix_type >= RTK_FLOAT else 1.0


@step
def note_fix(gnss: Record, p: Record, sample: Rows, path_m: float) -> None:
    """Follow the median of |change beyond the motion| by a step up or down with every fix: an
    outlier counts no more than any other."""
    height_m = sample[0].altitude_amsl_m
    if math.isnan(gnss.median_m):
        gnss.median_m = p.gnss_white_floor_m
    elif not math.isnan(gnss.height_m):
        change_m = abs(height_m - gnss.height_m - (path_m - gnss.path_m))
        up = change_m > gnss.median_m
        gnss.median_m *= 1.0 + NOISE_STEP if up else 1.0 / (1.0 + NOISE_STEP)
        gnss.differences += 1
    gnss.height_m, gnss.path_m = height_m, path_m
    gnss.ground_speed_mps = sample[0].ground_speed_mps


@step
def white_m2(gnss: Record, p: Record, sample: Rows, fix_type: int) -> float:
    """White variance of a fix: what the stream shows, within the reported spread."""
    shown_m = MEDIAN_TO_SD / math.sqrt(2.0) * gnss.median_m
    reported_m = math.sqrt(reported_m2(p, sample))
    return max(white_floor_m(p, fix_type), min(shown_m, reported_m)) ** 2


@step
def unseen_white_m2(gnss: Record, p: Record, sample: Rows, white: float) -> float:
    """What the white variance may be more than `white`, which the stream shows: all of the rest of
    the reported variance before it has shown a difference, a share of it after some."""
    return max(0.0, reported_m2(p, sample) - white) / max(1, gnss.differences)


@step
def forget_rests(gnss: Record) -> None:
    """What the heights vary by at rest is not known."""
    gnss.rest_s, gnss.rests_s = 0.0, 0.0
    gnss.rest_smooth_m, gnss.rests_quick_m2s = 0.0, 0.0
    for k in range(2):
        gnss.rest_m[k], gnss.rests_m2s[k] = 0.0, 0.0


@step
def expected_slow_m2(p: Record, sample: Rows, fix_type: int, white: float) -> float:
    """Slow variance of a fix as it is reported: the rest of the reported spread."""
    floor_m = slow_floor_m(p, fix_type)
    return max(floor_m * floor_m, reported_m2(p, sample) - white)


@step
def slow_m2(gnss: Record, p: Record, sample: Rows, fix_type: int, white: float) -> float:
    """Slow variance of a fix: as reported, or what the stream has shown at rest of a fix that was
    as good. A dilution of precision tells a variance to a factor, so less than it tells counts by
    the mean of the logarithms."""
    expected_m2 = expected_slow_m2(p, sample, fix_type, white)
    if fix_type > gnss.rest_type or gnss.rests_s == 0.0:
        return expected_m2
    shown_m2 = min(gnss.rests_m2s[0], gnss.rests_m2s[1]) / gnss.rests_s
    share = gnss.rests_s / (p.gnss_time_s + gnss.rests_s)
    if shown_m2 >= expected_m2:
        return (1.0 - share) * expected_m2 + share * shown_m2
    if sample[0].vertical_sd_m > 0.0:
        return expected_m2
    floor_m2 = slow_floor_m(p, fix_type) ** 2
    return float(max(floor_m2, expected_m2 * (max(floor_m2, shown_m2) / expected_m2) ** share))


@step
def slow_time_s(gnss: Record, p: Record, expected_m2: float, slow: float) -> float:
    """Correlation time of a slow error of variance `slow`, of which `expected_m2` is that of a good
    receiver and the rest are swings."""
    if slow <= expected_m2:
        return float(p.gnss_time_s)
    quick = gnss.rests_quick_m2s / max(gnss.rests_m2s[0], gnss.rests_quick_m2s)
    swing_s = max(SWING_TIME_S, min(p.gnss_time_s, SWING_TIME_S * (1.0 / quick - 1.0)))
    return float(slow / (expected_m2 / p.gnss_time_s + (slow - expected_m2) / swing_s))


@step
def note_rest(
    gnss: Record, p: Record, sample: Rows, fix_type: int, interval_s: float, baro_m: float
) -> None:
    """The next height of a vehicle that rests, where the barometer shows `baro_m`: what it varies
    by is error. A better fix type, or a reported spread that is much better, begins anew; a much
    worse one tells nothing, and RTK is better than a rest is still."""
    reported_m, height_m = math.sqrt(reported_m2(p, sample)), sample[0].altitude_amsl_m
    if fix_type >= RTK_FLOAT:
        return
    if MUCH_BETTER * reported_m < gnss.rest_reported_m or fix_type > gnss.rest_type:
        forget_rests(gnss)
    if gnss.rests_s == 0.0:
        gnss.rest_type, gnss.rest_reported_m = fix_type, reported_m
    if fix_type < gnss.rest_type or reported_m > MUCH_BETTER * gnss.rest_reported_m:
        return
    interval_s = min(interval_s, LONGEST_REST_STEP_S)
    gnss.rest_s += interval_s
    gnss.rests_s += interval_s
    share = interval_s / gnss.rest_s
    if share == 1.0:
        gnss.rest_smooth_m = height_m
    quick_m = height_m - gnss.rest_smooth_m
    gnss.rest_smooth_m += interval_s / SWING_TIME_S * quick_m
    gnss.rests_quick_m2s += interval_s * quick_m * quick_m
    for k in range(2):
        shown_m = height_m - (baro_m if k == 1 else 0.0)
        away_m = shown_m - gnss.rest_m[k] if share < 1.0 else 0.0
        gnss.rest_m[k] = shown_m - (1.0 - share) * away_m
        gnss.rests_m2s[k] += interval_s * (1.0 - share) * away_m * away_m


@step
def note_motion(gnss: Record) -> None:
    """The vehicle has moved: the next rest is another stretch, with a mean of its own."""
    gnss.rest_s = 0.0


@step
def expect_gnss(bank: Record, p: Record, slow: float, elapsed_s: float) -> None:
    """The slow variance that the receiver reports now goes to every hypothesis.

    A report that gets worse adds what it is worse by. One that gets better by `MUCH_BETTER` and
    more says that the error has shrunk with it, though not by how much exactly: it is as new as it
    is smaller. One that gets a little better may get worse again; it is followed as slowly as the
    error changes.
    """
    before = bank.slow_m2
    worse = max(0.0, slow - before)
    much_better = slow * MUCH_BETTER * MUCH_BETTER < before
    if worse > 0.0 or much_better:
        bank.slow_m2 = slow
    else:
        bank.slow_m2 += min(1.0, elapsed_s / p.gnss_time_s) * (slow - before)
    for i in range(N):
        if bank.weight[i] == 0.0:
            continue
        if much_better and not gnss_is_wrong(i):
            left = math.sqrt(slow / before)
            bank.x[i, GNSS_BIAS] *= left
            shrink(bank.P[i], GNSS_BIAS, left)
            bank.P[i, GNSS_BIAS, GNSS_BIAS] += (1.0 - left * left) * slow
        bank.P[i, GNSS_BIAS, GNSS_BIAS] += worse
