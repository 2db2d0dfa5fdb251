"""The two integrated altimeters on a vehicle: mechanisation, iterations,
isolation of faults.

Altimeter k (IBI 0, by the barometer; IIG 1, by GNSS) has a mechanised channel (``height_m[k]``,
``climb_mps[k]``) and the filter of its errors (``x[k]``, ``P[k]``, see `error_model`). Per
sample: `advance` mechanises, `extrapolate_errors` begins an iteration when one is due, `gather`
keeps a measurement, `correct_errors` ends the iteration and feeds the estimated errors of height
and climb back.
"""

import math

import numpy as np

from companion.estimators.judging import GATED, USED
from companion.estimators.robust_altimeter.error_model import (
    IBI,
    IIG,
    NORMAL_SIGMAS,
    STATES,
    extrapolate,
    innovation,
    take_in,
)
from companion.estimators.robust_altimeter.isolation import (
    DATUM,
    ISOLATION,
    TRUST_IBIG,
    align_datum,
    isolate,
    isolation_start,
)
from companion.jit import step
from companion.kernels.kalman import spread
from companion.kernels.ring import clear, push, ring_fields, shift
from companion.samples import Record, Rows

RING_SIZE, RING_SPACING_US = 64, 25_000
LOST_SD_M = 100.0
"""An altimeter with a larger spread of its own starts anew with the next measurement."""
NORMAL_TIME_S = 3.0
FRESH_US = 2_000_000

PAIR = np.dtype(
    [
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
        ("isolation", ISOLATION),
        ("datum", DATUM),
        ("sigma_gps_m", "f8"),
    ],
    align=True,
)
"""The record of this component."""


@step
def altimeters_start(pair: Record) -> None:
    """Nothing known."""
    pair.inertial = 0
    pair.ins_us = pair.iteration_us = -1
    pair.up_mps2 = 0.0
    for k in range(2):
        stop(pair, k)
    isolation_start(pair)
    pair.sigma_gps_m = math.nan


@step
def stop(pair: Record, k: int) -> None:
    """Altimeter `k` knows nothing."""
    pair.runs[k] = 0
    pair.height_m[k] = math.nan
    pair.climb_mps[k] = math.nan
    pair.prob[k] = math.nan
    pair.normal[k] = 1.0
    pair.refused_s[k] = 0.0
    pair.isolation.doubt_s[k] = 0.0
    discard(pair, k)
    if k == IIG:
        clear(pair.iig_us, pair.iig_values)
        pair.ring_us = -1


@step
def begin(pair: Record, params: Rows, k: int, height_m: float) -> None:
    """Start altimeter `k` at a height; its climb is that of the other one, if that runs, else
    unknown."""
    p = params[0]
    stop(pair, k)
    pair.runs[k] = 1
    pair.height_m[k] = height_m
    pair.climb_mps[k] = pair.climb_mps[1 - k] if pair.runs[1 - k] == 1 else 0.0
    for i in range(STATES):
        pair.x[k, i] = 0.0
        for j in range(STATES):
            pair.P[k, i, j] = 0.0
    pair.P[k, 0, 0], pair.P[k, 1, 1] = height_variance(pair, params, k), p.P_W
    pair.P[k, 2, 2], pair.P[k, 3, 3] = p.P_a[pair.inertial], p.P_g
    pair.P[k, 4, 4] = p.sigma_B * p.sigma_B


@step
def height_variance(pair: Record, params: Rows, k: int) -> float:
    """R of altimeter `k` (13), (18); without an inertial channel there is no error of one in it."""
    p = params[0]
    inertial = p.sigma_INS * p.sigma_INS if pair.inertial == 1 else 0.0
    return inertial + (p.sigma_B * p.sigma_B if k == IBI else pair.sigma_gps_m * pair.sigma_gps_m)


@step
def advance(pair: Record, time_us: int, up_mps2: float) -> None:
    """Mechanise both channels to `time_us` with an upward acceleration less its estimated
    errors."""
    if pair.ins_us >= 0:
        dt = max(0.0, (time_us - pair.ins_us) * 1e-6)
        for k in range(2):
            a = up_mps2 - pair.x[k, 2] - pair.x[k, 3]
            pair.height_m[k] += dt * (pair.climb_mps[k] + 0.5 * dt * a)
            pair.climb_mps[k] += dt * a
    pair.ins_us = max(pair.ins_us, time_us)
    if pair.runs[IIG] == 1 and (pair.ring_us < 0 or pair.ins_us - pair.ring_us >= RING_SPACING_US):
        push(pair.iig_us, pair.iig_values, pair.ins_us, pair.height_m[IIG])
        pair.ring_us = pair.ins_us


@step
def switch(pair: Record, params: Rows, inertial: int) -> None:
    """Go over to the error model with the IMU (1) or without: what is known of the acceleration is
    of no more use."""
    if pair.inertial != inertial:
        pair.inertial = inertial
        for k in range(2):
            forget_acceleration(pair, k, params[0].P_a[inertial])


@step
def forget_acceleration(pair: Record, k: int, variance: float) -> None:
    """Start the estimate of altimeter `k`'s acceleration error anew."""
    pair.x[k, 2] = 0.0
    for i in range(STATES):
        pair.P[k, 2, i] = 0.0
        pair.P[k, i, 2] = 0.0
    pair.P[k, 2, 2] = variance


@step
def is_abnormal(pair: Record, params: Rows, k: int, Z: float) -> bool:
    """Whether the innovation of altimeter `k` lies beyond 3 sigma, where prob(1/i) is below 0.5."""
    H = params[0].rows_H[k]
    S = spread(pair.P[k], H) + height_variance(pair, params, k)
    return abs(innovation(pair.x[k], H, Z)) > NORMAL_SIGMAS * math.sqrt(S)


@step
def gather(pair: Record, params: Rows, k: int, Z: float) -> int:
    """Keep a measurement for the next iteration. GATED when the robust gain rejects it."""
    abnormal = 1 if params[0].robust == 1 and is_abnormal(pair, params, k, Z) else 0
    pair.Z_sum[k, abnormal] += Z
    pair.Z_count[k, abnormal] += 1
    return GATED if abnormal == 1 else USED


@step
def discard(pair: Record, k: int) -> None:
    """Forget what was gathered."""
    for j in range(2):
        pair.Z_sum[k, j] = 0.0
        pair.Z_count[k, j] = 0


@step
def gathered(pair: Record, k: int) -> float:
    """Mean of what was gathered: of what is within 3 sigma, else of the rest; NaN when there is
    nothing."""
    for j in range(2):
        if pair.Z_count[k, j] > 0:
            return pair.Z_sum[k, j] / pair.Z_count[k, j]
    return math.nan


@step
def extrapolate_errors(pair: Record, params: Rows, now_us: int) -> float:
    """Begin an iteration of the paper if T_d is over: its length, or 0 while it is too early."""
    p = params[0]
    T = (now_us - pair.iteration_us) * 1e-6
    if pair.iteration_us < 0 or p.T_d - 1e-3 <= T:
        pair.iteration_us, first = now_us, pair.iteration_us < 0
        if first:
            return 0.0
        for k in range(2):
            if pair.runs[k] == 1:
                extrapolate(
                    pair.x[k],
                    pair.P[k],
                    T,
                    p.alpha[pair.inertial],
                    p.sigma_a[pair.inertial],
                    params,
                )
                pair.x[k, 0], pair.x[k, 1] = (
                    0.0,
                    0.0,
                )  # the mechanisation has taken these errors along
                if T > FRESH_US * 1e-6:
                    discard(pair, k)
        return T
    return 0.0


@step
def correct_errors(pair: Record, params: Rows, now_us: int, T: float, aligns: bool) -> None:
    """End an iteration: correct with what was gathered, isolate, align the datum if it `aligns`."""
    if params[0].may_doubt_imu == 1 and pair.inertial == 1 and imu_is_contradicted(pair, params):
        for k in range(2):
            reacquire(pair, params, k, gathered(pair, k))
            forget_acceleration(pair, k, params[0].P_a[0])
    for k in range(2):
        if pair.runs[k] == 1:
            estimate_errors(pair, params, k, T)
    isolate(pair, now_us, T)
    if (
        aligns
        and pair.runs[IBI] == 1
        and pair.runs[IIG] == 1
        and pair.isolation.trust == TRUST_IBIG
    ):
        align_datum(pair, params, T)


@step
def imu_is_contradicted(pair: Record, params: Rows) -> bool:
    """Whether both altimeters refuse their measurements for the second time, and in the same
    direction.

    What they have in common is the IMU. (The same bias on both sensors at once would look alike.)
    """
    Z_ibi, Z_iig = gathered(pair, IBI), gathered(pair, IIG)
    if not Z_ibi * Z_iig > 0.0 or not (pair.refused_s[IBI] > 0.0 and pair.refused_s[IIG] > 0.0):
        return False
    return is_abnormal(pair, params, IBI, Z_ibi) and is_abnormal(pair, params, IIG, Z_iig)


@step
def reacquire(pair: Record, params: Rows, k: int, Z: float) -> None:
    """Start from a measurement: height from it, climb from the other altimeter unless that
    refuses as well."""
    p = params[0]
    wrong_m = innovation(pair.x[k], p.rows_H[k], Z)
    pair.height_m[k] -= wrong_m
    if k == IIG:
        shift(pair.iig_values, -wrong_m)
    for j in range(2):
        pair.Z_sum[k, j] -= wrong_m * pair.Z_count[k, j]
    other = 1 - k
    if pair.runs[other] == 1 and pair.refused_s[other] == 0.0:
        pair.climb_mps[k] = pair.climb_mps[other]
    for i in range(STATES):
        for j in range(2):
            pair.P[k, i, j] = 0.0
            pair.P[k, j, i] = 0.0
    pair.P[k, 0, 0], pair.P[k, 1, 1] = height_variance(pair, params, k), p.P_W


@step
def estimate_errors(pair: Record, params: Rows, k: int, T: float) -> None:
    """Correct altimeter `k` with the mean of what was gathered, and feed its errors of height and
    climb back."""
    p = params[0]
    if math.isnan(gathered(pair, k)):
        return
    if pair.refused_s[k] >= p.reacquire_s[pair.inertial]:
        reacquire(pair, params, k, gathered(pair, k))
    x, R = pair.x[k], height_variance(pair, params, k)
    pair.prob[k] = take_in(x, pair.P[k], p.rows_H[k], pair.K, gathered(pair, k), R, p.robust == 1)
    pair.refused_s[k] = pair.refused_s[k] + T if pair.prob[k] < 0.5 else 0.0
    pair.normal[k] += T / (T + NORMAL_TIME_S) * (pair.prob[k] - pair.normal[k])
    pair.height_m[k] -= x[0]
    pair.climb_mps[k] -= x[1]
    if k == IIG:
        shift(pair.iig_values, -x[0])
    x[0], x[1] = 0.0, 0.0
    discard(pair, k)


@step
def lost(pair: Record, k: int) -> bool:
    """Whether altimeter `k` does not run, or knows next to nothing."""
    return pair.runs[k] == 0 or not pair.P[k, 0, 0] < LOST_SD_M * LOST_SD_M
