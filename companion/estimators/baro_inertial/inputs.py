"""What the two baro-inertial filters of one paper share: their inputs.

J. Keighobadi, H. Nourmohammadi, S. Rafatnia, "Design and Implementation of GA Filter Algorithm for
Baro-inertial Altitude Error Compensation". `damping_loop` and `baro_ins_kf` differ only in how they
join the two inputs of this module:

==============  =========================  =========================================================
H               ``calibrated_m``           barometer height, calibrated for the atmosphere (2)
A_z             ``acceleration_mps2``      vertical specific force, less local gravity
==============  =========================  =========================================================

Start height
------------
The paper computes s and b of (2) from temperature and pressure "at sea level", which (5) derives
from the very height that is to be calibrated: it is circular, and on an exactly standard day it
shifts a vehicle at 1350 m by -82 or +85 m. Here the height of the start is given: the median of the
first ``start_fixes`` credible GNSS heights (each compared with the barometer at its own time, so
that the vehicle may move meanwhile), or the setting ``start_altitude_m``, or the indicated altitude
where a QNH is known. From there on

    H = H_start + (1 + s) (H_p - H_p,start),      1 + s = T_start / T_standard(H_p,start)

which is (2) with s = Delta T / T at the start; in a layer of constant lapse rate it is exactly the
hypsometric formula from the start's pressure, temperature and height. T_start is the setting
``start_temperature_k``, or what AIR samples tell before the start: `air.temperature_c`, a METAR, or
HYGROMETER_SENSOR. Without a temperature s = 0. SCALED_PRESSURE carries the temperature of the
sensor's die, 10-30 K above the air: by default it is not used.

GNSS after the start
--------------------
A baro-inertial filter does not use it. Here the altitude never follows GNSS heights; the reported
spread does. While the barometer is silent for five seconds the estimate is GNSS height alone.
"""

import math

import numpy as np

from companion.estimators.outage import OUTAGE, gap_s, growth_m2, note_difference, outage_start
from companion.estimators.setting import (
    KNOWN_COLUMN_RATIO,
    SETTING,
    has_temperature,
    indicated_m,
    indicated_sd_m,
    is_set,
    note_air,
    note_level,
    setting_start,
    waits_for_level,
)
from companion.jit import step
from companion.kernels.atmosphere import (
    L0_KPM,
    T0_K,
    baro_altitude_m,
    geometric_m,
    geopotential_m,
    pressure_altitude_m,
)
from companion.kernels.attitude import (
    ATTITUDE_STATE,
    attitude_gnss,
    attitude_imu,
    attitude_start,
    imu_can_be_integrated,
    up_acceleration_mps2,
)
from companion.kernels.gnss import gnss_sd_m
from companion.kernels.ring import at, clear, push, ring_fields
from companion.samples import Record, Rows

LOWEST_PA, HIGHEST_PA = 1_000.0, 120_000.0
BARO_TIMEOUT_US = 5_000_000
IMU_TIMEOUT_US = 500_000
REACH_US = 1_000_000
RING_SIZE = 64
MOST_START_FIXES = 64
START_SD_M, LARGEST_START_SD_M, START_WAIT_US = 20.0, 30.0, 20_000_000
"""Spreads of fixes that count for the start: receivers slide by hundreds of metres while they
report more. One that still reports more after this time will not do better; a start above the
second spread could not be published."""
SETTLE_US = 2_000_000
"""time for which the barometer must have been there, or have contradicted the filter, before the
filter starts at it"""
GATE_M = 10.0
"""distance by which no vehicle leaves its inertial path between barometer samples; a step of the
barometer does"""
GATE_WITHOUT_IMU_MPS = 10.0
"""more for each second since the last barometer sample when nothing is known of the acceleration"""
COAST_ERROR_MPS2, COAST_WITHOUT_IMU_MPS2 = 0.3, 1.5
"""acceleration that the filter does not know of between barometer samples"""
REFERENCE_TIME_S = 30.0
"""Averaging time of GNSS heights for the reported spread."""
COLUMN_TEMPERATURE_ERROR = 0.035
"""relative error of the mean temperature of the air below: 10 K of 288"""


INPUTS = np.dtype(
    [
        ("attitude", ATTITUDE_STATE),
        ("setting", SETTING),
        ("outage", OUTAGE),
        ("started_by_setting", "i8"),
        ("acceleration_mps2", "f8"),  # newest; NaN while there is no IMU that can be integrated
        *ring_fields("baro", RING_SIZE),  # standard-atmosphere heights until the start
        ("first_fix_us", "i8"),  # -1 none
        ("start_fixes", "i8"),  # credible fixes so far
        ("start_count", "i8"),  # those that met a barometer height
        ("start_offsets_m", "f8", (MOST_START_FIXES,)),  # GNSS less barometer of each, sorted
        ("level_m", "f8"),  # pressure altitude of the newest pressure
        ("start_level_m", "f8"),  # pressure altitude, height and spread of the start; NaN before
        ("start_height_m", "f8"),  # geopotential
        ("start_var_m2", "f8"),
        ("start_us", "i8"),
        ("start_air_k", "f8"),  # air temperature told before the start, NaN none
        ("scale", "f8"),  # s of (2)
        ("wait_us", "i8"),  # since when the filter waits for the barometer, -1 not
        ("wait_m", "f8"),  # barometer height then
        ("reference_m", "f8"),  # mean of GNSS height less altitude
        ("reference_var_m2", "f8"),
        ("reference_us", "i8"),  # -1 none
    ],
    align=True,
)
"""The record of this component."""


@step
def start_inputs(inputs: Record) -> None:
    """Nothing known."""
    attitude_start(inputs.attitude)
    setting_start(inputs.setting)
    outage_start(inputs.outage)
    inputs.started_by_setting = 0
    clear(inputs.baro_us, inputs.baro_values)
    inputs.acceleration_mps2 = math.nan
    inputs.first_fix_us = -1
    inputs.start_fixes = 0
    inputs.start_count = 0
    for i in range(MOST_START_FIXES):
        inputs.start_offsets_m[i] = math.nan
    inputs.level_m = math.nan
    inputs.start_level_m = math.nan
    inputs.start_height_m = math.nan
    inputs.start_var_m2 = math.nan
    inputs.start_us = -1
    inputs.start_air_k = math.nan
    inputs.scale = 0.0
    inputs.wait_us = -1
    inputs.wait_m = math.nan
    inputs.reference_m = 0.0
    inputs.reference_var_m2 = math.nan
    inputs.reference_us = -1


@step
def take_imu(inputs: Record, sample: Rows) -> bool:
    """Upward acceleration of a judged sample; False, and NaN, when samples come too seldom to be
    integrated."""
    attitude_imu(inputs.attitude, sample)
    integrable = imu_can_be_integrated(inputs.attitude)
    inputs.acceleration_mps2 = (
        up_acceleration_mps2(inputs.attitude, sample) if integrable else math.nan
    )
    return integrable


@step
def take_pressure(inputs: Record, params: Rows, sample: Rows, imu_us: int) -> float:
    """Calibrated barometer height H, geometric, of a judged sample; NaN until the start is
    known."""
    inputs.level_m = pressure_altitude_m(sample[0].pressure_pa)
    if not math.isnan(inputs.acceleration_mps2) and sample[0].time_us - imu_us > IMU_TIMEOUT_US:
        inputs.acceleration_mps2 = math.nan
    if inputs.start_us < 0:
        push(
            inputs.baro_us,
            inputs.baro_values,
            sample[0].time_us,
            baro_altitude_m(sample[0].pressure_pa),
        )
        _note_temperature(inputs, params, sample[0].die_temperature_k)
        note_level(inputs.setting, inputs.level_m)
        if not math.isnan(params[0].start_altitude_m):
            _start_at(
                inputs, sample[0].time_us, params[0].start_altitude_m, params[0].gnss_sd_floor_m
            )
        elif is_set(inputs.setting):
            altitude_m = indicated_m(inputs.setting, inputs.level_m)
            sd_m = indicated_sd_m(inputs.setting, altitude_m, sample[0].time_us)
            if inputs.wait_us >= 0:
                inputs.wait_m += altitude_m - calibrated_m(
                    inputs.level_m, inputs.start_level_m, inputs.start_height_m, inputs.scale
                )
            _start_at(inputs, sample[0].time_us, altitude_m, sd_m)
            inputs.started_by_setting = 1
        else:
            return math.nan
    return calibrated_m(inputs.level_m, inputs.start_level_m, inputs.start_height_m, inputs.scale)


@step
def fuse_setting(inputs: Record, sample: Rows) -> None:
    """Take the setting of the altimeter: with the next pressure the start is anew at it. A start by
    GNSS, and a setting that GNSS has been compared with, count more than a QNH, and less than the
    field's elevation of a vehicle at rest."""
    changed = note_air(inputs.setting, sample, not math.isnan(inputs.level_m))
    is_alone = inputs.started_by_setting == 1 and inputs.reference_us < 0
    if changed and (is_alone or waits_for_level(inputs.setting)):
        inputs.start_us, inputs.reference_us = -1, -1
        inputs.reference_m = 0.0


@step
def note_start_temperature(inputs: Record, sample: Rows) -> None:
    """Take the air temperature of an AIR sample for that of the start, until the start."""
    if inputs.start_us < 0 and has_temperature(sample):
        inputs.start_air_k = sample[0].air_temperature_k


@step
def calibrated_m(
    level_m: float, start_level_m: float, start_height_m: float, scale: float
) -> float:
    """H of (2) with the start as its reference: geopotential heights in, geometric height out."""
    return geometric_m(start_height_m + (1.0 + scale) * (level_m - start_level_m))


@step
def note_fix(
    inputs: Record,
    params: Rows,
    sample: Rows,
    estimate: Rows,
    altitude_m: float,
    now_us: int,
    pressure_us: int,
) -> None:
    """A judged fix: counts for the start, or is compared with `altitude_m`, the filter's altitude
    at the fix's time (NaN none)."""
    p = params[0]
    attitude_gnss(inputs.attitude, sample)
    sd_m = gnss_sd_m(sample, p.gnss_sd_floor_m, p.gnss_sd_unknown_m)
    if inputs.first_fix_us < 0:
        inputs.first_fix_us = sample[0].time_us
    has_waited = sample[0].time_us - inputs.first_fix_us >= START_WAIT_US
    counts = sd_m <= (LARGEST_START_SD_M if has_waited else START_SD_M)
    if counts:
        inputs.start_fixes += 1
    if baro_is_silent(pressure_us, now_us):
        if inputs.start_fixes >= p.start_fixes:
            estimate[0].time_us = sample[0].time_us
            estimate[0].altitude_amsl_m = sample[0].altitude_amsl_m
            estimate[0].climb_mps = sample[0].climb_mps
            estimate[0].altitude_sd_m = sd_m
            estimate[0].baro_offset_m = math.nan
            estimate[0].innovation_m = math.nan
    elif inputs.start_us < 0:
        baro_m = at(inputs.baro_us, inputs.baro_values, sample[0].time_us, REACH_US)
        if counts and not math.isnan(baro_m):
            _insert(inputs, sample[0].altitude_amsl_m - baro_m)
            if inputs.start_count >= p.start_fixes:
                middle = inputs.start_count // 2
                offset_m = 0.5 * (
                    inputs.start_offsets_m[middle]
                    + inputs.start_offsets_m[inputs.start_count - 1 - middle]
                )
                _start_at(inputs, now_us, geometric_m(inputs.level_m) + offset_m, sd_m)
    elif not math.isnan(altitude_m):
        estimate[0].innovation_m = sample[0].altitude_amsl_m - altitude_m
        _reference(inputs, sample[0].time_us, estimate[0].innovation_m, sd_m)
        gnss_m, speed_mps = sample[0].altitude_amsl_m, sample[0].ground_speed_mps
        note_difference(inputs.outage, sample[0].time_us, gnss_m, altitude_m, speed_mps, sd_m)


@step
def _insert(inputs: Record, offset_m: float) -> None:
    """Put a GNSS-less-barometer height in its place among the sorted ones."""
    place = inputs.start_count
    while place > 0 and inputs.start_offsets_m[place - 1] > offset_m:
        inputs.start_offsets_m[place] = inputs.start_offsets_m[place - 1]
        place -= 1
    inputs.start_offsets_m[place] = offset_m
    inputs.start_count += 1


@step
def _start_at(inputs: Record, time_us: int, altitude_m: float, sd_m: float) -> None:
    """The newest pressure belongs to this altitude."""
    inputs.start_us = time_us
    inputs.start_level_m = inputs.level_m
    inputs.start_height_m = geopotential_m(altitude_m)
    inputs.start_var_m2 = sd_m * sd_m


@step
def _note_temperature(inputs: Record, params: Rows, die_temperature_k: float) -> None:
    """s of (2): the air's temperature at the newest pressure against the standard's there."""
    temperature_k = params[0].start_temperature_k
    if math.isnan(temperature_k):
        temperature_k = inputs.start_air_k
    if math.isnan(temperature_k) and params[0].use_die_temperature == 1:
        temperature_k = die_temperature_k - params[0].die_excess_k
    if temperature_k > 0.0:
        inputs.scale = temperature_k / (T0_K + L0_KPM * inputs.level_m) - 1.0


@step
def _reference(inputs: Record, time_us: int, innovation_m: float, sd_m: float) -> None:
    elapsed_s = (time_us - inputs.reference_us) * 1e-6 if inputs.reference_us >= 0 else 0.0
    inputs.reference_m += (
        elapsed_s / (elapsed_s + REFERENCE_TIME_S) * (innovation_m - inputs.reference_m)
    )
    inputs.reference_var_m2 = sd_m * sd_m
    inputs.reference_us = time_us


@step
def baro_is_silent(pressure_us: int, time_us: int) -> bool:
    """Whether no barometer sample came for `BARO_TIMEOUT_US`."""
    return pressure_us < 0 or time_us - pressure_us > BARO_TIMEOUT_US


@step
def gate_m(inputs: Record, elapsed_s: float) -> float:
    """How far the barometer may be from the filter's prediction over `elapsed_s`."""
    return GATE_M + (
        GATE_WITHOUT_IMU_MPS * elapsed_s if math.isnan(inputs.acceleration_mps2) else 0.0
    )


@step
def waited_climb_mps(inputs: Record, time_us: int, calibrated: float) -> float:
    """The barometer's mean slope once the filter has waited long enough to start at it, else
    NaN."""
    if inputs.wait_us < 0:
        inputs.wait_us = time_us
        inputs.wait_m = calibrated
    if time_us - inputs.wait_us < SETTLE_US:
        return math.nan
    climb_mps = (calibrated - inputs.wait_m) / ((time_us - inputs.wait_us) * 1e-6)
    inputs.wait_us = -1
    return climb_mps


@step
def write_altitude(
    inputs: Record,
    params: Rows,
    estimate: Rows,
    time_us: int,
    altitude_m: float,
    climb_mps: float,
    own_var_m2: float,
    pressure_us: int,
) -> None:
    """An altitude, and the error to expect of it: the filter's own and that of its reference
    (`reference_sd_m`)."""
    coast_s = max(0.0, (time_us - pressure_us) * 1e-6)
    unknown = COAST_WITHOUT_IMU_MPS2 if math.isnan(inputs.acceleration_mps2) else COAST_ERROR_MPS2
    coast_m = 0.5 * unknown * coast_s * coast_s
    level_sd_m = reference_sd_m(inputs, params, time_us, altitude_m)
    estimate[0].time_us = time_us
    estimate[0].altitude_amsl_m = altitude_m
    estimate[0].climb_mps = climb_mps
    estimate[0].altitude_sd_m = math.sqrt(level_sd_m * level_sd_m + own_var_m2 + coast_m * coast_m)
    estimate[0].baro_offset_m = altitude_m - geometric_m(inputs.level_m)


@step
def reference_sd_m(inputs: Record, params: Rows, time_us: int, altitude_m: float) -> float:
    """Root mean square error to expect of the compensated barometer: start, weather, temperature,
    as far as GNSS shows.

    With the variance V of the first three and the mean m of GNSS less altitude with variance M, the
    error is m V / (V + M) on the average, spread by V M / (V + M). It is not corrected, so both
    count, and V is no less than m shows; and what the barometer has moved by since the last fix.
    """
    p = params[0]
    until_us = max(time_us, inputs.start_us) if inputs.reference_us < 0 else inputs.reference_us
    weather_m = p.pressure_drift_mps * (until_us - inputs.start_us) * 1e-6
    told = not math.isnan(inputs.start_air_k)
    column_error = KNOWN_COLUMN_RATIO if told else COLUMN_TEMPERATURE_ERROR
    column_m = column_error * (altitude_m - inputs.start_height_m)
    prior = inputs.start_var_m2 + weather_m * weather_m + column_m * column_m
    if inputs.reference_us >= 0:
        prior = max(prior, inputs.reference_m**2 - inputs.reference_var_m2)
    weight = 0.0 if inputs.reference_us < 0 else prior / (prior + inputs.reference_var_m2)
    seen_m = weight * inputs.reference_m
    unseen_m = p.pressure_drift_mps * gap_s(inputs.outage, time_us)
    unseen_m2 = unseen_m * unseen_m + growth_m2(inputs.outage, time_us, altitude_m)
    return math.sqrt(seen_m * seen_m + prior * (1.0 - weight) + unseen_m2)
