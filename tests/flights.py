"""A synthetic flight with known truth, as tables of samples that a test may damage before it makes
a log of them.

A vehicle flies north-east at 30 m/s: it waits, climbs, holds, descends. Attitude and specific force
belong to that motion, so an inertial estimator can follow it. The air is standard but for a
sea-level pressure 6 hPa low, and the receiver wanders as real ones do; its heights arrive late.
Same arguments, same bytes.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.samples import DTYPES, Kind, Rows, SampleLog, readable

Array = NDArray[np.float64]

HOST_EPOCH_US = 1_700_000_000_000_000
RAMP_S = 4.0
GRAVITY_MPS2 = 9.8066
SPEED_MPS = 30.0
HEADING_RAD = 0.7
METRES_PER_DEGREE = 111_200.0
LEGS = ((20.0, 4.0), (80.0, -4.0), (160.0, -3.0), (230.0, 3.0))
"""(start_s, change of climb in m/s): climb 4 m/s for a minute, hold, sink 3 m/s for 70 s, hold"""


def climb_mps(time_s: Array) -> Array:
    """True climb: ramps of `RAMP_S` that have no corners."""
    total = np.zeros_like(time_s)
    for start_s, change_mps in LEGS:
        x = np.clip((time_s - start_s) / RAMP_S, 0.0, 1.0)
        total += change_mps * (3 * x**2 - 2 * x**3)
    return total


def height_m(time_s: Array) -> Array:
    """True height above the start: the integral of `climb_mps`."""
    total = np.zeros_like(time_s)
    for start_s, change_mps in LEGS:
        x = np.clip((time_s - start_s) / RAMP_S, 0.0, 1.0)
        after_s = np.maximum(0.0, time_s - start_s - RAMP_S)
        total += change_mps * (RAMP_S * (x**3 - 0.5 * x**4) + after_s)
    return total


def climb_rate_mps2(time_s: Array) -> Array:
    """True vertical acceleration: the derivative of `climb_mps`."""
    total = np.zeros_like(time_s)
    for start_s, change_mps in LEGS:
        x = np.clip((time_s - start_s) / RAMP_S, 0.0, 1.0)
        total += change_mps * 6 * (x - x**2) / RAMP_S
    return total


def standard_pressure_pa(altitude_m: Array, sea_level_pa: float) -> Array:
    """The troposphere by its own formula, in geopotential height: not the code under test."""
    geopotential_m = 6356766.0 * altitude_m / (6356766.0 + altitude_m)
    return sea_level_pa * np.power(
        1.0 - 0.0065 * geopotential_m / 288.15, 9.80665 / (287.05287 * 0.0065)
    )


@dataclass(frozen=True)
class Plan:
    """What flies, and how well it is measured. A rate of 0 leaves the sensor out."""

    duration_s: float = 260.0
    seed: int = 1
    start_m: float = 300.0
    sea_level_pa: float = 100_725.0
    imu_hz: float = 50.0
    pressure_hz: float = 20.0
    gnss_hz: float = 5.0
    attitude_hz: float = 10.0
    gnss_age_s: float = 0.12
    gnss_sd_m: float = 1.5
    pressure_sd_pa: float = 3.0
    force_sd_mps2: float = 0.05
    force_bias_mps2: float = 0.03
    boot_s: float = 30.0
    """vehicle time at the start"""


@dataclass
class Flight:
    """Tables by kind, sorted by time, with their arrivals; faults change them in place and return
    the flight."""

    plan: Plan
    tables: dict[Kind, Rows] = field(default_factory=dict)

    @property
    def start_us(self) -> int:
        return round(self.plan.boot_s * 1e6)

    def elapsed_s(self, time_us: Any) -> Array:
        """Seconds since the start of the flight."""
        return (np.asarray(time_us, np.float64) - self.start_us) * 1e-6

    def truth_m(self, time_us: Any) -> Array:
        """True altitude above mean sea level."""
        return self.plan.start_m + height_m(self.elapsed_s(time_us))

    def copy(self) -> "Flight":
        return Flight(self.plan, {kind: table.copy() for kind, table in self.tables.items()})

    def within(self, kind: Kind, start_s: float, end_s: float) -> NDArray[np.bool_]:
        """Which rows of `kind` were measured in [start_s, end_s)."""
        elapsed_s = self.elapsed_s(self.tables[kind]["time_us"])
        return (elapsed_s >= start_s) & (elapsed_s < end_s)

    def drop(self, kind: Kind, start_s: float = 0.0, end_s: float = math.inf) -> "Flight":
        """Without the rows of an interval."""
        self.tables[kind] = self.tables[kind][~self.within(kind, start_s, end_s)]
        return self

    def change(
        self,
        kind: Kind,
        name: str,
        how: Callable[[Any], Any],
        start_s: float = 0.0,
        end_s: float = math.inf,
    ) -> "Flight":
        """With a field replaced by `how(field)` in an interval."""
        chosen = self.within(kind, start_s, end_s)
        self.tables[kind][name][chosen] = how(self.tables[kind][name][chosen])
        return self

    def stand(self, until_s: float = 20.0) -> "Flight":
        """The receiver says that the vehicle stands until then, and it does not move by much."""
        return self.change(Kind.GNSS, "ground_speed_mps", lambda speed: 0.0 * speed, 0.0, until_s)

    def shift(self, duration_us: int) -> "Flight":
        """The same flight after a longer time since boot."""
        for table in self.tables.values():
            table["time_us"] += duration_us
        return self

    def log(self) -> SampleLog:
        """Everything in order of arrival."""
        log = SampleLog()
        arrivals = np.concatenate([table["arrival_us"] for table in self.tables.values()])
        kinds = np.concatenate(
            [np.full(table.size, int(kind)) for kind, table in self.tables.items()]
        )
        numbers = np.concatenate([np.arange(table.size) for table in self.tables.values()])
        readables = {int(kind): readable(table) for kind, table in self.tables.items()}
        for i in np.lexsort((kinds, arrivals)):
            kind, number = int(kinds[i]), int(numbers[i])
            log.append(Kind(kind), readables[kind][number : number + 1])
        return log


def flight(plan: Plan | None = None, **changes: Any) -> Flight:
    """The flight of `plan`, or of the default plan with `changes`."""
    plan = plan if plan is not None else Plan(**changes)
    made = Flight(plan)
    streams = [np.random.default_rng(seed) for seed in np.random.SeedSequence(plan.seed).spawn(4)]
    _imu(made, streams[0])
    _pressure(made, streams[1])
    _gnss(made, streams[2])
    _attitude(made, streams[3])
    _table(made, Kind.STATUS, 1.0, 0.0, 0.0)
    for name, value in (("armed", 0), ("landed", -1), ("reboot", 0)):
        made.tables[Kind.STATUS][name] = value
    return made


def _table(made: Flight, kind: Kind, rate_hz: float, phase_s: float, age_s: float) -> Array:
    """An empty table of `kind`, and the seconds of its rows."""
    count = int(made.plan.duration_s * rate_hz) if rate_hz > 0 else 0
    elapsed_us = np.round(
        (np.arange(count) / rate_hz if count else np.zeros(0)) * 1e6 + phase_s * 1e6
    ).astype(np.int64)
    table = np.zeros(count, DTYPES[kind])
    for name, (dtype, *_) in (DTYPES[kind].fields or {}).items():
        if dtype.base.kind == "f":
            table[name] = np.nan
    table["time_us"] = made.start_us + elapsed_us
    table["arrival_us"] = HOST_EPOCH_US + elapsed_us + round(age_s * 1e6)
    made.tables[kind] = table
    return np.asarray(elapsed_us * 1e-6, np.float64)


def _pitch_rad(elapsed_s: Array) -> Array:
    return np.arctan2(climb_mps(elapsed_s), SPEED_MPS)


def _imu(made: Flight, random: np.random.Generator) -> None:
    plan = made.plan
    elapsed_s = _table(made, Kind.IMU, plan.imu_hz, 0.001, 0.002)
    pitch, upward = _pitch_rad(elapsed_s), GRAVITY_MPS2 + climb_rate_mps2(elapsed_s)
    force = np.stack(
        [np.sin(pitch) * upward, np.zeros_like(pitch), -np.cos(pitch) * upward], axis=1
    )
    rate = np.zeros_like(force)
    rate[:, 1] = climb_rate_mps2(elapsed_s) * SPEED_MPS / (SPEED_MPS**2 + climb_mps(elapsed_s) ** 2)
    table = made.tables[Kind.IMU]
    noise = random.normal(0.0, plan.force_sd_mps2, force.shape) + plan.force_bias_mps2
    table["specific_force_b_mps2"] = force + noise
    table["angular_rate_b_radps"] = rate + random.normal(0.0, 0.002, rate.shape)


def _pressure(made: Flight, random: np.random.Generator) -> None:
    plan = made.plan
    _table(made, Kind.PRESSURE, plan.pressure_hz, 0.003, 0.004)
    table = made.tables[Kind.PRESSURE]
    exact_pa = standard_pressure_pa(made.truth_m(table["time_us"]), plan.sea_level_pa)
    table["pressure_pa"] = exact_pa + random.normal(0.0, plan.pressure_sd_pa, table.size)
    table["die_temperature_k"] = 303.0


def _gnss(made: Flight, random: np.random.Generator) -> None:
    plan = made.plan
    elapsed_s = _table(made, Kind.GNSS, plan.gnss_hz, 0.005, plan.gnss_age_s)
    table = made.tables[Kind.GNSS]
    climb = climb_mps(elapsed_s)
    along_m = SPEED_MPS * elapsed_s
    table["latitude_deg"] = 45.0 + along_m * math.cos(HEADING_RAD) / METRES_PER_DEGREE
    table["longitude_deg"] = 8.0 + along_m * math.sin(HEADING_RAD) / (
        METRES_PER_DEGREE * math.cos(math.pi / 4)
    )
    wander_m = 1.0 * np.sin(elapsed_s / 40.0)
    table["altitude_amsl_m"] = (
        made.truth_m(table["time_us"])
        + wander_m
        + random.normal(0.0, 0.6 * plan.gnss_sd_m, climb.size)
    )
    table["altitude_ellipsoid_m"] = table["altitude_amsl_m"] + 47.0
    table["ground_speed_mps"] = SPEED_MPS + random.normal(0.0, 0.05, climb.size)
    table["course_rad"] = HEADING_RAD + random.normal(0.0, 0.002, climb.size)
    table["horizontal_sd_m"] = 1.0
    table["vertical_sd_m"] = plan.gnss_sd_m
    table["hdop"], table["vdop"] = 0.8, 1.2
    table["fix_type"], table["satellites"] = 3, 14


def _attitude(made: Flight, random: np.random.Generator) -> None:
    elapsed_s = _table(made, Kind.ATTITUDE, made.plan.attitude_hz, 0.007, 0.008)
    table = made.tables[Kind.ATTITUDE]
    table["roll_rad"] = random.normal(0.0, 0.004, elapsed_s.size)
    table["pitch_rad"] = _pitch_rad(elapsed_s) + random.normal(0.0, 0.004, elapsed_s.size)
    table["yaw_rad"] = HEADING_RAD + random.normal(0.0, 0.01, elapsed_s.size)
    table["angular_rate_b_radps"] = 0.0
