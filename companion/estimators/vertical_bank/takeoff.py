"""Height above take-off: the state `TAKEOFF` is a copy of the height, made where the vehicle takes
off.

Its covariance with every other state is copied too, so the difference h - h_0 is known as well as
the barometer's drift and the receiver's error since then allow.

A vehicle that is first heard in the air has no height above take-off until it has rested. A restart
of the estimator alone, within one run of the vehicle's clock, keeps the height of the take-off.
"""

import math

import numpy as np

from companion.estimators.vertical_bank.channel import CLIMB, HEIGHT, TAKEOFF, clone, replace
from companion.estimators.vertical_bank.mixture import N, mean
from companion.jit import step
from companion.samples import Record

TAKEOFF_CLIMB_MPS, TAKEOFF_S = 1.0, 5.0
REST_MPS = 0.5
REST_SPEED_MPS = 1.5
"""Ground speed of a vehicle that moves: more than a receiver shows at rest."""
KNOWN, GUESSED = 1, 2
"""`TAKEOFF` is the height of a place where the vehicle stood; or where no speed was known yet."""

TAKEOFF_RECORD = np.dtype(
    [
        ("time_us", "i8"),  # -1 before
        ("climbing_us", "i8"),
        ("armed", "i8"),
        ("landed", "i8"),  # 1 on the ground, 0 in the air, -1 unknown
        ("marked", "i8"),  # 0 while `TAKEOFF` is no height
    ],
    align=True,
)


@step
def takeoff_start(takeoff: Record) -> None:
    """On the ground, as far as is known."""
    takeoff.time_us, takeoff.climbing_us, takeoff.marked = -1, -1, 0
    takeoff.armed, takeoff.landed = -1, -1


@step
def mark(takeoff: Record, bank: Record) -> None:
    """The vehicle stands where it will take off from."""
    takeoff.marked = KNOWN
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
def note_landed(takeoff: Record, landed: int) -> None:
    """STATUS: what the vehicle says about being on the ground."""
    if landed >= 0:
        takeoff.landed = landed


@step
def rests(takeoff: Record, climb_mps: float, ground_speed_mps: float) -> bool:
    """Whether the vehicle may stand on the ground: it neither moves, as far as is known, nor says
    that it flies."""
    moves = abs(climb_mps) >= REST_MPS or ground_speed_mps > REST_SPEED_MPS
    return not moves and takeoff.landed != 0


@step
def watch_takeoff(takeoff: Record, bank: Record, ground_speed_mps: float) -> bool:
    """A vehicle that does not say that it arms takes off with its first climb of five seconds after
    it has rested; whether its place was marked now."""
    if takeoff.time_us >= 0:
        return False
    if takeoff.marked == GUESSED and not math.isnan(ground_speed_mps):
        takeoff.marked = 0
    climb_mps = mean(bank, CLIMB)
    if climb_mps < TAKEOFF_CLIMB_MPS:
        takeoff.climbing_us = -1
        if rests(takeoff, climb_mps, ground_speed_mps):
            mark(takeoff, bank)
            takeoff.marked = GUESSED if math.isnan(ground_speed_mps) else KNOWN
            return True
        return False
    if takeoff.marked != 0:
        if takeoff.climbing_us < 0:
            takeoff.climbing_us = bank.now_us
        if (bank.now_us - takeoff.climbing_us) * 1e-6 >= TAKEOFF_S:
            takeoff.time_us = takeoff.climbing_us
    return False


@step
def take_off_at(
    takeoff: Record, bank: Record, time_us: int, height_m: float, variance_m2: float
) -> None:
    """The vehicle has taken off at `time_us` (us) from this height (m, variance m2): what an
    estimator knows that was restarted in flight."""
    takeoff.time_us, takeoff.marked = time_us, KNOWN
    for i in range(N):
        replace(bank.x[i], bank.P[i], TAKEOFF, height_m, variance_m2)


@step
def height_above_takeoff_m(takeoff: Record, bank: Record) -> float:
    """Height above the place of the take-off; NaN before."""
    if takeoff.time_us < 0:
        return math.nan
    return mean(bank, HEIGHT) - mean(bank, TAKEOFF)
