"""Hours of flight at the level of the sensors, for Monte Carlo: as the vertical bank's own model
says they are.

The barometer's error drifts at a rate that is Gauss-Markov with the spread of the weather's kind,
as are its gusts; the kind changes as the bank assumes. GNSS wanders and is noisy as its reported
spread is split. Height climbs and descends in ramps. Attitude is level. Same seed, same flight.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.estimators.method import Method
from companion.estimators.vertical_bank import steps as vb
from companion.estimators.vertical_bank.settings import VerticalBankSettings
from companion.kernels.atmosphere import EARTH_RADIUS_M, G0_MPS2, L0_KPM, P0_PA, R_AIR, T0_K
from companion.kernels.earth import gravity_mps2
from companion.samples import DTYPES, ESTIMATE, ORDER, Kind, Rows, Tables, readable, rows

Array = NDArray[np.float64]
LATITUDE_DEG = 45.0
STEP_S = 0.1
AGE_US = {Kind.IMU: 2_000, Kind.PRESSURE: 63_000, Kind.GNSS: 170_000}
"""age of a row at its arrival: pressures and fixes arrive after newer IMU samples, as on a real
link"""
START_S = 30.0
GROUND_SPEED_MPS, WIND_TIME_S = 30.0, 60.0
SLOW_SHARE = 0.7
"""Slow part of a receiver's spread, and white part."""


class Hour(NamedTuple):
    """Sensor tables on a grid of `STEP_S`, and the truth there."""

    elapsed_s: Array
    height_m: Array
    baro_m: Array
    tables: dict[Kind, Rows]


def gauss_markov(
    sd: Any, time_s: float, dt_s: float, rng: np.random.Generator, count: int
) -> Array:
    """A first-order process; `sd` may change over time."""
    keep = np.exp(-dt_s / time_s)
    drive = np.broadcast_to(sd, count) * np.sqrt(1.0 - keep**2) * rng.normal(size=count)
    values, value = np.empty(count), float(np.broadcast_to(sd, count)[0]) * rng.normal()
    for k in range(count):
        value = keep * value + drive[k]
        values[k] = value
    return values


def weather_kinds(
    settings: VerticalBankSettings, rng: np.random.Generator, seconds: int
) -> NDArray[np.int64]:
    """Calm (0), fair (1) or stormy (2), one a second."""
    prior = np.array(settings.weather_prior) / np.sum(settings.weather_prior)
    kind, kinds = rng.choice(3, p=prior), np.empty(seconds, np.int64)
    for k in range(seconds):
        if rng.random() < 1.0 / settings.switching_s:
            kind = rng.choice(3, p=prior)
        kinds[k] = kind
    return kinds


def velocity_head_m(settings: VerticalBankSettings, rng: np.random.Generator, count: int) -> Array:
    """Of a ground speed that stays and a wind that changes."""
    wind_mps = gauss_markov(settings.wind_sd_mps, WIND_TIME_S, STEP_S, rng, count)
    return (GROUND_SPEED_MPS + wind_mps) ** 2 / (2.0 * G0_MPS2)


def baro_error_m(
    settings: VerticalBankSettings, rng: np.random.Generator, climb: Array, seconds: int
) -> Array:
    """Weather, the scale of the column, gusts, static port, lag and white noise."""
    n, root = climb.size, np.sqrt(STEP_S)
    seconds_now = np.minimum((np.arange(n) * STEP_S).astype(np.int64), seconds - 1)
    scale = rng.normal(0.0, settings.scale_sd_ratio)
    scale = scale + settings.scale_walk_rts * np.cumsum(rng.normal(size=n)) * root
    kinds = weather_kinds(settings, rng, seconds)
    rate_sd_mps, gusts = np.array(settings.rate_sd_mps)[kinds], np.array(settings.gust_ratio)[kinds]
    rate_mps = gauss_markov(rate_sd_mps, settings.rate_time_s[1], 1.0, rng, seconds)
    slow = rng.normal(0.0, 60.0) + np.cumsum(rate_mps[seconds_now] * STEP_S)
    slow += settings.offset_walk_m_rts * np.cumsum(rng.normal(size=n)) * root
    slow += np.cumsum(scale * climb) * STEP_S
    fast_sd_m = settings.fast_sd_m * gusts[seconds_now]
    slow += gauss_markov(fast_sd_m, settings.fast_time_s, STEP_S, rng, n)
    port = rng.normal(0.0, settings.port_sd_ratio) * velocity_head_m(settings, rng, n)
    return slow + port - rng.normal(0.0, settings.lag_sd_s) * climb + rng.normal(0.0, 0.3, n)


def hour(seed: int, seconds: int = 3600, gnss_sd_m: float = 4.24, baro_hz: int = 5) -> Hour:
    """A healthy flight."""
    settings, rng = VerticalBankSettings(), np.random.default_rng(seed)
    elapsed_s: Array = np.arange(round(seconds / STEP_S), dtype=np.float64) * STEP_S
    height = smooth(profile(rng, elapsed_s), 5.0)
    climb = np.gradient(height, STEP_S)
    acceleration = np.gradient(climb, STEP_S)
    n = elapsed_s.size
    baro = height + baro_error_m(settings, rng, climb, seconds)
    bias = rng.normal(0.0, 0.1) + settings.accel_bias_walk_mps2_rts * np.cumsum(
        rng.normal(size=n)
    ) * np.sqrt(STEP_S)
    felt = (
        acceleration + bias + rng.normal(0.0, settings.accel_noise_mps2_rthz / np.sqrt(STEP_S), n)
    )
    gnss_every, baro_every = 10, round(1.0 / (STEP_S * baro_hz))
    fixes = height[::gnss_every] + gauss_markov(
        SLOW_SHARE * gnss_sd_m,
        settings.gnss_time_s,
        1.0,
        rng,
        height[::gnss_every].size,
    )
    fixes += rng.normal(0.0, SLOW_SHARE * gnss_sd_m, fixes.size)
    tables = {kind: rows(DTYPES[kind], 0) for kind in Kind}
    imu = tables[Kind.IMU] = table_at(Kind.IMU, elapsed_s)
    imu["specific_force_b_mps2"] = 0.0
    imu["specific_force_b_mps2"][:, 2] = -(gravity_mps2(LATITUDE_DEG, 1500.0) + felt)
    imu["angular_rate_b_radps"] = 0.0
    pressure = tables[Kind.PRESSURE] = table_at(Kind.PRESSURE, elapsed_s[::baro_every])
    pressure["pressure_pa"] = pressure_pa(baro[::baro_every])
    gnss = tables[Kind.GNSS] = table_at(Kind.GNSS, elapsed_s[::gnss_every])
    gnss["altitude_amsl_m"], gnss["vertical_sd_m"], gnss["fix_type"] = fixes, gnss_sd_m, 3
    gnss["latitude_deg"], gnss["ground_speed_mps"], gnss["course_rad"] = (
        LATITUDE_DEG,
        GROUND_SPEED_MPS,
        0.7,
    )
    return Hour(elapsed_s, height, baro, tables)


def profile(rng: np.random.Generator, elapsed_s: Array) -> Array:
    """A flight between levels of 300 to 3000 m at 2 to 5 m/s, with holds of one to five minutes."""
    times, levels = [0.0, rng.uniform(60.0, 300.0)], [rng.uniform(300.0, 3000.0)] * 2
    while times[-1] < elapsed_s[-1]:
        level = rng.uniform(300.0, 3000.0)
        times += [times[-1] + abs(level - levels[-1]) / rng.uniform(2.0, 5.0) + 1.0]
        times += [times[-1] + rng.uniform(60.0, 300.0)]
        levels += [level, level]
    return np.interp(elapsed_s, times, levels)


def smooth(values: Array, time_s: float) -> Array:
    """Two running means: the acceleration is finite."""
    return smooth_over(values, round(time_s / STEP_S))


def smooth_over(values: Array, width: int) -> Array:
    """Two running means over `width` samples."""
    for _ in range(2):
        padded = np.concatenate([np.full(width, values[0]), values, np.full(width, values[-1])])
        values = np.convolve(padded, np.ones(width) / width, "same")[width:-width]
    return values


def pressure_pa(baro_m: Array) -> Array:
    """Pressure of the standard troposphere."""
    geopotential_m = EARTH_RADIUS_M * baro_m / (EARTH_RADIUS_M + baro_m)
    return np.asarray(
        P0_PA * (1.0 + L0_KPM * geopotential_m / T0_K) ** (G0_MPS2 / (R_AIR * -L0_KPM))
    )


def arrange(tables: dict[Kind, Rows]) -> Tables:
    """What a compiled `run` loops over: the tables in order of arrival."""
    kinds = np.concatenate([np.full(tables[kind].size, int(kind)) for kind in Kind])
    order = np.zeros(kinds.size, ORDER)
    order["kind"] = kinds
    order["row"] = np.concatenate([np.arange(tables[kind].size) for kind in Kind])
    arrivals = np.concatenate([tables[kind]["arrival_us"] for kind in Kind])
    order = order[np.lexsort((kinds, arrivals))]
    return Tables(readable(order), *(readable(np.asarray(tables[kind])) for kind in Kind))


def estimates_of(method: Method, settings: Any, tables: Tables) -> Rows:
    """ESTIMATE rows, shape (rows of tables.order,): what `method` says after each sample."""
    params = settings.params()
    estimates, verdicts = rows(ESTIMATE, tables.order.size), np.zeros(tables.order.size, np.int64)
    method.run(method.init(params), params, tables, estimates, verdicts)
    return np.asarray(estimates)


def fly(made: Hour, settings: VerticalBankSettings | None = None) -> tuple[Rows, Array, Array]:
    """The vertical bank's estimates after each barometer row, their errors, and the seconds of
    each."""
    tables = arrange(made.tables)
    estimates = estimates_of(vb.METHOD, settings or VerticalBankSettings(), tables)
    found = estimates[np.asarray(tables.order["kind"]) == Kind.PRESSURE]
    elapsed_s = found["time_us"] * 1e-6 - START_S
    error = found["altitude_amsl_m"] - np.interp(elapsed_s, made.elapsed_s, made.height_m)
    return found, error, elapsed_s


def table_at(kind: Kind, elapsed_s: Array) -> Rows:
    """Rows of `kind` measured at `elapsed_s` and arriving `AGE_US` later; everything else
    unknown."""
    table = np.asarray(rows(DTYPES[kind], elapsed_s.size))
    table["time_us"] = np.round((elapsed_s + START_S) * 1e6).astype(np.int64)
    table["arrival_us"] = table["time_us"] + AGE_US[kind]
    return table
