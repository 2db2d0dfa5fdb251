"""What the two baro-inertial filters of one paper share: their inputs.

J. Keighobadi, H. Nourmohammadi, S. Rafatnia, "Design and Implementation of GA Filter Algorithm for
Baro-inertial Altitude Error Compensation". `damping_loop` and `baro_ins_kf` differ only in how they
join the two inputs of this module:

==============  =========================  =============================================================
H               ``calibrated_m``           barometer height, compensated for an atmosphere that is not standard (2)
A_z             ``acceleration_mps2``      upward acceleration: specific force along the vertical, less local gravity
==============  =========================  =============================================================

Start height
------------
The paper computes s and b of (2) from temperature and pressure "at sea level", which (5) derives from the very
height that is to be calibrated: it is circular, and on an exactly standard day it shifts a vehicle at 1350 m by -82 or
+85 m. Here the height of the start is given: the median of the first ``start_fixes`` credible GNSS heights (each
compared with the barometer at its own time, so that the vehicle may move meanwhile), or the setting
``start_altitude_m``. From there on

    H = H_start + (1 + s) (H_p - H_p,start),      1 + s = T_start / T_standard(H_p,start)

which is (2) with s = Delta T / T at the start; in a layer of constant lapse rate it is exactly the
hypsometric formula from the start's pressure, temperature and height. Without a temperature s = 0.
The temperature that MAVLink carries is the sensor die's, 10-30 K above the air: by default it is
not used.

GNSS after the start
--------------------
A baro-inertial filter does not use it. Here its heights only bear witness: the altitude never follows them, the
reported spread does. While the barometer is silent for five seconds the estimate is GNSS height alone.
"""

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from companion.config import Settings
from companion.estimators.judging import IMU, PRESSURE
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
from companion.samples import Rows, rows

LOWEST_PA, HIGHEST_PA = 1_000.0, 120_000.0
BARO_TIMEOUT_US = 5_000_000
IMU_TIMEOUT_US = 500_000
REACH_US = 1_000_000
RING_SIZE = 64
MOST_START_FIXES = 64
START_SD_M = 20.0
"""a fix with a larger spread does not count for the start: receivers slide by hundreds of metres
while they say so"""
SETTLE_US = 2_000_000
"""for so long the barometer must have been there, or have contradicted the filter, before the
filter starts at it"""
GATE_M = 10.0
"""no vehicle leaves its inertial path by so much between barometer samples; a step of the barometer
does"""
GATE_WITHOUT_IMU_MPS = 10.0
"""more for each second since the last barometer sample when nothing is known of the acceleration"""
COAST_ERROR_MPS2, COAST_WITHOUT_IMU_MPS2 = 0.3, 1.5
"""acceleration that the filter does not know of between barometer samples"""
WITNESS_TIME_S = 30.0
"""GNSS heights are averaged over this time before they bear witness"""
COLUMN_TEMPERATURE_ERROR = 0.035
"""of the mean temperature of the air below: 10 K of 288"""


def input_fields() -> tuple[tuple[Any, ...], ...]:
    """The state fields of this component."""
    return (
        ("attitude", ATTITUDE_STATE),
        ("acceleration_mps2", "f8"),  # newest; NaN while there is no IMU that can be integrated
        *ring_fields("baro", RING_SIZE),  # standard-atmosphere heights until the start
        ("start_fixes", "i8"),  # credible fixes so far
        ("start_count", "i8"),  # those that met a barometer height
        (
            "start_offsets_m",
            "f8",
            (MOST_START_FIXES,),
        ),  # GNSS less barometer height of each, sorted
        ("level_m", "f8"),  # pressure altitude of the newest pressure
        ("start_level_m", "f8"),  # pressure altitude, height and spread of the start; NaN before
        ("start_height_m", "f8"),  # geopotential
        ("start_var_m2", "f8"),
        ("start_us", "i8"),
        ("scale", "f8"),  # s of (2)
        (
            "wait_us",
            "i8",
        ),  # since when the filter waits for the barometer, -1 not; and its height then
        ("wait_m", "f8"),
        ("witness_m", "f8"),  # mean of GNSS height less altitude
        ("witness_var_m2", "f8"),
        ("witness_us", "i8"),  # -1 none
    )


INPUT_PARAMS: tuple[tuple[str, str], ...] = (
    ("start_altitude_m", "f8"),
    ("start_fixes", "i8"),
    ("start_temperature_k", "f8"),
    ("use_die_temperature", "i8"),
    ("die_excess_k", "f8"),
    ("use_attitude", "i8"),
    ("gnss_sd_floor_m", "f8"),
    ("gnss_sd_unknown_m", "f8"),
    ("pressure_drift_mps", "f8"),
)


class InputSettings(Settings):
    """What both filters' sections have in common."""

    start_altitude_m: float | None = Field(None, ge=-1000, le=20_000)
    """height above mean sea level of the place of the start, where it is known; otherwise from GNSS"""
    start_fixes: int = Field(15, ge=1, le=MOST_START_FIXES)
    """how many credible GNSS heights the start is the median of"""
    start_temperature_k: Annotated[float, Field(gt=150, le=350)] | Literal["standard", "die"] = (
        "standard"
    )
    """air temperature at the start: a number, the standard atmosphere's, or the sensor die's less
    die_excess_k"""
    die_excess_k: float = Field(20.0, ge=0, le=60)
    """how much warmer the sensor is than the air"""
    use_attitude: bool = True
    """take the autopilot's roll and pitch while they agree with our own"""
    gnss_sd_floor_m: float = Field(1.0, gt=0, le=100)
    """a claimed spread below this is not believed"""
    gnss_sd_unknown_m: float = Field(13.0, gt=0, le=1000)
    """spread of a receiver that claims nothing"""
    pressure_drift_mps: float = Field(0.003, ge=0, le=10)
    """how fast weather moves the pressure level: 10 m an hour is usual, 30 a front"""

    def input_params(self, dtype: np.dtype[Any]) -> Rows:
        """A row of parameters with the common ones filled in."""
        row, temperature = rows(dtype), self.start_temperature_k
        row["start_altitude_m"] = (
            math.nan if self.start_altitude_m is None else self.start_altitude_m
        )
        row["start_temperature_k"] = math.nan if isinstance(temperature, str) else temperature
        row["use_die_temperature"] = temperature == "die"
        for name in (
            "start_fixes",
            "die_excess_k",
            "use_attitude",
            "gnss_sd_floor_m",
            "gnss_sd_unknown_m",
        ):
            row[name] = getattr(self, name)
        row["pressure_drift_mps"] = self.pressure_drift_mps
        return row


@step
def start_inputs(state: Rows) -> None:
    """Nothing known."""
    s = state[0]
    attitude_start(state[0].attitude)
    clear(s.baro_us, s.baro_values)
    s.acceleration_mps2 = math.nan
    s.start_fixes = 0
    s.start_count = 0
    for i in range(MOST_START_FIXES):
        s.start_offsets_m[i] = math.nan
    s.level_m = math.nan
    s.start_level_m = math.nan
    s.start_height_m = math.nan
    s.start_var_m2 = math.nan
    s.start_us = -1
    s.scale = 0.0
    s.wait_us = -1
    s.wait_m = math.nan
    s.witness_m = 0.0
    s.witness_var_m2 = math.nan
    s.witness_us = -1


@step
def take_imu(state: Rows, sample: Rows) -> bool:
    """Upward acceleration of a judged sample; False, and NaN, when samples come too seldom to be
    integrated."""
    attitude_imu(state[0].attitude, sample)
    integrable = imu_can_be_integrated(state[0].attitude)
    state[0].acceleration_mps2 = (
        up_acceleration_mps2(state[0].attitude, sample) if integrable else math.nan
    )
    return integrable


@step
def take_pressure(state: Rows, params: Rows, sample: Rows) -> float:
    """Calibrated barometer height H, geometric, of a judged sample; NaN until the start is known."""
    s = state[0]
    s.level_m = pressure_altitude_m(sample[0].pressure_pa)
    if (
        not math.isnan(s.acceleration_mps2)
        and sample[0].time_us - s.last_us[IMU, 0] > IMU_TIMEOUT_US
    ):
        s.acceleration_mps2 = math.nan
    if s.start_us < 0:
        push(s.baro_us, s.baro_values, sample[0].time_us, baro_altitude_m(sample[0].pressure_pa))
        _note_temperature(state, params, sample[0].die_temperature_k)
        if math.isnan(params[0].start_altitude_m):
            return math.nan
        _start_at(state, sample[0].time_us, params[0].start_altitude_m, params[0].gnss_sd_floor_m)
    return calibrated_m(s.level_m, s.start_level_m, s.start_height_m, s.scale)


@step
def calibrated_m(
    level_m: float, start_level_m: float, start_height_m: float, scale: float
) -> float:
    """H of (2) with the start as its reference: geopotential heights in, geometric height out."""
    return geometric_m(start_height_m + (1.0 + scale) * (level_m - start_level_m))


@step
def take_fix(state: Rows, params: Rows, sample: Rows, estimate: Rows, altitude_m: float) -> None:
    """A judged fix: towards the start, or against `altitude_m`, the filter's altitude at the fix's
    time (NaN none)."""
    s, p = state[0], params[0]
    attitude_gnss(state[0].attitude, sample)
    sd_m = gnss_sd_m(sample, p.gnss_sd_floor_m, p.gnss_sd_unknown_m)
    if sd_m <= START_SD_M:
        s.start_fixes += 1
    if baro_is_silent(state, s.now_us):
        if s.start_fixes >= p.start_fixes:
            estimate[0].time_us = sample[0].time_us
            estimate[0].altitude_amsl_m = sample[0].altitude_amsl_m
            estimate[0].climb_mps = sample[0].climb_mps
            estimate[0].altitude_sd_m = sd_m
            estimate[0].baro_offset_m = math.nan
            estimate[0].innovation_m = math.nan
    elif s.start_us < 0:
        baro_m = at(s.baro_us, s.baro_values, sample[0].time_us, REACH_US)
        if sd_m <= START_SD_M and not math.isnan(baro_m):
            _insert(state, sample[0].altitude_amsl_m - baro_m)
            if s.start_count >= p.start_fixes:
                middle = s.start_count // 2
                offset_m = 0.5 * (
                    s.start_offsets_m[middle] + s.start_offsets_m[s.start_count - 1 - middle]
                )
                _start_at(state, s.now_us, geometric_m(s.level_m) + offset_m, sd_m)
    elif not math.isnan(altitude_m):
        estimate[0].innovation_m = sample[0].altitude_amsl_m - altitude_m
        _witness(state, sample[0].time_us, estimate[0].innovation_m, sd_m)


@step
def _insert(state: Rows, offset_m: float) -> None:
    """Put a GNSS-less-barometer height in its place among the sorted ones."""
    s = state[0]
    place = s.start_count
    while place > 0 and s.start_offsets_m[place - 1] > offset_m:
        s.start_offsets_m[place] = s.start_offsets_m[place - 1]
        place -= 1
    s.start_offsets_m[place] = offset_m
    s.start_count += 1


@step
def _start_at(state: Rows, time_us: int, altitude_m: float, sd_m: float) -> None:
    """The newest pressure belongs to this altitude."""
    s = state[0]
    s.start_us = time_us
    s.start_level_m = s.level_m
    s.start_height_m = geopotential_m(altitude_m)
    s.start_var_m2 = sd_m * sd_m


@step
def _note_temperature(state: Rows, params: Rows, die_temperature_k: float) -> None:
    """s of (2): the air's temperature at the newest pressure against the standard's there."""
    temperature_k = params[0].start_temperature_k
    if params[0].use_die_temperature == 1:
        temperature_k = die_temperature_k - params[0].die_excess_k
    if temperature_k > 0.0:
        state[0].scale = temperature_k / (T0_K + L0_KPM * state[0].level_m) - 1.0


@step
def _witness(state: Rows, time_us: int, innovation_m: float, sd_m: float) -> None:
    s = state[0]
    elapsed_s = (time_us - s.witness_us) * 1e-6 if s.witness_us >= 0 else 0.0
    s.witness_m += elapsed_s / (elapsed_s + WITNESS_TIME_S) * (innovation_m - s.witness_m)
    s.witness_var_m2 = sd_m * sd_m
    s.witness_us = time_us


@step
def baro_is_silent(state: Rows, time_us: int) -> bool:
    """Whether no barometer sample came for `BARO_TIMEOUT_US`."""
    return (
        state[0].last_us[PRESSURE, 0] < 0
        or time_us - state[0].last_us[PRESSURE, 0] > BARO_TIMEOUT_US
    )


@step
def gate_m(state: Rows, elapsed_s: float) -> float:
    """How far the barometer may be from the filter's prediction over `elapsed_s`."""
    return GATE_M + (
        GATE_WITHOUT_IMU_MPS * elapsed_s if math.isnan(state[0].acceleration_mps2) else 0.0
    )


@step
def waited_climb_mps(state: Rows, time_us: int, calibrated: float) -> float:
    """The barometer's mean slope once the filter has waited long enough to start at it, else NaN."""
    s = state[0]
    if s.wait_us < 0:
        s.wait_us = time_us
        s.wait_m = calibrated
    if time_us - s.wait_us < SETTLE_US:
        return math.nan
    climb_mps = (calibrated - s.wait_m) / ((time_us - s.wait_us) * 1e-6)
    s.wait_us = -1
    return climb_mps


@step
def write_altitude(
    state: Rows,
    params: Rows,
    estimate: Rows,
    time_us: int,
    altitude_m: float,
    climb_mps: float,
    own_var_m2: float,
) -> None:
    """An altitude, and the error to expect of it: the filter's own and that of its reference
    (`reference_sd_m`)."""
    s = state[0]
    coast_s = max(0.0, (time_us - s.last_us[PRESSURE, 0]) * 1e-6)
    unknown = COAST_WITHOUT_IMU_MPS2 if math.isnan(s.acceleration_mps2) else COAST_ERROR_MPS2
    coast_m = 0.5 * unknown * coast_s * coast_s
    reference_m = reference_sd_m(state, params, time_us, altitude_m)
    estimate[0].time_us = time_us
    estimate[0].altitude_amsl_m = altitude_m
    estimate[0].climb_mps = climb_mps
    estimate[0].altitude_sd_m = math.sqrt(
        reference_m * reference_m + own_var_m2 + coast_m * coast_m
    )
    estimate[0].baro_offset_m = altitude_m - geometric_m(s.level_m)


@step
def reference_sd_m(state: Rows, params: Rows, time_us: int, altitude_m: float) -> float:
    """Root mean square error to expect of the compensated barometer: start, weather, temperature;
    GNSS's word.

    With the variance V of the first three and the witness's mean m with variance M, the error is m
    V / (V + M) on the average, spread by V M / (V + M). It is not corrected, so both count; and the
    weather since the last fix.
    """
    s, p = state[0], params[0]
    since_us = s.start_us if s.witness_us < 0 else s.witness_us
    unseen_m = p.pressure_drift_mps * max(0.0, (time_us - since_us) * 1e-6)
    weather_m = p.pressure_drift_mps * (since_us - s.start_us) * 1e-6
    column_m = COLUMN_TEMPERATURE_ERROR * (altitude_m - s.start_height_m)
    prior = s.start_var_m2 + weather_m * weather_m + column_m * column_m
    weight = 0.0 if s.witness_us < 0 else prior / (prior + s.witness_var_m2)
    seen_m = weight * s.witness_m
    return math.sqrt(seen_m * seen_m + prior * (1.0 - weight) + unseen_m * unseen_m)
