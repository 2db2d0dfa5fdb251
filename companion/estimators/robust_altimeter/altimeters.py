"""The two integrated altimeters of `robust_altimeter` on a vehicle: mechanisation, iterations,
isolation of faults.

Altimeter k (IBI 0, by the barometer; IIG 1, by GNSS) has a mechanised channel (``height_m[k]``,
``climb_mps[k]``) and the filter of its errors (``x[k]``, ``P[k]``, see `vertical_error`). Per
sample: `advance` mechanises, `extrapolate_errors` begins an iteration when one is due, `gather`
keeps a measurement, `correct_errors` ends the iteration and feeds the estimated errors of height
and climb back.
"""

import math
from typing import Any

from companion.estimators.judging import GATED, GNSS, PRESSURE, USED
from companion.estimators.robust_altimeter.error_model import (
    IBI,
    IIG,
    MODEL_FIELDS,
    NORMAL_SIGMAS,
    STATES,
    extrapolate,
    innovation,
    take_in,
)
from companion.estimators.robust_altimeter.isolation import (
    ISOLATION_FIELDS,
    TRUST_IBIG,
    align_datum,
    isolate,
    isolation_start,
)
from companion.jit import step
from companion.kernels.kalman import spread
from companion.kernels.ring import clear, push, ring_fields, shift
from companion.samples import Rows

RING_SIZE, RING_SPACING_US = 64, 25_000
LOST_SD_M = 100.0
"""An altimeter that knows this little starts anew with the next measurement."""
NORMAL_TIME_S = 3.0
FRESH_US = 2_000_000

ALTIMETER_FIELDS: tuple[tuple[Any, ...], ...] = (
    ("inertial", "i8"),  # 1 while the IMU is integrated
    ("ins_us", "i8"),  # until when the channels are mechanised, -1 never
    ("up_mps2", "f8"),  # newest upward acceleration
    ("runs", "i8", (2,)),
    ("height_m", "f8", (2,)),
    ("climb_mps", "f8", (2,)),
    ("x", "f8", (2, STATES)),
    ("P", "f8", (2, STATES, STATES)),
    ("K", "f8", (STATES,)),
    ("Z_sum", "f8", (2, 2)),  # of an altimeter's measurements within 3 sigma, and beyond
    ("Z_count", "i8", (2, 2)),
    ("iteration_us", "i8"),
    ("prob", "f8", (2,)),
    ("normal", "f8", (2,)),  # its mean over NORMAL_TIME_S
    ("refused_s", "f8", (2,)),  # for how long it has been below 0.5
    *ring_fields("iig", RING_SIZE),  # recent heights of IIG
    ("ring_us", "i8"),
    *ISOLATION_FIELDS,
    ("sigma_gps_m", "f8"),
)
"""The state fields of this component."""

ALTIMETER_PARAMS: tuple[tuple[Any, ...], ...] = (
    *MODEL_FIELDS,
    ("alpha", "f8", (2,)),  # 1/s: without the IMU (0), with it (1)
    ("sigma_a", "f8", (2,)),  # of U_Delta_az, the same
    ("P_a", "f8", (2,)),  # variance of the acceleration error at the start, the same
    ("rows_H", "f8", (2, STATES)),  # (7), (14)
    ("sigma_INS", "f8"),
    ("sigma_B", "f8"),
    ("sigma_GPS", "f8"),  # at least
    ("sigma_GPS_unknown", "f8"),
    ("P_W", "f8"),
    ("P_g", "f8"),
    ("reacquire_s", "f8", (2,)),  # without the IMU (0), with it (1)
    ("reference_s", "f8"),
    ("blame_imu", "i8"),  # whether both altimeters may re-acquire at once
    ("robust", "i8"),
)
"""What a params dtype holds for it."""


@step
def altimeters_start(state: Rows) -> None:
    """Nothing known."""
    s = state[0]
    s.inertial = 0
    s.ins_us = s.iteration_us = -1
    s.up_mps2 = 0.0
    for k in range(2):
        stop(state, k)
    isolation_start(state)
    s.sigma_gps_m = math.nan


@step
def stop(state: Rows, k: int) -> None:
    """Altimeter `k` knows nothing."""
    s = state[0]
    s.runs[k] = 0
    s.height_m[k] = math.nan
    s.climb_mps[k] = math.nan
    s.prob[k] = math.nan
    s.normal[k] = 1.0
    s.refused_s[k] = 0.0
    s.doubt_s[k] = 0.0
    discard(state, k)
    if k == IIG:
        clear(s.iig_us, s.iig_values)
        s.ring_us = -1


@step
def begin(state: Rows, params: Rows, k: int, height_m: float) -> None:
    """Start altimeter `k` at a height; its climb is that of the other one, if that runs, else
    unknown."""
    s, p = state[0], params[0]
    stop(state, k)
    s.runs[k] = 1
    s.height_m[k] = height_m
    s.climb_mps[k] = s.climb_mps[1 - k] if s.runs[1 - k] == 1 else 0.0
    for i in range(STATES):
        s.x[k, i] = 0.0
        for j in range(STATES):
            s.P[k, i, j] = 0.0
    s.P[k, 0, 0], s.P[k, 1, 1] = height_variance(state, params, k), p.P_W
    s.P[k, 2, 2], s.P[k, 3, 3] = p.P_a[s.inertial], p.P_g
    s.P[k, 4, 4] = p.sigma_B * p.sigma_B


@step
def height_variance(state: Rows, params: Rows, k: int) -> float:
    """R of altimeter `k` (13), (18); without an inertial channel there is no error of one in it."""
    s, p = state[0], params[0]
    inertial = p.sigma_INS * p.sigma_INS if s.inertial == 1 else 0.0
    return inertial + (p.sigma_B * p.sigma_B if k == IBI else s.sigma_gps_m * s.sigma_gps_m)


@step
def advance(state: Rows, time_us: int, up_mps2: float) -> None:
    """Mechanise both channels to `time_us` with an upward acceleration less its estimated errors."""
    s = state[0]
    if s.ins_us >= 0:
        dt = max(0.0, (time_us - s.ins_us) * 1e-6)
        for k in range(2):
            a = up_mps2 - s.x[k, 2] - s.x[k, 3]
            s.height_m[k] += dt * (s.climb_mps[k] + 0.5 * dt * a)
            s.climb_mps[k] += dt * a
    s.ins_us = max(s.ins_us, time_us)
    if s.runs[IIG] == 1 and (s.ring_us < 0 or s.ins_us - s.ring_us >= RING_SPACING_US):
        push(s.iig_us, s.iig_values, s.ins_us, s.height_m[IIG])
        s.ring_us = s.ins_us


@step
def switch(state: Rows, params: Rows, inertial: int) -> None:
    """Go over to the error model with the IMU (1) or without: what is known of the acceleration is
    of no more use."""
    s = state[0]
    if s.inertial != inertial:
        s.inertial = inertial
        for k in range(2):
            forget_acceleration(state, k, params[0].P_a[inertial])


@step
def forget_acceleration(state: Rows, k: int, variance: float) -> None:
    """Start the estimate of altimeter `k`'s acceleration error anew."""
    s = state[0]
    s.x[k, 2] = 0.0
    for i in range(STATES):
        s.P[k, 2, i] = 0.0
        s.P[k, i, 2] = 0.0
    s.P[k, 2, 2] = variance


@step
def is_abnormal(state: Rows, params: Rows, k: int, Z: float) -> bool:
    """Whether the innovation of altimeter `k` lies beyond 3 sigma, where prob(1/i) is below 0.5."""
    s, H = state[0], params[0].rows_H[k]
    S = spread(s.P[k], H) + height_variance(state, params, k)
    return abs(innovation(s.x[k], H, Z)) > NORMAL_SIGMAS * math.sqrt(S)


@step
def gather(state: Rows, params: Rows, k: int, Z: float) -> int:
    """Keep a measurement for the next iteration. GATED when the robust gain will not believe it."""
    s = state[0]
    abnormal = 1 if params[0].robust == 1 and is_abnormal(state, params, k, Z) else 0
    s.Z_sum[k, abnormal] += Z
    s.Z_count[k, abnormal] += 1
    return GATED if abnormal == 1 else USED


@step
def discard(state: Rows, k: int) -> None:
    """Forget what was gathered."""
    for j in range(2):
        state[0].Z_sum[k, j] = 0.0
        state[0].Z_count[k, j] = 0


@step
def gathered(state: Rows, k: int) -> float:
    """Mean of what was gathered: of what is within 3 sigma, else of the rest; NaN when there is
    nothing."""
    s = state[0]
    for j in range(2):
        if s.Z_count[k, j] > 0:
            return s.Z_sum[k, j] / s.Z_count[k, j]
    return math.nan


@step
def extrapolate_errors(state: Rows, params: Rows) -> float:
    """Begin an iteration of the paper if T_d is over: its length, or 0 while it is too early."""
    s, p = state[0], params[0]
    T = (s.now_us - s.iteration_us) * 1e-6
    if s.iteration_us < 0 or p.T_d - 1e-3 <= T:
        s.iteration_us, first = s.now_us, s.iteration_us < 0
        if first:
            return 0.0
        for k in range(2):
            if s.runs[k] == 1:
                extrapolate(s.x[k], s.P[k], T, p.alpha[s.inertial], p.sigma_a[s.inertial], params)
                s.x[k, 0], s.x[k, 1] = 0.0, 0.0  # the mechanisation has taken these errors along
                if T > FRESH_US * 1e-6:
                    discard(state, k)
        return T
    return 0.0


@step
def correct_errors(state: Rows, params: Rows, T: float) -> None:
    """End an iteration: correct with what was gathered, isolate, align the datum."""
    s = state[0]
    if params[0].blame_imu == 1 and s.inertial == 1 and imu_is_contradicted(state, params):
        for k in range(2):
            reacquire(state, params, k, gathered(state, k))
            forget_acceleration(state, k, params[0].P_a[0])
    for k in range(2):
        if s.runs[k] == 1:
            estimate_errors(state, params, k, T)
    isolate(state, T)
    heard = min(s.last_us[PRESSURE, 0], s.last_us[GNSS, 0]) > max(0, s.now_us - FRESH_US)
    if heard and s.runs[IBI] == 1 and s.runs[IIG] == 1 and s.trust == TRUST_IBIG:
        align_datum(state, params, T)


@step
def imu_is_contradicted(state: Rows, params: Rows) -> bool:
    """Whether both altimeters refuse their measurements for the second time, and in the same
    direction.

    What they have in common is the IMU. (The same bias on both sensors at once would look alike.)
    """
    s = state[0]
    Z_ibi, Z_iig = gathered(state, IBI), gathered(state, IIG)
    if not Z_ibi * Z_iig > 0.0 or not (s.refused_s[IBI] > 0.0 and s.refused_s[IIG] > 0.0):
        return False
    return is_abnormal(state, params, IBI, Z_ibi) and is_abnormal(state, params, IIG, Z_iig)


@step
def reacquire(state: Rows, params: Rows, k: int, Z: float) -> None:
    """Believe a measurement: height anew from it, climb from the other altimeter unless that
    refuses as well."""
    s, p = state[0], params[0]
    wrong_m = innovation(s.x[k], p.rows_H[k], Z)
    s.height_m[k] -= wrong_m
    if k == IIG:
        shift(s.iig_values, -wrong_m)
    for j in range(2):
        s.Z_sum[k, j] -= wrong_m * s.Z_count[k, j]
    other = 1 - k
    if s.runs[other] == 1 and s.refused_s[other] == 0.0:
        s.climb_mps[k] = s.climb_mps[other]
    for i in range(STATES):
        for j in range(2):
            s.P[k, i, j] = 0.0
            s.P[k, j, i] = 0.0
    s.P[k, 0, 0], s.P[k, 1, 1] = height_variance(state, params, k), p.P_W


@step
def estimate_errors(state: Rows, params: Rows, k: int, T: float) -> None:
    """Correct altimeter `k` with the mean of what was gathered, and feed its errors of height and
    climb back."""
    s, p = state[0], params[0]
    if math.isnan(gathered(state, k)):
        return
    if s.refused_s[k] >= p.reacquire_s[s.inertial]:
        reacquire(state, params, k, gathered(state, k))
    x, R = s.x[k], height_variance(state, params, k)
    s.prob[k] = take_in(x, s.P[k], p.rows_H[k], s.K, gathered(state, k), R, p.robust == 1)
    s.refused_s[k] = s.refused_s[k] + T if s.prob[k] < 0.5 else 0.0
    s.normal[k] += T / (T + NORMAL_TIME_S) * (s.prob[k] - s.normal[k])
    s.height_m[k] -= x[0]
    s.climb_mps[k] -= x[1]
    if k == IIG:
        shift(s.iig_values, -x[0])
    x[0], x[1] = 0.0, 0.0
    discard(state, k)


@step
def lost(state: Rows, k: int) -> bool:
    """Whether altimeter `k` does not run, or knows next to nothing."""
    s = state[0]
    return s.runs[k] == 0 or not s.P[k, 0, 0] < LOST_SD_M * LOST_SD_M
