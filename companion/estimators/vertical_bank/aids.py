"""What may be known besides pressure, fixes and forces: QNH, the air's temperature, the ground near
the take-off.

None of them is needed, and each is a measurement like any other. A QNH says what the barometer
reads too much where its station stands, which is taken to be the field of the take-off; the
temperature of the air, how that changes with height, here. A range finder sees the height above
take-off as well as the ground is level: the less, the further away.
"""

import math
from typing import Any

from companion.estimators.judging import (
    AIR,
    GATED,
    HIGHEST_AIR_K,
    IGNORED,
    INVALID,
    LOWEST_AIR_K,
    RANGE,
    STALE,
    USED,
    is_stale,
    place,
    tally,
)
from companion.estimators.vertical_bank.channel import (
    HEIGHT,
    OFFSET,
    SCALE,
    SIZE,
    absorb,
    dot,
    gather,
    sees_height,
    sees_nothing,
)
from companion.estimators.vertical_bank.exclusion import FIX_SIGMA, follows_baro, reopen_channel
from companion.estimators.vertical_bank.mixture import CHANNELS, TAKEOFF, advance, combine
from companion.jit import step
from companion.kernels.atmosphere import (
    baro_altitude_m,
    pressure_altitude_m,
    standard_temperature_k,
)
from companion.kernels.earth import meridian_radius_m, normal_radius_m
from companion.samples import Rows

LOWEST_QNH_PA, HIGHEST_QNH_PA = 85_000.0, 110_000.0
QNH_PA_PER_M = 12.0
"""of sea-level air"""
QNH_DRIFT_MPS = 0.005
"""two hectopascals an hour: what a QNH that somebody has told ages by"""

FURTHEST_RANGE_M = 500.0
STEEPEST_COS = 0.8
RANGE_SD_M, RANGE_RATIO = 0.05, 0.02
SLOPE_RATIO = 0.05
"""of the ground, from the place of the take-off"""
GROUND_TIME_S = 5.0
"""for so long does the ground below err alike"""
STEP_SIGMA, LEAST_STEP_M = 6.0, 0.5
"""What changes by this from one range to the next is a roof or a ditch."""
GROUND_SIGMA, DRIFT_MPS = 3.0, 0.01
"""So fast may the barometer have drifted out of sight of the ground: 4 hPa an hour."""
FRESH_US = 1_000_000
REST_RANGE_M = 0.1
"""of a range finder that tells nothing on the ground: it hangs lower than it can see"""


def aids_fields() -> tuple[tuple[Any, ...], ...]:
    """The state fields of this component."""
    return (
        ("known_qnh_pa", "f8"),  # NaN unknown
        ("known_qnh_us", "i8"),
        ("air_k", "f8"),
        (
            "air_H",
            "f8",
            (SIZE,),
        ),  # its row: `H` may hold that of the measurement that it comes with
        ("range_m", "f8"),  # newest, along the vertical
        ("range_us", "i8"),
        ("range_instance", "i8"),
        ("range_above_m", "f8"),  # what it told above the height above take-off
        ("ground_m", "f8"),  # how much higher the ground is than at take-off, by the steps seen
        ("takeoff_range_m", "f8"),  # what it was on the ground
        ("here_deg", "f8", (2,)),  # latitude and longitude of the newest fix, and of the take-off
        ("takeoff_deg", "f8", (2,)),
    )


@step
def aids_start(state: Rows) -> None:
    """Nothing known."""
    s = state[0]
    s.known_qnh_pa, s.known_qnh_us, s.air_k = math.nan, -1, math.nan
    s.range_m, s.range_us, s.takeoff_range_m = math.nan, -FRESH_US, REST_RANGE_M
    s.range_instance, s.range_above_m, s.ground_m = 0, math.nan, 0.0
    for i in range(2):
        s.here_deg[i], s.takeoff_deg[i] = math.nan, math.nan


@step
def on_air(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """QNH and temperature, either or both; they wait for the first barometer height."""
    s, time_us = state[0], sample[0].time_us
    if sample[0].instance != 0:
        return tally(state, AIR, IGNORED)
    has_qnh = LOWEST_QNH_PA <= sample[0].qnh_pa <= HIGHEST_QNH_PA
    has_air = LOWEST_AIR_K <= sample[0].air_temperature_k <= HIGHEST_AIR_K
    if not has_qnh and not has_air:
        return tally(state, AIR, INVALID)
    if is_stale(state, AIR, 0, time_us):
        return tally(state, AIR, STALE)
    place(state, AIR, 0, time_us)
    verdict = IGNORED
    if has_air:
        s.air_k = sample[0].air_temperature_k
        verdict = USED if s.baro_seen == 0 else take_temperature(state, params)
    if has_qnh and sample[0].qnh_pa != s.known_qnh_pa:
        s.known_qnh_pa, s.known_qnh_us = sample[0].qnh_pa, time_us
        if s.baro_seen == 1:
            combine(state)
        verdict = USED if s.baro_seen == 0 else take_qnh(state, params, s.average[HEIGHT])
    return tally(state, AIR, verdict)


@step
def take_qnh(state: Rows, params: Rows, height_m: float) -> int:
    """Correct the barometer's offset at `height_m` by the known QNH: o - s (h - h_field) = H(QNH)."""
    s = state[0]
    if math.isnan(s.known_qnh_pa):
        return IGNORED
    aged_m = QNH_DRIFT_MPS * max(0.0, (s.filter_us - s.known_qnh_us) * 1e-6)
    sd_m = params[0].known_qnh_sd_pa / QNH_PA_PER_M
    sees_nothing(s.air_H)
    s.air_H[OFFSET] = 1.0
    if not math.isnan(s.takeoff_reference_m):
        s.air_H[SCALE] = s.takeoff_reference_m - height_m
    return correct_baro(state, baro_altitude_m(s.known_qnh_pa), sd_m * sd_m + aged_m * aged_m)


@step
def take_temperature(state: Rows, params: Rows) -> int:
    """Correct the scale here by the air's temperature: s = T_standard / T - 1; again only when less
    is known than it tells, as a thermometer errs alike for hours."""
    s = state[0]
    if math.isnan(s.air_k) or math.isnan(s.baro_pa):
        return IGNORED
    sd = params[0].known_temperature_sd_k / s.air_k
    combine(state)
    if s.cov[SCALE, SCALE] < sd * sd:
        return IGNORED
    sees_nothing(s.air_H)
    s.air_H[SCALE] = 1.0
    return correct_baro(
        state, standard_temperature_k(pressure_altitude_m(s.baro_pa)) / s.air_k - 1.0, sd * sd
    )


@step
def correct_baro(state: Rows, value: float, R: float) -> int:
    """Correct what every channel that follows the barometer thinks of it, unless the bank
    contradicts."""
    s, H = state[0], state[0].air_H
    combine(state)
    innovation = value - dot(H, s.average)
    if innovation * innovation > FIX_SIGMA * FIX_SIGMA * (R + gather(s.cov, H, s.K)):
        return GATED
    for i in range(CHANNELS):
        if follows_baro(i) and i != TAKEOFF:
            innovation = value - dot(H, s.x[i])
            S = R + gather(s.P[i], H, s.K)
            absorb(s.x[i], s.P[i], s.K, innovation, S)
    return USED


@step
def note_place(state: Rows, latitude_deg: float, longitude_deg: float) -> None:
    """Where the newest fix is."""
    state[0].here_deg[0], state[0].here_deg[1] = latitude_deg, longitude_deg


@step
def note_takeoff(state: Rows) -> None:
    """The vehicle stands where it will take off from."""
    s = state[0]
    for i in range(2):
        s.takeoff_deg[i] = s.here_deg[i]
    s.takeoff_range_m = s.range_m if s.filter_us - s.range_us <= FRESH_US else REST_RANGE_M


@step
def from_takeoff_m(state: Rows) -> float:
    """Horizontal distance of the newest fix from the place of the take-off, NaN unknown."""
    s = state[0]
    latitude = math.radians(s.takeoff_deg[0])
    north_m = math.radians(s.here_deg[0] - s.takeoff_deg[0]) * meridian_radius_m(latitude)
    east_m = (
        math.radians(s.here_deg[1] - s.takeoff_deg[1])
        * normal_radius_m(latitude)
        * math.cos(latitude)
    )
    return math.hypot(north_m, east_m)


@step
def on_range(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A range finder that looks down corrects the height above take-off, as far as the ground is
    level."""
    s, time_us, distance_m = state[0], sample[0].time_us, sample[0].distance_m
    if sample[0].downward != 1:
        return tally(state, RANGE, IGNORED)
    if not 0.0 < distance_m <= FURTHEST_RANGE_M:
        return tally(state, RANGE, INVALID)
    if is_stale(state, RANGE, sample[0].instance, time_us):
        return tally(state, RANGE, STALE)
    place(state, RANGE, sample[0].instance, time_us)
    if sample[0].instance != s.range_instance and time_us - s.range_us <= FRESH_US:
        return tally(state, RANGE, IGNORED)  # one at a time: they hang at different heights
    upright = -s.attitude.own.up_b[2]
    if not upright > STEEPEST_COS:
        return tally(state, RANGE, IGNORED)
    between_s = (time_us - s.range_us) * 1e-6
    s.range_m, s.range_us, s.range_instance = distance_m * upright, time_us, sample[0].instance
    if s.takeoff_us < 0 or s.takeoff_handed_over == 1:
        return tally(state, RANGE, IGNORED)
    advance(state, params, max(time_us, s.filter_us))
    sees_height(s.H, (s.filter_us - time_us) * 1e-6)
    above_m = s.range_m - s.takeoff_range_m - dot(s.H, s.x[TAKEOFF])
    R = RANGE_SD_M * RANGE_SD_M + (RANGE_RATIO * s.range_m) ** 2
    note_ground(state, above_m, R, between_s)
    level_m = SLOPE_RATIO * from_takeoff_m(state)
    R += level_m * level_m
    innovation, known = above_m + s.ground_m, gather(s.P[TAKEOFF], s.H, s.K)
    if not innovation * innovation <= GROUND_SIGMA * GROUND_SIGMA * (R + known):
        return tally(state, RANGE, GATED)
    R *= max(1.0, GROUND_TIME_S / between_s)  # equal errors for a while: as many fewer measurements
    absorb(s.x[TAKEOFF], s.P[TAKEOFF], s.K, innovation, known + R)
    s.range_above_m -= s.K[HEIGHT] * innovation
    return tally(state, RANGE, USED)


@step
def note_ground(state: Rows, above_m: float, R: float, between_s: float) -> None:
    """Follow the ground over steps; after a while out of sight it is that of the take-off again,
    and the barometer may have drifted."""
    s = state[0]
    step_m = above_m - s.range_above_m
    if not between_s * 1e6 <= FRESH_US or math.isnan(step_m):
        s.ground_m = 0.0
        drifted_m = DRIFT_MPS * min(between_s, (s.range_us - s.takeoff_us) * 1e-6)
        reopen_channel(state, TAKEOFF, drifted_m * drifted_m)
    elif abs(step_m) > max(LEAST_STEP_M, STEP_SIGMA * math.sqrt(R)):
        s.ground_m -= step_m
    s.range_above_m = above_m
