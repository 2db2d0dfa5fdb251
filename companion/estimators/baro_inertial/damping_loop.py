"""Baro-inertial damping loop of the third order, its gains found by a genetic algorithm.

J. Keighobadi, H. Nourmohammadi, S. Rafatnia, "Design and Implementation of GA Filter Algorithm for
Baro-inertial Altitude Error Compensation". The paper's letters:

==============  =========================  =========================================================
h, V_z          ``h``, ``v``               altitude and climb (6)
a_c             ``a_c``                    compensator output: the accelerometer error
K1, K2, K3      ``K1, K2, K3``             feedback gains; (10) gives 3.00, .6452, .8710
H               ``calibrated``             barometer height, calibrated (2): see `baro_inertial`
A_z             ``acceleration_mps2``      upward acceleration
w_s             (in the local gravity)     Schuler frequency
==============  =========================  =========================================================

The loop is

    dh/dt = V_z - K1 (h - H)
    dV_z/dt = A_z - a_c + 2 w_s^2 h - K2 (h - H)
    da_c/dt = K3 (h - H)                                                                        (6)

with the poles of s^3 + K1 s^2 + (K2 - 2 w_s^2) s + K3, stable when K1 (K2 - 2 w_s^2) > K3. The
paper's gains have poles -2.8810 and -.0595 +- .5466 i: a damping ratio of .108, which rings for a
minute. `kollsman tune LOG --estimator damping-loop` finds others
(`companion.estimators.baro_inertial.tuning`).

Discretisation
--------------
Forward Euler, the usual choice, is unstable from a step of .394 s on. Here the IMU moves h and V_z
exactly (constant acceleration over its interval), and a barometer sample, T after the last one,
takes

    h -= alpha e,   V_z -= beta / T e,   a_c += gamma / T^2 e,      e = h - H

with the alpha, beta, gamma for which the error obeys exactly the continuous loop: its transition
over T has the eigenvalues exp(p T) of the loop's poles p (`loop_gains.matched_gains`). So it is
stable at every rate of the IMU and of the barometer if (6) is, becomes (6) for fast sensors, and a
slow barometer does not drag the altitude behind a climb, as one that is held between samples would.

Errata and departures of the input (the start height in place of (5), the sign of (1)) are told in
`baro_inertial`.

Departures
----------
- 2 w_s^2 h, the decrease of gravity with height, is in A_z: local gravity is taken at the GNSS
  height.
- GNSS gives the start height and the reported spread, no more. A lasting step of the
  barometer stays in the altitude, as it must in a baro-inertial loop: ``follows_baro_step`` is
  False.
- A barometer that is further than `baro_inertial.GATE_M` from the loop is GATED; after two seconds
  of that the loop starts anew at it, keeping a_c. The paper has no gate.
- Without an IMU that can be integrated (below about 10 Hz its samples are IGNORED) the loop runs on
  the barometer alone, with A_z = 0 and the gains of critical damping at 1 rad/s: K1 = 2, K2 = 1, K3
  = 0.

Breaks when
-----------
The weather changes or the column of air is not standard: every error of the barometer since the
start is the altitude's. The spread says so while there is GNSS, the altitude does not. With the
paper's gains anything that excites .55 rad/s (11 s: turns with a wrong attitude) is amplified three
times.
"""

import math
from collections.abc import Mapping
from typing import Any

from pydantic import Field, model_validator

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
from companion.estimators.baro_inertial.loop_gains import (
    BARO_ALONE,
    is_stable,
    matched_gains,
    poles,
)
from companion.estimators.baro_inertial.settings import InputSettings
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
    state_dtype,
    tally,
)
from companion.estimators.method import Method
from companion.estimators.setting import admit_setting
from companion.jit import step
from companion.kernels.attitude import attitude_vehicle
from companion.samples import Kind, Rows, Tables, readable, rows

LOOP_VAR_M2 = 0.25
"""variance of the loop's own error: barometer noise, and accelerometer noise through the gains"""

STATE = state_dtype(
    ("inputs", INPUTS),
    ("running", "i8"),
    ("x_us", "i8"),  # time of h, v, a_c
    ("corrected_us", "i8"),  # time of the last barometer sample that was taken in
    ("h", "f8"),
    ("v", "f8"),
    ("a_c", "f8"),
)


class DampingLoopSettings(InputSettings):
    """Section ``estimators.damping-loop``."""

    k1: float = Field(3.0, gt=0, le=100)
    """gain K1 of (6), 1/s; the defaults are the paper's"""
    k2: float = Field(0.6452, gt=0, le=100)
    """gain K2 of (6), 1/s2; the defaults are the paper's"""
    k3: float = Field(0.871, ge=0, le=100)
    """gain K3 of (6), 1/s3; the defaults are the paper's"""

    @model_validator(mode="after")
    def _is_stable(self) -> "DampingLoopSettings":
        if not is_stable(self.k1, self.k2, self.k3):
            raise ValueError("these gains are unstable: k1 (k2 - 3.1e-6) must exceed k3")
        return self

    def derived(self) -> Mapping[str, Any]:
        return {
            **super().derived(),
            "poles": poles(self.k1, self.k2, self.k3),
            "baro_alone_poles": poles(*BARO_ALONE),
        }


def init(params: Rows) -> Rows:
    """A fresh state: nothing known."""
    state = rows(STATE)
    start(state)
    return readable(state)


@step
def start(state: Rows) -> None:
    """Forget everything but the counters."""
    reset(state)
    start_inputs(state[0].inputs)
    s = state[0]
    s.running = 0
    s.x_us = -1
    s.corrected_us = -1
    s.h = math.nan
    s.v = math.nan
    s.a_c = 0.0


@step
def advance(state: Rows, time_us: int) -> None:
    """h and V_z of (6) to a later instant under constant acceleration; feedback comes with the
    barometer."""
    s = state[0]
    elapsed_s = (time_us - s.x_us) * 1e-6
    if s.running == 0 or elapsed_s <= 0.0:
        return
    acceleration = (
        0.0 if math.isnan(s.inputs.acceleration_mps2) else s.inputs.acceleration_mps2 - s.a_c
    )
    s.h += elapsed_s * (s.v + 0.5 * elapsed_s * acceleration)
    s.v += elapsed_s * acceleration
    s.x_us = time_us


@step
def feed_back(state: Rows, params: Rows, error_m: float, T: float) -> None:
    """The feedback of (6) over T, by its exact discrete gains."""
    s, p = state[0], params[0]
    if math.isnan(s.inputs.acceleration_mps2):
        alpha, beta, _ = matched_gains(
            p.baro_alone_poles[0], p.baro_alone_poles[1], p.baro_alone_poles[2], T
        )
    else:
        alpha, beta, gamma = matched_gains(p.poles[0], p.poles[1], p.poles[2], T)
        s.a_c += gamma * error_m
    s.h -= alpha * error_m
    s.v -= beta * error_m


@step
def on_imu(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A_z, and (6) up to now."""
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
    advance(state, sample[0].time_us)
    write_estimate(state, params, estimate)
    return tally(state, IMU, USED)


@step
def on_pressure(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """H, and the feedback of (6)."""
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
    advance(state, time_us)
    if s.running == 1:
        T = (time_us - s.corrected_us) * 1e-6
        error_m = s.h - s.v * (s.x_us - time_us) * 1e-6 - calibrated
        if abs(error_m) <= gate_m(s.inputs, T):
            feed_back(state, params, error_m, T)
            s.corrected_us, s.inputs.wait_us = time_us, -1
            write_estimate(state, params, estimate)
            return tally(state, PRESSURE, USED)
    climb_mps = waited_climb_mps(s.inputs, time_us, calibrated)
    if not math.isnan(climb_mps):
        s.running, s.x_us, s.corrected_us, s.h, s.v = 1, time_us, time_us, calibrated, climb_mps
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
            LOOP_VAR_M2,
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
    altitude_m = s.h - s.v * (s.x_us - sample[0].time_us) * 1e-6 if s.running == 1 else math.nan
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
        start(state)
        forget(estimate)
    return tally(state, STATUS, USED)


@step
def write_estimate(state: Rows, params: Rows, estimate: Rows) -> None:
    """The loop's altitude and climb."""
    s = state[0]
    if s.running == 1:
        write_altitude(
            s.inputs, params, estimate, s.x_us, s.h, s.v, LOOP_VAR_M2, s.last_us[PRESSURE, 0]
        )


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
    name="damping-loop",
    summary="third-order baro-inertial loop from a GNSS start height, gains by genetic search",
    citation="Keighobadi, Nourmohammadi, Rafatnia",
    settings=DampingLoopSettings,
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
)
