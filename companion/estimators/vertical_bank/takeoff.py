"""Height above take-off: from a stiff copy of barometer and IMU, which `vertical_integrity` hands
over to the bank."""

import math

from companion.estimators.vertical_bank.aids import note_takeoff
from companion.estimators.vertical_bank.channel import CLIMB, FAST, HEIGHT, OFFSET
from companion.estimators.vertical_bank.exclusion import BAROMETER, REST_MPS, is_blamed, seed_stiff
from companion.estimators.vertical_bank.mixture import TAKEOFF, combine
from companion.jit import step
from companion.samples import Rows

TAKEOFF_CLIMB_MPS, TAKEOFF_S = 1.0, 5.0
TAKEOFF_SIGMA = 3.0


@step
def note_armed(state: Rows, armed: int) -> None:
    """STATUS: a vehicle that is seen to arm stands where it will take off from."""
    s = state[0]
    if armed < 0:
        return
    if armed == 1 and s.armed == 0:
        s.takeoff_us = -1
        start_takeoff(state)
    s.armed = armed


@step
def watch_takeoff(state: Rows) -> None:
    """A vehicle that does not say that it arms takes off with its first climb of five seconds. Call
    it combined."""
    s = state[0]
    if s.takeoff_us >= 0 or is_blamed(state, BAROMETER) or s.stiff_seeded == 0:
        return
    if s.average[CLIMB] < TAKEOFF_CLIMB_MPS:
        s.takeoff_climbing_us = -1
        if abs(s.average[CLIMB]) < REST_MPS or math.isnan(s.takeoff_reference_m):
            start_takeoff(state)
            s.takeoff_us = -1
        return
    if math.isnan(s.takeoff_reference_m):
        return
    if s.takeoff_climbing_us < 0:
        s.takeoff_climbing_us = s.filter_us
    if (s.filter_us - s.takeoff_climbing_us) * 1e-6 >= TAKEOFF_S:
        s.takeoff_us = s.takeoff_climbing_us


@step
def start_takeoff(state: Rows) -> None:
    """Height above take-off counts from here."""
    s = state[0]
    if s.filter_us < 0 or s.baro_seen == 0:
        return
    combine(state)
    error_m = s.average[HEIGHT] + s.average[OFFSET] + s.average[FAST]
    seed_stiff(state, TAKEOFF, 0.0, error_m)
    s.takeoff_reference_m, s.takeoff_var_m2 = s.average[HEIGHT], s.cov[HEIGHT, HEIGHT]
    s.takeoff_us, s.takeoff_handed_over = s.filter_us, 0
    note_takeoff(state)


@step
def height_above_takeoff(state: Rows) -> float:
    """From the stiff copy, until it contradicts the bank; NaN before. Call it combined."""
    s = state[0]
    if s.takeoff_us < 0:
        return math.nan
    bank_m, stiff_m = s.average[HEIGHT] - s.takeoff_reference_m, s.x[TAKEOFF, HEIGHT]
    if s.takeoff_handed_over == 0:
        limit_m = TAKEOFF_SIGMA * math.sqrt(s.cov[HEIGHT, HEIGHT] + s.takeoff_var_m2)
        s.takeoff_handed_over = 1 if abs(bank_m - stiff_m) > limit_m else 0
    return bank_m if s.takeoff_handed_over == 1 else stiff_m
