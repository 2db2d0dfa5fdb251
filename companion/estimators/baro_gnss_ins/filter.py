"""The GNSS/INS part of `companion.estimators.baro_gnss_ins.steps`: seventeen errors, carried on by
an IMU or without one.

Letters as there: ``P`` the covariance of the errors, ``dx`` the errors found by the present sample
and not yet injected, ``H`` a measurement row, ``K`` a gain, ``Q`` spectral densities.

Two ways to carry the same state on. Inertial: the mechanisation and error model of
`companion.estimators.baro_gnss_ins.strapdown`. Coasting: constant velocity under white
acceleration, with the attitude forgotten. An estimator calls `catch_up` before each measurement,
`carry` for each IMU sample, the corrections, and `inject` at the end of each sample that corrected.
"""

import math
from typing import Any

from numpy.typing import NDArray

from companion.estimators.baro_gnss_ins.strapdown import (
    FORCE_BIAS,
    POSITION,
    RATE_BIAS,
    TILT,
    VELOCITY,
    coast,
    mechanise,
    move,
    set_attitude,
    transition,
    turn_frame,
    wrapped,
    yaw_rad,
)
from companion.estimators.baro_gnss_ins.track import clear, push, shift, track_fields
from companion.estimators.judging import PRESSURE
from companion.jit import step
from companion.kernels.attitude import (
    ATTITUDE_STATE,
    attitude_start,
    pitch_rad,
    roll_rad,
    tilt_sd_rad,
    up_is_known,
)
from companion.kernels.levelling import MOVING_TILT_SD_RAD
from companion.samples import Rows

BARO_BIAS, BARO_SCALE, N = 15, 16, 17
"""the last two errors, and how many there are"""
NORTH, EAST, DOWN = 0, 1, 2

LONGEST_STEP_S = 0.5
"""an IMU that is silent for longer says nothing about the attitude afterwards"""
LONGEST_COAST_S = 30.0
"""after a longer silence of everything, height and climb are unknown again"""
BLIND_S = 60.0
"""without GNSS velocity for longer, the horizontal channel has left the truth and takes the
attitude along"""
ALONE_S = 600.0
"""the same when there is no barometer either, and nothing better to do than to integrate on"""
RUNAWAY_M = 30.0
"""how far height, and b after it, may have gone by then"""
REST_US = 30_000_000
"""for which an IMU that has been wrong is not integrated"""
UNKNOWN_M, UNKNOWN_MPS, UNKNOWN_CLIMB_MPS = 1e4, 50.0, 10.0
UNKNOWN_YAW_SD_RAD = math.pi / math.sqrt(3.0)
"""half a turn to either side, all equally likely"""
SLOWEST_COURSE_MPS = 5.0
SIDE_WIND_MPS = 5.0
"""the nose points beside the course by atan(side wind / speed)"""
GATE = 3.0
SNAPSHOT_MPS2, SNAPSHOT_RADPS = 0.3, 0.02
"""RAW_IMU is one sample of vibration and gusts, not their mean over the interval: white noise of
this spread"""
HIGHEST_M, FASTEST_MPS = 60_000.0, 1_000.0
"""beyond these the filter has diverged"""


def ins_fields() -> tuple[tuple[Any, ...], ...]:
    """The state fields of this part."""
    return (
        ("attitude", ATTITUDE_STATE),
        *track_fields(),
        ("time_us", "i8"),  # of position, velocity and attitude; -1 not begun
        ("inertial", "i8"),  # 1 carried on by the IMU, 0 coasting
        ("yaw_known", "i8"),
        ("located", "i8"),  # latitude and longitude are known
        ("velocity_us", "i8"),  # newest GNSS velocity, -1 none
        ("slip_s", "f8"),  # for how long GNSS velocity has contradicted
        ("sink_s", "f8"),  # for how long the barometer has: positive or negative, by its side
        ("rest_us", "i8"),  # until when the IMU is not integrated
        ("position", "f8", (3,)),  # latitude, longitude (rad), height (m)
        ("velocity_n_mps", "f8", (3,)),
        ("quaternion", "f8", (4,)),
        ("force_bias_b_mps2", "f8", (3,)),
        ("rate_bias_b_radps", "f8", (3,)),
        ("b_m", "f8"),
        ("s", "f8"),
        ("P", "f8", (N, N)),
        ("dx", "f8", (N,)),
        ("H", "f8", (N,)),
        ("K", "f8", (N,)),
        (
            "mat",
            "f8",
            (4, 3),
        ),  # mat_nb, and specific force NED, in the middle of the newest interval
        ("force_b_mps2", "f8", (3,)),  # newest IMU sample less its biases
        ("rate_b_radps", "f8", (3,)),
    )


@step
def ins_start(state: Rows, params: Rows) -> None:
    """Nothing known but the priors."""
    s, p = state[0], params[0]
    attitude_start(state[0].attitude)
    clear(s.track_us, s.track)
    s.time_us, s.velocity_us = -1, -1
    s.inertial, s.yaw_known, s.located = 0, 0, 0
    s.slip_s, s.sink_s, s.b_m, s.s = 0.0, 0.0, 0.0, 0.0
    s.rest_us = -1
    s.position[0], s.position[1], s.position[2] = math.radians(45.0), 0.0, 0.0
    set_attitude(s.quaternion, 0.0, 0.0, 0.0)
    for i in range(6):
        s.track_at[i] = 0.0
    for i in range(3):
        s.velocity_n_mps[i], s.force_b_mps2[i], s.rate_b_radps[i] = 0.0, 0.0, 0.0
        s.force_bias_b_mps2[i], s.rate_bias_b_radps[i] = 0.0, 0.0
        for j in range(4):
            s.mat[j, i] = 0.0
    for i in range(N):
        s.dx[i], s.H[i], s.K[i] = 0.0, 0.0, 0.0
        for j in range(N):
            s.P[i, j] = 0.0
    for i in range(3):
        s.P[POSITION + i, POSITION + i] = UNKNOWN_M * UNKNOWN_M
        s.P[VELOCITY + i, VELOCITY + i] = UNKNOWN_MPS * UNKNOWN_MPS
        s.P[FORCE_BIAS + i, FORCE_BIAS + i] = p.accel_bias_sd_mps2 * p.accel_bias_sd_mps2
        s.P[RATE_BIAS + i, RATE_BIAS + i] = p.gyro_bias_sd_radps * p.gyro_bias_sd_radps
    s.P[VELOCITY + DOWN, VELOCITY + DOWN] = UNKNOWN_CLIMB_MPS * UNKNOWN_CLIMB_MPS
    s.P[BARO_BIAS, BARO_BIAS] = p.baro_bias_sd_m * p.baro_bias_sd_m
    s.P[BARO_SCALE, BARO_SCALE] = p.baro_scale_sd_ratio * p.baro_scale_sd_ratio


@step
def begin(state: Rows, time_us: int, height_m: float) -> None:
    """The first height: where the filter is linearised, known to nobody yet."""
    state[0].time_us = time_us
    state[0].position[2] = height_m


@step
def forget_error(state: Rows, index: int, variance: float) -> None:
    """One error starts anew, correlated with no other; what the present sample has found of it is
    void."""
    P = state[0].P
    for k in range(N):
        P[index, k] = 0.0
        P[k, index] = 0.0
    P[index, index] = variance
    state[0].dx[index] = 0.0


@step
def widen_common(P: NDArray[Any], variance: float) -> None:
    """Height and b are wrong together, by as much: of this the barometer sees nothing."""
    down = POSITION + DOWN
    P[down, down] += variance
    P[BARO_BIAS, BARO_BIAS] += variance
    P[down, BARO_BIAS] -= variance
    P[BARO_BIAS, down] -= variance


# Carrying the state on


@step
def catch_up(state: Rows, params: Rows, time_us: int) -> None:
    """Bring the state to a measurement's time, unless the IMU does that."""
    s = state[0]
    if s.inertial == 1 and time_us - s.time_us > LONGEST_STEP_S * 1e6:
        s.inertial = 0
    if s.inertial == 0 and time_us > s.time_us:
        _coast(state, params, (time_us - s.time_us) * 1e-6)
        s.time_us = time_us
        push(s.track_us, s.track, time_us, s.position, s.velocity_n_mps)


@step
def _coast(state: Rows, params: Rows, dt_s: float) -> None:
    s, p = state[0], params[0]
    Q = p.coast_noise_mps2_rthz * p.coast_noise_mps2_rthz
    _walk_biases(state, params, dt_s)
    if dt_s > LONGEST_COAST_S:
        for axis in range(3):
            s.velocity_n_mps[axis] = 0.0
            forget_error(state, POSITION + axis, UNKNOWN_M * UNKNOWN_M)
            forget_error(state, VELOCITY + axis, UNKNOWN_MPS * UNKNOWN_MPS)
        s.P[VELOCITY + DOWN, VELOCITY + DOWN] = UNKNOWN_CLIMB_MPS * UNKNOWN_CLIMB_MPS
        s.located, s.velocity_us = 0, -1
        clear(s.track_us, s.track)
        return
    v = s.velocity_n_mps
    move(s.position, v[NORTH] * dt_s, v[EAST] * dt_s, v[DOWN] * dt_s)
    coast(s.P, dt_s)
    _transpose(s.P)
    coast(s.P, dt_s)
    for axis in range(3):
        i, j = POSITION + axis, VELOCITY + axis
        s.P[i, i] += Q * dt_s * dt_s * dt_s / 3.0
        s.P[i, j] += Q * dt_s * dt_s / 2.0
        s.P[j, i] += Q * dt_s * dt_s / 2.0
        s.P[j, j] += Q * dt_s
    _symmetrise(s.P)


@step
def carry(state: Rows, params: Rows, sample: Rows) -> None:
    """Carry the state on by an IMU sample; begin to do so when the attitude is known and GNSS shows
    the velocity."""
    s = state[0]
    dt_s = (sample[0].time_us - s.time_us) * 1e-6
    blind_s = (sample[0].time_us - s.velocity_us) * 1e-6
    has_baro = (
        sample[0].time_us - s.last_us[PRESSURE, 0] < BLIND_S * 1e6 and s.last_us[PRESSURE, 0] >= 0
    )
    if s.inertial == 1 and (dt_s > LONGEST_STEP_S or blind_s > (BLIND_S if has_baro else ALONE_S)):
        s.inertial = 0
    if s.inertial == 0:
        fresh = s.velocity_us >= 0 and sample[0].time_us - s.velocity_us < 2_000_000
        if fresh and up_is_known(state[0].attitude) and sample[0].time_us >= s.rest_us:
            catch_up(state, params, sample[0].time_us)
            _align(state)
        return
    if dt_s <= 0.0:
        return
    for i in range(3):
        s.force_b_mps2[i] = sample[0].specific_force_b_mps2[i] - s.force_bias_b_mps2[i]
        s.rate_b_radps[i] = sample[0].angular_rate_b_radps[i] - s.rate_bias_b_radps[i]
    mechanise(
        s.position, s.velocity_n_mps, s.quaternion, s.force_b_mps2, s.rate_b_radps, dt_s, s.mat
    )
    s.time_us = sample[0].time_us
    propagate(state, params, dt_s)
    push(s.track_us, s.track, s.time_us, s.position, s.velocity_n_mps)


@step
def propagate(state: Rows, params: Rows, dt_s: float) -> None:
    """P = Phi P Phi' + Q dt over the interval that `mechanise` has just carried."""
    s, p = state[0], params[0]
    transition(s.P, s.mat, dt_s)
    _transpose(s.P)
    transition(s.P, s.mat, dt_s)
    force = p.accel_noise_mps2_rthz * p.accel_noise_mps2_rthz + SNAPSHOT_MPS2 * SNAPSHOT_MPS2 * dt_s
    rate = (
        p.gyro_noise_radps_rthz * p.gyro_noise_radps_rthz + SNAPSHOT_RADPS * SNAPSHOT_RADPS * dt_s
    )
    for i in range(3):
        s.P[VELOCITY + i, VELOCITY + i] += force * dt_s
        s.P[TILT + i, TILT + i] += rate * dt_s
    _walk_biases(state, params, dt_s)
    _symmetrise(s.P)


@step
def _walk_biases(state: Rows, params: Rows, dt_s: float) -> None:
    s, p = state[0], params[0]
    for i in range(3):
        s.P[FORCE_BIAS + i, FORCE_BIAS + i] += p.accel_walk_mps2_rts * p.accel_walk_mps2_rts * dt_s
        s.P[RATE_BIAS + i, RATE_BIAS + i] += p.gyro_walk_radps_rts * p.gyro_walk_radps_rts * dt_s
    s.P[BARO_BIAS, BARO_BIAS] += p.baro_walk_m_rts * p.baro_walk_m_rts * dt_s
    s.P[BARO_SCALE, BARO_SCALE] += p.baro_scale_walk_rts * p.baro_scale_walk_rts * dt_s


@step
def _transpose(P: NDArray[Any]) -> None:
    for i in range(N):
        for j in range(i):
            P[i, j], P[j, i] = P[j, i], P[i, j]


@step
def _symmetrise(P: NDArray[Any]) -> None:
    for i in range(N):
        for j in range(i):
            mean = 0.5 * (P[i, j] + P[j, i])
            P[i, j] = mean
            P[j, i] = mean


@step
def inject(state: Rows, params: Rows) -> None:
    """Move the errors found into the state, and its past with it."""
    s = state[0]
    dx = s.dx
    move(s.position, dx[0], dx[1], dx[2])
    turn_frame(s.quaternion, dx[TILT], dx[TILT + 1], dx[TILT + 2])
    for i in range(3):
        s.velocity_n_mps[i] += dx[VELOCITY + i]
        s.force_bias_b_mps2[i] += dx[FORCE_BIAS + i]
        s.rate_bias_b_radps[i] += dx[RATE_BIAS + i]
    s.b_m += dx[BARO_BIAS]
    s.s += dx[BARO_SCALE]
    shift(s.track_us, s.track, s.time_us, dx[:VELOCITY], dx[VELOCITY:TILT])
    for i in range(N):
        dx[i] = 0.0
    speed = math.hypot(math.hypot(s.velocity_n_mps[0], s.velocity_n_mps[1]), s.velocity_n_mps[2])
    if not abs(s.position[2]) < HIGHEST_M or not speed < FASTEST_MPS:
        ins_start(state, params)


# Attitude


@step
def _align(state: Rows) -> None:
    """Begin to integrate: roll, pitch and gyro bias of the attitude component, yaw along the course
    or unknown."""
    s = state[0]
    set_attitude(s.quaternion, roll_rad(state[0].attitude), pitch_rad(state[0].attitude), 0.0)
    sd_rad = tilt_sd_rad(state[0].attitude)
    tilt_var = (
        sd_rad * sd_rad if sd_rad > 0.0 else MOVING_TILT_SD_RAD * MOVING_TILT_SD_RAD
    )  # the vehicle's alone
    for i in range(3):
        s.rate_bias_b_radps[i] = s.attitude.own.bias_b_radps[i]
        # An accelerometer bias tilts the level by bias / g.
        forget_error(state, TILT + i, tilt_var + s.P[FORCE_BIAS + i, FORCE_BIAS + i] / 96.0)
        forget_error(state, RATE_BIAS + i, s.attitude.own.bias_var)
    forget_error(state, TILT + DOWN, UNKNOWN_YAW_SD_RAD * UNKNOWN_YAW_SD_RAD)
    s.inertial, s.yaw_known, s.slip_s, s.sink_s = 1, 0, 0.0, 0.0
    if s.attitude.own.speed_mps > SLOWEST_COURSE_MPS:
        set_yaw(state, s.attitude.own.course_rad, course_sd_rad(s.attitude.own.speed_mps))


@step
def set_yaw(state: Rows, yaw: float, sd_rad: float) -> None:
    """Turn the nose to `yaw` about the vertical."""
    s = state[0]
    turn_frame(s.quaternion, 0.0, 0.0, wrapped(yaw - yaw_rad(s.quaternion)))
    forget_error(state, TILT + DOWN, sd_rad * sd_rad)
    s.yaw_known = 1


@step
def course_sd_rad(speed_mps: float) -> float:
    """How far the nose may point beside the course."""
    return math.atan2(SIDE_WIND_MPS, speed_mps)


@step
def suspend(state: Rows, params: Rows) -> None:
    """Stop integrating for a while: h and b may have gone far together; climb, s and the IMU's
    biases are unknown."""
    s, p, P = state[0], params[0], state[0].P
    s.inertial, s.slip_s, s.sink_s = 0, 0.0, 0.0
    s.rest_us = s.time_us + REST_US
    forget_error(state, BARO_SCALE, p.baro_scale_sd_ratio * p.baro_scale_sd_ratio)
    widen_common(P, RUNAWAY_M * RUNAWAY_M)
    for i in range(3):
        s.force_bias_b_mps2[i], s.rate_bias_b_radps[i] = 0.0, 0.0
        forget_error(state, VELOCITY + i, UNKNOWN_CLIMB_MPS * UNKNOWN_CLIMB_MPS)
        forget_error(state, FORCE_BIAS + i, p.accel_bias_sd_mps2 * p.accel_bias_sd_mps2)
        forget_error(state, RATE_BIAS + i, p.gyro_bias_sd_radps * p.gyro_bias_sd_radps)
