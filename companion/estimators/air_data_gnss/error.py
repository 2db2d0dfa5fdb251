"""Scale-factor and bias error of the barometer: lambda-update from temperature, z-update from GNSS.

Letters as in the package's docstring.
"""

import math

import numpy as np

from companion.estimators.judging import GATED, USED
from companion.estimators.outage import moved_m2, note_difference
from companion.jit import step
from companion.kernels.atmosphere import L0_KPM, T0_K
from companion.kernels.kalman import Array, correct, inflated, spread
from companion.samples import Record, Rows

EXACT, LINEAR, PRINTED = 0, 1, 2
"""Laws of lambda: exact, its linear part, as the paper prints it."""
LOWEST_A = -0.5
TROPOPAUSE_M = 11_000.0
R_GAMMA_K2PM2 = 0.003**2
"""Variance of the lapse rate, section 3, K2/m2."""
GNSS_PATIENCE_US = 10_000_000
"""Time for which GNSS innovations must lie beyond the gate on one side before they are accepted."""

ERROR = np.dtype(
    [
        ("x", "f8", (2,)),  # a, b
        ("P", "f8", (2, 2)),
        ("H_0", "f8"),  # reference height: of the settings, then the field's once that is told
        ("T_0", "f8"),  # the standard temperature there
        ("time_us", "i8"),  # until when Q^a and Q^b have been added
        ("P_settled", "f8", (2, 2)),  # P after the last fix, before its correlation is dropped
        ("H", "f8", (2,)),
        ("K", "f8", (2,)),
        ("lambda_us", "i8"),  # of the last lambda-update
        ("innovation_m", "f8"),
        ("run", "i8", (2,)),  # side of the gate (0 inside) and since when
    ],
    align=True,
)
"""The record of the barometer's scale-factor and bias error."""


@step
def error_start(error: Record, params: Rows) -> None:
    """No error known, with the spreads of the settings."""
    p = params[0]
    error.x[0], error.x[1] = 0.0, 0.0
    error.H_0, error.T_0 = p.H_0, p.T_0
    diagonal(error.P, p.P_a0, p.P_b0)
    diagonal(error.P_settled, p.P_a0, p.P_b0)
    error.time_us, error.lambda_us = -1, -1
    error.H[0], error.H[1] = 0.0, 0.0
    error.K[0], error.K[1] = 0.0, 0.0
    error.innovation_m = math.nan
    error.run[0], error.run[1] = 0, 0


@step
def refer_to(error: Record, params: Rows, height_m: float) -> None:
    """Count the scale factor from another reference height H_0: h^B - h stays what it is."""
    up_m = height_m - error.H_0
    error.x[1] += error.x[0] * up_m
    refer(error.P, up_m)
    refer(error.P_settled, up_m)
    if params[0].joint == 0:
        error.P[0, 1], error.P[1, 0] = 0.0, 0.0
    error.H_0, error.T_0 = height_m, T0_K + L0_KPM * height_m


@step
def refer(P: Array, up_m: float) -> None:
    """The covariance of a and b, for b at a reference height `up_m` higher."""
    P[1, 1] += up_m * (2.0 * P[0, 1] + up_m * P[0, 0])
    P[0, 1] += up_m * P[0, 0]
    P[1, 0] = P[0, 1]


@step
def predict_error(error: Record, params: Rows, time_us: int) -> None:
    """Add Q^a and Q^b up to the time of a barometer height (17), (18)."""
    p = params[0]
    if error.time_us >= 0:
        dt = (time_us - error.time_us) * 1e-6
        error.P[0, 0] += p.Q_a * dt
        error.P[1, 1] += p.Q_b * dt
    error.time_us = time_us


@step
def diagonal(P: Array, first: float, second: float) -> None:
    """P = diag(first, second)."""
    P[0, 0], P[0, 1], P[1, 0], P[1, 1] = first, 0.0, 0.0, second


@step
def compensate(baro: float, a: float, b: float, H_0: float) -> float:
    """h^c of (32), with the height above H_0 as in (2): the inverse of h^B = h + a (h - H_0) +
    b."""
    return H_0 + (baro - H_0 - b) / (1.0 + a)


@step
def scale_of_temperature(law: int, T: float, T_0: float, above: float) -> float:
    """lambda of (6): the scale-factor error when the air is T at `above` metres over the reference
    height."""
    T_0_now = T - L0_KPM * above
    if law == EXACT:
        return T_0 / T_0_now - 1.0
    lam = (T_0_now - T_0) / T_0
    return lam if law == PRINTED else -lam


@step
def scale_variance(R_T: float, P_h: float, above: float, T_0: float) -> float:
    """Var v^a of (7), with T_0 squared (erratum)."""
    return (R_T + L0_KPM * L0_KPM * P_h + above * above * R_GAMMA_K2PM2) / (T_0 * T_0)


@step
def persists(run: Array, side: int, time_us: int, patience_us: int) -> bool:
    """Whether innovations have now been on this `side` of the gate (0: inside) for
    `patience_us`."""
    if side != run[0]:
        run[0], run[1] = side, time_us
    return side != 0 and time_us - run[1] >= patience_us


@step
def correct_error(error: Record, motion: Record, params: Rows, innovation: float, R: float) -> None:
    """Correct [a, b] with the row in H; the height moves along unless the correction is to be
    filtered."""
    p = params[0]
    baro = motion.x[0] + error.x[0] * (motion.x[0] - error.H_0) + error.x[1]
    correct(error.x, error.P, error.H, error.K, innovation, R)
    error.x[0] = max(error.x[0], LOWEST_A)
    if p.carried == 1:
        motion.x[0] = compensate(baro, error.x[0], error.x[1], error.H_0)


@step
def lambda_update(
    error: Record, motion: Record, params: Rows, T: float, R_T: float, time_us: int
) -> None:
    """(20)-(22) with the temperature T of the air at the predicted height."""
    p = params[0]
    above = motion.x[0] - error.H_0
    if not motion.x[0] < TROPOPAUSE_M:
        return
    variance = scale_variance(R_T, motion.P[0, 0], above, error.T_0)
    if error.lambda_us >= 0:
        variance *= max(1.0, p.temperature_time_s / ((time_us - error.lambda_us) * 1e-6))
    error.lambda_us = time_us
    error.H[0], error.H[1] = 1.0, 0.0
    correct_error(
        error,
        motion,
        params,
        scale_of_temperature(p.law, T, error.T_0, above) - error.x[0],
        variance,
    )


@step
def z_innovation(
    error: Record, motion: Record, params: Rows, apart_m: float, baro: float, fix_m: float
) -> float:
    """z - a (h - H_0) - b of (10) for a fix when the barometer reads `baro`, `apart_m` below its
    newest height; H is left set for it."""
    p = params[0]
    height = motion.x[0] - apart_m / (1.0 + error.x[0])
    error.H[0] = (fix_m if p.regress_gnss == 1 else height) - error.H_0
    error.H[1] = 1.0
    return baro - fix_m - error.H[0] * error.x[0] - error.x[1]


@step
def learn_anew(error: Record, params: Rows, innovation: float) -> None:
    """Fixes have contradicted [a, b] for long: no scale factor, and a bias as wrong as the
    innovation says."""
    p = params[0]
    error.run[0] = 0
    error.x[1] += error.H[0] * error.x[0]
    error.x[0] = 0.0
    diagonal(error.P, p.P_a0, error.P[1, 1] + innovation * innovation)


@step
def z_correct(
    error: Record, motion: Record, params: Rows, time_us: int, innovation: float, R_GPS: float
) -> int:
    """(25), (26), (29)-(31) in one, with the row that `z_innovation` left: USED, or GATED when its
    weight was damped."""
    R = params[0].R_B + R_GPS
    R_damped = inflated(innovation, spread(error.P, error.H) + R, R, params[0].gnss_gate)
    side = 0 if R_damped == R else (1 if innovation > 0.0 else -1)
    if persists(error.run, side, time_us, GNSS_PATIENCE_US):
        learn_anew(error, params, innovation)
        R_damped = R
    error.innovation_m = -innovation
    correct_error(error, motion, params, innovation, R_damped)
    for i in range(2):
        for j in range(2):
            error.P_settled[i, j] = error.P[i, j]
    if params[0].joint == 0:
        error.P[0, 1], error.P[1, 0] = 0.0, 0.0
    return USED if R_damped == R else GATED


@step
def note_outage(
    error: Record, outage: Record, params: Rows, fix: Rows, baro: float, sd_m: float
) -> None:
    """A fix beside the barometer height of its time. After an outage b may have moved."""
    if math.isnan(baro):
        return
    time_us = fix[0].time_us
    if params[0].gnss_gate < math.inf:
        error.P[1, 1] += moved_m2(outage, time_us, baro)
    note_difference(outage, time_us, fix[0].altitude_amsl_m, baro, fix[0].ground_speed_mps, sd_m)
