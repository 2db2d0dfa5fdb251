"""Height and climb: the alpha-beta filter (33), (34) of paper W.

Letters as in the package's docstring.
"""

import math

import numpy as np

from companion.estimators.air_data_gnss.error import diagonal, persists
from companion.estimators.judging import GATED, USED
from companion.jit import step
from companion.kernels.kalman import correct, inflated
from companion.samples import Record, Rows

P_H0_M2, P_V0_M2PS2 = 100.0, 144.0
"""Variances of height and climb at the start, section 3."""
BARO_PATIENCE_US = 250_000
"""Time for which barometer innovations must lie beyond the gate on one side before they are
accepted."""

MOTION = np.dtype(
    [
        ("x", "f8", (2,)),  # height, climb; NaN before the first
        ("P", "f8", (2, 2)),
        ("time_us", "i8"),
        ("H", "f8", (2,)),
        ("K", "f8", (2,)),
        ("run", "i8", (2,)),  # side of the gate (0 inside) and since when
        ("jump_m", "f8"),  # innovation with which the run began
    ],
    align=True,
)
"""The record of the alpha-beta filter."""


@step
def motion_start(motion: Record) -> None:
    """Height and climb unknown."""
    motion.x[0], motion.x[1] = math.nan, math.nan
    diagonal(motion.P, P_H0_M2, P_V0_M2PS2)
    motion.time_us = -1
    motion.H[0], motion.H[1] = 0.0, 0.0
    motion.K[0], motion.K[1] = 0.0, 0.0
    motion.run[0], motion.run[1] = 0, 0
    motion.jump_m = 0.0


@step
def restart_motion(motion: Record, height: float, P_h: float) -> None:
    """Height from one measurement, climb unknown."""
    motion.x[0], motion.x[1] = height, 0.0
    diagonal(motion.P, P_h, P_V0_M2PS2)


@step
def predict_motion(motion: Record, params: Rows, dt: float) -> None:
    """x = F x, P = F P F' + G Q^h G' (33)."""
    p = params[0]
    decay = 1.0 - dt / p.tau
    P = motion.P
    motion.x[0] += dt * motion.x[1]
    motion.x[1] *= decay
    P[0, 0] += 2.0 * dt * P[0, 1] + dt * dt * P[1, 1]
    P[0, 1] = decay * (P[0, 1] + dt * P[1, 1])
    P[1, 0] = P[0, 1]
    P[1, 1] = decay * decay * P[1, 1] + p.Q_h * dt


@step
def correct_motion(
    motion: Record, error: Record, params: Rows, height: float, R: float, time_us: int
) -> int:
    """The alpha-beta update with a height of variance R (34): USED, or GATED when its weight was
    damped.

    Innovations that stay beyond the gate are a jump of the sensor: height starts anew there, and b,
    which a jump of the barometer changes, becomes as uncertain as the jump was large.
    """
    gate = params[0].baro_gate
    innovation = height - motion.x[0]
    R_damped = inflated(innovation, motion.P[0, 0] + R, R, gate)
    side = 0 if R_damped == R else (1 if innovation > 0.0 else -1)
    if side != motion.run[0]:
        motion.jump_m = innovation
    if persists(motion.run, side, time_us, BARO_PATIENCE_US):
        motion.run[0] = 0
        motion.x[0] = height
        motion.P[0, 0], motion.P[0, 1], motion.P[1, 0] = R, 0.0, 0.0
        error.P[1, 1] += motion.jump_m * motion.jump_m
        error.P_settled[1, 1] += motion.jump_m * motion.jump_m
        return USED
    motion.H[0], motion.H[1] = 1.0, 0.0
    correct(motion.x, motion.P, motion.H, motion.K, innovation, R_damped)
    return USED if side == 0 else GATED
