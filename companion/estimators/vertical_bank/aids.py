"""What may be known besides pressure, fixes and forces: QNH, the air's temperature, the elevation
of the field, the ground near the take-off.

None of them is needed, and each is a measurement like any other. A QNH says what the barometer
reads too much where its station stands, which is taken to be the field of the take-off; the
temperature of the air, how that changes with height, here; the elevation of the field, the height
while the vehicle rests before the take-off. A range finder measures the height above take-off as
well as the ground is level: the less, the further away.
"""

import math

import numpy as np

from companion.estimators.vertical_bank.baro_terms.column import column_ratio
from companion.estimators.vertical_bank.channel import (
    HEIGHT,
    OFFSET,
    SCALE,
    SIZE,
    TAKEOFF,
    absorb,
    dot,
    gather,
    sees_height,
    sees_nothing,
)
from companion.estimators.vertical_bank.mixture import (
    N,
    baro_is_wrong,
    expected,
    expected_variance,
    mean,
    variance,
)
from companion.jit import step
from companion.kernels.atmosphere import baro_altitude_m
from companion.kernels.earth import meridian_radius_m, normal_radius_m
from companion.kernels.kalman import Array
from companion.samples import Record

LOWEST_QNH_PA, HIGHEST_QNH_PA = 85_000.0, 110_000.0
LOWEST_FIELD_M, HIGHEST_FIELD_M = -500.0, 9_000.0
QNH_PA_PER_M = 12.0
"""of sea-level air"""
QNH_DRIFT_MPS = 0.005
"""two hectopascals an hour: what a QNH that somebody has told ages by"""
KNOWN_SIGMA = 5.0
"""An aid that the mixture contradicts by more is not used."""

FURTHEST_RANGE_M = 500.0
STEEPEST_COS = 0.8
RANGE_SD_M, RANGE_RATIO = 0.05, 0.02
SLOPE_RATIO = 0.05
"""of the ground, from the place of the take-off"""
FIELD_SLOPE_RATIO = 0.01
"""of a field, from where its elevation was told: runways may rise by 2 % (ICAO Annex 14)"""
GROUND_TIME_S = 5.0
"""for so long does the ground below err alike"""
STEP_SIGMA, LEAST_STEP_M = 6.0, 0.5
"""What changes by this from one range to the next is a roof or a ditch."""
GROUND_SIGMA = 3.0
FRESH_US = 1_000_000
REST_RANGE_M = 0.1
"""of a range finder that tells nothing on the ground: it hangs lower than it can see"""

AIDS = np.dtype(
    [
        ("known_qnh_pa", "f8"),  # NaN unknown
        ("known_qnh_us", "i8"),
        ("known_qnh_sd_pa", "f8"),
        ("air_k", "f8"),
        ("field_m", "f8"),
        ("H", "f8", (SIZE,)),
        ("range_m", "f8"),  # newest, along the vertical
        ("range_us", "i8"),
        ("range_instance", "i8"),
        ("range_above_m", "f8"),  # what it told above the height above take-off
        ("ground_m", "f8"),  # how much higher the ground is than at take-off, by the steps seen
        ("takeoff_range_m", "f8"),  # what it was on the ground
        ("here_deg", "f8", (2,)),  # latitude and longitude of the newest fix, and of the take-off
        ("takeoff_deg", "f8", (2,)),
        ("field_deg", "f8", (2,)),  # where the elevation of the field was first used
    ],
    align=True,
)


@step
def aids_start(aids: Record) -> None:
    """Nothing known."""
    aids.known_qnh_pa, aids.known_qnh_us, aids.air_k, aids.field_m = (
        math.nan,
        -1,
        math.nan,
        math.nan,
    )
    aids.known_qnh_sd_pa = math.nan
    aids.range_m, aids.range_us, aids.takeoff_range_m = math.nan, -FRESH_US, REST_RANGE_M
    aids.range_instance, aids.range_above_m, aids.ground_m = 0, math.nan, 0.0
    for i in range(2):
        aids.here_deg[i], aids.takeoff_deg[i], aids.field_deg[i] = math.nan, math.nan, math.nan


@step
def fuse_known(bank: Record, H: Record, z: float, R: float) -> bool:
    """Correct every hypothesis with a good barometer by z = H x + white, unless the mixture
    contradicts; whether it was used. Probabilities stay: an aid is not used for fault detection."""
    innovation = z - expected(bank, H)
    if innovation * innovation > KNOWN_SIGMA * KNOWN_SIGMA * (R + expected_variance(bank, H)):
        return False
    for i in range(N):
        if bank.weight[i] > 0.0 and not baro_is_wrong(i):
            S = R + gather(bank.P[i], H, bank.K)
            absorb(bank.x[i], bank.P[i], bank.K, z - dot(H, bank.x[i]), S)
    return True


@step
def fuse_qnh(aids: Record, bank: Record, height_m: float) -> bool:
    """Correct the barometer's offset at `height_m` by the known QNH: o - s (h - h_field) =
    H(QNH)."""
    if math.isnan(aids.known_qnh_pa):
        return False
    aged_m = QNH_DRIFT_MPS * max(0.0, (bank.now_us - aids.known_qnh_us) * 1e-6)
    sd_m = aids.known_qnh_sd_pa / QNH_PA_PER_M
    sees_nothing(aids.H)
    aids.H[OFFSET] = 1.0
    takeoff_m = mean(bank, TAKEOFF)
    if takeoff_m != 0.0:
        aids.H[SCALE] = takeoff_m - height_m
    R = sd_m * sd_m + aged_m * aged_m
    return fuse_known(bank, aids.H, baro_altitude_m(aids.known_qnh_pa), R)


@step
def know_qnh(aids: Record, qnh_pa: float, sd_pa: float, time_us: int) -> None:
    """A QNH with the standard deviation of its constant error."""
    aids.known_qnh_pa, aids.known_qnh_sd_pa, aids.known_qnh_us = qnh_pa, sd_pa, time_us


@step
def fuse_temperature(aids: Record, bank: Record, p: Record, pressure_pa: float) -> bool:
    """Correct the scale here by the air's temperature; again only when less is known than it tells,
    as a thermometer errs alike for hours."""
    if math.isnan(aids.air_k) or math.isnan(pressure_pa):
        return False
    sd = p.known_temperature_sd_k / aids.air_k
    if variance(bank, SCALE) < sd * sd:
        return False
    sees_nothing(aids.H)
    aids.H[SCALE] = 1.0
    return fuse_known(bank, aids.H, column_ratio(pressure_pa, aids.air_k), sd * sd)


@step
def fuse_field(aids: Record, bank: Record, p: Record) -> None:
    """The height of a vehicle that rests is the elevation of the field, the less exactly the
    further it has taxied; again only when less is known, as it errs alike for ever."""
    if math.isnan(aids.field_m):
        return
    sloped_m = FIELD_SLOPE_RATIO * apart_m(aids.field_deg, aids.here_deg)
    if math.isnan(sloped_m):
        aids.field_deg[0], aids.field_deg[1] = aids.here_deg[0], aids.here_deg[1]
        sloped_m = 0.0
    R = p.known_elevation_sd_m * p.known_elevation_sd_m + sloped_m * sloped_m
    if variance(bank, HEIGHT) <= R:
        return
    sees_height(aids.H, 0.0)
    fuse_known(bank, aids.H, aids.field_m, R)


@step
def note_place(aids: Record, latitude_deg: float, longitude_deg: float) -> None:
    """Where the newest fix is."""
    aids.here_deg[0], aids.here_deg[1] = latitude_deg, longitude_deg


@step
def note_takeoff(aids: Record, now_us: int) -> None:
    """The vehicle stands where it will take off from."""
    for i in range(2):
        aids.takeoff_deg[i] = aids.here_deg[i]
    aids.takeoff_range_m = aids.range_m if now_us - aids.range_us <= FRESH_US else REST_RANGE_M


@step
def apart_m(one_deg: Array, other_deg: Array) -> float:
    """Horizontal distance of two places, latitude and longitude each; NaN unknown."""
    latitude = math.radians(one_deg[0])
    north_m = math.radians(other_deg[0] - one_deg[0]) * meridian_radius_m(latitude)
    east_m = (
        math.radians(other_deg[1] - one_deg[1]) * normal_radius_m(latitude) * math.cos(latitude)
    )
    return math.hypot(north_m, east_m)


@step
def note_range(aids: Record, time_us: int, instance: int, vertical_m: float) -> float:
    """A new range; the seconds since the last."""
    between_s = (time_us - aids.range_us) * 1e-6
    aids.range_m, aids.range_us, aids.range_instance = vertical_m, time_us, instance
    return between_s


@step
def fuse_range(aids: Record, bank: Record, late_s: float, between_s: float) -> bool:
    """Correct the height above take-off by the newest range; whether it was used."""
    sees_height(aids.H, late_s)
    aids.H[TAKEOFF] = -1.0
    above_m = aids.range_m - aids.takeoff_range_m - expected(bank, aids.H)
    R = RANGE_SD_M * RANGE_SD_M + (RANGE_RATIO * aids.range_m) ** 2
    note_ground(aids, above_m, R, between_s)
    level_m = SLOPE_RATIO * apart_m(aids.takeoff_deg, aids.here_deg)
    R += level_m * level_m
    innovation = above_m + aids.ground_m
    if not innovation * innovation <= GROUND_SIGMA * GROUND_SIGMA * (
        R + expected_variance(bank, aids.H)
    ):
        return False
    z = innovation + expected(bank, aids.H)
    R *= max(1.0, GROUND_TIME_S / between_s)  # equal errors for a while: as many fewer measurements
    before_m = expected(bank, aids.H)
    for i in range(N):
        if bank.weight[i] > 0.0:
            S = R + gather(bank.P[i], aids.H, bank.K)
            absorb(bank.x[i], bank.P[i], bank.K, z - dot(aids.H, bank.x[i]), S)
    aids.range_above_m -= expected(bank, aids.H) - before_m
    return True


@step
def note_ground(aids: Record, above_m: float, R: float, between_s: float) -> None:
    """Follow the ground over steps; after a while out of sight it is that of the take-off again."""
    step_m = above_m - aids.range_above_m
    if not between_s * 1e6 <= FRESH_US or math.isnan(step_m):
        aids.ground_m = 0.0
    elif abs(step_m) > max(LEAST_STEP_M, STEP_SIGMA * math.sqrt(R)):
        aids.ground_m -= step_m
    aids.range_above_m = above_m
