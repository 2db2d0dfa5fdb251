"""The vertical bank, our own estimator: a pruned Gaussian mixture of vertical channels over few
hypotheses about the weather and about faults of sensors.

`channel` is one Kalman filter of thirteen states. `hypotheses` says which of them run side by side:
calm, fair and stormy weather; a wrong receiver, a wrong barometer, a wrong IMU, and what follows.
Measurements move their probabilities (`mixture`); the estimate is the mean of the mixture, the
protection level its tail (`protection`), and a sensor is excluded while the hypotheses that it is
wrong are probable (`attribution`). Where the evidence does not decide, the spread grows by itself.

Each fix and each barometer height goes the same way: place it in time, predict, suppose the faults
that would explain a surprise, fuse, let hypotheses change into each other, publish. All channels
stand at one instant; a measurement older than that meets the height of its own time.

Only the prior of the offset (100 m, twelve hectopascals) says anything about the sea-level
pressure, unless a QNH is given (`aids`).
"""

import math

from companion.estimators.judging import (
    AIR,
    AIRSPEED,
    ATTITUDE,
    GATED,
    GNSS,
    HIGHEST_AIR_K,
    IGNORED,
    IMU,
    INVALID,
    LOWEST_AIR_K,
    PRESSURE,
    RANGE,
    STALE,
    STATUS,
    USED,
    forget,
    is_stale,
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
    AIDS,
    FRESH_US,
    FURTHEST_RANGE_M,
    HIGHEST_FIELD_M,
    HIGHEST_QNH_PA,
    LOWEST_FIELD_M,
    LOWEST_QNH_PA,
    QNH_PA_PER_M,
    STEEPEST_COS,
    aids_start,
    fuse_field,
    fuse_qnh,
    fuse_range,
    fuse_temperature,
    note_place,
    note_range,
    note_takeoff,
)
from companion.estimators.vertical_bank.attribution import (
    ATTRIBUTION,
    BAROMETER,
    GNSS_HEIGHT,
    INERTIAL,
    attribute,
    attribution_start,
    fault_probability,
    is_named,
    named_fault,
)
from companion.estimators.vertical_bank.baro_terms.lag import lag_climb_mps, slope_mps
from companion.estimators.vertical_bank.baro_terms.static_port import unseen_head_m2
from companion.estimators.vertical_bank.baro_terms.timing import timing_m2
from companion.estimators.vertical_bank.barometer import (
    BAROMETER_RECORD,
    MOVED_M,
    barometer_start,
    noise_m2,
    note_height,
    note_repeat,
    note_speed,
    rests,
    sees_barometer,
    unseen_speed_mps,
)
from companion.estimators.vertical_bank.beginning import (
    bank_start,
    expect_atmosphere,
    forget_height,
    resume,
)
from companion.estimators.vertical_bank.channel import (
    CLIMB,
    GNSS_BIAS,
    HEIGHT,
    OFFSET,
    PORT,
    RATE,
    SCALE,
    sees_climb,
    sees_height,
)
from companion.estimators.vertical_bank.hypotheses import (
    SURPRISE_SIGMA,
    doubt_repeat,
    on_baro_surprise,
    on_gnss_surprise,
    search,
    suppose_after_outage,
    switch,
)
from companion.estimators.vertical_bank.inertial import (
    INERTIAL as INERTIAL_RECORD,
)
from companion.estimators.vertical_bank.inertial import (
    VAGUE_TILT_RAD,
    inertial_start,
    is_inertial,
    known_displacement,
    note_tilt,
    take_acceleration,
)
from companion.estimators.vertical_bank.mixture import (
    BANK,
    N,
    advance,
    climb_the_column,
    expected,
    expected_variance,
    fuse,
    mean,
    surprises,
    variance,
)
from companion.estimators.vertical_bank.protection import protection_level_m
from companion.estimators.vertical_bank.redundancy import (
    BAROMETERS,
    FAR_SIGMA,
    NOT_IN_USE,
    RECEIVERS,
    SPARES,
    TAKES_OVER,
    choose,
    follow,
    is_settled,
    offset_m,
    spares_start,
)
from companion.estimators.vertical_bank.reported_accuracy import (
    RECEIVER,
    expect_gnss,
    note_fix,
    receiver_start,
    slow_m2,
    stamp_ratio,
    white_m2,
)
from companion.estimators.vertical_bank.settings import VerticalBankSettings
from companion.estimators.vertical_bank.takeoff import (
    TAKEOFF_RECORD,
    height_above_takeoff_m,
    note_armed,
    takeoff_start,
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
from companion.samples import Kind, Rows, Tables, readable, rows

LOWEST_PA, HIGHEST_PA = 1_000.0, 120_000.0
OUTPUT_US = 100_000
"""An estimate is no older than this while there is an IMU."""
FASTEST_CLIMB_MPS = 200.0
OUTAGE_S = 5.0
"""A barometer that went wrong in an outage of GNSS as long as this was not seen to do so."""
SILENT_US = 2_000_000
DATUM_SIGMA = 5.0
"""A barometer that is further off after a silence has another datum."""
BARO_INTERVAL_S, FIX_INTERVAL_S = 0.1, 0.2
"""Measurements that come faster share the evidence of this time."""
REST_SPEED_MPS = 1.5
FASTEST_AIRSPEED_MPS = 400.0
LONG_SILENCE_US = 60_000_000
"""After so long without any height, what moved is unknown."""

STATE = state_dtype(
    ("attitude", ATTITUDE_STATE),
    ("imu", INERTIAL_RECORD),
    ("bank", BANK),
    ("named", ATTRIBUTION),
    ("baro", BAROMETER_RECORD),
    ("gnss", RECEIVER),
    ("spares", SPARES),
    ("takeoff", TAKEOFF_RECORD),
    ("aids", AIDS),
)


def init(params: Rows) -> Rows:
    """A fresh state: nothing known."""
    state = readable(rows(STATE))
    start(state, params)
    return state


@step
def start(state: Rows, params: Rows) -> None:
    """Forget everything but the counters."""
    s, p = state[0], params[0]
    reset(state)
    attitude_start(s.attitude)
    inertial_start(s.imu)
    bank_start(s.bank, p)
    attribution_start(s.named)
    barometer_start(s.baro, p)
    receiver_start(s.gnss)
    spares_start(s.spares)
    takeoff_start(s.takeoff)
    aids_start(s.aids)


# Inertial sensors


@step
def on_imu(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """Attitude, upward acceleration, and its integral; between measurements the estimate goes on
    ten times a second."""
    s, p = state[0], params[0]
    if sample[0].instance != 0:
        return tally(state, IMU, IGNORED)
    verdict = judge_imu(state, sample)
    if verdict != USED:
        return tally(state, IMU, verdict)
    time_us = sample[0].time_us
    place(state, IMU, 0, time_us)
    attitude_imu(s.attitude, sample)
    up_mps2 = upward_mps2(state, params, sample) if imu_can_be_integrated(s.attitude) else math.nan
    note_tilt(s.imu, s.attitude, sample)
    take_acceleration(s.imu, p, s.attitude.interval_s, time_us, up_mps2)
    if s.bank.now_us >= 0 and time_us - s.bank.now_us >= OUTPUT_US:
        advance(s.bank, s.imu, p, s.attitude.interval_s, time_us)
        publish(state, params, estimate)
    if math.isnan(up_mps2):
        return tally(state, IMU, IGNORED)
    return tally(state, IMU, GATED if is_named(s.named, INERTIAL) else USED)


@step
def upward_mps2(state: Rows, params: Rows, sample: Rows) -> float:
    """Upward acceleration by our own attitude, or the vehicle's if the settings say so; NaN while
    that is vague."""
    s, force = state[0], sample[0].specific_force_b_mps2
    if params[0].vehicle_attitude == 1 and vehicle_serves(s.attitude):
        return up_acceleration_mps2(s.attitude, sample)
    if not s.attitude.own.tilt_var < VAGUE_TILT_RAD * VAGUE_TILT_RAD:
        return math.nan
    up = s.attitude.own.up_b
    return force[0] * up[0] + force[1] * up[1] + force[2] * up[2] - s.attitude.own.gravity_mps2


@step
def on_attitude(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """The autopilot's attitude, a second source beside our own."""
    s = state[0]
    if sample[0].instance != 0:
        return tally(state, ATTITUDE, IGNORED)
    verdict = judge_attitude(state, sample)
    if verdict == USED:
        place(state, ATTITUDE, 0, sample[0].time_us)
        attitude_vehicle(s.attitude, sample)
    return tally(state, ATTITUDE, verdict)


@step
def on_airspeed(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """Airspeed, the regressor of the static port and of lift-off."""
    if sample[0].instance != 0:
        return tally(state, AIRSPEED, IGNORED)
    if not 0.0 <= sample[0].airspeed_mps <= FASTEST_AIRSPEED_MPS:
        return tally(state, AIRSPEED, INVALID)
    if is_stale(state, AIRSPEED, 0, sample[0].time_us):
        return tally(state, AIRSPEED, STALE)
    place(state, AIRSPEED, 0, sample[0].time_us)
    note_speed(state[0].baro, params[0], sample[0].time_us, sample[0].airspeed_mps, 1)
    return tally(state, AIRSPEED, USED)


# The barometer


@step
def on_pressure(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A barometer height: place, predict, suppose, fuse, let hypotheses change, publish."""
    s, p, instance, time_us = state[0], params[0], sample[0].instance, sample[0].time_us
    verdict = judge_pressure(state, sample, LOWEST_PA, HIGHEST_PA)
    if verdict != USED:
        return tally(state, PRESSURE, verdict)
    role = choose(s.spares, BAROMETERS, instance, time_us)
    silent_us = time_us - s.baro.heard_us
    place(state, PRESSURE, instance, time_us)
    predict(state, params, time_us)
    late_s = (s.bank.now_us - time_us) * 1e-6
    read_m = baro_altitude_m(sample[0].pressure_pa)
    if role == NOT_IN_USE:
        if s.baro.seen == 1:
            sees_barometer(s.bank.H, s.baro, lag_climb_mps(s.bank.slope_mps), late_s)
            innovation_m = read_m - expected(s.bank, s.bank.H)
            follow(s.spares, BAROMETERS, instance, time_us, innovation_m)
        return tally(state, PRESSURE, IGNORED)
    if role == TAKES_OVER:
        s.baro.pressure_pa = math.nan
    height_m = read_m - offset_m(s.spares, BAROMETERS, instance)
    s.baro.heard_us = time_us
    is_repeat = sample[0].pressure_pa == s.baro.pressure_pa and silent_us <= SILENT_US
    note_repeat(s.baro, is_repeat, mean(s.bank, CLIMB))
    if is_repeat:
        hear_repeat(state, params, time_us)
    else:
        hear_height(state, params, time_us, sample[0].pressure_pa, height_m, silent_us)
    if not is_repeat or rests(s.baro, time_us, s.bank.path_m, mean(s.bank, CLIMB)):
        R = noise_m2(s.baro, p) + timing_m2(p.timing_sd_s, s.bank.climb_mps, silent_us * 1e-6)
        sees_barometer(s.bank.H, s.baro, lag_climb_mps(s.bank.slope_mps), late_s)
        watched = p.integrity == 1 and s.gnss.seen == 1
        if watched and surprises(s.bank, s.baro.height_m, R, SURPRISE_SIGMA):
            on_baro_surprise(s.bank, p, is_blind(state), silent_us * 1e-6)
        share = min(1.0, silent_us * 1e-6 / BARO_INTERVAL_S)
        fuse(s.bank, s.baro.height_m, R, p.temper * share, 1)
    conclude(state, params, estimate)
    return tally(state, PRESSURE, GATED if is_named(s.named, BAROMETER) else USED)


@step
def hear_height(
    state: Rows, params: Rows, time_us: int, pressure_pa: float, height_m: float, silent_us: int
) -> None:
    """A new value of the barometer in use: its stream, its prior if it is the first, its datum if
    it was silent."""
    s, p = state[0], params[0]
    first = s.baro.seen == 0
    if not first:
        s.bank.slope_mps = slope_mps(s.baro.smooth_m, s.baro.height_m)
    note_height(s.baro, time_us, pressure_pa, height_m, s.bank.path_m)
    if first:
        s.baro.seen = 1
        known = s.gnss.seen == 1
        expect_atmosphere(s.bank, p, mean(s.bank, HEIGHT) if known else height_m)
        fuse_qnh(s.aids, s.bank, p, mean(s.bank, HEIGHT) if known else height_m)
        fuse_temperature(s.aids, s.bank, p, pressure_pa)
    elif silent_us > SILENT_US:
        sees_barometer(
            s.bank.H, s.baro, lag_climb_mps(s.bank.slope_mps), (s.bank.now_us - time_us) * 1e-6
        )
        innovation_m = height_m - expected(s.bank, s.bank.H)
        S = noise_m2(s.baro, p) + expected_variance(s.bank, s.bank.H)
        if innovation_m * innovation_m > DATUM_SIGMA * DATUM_SIGMA * S:
            for i in range(N):
                s.bank.P[i, OFFSET, OFFSET] += innovation_m * innovation_m


@step
def hear_repeat(state: Rows, params: Rows, time_us: int) -> None:
    """The same value again: the more improbable, the more the vehicle has moved since."""
    s, p = state[0], params[0]
    if p.integrity == 0 or abs(s.bank.path_m - s.baro.path_m) <= MOVED_M:
        return
    on_baro_surprise(s.bank, p, True, BARO_INTERVAL_S)
    doubt_repeat(s.bank, s.baro.repeat_probability)
    if fault_probability(s.bank, BAROMETER) > p.attribution_probability:
        s.baro.stuck = 1


# The receiver


@step
def on_gnss(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A fix, which is late and meets the height of its own time: place, predict, suppose, fuse, let
    hypotheses change, publish."""
    s, p, instance, time_us = state[0], params[0], sample[0].instance, sample[0].time_us
    verdict = judge_gnss(state, sample)
    if verdict != USED:
        return tally(state, GNSS, verdict)
    role = choose(s.spares, RECEIVERS, instance, time_us)
    place(state, GNSS, instance, time_us)
    note_place(s.aids, sample[0].latitude_deg, sample[0].longitude_deg)
    if role != NOT_IN_USE:
        attitude_gnss(s.attitude, sample)
        note_speed(s.baro, p, time_us, sample[0].ground_speed_mps, 0)
    predict(state, params, time_us)
    late_s = (s.bank.now_us - time_us) * 1e-6
    fix_m = sample[0].altitude_amsl_m - known_displacement(s.imu, s.bank.now_us, time_us)
    sees_height(s.bank.H, late_s)
    if role == NOT_IN_USE:
        return tally(state, GNSS, on_spare_fix(state, params, sample, estimate, fix_m))
    fix_m -= offset_m(s.spares, RECEIVERS, instance)
    s.bank.H[GNSS_BIAS] = 1.0
    elapsed_s = (s.bank.now_us - s.gnss.used_us) * 1e-6 if s.gnss.seen == 1 else FIX_INTERVAL_S
    note_fix(s.gnss, p, sample, s.bank.path_m)
    white = white_m2(s.gnss, p, sample)
    expect_gnss(s.bank, p, slow_m2(p, sample, white), elapsed_s)
    if s.gnss.seen == 0:
        meet_gnss(state, params, fix_m)
    stamp_s = p.timing_sd_s * stamp_ratio(sample[0].fix_type)
    R = white + timing_m2(stamp_s, s.bank.climb_mps, elapsed_s)
    s.gnss.innovation_m = fix_m - expected(s.bank, s.bank.H)
    if p.integrity == 1 and s.gnss.seen == 1 and s.baro.seen == 1:
        if elapsed_s > OUTAGE_S:
            blind = is_blind(state)
            suppose_after_outage(s.bank, p, p.outage_fault_probabilities[0 if blind else 1])
        if surprises(s.bank, fix_m, R, SURPRISE_SIGMA):
            on_gnss_surprise(s.bank, p, is_blind(state), elapsed_s)
    s.gnss.seen, s.gnss.used_us = 1, s.bank.now_us
    fuse(s.bank, fix_m, R, p.temper * min(1.0, elapsed_s / FIX_INTERVAL_S), 0)
    fuse_climb(state, params, sample[0].climb_mps, late_s)
    conclude(state, params, estimate)
    return tally(state, GNSS, GATED if is_named(s.named, GNSS_HEIGHT) else USED)


@step
def meet_gnss(state: Rows, params: Rows, fix_m: float) -> None:
    """The first fix: until now the height rested on the prior of the offset, which would count
    twice."""
    s, p = state[0], params[0]
    far = False
    if s.baro.seen == 1:
        innovation_m = fix_m - expected(s.bank, s.bank.H)
        S = expected_variance(s.bank, s.bank.H)
        far = innovation_m * innovation_m > DATUM_SIGMA * DATUM_SIGMA * S
    forget_height(s.bank)
    if s.baro.seen == 0:
        return
    if far:
        s.aids.known_qnh_pa = math.nan  # of another place, or a slip of the pen
    expect_atmosphere(s.bank, p, fix_m)
    if far:  # the barometer's datum is further off than its prior
        for i in range(N):
            s.bank.P[i, OFFSET, OFFSET] += (s.baro.height_m - fix_m) ** 2
    fuse_qnh(s.aids, s.bank, p, fix_m)
    fuse_temperature(s.aids, s.bank, p, s.baro.pressure_pa)


@step
def fuse_climb(state: Rows, params: Rows, climb_mps: float, late_s: float) -> None:
    """A GNSS climb, where there is one; what the climb gained since is integrated. It does not move
    probabilities, and is not used while the receiver may be wrong."""
    s, p = state[0], params[0]
    if not -FASTEST_CLIMB_MPS < climb_mps < FASTEST_CLIMB_MPS:
        return
    if fault_probability(s.bank, GNSS_HEIGHT) > 1.0 - p.attribution_probability:
        return
    gained_mps = s.imu.up_mps2 * late_s if is_inertial(s.imu, s.bank.now_us) else 0.0
    sees_climb(s.bank.H, late_s)
    fuse(s.bank, climb_mps + gained_mps, p.gnss_climb_sd_mps * p.gnss_climb_sd_mps, 0.0, 1)


@step
def on_spare_fix(state: Rows, params: Rows, sample: Rows, estimate: Rows, fix_m: float) -> int:
    """A second receiver: it follows the first, and stands in while that is excluded, as one height
    with the slow error of a receiver for each of its correlation times."""
    s, p, instance, time_us = state[0], params[0], sample[0].instance, sample[0].time_us
    if s.gnss.seen == 0:
        return IGNORED
    innovation_m = fix_m - expected(s.bank, s.bank.H)
    if not is_named(s.named, GNSS_HEIGHT):
        follow(s.spares, RECEIVERS, instance, time_us, innovation_m)
        return IGNORED
    if not is_settled(s.spares, RECEIVERS, instance):
        return IGNORED
    white = white_m2(s.gnss, p, sample)
    slow = slow_m2(p, sample, white)
    away_m = innovation_m - s.spares.offset_m[RECEIVERS, instance]
    S = white + slow + expected_variance(s.bank, s.bank.H)
    if away_m * away_m > FAR_SIGMA * FAR_SIGMA * S:
        return GATED
    interval_s = max(0.01, (time_us - s.spares.time_us[RECEIVERS, instance]) * 1e-6)
    s.spares.time_us[RECEIVERS, instance] = time_us
    R = (white + slow) * max(1.0, p.gnss_time_s / interval_s)
    fuse(s.bank, fix_m - s.spares.offset_m[RECEIVERS, instance], R, 0.0, 0)
    conclude(state, params, estimate)
    return USED


# What is known besides


@step
def on_air(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """QNH, temperature and elevation of the field, any of them; they wait for the first barometer
    height."""
    s, p, time_us = state[0], params[0], sample[0].time_us
    if sample[0].instance != 0:
        return tally(state, AIR, IGNORED)
    has_qnh = LOWEST_QNH_PA <= sample[0].qnh_pa <= HIGHEST_QNH_PA
    has_air = LOWEST_AIR_K <= sample[0].air_temperature_k <= HIGHEST_AIR_K
    has_field = LOWEST_FIELD_M <= sample[0].field_elevation_m <= HIGHEST_FIELD_M
    if not has_qnh and not has_air and not has_field:
        return tally(state, AIR, INVALID)
    if is_stale(state, AIR, 0, time_us):
        return tally(state, AIR, STALE)
    place(state, AIR, 0, time_us)
    used = s.baro.seen == 0
    if has_field:
        s.aids.field_m, used = sample[0].field_elevation_m, True
    if has_air:
        s.aids.air_k = sample[0].air_temperature_k
        if s.baro.seen == 1 and fuse_temperature(s.aids, s.bank, p, s.baro.pressure_pa):
            used = True
    if has_qnh and sample[0].qnh_pa != s.aids.known_qnh_pa:
        s.aids.known_qnh_pa, s.aids.known_qnh_us = sample[0].qnh_pa, time_us
        if s.baro.seen == 1 and fuse_qnh(s.aids, s.bank, p, mean(s.bank, HEIGHT)):
            used = True
    return tally(state, AIR, USED if used else IGNORED)


@step
def on_range(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A range finder that looks down corrects the height above take-off, as far as the ground is
    level."""
    s, time_us, distance_m = state[0], sample[0].time_us, sample[0].distance_m
    if sample[0].downward != 1:
        return tally(state, RANGE, IGNORED)
    if not 0.0 < distance_m <= FURTHEST_RANGE_M:
        return tally(state, RANGE, INVALID)
    if is_stale(state, RANGE, sample[0].instance, time_us):
        return tally(state, RANGE, STALE)
    place(state, RANGE, sample[0].instance, time_us)
    other = sample[0].instance != s.aids.range_instance
    if other and time_us - s.aids.range_us <= FRESH_US:
        return tally(state, RANGE, IGNORED)  # one at a time: they hang at different heights
    upright = -s.attitude.own.up_b[2]
    if not upright > STEEPEST_COS:
        return tally(state, RANGE, IGNORED)
    between_s = note_range(s.aids, time_us, sample[0].instance, distance_m * upright)
    if s.takeoff.time_us < 0:
        return tally(state, RANGE, IGNORED)
    predict(state, params, time_us)
    used = fuse_range(s.aids, s.bank, (s.bank.now_us - time_us) * 1e-6, between_s)
    return tally(state, RANGE, USED if used else GATED)


@step
def on_status(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A reboot restarts the vehicle's clock: start anew."""
    s = state[0]
    if sample[0].reboot == 1:
        start(state, params)
        forget(estimate)
    if note_armed(s.takeoff, s.bank, sample[0].armed):
        note_takeoff(s.aids, s.bank.now_us)
    return tally(state, STATUS, USED)


# What every measurement does


@step
def is_blind(state: Rows) -> bool:
    """Whether nothing is known of the vehicle's acceleration now."""
    return not is_inertial(state[0].imu, state[0].bank.now_us)


@step
def predict(state: Rows, params: Rows, time_us: int) -> None:
    """Bring the mixture to a measurement; after a long silence of both sensors, begin again."""
    s, p = state[0], params[0]
    bank = s.bank
    before_us = bank.now_us
    k, k2 = mean(bank, PORT), variance(bank, PORT)
    unseen_mps = unseen_speed_mps(s.baro, p, time_us)
    bank.fast_m2 = p.fast_sd_m**2 + unseen_head_m2(s.baro.head_m, unseen_mps, k * k + k2)
    advance(bank, s.imu, p, s.attitude.interval_s, max(time_us, bank.now_us))
    heard_us = max(s.baro.heard_us, s.gnss.used_us)
    if before_us >= 0 and heard_us >= 0 and bank.now_us - heard_us > LONG_SILENCE_US:
        resume(bank, p)
        attribution_start(s.named)
        s.baro.heard_us = bank.now_us


@step
def conclude(state: Rows, params: Rows, estimate: Rows) -> None:
    """Let hypotheses change into each other, name the sensors that are wrong, publish."""
    s, p = state[0], params[0]
    climb_the_column(s.bank)
    if s.bank.switched_us < 0:
        s.bank.switched_us, s.bank.searched_us = s.bank.now_us, s.bank.now_us
    away_s = (s.bank.now_us - s.gnss.used_us) * 1e-6
    s.bank.outage = 1 if s.gnss.seen == 0 or away_s > OUTAGE_S else 0
    switch(s.bank, p, s.baro.stuck)
    if p.integrity == 1 and s.gnss.seen == 1 and s.baro.seen == 1:
        search(s.bank, p)
        attribute(s.named, s.bank, p.attribution_probability, is_blind(state))
    if watch_takeoff(s.takeoff, s.bank):
        note_takeoff(s.aids, s.bank.now_us)
    if s.takeoff.time_us < 0 and not s.gnss.ground_speed_mps > REST_SPEED_MPS:
        fuse_field(s.aids, s.bank, p)
    publish(state, params, estimate)


@step
def publish(state: Rows, params: Rows, estimate: Rows) -> None:
    """What the mixture says; nothing while nobody has told a height."""
    s, p, e = state[0], params[0], estimate[0]
    if s.baro.seen == 0 and s.gnss.seen == 0:
        return
    bank = s.bank
    e.time_us = bank.now_us
    e.altitude_amsl_m = mean(bank, HEIGHT)
    e.climb_mps = mean(bank, CLIMB)
    e.altitude_sd_m = math.sqrt(variance(bank, HEIGHT))
    e.climb_sd_mps = math.sqrt(variance(bank, CLIMB))
    e.baro_offset_m = -mean(bank, OFFSET)
    e.baro_rate_mps = mean(bank, RATE)
    e.baro_scale = mean(bank, SCALE)
    e.gnss_offset_m = mean(bank, GNSS_BIAS)
    e.innovation_m = s.gnss.innovation_m
    e.height_above_takeoff_m = height_above_takeoff_m(s.takeoff, bank)
    e.protection_level_m = protection_level_m(
        bank, p.crossings_per_h, p.integrity_risk_probability, e.altitude_sd_m
    )
    e.qnh_pa, e.qnh_sd_pa = math.nan, math.nan
    if s.baro.seen == 1 and not is_named(s.named, BAROMETER):
        e.qnh_pa = qnh_pa(s.baro.pressure_pa, e.altitude_amsl_m)
        e.qnh_sd_pa = QNH_PA_PER_M * e.altitude_sd_m
    for j in range(e.drift_probabilities.size):
        e.drift_probabilities[j] = 0.0
    for i in range(N):
        e.drift_probabilities[bank.weather[i]] += bank.weight[i]
    e.faulty = named_fault(s.named)
    e.faulty_since_us = s.named.since_us[e.faulty] if e.faulty > 0 else 0
    for fault in range(1, s.named.since_us.size):
        e.fault_probabilities[fault - 1] = fault_probability(bank, fault)


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
        elif kind == AIRSPEED:
            verdicts[i] = on_airspeed(state, params, tables.airspeed[row : row + 1], estimate)
        elif kind == RANGE:
            verdicts[i] = on_range(state, params, tables.range[row : row + 1], estimate)
        elif kind == AIR:
            verdicts[i] = on_air(state, params, tables.air[row : row + 1], estimate)
        elif kind == STATUS:
            verdicts[i] = on_status(state, params, tables.status[row : row + 1], estimate)


METHOD = Method(
    name="vertical-bank",
    summary="mixture of vertical channels over weather and sensor faults, with a protection level",
    citation="Kollsman",
    settings=VerticalBankSettings,
    state=STATE,
    init=init,
    steps={
        Kind.IMU: on_imu,
        Kind.PRESSURE: on_pressure,
        Kind.GNSS: on_gnss,
        Kind.ATTITUDE: on_attitude,
        Kind.AIRSPEED: on_airspeed,
        Kind.RANGE: on_range,
        Kind.AIR: on_air,
        Kind.STATUS: on_status,
    },
    run=run,
    datum_invariant=False,
    follows_baro_step=True,
    version=2,
)
