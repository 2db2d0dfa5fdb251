"""The simulation of paper W, section 3: readings, rows of a vehicle, runs and errors."""

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from companion.estimators.air_data_gnss import METHOD
from companion.estimators.air_data_gnss.settings import AirDataGnssSettings
from companion.estimators.method import Filter, run_log
from companion.kernels.atmosphere import (
    G0_MPS2,
    L0_KPM,
    P0_PA,
    R_AIR,
    T0_K,
    geopotential_m,
    standard_pressure_pa,
)
from companion.kernels.kalman import correct
from companion.samples import Kind, SampleLog, sample
from sim.studies.page import Spread, generators, spread

Array = NDArray[np.float64]
Law = Literal["exact", "linear", "printed"]
DT_S = 0.2
STEPS = 1500
GPS_EVERY = 5
LAPSE_EVERY = 50
BARO_SD_M, GPS_SD_M, TEMPERATURE_SD_K, LAPSE_SD_KPM = 5.0, 70.0, 1.5, 0.003
Q_A, Q_B = 2e-5, 400.0
SETTLED = 300
"""Errors count from here on: after a minute."""
BASE_M = 3000.0
"""H_0: random walks take the barometer down by more than the pressure of any valley would be
believed."""
TIME_S = DT_S * np.arange(STEPS)
HEIGHT_M = 90.0 * (1.0 - np.cos(2.0 * math.pi * TIME_S / 150.0))
WEATHER, WALK_SECOND, WALK_STEP = READINGS = (
    "weather",
    "random walk, Q per second",
    "random walk, Q per step",
)
SETTINGS = {
    "paper": AirDataGnssSettings(preset="paper"),
    "as printed": AirDataGnssSettings(preset="paper", temperature_law="printed", regressor="gnss"),
    "slow walks": AirDataGnssSettings(
        preset="paper",
        covariance="joint",
        scale_walk_per_second=1e-9 / DT_S,
        bias_walk_m2ps=0.01 / DT_S,
    ),
    "tuned": AirDataGnssSettings(
        gnss_variance_m2=GPS_SD_M**2, baro_variance_m2=BARO_SD_M**2, bias_sd_m=20.0
    ),
}
"""Ours: the paper's filter corrected, with its sign and regressor; with slow Q and joint covariance
and nothing else changed; and the preset ``tuned``, told what the simulation's sensors are like."""


def pressure_ratio(above_m: Any, temperature_k: Any, lapse_kpm: Any) -> Array:
    """P/P_0 at a height above the launch: the inverse of the corrected (1), for arrays of one
    shape."""
    return np.asarray(
        (1.0 + lapse_kpm * above_m / temperature_k) ** (-G0_MPS2 / (R_AIR * lapse_kpm))
    )


def baro_height_m(ratio: Any) -> Array:
    """(1) with R in the exponent (erratum), H_0 = 0, the standard T_0 and lapse rate."""
    return np.asarray(T0_K / L0_KPM * (np.asarray(ratio) ** (-R_AIR * L0_KPM / G0_MPS2) - 1.0))


@dataclass(frozen=True)
class Readings:
    """What the sensors say in one run, shape (STEPS,)."""

    baro_m: Array
    gps_m: Array
    temperature_k: Array
    base_m: float
    """the launch site, from which heights count"""
    final: tuple[float, float]
    """true a and b at the end; NaN where the air is no random walk"""


def readings(reading: str, rng: np.random.Generator) -> Readings:
    """One run under one reading of what moves the air."""
    lapse = np.repeat(rng.normal(L0_KPM, LAPSE_SD_KPM, STEPS // LAPSE_EVERY), LAPSE_EVERY)
    noise = rng.normal(size=(3, STEPS))
    base_m, final = 0.0, (math.nan, math.nan)
    if reading == WEATHER:
        sign = rng.choice([-1.0, 1.0], 2)
        ground_k = T0_K + sign[0] * rng.uniform(5.0, 15.0)
        drift = sign[1] * rng.uniform(100.0, 300.0) / 3600.0 * TIME_S + rng.normal(0.0, 50.0)
        ratio = (1.0 + drift / 101_325.0) * pressure_ratio(HEIGHT_M, ground_k, lapse)
        baro_m, temperature_k = baro_height_m(ratio), ground_k + lapse * HEIGHT_M
    else:
        base_m, step = BASE_M, DT_S if reading == WALK_SECOND else 1.0
        a = np.cumsum(rng.normal(0.0, math.sqrt(Q_A * step), STEPS))
        b = np.cumsum(rng.normal(0.0, math.sqrt(Q_B * step), STEPS))
        baro_m = HEIGHT_M + a * HEIGHT_M + b
        temperature_k = (T0_K + L0_KPM * BASE_M) * (1.0 - a) + lapse * HEIGHT_M
        final = float(a[-1]), float(b[-1])
    return Readings(
        baro_m + BARO_SD_M * noise[0],
        HEIGHT_M + GPS_SD_M * noise[1],
        temperature_k + TEMPERATURE_SD_K * noise[2],
        base_m,
        final,
    )


@dataclass(frozen=True)
class Run:
    """What the estimator made of one run; errors after each cycle."""

    final_m: Array
    compensated_m: Array
    """h^c (32), before the alpha-beta filter"""
    nees: float
    """of a and b at the end"""


class VehicleRows:
    """The rows that a vehicle would send, made once and filled for each run."""

    def __init__(self, gps_every: int = GPS_EVERY, steps: int = STEPS) -> None:
        self.log = SampleLog()
        self._fixes = slice(0, steps, gps_every)
        ends = []
        for step in range(steps):
            time_us = 1_000_000 + step * round(DT_S * 1e6)
            self.log.append(Kind.AIR, sample(Kind.AIR, time_us))
            if step % gps_every == 0:
                self.log.append(Kind.GNSS, sample(Kind.GNSS, time_us, fix_type=3))
            self.log.append(Kind.PRESSURE, sample(Kind.PRESSURE, time_us))
            ends.append(len(self.log) - 1)
        self._ends = np.array(ends)

    def run(self, data: Readings, settings: AirDataGnssSettings) -> Run:
        """One run of the estimator, through the loop that replays logs."""
        base_m = data.base_m
        pressures = [
            standard_pressure_pa(geopotential_m(height))
            for height in (base_m + data.baro_m).tolist()
        ]
        self.log[Kind.PRESSURE]["pressure_pa"] = pressures
        self.log[Kind.AIR]["air_temperature_k"] = data.temperature_k
        self.log[Kind.GNSS]["altitude_amsl_m"] = base_m + data.gps_m[self._fixes]
        based = settings.model_copy(update={"reference_height_m": base_m})
        estimates, _, state = run_log(METHOD, self.log, based)
        cycles = estimates[self._ends]
        error = state["error"]["x"][0] - data.final
        return Run(
            cycles["altitude_amsl_m"] - base_m - HEIGHT_M,
            data.baro_m + cycles["baro_offset_m"] - HEIGHT_M,
            float(error @ np.linalg.solve(state["error"]["P"][0], error)),
        )


def rms(errors_m: Array) -> float:
    return float(np.sqrt(np.mean(np.square(errors_m))))


def settled(errors_m: Array) -> float:
    """Root mean square after a minute."""
    return rms(errors_m[SETTLED:])


def temperature_alone_m(law: Law, warmer_k: float, height_m: float = 1600.0) -> float:
    """Error of the settled height in air that is `warmer_k` than standard, with no GPS: what lambda
    alone does."""
    above = geopotential_m(height_m)
    air_k = T0_K + warmer_k + L0_KPM * above
    pressure_pa = P0_PA * float(pressure_ratio(above, T0_K + warmer_k, L0_KPM))
    running = Filter(METHOD, AirDataGnssSettings(preset="paper", temperature_law=law))
    air, pressure = (
        sample(Kind.AIR, 0, air_temperature_k=air_k),
        sample(Kind.PRESSURE, 0, pressure_pa=pressure_pa),
    )
    for step in range(1, 301):
        air["time_us"] = pressure["time_us"] = step * round(DT_S * 1e6)
        running.step(Kind.AIR, air)
        running.step(Kind.PRESSURE, pressure)
    return float(running.estimate["altitude_amsl_m"][0]) - height_m


def printed_update(
    a: float, b: float, P_a: float, P_b: float, z: float, h: float, R: float
) -> tuple[float, float, float, float]:
    """The z-update as printed, (23)-(31), which divides by the height h."""
    z_a, S_a = (z - b) / h, (P_b + R) / h**2
    weight = P_a / (P_a + S_a)
    a, P_a = a + weight * (z_a - a), (1.0 - weight) * P_a
    K = P_b / (P_b + R)
    return a, b + K * (z - h * a - b), P_a, (1.0 - K) * P_b + (K * h) ** 2 * P_a


def update_difference(rng: np.random.Generator, draws: int = 500) -> float:
    """Largest relative difference of `printed_update` and a joint Kalman correction without its
    correlation."""
    worst, floor = 0.0, np.array([1e-3, 1.0, 0.0, 0.0])
    for _ in range(draws):
        a, b, z = rng.normal(size=3) * (0.05, 30.0, 60.0)
        P_a, P_b, R, h = np.exp(rng.uniform((-12.0, 0.0, 1.0, 2.0), (-3.0, 8.0, 9.0, 8.0)))
        printed = np.array(printed_update(a, b, P_a, P_b, z, h, R))
        x, P, H = np.array([a, b]), np.diag([P_a, P_b]), np.array([h, 1.0])
        correct(x, P, H, np.empty(2), z - h * a - b, R)
        ours = np.array([*x, P[0, 0], P[1, 1]])
        worst = max(worst, float(np.max(np.abs(ours - printed) / (np.abs(printed) + floor))))
    return worst


def normalised_errors(covariance: Literal["joint", "marginal"], seeds: int) -> Array:
    """Normalised error squared of [a, b] at the end of runs whose air is exactly the filter's
    model, 1-2 km up.

    No thermometer: what is known of a comes from fixes, together with b.
    """
    q_a, q_b = 2e-7, 4.0
    settings = AirDataGnssSettings(
        preset="paper", covariance=covariance, temperature="none",
        scale_walk_per_second=q_a / 0.2, bias_walk_m2ps=q_b / 0.2, scale_sd=0.02,
    )  # fmt: skip
    stream, height_m = VehicleRows(), 1000.0 + 6.0 * HEIGHT_M
    nees = []
    for rng in generators("W", seeds):
        a = 0.02 * rng.normal() + np.cumsum(math.sqrt(q_a) * rng.normal(size=STEPS))
        b = 20.0 * rng.normal() + np.cumsum(math.sqrt(q_b) * rng.normal(size=STEPS))
        noise = rng.normal(size=(2, STEPS))
        data = Readings(
            height_m + a * height_m + b + BARO_SD_M * noise[0],
            height_m + GPS_SD_M * noise[1],
            np.full(STEPS, math.nan),
            0.0,
            (float(a[-1]), float(b[-1])),
        )
        nees.append(stream.run(data, settings).nees)
    return np.array(nees)


@dataclass
class Figures:
    """The errors of all runs under one reading."""

    errors: dict[str, list[Array]] = field(default_factory=dict)

    def add(self, name: str, error_m: Array) -> None:
        self.errors.setdefault(name, []).append(error_m)

    def rms(self, name: str) -> Spread:
        """Over time, mean and spread over the seeds."""
        return spread([settled(error) for error in self.errors[name]])

    def total(self, name: str) -> float:
        """Root mean square over time and seeds."""
        return rms(np.array(self.errors[name])[:, SETTLED:])

    def curve(self, name: str) -> Array:
        """Root mean square over the seeds at each instant, as Fig. 3 has it."""
        return np.asarray(np.sqrt(np.mean(np.square(self.errors[name]), axis=0)))


SPARSE = {"1 s": GPS_EVERY, "10 s": 50, "60 s": 300}
"""Intervals of GPS."""


def monte_carlo(reading: str, seeds: int, stream: VehicleRows) -> Figures:
    """All settings on the same readings, one set a seed."""
    found = Figures()
    for rng in generators("W", seeds):
        data = readings(reading, rng)
        found.add("barometer", data.baro_m - HEIGHT_M)
        found.add("GPS", data.gps_m - HEIGHT_M)
        for name, settings in SETTINGS.items():
            run = stream.run(data, settings)
            found.add(name, run.final_m)
            if name == "paper":
                found.add("compensated", run.compensated_m)
    return found


def rarer(stream: VehicleRows, seeds: int) -> Figures:
    found = Figures()
    for rng in generators("W", seeds):
        data = readings(WEATHER, rng)
        for name in ("paper", "tuned"):
            found.add(name, stream.run(data, SETTINGS[name]).final_m)
    return found
