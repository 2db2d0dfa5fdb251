"""The simulation of paper H, section 5: cases, rows of a vehicle, runs and their tally."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from companion.estimators.adaptive_fusion import (
    METHOD,
    AdaptiveFusionSettings,
    adaptive_factor,
    gain,
)
from companion.estimators.method import Filter, run_log
from companion.kernels.atmosphere import (
    G0_MPS2,
    R_AIR,
    geopotential_m,
    standard_pressure_pa,
)
from companion.samples import Kind, Rows, SampleLog, sample
from sim.studies.page import Spread, generators, spread

Array = NDArray[np.float64]
Gain = Literal["adaptive", "fixed"]
R_B, R_GPS = 81.0, 169.0
"""Variances of barometer and GPS, m2."""
P0_KPA, T0_K, LAPSE_KPM, G_MPS2 = 101.325, 288.15, 0.0065, 9.81
R_PRINTED, R_FITTING = 287.0, 287.05
DRIFT_KPA, DRIFT_K = 0.01, 0.01
"""Fall of p0 and T0 a unit of k."""
PRESSURE_KPA = 23.0 + 0.05 * np.arange(1538)
STEP_US = 1_000_000
TABLE_1 = {400: 160.693, 600: 159.417, 800: 163.447, 1000: 159.054, 1300: 164.408, 1500: 164.772}
"""Printed P by iteration, m2."""


def height_m(
    pressure_kpa: Any, p0_kpa: Any = P0_KPA, t0_k: Any = T0_K, gas_constant: float = R_FITTING
) -> Array:
    """The paper's (1): height at a pressure, for arrays of one shape."""
    ratio = np.asarray(pressure_kpa) / p0_kpa
    return np.asarray(t0_k / LAPSE_KPM * (1.0 - ratio ** (LAPSE_KPM * gas_constant / G_MPS2)))


@dataclass(frozen=True)
class Case:
    """A scenario: what the barometer would read without noise. The truth is (1) with the standard
    p0 and T0."""

    name: str
    baro_m: Array
    truth_m: Array = field(default_factory=lambda: height_m(PRESSURE_KPA))

    @property
    def bias_m(self) -> Array:
        """Error of the noiseless barometer."""
        return self.baro_m - self.truth_m


def drifting(name: str, k: NDArray[np.floating[Any]]) -> Case:
    """p0 and T0 fall by 0.01 a unit of k."""
    return Case(name, height_m(PRESSURE_KPA, P0_KPA - DRIFT_KPA * k, T0_K - DRIFT_K * k))


NOMINAL = Case("no drift", height_m(PRESSURE_KPA))
DRIFT = drifting("drift, k the pressure", PRESSURE_KPA)
LITERAL = drifting("drift, k the iteration", np.arange(1.0, PRESSURE_KPA.size + 1))


class VehicleRows:
    """The rows that a vehicle would send, made once and filled for each run."""

    def __init__(self) -> None:
        self.log = SampleLog()
        for step in range(PRESSURE_KPA.size):
            time_us = (step + 1) * STEP_US
            self.log.append(Kind.PRESSURE, sample(Kind.PRESSURE, time_us))
            self.log.append(Kind.GNSS, sample(Kind.GNSS, time_us, fix_type=3))

    def fill(self, baro_m: Array, gnss_m: Array) -> None:
        """Let the sensors read these heights."""
        pressures = [standard_pressure_pa(geopotential_m(height)) for height in baro_m.tolist()]
        self.log[Kind.PRESSURE]["pressure_pa"] = pressures
        self.log[Kind.GNSS]["altitude_amsl_m"] = gnss_m

    def estimates(self, which: Gain) -> Rows:
        """Estimate rows of the paper's fixed or adaptive filter, one after each fix."""
        settings = AdaptiveFusionSettings(gain=which, baro_variance_m2=R_B, gnss_variance_m2=R_GPS)
        return run_log(METHOD, self.log, settings)[0][1::2]


@dataclass(frozen=True)
class Run:
    """One Monte-Carlo run of one case; errors in metres, one a step."""

    case: Case
    baro_m: Array
    gnss_m: Array
    fixed_m: Array
    adaptive_m: Array
    delta_m: Array
    """residual (18), as the estimator reports it"""

    @property
    def printed_factor(self) -> Array:
        """S of (31) as printed, without the condition (28)."""
        return (self.delta_m**2 - R_GPS) / R_B

    @property
    def factor(self) -> Array:
        return np.array([adaptive_factor(delta, R_B, R_GPS) for delta in self.delta_m.tolist()])

    def variance_m2(self, iteration: int) -> float:
        """The paper's P (17) of the adaptive filter at an iteration counted from 1."""
        return R_GPS * gain(
            adaptive_factor(float(self.delta_m[iteration - 1]), R_B, R_GPS), R_B, R_GPS
        )


def run_case(stream: VehicleRows, case: Case, noise: Array) -> Run:
    """Both filters on one draw of `noise`: standard normal, shape (2, steps), barometer and GPS
    (32)-(33)."""
    baro_m = case.baro_m + math.sqrt(R_B) * noise[0]
    gnss_m = case.truth_m + math.sqrt(R_GPS) * noise[1]
    stream.fill(baro_m, gnss_m)
    fixed, adaptive = stream.estimates("fixed"), stream.estimates("adaptive")
    truth_m = case.truth_m
    return Run(
        case,
        baro_m - truth_m,
        gnss_m - truth_m,
        fixed["altitude_amsl_m"] - truth_m,
        adaptive["altitude_amsl_m"] - truth_m,
        adaptive["innovation_m"].copy(),
    )


def setting_difference_m() -> float:
    """Largest difference of the estimator's h^B from (31), when p_0(k) and T_0(k) of the drift are
    told before each pressure (geopotential)."""
    running, worst_m = Filter(METHOD), 0.0
    for step, pressure_kpa in enumerate(PRESSURE_KPA[::20].tolist(), start=1):
        p0_kpa, t0_k = P0_KPA - DRIFT_KPA * pressure_kpa, T0_K - DRIFT_K * pressure_kpa
        told = {"qnh_pa": 1e3 * p0_kpa, "air_temperature_k": t0_k, "field_elevation_m": 0.0}
        time_us = step * STEP_US
        running.step(Kind.AIR, sample(Kind.AIR, time_us, **told))
        running.step(Kind.PRESSURE, sample(Kind.PRESSURE, time_us, pressure_pa=1e3 * pressure_kpa))
        power = (pressure_kpa / p0_kpa) ** (LAPSE_KPM * R_AIR / G0_MPS2)
        expected_m = t0_k / LAPSE_KPM * (1.0 - power)
        baro_m = geopotential_m(float(running.state[0]["baro_m"]))
        worst_m = max(worst_m, abs(baro_m - expected_m))
    return worst_m


SENSORS = ("baro_m", "gnss_m", "fixed_m", "adaptive_m")


class Tally:
    """What is kept of the runs of a case: figures of each, and sums over all."""

    def __init__(self) -> None:
        self.rmse: dict[str, list[float]] = {name: [] for name in SENSORS}
        self.squares: dict[str, Array] = {name: np.zeros(PRESSURE_KPA.size) for name in SENSORS}
        self.negative: list[float] = []
        self.fired: list[float] = []
        self.variance_m2: dict[int, list[float]] = {iteration: [] for iteration in TABLE_1}

    def add(self, run: Run) -> None:
        for name in SENSORS:
            error = getattr(run, name)
            self.rmse[name].append(float(np.sqrt(np.mean(error**2))))
            self.squares[name] += error**2
        self.negative.append(float(np.mean(run.printed_factor < 0)))
        self.fired.append(float(np.mean(run.delta_m**2 >= R_GPS + R_B)))
        for iteration, values in self.variance_m2.items():
            values.append(run.variance_m2(iteration))

    def rms(self, name: str) -> Spread:
        return spread(self.rmse[name])

    def mean_square_m2(self, name: str) -> Array:
        """Over the seeds, one a step."""
        return self.squares[name] / len(self.rmse[name])


def monte_carlo(seeds: int) -> Iterator[tuple[Run, Run, Run]]:
    """Runs of the three cases on the same noise, one triple a seed."""
    stream = VehicleRows()
    for generator in generators("H", seeds):
        noise = generator.standard_normal((2, PRESSURE_KPA.size))
        yield (
            run_case(stream, NOMINAL, noise),
            run_case(stream, DRIFT, noise),
            run_case(stream, LITERAL, noise),
        )
