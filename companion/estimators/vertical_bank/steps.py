"""The vertical bank, our own estimator: a pruned Gaussian mixture of vertical channels over few
hypotheses about the weather and about faults of sensors.

`channel` is one Kalman filter of thirteen states. `hypotheses` says which of them run side by side:
calm, fair and stormy weather; a wrong receiver, a wrong barometer, a wrong IMU, and what follows.
Measurements move their probabilities (`mixture`); the estimate is the mean of the mixture, the
protection level its tail (`protection`), and a sensor is excluded while the hypotheses that it is
wrong are probable (`attribution`). Where the measurements do not decide, the spread grows by
itself.

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
    judge_imu,
    place,
    tally,
)
from companion.estimators.method import Method
from companion.estimators.vertical_bank.aids import (
    FRESH_US,
    FURTHEST_RANGE_M,
    HIGHEST_FIELD_M,
    HIGHEST_QNH_PA,
    LOWEST_FIELD_M,
    LOWEST_QNH_PA,
    STEEPEST_COS,
    fuse_qnh,
    fuse_range,
    fuse_temperature,
    know_qnh,
    note_range,
    note_takeoff,
)
from companion.estimators.vertical_bank.attribution import INERTIAL, is_named
from companion.estimators.vertical_bank.barometer import note_speed
from companion.estimators.vertical_bank.channel import HEIGHT, TAKEOFF
from companion.estimators.vertical_bank.cycle import predict
from companion.estimators.vertical_bank.fixes import on_gnss
from companion.estimators.vertical_bank.inertial import VAGUE_TILT_RAD, note_tilt, take_acceleration
from companion.estimators.vertical_bank.mixture import advance, mean, variance
from companion.estimators.vertical_bank.pressures import on_pressure
from companion.estimators.vertical_bank.publishing import publish
from companion.estimators.vertical_bank.settings import VerticalBankSettings
from companion.estimators.vertical_bank.state import STATE, init, restart, start
from companion.estimators.vertical_bank.takeoff import note_armed, note_landed, take_off_at
from companion.estimators.vertical_bank.weather import follow_weather
from companion.jit import step
from companion.kernels.attitude import (
    attitude_imu,
    attitude_vehicle,
    imu_can_be_integrated,
    up_acceleration_mps2,
    vehicle_serves,
)
from companion.samples import Kind, Rows, Tables

OUTPUT_US = 100_000
"""An estimate is no older than this while there is an IMU."""
FASTEST_AIRSPEED_MPS = 400.0


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
    if has_qnh:
        used = on_qnh(state, params, sample) or used
    return tally(state, AIR, USED if used else IGNORED)


@step
def on_qnh(state: Rows, params: Rows, sample: Rows) -> bool:
    """A QNH, told or measured by a reference barometer; whether it was used."""
    s, qnh_pa, sd_pa = state[0], sample[0].qnh_pa, sample[0].qnh_sd_pa
    is_measured = sd_pa > 0.0
    is_new = qnh_pa != s.aids.known_qnh_pa
    know_qnh(
        s.aids,
        qnh_pa,
        sd_pa if is_measured else params[0].known_qnh_sd_pa,
        sample[0].time_us if is_new or is_measured else s.aids.known_qnh_us,
    )
    is_followed = is_measured and follow_weather(s.bank, params[0], qnh_pa, sample[0].time_us)
    if s.baro.seen == 0 or is_followed or (not is_new and not is_measured):
        return is_followed
    return fuse_qnh(s.aids, s.bank, mean(s.bank, HEIGHT))


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
    """A reboot restarts the vehicle's clock: start anew. Where the clock goes on, only the
    estimator is restarted: the vehicle has taken off where it did, and its receiver is as good as
    it has shown itself to be."""
    s = state[0]
    if sample[0].reboot == 1:
        is_ours = 0 <= s.bank.now_us <= sample[0].time_us
        was_us = s.takeoff.time_us if is_ours else -1
        height_m, variance_m2 = mean(s.bank, TAKEOFF), variance(s.bank, TAKEOFF)
        if is_ours:
            restart(state, params)
        else:
            start(state, params)
        forget(estimate)
        if was_us >= 0:
            take_off_at(s.takeoff, s.bank, was_us, height_m, variance_m2)
    note_landed(s.takeoff, sample[0].landed)
    if note_armed(s.takeoff, s.bank, sample[0].armed):
        note_takeoff(s.aids, s.bank.now_us)
    return tally(state, STATUS, USED)


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
    tunable=(
        "accel_noise_mps2_rthz",
        "blind_psd_m2ps3",
        "offset_walk_m_rts",
        "fast_sd_m",
        "baro_sd_m",
        "gnss_white_floor_m",
        "gnss_slow_floor_m",
        "timing_sd_s",
    ),
    version=2,
)
