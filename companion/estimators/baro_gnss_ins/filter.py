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

import numpy as np
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
from companion.estimators.baro_gnss_ins.track import TRACK, clear, push, shift
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
from companion.samples import Record, Rows

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
"""time for which an IMU that has been wrong is not integrated"""
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


INS = np.dtype(
    [
        ("attitude", ATTITUDE_STATE),
        ("track", TRACK),
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
        ("mat", "f8", (4, 3)),  # mat_nb and specific force NED in the middle of the newest interval
        ("force_b_mps2", "f8", (3,)),  # newest IMU sample less its biases
        ("rate_b_radps", "f8", (3,)),
    ],
    align=True,
)
"""The record of this component."""


@step
def ins_start(ins: Record, params: Rows) -> None:
    """Nothing known but the priors."""
    p = params[0]
    attitude_start(ins.attitude)
    clear(ins.track)
    ins.time_us, ins.velocity_us = -1, -1
    ins.inertial, ins.yaw_known, ins.located = 0, 0, 0
    ins.slip_s, ins.sink_s, ins.b_m, ins.s = 0.0, 0.0, 0.0, 0.0
    ins.rest_us = -1
    ins.position[0], ins.position[1], ins.position[2] = math.radians(45.0), 0.0, 0.0
    set_attitude(ins.quaternion, 0.0, 0.0, 0.0)
    for i in range(6):
        ins.track.at[i] = 0.0
    for i in range(3):
        ins.velocity_n_mps[i], ins.force_b_mps2[i], ins.rate_b_radps[i] = 0.0, 0.0, 0.0
        ins.force_bias_b_mps2[i], ins.rate_bias_b_radps[i] = 0.0, 0.0
        for j in range(4):
            ins.mat[j, i] = 0.0
    for i in range(N):
        ins.dx[i], ins.H[i], ins.K[i] = 0.0, 0.0, 0.0
        for j in range(N):
            ins.P[i, j] = 0.0
    for i in range(3):
        ins.P[POSITION + i, POSITION + i] = UNKNOWN_M * UNKNOWN_M
        ins.P[VELOCITY + i, VELOCITY + i] = UNKNOWN_MPS * UNKNOWN_MPS
        ins.P[FORCE_BIAS + i, FORCE_BIAS + i] = p.accel_bias_sd_mps2 * p.accel_bias_sd_mps2
        ins.P[RATE_BIAS + i, RATE_BIAS + i] = p.gyro_bias_sd_radps * p.gyro_bias_sd_radps
    ins.P[VELOCITY + DOWN, VELOCITY + DOWN] = UNKNOWN_CLIMB_MPS * UNKNOWN_CLIMB_MPS
    ins.P[BARO_BIAS, BARO_BIAS] = p.baro_bias_sd_m * p.baro_bias_sd_m
    ins.P[BARO_SCALE, BARO_SCALE] = p.baro_scale_sd_ratio * p.baro_scale_sd_ratio


@step
def begin(ins: Record, time_us: int, height_m: float) -> None:
    """The first height: where the filter is linearised, known to nobody yet."""
    ins.time_us = time_us
    ins.position[2] = height_m


@step
def forget_error(ins: Record, index: int, variance: float) -> None:
    """One error starts anew, correlated with no other; what the present sample has found of it is
    void."""
    P = ins.P
    for k in range(N):
        P[index, k] = 0.0
        P[k, index] = 0.0
    P[index, index] = variance
    ins.dx[index] = 0.0


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
def catch_up(ins: Record, params: Rows, time_us: int) -> None:
    """Bring the state to a measurement's time, unless the IMU does that."""
    if ins.inertial == 1 and time_us - ins.time_us > LONGEST_STEP_S * 1e6:
        ins.inertial = 0
    if ins.inertial == 0 and time_us > ins.time_us:
        _coast(ins, params, (time_us - ins.time_us) * 1e-6)
        ins.time_us = time_us
        push(ins.track, time_us, ins.position, ins.velocity_n_mps)


@step
def _coast(ins: Record, params: Rows, dt_s: float) -> None:
    p = params[0]
    Q = p.coast_noise_mps2_rthz * p.coast_noise_mps2_rthz
    _walk_biases(ins, params, dt_s)
    if dt_s > LONGEST_COAST_S:
        for axis in range(3):
            ins.velocity_n_mps[axis] = 0.0
            forget_error(ins, POSITION + axis, UNKNOWN_M * UNKNOWN_M)
            forget_error(ins, VELOCITY + axis, UNKNOWN_MPS * UNKNOWN_MPS)
        ins.P[VELOCITY + DOWN, VELOCITY + DOWN] = UNKNOWN_CLIMB_MPS * UNKNOWN_CLIMB_MPS
        ins.located, ins.velocity_us = 0, -1
        clear(ins.track)
        return
    v = ins.velocity_n_mps
    move(ins.position, v[NORTH] * dt_s, v[EAST] * dt_s, v[DOWN] * dt_s)
    coast(ins.P, dt_s)
    _transpose(ins.P)
    coast(ins.P, dt_s)
    for axis in range(3):
        i, j = POSITION + axis, VELOCITY + axis
        ins.P[i, i] += Q * dt_s * dt_s * dt_s / 3.0
        ins.P[i, j] += Q * dt_s * dt_s / 2.0
        ins.P[j, i] += Q * dt_s * dt_s / 2.0
        ins.P[j, j] += Q * dt_s
    _symmetrise(ins.P)


@step
def carry(ins: Record, params: Rows, sample: Rows, pressure_us: int) -> None:
    """Carry the state on by an IMU sample; begin to do so when the attitude is known and GNSS shows
    the velocity. `pressure_us` is the time of the last pressure, -1 none."""
    dt_s = (sample[0].time_us - ins.time_us) * 1e-6
    blind_s = (sample[0].time_us - ins.velocity_us) * 1e-6
    has_baro = pressure_us >= 0 and sample[0].time_us - pressure_us < BLIND_S * 1e6
    if ins.inertial == 1 and (
        dt_s > LONGEST_STEP_S or blind_s > (BLIND_S if has_baro else ALONE_S)
    ):
        ins.inertial = 0
    if ins.inertial == 0:
        fresh = ins.velocity_us >= 0 and sample[0].time_us - ins.velocity_us < 2_000_000
        if fresh and up_is_known(ins.attitude) and sample[0].time_us >= ins.rest_us:
            catch_up(ins, params, sample[0].time_us)
            _align(ins)
        return
    if dt_s <= 0.0:
        return
    for i in range(3):
        ins.force_b_mps2[i] = sample[0].specific_force_b_mps2[i] - ins.force_bias_b_mps2[i]
        ins.rate_b_radps[i] = sample[0].angular_rate_b_radps[i] - ins.rate_bias_b_radps[i]
    mechanise(
        ins.position,
        ins.velocity_n_mps,
        ins.quaternion,
        ins.force_b_mps2,
        ins.rate_b_radps,
        dt_s,
        ins.mat,
    )
    ins.time_us = sample[0].time_us
    propagate(ins, params, dt_s)
    push(ins.track, ins.time_us, ins.position, ins.velocity_n_mps)


@step
def propagate(ins: Record, params: Rows, dt_s: float) -> None:
    """P = Phi P Phi' + Q dt over the interval that `mechanise` has just carried."""
    p = params[0]
    transition(ins.P, ins.mat, dt_s)
    _transpose(ins.P)
    transition(ins.P, ins.mat, dt_s)
    force = p.accel_noise_mps2_rthz * p.accel_noise_mps2_rthz + SNAPSHOT_MPS2 * SNAPSHOT_MPS2 * dt_s
    rate = (
        p.gyro_noise_radps_rthz * p.gyro_noise_radps_rthz + SNAPSHOT_RADPS * SNAPSHOT_RADPS * dt_s
    )
    for i in range(3):
        ins.P[VELOCITY + i, VELOCITY + i] += force * dt_s
        ins.P[TILT + i, TILT + i] += rate * dt_s
    _walk_biases(ins, params, dt_s)
    _symmetrise(ins.P)


@step
def _walk_biases(ins: Record, params: Rows, dt_s: float) -> None:
    p = params[0]
    for i in range(3):
        ins.P[FORCE_BIAS + i, FORCE_BIAS + i] += (
            p.accel_walk_mps2_rts * p.accel_walk_mps2_rts * dt_s
        )
        ins.P[RATE_BIAS + i, RATE_BIAS + i] += p.gyro_walk_radps_rts * p.gyro_walk_radps_rts * dt_s
    ins.P[BARO_BIAS, BARO_BIAS] += p.baro_walk_m_rts * p.baro_walk_m_rts * dt_s
    ins.P[BARO_SCALE, BARO_SCALE] += p.baro_scale_walk_rts * p.baro_scale_walk_rts * dt_s


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
def inject(ins: Record, params: Rows) -> None:
    """Move the errors found into the state, and its past with it."""
    dx = ins.dx
    move(ins.position, dx[0], dx[1], dx[2])
    turn_frame(ins.quaternion, dx[TILT], dx[TILT + 1], dx[TILT + 2])
    for i in range(3):
        ins.velocity_n_mps[i] += dx[VELOCITY + i]
        ins.force_bias_b_mps2[i] += dx[FORCE_BIAS + i]
        ins.rate_bias_b_radps[i] += dx[RATE_BIAS + i]
    ins.b_m += dx[BARO_BIAS]
    ins.s += dx[BARO_SCALE]
    shift(ins.track, ins.time_us, dx[:VELOCITY], dx[VELOCITY:TILT])
    for i in range(N):
        dx[i] = 0.0
    speed = math.hypot(
        math.hypot(ins.velocity_n_mps[0], ins.velocity_n_mps[1]), ins.velocity_n_mps[2]
    )
    if not abs(ins.position[2]) < HIGHEST_M or not speed < FASTEST_MPS:
        ins_start(ins, params)


# Attitude


@step
def _align(ins: Record) -> None:
    """Begin to integrate: roll, pitch and gyro bias of the attitude component, yaw along the course
    or unknown."""
    set_attitude(ins.quaternion, roll_rad(ins.attitude), pitch_rad(ins.attitude), 0.0)
    sd_rad = tilt_sd_rad(ins.attitude)
    tilt_var = (
        sd_rad * sd_rad if sd_rad > 0.0 else MOVING_TILT_SD_RAD * MOVING_TILT_SD_RAD
    )  # the vehicle's alone
    for i in range(3):
        ins.rate_bias_b_radps[i] = ins.attitude.own.bias_b_radps[i]
        # An accelerometer bias tilts the level by bias / g.
        forget_error(ins, TILT + i, tilt_var + ins.P[FORCE_BIAS + i, FORCE_BIAS + i] / 96.0)
        forget_error(ins, RATE_BIAS + i, ins.attitude.own.bias_var)
    forget_error(ins, TILT + DOWN, UNKNOWN_YAW_SD_RAD * UNKNOWN_YAW_SD_RAD)
    ins.inertial, ins.yaw_known, ins.slip_s, ins.sink_s = 1, 0, 0.0, 0.0
    if ins.attitude.own.speed_mps > SLOWEST_COURSE_MPS:
        set_yaw(ins, ins.attitude.own.course_rad, course_sd_rad(ins.attitude.own.speed_mps))


@step
def set_yaw(ins: Record, yaw: float, sd_rad: float) -> None:
    """Turn the nose to `yaw` about the vertical."""
    turn_frame(ins.quaternion, 0.0, 0.0, wrapped(yaw - yaw_rad(ins.quaternion)))
    forget_error(ins, TILT + DOWN, sd_rad * sd_rad)
    ins.yaw_known = 1


@step
def course_sd_rad(speed_mps: float) -> float:
    """How far the nose may point beside the course."""
    return math.atan2(SIDE_WIND_MPS, speed_mps)


@step
def suspend(ins: Record, params: Rows) -> None:
    """Stop integrating for a while: h and b may have gone far together; climb, s and the IMU's
    biases are unknown."""
    p, P = params[0], ins.P
    ins.inertial, ins.slip_s, ins.sink_s = 0, 0.0, 0.0
    ins.rest_us = ins.time_us + REST_US
    forget_error(ins, BARO_SCALE, p.baro_scale_sd_ratio * p.baro_scale_sd_ratio)
    widen_common(P, RUNAWAY_M * RUNAWAY_M)
    for i in range(3):
        ins.force_bias_b_mps2[i], ins.rate_bias_b_radps[i] = 0.0, 0.0
        forget_error(ins, VELOCITY + i, UNKNOWN_CLIMB_MPS * UNKNOWN_CLIMB_MPS)
        forget_error(ins, FORCE_BIAS + i, p.accel_bias_sd_mps2 * p.accel_bias_sd_mps2)
        forget_error(ins, RATE_BIAS + i, p.gyro_bias_sd_radps * p.gyro_bias_sd_radps)
