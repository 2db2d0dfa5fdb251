"""The vertical bank: our own estimator. A bank of vertical channels over how fast weather drifts.

`vertical_channel` is one channel, a Kalman filter of eight states. Three of them run side by side
and differ in one prior alone: how large the drift rate of the barometer's error is (calm, fair,
stormy). They interact (Blom and Bar-Shalom's interacting multiple model): weather changes its mind
once in `switching_s`; every second each channel restarts from the mixture of all, weighed by the
chance that the weather changed to it (`mix`), and measurements move the weights by their likelihood
(`weigh`). The estimate is mean and covariance of the mixture (`combine`). So a calm day has the
accuracy of a filter that trusts its barometer, and a front has one that does not.

All channels stand at one instant, ``filter_us``. Specific force is turned up by
`companion.kernels.attitude` and integrated between the measurements (`integrate`); the channels are
propagated only when a measurement comes (`advance`), which is exact, since bias and state do not
change in between. A measurement older than that instant sees the height of its own time. A stretch
without IMU samples that can be integrated counts as blind: no acceleration, much noise.

Specific force is as noisy as its changes from sample to sample show (`note_shake`), and as the
doubt in the attitude makes it when the vehicle turns (`note_tilt`).

Measurements
------------
Pressure is geometric height of the standard atmosphere, h + o + e. Its noise is no less than the median of what
consecutive heights differ by beyond the motion; beyond three sigma an innovation's variance is inflated (`inflated`),
and after fifteen such ones of one sign, or one after a silence, the offset is learned anew (`note_clipped`). The same
value again is no measurement, unless the vehicle rests.

GNSS height is h + g. Its spread is split into a slow part, which is the state g, and a white one;
both have floors, since receivers claim decimetres with metres of error. Beyond five sigma a fix is
refused. GNSS climb, where a source gives it, is taken with no less than 0.6 m/s, as its errors
last.

Only the prior of the offset (100 m, twelve hectopascals) says anything about the sea-level
pressure, unless a QNH is given (`vertical_aids`).

Breaks when
-----------
The slow GNSS error is the floor: nothing tells it from height but a barometer that is known to be stable.
"""

import math

from companion.estimators.judging import (
    AIR,
    ATTITUDE,
    GATED,
    GNSS,
    IGNORED,
    IMU,
    PRESSURE,
    RANGE,
    STATUS,
    USED,
    forget,
    judge_attitude,
    judge_gnss,
    judge_imu,
    judge_pressure,
    place,
    reset,
    state_dtype,
    tally,
)
from companion.estimators.method import Method
from companion.estimators.vertical_bank.aids import (
    QNH_PA_PER_M,
    aids_fields,
    aids_start,
    note_place,
    on_air,
    on_range,
    take_qnh,
    take_temperature,
)
from companion.estimators.vertical_bank.channel import (
    CLIMB,
    GNSS_BIAS,
    HEIGHT,
    OFFSET,
    RATE,
    SCALE,
    absorb,
    dot,
    expect_baro,
    forget_height,
    gather,
    sees_climb,
    sees_height,
)
from companion.estimators.vertical_bank.exclusion import (
    BAROMETER,
    FIX_SIGMA,
    GNSS_HEIGHT,
    INERTIAL,
    baro_after_silence,
    baro_comes_back,
    blame,
    blamed_now,
    follows_baro,
    follows_gnss,
    forgive_imu,
    give_up,
    gnss_comes_back,
    integrity_fields,
    integrity_start,
    is_blamed,
    note_clipped,
    note_interval,
    note_repeat,
    relearn_offset,
    rests,
    rests_on_imu,
    sees_baro,
    separate,
    watch_baro,
    watch_fix,
)
from companion.estimators.vertical_bank.mixture import (
    BANK,
    CHANNELS,
    advance,
    combine,
    known_displacement,
    mixture_fields,
    mixture_start,
    note_tilt,
    take_acceleration,
)
from companion.estimators.vertical_bank.protection import protection_level_m, spread_m
from companion.estimators.vertical_bank.redundancy import (
    BARO,
    FAR_SIGMA,
    RECEIVER,
    SILENT_US,
    compare_spare,
    follow_spare,
    is_settled,
    spare_fields,
    spares_start,
)
from companion.estimators.vertical_bank.reported_accuracy import (
    expect_gnss,
    slow_fix_m2,
    white_fix_m2,
)
from companion.estimators.vertical_bank.settings import VerticalBankSettings
from companion.estimators.vertical_bank.takeoff import (
    height_above_takeoff,
    note_armed,
    watch_takeoff,
)
from companion.jit import step
from companion.kernels.atmosphere import baro_altitude_m, qnh_pa
from companion.kernels.attitude import (
    ATTITUDE_STATE,
    attitude_gnss,
    attitude_imu,
    attitude_start,
    attitude_vehicle,
    imu_can_be_integrated,
    up_acceleration_mps2,
    vehicle_serves,
)
from companion.kernels.kalman import inflated
from companion.samples import Kind, Rows, Tables, readable, rows

LOWEST_PA, HIGHEST_PA = 1_000.0, 120_000.0
OUTPUT_US = 100_000
"""an estimate is no older than this while there is an IMU"""
SOFT_SIGMA = 3.0
NOISE_STEP, MEAN_WEIGHT = 0.1, 0.01
MEDIAN_TO_SD = 1.4826
LEAST_NOISE_M = 0.1
"""1.2 Pa, as good barometers have"""
FASTEST_CLIMB_MPS = 200.0
VAGUE_TILT_RAD = 0.2
"""by which gravity alone shows 0.2 m/s2 too little: as much as the prior of the accelerometer's
bias"""

STATE = state_dtype(
    ("attitude", ATTITUDE_STATE),
    *mixture_fields(),
    *integrity_fields(),
    *spare_fields(),
    *aids_fields(),
    ("baro_seen", "i8"),
    ("baro_pa", "f8"),  # newest pressure, its height, and where it was
    ("baro_m", "f8"),
    ("baro_path_m", "f8"),
    ("baro_median_m", "f8"),  # of the differences between consecutive heights beyond the motion
    ("baro_median_mean_m", "f8"),  # its mean over a hundred heights
    ("fix_seen", "i8"),
    ("gnss_slow_m2", "f8"),
    ("innovation_m", "f8"),
)


def init(params: Rows) -> Rows:
    """A fresh state: nothing known."""
    state = readable(rows(STATE))
    start(state, params)
    return state


@step
def start(state: Rows, params: Rows) -> None:
    """Forget everything but the counters."""
    s = state[0]
    reset(state)
    attitude_start(state[0].attitude)
    mixture_start(state, params)
    integrity_start(state, params)
    spares_start(state)
    aids_start(state)
    forget_readings(state)
    s.baro_pa = math.nan
    s.baro_median_m = s.baro_median_mean_m = params[0].baro_sd_m


@step
def forget_readings(state: Rows) -> None:
    """No barometer height and no fix yet."""
    s = state[0]
    s.baro_seen, s.baro_m, s.baro_path_m = 0, math.nan, 0.0
    s.fix_seen, s.gnss_slow_m2, s.innovation_m = 0, 0.0, math.nan


@step
def start_over(state: Rows, params: Rows) -> None:
    """Nothing supports the height any more: forget it, and the attitude that may have carried it
    away."""
    s = state[0]
    give_up(state, params)
    attitude_start(state[0].attitude)
    forget_readings(state)
    if s.baro_frozen == 0:
        s.baro_pa = math.nan


@step
def on_imu(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """Attitude, upward acceleration, and its integral; between measurements the estimate goes on
    ten times a second."""
    s = state[0]
    if sample[0].instance != 0:
        return tally(state, IMU, IGNORED)
    verdict = judge_imu(state, sample)
    if verdict != USED:
        return tally(state, IMU, verdict)
    time_us = sample[0].time_us
    place(state, IMU, 0, time_us)
    attitude_imu(state[0].attitude, sample)
    up_mps2 = (
        upward_mps2(state, params, sample) if imu_can_be_integrated(state[0].attitude) else math.nan
    )
    if math.isnan(up_mps2):
        verdict = IGNORED
    elif is_blamed(state, INERTIAL):
        verdict, up_mps2 = GATED, math.nan
    note_tilt(state, sample)
    take_acceleration(state, params, time_us, up_mps2)
    if s.filter_us >= 0 and time_us - s.filter_us >= OUTPUT_US:
        advance(state, params, time_us)
        write_estimate(state, params, estimate)
    return tally(state, IMU, verdict)


@step
def upward_mps2(state: Rows, params: Rows, sample: Rows) -> float:
    """Upward acceleration by our own attitude, or the vehicle's if the settings say so; NaN while
    that is vague."""
    s, force = state[0], sample[0].specific_force_b_mps2
    if params[0].vehicle_attitude == 1 and vehicle_serves(state[0].attitude):
        return up_acceleration_mps2(state[0].attitude, sample)
    if not s.attitude.own.tilt_var < VAGUE_TILT_RAD * VAGUE_TILT_RAD:
        return math.nan
    up = s.attitude.own.up_b
    return force[0] * up[0] + force[1] * up[1] + force[2] * up[2] - s.attitude.own.gravity_mps2


@step
def on_attitude(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """The autopilot's attitude, a second source beside our own."""
    if sample[0].instance != 0:
        return tally(state, ATTITUDE, IGNORED)
    verdict = judge_attitude(state, sample)
    if verdict == USED:
        place(state, ATTITUDE, 0, sample[0].time_us)
        attitude_vehicle(state[0].attitude, sample)
    return tally(state, ATTITUDE, verdict)


@step
def on_pressure(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A barometer height: is it new, what noise does it show, is it to be believed; then every
    channel takes it."""
    s = state[0]
    verdict = judge_pressure(state, sample, LOWEST_PA, HIGHEST_PA)
    if verdict != USED:
        return tally(state, PRESSURE, verdict)
    if sample[0].instance != 0:
        return tally(state, PRESSURE, on_spare_baro(state, params, sample, estimate))
    time_us = sample[0].time_us
    returns = s.baro_seen == 1 and time_us - s.last_us[PRESSURE, 0] > SILENT_US
    place(state, PRESSURE, 0, time_us)
    advance(state, params, max(time_us, s.filter_us))
    forgive_imu(state)
    sees_baro(state, (s.filter_us - time_us) * 1e-6)
    if sample[0].pressure_pa == s.baro_pa and not returns:
        note_repeat(state, time_us, s.path_m - s.baro_path_m)
        combine(state)
        if is_blamed(state, BAROMETER):
            verdict = GATED
        elif rests(state, time_us, s.path_m - s.baro_path_m):
            take_baro(state, s.baro_m, baro_noise_m(state, params) ** 2)
        write_estimate(state, params, estimate)
        return tally(state, PRESSURE, verdict)
    baro_m = baro_altitude_m(sample[0].pressure_pa)
    white_m = baro_white_m(state, params, baro_m)
    note_interval(state, time_us)
    s.baro_m, s.baro_pa, s.baro_path_m = baro_m, sample[0].pressure_pa, s.path_m
    if s.baro_seen == 0:
        s.baro_seen = 1
        combine(state)
        expect_atmosphere(state, params, s.average[HEIGHT] if s.fix_seen == 1 else baro_m)
    if returns and not is_blamed(state, BAROMETER):
        baro_after_silence(state, baro_m, white_m * white_m)
        sees_baro(state, (s.filter_us - time_us) * 1e-6)
    if is_blamed(state, BAROMETER):
        if not baro_comes_back(state, params, baro_m, white_m):
            verdict = GATED
    elif watch_baro(state, params, baro_m, shown_noise_m(state) ** 2):
        blame(state, BAROMETER)
        verdict = GATED
    if verdict == USED:
        take_baro(state, baro_m, white_m * white_m)
    write_estimate(state, params, estimate)
    return tally(state, PRESSURE, verdict)


@step
def expect_atmosphere(state: Rows, params: Rows, height_m: float) -> None:
    """Prior of the barometer's error at a height, the true one if there is one: on a day 8 % too
    warm, the barometer's own reading in its place makes the scale learned from the first innovation
    8 % too small."""
    s, p = state[0], params[0]
    for i in range(CHANNELS):
        if follows_baro(i):
            expect_baro(
                s.x[i],
                s.P[i],
                height_m,
                p.offset_sd_m * p.offset_sd_m,
                p.scale_sd_ratio * p.scale_sd_ratio,
            )
    take_qnh(state, params, height_m)
    take_temperature(state, params)


@step
def on_spare_baro(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A second barometer: it follows the first, and stands in for it."""
    s, instance, time_us = state[0], sample[0].instance, sample[0].time_us
    place(state, PRESSURE, instance, time_us)
    if s.baro_seen == 0:
        return IGNORED
    advance(state, params, max(time_us, s.filter_us))
    combine(state)
    sees_baro(state, (s.filter_us - time_us) * 1e-6)
    baro_m = baro_altitude_m(sample[0].pressure_pa)
    R = params[0].baro_sd_m * params[0].baro_sd_m
    away_m = compare_spare(state, BARO, instance, baro_m - dot(s.H, s.average))
    if abs(away_m) > FAR_SIGMA * math.sqrt(gather(s.cov, s.H, s.K) + R):
        return GATED
    if is_blamed(state, BAROMETER) or s.filter_us - s.last_us[PRESSURE, 0] > SILENT_US:
        if not is_settled(state, BARO, instance):
            return GATED
        s.spare_us[BARO, instance] = time_us
        take_baro(state, baro_m - s.spare_offset_m[BARO, instance], R)
        write_estimate(state, params, estimate)
    else:
        follow_spare(state, BARO, instance, time_us)
    return USED


@step
def baro_white_m(state: Rows, params: Rows, baro_m: float) -> float:
    """White noise of the barometer height: no less than the stream shows.

    The median of |change beyond the motion| is followed by a step up or down with every value: an
    outlier counts no more than any other.
    """
    s = state[0]
    if not math.isnan(s.baro_m):
        change_m = baro_m - s.baro_m - (s.path_m - s.baro_path_m)
        s.baro_change_m = change_m
        s.baro_median_m *= (
            1.0 + NOISE_STEP if abs(change_m) > s.baro_median_m else 1.0 / (1.0 + NOISE_STEP)
        )
        s.baro_median_mean_m += MEAN_WEIGHT * (s.baro_median_m - s.baro_median_mean_m)
    return baro_noise_m(state, params)


@step
def baro_noise_m(state: Rows, params: Rows) -> float:
    """The same, as it is known so far."""
    return max(params[0].baro_sd_m, MEDIAN_TO_SD / math.sqrt(2.0) * state[0].baro_median_m)


@step
def shown_noise_m(state: Rows) -> float:
    """What the stream shows, without wander that a look at consecutive heights misses: for faults
    of seconds.

    A median that is followed in steps is often too small; its mean is not.
    """
    s = state[0]
    return max(
        LEAST_NOISE_M, MEDIAN_TO_SD / math.sqrt(2.0) * max(s.baro_median_m, s.baro_median_mean_m)
    )


@step
def take_baro(state: Rows, baro_m: float, R: float) -> None:
    """Correct every channel that follows the barometer; the bank's weights move with the
    likelihood."""
    s = state[0]
    s.baro_us = s.filter_us
    combine(state)
    innovation = baro_m - dot(s.H, s.average)
    if innovation * innovation <= SOFT_SIGMA * SOFT_SIGMA * (gather(s.cov, s.H, s.K) + R):
        s.baro_clipped = 0
    else:
        note_clipped(state, innovation)
    for i in range(CHANNELS):
        if not follows_baro(i):
            continue
        innovation = baro_m - dot(s.H, s.x[i])
        known = gather(s.P[i], s.H, s.K)
        S = known + inflated(innovation, known + R, R, SOFT_SIGMA)
        absorb(s.x[i], s.P[i], s.K, innovation, S)
        if i < BANK:
            s.evidence[i] -= 0.5 * (math.log(S) + innovation * innovation / S)


@step
def on_gnss(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A fix, which is late: it meets the height of its own time."""
    s, instance, time_us = state[0], sample[0].instance, sample[0].time_us
    verdict = judge_gnss(state, sample)
    if verdict != USED:
        return tally(state, GNSS, verdict)
    if instance == 0 and time_us - s.last_us[GNSS, 0] > SILENT_US:
        s.near_fix_m, s.latched, s.refused_us = math.nan, 0, -1
        s.silence_s = (time_us - s.last_us[GNSS, 0]) * 1e-6
    place(state, GNSS, instance, time_us)
    silent = time_us - s.last_us[GNSS, 0] > SILENT_US
    note_place(state, sample[0].latitude_deg, sample[0].longitude_deg)
    if instance == 0 or silent:
        attitude_gnss(state[0].attitude, sample)
    advance(state, params, max(time_us, s.filter_us))
    forgive_imu(state)
    late_s = (s.filter_us - time_us) * 1e-6
    fix_m = sample[0].altitude_amsl_m - known_displacement(state, time_us)
    sees_height(s.H, late_s)
    s.H[GNSS_BIAS] = 1.0
    combine(state)
    if instance != 0:
        return tally(state, GNSS, on_spare_fix(state, params, sample, estimate, fix_m, silent))
    s.innovation_m = fix_m - dot(s.H, s.average)
    R, slow_m2 = white_fix_m2(params, sample), slow_fix_m2(params, sample)
    admitted_m2 = max(0.0, slow_m2 - s.gnss_slow_m2)
    S = R + admitted_m2 + gather(s.cov, s.H, s.K)
    far = s.innovation_m * s.innovation_m > FIX_SIGMA * FIX_SIGMA * S
    if is_blamed(state, GNSS_HEIGHT):
        if not gnss_comes_back(state, s.innovation_m, R):
            verdict = GATED
    elif s.fix_seen == 0:
        if s.baro_seen == 1:
            meet_gnss(state, params, fix_m, far)
    elif not watch_fix(state, far):
        verdict = GATED
    if verdict == USED:
        expect_gnss(state, params, slow_m2)
        s.fix_seen, s.fix_us, s.refused_us = 1, s.filter_us, -1
        take_fix(state, fix_m, R)
        take_climb(state, params, sample[0].climb_mps, late_s)
    elif s.refused_us < 0:
        s.refused_us = s.filter_us
    if rests_on_imu(state):
        start_over(state, params)
        forget(estimate)
        return tally(state, GNSS, verdict)
    combine(state)
    separate(state, params)
    write_estimate(state, params, estimate)
    return tally(state, GNSS, verdict)


@step
def meet_gnss(state: Rows, params: Rows, fix_m: float, far: bool) -> None:
    """The first fix: until now the height rested on the prior of the offset, which would count
    twice."""
    s = state[0]
    for i in range(CHANNELS):
        if follows_baro(i):
            forget_height(s.P[i])
    if far:
        s.known_qnh_pa = math.nan  # of another place, or a slip of the pen
    expect_atmosphere(state, params, fix_m)
    if far:
        relearn_offset(
            state, s.innovation_m * s.innovation_m
        )  # the barometer's datum is further off than its prior


@step
def on_spare_fix(
    state: Rows, params: Rows, sample: Rows, estimate: Rows, fix_m: float, silent: bool
) -> int:
    """A second receiver: it follows the first, stands in for it, and is its witness."""
    s, instance = state[0], sample[0].instance
    if s.fix_seen == 0:
        return IGNORED
    away_m = compare_spare(state, RECEIVER, instance, fix_m - dot(s.H, s.average))
    stands_in = silent or is_blamed(state, GNSS_HEIGHT)
    R = white_fix_m2(params, sample)
    if abs(away_m) > FAR_SIGMA * math.sqrt(gather(s.cov, s.H, s.K) + R):
        return GATED
    if not stands_in:
        follow_spare(state, RECEIVER, instance, sample[0].time_us)
        return USED
    if not is_settled(state, RECEIVER, instance):
        return GATED
    expect_gnss(state, params, slow_fix_m2(params, sample))
    s.spare_us[RECEIVER, instance], s.fix_us = sample[0].time_us, s.filter_us
    take_fix(state, fix_m - s.spare_offset_m[RECEIVER, instance], R)
    write_estimate(state, params, estimate)
    return USED


@step
def take_fix(state: Rows, fix_m: float, R: float) -> None:
    """Correct every channel that follows GNSS; the bank's weights move with the likelihood."""
    s = state[0]
    for i in range(CHANNELS):
        if follows_gnss(i):
            innovation = fix_m - dot(s.H, s.x[i])
            S = R + gather(s.P[i], s.H, s.K)
            absorb(s.x[i], s.P[i], s.K, innovation, S)
            if i < BANK:
                s.evidence[i] -= 0.5 * (math.log(S) + innovation * innovation / S)


@step
def take_climb(state: Rows, params: Rows, climb_mps: float, late_s: float) -> None:
    """The same with a GNSS climb, where there is one; what the climb gained since is integrated."""
    s, p = state[0], params[0]
    if not -FASTEST_CLIMB_MPS < climb_mps < FASTEST_CLIMB_MPS:
        return
    gained_mps = 0.0 if math.isnan(s.up_mps2) else s.up_mps2 * late_s
    R = p.gnss_climb_sd_mps * p.gnss_climb_sd_mps
    sees_climb(s.H, late_s)
    for i in range(CHANNELS):
        if follows_gnss(i):
            innovation = climb_mps + gained_mps - dot(s.H, s.x[i])
            known = gather(s.P[i], s.H, s.K)
            S = known + inflated(innovation, known + R, R, SOFT_SIGMA)
            absorb(s.x[i], s.P[i], s.K, innovation, S)
            if i < BANK:
                s.evidence[i] -= 0.5 * (math.log(S) + innovation * innovation / S)


@step
def on_status(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A reboot restarts the vehicle's clock: start anew."""
    if sample[0].reboot == 1:
        start(state, params)
        forget(estimate)
    note_armed(state, sample[0].armed)
    return tally(state, STATUS, USED)


@step
def write_estimate(state: Rows, params: Rows, estimate: Rows) -> None:
    """What the bank says, and what the copies say of it; nothing while nobody has told a height."""
    s, e = state[0], estimate[0]
    if s.baro_seen == 0 and s.fix_seen == 0:
        return
    combine(state)
    watch_takeoff(state)
    e.time_us = s.filter_us
    e.altitude_amsl_m = s.average[HEIGHT]
    e.climb_mps = s.average[CLIMB]
    e.altitude_sd_m = spread_m(state)
    e.climb_sd_mps = math.sqrt(s.cov[CLIMB, CLIMB])
    e.baro_offset_m = -s.average[OFFSET]
    e.baro_rate_mps = s.average[RATE]
    e.baro_scale = s.average[SCALE]
    e.gnss_offset_m = s.average[GNSS_BIAS]
    e.innovation_m = s.innovation_m
    e.height_above_takeoff_m = height_above_takeoff(state)
    e.protection_level_m = protection_level_m(state, params)
    if s.baro_seen == 1 and not is_blamed(state, BAROMETER):
        e.qnh_pa = qnh_pa(s.baro_pa, s.average[HEIGHT])
        e.qnh_sd_pa = QNH_PA_PER_M * e.altitude_sd_m
    else:
        e.qnh_pa, e.qnh_sd_pa = math.nan, math.nan
    for i in range(BANK):
        e.drift_probabilities[i] = s.probability[i]
    e.faulty = blamed_now(state)
    e.faulty_since_us = s.blamed_us[e.faulty] if e.faulty > 0 else 0


@step
def run(state: Rows, params: Rows, tables: Tables, estimates: Rows, verdicts: Rows) -> None:
    """The steps over a whole log, in order of arrival."""
    estimate = estimates[:0]
    for i in range(tables.order.size):
        kind, row = tables.order[i].kind, tables.order[i].row
        if i > 0:
            estimates[i] = estimates[i - 1]
        estimate = estimates[i : i + 1]
        if kind == IMU:
            verdicts[i] = on_imu(state, params, tables.imu[row : row + 1], estimate)
        elif kind == PRESSURE:
            verdicts[i] = on_pressure(state, params, tables.pressure[row : row + 1], estimate)
        elif kind == GNSS:
            verdicts[i] = on_gnss(state, params, tables.gnss[row : row + 1], estimate)
        elif kind == ATTITUDE:
            verdicts[i] = on_attitude(state, params, tables.attitude[row : row + 1], estimate)
        elif kind == RANGE:
            verdicts[i] = on_range(state, params, tables.range[row : row + 1], estimate)
        elif kind == AIR:
            verdicts[i] = on_air(state, params, tables.air[row : row + 1], estimate)
        elif kind == STATUS:
            verdicts[i] = on_status(state, params, tables.status[row : row + 1], estimate)


METHOD = Method(
    name="vertical-bank",
    summary="bank of eight-state vertical channels over weather drift rates, with integrity monitoring",
    citation="Kollsman",
    settings=VerticalBankSettings,
    state=STATE,
    init=init,
    steps={
        Kind.IMU: on_imu,
        Kind.PRESSURE: on_pressure,
        Kind.GNSS: on_gnss,
        Kind.ATTITUDE: on_attitude,
        Kind.RANGE: on_range,
        Kind.AIR: on_air,
        Kind.STATUS: on_status,
    },
    run=run,
    datum_invariant=False,
    follows_baro_step=True,
)
