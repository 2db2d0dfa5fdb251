"""The setting window of an altimeter, shared by the estimators: altitude from pressure and QNH.

An altimeter set to a QNH indicates H_p(p) - H_p(QNH), geopotential. The setting comes in AIR
samples: a QNH, or the known elevation of the field on which the vehicle rests; the elevation counts
more, as it sets the altimeter to the vehicle's own barometer. An air temperature in the same sample
is that of the field: heights above the field are then scaled by its ratio to the standard
temperature there. An estimator holds a `SETTING` record, calls `note_air` for an AIR sample that
`judge_air` admits, and asks `indicated_m` and `indicated_sd_m`.

The spread of the indicated altitude has four parts: that of the setting itself, weather since it
was set, the temperature of the column between the field and the vehicle, and the barometer's own
error.
"""

import math

import numpy as np

from companion.estimators.judging import (
    AIR,
    HIGHEST_AIR_K,
    IGNORED,
    INVALID,
    LOWEST_AIR_K,
    STALE,
    USED,
    is_stale,
    place,
    tally,
)
from companion.jit import step
from companion.kernels.atmosphere import (
    L0_KPM,
    T0_K,
    geometric_m,
    geopotential_m,
    pressure_altitude_m,
    qnh_pa,
    standard_pressure_pa,
)
from companion.samples import MAX_INSTANCES, Record, Rows

LOWEST_QNH_PA, HIGHEST_QNH_PA = 85_000.0, 110_000.0
LOWEST_FIELD_M, HIGHEST_FIELD_M = -500.0, 9_000.0
SEA_LEVEL_M = 0.0
"""where a setting holds whose field is unknown (`is_placed` 0)"""
SETTING_SD_PA = 60.0
"""Spread of a setting: METARs are whole hectopascals, rounded down, and the field is not the
station; with the barometer's calibration of 50 Pa."""
ELEVATION_SD_M = 1.0
"""Spread of a setting by the field's elevation: that of the place on the field."""
STANDARD_SD_PA = 1_000.0
"""Spread of the sea-level pressure about 1013.25 hPa where no setting is known."""
WEATHER_MPS = 0.003
"""Drift of the pressure level with weather: 10 m an hour."""
COLUMN_RATIO = 0.035
"""Relative error of the height above the field where the air is 10 K off the standard."""
KNOWN_COLUMN_RATIO = 0.015
"""The same where the field's air temperature is known: 2 K of the thermometer, and a lapse rate
that is 3 K/km off up to 2.5 km above the field (4 K in 280 K together)."""
M_PER_PA = 0.0832
"""Change of the indicated altitude per pascal of setting, at sea level."""

SETTING = np.dtype(
    [
        ("qnh_pa", "f8"),  # NaN unknown
        ("sd_m", "f8"),  # of the indicated altitude, when it was set
        ("told_pa", "f8"),  # the QNH that was told last, NaN none
        ("set_us", "i8"),
        ("field_m", "f8"),  # height where the setting holds; NaN: where the next pressure is
        ("is_placed", "i8"),  # 0 where that is unknown, and sea level stands for it
        ("elevation_m", "f8"),  # known elevation that waits for a pressure, NaN none
        ("air_k", "f8"),  # air temperature at the field, NaN unknown
        ("is_new", "i8"),  # 1 until the estimator has used it
    ],
    align=True,
)
"""The record of this component."""


@step
def setting_start(setting: Record) -> None:
    """No setting known."""
    setting.qnh_pa, setting.field_m, setting.elevation_m = math.nan, math.nan, math.nan
    setting.told_pa, setting.sd_m, setting.air_k = math.nan, math.nan, math.nan
    setting.set_us, setting.is_new, setting.is_placed = -1, 0, 0


@step
def judge_air(state: Rows, sample: Rows) -> int:
    """USED for a sample with a possible QNH, air temperature or field elevation, else STALE or
    INVALID."""
    if not 0 <= sample[0].instance < MAX_INSTANCES:
        return INVALID
    if not has_temperature(sample) and not has_setting(sample):
        return INVALID
    return STALE if is_stale(state, AIR, sample[0].instance, sample[0].time_us) else USED


@step
def has_setting(sample: Rows) -> bool:
    """Whether an AIR sample tells a QNH or an elevation of the field."""
    return (
        LOWEST_QNH_PA <= sample[0].qnh_pa <= HIGHEST_QNH_PA
        or LOWEST_FIELD_M <= sample[0].field_elevation_m <= HIGHEST_FIELD_M
    )


@step
def has_temperature(sample: Rows) -> bool:
    """Whether an AIR sample tells a possible air temperature."""
    return LOWEST_AIR_K <= sample[0].air_temperature_k <= HIGHEST_AIR_K


@step
def admit_setting(state: Rows, sample: Rows, warms: bool) -> int:
    """The verdict, counted, of an AIR sample for an estimator that uses a setting of the altimeter:
    USED when it tells one, or a temperature while the estimator uses that (`warms`); IGNORED when
    it tells a temperature alone otherwise."""
    if sample[0].instance != 0:
        return tally(state, AIR, IGNORED)
    verdict = judge_air(state, sample)
    if verdict == USED:
        place(state, AIR, 0, sample[0].time_us)
        wanted = has_setting(sample) or (warms and has_temperature(sample))
        verdict = USED if wanted else IGNORED
    return tally(state, AIR, verdict)


@step
def note_air(setting: Record, sample: Rows, in_flight: bool) -> bool:
    """Take the setting of an AIR sample; whether it tells anything new.

    A QNH that comes before the first pressure holds where the vehicle is. One that comes later
    holds where it was measured, or at sea level while that is unknown; an air temperature is then
    not used, since nothing tells its height.
    """
    qnh, at_m, elevation, air_k = (
        sample[0].qnh_pa,
        sample[0].qnh_elevation_m,
        sample[0].field_elevation_m,
        sample[0].air_temperature_k,
    )
    has_qnh, is_measured = LOWEST_QNH_PA <= qnh <= HIGHEST_QNH_PA, sample[0].qnh_sd_pa > 0.0
    knows_field = LOWEST_FIELD_M <= elevation <= HIGHEST_FIELD_M
    if has_qnh and knows_field and math.isnan(at_m):
        at_m, knows_field = elevation, False
    field_m, is_placed = math.nan, 1
    has_place = LOWEST_FIELD_M <= at_m <= HIGHEST_FIELD_M
    if has_place:
        field_m = at_m
    elif in_flight and math.isnan(setting.field_m):
        field_m, is_placed = SEA_LEVEL_M, 0
    elif in_flight:
        field_m, is_placed = setting.field_m, setting.is_placed
    warms = has_temperature(sample) and (knows_field or is_placed == 1)
    is_told, is_moved = knows_field, has_place and setting.field_m != at_m
    if has_qnh and (is_measured or is_moved or qnh != setting.told_pa):
        setting.qnh_pa, setting.told_pa, setting.elevation_m = qnh, qnh, math.nan
        setting.sd_m = M_PER_PA * (sample[0].qnh_sd_pa if is_measured else SETTING_SD_PA)
        setting.field_m, setting.is_placed = field_m, is_placed
        is_told = True
    if knows_field:
        setting.elevation_m = elevation
    if is_told:
        setting.set_us = sample[0].time_us
    elif not (has_qnh and warms and air_k != setting.air_k):
        return False
    if warms or not is_measured:
        setting.air_k = air_k if warms else math.nan
    setting.is_new = 1
    return True


@step
def note_level(setting: Record, level_m: float) -> None:
    """Complete the setting with a pressure altitude (geopotential), once one is known."""
    if not math.isnan(setting.elevation_m):
        setting.qnh_pa = qnh_pa(standard_pressure_pa(level_m), setting.elevation_m)
        setting.field_m, setting.is_placed = setting.elevation_m, 1
        setting.elevation_m = math.nan
        setting.sd_m = ELEVATION_SD_M
    if math.isnan(setting.field_m) and not math.isnan(setting.qnh_pa):
        setting.field_m = indicated_m(setting, level_m)


@step
def is_set(setting: Record) -> bool:
    """Whether a setting is known."""
    return not math.isnan(setting.qnh_pa)


@step
def waits_for_level(setting: Record) -> bool:
    """Whether the elevation of a vehicle at rest has just been told: it counts more than the GNSS
    heights before it."""
    return not math.isnan(setting.elevation_m)


@step
def indicated_m(setting: Record, level_m: float) -> float:
    """Indicated altitude, geometric, at a pressure altitude (geopotential); with 1013.25 hPa while
    no setting is known. Where the field's air temperature is known, the height above the field is
    that of a column with this temperature."""
    datum_m = 0.0 if math.isnan(setting.qnh_pa) else pressure_altitude_m(setting.qnh_pa)
    if math.isnan(setting.air_k) or math.isnan(setting.field_m):
        return geometric_m(level_m - datum_m)
    field_m = geopotential_m(setting.field_m)
    column_ratio = setting.air_k / (T0_K + L0_KPM * (datum_m + field_m))
    return geometric_m(field_m + column_ratio * (level_m - datum_m - field_m))


@step
def indicated_sd_m(setting: Record, altitude_m: float, now_us: int) -> float:
    """Spread of the indicated altitude."""
    if math.isnan(setting.qnh_pa):
        column_m = COLUMN_RATIO * altitude_m
        return math.hypot(STANDARD_SD_PA * M_PER_PA, column_m)
    field_m = 0.0 if math.isnan(setting.field_m) else setting.field_m
    weather_m = WEATHER_MPS * max(0.0, (now_us - setting.set_us) * 1e-6)
    ratio = COLUMN_RATIO if math.isnan(setting.air_k) else KNOWN_COLUMN_RATIO
    column_m = ratio * (altitude_m - field_m)
    return math.hypot(math.hypot(setting.sd_m, weather_m), column_m)
