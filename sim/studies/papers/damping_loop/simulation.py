"""Paper K's filters on drives: formulas as printed, loop and Kalman filters, gains by search."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from companion.config import Settings
from companion.estimators.baro_inertial import baro_ins_kf, damping_loop, genetic, tuning
from companion.estimators.baro_inertial.damping_loop import DampingLoopSettings
from companion.estimators.baro_inertial.genetic import Gains
from companion.estimators.baro_inertial.inputs import calibrated_m
from companion.estimators.baro_inertial.loop_gains import matched_gains, poles
from companion.estimators.baro_inertial.settings import BaroInsKfSettings
from companion.estimators.method import Method, run_log
from companion.kernels.atmosphere import baro_altitude_array, geopotential_m, pressure_altitude_m
from companion.samples import Kind
from sim.studies.page import Spread, generators, spread
from sim.studies.papers.damping_loop import mountain_road as road
from sim.studies.papers.damping_loop.mountain_road import G_MPS2, GAS, LAPSE_KPM, P0_PA, T0_K, Drive

Array = NDArray[np.float64]
PRINTED_GAINS = (3.00, 0.6452, 0.8710)
THERMOMETER_SD_K = 2.0
"""of the air temperature at the start, for the compensated altitude"""
RATIO_DRIVES = 20
NOISES: tuple[float, ...] = tuple(np.geomspace(0.02, 2.0, 13).tolist())
"""of w in (11), m/s2/sqrt(Hz), from which the filter without a bias state gets its best"""
PRINTED_LOOP, BEST_LOOP = "loop, gains (10)", "loop, best gains"
EULER_LOOP = "loop, gains (10), by forward Euler at 20 Hz"
KF_3, KF_3_TOLD, KF_4 = (
    "Kalman filter, 3 states as (14), best w",
    "the same, w as simulated",
    "Kalman filter, 4 states",
)


def printed_altitude_m(pressure_pa: float, lapse: float) -> float:
    """(1) as printed, for either sign of the lapse rate."""
    return float(T0_K / lapse * ((pressure_pa / P0_PA) ** (lapse * GAS / G_MPS2) - 1.0))


def circular_error_m(altitude_m: float, density: float | None = None) -> float:
    """What (4)-(5) add at an altitude of an exactly standard day; density as measured there unless
    given, kg/m3."""
    temperature_k = T0_K - LAPSE_KPM * altitude_m
    pressure_pa = P0_PA * (temperature_k / T0_K) ** (G_MPS2 / (GAS * LAPSE_KPM))
    density = pressure_pa / (GAS * temperature_k) if density is None else density
    deviation_k = temperature_k + LAPSE_KPM * altitude_m - T0_K  # (5): zero, as it should be
    deviation_pa = pressure_pa + density * G_MPS2 * altitude_m - P0_PA
    return float(deviation_k / T0_K * altitude_m + GAS * T0_K / G_MPS2 * deviation_pa / P0_PA)


def euler(
    gains: Gains,
    state: tuple[float, float, float],
    baro_m: Array,
    acceleration_mps2: Array,
    interval_s: float,
) -> Array:
    """(6) without 2 w_s^2 by forward Euler: (h, v, a_c) before each step, shape (n, 3)."""
    h, v, a_c = state
    found = np.empty((baro_m.size, 3))
    for k in range(baro_m.size):
        found[k] = h, v, a_c
        error_m = h - baro_m[k]
        h, v, a_c = (
            h + interval_s * (v - gains[0] * error_m),
            v + interval_s * (acceleration_mps2[k] - a_c - gains[1] * error_m),
            a_c + interval_s * gains[2] * error_m,
        )
    return found


def estimates(method: Method, settings: Settings, driven: Drive) -> tuple[Array, Array]:
    """Altitude and climb after each IMU sample."""
    found = run_log(method, driven.log, settings)[0]
    of_imu = driven.log.tables.order["kind"] == Kind.IMU
    return found["altitude_amsl_m"][of_imu], found["climb_mps"][of_imu]


def start_settings(warmer_k: float = road.WARMER_K) -> dict[str, float]:
    """The start as the estimators are told of it: its height, and the air's temperature there."""
    return {
        "start_altitude_m": road.START_M,
        "start_temperature_k": T0_K - LAPSE_KPM * road.START_M + warmer_k,
    }


def loop(gains: Gains) -> Callable[[Drive], tuple[Array, Array]]:
    """Altitude and climb of the loop."""
    settings = DampingLoopSettings(k1=gains[0], k2=gains[1], k3=gains[2], **start_settings())
    return partial(estimates, damping_loop.METHOD, settings)


def kalman_filter(
    *, bias_state: bool, noise: float = road.FORCE_SD / math.sqrt(road.IMU_HZ)
) -> Callable[[Drive], tuple[Array, Array]]:
    """Altitude and climb of the Kalman filter that is told how the sensors were simulated."""
    settings = BaroInsKfSettings(
        accelerometer_bias_state=bias_state,
        baro_bias_sd_m=road.BARO_WANDER_M,
        baro_bias_time_s=road.BARO_TIME_S,
        baro_sd_m=road.BARO_SD_M,
        acceleration_noise_mps2_rthz=noise,
        accelerometer_bias_sd_mps2=math.hypot(road.FORCE_BIAS, road.FORCE_WANDER),
        accelerometer_bias_time_s=road.FORCE_TIME_S,
        **start_settings(),
    )
    return partial(estimates, baro_ins_kf.METHOD, settings)


def euler_loop(driven: Drive) -> tuple[Array, Array]:
    """Altitude and climb of the printed gains by forward Euler, the barometer held between its
    samples."""
    course = flight_of(driven).course
    inertial, baro = (course[course["kind"] == kind] for kind in (Kind.IMU, Kind.PRESSURE))
    held_m = baro["value"][np.searchsorted(baro["time_us"], inertial["time_us"], "right") - 1]
    found = np.full((driven.time_s.size, 3), np.nan)
    start = (float(held_m[0]), 0.0, 0.0)
    found[-inertial.size :] = euler(
        PRINTED_GAINS, start, held_m, inertial["value"], 1.0 / road.IMU_HZ
    )
    return found[:, 0], found[:, 1]


@dataclass(frozen=True)
class Tuned:
    """What all strings cost on one drive, and what genetic searches found there."""

    costs: Array
    searches: list[genetic.Search]
    by_roulette: list[genetic.Search]

    @property
    def roulette_share(self) -> float:
        """Share of the searches with roulette selection that reach the least cost."""
        least = float(self.costs.min())
        return float(np.mean([each.cost <= least * (1.0 + 1e-12) for each in self.by_roulette]))

    @property
    def best(self) -> Gains:
        return genetic.decode(int(np.argmin(self.costs)))

    @property
    def ratios(self) -> Array:
        """Cost that each search reached over the least."""
        return np.array([search.cost / float(self.costs.min()) for search in self.searches])


def flight_of(driven: Drive) -> tuning.Flight:
    """What gains are tried on."""
    return tuning.Flight(driven.log, DampingLoopSettings(**start_settings()))


def tune(driven: Drive, searches: int, progress: Callable[[float], None]) -> Tuned:
    """Try all strings on a drive, and search them genetically."""
    flight, costs = flight_of(driven), np.empty(2**genetic.STRING_BITS)
    for string in range(costs.size):
        costs[string] = flight.cost(genetic.decode(string))
        if string % 2048 == 0:
            progress(string / costs.size)
    return Tuned(
        costs,
        *(
            [
                genetic.search(lambda s: float(costs[s]), random, selection=selection)
                for random in generators("K", searches)
            ]
            for selection in (genetic.tournament, genetic.roulette)
        ),
    )


def printed_over_least(drives: list[Drive]) -> Array:
    """Cost of the printed gains over the least that three genetic searches find, one a drive."""
    ratios = []
    for driven, random in zip(drives, generators("K", len(drives)), strict=True):
        flight = flight_of(driven)
        least = min(
            genetic.search(lambda s: flight.cost(genetic.decode(s)), random).cost  # noqa: B023
            for _ in range(3)
        )
        ratios.append(flight.cost(genetic.PAPER_GAINS) / least)
    return np.array(ratios)


def errors(
    drives: list[Drive], way: Callable[[Drive], tuple[Array, Array]]
) -> tuple[Spread, Spread]:
    """RMS error of climb and of altitude after the first minute, over drives."""
    climbs, altitudes = [], []
    for driven in drives:
        altitude_m, climb_mps = way(driven)
        climbs.append(_rms((climb_mps - driven.climb_mps)[driven.late]))
        altitudes.append(_rms((altitude_m - driven.altitude_m)[driven.late]))
    return spread(climbs), spread(altitudes)


def best_noise(driven: Drive) -> float:
    """w with which the filter without a bias state has the smallest velocity error on a drive."""

    def error(noise: float) -> float:
        return errors([driven], kalman_filter(bias_state=False, noise=noise))[0].mean

    return min(NOISES, key=error)


def compensated_m(driven: Drive, told: dict[str, float]) -> Array:
    """H of (2) at each barometer sample."""
    level_m = np.array(
        [pressure_altitude_m(value) for value in driven.log[Kind.PRESSURE]["pressure_pa"]]
    )
    start_level_m = pressure_altitude_m(float(road.pressure_pa(np.array(road.START_M))))
    scale = told["start_temperature_k"] / (T0_K - LAPSE_KPM * start_level_m) - 1.0
    start_m = geopotential_m(told["start_altitude_m"])
    return np.array([calibrated_m(level, start_level_m, start_m, scale) for level in level_m])


def barometer_rms_m(drives: list[Drive]) -> tuple[float, float]:
    """Of the standard and of the compensated altitude over all drives."""
    random = generators("K thermometer", 1)[0]
    standard, compensated = [], []
    for driven in drives:
        pressures = driven.log[Kind.PRESSURE]
        truth_m = np.interp(
            pressures["time_us"] * 1e-6 - road.START_S, driven.time_s, driven.altitude_m
        )
        standard.append(_rms(baro_altitude_array(pressures["pressure_pa"]) - truth_m))
        told = start_settings(road.WARMER_K + random.normal(0.0, THERMOMETER_SD_K))
        compensated.append(_rms(compensated_m(driven, told) - truth_m))
    return _rms(np.array(standard)), _rms(np.array(compensated))


def radius(interval_s: float) -> float:
    """Spectral radius of the error's transition over one barometer interval, with the printed
    gains."""
    gains = matched_gains(*poles(*PRINTED_GAINS), interval_s)
    fly = np.array(
        [[1.0, interval_s, interval_s**2 / 2.0], [0.0, 1.0, interval_s], [0.0, 0.0, 1.0]]
    )
    return float(
        np.abs(np.linalg.eigvals((np.eye(3) - np.outer(gains, [1.0, 0.0, 0.0])) @ fly)).max()
    )


def euler_limit_s() -> float:
    """Step from which forward Euler is unstable, with the printed gains."""
    return min(-2.0 * pole.real / abs(pole) ** 2 for pole in tuning.loop_poles(PRINTED_GAINS))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values * values)))
