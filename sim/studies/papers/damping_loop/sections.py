"""The sections of paper K's page: tables and figures."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.estimators.baro_inertial import genetic, tuning
from companion.estimators.baro_inertial.genetic import Gains
from companion.estimators.baro_inertial.loop_gains import TWO_WS2
from companion.kernels.atmosphere import baro_altitude_array, pressure_altitude_m
from companion.plots.style import BARO, BOUND, FUSED, GNSS, INERTIAL, OTHER, TRUTH
from companion.samples import Kind
from sim.studies.page import Value, spread
from sim.studies.papers.damping_loop import mountain_road as road
from sim.studies.papers.damping_loop.consistency import (
    EXPECTED,
    HIGHEST,
    LOWEST,
    Input,
    normalised_errors,
    stationary_bias_sd_m,
)
from sim.studies.papers.damping_loop.mountain_road import LAPSE_KPM, Drive
from sim.studies.papers.damping_loop.simulation import (
    BEST_LOOP,
    EULER_LOOP,
    KF_3,
    KF_3_TOLD,
    KF_4,
    PRINTED_GAINS,
    PRINTED_LOOP,
    THERMOMETER_SD_K,
    Tuned,
    barometer_rms_m,
    circular_error_m,
    compensated_m,
    errors,
    euler_limit_s,
    euler_loop,
    kalman_filter,
    loop,
    printed_altitude_m,
    radius,
    start_settings,
)
from sim.studies.papers.page import Page, Row, at_most, below, compare, holds

Array = NDArray[np.float64]


def add_atmosphere(page: Page, drives: list[Drive]) -> None:
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
                "Fig. 4", f"on a standard day (5) alone adds {circular_m[0]:+.0f} m, or "
                f"{circular_m[1]:+.0f} m with 1.225 kg/m3"),
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


def add_loop(page: Page, best: Gains) -> None:
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


def add_genetic(page: Page, tuned: Tuned, printed_ratios: Array) -> None:
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
        axes[0].plot(curves[0], color=BOUND, linewidth=0.5, label="each search")
        axes[0].plot(curves[1:].T, color=BOUND, linewidth=0.5, alpha=0.5)
        axes[0].plot(np.median(curves, axis=0), color=FUSED, label="median of the searches")
        axes[0].axhline(1.0, color=TRUTH, linewidth=0.8, label="exhaustive search")
        axes[0].set_ylim(0.995, 1.2)
        axes[0].set_xlim(0, 40)
        axes[0].set(title="cost over the least of all", xlabel="generation")
        axes[0].legend()


def add_comparison(page: Page, drives: list[Drive], best: Gains, noise: float) -> None:
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
            holds("the printed gains are optimal", at_most(speed[PRINTED_LOOP],
                                                           1.05 * speed[BEST_LOOP]),
                  f"{speed[PRINTED_LOOP]:.3f} against {speed[BEST_LOOP]:.3f} m/s", where="(10)",
                  note="on our road; theirs is not known"),
        ],
    )  # fmt: skip
    _add_consistency(page, drives)
    _draw_comparison(page, drives[0], ways)


def _add_consistency(page: Page, drives: list[Drive]) -> None:
    """(15) as printed beside the corrected one."""
    page.text(
        "Two claims are tried on (15): that it is (11) and (12) as a state space, so that b has "
        f"the spread sigma of (12) ({road.BARO_WANDER_M:g} m here), within 1 %; and that the "
        "Kalman filter is an optimal estimator (section I). The error squared of an optimal "
        f"filter's climb and height over their P averages {EXPECTED:g}: a mean between {LOWEST:g} "
        f"and {HIGHEST:g} counts as optimal, that is, a variance right within a factor of two."
    )
    rows = []
    for b_input in Input:
        reading = "" if b_input is Input.PRINTED else b_input.value
        nees = normalised_errors(drives, b_input)
        rows += [
            compare(
                "(15) is (11) and (12): spread of b",
                road.BARO_WANDER_M,
                stationary_bias_sd_m(b_input),
                0.01 * road.BARO_WANDER_M,
                reading=reading,
                unit="m",
                where="(12), (15)",
            ),
            holds(
                "the Kalman filter is optimal: error squared of climb and height over P",
                below(LOWEST, nees.mean, HIGHEST),
                nees,
                reading=reading,
                where="section I, (15)",
            ),
        ]
    page.table("The Kalman filter's model (15)", rows)


def _draw_comparison(
    page: Page, driven: Drive, ways: dict[str, Callable[[Drive], tuple[Array, Array]]]
) -> None:
    """Altitude, and errors of altitude and velocity, on one drive."""
    pairs = ((PRINTED_LOOP, BEST_LOOP), (KF_3, KF_4))
    colours = {PRINTED_LOOP: OTHER, BEST_LOOP: FUSED, KF_3: INERTIAL, KF_4: GNSS}
    found = {name: ways[name](driven) for name in colours}
    caption = (
        "One drive as the paper's Figs. 4 to 6 draw it (altitude), and what the scale of these "
        "figures hides: the errors of the altitude."
    )
    with page.figure("height", caption, rows=3, sharex=True, panel_in=2.2) as axes:
        pressures = driven.log[Kind.PRESSURE]
        axes[0].plot(driven.time_s, driven.altitude_m, color=TRUTH, label="truth")
        axes[0].plot(
            pressures["time_us"] * 1e-6 - road.START_S,
            baro_altitude_array(pressures["pressure_pa"]),
            color=BARO,
            label="barometer, standard (1)",
        )
        for name in (BEST_LOOP, KF_3):
            style = "-" if name == BEST_LOOP else "--"
            axes[0].plot(
                driven.time_s, found[name][0], color=colours[name], linestyle=style, label=name
            )
        axes[0].set(title="altitude (m)")
        axes[0].legend(ncols=2)
        _draw_errors(axes[1:], driven, found, colours, pairs, 0, "altitude error (m)", 4.0)
    with page.figure("velocity", "Velocity error of one drive.", rows=2, sharex=True) as axes:
        _draw_errors(axes, driven, found, colours, pairs, 1, "velocity error (m/s)", 1.5)


def _draw_errors(
    axes: Sequence[Any],
    driven: Drive,
    found: dict[str, tuple[Array, Array]],
    colours: dict[str, str],
    pairs: Sequence[tuple[str, str]],
    which: int,
    title: str,
    limit: float,
) -> None:
    """Errors of altitude (0) or velocity (1) of each pair in a panel."""
    truth = (driven.altitude_m, driven.climb_mps)[which]
    for axis, names in zip(axes, pairs, strict=True):
        for name in names:
            axis.plot(
                driven.time_s,
                found[name][which] - truth,
                color=colours[name],
                linewidth=0.9,
                label=name,
            )
        axis.set(title=title, ylim=(-limit, limit))
        axis.legend(ncols=2)
    axes[-1].set_xlabel("time (s)")
