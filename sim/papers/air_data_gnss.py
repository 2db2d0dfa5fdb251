"""Paper W: Whang, Ra 2008, against `companion.estimators.air_data_gnss`.

The simulation of section 3: air data every 0.2 s (5 m, 1.5 K), GPS every second (70 m), a lapse rate that is drawn anew
every ten seconds. Samples reach the estimator as a vehicle would send them: each barometer height becomes the pressure
at which the standard atmosphere has it, each temperature a sample of AIR, and `run_log` steps through the rows.

What the print leaves open, and what is wrong in it
---------------------------------------------------
- Figure 2, the trajectory, is not described: here two climbs to 180 m and back in 300 s.
- What moves the true a and b is not said. Three readings: weather (`WEATHER`), random walks with the filter's own Q per
  second (`WALK_SECOND`), and per step of 0.2 s (`WALK_STEP`).
- "0.003 degC/km around -0.0065 degC/km" is K/m.
- Figure 3 shows curves, no numbers: what can be held against it are the sentences about it.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.atmosphere import G0_MPS2, L0_KPM, R_AIR, T0_K, geopotential_m, standard_pressure_pa
from companion.estimators.air_data_gnss import METHOD, AirDataGnssSettings
from companion.estimators.method import run_log
from companion.samples import Kind, SampleLog, sample
from sim.papers import Progress
from sim.papers.page import BARO, FUSED, GNSS, OTHER, TRUTH, Page, Row, Verdict, generators, holds, spread

Array = NDArray[np.float64]

DT_S = 0.2
STEPS = 1500
GPS_EVERY = 5
LAPSE_EVERY = 50
BARO_SD_M, GPS_SD_M, TEMPERATURE_SD_K, LAPSE_SD_KPM = 5.0, 70.0, 1.5, 0.003
Q_A, Q_B = 2e-5, 400.0
SETTLED = 300
"""Errors count from here on: after a minute."""

TIME_S = DT_S * np.arange(STEPS)
HEIGHT_M = 90.0 * (1.0 - np.cos(2.0 * math.pi * TIME_S / 150.0))

WEATHER, WALK_SECOND, WALK_STEP = "weather", "random walk, Q per second", "random walk, Q per step"

SETTINGS = {
    "paper": AirDataGnssSettings(preset="paper"),
    "as printed": AirDataGnssSettings(preset="paper", temperature_law="printed", regressor="gnss"),
    "slow walks": AirDataGnssSettings(
        preset="paper", covariance="joint", scale_walk_per_s=1e-9 / DT_S, bias_walk_m2ps=0.01 / DT_S
    ),
    "tuned": AirDataGnssSettings(gnss_variance_m2=GPS_SD_M**2, baro_variance_m2=BARO_SD_M**2, bias_sd_m=20.0),
}
"""Ours: the paper's filter corrected, with its sign and regressor; with slow Q and joint covariance and nothing else
changed; and the preset ``tuned``, told what the simulation's sensors are like."""


def pressure_ratio(above_m: Any, temperature_k: Any, lapse_kpm: Any) -> Array:
    """P/P_0 at a height above the launch: the inverse of the corrected (1), for arrays of one shape."""
    return np.asarray((1.0 + lapse_kpm * above_m / temperature_k) ** (-G0_MPS2 / (R_AIR * lapse_kpm)))


def baro_height_m(ratio: Any) -> Array:
    """(1) with R in the exponent (erratum), H_0 = 0, the standard T_0 and lapse rate."""
    return np.asarray(T0_K / L0_KPM * (np.asarray(ratio) ** (-R_AIR * L0_KPM / G0_MPS2) - 1.0))


@dataclass(frozen=True)
class Readings:
    """What the sensors say in one run, shape (STEPS,)."""

    baro_m: Array
    gps_m: Array
    temperature_k: Array


def readings(reading: str, rng: np.random.Generator) -> Readings:
    """One run under one reading of what moves the air."""
    lapse = np.repeat(rng.normal(L0_KPM, LAPSE_SD_KPM, STEPS // LAPSE_EVERY), LAPSE_EVERY)
    noise = rng.normal(size=(3, STEPS))
    if reading == WEATHER:
        sign = rng.choice([-1.0, 1.0], 2)
        ground_k = T0_K + sign[0] * rng.uniform(5.0, 15.0)
        drift = sign[1] * rng.uniform(100.0, 300.0) / 3600.0 * TIME_S + rng.normal(0.0, 50.0)
        ratio = (1.0 + drift / 101_325.0) * pressure_ratio(HEIGHT_M, ground_k, lapse)
        baro_m, temperature_k = baro_height_m(ratio), ground_k + lapse * HEIGHT_M
    else:
        step = DT_S if reading == WALK_SECOND else 1.0
        a = np.cumsum(rng.normal(0.0, math.sqrt(Q_A * step), STEPS))
        b = np.cumsum(rng.normal(0.0, math.sqrt(Q_B * step), STEPS))
        baro_m, temperature_k = HEIGHT_M + a * HEIGHT_M + b, T0_K * (1.0 - a) + lapse * HEIGHT_M
    return Readings(
        baro_m + BARO_SD_M * noise[0], HEIGHT_M + GPS_SD_M * noise[1], temperature_k + TEMPERATURE_SD_K * noise[2]
    )


class Stream:
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

    def heights_m(self, data: Readings, settings: AirDataGnssSettings) -> tuple[Array, Array]:
        """Final and compensated heights after each cycle."""
        pressures = [standard_pressure_pa(geopotential_m(height)) for height in data.baro_m.tolist()]
        self.log[Kind.PRESSURE]["pressure_pa"] = pressures
        self.log[Kind.AIR]["air_temperature_k"] = data.temperature_k
        self.log[Kind.GNSS]["altitude_amsl_m"] = data.gps_m[self._fixes]
        estimates = run_log(METHOD, self.log, settings)[0][self._ends]
        return estimates["altitude_amsl_m"].copy(), data.baro_m + estimates["baro_offset_m"]


def rms(errors_m: Array) -> float:
    return float(np.sqrt(np.mean(np.square(errors_m))))
