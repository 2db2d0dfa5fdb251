"""Baro-inertial Kalman filter: the baseline that the damping loop's authors compare it with,
corrected.

J. Keighobadi, H. Nourmohammadi, S. Rafatnia, "Design and Implementation of GA Filter Algorithm for
Baro-inertial Altitude Error Compensation", section IV.C (after Ausman 1991). The paper's letters:

==============  =========================  =========================================================
V_z, h, b       ``x[0], x[1], x[2]``       climb, altitude, barometer bias (11)-(12), (14)
(none)          ``x[3]``                   accelerometer bias, which the paper leaves out
H               ``calibrated``             barometer height, calibrated (2): see `baro_inertial`
A_z             ``acceleration_mps2``      upward acceleration
beta, sigma     ``beta_ps``, ``sigma_m``   of the bias: a first-order Gauss-Markov process (12)
v_a             ``R_m2``                   white noise of the barometer (16)
P, K            ``P, K``                   covariance of x, gain
==============  =========================  =========================================================

    dV_z/dt = A_z - a + w,   dh/dt = V_z,   db/dt = -beta b + sqrt(2 beta sigma^2) w_b    (11)-(15)
    H = h + b + v_a                                                                            (16)

with a the accelerometer bias, also Gauss-Markov, if ``accelerometer_bias_state`` is on.

Errata
------
- (15) puts the noise of b on the row of delta h. It belongs to b.
- beta of (12) is called a correlation time; it is the inverse of one.
- (11) feeds the whole of A_z into a model of errors. A_z moves h and V_z; their errors grow with
  the error of A_z alone.

Departures
----------
- The states are altitude and climb instead of their errors, which is the same filter when the
  estimated errors are fed back at once. 2 w_s^2 h, the decrease of gravity with height, is in A_z
  (local gravity).
- The accelerometer bias state (default on). Without it a bias of the accelerometer drags the
  altitude for ever, and only then does the damping loop beat this filter.
- Start height, gate, restart, GNSS for the spread: as in `damping_loop`, with the same constants.
  The spread of the estimate is that of P together with that of the reference
  (`baro_inertial.reference_sd_m`); P knows nothing of the weather.
- Without an IMU that can be integrated (below about 10 Hz its samples are IGNORED) A_z = 0, with
  the noise of an unknown acceleration.

Breaks when
-----------
The same as `damping_loop`: every lasting error of the barometer is the altitude's, since b has mean
zero.
"""

import math

from companion.estimators.baro_inertial.inputs import (
    HIGHEST_PA,
    INPUTS,
    LOWEST_PA,
    baro_is_silent,
    fuse_setting,
    gate_m,
    note_fix,
    note_start_temperature,
    start_inputs,
    take_imu,
    take_pressure,
    waited_climb_mps,
    write_altitude,
)
from companion.estimators.baro_inertial.settings import BaroInsKfSettings
from companion.estimators.judging import (
    AIR,
    ATTITUDE,
    GATED,
    GNSS,
    IGNORED,
    IMU,
    PRESSURE,
    STATUS,
    USED,
    forget,
    judge_attitude,
    judge_gnss,
    judge_imu,
    judge_pressure,
    place,
    reset,
    score,
    state_dtype,
    tally,
)
from companion.estimators.method import Method
from companion.estimators.setting import admit_setting
from companion.jit import step
from companion.kernels.attitude import attitude_vehicle
from companion.kernels.kalman import correct
from companion.samples import Kind, Rows, Tables, readable, rows

V, ALTITUDE, BIAS, ACCELERATION = range(4)
START_CLIMB_VAR = 1.0
"""variance of the barometer's slope over two seconds, (m/s)2"""

STATE = state_dtype(
    ("inputs", INPUTS),
    ("running", "i8"),
    ("x_us", "i8"),  # time of x
    ("corrected_us", "i8"),  # time of the last barometer sample that was taken in
    ("x", "f8", (4,)),
    ("P", "f8", (4, 4)),
    ("H", "f8", (4,)),
    ("K", "f8", (4,)),
)


def init(params: Rows) -> Rows:
    """A fresh state: nothing known."""
    state = rows(STATE)
    start(state, params)
    return readable(state)


@step
def start(state: Rows, params: Rows) -> None:
    """Forget everything but the counters."""
    reset(state)
    start_inputs(state[0].inputs)
    s = state[0]
    s.running = 0
    s.x_us = -1
    s.corrected_us = -1
    for i in range(4):
        s.x[i] = 0.0
        s.K[i] = 0.0
        s.H[i] = 1.0 if i in (ALTITUDE, BIAS) else 0.0
        for j in range(4):
            s.P[i, j] = 0.0
    s.P[ACCELERATION, ACCELERATION] = params[0].bias_mps2 * params[0].bias_mps2


@step
def start_at(state: Rows, params: Rows, time_us: int, calibrated: float, climb_mps: float) -> None:
    """Altitude and climb as the barometer has them, b = 0 with the spread of (12); the acceleration
    bias stays."""
    s, p = state[0], params[0]
    bias_var = p.sigma_m * p.sigma_m
    s.running, s.x_us, s.corrected_us = 1, time_us, time_us
    s.x[V], s.x[ALTITUDE], s.x[BIAS] = climb_mps, calibrated, 0.0
    for i in range(3):
        for j in range(4):
            s.P[i, j], s.P[j, i] = 0.0, 0.0
    s.P[V, V] = START_CLIMB_VAR
    s.P[ALTITUDE, ALTITUDE] = p.R_m2 + bias_var
    s.P[BIAS, BIAS] = bias_var
    s.P[ALTITUDE, BIAS], s.P[BIAS, ALTITUDE] = -bias_var, -bias_var


@step
def advance(state: Rows, params: Rows, time_us: int) -> None:
    """x of (13) to a later instant, exact for constant A_z."""
    s, p = state[0], params[0]
    elapsed_s = (time_us - s.x_us) * 1e-6
    if s.running == 0 or elapsed_s <= 0.0:
        return
    acceleration = (
        0.0
        if math.isnan(s.inputs.acceleration_mps2)
        else s.inputs.acceleration_mps2 - s.x[ACCELERATION]
    )
    s.x[ALTITUDE] += elapsed_s * (s.x[V] + 0.5 * elapsed_s * acceleration)
    s.x[V] += elapsed_s * acceleration
    s.x[BIAS] *= math.exp(-p.beta_ps * elapsed_s)
    s.x[ACCELERATION] *= math.exp(-p.bias_beta_ps * elapsed_s)
    s.x_us = time_us


@step
def spread_out(state: Rows, params: Rows, T: float) -> None:
    """P = Phi P Phi' + Q over T, once a barometer sample: nothing reads it in between."""
    s, p = state[0], params[0]
    P = s.P
    alone = math.isnan(s.inputs.acceleration_mps2)
    g = 0.0 if alone else -T  # what the accelerometer bias does to the climb
    phi_b, phi_a = math.exp(-p.beta_ps * T), math.exp(-p.bias_beta_ps * T)
    for j in range(4):  # Phi P
        P[ALTITUDE, j] += T * (P[V, j] + 0.5 * g * P[ACCELERATION, j])
        P[V, j] += g * P[ACCELERATION, j]
        P[BIAS, j] *= phi_b
        P[ACCELERATION, j] *= phi_a
    for i in range(4):  # (Phi P) Phi'
        P[i, ALTITUDE] += T * (P[i, V] + 0.5 * g * P[i, ACCELERATION])
        P[i, V] += g * P[i, ACCELERATION]
        P[i, BIAS] *= phi_b
        P[i, ACCELERATION] *= phi_a
    q = p.baro_alone_q_m2ps3 if alone else p.q_m2ps3
    walk = (
        p.bias_mps2 * p.bias_mps2 * (1.0 - phi_a * phi_a)
    )  # of the accelerometer bias, and what it did meanwhile
    P[V, V] += q * T + g * g * walk / 3.0
    P[ALTITUDE, V] += 0.5 * q * T * T
    P[ALTITUDE, ALTITUDE] += q * T * T * T / 3.0
    P[BIAS, BIAS] += p.sigma_m * p.sigma_m * (1.0 - phi_b * phi_b)
    P[ACCELERATION, V] += 0.5 * g * walk
    P[ACCELERATION, ALTITUDE] += g * T * walk / 6.0
    P[ACCELERATION, ACCELERATION] += walk
    for i in range(4):
        for j in range(i):
            P[j, i] = P[i, j]


@step
def on_imu(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A_z, and (13) up to now."""
    s = state[0]
    if sample[0].instance != 0:
        return tally(state, IMU, IGNORED)
    verdict = judge_imu(state, sample)
    if verdict != USED:
        return tally(state, IMU, verdict)
    place(state, IMU, 0, sample[0].time_us)
    if not take_imu(s.inputs, sample):
        return tally(state, IMU, IGNORED)
    if baro_is_silent(s.last_us[PRESSURE, 0], sample[0].time_us):
        s.running = 0
    advance(state, params, sample[0].time_us)
    write_estimate(state, params, estimate)
    return tally(state, IMU, USED)


@step
def on_pressure(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """The measurement (16)."""
    s = state[0]
    if sample[0].instance != 0:
        return tally(state, PRESSURE, IGNORED)
    verdict = judge_pressure(state, sample, LOWEST_PA, HIGHEST_PA)
    if verdict != USED:
        return tally(state, PRESSURE, verdict)
    time_us = sample[0].time_us
    if baro_is_silent(s.last_us[PRESSURE, 0], time_us):
        s.running, s.inputs.wait_us = 0, -1
    place(state, PRESSURE, 0, time_us)
    calibrated = take_pressure(s.inputs, params, sample, s.last_us[IMU, 0])
    if math.isnan(calibrated):
        return tally(state, PRESSURE, USED)
    advance(state, params, time_us)
    if s.running == 1:
        T = (time_us - s.corrected_us) * 1e-6
        innovation = calibrated - s.x[ALTITUDE] - s.x[BIAS] + s.x[V] * (s.x_us - time_us) * 1e-6
        if abs(innovation) <= gate_m(s.inputs, T):
            spread_out(state, params, T)
            S = correct(s.x, s.P, s.H, s.K, innovation, params[0].R_m2)
            score(state, innovation, S)
            s.corrected_us, s.inputs.wait_us = time_us, -1
            write_estimate(state, params, estimate)
            return tally(state, PRESSURE, USED)
    climb_mps = waited_climb_mps(s.inputs, time_us, calibrated)
    if not math.isnan(climb_mps):
        start_at(state, params, time_us, calibrated, climb_mps)
    elif s.running == 1:
        return tally(state, PRESSURE, GATED)
    else:
        write_altitude(
            s.inputs,
            params,
            estimate,
            time_us,
            calibrated,
            math.nan,
            params[0].R_m2,
            s.last_us[PRESSURE, 0],
        )
    write_estimate(state, params, estimate)
    return tally(state, PRESSURE, USED)


@step
def on_gnss(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """The start height; after it the reported spread."""
    s = state[0]
    if sample[0].instance != 0:
        return tally(state, GNSS, IGNORED)
    verdict = judge_gnss(state, sample)
    if verdict != USED:
        return tally(state, GNSS, verdict)
    place(state, GNSS, 0, sample[0].time_us)
    altitude_m = (
        s.x[ALTITUDE] - s.x[V] * (s.x_us - sample[0].time_us) * 1e-6 if s.running == 1 else math.nan
    )
    note_fix(s.inputs, params, sample, estimate, altitude_m, s.now_us, s.last_us[PRESSURE, 0])
    return tally(state, GNSS, USED)


@step
def on_air(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """The setting of the altimeter: the start height where GNSS gives none; and until the start the
    air temperature, T of (3)."""
    s = state[0]
    verdict = admit_setting(state, sample, s.inputs.start_us < 0)
    if verdict == USED:
        note_start_temperature(s.inputs, sample)
        fuse_setting(s.inputs, sample)
    return verdict


@step
def on_attitude(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """The autopilot's roll and pitch, if wanted."""
    if sample[0].instance != 0 or params[0].use_attitude == 0:
        return tally(state, ATTITUDE, IGNORED)
    verdict = judge_attitude(state, sample)
    if verdict == USED:
        place(state, ATTITUDE, 0, sample[0].time_us)
        attitude_vehicle(state[0].inputs.attitude, sample)
    return tally(state, ATTITUDE, verdict)


@step
def on_status(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A reboot restarts the vehicle's clock: start anew."""
    if sample[0].reboot == 1:
        start(state, params)
        forget(estimate)
    return tally(state, STATUS, USED)


@step
def write_estimate(state: Rows, params: Rows, estimate: Rows) -> None:
    """Altitude and climb of x, with their variances in P."""
    s = state[0]
    if s.running == 1:
        write_altitude(
            s.inputs,
            params,
            estimate,
            s.x_us,
            s.x[ALTITUDE],
            s.x[V],
            s.P[ALTITUDE, ALTITUDE],
            s.last_us[PRESSURE, 0],
        )
        estimate[0].climb_sd_mps = math.sqrt(s.P[V, V])


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
        elif kind == AIR:
            verdicts[i] = on_air(state, params, tables.air[row : row + 1], estimate)
        elif kind == STATUS:
            verdicts[i] = on_status(state, params, tables.status[row : row + 1], estimate)


METHOD = Method(
    name="baro-ins-kf",
    summary="baro-inertial Kalman filter from a GNSS start height, with or without accelerometer "
    "bias",
    citation="Keighobadi, Nourmohammadi, Rafatnia",
    settings=BaroInsKfSettings,
    state=STATE,
    init=init,
    steps={
        Kind.IMU: on_imu,
        Kind.PRESSURE: on_pressure,
        Kind.GNSS: on_gnss,
        Kind.ATTITUDE: on_attitude,
        Kind.AIR: on_air,
        Kind.STATUS: on_status,
    },
    run=run,
    datum_invariant=False,
    follows_baro_step=False,
    tunable=(
        "baro_bias_sd_m",
        "baro_bias_time_s",
        "baro_sd_m",
        "acceleration_noise_mps2_rthz",
        "unknown_acceleration_mps2_rthz",
        "accelerometer_bias_sd_mps2",
    ),
)
