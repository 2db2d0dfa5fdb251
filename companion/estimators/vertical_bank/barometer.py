"""The barometer's stream: its height, the regressors of its error terms, its noise, and whether it
is stuck.

Noise is no less than the median of what consecutive heights differ by beyond the motion. A value
that repeats while the vehicle moves is improbable in proportion to how often this stream has
repeated so far; that is the likelihood with which a stuck sensor is found (`repeat_probability`).
A sensor that is read twice for each of its measurements repeats once and never twice; one of coarse
resolution repeats by chance, whatever it did before. So the probability of a first, a second and a
further repeat are counted apart, and each is that of the repeat before it until it has been seen.
"""

import math

import numpy as np

from companion.estimators.vertical_bank.baro_terms.lag import smoothed
from companion.estimators.vertical_bank.baro_terms.lift_off import lift_share
from companion.estimators.vertical_bank.baro_terms.static_port import (
    true_airspeed_mps,
    velocity_head_m,
)
from companion.estimators.vertical_bank.channel import FAST, LAG, LIFT, OFFSET, PORT, sees_height
from companion.jit import step
from companion.kernels.kalman import Array
from companion.samples import Record

NOISE_STEP = 0.1
MEDIAN_TO_SD = 1.4826
MOVED_M = 0.5
"""A vehicle that has moved so far has another pressure around it."""
MOVING_MPS = 0.5
REPEAT_FORGOTTEN, REPEAT_START = 0.005, 0.5
COARSEST_M = 8.5
"""A stream that has not changed yet may resolve a hectopascal."""
REST_S, REST_INTERVALS = 1.0, 10.0
INTERVAL_WEIGHT = 1.0 / 16.0
FRESH_SPEED_US = 3_000_000
LEAST_REPEAT = 0.005
SPEED_DRIFT_MPS2 = 0.1
"""A speed that is no longer heard changes by 6 m/s a minute."""

BAROMETER_RECORD = np.dtype(
    [
        ("seen", "i8"),
        ("heard_us", "i8"),  # newest sample, -1 none
        ("pressure_pa", "f8"),  # newest, its height, and the path then
        ("height_m", "f8"),
        ("path_m", "f8"),
        ("smooth_m", "f8"),  # over two seconds
        ("time_us", "i8"),  # of the newest height
        ("median_m", "f8"),  # of the differences between consecutive heights beyond the motion
        ("value_us", "i8"),  # since when the value repeats
        ("change_m", "f8"),  # the least that values have differed from the one before by, of late
        ("interval_s", "f8"),  # between new values, smoothed; NaN unknown
        ("run", "i8"),  # number of repeats of the newest value
        ("doubt", "f8"),  # probability of those in which the vehicle had moved
        ("seen_runs", "f8", (3,)),  # while the vehicle moves: readings after no, one, more repeats
        ("repeated", "f8", (3,)),  # how many of them were repeats
        ("stuck", "i8"),
        ("speed_us", "i8"),  # newest airspeed, else ground speed
        ("airspeed_us", "i8"),
        ("head_m", "f8"),  # velocity head, m
        ("lift", "f8"),  # share of the lift-off error
    ],
    align=True,
)


@step
def barometer_start(baro: Record, p: Record) -> None:
    """No barometer heard."""
    baro.seen, baro.pressure_pa, baro.height_m, baro.path_m = 0, math.nan, math.nan, 0.0
    baro.smooth_m, baro.time_us, baro.median_m = math.nan, -1, p.baro_sd_m
    baro.value_us, baro.interval_s, baro.run, baro.doubt = -1, math.nan, 0, 1.0
    baro.change_m = COARSEST_M
    for k in range(3):
        baro.seen_runs[k], baro.repeated[k] = 0.0, 0.0
    baro.heard_us, baro.stuck, baro.head_m, baro.lift = -1, 0, 0.0, 0.0
    baro.speed_us, baro.airspeed_us = -FRESH_SPEED_US, -FRESH_SPEED_US


@step
def note_speed(baro: Record, p: Record, time_us: int, airspeed_mps: float, is_air: int) -> None:
    """A calibrated airspeed, or the ground speed in its place while there is none."""
    if is_air == 0 and time_us - baro.airspeed_us <= FRESH_SPEED_US:
        return
    if not 0.0 <= airspeed_mps <= 400.0:
        return
    true_mps = airspeed_mps
    if is_air == 1:
        baro.airspeed_us = time_us
        if baro.seen == 1:
            true_mps = true_airspeed_mps(airspeed_mps, baro.pressure_pa)
    baro.speed_us = time_us
    baro.head_m = velocity_head_m(true_mps)
    baro.lift = lift_share(airspeed_mps, p.lift_speed_mps)


@step
def sees_barometer(H: Array, baro: Record, climb_mps: float, late_s: float) -> None:
    """The row of a barometer height `late_s` ago: every error term at its regressor."""
    sees_height(H, late_s)
    H[OFFSET] = 1.0
    H[FAST] = 1.0
    H[PORT] = baro.head_m
    H[LIFT] = baro.lift
    H[LAG] = -climb_mps


@step
def note_height(
    baro: Record, time_us: int, pressure_pa: float, height_m: float, path_m: float
) -> None:
    """A new value: noise and interval of the stream, and its smoothed height."""
    if baro.seen == 1:
        baro.change_m = min(abs(height_m - baro.height_m), (1.0 + NOISE_STEP) * baro.change_m)
        change_m = abs(height_m - baro.height_m - (path_m - baro.path_m))
        up = change_m > baro.median_m
        baro.median_m *= 1.0 + NOISE_STEP if up else 1.0 / (1.0 + NOISE_STEP)
        interval_s = (time_us - baro.value_us) * 1e-6
        if math.isnan(baro.interval_s):
            baro.interval_s = interval_s
        longest_s = 3.0 * baro.interval_s
        baro.interval_s += INTERVAL_WEIGHT * (min(interval_s, longest_s) - baro.interval_s)
    baro.height_m, baro.pressure_pa, baro.path_m = height_m, pressure_pa, path_m
    if math.isnan(baro.smooth_m):
        baro.smooth_m = height_m
    else:
        baro.smooth_m = smoothed(baro.smooth_m, height_m, (time_us - baro.time_us) * 1e-6)
    baro.value_us, baro.time_us, baro.stuck = time_us, time_us, 0


@step
def unseen_speed_mps(baro: Record, p: Record, now_us: int) -> float:
    """What is not known of the airspeed at the instant of a height, and more since no speed was
    heard.

    A measured airspeed is up to a second old, so its error while the vehicle gains speed is as
    large as that of a ground speed in wind. Taken as exact, a manoeuvre looked like a fault of the
    barometer."""
    silent_s = max(0.0, (now_us - baro.speed_us - FRESH_SPEED_US) * 1e-6)
    return float(p.wind_sd_mps + SPEED_DRIFT_MPS2 * silent_s)


@step
def noise_m2(baro: Record, p: Record) -> float:
    """White variance of the barometer height: no less than the stream shows."""
    return max(p.baro_sd_m, MEDIAN_TO_SD / math.sqrt(2.0) * baro.median_m) ** 2


@step
def note_run(baro: Record, climb_mps: float) -> None:
    """A new value ends a run of repeats: what it says about how often readings repeat in motion."""
    if abs(climb_mps) > MOVING_MPS and baro.stuck == 0:
        for k in range(3):
            baro.seen_runs[k] *= 1.0 - REPEAT_FORGOTTEN
            baro.repeated[k] *= 1.0 - REPEAT_FORGOTTEN
        for i in range(baro.run + 1):
            baro.seen_runs[min(i, 2)] += 1.0
            baro.repeated[min(i, 2)] += 1.0 if i < baro.run else 0.0
    baro.run, baro.doubt = 0, 1.0


@step
def repeat_probability(baro: Record) -> float:
    """Probability of the newest repeat in motion, by how often this stream has repeated after as
    many repeats."""
    probability = REPEAT_START
    for k in range(min(baro.run, 3)):
        probability = (baro.repeated[k] + probability) / (baro.seen_runs[k] + 1.0)
    return max(LEAST_REPEAT, probability)


@step
def has_moved(baro: Record, path_m: float, climb_mps: float) -> bool:
    """Whether the vehicle moves, and has done since the newest value by more than values differ by
    at least: the resolution of the stream."""
    return abs(climb_mps) > MOVING_MPS and abs(path_m - baro.path_m) > baro.change_m


@step
def rests(baro: Record, time_us: int, path_m: float, climb_mps: float) -> bool:
    """Whether the barometer repeats its value because nothing changes: for long, and the vehicle
    does not move."""
    long_s = REST_S if math.isnan(baro.interval_s) else REST_INTERVALS * baro.interval_s
    at_rest = abs(path_m - baro.path_m) <= MOVED_M and abs(climb_mps) < MOVING_MPS
    return at_rest and (time_us - baro.value_us) * 1e-6 >= long_s
