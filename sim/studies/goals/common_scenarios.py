"""The papers' common scenarios S1 to S8 at the level of the sensors, drawn from the model whose
bound is known.

Barometer 5 Hz, fixes 1 Hz, and an IMU in level attitude at 50 Hz whose noise has the density of
0.03 m/s2 at 5 Hz: an estimator rightly refuses to integrate one of 5 Hz. The priors are those of
`bound.Model`: the drift of the sea-level pressure and the temperature's error are Gaussian with the
spread of "1 to 3 hPa an hour" and "5 to 15 K".
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.kernels.atmosphere import geopotential_m, standard_pressure_pa
from companion.kernels.earth import gravity_mps2
from companion.samples import DTYPES, Kind, Rows, rows
from sim.studies.goals.bound import Model
from sim.studies.goals.sensor_level import LATITUDE_DEG, Array, gauss_markov, smooth_over, table_at

IMU_HZ = 50
OUTAGE_S = (500.0, 800.0)
STEP_AT_S, STEP_M = 400.0, 15.0
SPIKE_SHARE, SPIKE_M = 0.01, 37.0
BURST_S, BURST_SD_M = (400.0, 520.0), 5.0


@dataclass(frozen=True)
class Scenario:
    """The flight, and its fault."""

    key: str
    title: str
    corners: tuple[tuple[float, float], ...]
    """(seconds, height in m), straight in between and rounded over ten seconds"""
    fault: str = ""
    """"outage", "step", "spikes" or "burst" """

    @property
    def within_s(self) -> tuple[float, float]:
        """Where errors count: after the first minute, or within the outage."""
        return OUTAGE_S if self.fault == "outage" else (60.0, self.corners[-1][0])


_LOW = (
    (0.0, 5.0),
    (90.0, 5.0),
    (190.0, 200.0),
    (500.0, 200.0),
    (600.0, 60.0),
    (900.0, 160.0),
    (1100.0, 5.0),
    (1200.0, 5.0),
)
_HILLS = ((0.0, 5.0), (90.0, 5.0), (650.0, 2800.0), (850.0, 2800.0), (1400.0, 5.0), (1500.0, 5.0))

_SCENARIOS = (
    Scenario(
        "S1",
        "descent from 10.9 km",
        ((0.0, 10_900.0), (90.0, 10_900.0), (868.0, 8.0), (930.0, 8.0)),
    ),
    Scenario("S2", "0 to 200 m", _LOW),
    Scenario("S3", "0 to 2.8 km", _HILLS),
    Scenario("S4", "an hour's cruise at 3 km", ((0.0, 3000.0), (3600.0, 3000.0))),
    Scenario("S5", "S3 with 300 s without GNSS", _HILLS, "outage"),
    Scenario("S6", "S2 with a barometer step of 15 m", _LOW, "step"),
    Scenario("S7", "S2 with 1 % barometer spikes", _LOW, "spikes"),
    Scenario("S8", "S2 with barometer noise of 5 m for two minutes", _LOW, "burst"),
)

SCENARIOS: dict[str, Scenario] = {scenario.key: scenario for scenario in _SCENARIOS}
"""The scenarios, by key."""


@dataclass(frozen=True)
class Drawn:
    """One flight: truth, raw heights and fixes at the barometer's samples, and the sensors'
    tables."""

    elapsed_s: Array
    height_m: Array
    baro_m: Array
    fix_m: Array
    """NaN where there is no fix"""
    scale: float
    tables: dict[Kind, Rows]


def heights_m(scenario: Scenario, elapsed_s: Array, step_s: float) -> Array:
    """True height."""
    times, heights = np.array(scenario.corners).T
    return smooth_over(np.interp(elapsed_s, times, heights), round(5.0 / step_s))


def draw(scenario: Scenario, seed: int, model: Model) -> Drawn:
    """The flight of a seed; the faults are added to the same errors, so that a seed flies alike
    with and without."""
    rng, fault_rng = (
        np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(2)
    )
    step_s, imu_step_s = model.step_s, 1.0 / IMU_HZ
    fine_s = np.arange(0.0, scenario.corners[-1][0], imu_step_s)
    fine_m = heights_m(scenario, fine_s, imu_step_s)
    every = round(step_s / imu_step_s)
    elapsed_s, height = fine_s[::every], fine_m[::every]
    n = elapsed_s.size
    scale = rng.normal(0.0, model.scale_sd_ratio)
    baro = (
        height * (1.0 + scale)
        + rng.normal(0.0, model.offset_sd_m)
        + rng.normal(0.0, model.rate_sd_mps) * elapsed_s
    )
    baro += gauss_markov(model.fast_sd_m, model.fast_time_s, step_s, rng, n) + rng.normal(
        0.0, model.baro_white_sd_m, n
    )
    wander = gauss_markov(model.accel_wander_sd_mps2, model.accel_wander_time_s, step_s, rng, n)
    bias = rng.normal(0.0, model.accel_bias_sd_mps2) + np.repeat(wander, every)[: fine_s.size]
    felt = np.gradient(np.gradient(fine_m, imu_step_s), imu_step_s) + bias
    felt += rng.normal(0.0, model.accel_white_sd_mps2 * np.sqrt(step_s * IMU_HZ), fine_s.size)
    fixes = height + gauss_markov(model.gnss_slow_sd_m, model.gnss_slow_time_s, step_s, rng, n)
    fixes += rng.normal(0.0, model.gnss_white_sd_m, n)
    fixes[~has_fix(scenario, elapsed_s, step_s)] = np.nan
    baro += _fault_m(scenario, elapsed_s, fault_rng)
    tables = _tables(fine_s, fine_m, felt, elapsed_s, baro, fixes, model)
    return Drawn(elapsed_s, height, baro, fixes, float(scale), tables)


def has_fix(scenario: Scenario, elapsed_s: Array, step_s: float) -> NDArray[np.bool_]:
    """Which barometer samples have a fix: one a second, but in an outage."""
    fixed: NDArray[np.bool_] = np.arange(elapsed_s.size) % round(1.0 / step_s) == 0
    if scenario.fault == "outage":
        fixed &= (elapsed_s < OUTAGE_S[0]) | (elapsed_s >= OUTAGE_S[1])
    return fixed


def _fault_m(scenario: Scenario, elapsed_s: Array, rng: np.random.Generator) -> Array:
    """What the fault adds to the barometer height."""
    n = elapsed_s.size
    if scenario.fault == "step":
        return np.where(elapsed_s >= STEP_AT_S, STEP_M, 0.0)
    if scenario.fault == "spikes":
        return np.where(rng.random(n) < SPIKE_SHARE, SPIKE_M * rng.choice([-1.0, 1.0], n), 0.0)
    if scenario.fault == "burst":
        within = (elapsed_s >= BURST_S[0]) & (elapsed_s < BURST_S[1])
        return np.where(within, rng.normal(0.0, BURST_SD_M, n), 0.0)
    return np.zeros(n)


def _tables(
    fine_s: Array,
    fine_m: Array,
    felt: Array,
    elapsed_s: Array,
    baro: Array,
    fixes: Array,
    model: Model,
) -> dict[Kind, Rows]:
    tables = {kind: rows(DTYPES[kind], 0) for kind in Kind}
    imu = tables[Kind.IMU] = table_at(Kind.IMU, fine_s)
    gravity = np.interp(
        fine_m, [0.0, 12_000.0], [gravity_mps2(LATITUDE_DEG, h) for h in (0.0, 12_000.0)]
    )
    imu["specific_force_b_mps2"] = 0.0
    imu["specific_force_b_mps2"][:, 2] = -(gravity + felt)
    imu["angular_rate_b_radps"] = 0.0
    pressure = tables[Kind.PRESSURE] = table_at(Kind.PRESSURE, elapsed_s)
    pressure["pressure_pa"] = [standard_pressure_pa(geopotential_m(h)) for h in baro]
    fixed = np.isfinite(fixes)
    gnss = tables[Kind.GNSS] = table_at(Kind.GNSS, elapsed_s[fixed])
    gnss["altitude_amsl_m"], gnss["fix_type"] = fixes[fixed], 3
    gnss["vertical_sd_m"] = np.hypot(model.gnss_slow_sd_m, model.gnss_white_sd_m)
    gnss["latitude_deg"], gnss["ground_speed_mps"], gnss["course_rad"] = LATITUDE_DEG, 30.0, 0.7
    return tables
