"""Paper K: Keighobadi, Nourmohammadi, Rafatnia, against
`companion.estimators.baro_inertial.damping_loop` and `baro_ins_kf`.

The paper drives a car with a MEMS IMU and barometer over mountain roads and shows figures without
numbers; apart from its formulas, the gains (10) and the schedule (8) nothing is printed that could
be computed again. Its claims are tried on `sim.studies.papers.mountain_road`. Samples reach the
estimators as a vehicle sends them, and are stepped through by their own `run`. Gains are found on
the GPS velocity of one drive, and judged by the true velocity of the others.

What the print leaves open, and what is wrong in it
---------------------------------------------------
- (1) is negative above sea level for either sign of L.
- (5) derives sea-level temperature and pressure from the height that they are to correct: circular.
- The gains (10) have three digits: they are 31, 20 and 27 thirty-firsts, 5 bits on [0, 3], [0, 1],
  [0, 1]. The floor of (8) is 1 / 240, one over N_pop x N_bits as in its reference: 16 strings of 15
  bits.
- (11), (12), (15): see `companion.estimators.baro_inertial.baro_ins_kf`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.config import Settings
from companion.estimators.baro_inertial import baro_ins_kf, damping_loop, genetic, tuning
from companion.estimators.baro_inertial.damping_loop import DampingLoopSettings
from companion.estimators.baro_inertial.genetic import Gains
from companion.estimators.baro_inertial.inputs import calibrated_m
from companion.estimators.baro_inertial.loop_gains import TWO_WS2, matched_gains, poles
from companion.estimators.baro_inertial.settings import BaroInsKfSettings
from companion.estimators.method import Method, run_log
from companion.kernels.atmosphere import baro_altitude_array, geopotential_m, pressure_altitude_m
from companion.samples import Kind
from sim.studies.page import (
    BARO,
    BOUND,
    FUSED,
    GNSS,
    INERTIAL,
    OTHER,
    TRUTH,
    Spread,
    Value,
    generators,
    spread,
)
from sim.studies.papers import Progress
from sim.studies.papers import mountain_road as road
from sim.studies.papers.mountain_road import G_MPS2, GAS, LAPSE_KPM, P0_PA, T0_K, Drive
from sim.studies.papers.page import Page, Row, at_most, below, compare, holds

Array = NDArray[np.float64]

PRINTED_GAINS = (3.00, 0.6452, 0.8710)
THERMOMETER_SD_K = 2.0
"""of the air temperature at the start, for the compensated altitude"""
RATIO_DRIVES = 20
NEES_DRIVES = 10
"""drives on which the printed gains are held against the best"""
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
    random = np.random.default_rng(np.random.SeedSequence([ord("K"), 1]))
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


def reproduce(seeds: int, out: Path, progress: Progress) -> Page:
    """The page of this paper."""
    page = Page("K", seeds, out)
    progress(0.0, "drives")
    tuned_on, *drives = (road.drive(random) for random in generators("K", seeds + 1))
    tuned = tune(
        tuned_on, max(seeds, 20), lambda share: progress(0.2 + 0.5 * share, "all 32768 strings")
    )
    progress(0.7, "genetic searches")
    page.text(
        "The paper's results are figures of a drive that is not published; what it prints are "
        "formulas, a schedule and three gains. Its claims are tried on a mountain road of our "
        "own: 1350 m to about 1950 m in five minutes, 15 K and -8 hPa off the standard at sea "
        "level; an accelerometer at 20 Hz (0.2 m/s2 bias, 0.1 m/s2 / 60 s Gauss-Markov, 0.1 m/s2 "
        "white), a barometer at 10 Hz (0.3 m white, 1 m / 60 s), GPS velocity at 1 Hz (0.1 m/s). "
        "All of these are our assumptions."
    )
    _atmosphere(page, drives)
    _loop(page, tuned.best)
    _genetic(page, tuned, printed_over_least(drives[:RATIO_DRIVES]))
    progress(0.8, "estimators")
    _comparison(page, drives, tuned.best, best_noise(tuned_on))
    return page


def _atmosphere(page: Page, drives: list[Drive]) -> None:
    """Section II: (1)-(5) and figure 4."""
    standard_m, compensated = barometer_rms_m(drives)
    circular_m = circular_error_m(road.START_M), circular_error_m(road.START_M, 1.225)
    page.table(
        "Barometric altitude (section II)",
        [
            *(compare(f"altitude at 84.5 kPa, L {lapse:+g} K/m", pressure_altitude_m(84_500.0),
                      printed_altitude_m(84_500.0, lapse), 1.0, unit="m", where="(1)",
                      note="the standard atmosphere's in the column of the print")
              for lapse in (LAPSE_KPM, -LAPSE_KPM)),
            compare("correction on an exactly standard day at 1350 m", 0.0, circular_m[0], 5.0,
                    unit="m", where="(5)",
                    note="the H_p in it is what it is to correct; with 1.225 kg/m3 "
                        f"{circular_m[1]:+.1f} m"),
            holds("the compensated altitude is accurate: rms",
                  below(compensated, 0.2 * standard_m), compensated, unit="m",
                  where="(2), Fig. 4", note="with the start's height given, and its air "
                      "temperature to "
                  f"{THERMOMETER_SD_K:g} K; uncompensated {standard_m:.1f} m"),
            Row("the 60 m between compensated altitude and GPS are the geoid", "60", None, "m",
                "Fig. 4", "they are as much as (5) invents"),
        ],
    )  # fmt: skip
    pressures = drives[0].log[Kind.PRESSURE]
    baro_s = pressures["time_us"] * 1e-6 - road.START_S
    truth_m = np.interp(baro_s, drives[0].time_s, drives[0].altitude_m)
    standard = baro_altitude_array(pressures["pressure_pa"]) - truth_m
    with page.figure("altitude", "Error of the barometer's altitude on one drive.") as axes:
        axes[0].plot(baro_s, standard, color=BARO, label="standard (1)")
        axes[0].plot(
            baro_s,
            compensated_m(drives[0], start_settings()) - truth_m,
            color=FUSED,
            label="compensated (2)",
        )
        for error_m in circular_m:
            axes[0].axhline(error_m, color=OTHER, linestyle="--", linewidth=0.8)
        axes[0].plot([], [], color=OTHER, linestyle="--", label="what (5) adds on a standard day")
        axes[0].set(title="altitude error (m)", xlabel="time (s)")
        axes[0].set_ylim(-110.0, 140.0)
        axes[0].legend(ncols=3)


def _loop(page: Page, best: Gains) -> None:
    """(6) and (10): poles, and what discretisation makes of them."""
    real, slow, _ = tuning.loop_poles(PRINTED_GAINS)
    damping = tuning.damping(PRINTED_GAINS)
    intervals_s = np.geomspace(1e-3, 10.0, 200)
    exact = np.array([radius(interval_s) for interval_s in intervals_s])
    page.table(
        "Damping loop (6) with the gains (10)",
        [
            holds("the gains are stable: K3 < K1 (K2 - 2 w_s^2)",
                  below(PRINTED_GAINS[2], PRINTED_GAINS[0] * (PRINTED_GAINS[1] - TWO_WS2)),
                  f"{PRINTED_GAINS[2]:.3f} < "
                  f"{PRINTED_GAINS[0] * (PRINTED_GAINS[1] - TWO_WS2):.3f}"),
            holds("the effect of noise's oscillations is removed perfectly", below(0.7, damping),
                  f"damping ratio {damping:.3f}", where="section IV.C",
                  note="noise excites the loop's own oscillation: period "
                      f"{2 * math.pi / slow.imag:.1f} s, "
                  f"a tenth after {math.log(10) / -slow.real:.0f} s"),
        ],
    )  # fmt: skip
    page.grid(
        "What the paper does not print",
        ["", "ours"],
        [
            ["real pole, 1/s", f"{real.real:.4f}"],
            ["slow pair, 1/s", f"{slow.real:.5f} ± {slow.imag:.5f}i"],
            ["damping ratio", f"{damping:.3f}"],
            ["forward Euler is unstable from, s", f"{euler_limit_s():.4f}"],
            ["largest spectral radius of our feedback, 1 ms to 10 s", f"{exact.max():.6f}"],
        ],
    )
    _draw_poles(page, best, intervals_s, exact)


def _draw_poles(page: Page, best: Gains, intervals_s: Array, exact: Array) -> None:
    """Poles, and the spectral radius of a step by its length."""
    real, slow, _ = tuning.loop_poles(PRINTED_GAINS)
    euler_radius = np.abs(1.0 + np.outer([real, slow], intervals_s)).max(axis=0)
    caption = (
        "Poles of the loop, and spectral radius of a step of it by its length: above 1 it "
        "is unstable."
    )
    with page.figure("poles", caption, columns=2) as axes:
        for gains, colour, label in (
            (PRINTED_GAINS, OTHER, "gains (10)"),
            (best, FUSED, "best gains"),
        ):
            found = np.array(tuning.loop_poles(gains))
            axes[0].plot(found.real, found.imag, "x", color=colour, label=label)
        axes[0].axhline(0.0, color=BOUND, linewidth=0.8)
        axes[0].axvline(0.0, color=BOUND, linewidth=0.8)
        axes[0].set(
            title="poles", xlim=(-3.2, 0.2), xlabel="real part (1/s)", ylabel="imaginary part (1/s)"
        )
        axes[0].legend()
        axes[1].semilogx(intervals_s, euler_radius, color=OTHER, label="gains (10), forward Euler")
        axes[1].semilogx(intervals_s, exact, color=FUSED, label="gains (10), ours")
        axes[1].axhline(1.0, color=BOUND, linewidth=0.8)
        axes[1].set(
            title="spectral radius of a step", xlabel="step (s)", xlim=(0.02, 10.0), ylim=(0.5, 1.5)
        )
        axes[1].legend()


def _genetic(page: Page, tuned: Tuned, printed_ratios: Array) -> None:
    """Section III: the schedule (8) and what the search finds."""
    exact = float(np.mean(tuned.ratios < 1.0 + 1e-12))
    roulette = tuned.roulette_share
    tried = np.mean([search.evaluations for search in tuned.searches])
    on_grid = genetic.decode(genetic.encode(PRINTED_GAINS))
    page.table(
        "Genetic algorithm (section III)",
        [
            compare("p_m of the first generation", 0.117917, genetic.mutation_probability(0), 1e-6,
                    where="(8)"),
            compare("floor of p_m", 0.0041667, genetic.mutation_probability(60), 1e-7, where="(8)"),
            holds("the gains lie on a grid of 5 bits",
                  at_most(float(np.abs(np.subtract(on_grid, PRINTED_GAINS)).max()), 5e-5),
                  "31/31, 20/31, 27/31", printed="3.00, .6452, .8710", where="(10)"),
            holds("the same with the paper's roulette selection", below(0.99, roulette),
                  f"{100 * roulette:.0f} %",
                  where="section III"),
            holds("reaches the best solution and avoids local minima: share of searches",
                  below(0.99, exact),
                  f"{100 * exact:.0f} % of searches", where="section I",
                  note="against all 32768 strings; the others "
                  f"stay at most {100 * (tuned.ratios.max() - 1.0):.1f} % above. {tried:.0f} "
                  "strings tried a search"),
            Row("cost of the printed gains over the least", None, spread(printed_ratios),
                where="(7)", note="on our drives"),
        ],
    )  # fmt: skip
    least = float(tuned.costs.min())
    curves = np.array([search.history for search in tuned.searches]) / least
    with page.figure(
        "genetic", "Cost of the best string over the least of all, by generation."
    ) as axes:
        axes[0].plot(curves.T, color=BOUND, linewidth=0.5, alpha=0.5)
        axes[0].plot(np.median(curves, axis=0), color=FUSED, label="median of the searches")
        axes[0].axhline(1.0, color=TRUTH, linewidth=0.8, label="exhaustive search")
        axes[0].set_ylim(0.995, 1.2)
        axes[0].set_xlim(0, 40)
        axes[0].set(title="cost over the least of all", xlabel="generation")
        axes[0].legend()


def _comparison(page: Page, drives: list[Drive], best: Gains, noise: float) -> None:
    """Section IV.C: loop against Kalman filter."""
    ways = {
        PRINTED_LOOP: loop(PRINTED_GAINS),
        EULER_LOOP: euler_loop,
        BEST_LOOP: loop(best),
        KF_3: kalman_filter(bias_state=False, noise=noise),
        KF_3_TOLD: kalman_filter(bias_state=False),
        KF_4: kalman_filter(bias_state=True),
    }
    found = {name: errors(drives, way) for name, way in ways.items()}
    rows: list[list[Value]] = [[name, *found[name]] for name in ways]
    page.grid("RMS errors", ["after the first minute", "velocity, m/s", "altitude, m"], rows)
    speed = {name: velocity.mean for name, (velocity, _) in found.items()}
    height = {name: altitude.mean for name, (_, altitude) in found.items()}
    nees = {place: bias_nees(drives, place) for place in ("as printed", "corrected")}
    page.table(
        "Loop against Kalman filter (section IV.C)",
        [
            holds("the genetic loop tracks the altitude better than the Kalman filter",
                  below(height[BEST_LOOP], 0.95 * height[KF_3]),
                  f"{height[BEST_LOOP]:.2f} against {height[KF_3]:.2f} m", printed="superior",
                  where="Fig. 6",
                  note="5 % would count; a filter with a state for the accelerometer's bias has "
                      f"{height[KF_4]:.2f} m"),
            holds("it tracks the velocity better", below(speed[BEST_LOOP], 0.95 * speed[KF_3]),
                  f"{speed[BEST_LOOP]:.3f} against {speed[KF_3]:.3f} m/s",
                  reading="a filter without a state for the accelerometer's bias, as (14)",
                  note=f"with it {speed[KF_4]:.3f} m/s"),
            holds("(15) as printed is consistent: error squared of height and climb over P",
                  below(nees["as printed"].mean, 4.0), nees["as printed"], where="(15)",
                  note="2 is consistent; the noise of b stands in the row of the height"),
            holds("with that noise in the row of b it is ten times nearer",
                  below(nees["corrected"].mean, 0.1 * nees["as printed"].mean), nees["corrected"],
                  where="(15)"),
            holds("the printed gains are optimal", at_most(speed[PRINTED_LOOP],
                                                           1.05 * speed[BEST_LOOP]),
                  f"{speed[PRINTED_LOOP]:.3f} against {speed[BEST_LOOP]:.3f} m/s", where="(10)",
                  note="on our road; theirs is not known"),
        ],
    )  # fmt: skip
    _draw_comparison(page, drives[0], ways)


def _draw_comparison(
    page: Page, driven: Drive, ways: dict[str, Callable[[Drive], tuple[Array, Array]]]
) -> None:
    """Errors of velocity and altitude on one drive."""
    for figure, which, unit, limit in (
        ("velocity", 1, "velocity error (m/s)", 1.5),
        ("height", 0, "altitude error (m), the paper's Figs. 4-6", 6.0),
    ):
        with page.figure(
            figure, f"{unit.split(' (')[0].capitalize()} of one drive.", rows=2, sharex=True
        ) as axes:
            truth = (driven.altitude_m, driven.climb_mps)[which]
            for axis, names in ((axes[0], (PRINTED_LOOP, BEST_LOOP)), (axes[1], (KF_3, KF_4))):
                colours = (OTHER, FUSED) if axis is axes[0] else (INERTIAL, GNSS)
                for name, colour in zip(names, colours, strict=True):
                    axis.plot(
                        driven.time_s,
                        ways[name](driven)[which] - truth,
                        color=colour,
                        label=name,
                    )
                axis.set(title=unit, ylim=(-limit, limit))
                axis.legend(ncols=2)
            axes[1].set_xlabel("time (s)")


def bias_nees(drives: list[Drive], place: str) -> Spread:
    """Normalised error squared of (height, climb) of a filter of climb, height and the barometer's
    bias (11)-(16), with the noise of b in the row of the height, as (15) prints, or in that of
    b."""
    return spread(
        [_three_state_nees(driven, place == "as printed") for driven in drives[:NEES_DRIVES]]
    )


def _three_state_nees(driven: Drive, printed: bool) -> float:
    """Mean over one drive after the first minute, once a barometer sample; (V_z, h, b)."""
    course = flight_of(driven).course
    sigma, beta = road.BARO_WANDER_M, 1.0 / road.BARO_TIME_S
    noise = road.FORCE_SD**2 / road.IMU_HZ + road.FORCE_BIAS**2
    x, P = np.array([0.0, road.START_M, 0.0]), np.diag([1.0, 4.0, sigma**2])
    H, last_us, force, found = np.array([0.0, 1.0, 1.0]), int(course["time_us"][0]), 0.0, []
    for time_us, kind, value in zip(
        course["time_us"], course["kind"], course["value"], strict=True
    ):
        dt = (int(time_us) - last_us) * 1e-6
        last_us = int(time_us)
        F = np.array([[1.0, 0.0, 0.0], [dt, 1.0, 0.0], [0.0, 0.0, 1.0 - beta * dt]])
        x = F @ x + np.array([dt * force, 0.0, 0.0])
        walk = 2.0 * beta * sigma**2 * dt
        P = F @ P @ F.T + np.diag([noise * dt, walk if printed else 0.0, 0.0 if printed else walk])
        if kind == Kind.IMU:
            force = float(value)
        elif kind == Kind.PRESSURE:
            K = P @ H / (H @ P @ H + road.BARO_SD_M**2)
            x, P = x + K * (float(value) - H @ x), P - np.outer(K, H @ P)
            at_s = int(time_us) * 1e-6 - road.START_S
            if at_s > 60.0:
                truth = np.array(
                    [
                        np.interp(at_s, driven.time_s, driven.climb_mps),
                        np.interp(at_s, driven.time_s, driven.altitude_m),
                    ]
                )
                error = x[:2] - truth
                found.append(float(error @ np.linalg.solve(P[:2, :2], error)))
    return float(np.mean(found))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values * values)))
