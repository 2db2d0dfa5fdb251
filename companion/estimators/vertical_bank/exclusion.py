"""Which sensor is wrong, and how far the height could be off: solution separation and its rules.

Copies of the channel run beside the bank and leave one sensor out (`vertical_mixture`). What
follows when they part:

==============================================================  ================================================
what is seen                                                    what is concluded
==============================================================  ================================================
barometer: `ONSET_FAILS` of ten innovations beyond four sigma   the barometer is wrong
on one side in the stiff copy, or their mean over two seconds
beyond seven of its own sigma, or the same value for ten of its
own intervals while the vehicle moves
four of five fixes beyond five sigma                            GNSS is wrong; but while the barometer is blamed, and
                                                                agrees or GNSS did not jump: the IMU
                                                                is
the bank parts from a copy without GNSS by five sigma, faster   GNSS is wrong, and the bank goes back to the youngest
than weather can drift                                          copy from before
the same, slower                                                weather: the spread grows, nobody is blamed
four of five fixes beyond, and a second receiver agrees         the bank has drifted: nobody is blamed
fifteen barometer heights beyond three sigma without a jump,    the IMU is wrong; if it was the barometer after all,
and without GNSS for `ALONE_US`                                 the fixes that come later are believed
four of five fixes beyond, taking back what had parted          GNSS was wrong and is right again
fixes were refused for `INERTIAL_US`, barometer heights too     whoever was blamed, the height is lost: start anew
==============================================================  ================================================

A sensor comes back by evidence: the barometer when it has followed the bank's motion for `STEADY_S`
(its offset is then learned anew), GNSS when it has been near the height without it for as long and
moved no faster than weather, the IMU after a while on trial. A GNSS that left with a jump stays out
until it jumps back, while doubt in the height explains what it has moved since (or a lasting step
would be accepted as soon as the spread has grown).

The copies without GNSS are seeded from the bank in turns, `SEED_S` apart: the old ones remember a
time before a slow fault, the young ones know the weather of now.

The variance of the separation of an optimal estimate and one from fewer data is the difference of
their variances.
"""

import math
from typing import Any

from companion.estimators.vertical_bank.channel import (
    ACCEL,
    CLIMB,
    FAST,
    GNSS_BIAS,
    HEIGHT,
    OFFSET,
    RATE,
    SCALE,
    SIZE,
    absorb,
    dot,
    duplicate,
    gather,
    sees_height,
)
from companion.estimators.vertical_bank.mixture import (
    BANK,
    CHANNELS,
    FREE,
    NO_BARO,
    NO_GNSS,
    NO_IMU,
    STIFF,
    TAKEOFF,
    combine,
    expect_weather,
    inertial_psd,
    is_inertial,
    mixture_start,
    tilt_mps2_squared,
)
from companion.estimators.vertical_bank.redundancy import RECEIVER, a_witness_agrees
from companion.jit import step
from companion.samples import FaultySensor, Rows

NOBODY, BAROMETER, GNSS_HEIGHT, INERTIAL = (int(fault) for fault in FaultySensor)

ONSET_SIGMA, ONSET_OF, ONSET_FAILS = 4.0, 10, 8
ONSET_TIME_S, ONSET_MEAN_SIGMA = 2.0, 7.0
SCALE_TIME_S = 1.0
"""for so long does a climb that the air's scale feigns go unabsorbed in the stiff copy"""
TILT_SIGMA = 3.0
"""of a wrong attitude count as one in the stiff copy, whose mean over time does nothing against
what stays"""
ALONE_US = 3_000_000
CLIPPED_TO_RELEARN = 15
CLIPPED_SIGMA = 3.0
"""no single innovation moves the mean by more"""
FROZEN_INTERVALS, FROZEN_REPEATS = 10.0, 9
FROZEN_MOTION_M = 0.5
REST_MPS = 0.5
REST_S = 1.0
"""with a barometer whose own rate is not known yet"""
INTERVAL_WEIGHT = 1.0 / 16.0
FIX_SIGMA = 5.0
FIXES, FAILED_FIXES = 5, 4
STEADY_S = 5.0
SMOOTHING_S = 1.0
STEADY_BARO_M = 1.0
STEADY_GNSS_M = 13.0
"""under half of the 30 m step that must stay out, over four sigma of a healthy receiver"""
JUMP_SIGMA, JUMP_FIXES = 4.0, 3
AWAY_WEIGHT = 0.2
RELEARNED_M2 = 1e4
SEED_S = 25.0
YOUNGEST_S = 20.0
"""a copy this old has had time to part"""
ONSET_DOUBT_S = 5.0
"""of when it began to part"""
PARTED_SIGMA = 5.0
PARTED_FLOOR_M2 = 0.25
SLOPE_TIME_S = 10.0
FASTEST_WEATHER_MPS = 1.0
"""two hectopascals a minute are 0.28 m/s; the warmest ramp of a front at 3 km adds as much"""
DOUBT_TIME_S = 300.0
"""in which doubt in the height without GNSS grows by a sigma"""
OUTAGE_S, REACQUIRED_S = 10.0, 15.0
DEFENDED_SD_M = 30.0
"""a height without GNSS that is worse is of no use: better a GNSS that may be wrong"""
INFLATED_TIME_S = 200.0
TAKEN_BACK_M = 3.0
INERTIAL_US = 10_000_000
"""for so long may the height rest on the IMU alone while there are fixes"""
IMU_PENALTY_US = 30_000_000
STIFF_OFFSET_WALK = 0.01
STIFF_REFERENCE_M = 0.1


def integrity_fields() -> tuple[tuple[Any, ...], ...]:
    """The state fields of this component."""
    return (
        ("watching", "i8"),  # whether anybody may be blamed
        ("blamed_us", "i8", (len(FaultySensor),)),  # since when, -1 healthy
        ("baro_value_us", "i8"),  # since when the barometer repeats its value
        ("baro_repeats", "i8"),
        ("baro_interval_s", "f8"),  # between new values, smoothed; NaN unknown
        ("baro_frozen", "i8"),
        ("onset_above", "i8"),  # bits of the last innovations beyond the gate, newest lowest
        ("onset_below", "i8"),
        ("onset_mean", "f8"),
        ("baro_change_m", "f8"),  # from value to value, beyond the motion
        ("baro_jump_us", "i8"),  # when that was last more than noise
        (
            "baro_clipped",
            "i8",
        ),  # innovations beyond the bank's gate in a row; the sign is their side
        ("fix_us", "i8"),  # newest fix that was used, and barometer height
        ("baro_us", "i8"),
        ("refused_us", "i8"),  # the first fix that was refused since one was used, -1 none
        (
            "unwitnessed",
            "i8",
        ),  # the IMU was blamed on the word of the barometer alone, and no fix has agreed since
        ("stiff_seeded", "i8"),
        ("steady_us", "i8"),  # a blamed barometer follows the motion since, -1 not
        ("steady_m", "f8"),
        ("smooth_m", "f8"),
        ("failed_fixes", "i8"),  # bits, newest lowest
        ("near_us", "i8"),  # a blamed GNSS is near, and no faster than weather, since; -1 not
        ("near_m", "f8"),  # and was so far away then
        ("away_m", "f8"),  # how far it is from the bank, smoothed
        ("away_fixes", "i8"),
        ("jumps_m", "f8"),  # sum of its jumps, that of its fault included
        ("jump_m", "f8"),  # of the last fixes, not yet believed
        ("jumped_fixes", "i8"),
        ("near_fix_m", "f8"),  # innovation of the last fix within the gate, NaN after a silence
        ("silence_s", "f8"),  # before the fixes since
        (
            "latched",
            "i8",
        ),  # what GNSS is blamed for came: 1 as a jump, -1 with the first fixes after an outage, 0 else
        ("seeded_us", "i8", (FREE,)),  # of the copies without GNSS, -1 never
        (
            "separation_mean_m",
            "f8",
            (FREE,),
        ),  # bank less copy, smoothed; NaN while the copy is too young
        ("separation_us", "i8"),
        (
            "excess_m",
            "f8",
        ),  # of the separation over what is normal: nobody's fault, but somebody's error
        ("takeoff_us", "i8"),  # -1 before
        ("takeoff_climbing_us", "i8"),
        ("takeoff_reference_m", "f8"),  # the bank's height then
        ("takeoff_var_m2", "f8"),
        ("takeoff_handed_over", "i8"),
        ("armed", "i8"),
    )


@step
def integrity_start(state: Rows, params: Rows) -> None:
    """Nobody is blamed."""
    s = state[0]
    s.watching = params[0].integrity
    for i in range(s.blamed_us.size):
        s.blamed_us[i] = -1
    s.baro_value_us, s.baro_repeats, s.baro_interval_s, s.baro_frozen = -1, 0, math.nan, 0
    s.onset_above, s.onset_below, s.onset_mean, s.stiff_seeded, s.baro_clipped = 0, 0, 0.0, 0, 0
    s.baro_change_m, s.baro_jump_us, s.fix_us, s.baro_us = 0.0, -ALONE_US, -ALONE_US, -ALONE_US
    s.refused_us, s.unwitnessed = -1, 0
    s.steady_us, s.steady_m, s.smooth_m = -1, 0.0, 0.0
    s.failed_fixes, s.near_us, s.near_m = 0, -1, 0.0
    s.away_fixes, s.away_m, s.jumps_m, s.jumped_fixes, s.jump_m = 0, math.nan, 0.0, 0, 0.0
    s.near_fix_m, s.silence_s, s.latched = math.nan, 0.0, 0
    forget_copies(state)
    s.separation_us = -1
    s.excess_m = 0.0
    s.takeoff_us, s.takeoff_climbing_us, s.takeoff_handed_over = -1, -1, 0
    s.takeoff_reference_m, s.takeoff_var_m2 = math.nan, math.nan
    s.armed = -1
    expect_weather(state, params, NO_IMU, params[0].rate_sd_mps[1])
    s.P[NO_IMU, RATE, RATE] = s.steady[NO_IMU, RATE]
    s.P[NO_IMU, FAST, FAST] = s.steady[NO_IMU, FAST]


@step
def is_blamed(state: Rows, fault: int) -> bool:
    """Whether a sensor is held to be wrong now."""
    return state[0].blamed_us[fault] >= 0


@step
def blame(state: Rows, fault: int) -> None:
    """From now on a sensor is wrong."""
    s = state[0]
    s.blamed_us[fault] = s.filter_us
    s.failed_fixes = 0
    if fault == GNSS_HEIGHT:
        s.near_us, s.latched = -1, 0
        s.away_fixes, s.jumps_m, s.jumped_fixes, s.jump_m = 0, 0.0, 0, 0.0
    elif fault == BAROMETER:
        s.steady_us, s.stiff_seeded = -1, 0
        hand_over(state)


@step
def forgive_imu(state: Rows) -> None:
    """The IMU is on trial again after a while, whether it has been heard since or not."""
    s = state[0]
    if is_blamed(state, INERTIAL) and s.filter_us - s.blamed_us[INERTIAL] > IMU_PENALTY_US:
        s.blamed_us[INERTIAL] = -1


@step
def blamed_now(state: Rows) -> int:
    """The sensor that has been wrong for longest, `FaultySensor.NONE` if all are well."""
    s, found = state[0], NOBODY
    for fault in range(1, s.blamed_us.size):
        earlier = found == NOBODY or s.blamed_us[fault] < s.blamed_us[found]
        if s.blamed_us[fault] >= 0 and earlier:
            found = fault
    return found


# Barometer


@step
def note_interval(state: Rows, time_us: int) -> None:
    """A new value came: how long the last one was repeated."""
    s = state[0]
    if s.baro_value_us >= 0 and s.baro_frozen == 0:
        interval_s = (time_us - s.baro_value_us) * 1e-6
        if math.isnan(s.baro_interval_s):
            s.baro_interval_s = interval_s
        s.baro_interval_s += INTERVAL_WEIGHT * (
            min(interval_s, 3.0 * s.baro_interval_s) - s.baro_interval_s
        )
    s.baro_value_us, s.baro_repeats, s.baro_frozen = time_us, 0, 0


@step
def note_repeat(state: Rows, time_us: int, moved_m: float) -> None:
    """The same value again: frozen, if for ten of the sensor's own intervals, while the vehicle
    moved."""
    s = state[0]
    s.baro_repeats += 1
    interval_s = REST_S if math.isnan(s.baro_interval_s) else s.baro_interval_s
    long = (time_us - s.baro_value_us) * 1e-6 >= FROZEN_INTERVALS * interval_s
    moved = abs(moved_m) > FROZEN_MOTION_M
    if (
        s.watching == 1
        and long
        and s.baro_repeats >= FROZEN_REPEATS
        and moved
        and not is_blamed(state, BAROMETER)
    ):
        s.baro_frozen = 1
        blame(state, BAROMETER)


@step
def rests(state: Rows, time_us: int, moved_m: float) -> bool:
    """Whether the barometer repeats its value because nothing changes: for long, and the vehicle
    does not move."""
    s = state[0]
    long_s = REST_S if math.isnan(s.baro_interval_s) else FROZEN_INTERVALS * s.baro_interval_s
    at_rest = abs(moved_m) <= FROZEN_MOTION_M and abs(s.average[CLIMB]) < REST_MPS
    return at_rest and (time_us - s.baro_value_us) * 1e-6 >= long_s


@step
def baro_after_silence(state: Rows, baro_m: float, R: float) -> None:
    """A barometer that was silent, or not believed, reads again: what it reads may be of another
    datum."""
    s = state[0]
    combine(state)
    innovation = baro_m - dot(s.H, s.average)
    if innovation * innovation > FIX_SIGMA * FIX_SIGMA * (R + gather(s.cov, s.H, s.K)):
        hand_over(state)
        relearn_offset(state, innovation * innovation)
    forget_copies(state)
    s.stiff_seeded = 0


@step
def seed_stiff(state: Rows, i: int, height_m: float, error_m: float) -> None:
    """Channel `i` takes the bank's climb and accelerometer bias, and believes that the barometer
    reads the height `height_m` too high by `error_m`, and goes on so."""
    s = state[0]
    combine(state)
    duplicate(s.x[i], s.P[i], s.average, s.cov)
    for k in range(SIZE):
        if k not in (CLIMB, ACCEL):
            s.x[i, k] = 0.0
            s.steady[i, k] = 0.0
            for m in range(SIZE):
                s.P[i, k, m] = 0.0
                s.P[i, m, k] = 0.0
    s.x[i, HEIGHT], s.x[i, OFFSET] = height_m, error_m
    s.P[i, OFFSET, OFFSET] = STIFF_REFERENCE_M * STIFF_REFERENCE_M
    s.walk[i, OFFSET] = STIFF_OFFSET_WALK * STIFF_OFFSET_WALK
    s.walk[i, SCALE] = 0.0


@step
def watch_baro(state: Rows, params: Rows, baro_m: float, R: float) -> bool:
    """Whether the barometer has just begun to be wrong, as the stiff copy sees it; that takes the
    measurement in.

    What may look so without being it: a climb that the air's scale feigns, and an attitude that is
    wrong in a turn.

    A wrong acceleration a stays a / w2 of innovation, where the copy's bandwidth is w4 = noise of
    the acceleration over that of the barometer. Without GNSS it is the barometer against the IMU,
    and the one that stays bounded is believed, unless it jumped.
    """
    s = state[0]
    if s.stiff_seeded == 0:
        s.stiff_seeded = 1
        s.onset_above, s.onset_below, s.onset_mean = 0, 0, 0.0
        seed_stiff(state, STIFF, baro_m, 0.0)
        s.P[STIFF, HEIGHT, HEIGHT] = R
        return False
    s.x[STIFF, SCALE] = s.average[SCALE]
    innovation = baro_m - dot(s.H, s.x[STIFF])
    S = R + gather(s.P[STIFF], s.H, s.K)
    interval_s = 0.0 if math.isnan(s.baro_interval_s) else s.baro_interval_s
    by_scale_m = SCALE_TIME_S * s.average[CLIMB] * math.sqrt(s.cov[SCALE, SCALE])
    by_tilt_m2 = (
        TILT_SIGMA
        * TILT_SIGMA
        * tilt_mps2_squared(state)
        * R
        * interval_s
        / inertial_psd(state, params)
    )
    normal = innovation / math.sqrt(S + by_scale_m * by_scale_m + by_tilt_m2)
    kept = (1 << ONSET_OF) - 1
    s.onset_above = ((s.onset_above << 1) | (1 if normal > ONSET_SIGMA else 0)) & kept
    s.onset_below = ((s.onset_below << 1) | (1 if normal < -ONSET_SIGMA else 0)) & kept
    share = min(1.0, interval_s / ONSET_TIME_S)
    s.onset_mean += share * (max(-CLIPPED_SIGMA, min(CLIPPED_SIGMA, normal)) - s.onset_mean)
    if abs(normal) <= ONSET_SIGMA:
        absorb(s.x[STIFF], s.P[STIFF], s.K, innovation, S)
    if abs(s.baro_change_m) > JUMP_SIGMA * math.sqrt(2.0 * R):
        s.baro_jump_us = s.filter_us
    if s.watching == 0 or stands_alone(state):
        return False
    fails = max(bits(s.onset_above), bits(s.onset_below)) >= ONSET_FAILS
    mean_sd = math.sqrt(share / (2.0 - share))
    return fails or abs(s.onset_mean) > ONSET_MEAN_SIGMA * mean_sd > 0.0


@step
def bits(value: int) -> int:
    """How many are set."""
    count = 0
    while value > 0:
        count += value & 1
        value >>= 1
    return count


@step
def baro_comes_back(state: Rows, params: Rows, baro_m: float, white_m: float) -> bool:
    """Whether a blamed barometer has followed the bank's motion for long enough; its offset is then
    learned anew."""
    s = state[0]
    now_m = baro_m - s.path_m
    limit_m = STEADY_BARO_M + 0.5 * white_m + math.sqrt(s.cov[CLIMB, CLIMB])
    jumped = abs(now_m - s.smooth_m) > 2.0 * STEADY_BARO_M + 4.0 * white_m
    if s.steady_us < 0 or jumped or abs(s.smooth_m - s.steady_m) > limit_m:
        s.steady_us, s.steady_m, s.smooth_m = s.filter_us, now_m, now_m
        return False
    share = min(1.0, (0.0 if math.isnan(s.baro_interval_s) else s.baro_interval_s) / SMOOTHING_S)
    s.smooth_m += share * (now_m - s.smooth_m)
    if (s.filter_us - s.steady_us) * 1e-6 < SMOOTHING_S:
        s.steady_m = s.smooth_m
    if (s.filter_us - s.steady_us) * 1e-6 < STEADY_S:
        return False
    s.blamed_us[BAROMETER] = -1
    relearn_offset(state, RELEARNED_M2)
    forget_copies(state)
    return True


@step
def note_clipped(state: Rows, innovation_m: float) -> None:
    """`CLIPPED_TO_RELEARN` innovations beyond the gate on one side: the barometer has another
    offset now.

    If it came without a jump and without GNSS, it is held that the IMU has carried the height away,
    since that has no bound; the fixes that come later will tell.
    """
    s = state[0]
    side = 1 if innovation_m > 0.0 else -1
    s.baro_clipped = s.baro_clipped + side if s.baro_clipped * side > 0 else side
    if abs(s.baro_clipped) < CLIPPED_TO_RELEARN:
        return
    s.baro_clipped = 0
    if s.watching == 1 and stands_alone(state) and is_inertial(state):
        blame_imu(state)
        s.unwitnessed = 1
    else:
        relearn_offset(state, innovation_m * innovation_m)


@step
def stands_alone(state: Rows) -> bool:
    """Whether it is the barometer against the IMU: no fix of late, and no jump of the barometer."""
    s = state[0]
    return s.filter_us - s.fix_us > ALONE_US and s.filter_us - s.baro_jump_us > ALONE_US


@step
def relearn_offset(state: Rows, variance_m2: float) -> None:
    """The barometer has jumped: its offset is unknown in every channel that follows it."""
    s = state[0]
    for i in range(BANK):
        s.P[i, OFFSET, OFFSET] += variance_m2
    s.P[NO_IMU, OFFSET, OFFSET] += variance_m2
    for i in range(NO_GNSS, NO_GNSS + FREE):
        s.P[i, OFFSET, OFFSET] += variance_m2


# GNSS


@step
def watch_fix(state: Rows, failed: bool) -> bool:
    """Count fixes beyond the gate, and blame for four of five; whether this fix may be taken."""
    s = state[0]
    if s.watching == 0:
        return True
    s.failed_fixes = ((s.failed_fixes << 1) | (1 if failed else 0)) & ((1 << FIXES) - 1)
    if not failed:
        s.near_fix_m, s.silence_s, s.unwitnessed = s.innovation_m, 0.0, 0
    if bits(s.failed_fixes) < FAILED_FIXES:
        return not failed
    if s.unwitnessed == 1:
        s.failed_fixes, s.unwitnessed = 0, 0
        reopen_bank(state, s.innovation_m)
        return True
    if is_blamed(state, INERTIAL):
        return not failed
    if abs(s.excess_m) > TAKEN_BACK_M and s.excess_m * s.innovation_m < 0.0:
        s.failed_fixes, s.excess_m = 0, 0.0
        reopen(state, s.innovation_m)
        return True
    if a_witness_agrees(state, RECEIVER, s.innovation_m, STEADY_GNSS_M):
        s.failed_fixes = 0
        reopen(state, s.innovation_m)
        return True
    jumped = abs(s.innovation_m - s.near_fix_m) > STEADY_GNSS_M
    others_agree = is_blamed(state, BAROMETER) and (baro_agrees(state) or not jumped)
    if not others_agree or not is_inertial(state):
        blame(state, GNSS_HEIGHT)
        s.latched = -1 if s.silence_s > OUTAGE_S else 1 if jumped else 0
    else:
        blame_imu(state)
    return False


@step
def baro_agrees(state: Rows) -> bool:
    """Whether the barometer, blamed or not, is as far from the bank as the newest fix is. Call it
    combined."""
    s = state[0]
    expected_m = s.average[HEIGHT] + s.average[OFFSET] + s.average[FAST]
    away_m = s.baro_m + s.path_m - s.baro_path_m - expected_m
    return abs(away_m - s.innovation_m) < STEADY_GNSS_M


@step
def blame_imu(state: Rows) -> None:
    """The others contradict the IMU: the bank goes on without it, and with the barometer, unless
    that is frozen."""
    s = state[0]
    if s.baro_frozen == 0:
        s.blamed_us[BAROMETER] = -1
    blame(state, INERTIAL)
    return_to(state, NO_IMU)
    forget_copies(state)
    s.stiff_seeded = 0


@step
def rests_on_imu(state: Rows) -> bool:
    """Whether fixes have been refused for too long while no barometer height was believed either."""
    s = state[0]
    return s.refused_us >= 0 and s.filter_us - max(s.refused_us, s.baro_us) > INERTIAL_US


@step
def give_up(state: Rows, params: Rows) -> None:
    """The height is lost: start anew with all that is not a height. A frozen barometer stays
    frozen."""
    s = state[0]
    reference_m, armed, takeoff_us = s.takeoff_reference_m, s.armed, s.takeoff_us
    frozen, frozen_us = s.baro_frozen, s.blamed_us[BAROMETER]
    interval_s, value_us, repeats = s.baro_interval_s, s.baro_value_us, s.baro_repeats
    mixture_start(state, params)
    integrity_start(state, params)
    s.takeoff_reference_m, s.armed, s.takeoff_us = reference_m, armed, takeoff_us
    s.takeoff_handed_over = 1 if takeoff_us >= 0 else 0
    s.baro_interval_s, s.baro_value_us, s.baro_repeats = interval_s, value_us, repeats
    if frozen == 1:
        s.baro_frozen, s.blamed_us[BAROMETER] = frozen, frozen_us


@step
def return_to(state: Rows, i: int) -> None:
    """The bank goes back to a copy, each model with its own weather."""
    s = state[0]
    for j in range(BANK):
        duplicate(s.x[j], s.P[j], s.x[i], s.P[i])


@step
def gnss_comes_back(state: Rows, away_m: float, R: float) -> bool:
    """Whether a blamed GNSS has been near the height without it for long enough, or its jumps have
    cancelled.

    What parts slowly while GNSS is left out may be the weather under the barometer. So the jumps of
    the fixes against the bank are added up: a fault that came with one has gone when another takes
    it back. Until then it stays out as long as doubt in the height explains what the fixes have
    moved since, and the height is worth defending. After an outage it is the height that is in
    doubt, and fixes that stay for longer are believed however far they are.
    """
    s = state[0]
    note_jump(state, away_m, R)
    doubt = 2.0 + (s.filter_us - s.blamed_us[GNSS_HEIGHT]) * 1e-6 / DOUBT_TIME_S
    sd_m = math.sqrt(s.cov[HEIGHT, HEIGHT])
    as_it_came = abs(s.away_m - s.jumps_m) <= STEADY_GNSS_M + 2.0 * sd_m
    held = s.latched == 1 and as_it_came and sd_m < DEFENDED_SD_M
    limit_m = STEADY_GNSS_M if held else max(STEADY_GNSS_M, doubt * sd_m)
    far = abs(away_m) > limit_m and abs(s.jumps_m) > STEADY_GNSS_M
    steady_s = REACQUIRED_S if far else STEADY_S
    if far and s.latched >= 0:
        s.near_us = -1
        return False
    if s.near_us < 0 or abs(s.away_m - s.near_m) > FASTEST_WEATHER_MPS * STEADY_S:
        s.near_us, s.near_m = s.filter_us, s.away_m
    if (s.filter_us - s.near_us) * 1e-6 < steady_s:
        return False
    s.blamed_us[GNSS_HEIGHT] = -1
    s.failed_fixes = 0
    reopen(state, s.away_m)
    if min(abs(s.away_m), abs(s.jumps_m)) > STEADY_GNSS_M:
        s.excess_m = (
            s.away_m
        )  # either may have been wrong: the spread says so, and a jump back is believed
    return True


@step
def note_jump(state: Rows, away_m: float, R: float) -> None:
    """How far a blamed GNSS is, smoothed, and the sum of its jumps: what `JUMP_FIXES` in a row
    agree on."""
    s = state[0]
    if s.away_fixes < JUMP_FIXES:
        s.away_fixes += 1
        s.jumps_m += (away_m - s.jumps_m) / s.away_fixes
        s.away_m = s.jumps_m
        return
    change_m = away_m - s.away_m
    if abs(change_m) <= JUMP_SIGMA * math.sqrt(R):
        s.jumped_fixes, s.jump_m = 0, 0.0
        s.away_m += AWAY_WEIGHT * change_m
        return
    if change_m * s.jump_m < 0.0:
        s.jumped_fixes, s.jump_m = 0, 0.0
    s.jumped_fixes += 1
    s.jump_m += (change_m - s.jump_m) / s.jumped_fixes
    if s.jumped_fixes >= JUMP_FIXES:
        s.jumps_m += s.jump_m
        s.away_m += s.jump_m
        s.jumped_fixes, s.jump_m, s.near_us = 0, 0.0, -1


@step
def reopen(state: Rows, away_m: float) -> None:
    """The height has drifted this far, and the offset with it, since what the barometer reads stays
    explained."""
    forget_copies(state)
    for i in range(CHANNELS):
        if not follows_gnss(i):
            reopen_channel(state, i, away_m * away_m)


@step
def reopen_bank(state: Rows, away_m: float) -> None:
    """The same for everybody: it is the bank that has drifted."""
    forget_copies(state)
    for i in range(CHANNELS):
        reopen_channel(state, i, away_m * away_m)


@step
def reopen_channel(state: Rows, i: int, variance_m2: float) -> None:
    """Height and offset are in doubt together: their sum, which the barometer reads, is not."""
    s = state[0]
    s.P[i, HEIGHT, HEIGHT] += variance_m2
    if follows_baro(i):
        s.P[i, OFFSET, OFFSET] += variance_m2
        s.P[i, HEIGHT, OFFSET] -= variance_m2
        s.P[i, OFFSET, HEIGHT] -= variance_m2
        s.P[i, RATE, RATE] += s.steady[i, RATE]


@step
def separate(state: Rows, params: Rows) -> None:
    """Hold the bank against its copies without GNSS, and seed these in turns. Call it after a fix,
    combined.

    The oldest copy says how much of what has parted nobody is blamed for. A copy that has parted by
    a line, at its present slope, began to |separation| / |slope| ago: of those seeded before that,
    the youngest is the one to trust.
    """
    s = state[0]
    if s.watching == 0 or blamed_now(state) != NOBODY:
        return
    oldest, youngest_us, onset_s = oldest_copy(state), -1, math.nan
    for j in range(FREE):
        youngest_us = max(youngest_us, s.seeded_us[j])
    elapsed_s = (s.filter_us - s.separation_us) * 1e-6
    s.excess_m *= math.exp(-min(elapsed_s, INFLATED_TIME_S) / INFLATED_TIME_S)
    s.separation_us = s.filter_us
    for j in range(FREE):
        i = NO_GNSS + j
        if s.seeded_us[j] < 0 or (s.filter_us - s.seeded_us[j]) * 1e-6 < YOUNGEST_S:
            continue
        apart_m = s.average[HEIGHT] - s.x[i, HEIGHT]
        variance = max(0.0, s.P[i, HEIGHT, HEIGHT] - s.cov[HEIGHT, HEIGHT]) + PARTED_FLOOR_M2
        if math.isnan(s.separation_mean_m[j]):
            s.separation_mean_m[j] = apart_m
        s.separation_mean_m[j] += min(1.0, elapsed_s / SLOPE_TIME_S) * (
            apart_m - s.separation_mean_m[j]
        )
        slope_mps = (apart_m - s.separation_mean_m[j]) / SLOPE_TIME_S
        excess_m = abs(apart_m) - PARTED_SIGMA * math.sqrt(variance)
        if excess_m > 0.0 and abs(slope_mps) > FASTEST_WEATHER_MPS and math.isnan(onset_s):
            onset_s = abs(apart_m / slope_mps) + ONSET_DOUBT_S
        if j == oldest and excess_m > abs(s.excess_m):
            s.excess_m = math.copysign(excess_m, apart_m)
    if not math.isnan(onset_s) and not a_witness_agrees(
        state, RECEIVER, s.innovation_m, STEADY_GNSS_M
    ):
        blame(state, GNSS_HEIGHT)
        return_to(
            state, NO_GNSS + copy_from_before(state, s.filter_us - round(onset_s * 1e6), oldest)
        )
        return
    if youngest_us < 0 or (s.filter_us - youngest_us) * 1e-6 >= SEED_S:
        seed_without_gnss(state, params, oldest)


@step
def oldest_copy(state: Rows) -> int:
    """Which copy without GNSS was seeded first; one that never was, if there is one."""
    s, oldest = state[0], 0
    for j in range(1, FREE):
        if s.seeded_us[j] < s.seeded_us[oldest]:
            oldest = j
    return oldest


@step
def copy_from_before(state: Rows, onset_us: int, oldest: int) -> int:
    """The youngest copy without GNSS that was seeded before an instant; the oldest if none was."""
    s, found = state[0], oldest
    for j in range(FREE):
        if s.seeded_us[found] < s.seeded_us[j] <= onset_us:
            found = j
    return found


@step
def seed_without_gnss(state: Rows, params: Rows, j: int) -> None:
    """A copy without GNSS starts from the bank, in weather as the bank sees it."""
    s, p, i = state[0], params[0], NO_GNSS + j
    duplicate(s.x[i], s.P[i], s.average, s.cov)
    variance = 0.0
    for k in range(BANK):
        variance += s.probability[k] * p.rate_sd_mps[k] * p.rate_sd_mps[k]
    expect_weather(state, params, i, math.sqrt(variance))
    s.steady[i, GNSS_BIAS] = s.steady[0, GNSS_BIAS]
    s.seeded_us[j], s.separation_mean_m[j] = s.filter_us, math.nan


@step
def forget_copies(state: Rows) -> None:
    """The copies without GNSS were seeded from a bank that was wrong."""
    s = state[0]
    for j in range(FREE):
        s.seeded_us[j], s.separation_mean_m[j] = -1, math.nan


@step
def hand_over(state: Rows) -> None:
    """The barometer is wrong: from here the bank carries the height above take-off on."""
    s = state[0]
    if s.takeoff_us >= 0 and s.takeoff_handed_over == 0:
        combine(state)
        s.takeoff_handed_over = 1
        s.takeoff_reference_m = s.average[HEIGHT] - s.x[TAKEOFF, HEIGHT]


@step
def follows_baro(i: int) -> bool:
    """Whether a channel takes barometer heights with the bank."""
    return i not in (NO_BARO, STIFF)


@step
def follows_gnss(i: int) -> bool:
    """Whether a channel takes fixes with the bank."""
    return i < BANK or i in (NO_BARO, NO_IMU)


@step
def sees_baro(state: Rows, late_s: float) -> None:
    """The row of a barometer height."""
    s = state[0]
    sees_height(s.H, late_s)
    s.H[OFFSET] = 1.0
    s.H[FAST] = 1.0
