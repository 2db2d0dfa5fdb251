"""Height above take-off: the state `TAKEOFF` is a copy of the height, made where the vehicle takes
off.

Its covariance with every other state is copied too, so the difference h - h_0 is known as well as
the barometer's drift and the receiver's error since then allow.
"""

import math

import numpy as np

from companion.estimators.vertical_bank.channel import CLIMB, HEIGHT, TAKEOFF, clone
from companion.estimators.vertical_bank.mixture import N, mean
from companion.jit import step
from companion.samples import Record

TAKEOFF_CLIMB_MPS, TAKEOFF_S = 1.0, 5.0
REST_MPS = 0.5

TAKEOFF_RECORD = np.dtype(
    [
        ("time_us", "i8"),  # -1 before
        ("climbing_us", "i8"),
        ("armed", "i8"),
        ("marked", "i8"),  # whether `TAKEOFF` is a height
    ],
    align=True,
)


@step
def takeoff_start(takeoff: Record) -> None:
    """On the ground, as far as is known."""
    takeoff.time_us, takeoff.climbing_us, takeoff.armed, takeoff.marked = -1, -1, -1, 0


@step
def mark(takeoff: Record, bank: Record) -> None:
    """The vehicle stands where it will take off from."""
    takeoff.marked = 1
    for i in range(N):
        if bank.weight[i] > 0.0:
            clone(bank.x[i], bank.P[i], TAKEOFF, HEIGHT)


@step
def note_armed(takeoff: Record, bank: Record, armed: int) -> bool:
    """STATUS: a vehicle that is seen to arm stands where it will take off from; whether it has."""
    if armed < 0:
        return False
    arms = armed == 1 and takeoff.armed == 0 and bank.now_us >= 0
    if arms:
        mark(takeoff, bank)
        takeoff.time_us = bank.now_us
    takeoff.armed = armed
    return arms


@step
def watch_takeoff(takeoff: Record, bank: Record) -> bool:
    """A vehicle that does not say that it arms takes off with its first climb of five seconds;
    whether its place was marked now."""
    if takeoff.time_us >= 0:
        return False
    climb_mps = mean(bank, CLIMB)
    if climb_mps < TAKEOFF_CLIMB_MPS:
        takeoff.climbing_us = -1
        if abs(climb_mps) < REST_MPS or takeoff.marked == 0:
            mark(takeoff, bank)
            return True
        return False
    if takeoff.marked == 1:
        if takeoff.climbing_us < 0:
            takeoff.climbing_us = bank.now_us
        if (bank.now_us - takeoff.climbing_us) * 1e-6 >= TAKEOFF_S:
            takeoff.time_us = takeoff.climbing_us
    return False


@step
def height_above_takeoff_m(takeoff: Record, bank: Record) -> float:
    """Height above the place of the take-off; NaN before."""
    if takeoff.time_us < 0:
        return math.nan
    return mean(bank, HEIGHT) - mean(bank, TAKEOFF)
