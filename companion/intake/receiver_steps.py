"""The compiled checks of a GNSS height (`companion.intake.receivers`), and the choice of the
primary sensor (`companion.intake.primary`)."""

import math

import numpy as np

from companion.jit import step
from companion.kernels.gnss import gnss_sd_m
from companion.samples import Rows

NONE_US = -(1 << 62)
CLIMB_M = 20.0
"""change of both heights over which their ratio is checked: a smaller one is noise or a spike"""
FACTORS = (0.01, 0.1, 10.0, 100.0)
TOLERANCE = 0.2
SETTLING_US = 5_000_000
SETTLED_SPREAD_M = 10.0
WEATHER_M, TEMPERATURE_RATIO = 300.0, 0.1
"""largest difference of barometer and true height: 35 hPa, and a column 10 % too warm or cold"""
MEETS_MIN = 2
LEAST_UNDULATION_M = 1.0
UNKNOWN_SD_M = 10.0
DOUBTS_MIN = 20
"""fixes of equal heights before that is told: a simulator tells meanwhile that it is one"""
WAIT_US = 2_000_000
LEAST_PA = 100.0
NOTHING, ZEROS, UNIT = 0, 1, 2
"""what `check_height` has to tell"""

RECEIVER = np.dtype(
    [
        ("doubt_m", "f8"),  # largest common error of the heights
        ("doubts", "i8"),  # number of heights in doubt
        ("told", "i8"),  # sum of 2 ** (what was told)
        ("zeros", "i8"),
        ("scaled", "i8"),
        ("factor", "f8"),
        ("has_start", "i8"),
        ("start_baro_m", "f8"),
        ("start_gnss_m", "f8"),
        ("settled", "i8"),
        ("apart_us", "i8"),  # start and bounds of the difference of GNSS and barometer height
        ("low_m", "f8"),
        ("high_m", "f8"),
    ],
    align=True,
)
PRIMARY = np.dtype(
    [
        ("first", "i8"),  # the primary instance; -1 unknown
        ("zero_heard", "i8"),
        ("since_us", "i8"),
    ],
    align=True,
)


@step
def is_height(row: Rows) -> bool:
    """Whether a fix has a height that can be checked."""
    return row[0].fix_type >= 3 and not math.isnan(row[0].altitude_amsl_m)


@step
def is_near(height_m: float, baro_m: float) -> bool:
    """Whether a height may be that of a barometer in some weather."""
    return abs(height_m - baro_m) <= WEATHER_M + TEMPERATURE_RATIO * abs(height_m)


@step
def check_height(r: Rows, row: Rows, baro_m: float) -> int:
    """Void heights of exactly 0 and those in a wrong unit; what there is to tell, once each."""
    told = NOTHING
    r[0].doubt_m = 0.0
    is_zero = row[0].altitude_amsl_m == 0.0 and math.isnan(row[0].altitude_ellipsoid_m)
    r[0].zeros = r[0].zeros + 1 if is_zero else 0
    if is_zero:
        row[0].altitude_amsl_m = math.nan
        if r[0].zeros >= MEETS_MIN and not r[0].told & 1 << ZEROS:
            told = ZEROS
    height_m = row[0].altitude_amsl_m
    if not math.isfinite(baro_m + height_m):
        return told
    if not r[0].has_start:
        r[0].has_start, r[0].start_baro_m, r[0].start_gnss_m = 1, baro_m, height_m
    climb_m, moved_m = baro_m - r[0].start_baro_m, height_m - r[0].start_gnss_m
    if min(abs(climb_m), abs(moved_m)) >= CLIMB_M:
        r[0].start_baro_m, r[0].start_gnss_m = baro_m, height_m
        factor = 1.0
        for i in range(len(FACTORS)):
            moves = abs(moved_m / climb_m / FACTORS[i] - 1.0) <= TOLERANCE
            if factor == 1.0 and moves and is_near(height_m / FACTORS[i], baro_m):
                factor = FACTORS[i]
        r[0].scaled = r[0].scaled + 1 if factor != 1.0 else 0
        if r[0].scaled >= MEETS_MIN:
            r[0].factor = factor
            told = NOTHING if r[0].told & 1 << UNIT else UNIT
    if r[0].scaled >= MEETS_MIN:
        row[0].altitude_amsl_m = math.nan
    return told


@step
def doubt(r: Rows, row: Rows, above_m: float) -> None:
    """Widen a height that may be the ellipsoid's, which lies `above_m` beside sea level."""
    r[0].doubts += 1
    r[0].doubt_m = abs(above_m)
    sd_m = gnss_sd_m(row, 0.0, UNKNOWN_SD_M)
    row[0].vertical_sd_m = math.sqrt(sd_m * sd_m + above_m * above_m)
    row[0].datum_sd_m = abs(above_m)


@step
def check_unreported(r: Rows, row: Rows, baro_m: float) -> None:
    """A receiver that reports no accuracy must first move as the barometer does, if there is
    one."""
    height_m, time_us = row[0].altitude_amsl_m, row[0].time_us
    difference_m = height_m - baro_m
    if r[0].settled or not math.isfinite(difference_m) or gnss_sd_m(row, 0.0, 0.0) > 0.0:
        return
    if r[0].apart_us == NONE_US:
        r[0].apart_us, r[0].low_m, r[0].high_m = time_us, difference_m, difference_m
    low_m, high_m = min(r[0].low_m, difference_m), max(r[0].high_m, difference_m)
    spreads = high_m - low_m > SETTLED_SPREAD_M
    if not is_near(height_m, baro_m) or spreads or time_us < r[0].apart_us:
        r[0].apart_us, r[0].low_m, r[0].high_m = time_us, difference_m, difference_m
    else:
        r[0].low_m, r[0].high_m = low_m, high_m
        r[0].settled = 1 if time_us - r[0].apart_us >= SETTLING_US else 0
    if not r[0].settled:
        row[0].altitude_amsl_m = math.nan


@step
def number(c: Rows, row: Rows, works: bool) -> bool:
    """Give a row the number of its sensor among its kind; True when another than the first becomes
    the primary one."""
    instance, time_us, chosen = row[0].instance, row[0].time_us, False
    if c[0].first < 0 and works:
        if c[0].since_us == NONE_US:
            c[0].since_us = time_us
        if instance == 0 or c[0].zero_heard or time_us - c[0].since_us >= WAIT_US:
            c[0].first = instance
            chosen = instance != 0
    if instance == 0:
        c[0].zero_heard = 1
    if c[0].first > 0 and (instance == 0 or instance == c[0].first):
        row[0].instance = c[0].first - instance
    return chosen


@step
def pressure_works(row: Rows) -> bool:
    """Whether a barometer has a value."""
    return row[0].pressure_pa > LEAST_PA


@step
def fix_works(row: Rows) -> bool:
    """Whether a receiver has a height."""
    return row[0].fix_type >= 3 and math.isfinite(row[0].altitude_amsl_m)
