"""Paper H: Hajiyev, Hacizade, Cilden-Guler 2019, against `companion.estimators.adaptive_fusion`.

The simulation of section 5: pressure rises from 23 to 99.85 kPa in steps of 0.05; (1) gives the
true height; barometer and GPS add white noise of 9 and 13 m (32)-(33). In the drift case the
barometer's p0 and T0 leave the standard.

Heights reach the estimator as a vehicle would send them: each barometer height becomes the pressure
at which the standard atmosphere has it, each GPS height a fix of the same instant, and `run_log`
steps through the rows.

What the print leaves open, and what is wrong in it
---------------------------------------------------
- R = 287 does not give the paper's heights; 287.05 does. Everything here is computed with the
  latter.
- ``p0(k) = p0 - 0.01 k kPa, T0(k) = T0 - 0.01 k K, k >= 23``: k is the pressure loop's variable in
  kPa (23 to 99.85). Taken as the iteration, which is what the text says, nothing of Table 1 is
  reached.
- 1560 iterations are 1538 steps of 0.05 kPa.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from companion.estimators.adaptive_fusion import (
    METHOD,
    AdaptiveFusionSettings,
    adaptive_factor,
    gain,
)
from companion.estimators.method import run_log
from companion.kernels.atmosphere import geopotential_m, standard_pressure_pa
from companion.samples import Kind, Rows, SampleLog, sample
from sim.studies.page import (
    BARO,
    BOUND,
    FUSED,
    GNSS,
    OTHER,
    TRUTH,
    Spread,
    Value,
    generators,
    spread,
)
from sim.studies.papers import Progress
from sim.studies.papers.page import Page, Row, at_most, below, compare, holds, near

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


def reproduce(seeds: int, out: Path, progress: Progress) -> Page:
    """The page of paper H."""
    tallies = nominal, drift, literal = Tally(), Tally(), Tally()
    examples: list[Run] = []
    for done, runs in enumerate(monte_carlo(seeds), start=1):
        examples = examples or list(runs)
        for tally, run in zip(tallies, runs, strict=True):
            tally.add(run)
        progress(0.9 * done / seeds, "Monte Carlo")
    page = Page("H", seeds, out)
    page.text(
        "A descent from 10.9 km to 123 m in 1538 steps. The barometer (white, 9 m) and GPS "
        "(white, 13 m) are fused with a fixed gain and with one that adapts to their "
        "disagreement; then the sea-level pressure and temperature of the air drift away from the "
        "standard that the barometer assumes. Each pair of heights goes through the estimator as "
        "a pressure and a fix, as live samples do."
    )
    page.table("The descent (section 5)", _descent_rows())
    page.table("Without drift (Figs. 2-5)", _nominal_rows(nominal))
    _draw_descent(page)
    _draw_nominal(page, examples[0])
    page.table(
        "Table 1: P of the adaptive filter under drift",
        _table_1_rows(drift, literal),
        ("k: kPa", "k: iteration"),
    )
    page.table("Under drift (Figs. 6-10)", _drift_rows(drift, examples[1]))
    _draw_drift(page, examples[1])
    _draw_rms(page, drift)
    _add_true_error(page, drift)
    page.table("Properties that the text states", _property_rows())
    return page


def _descent_rows() -> list[Row]:
    top, bottom = (
        float(height_m(p, gas_constant=R_PRINTED)) for p in (PRESSURE_KPA[0], PRESSURE_KPA[-1])
    )
    fitting_top, fitting_bottom = (float(height_m(p)) for p in (PRESSURE_KPA[0], PRESSURE_KPA[-1]))
    reading = "with R = 287.05"
    return [
        compare("height at 23 kPa, R = 287", 10894.0, top, 0.5, unit="m", where="(1)"),
        compare(
            "height at 23 kPa", 10894.0, fitting_top, 0.5, unit="m", where="(1)", reading=reading
        ),
        compare("height at 99.85 kPa, R = 287", 123.47, bottom, 0.005, unit="m", where="(1)"),
        compare(
            "height at 99.85 kPa",
            123.47,
            fitting_bottom,
            0.005,
            unit="m",
            where="(1)",
            reading=reading,
        ),
        compare(
            "iterations", 1560, PRESSURE_KPA.size, 0, where="sec. 5", note="(99.85 - 23) / 0.05 + 1"
        ),
    ]


def _nominal_rows(nominal: Tally) -> list[Row]:
    fixed, baro, gnss = nominal.rms("fixed_m"), nominal.rms("baro_m"), nominal.rms("gnss_m")
    mean_square = spread(np.square(nominal.rmse["fixed_m"]))
    return [
        compare(
            "P of the fixed filter",
            54.756,
            R_GPS * gain(1.0, R_B, R_GPS),
            5e-4,
            unit="m²",
            where="(17)",
        ),
        compare("its mean square error", 54.756, mean_square, 0.5, unit="m²", where="sec. 5"),
        holds(
            "the fixed filter is better than either sensor",
            below(fixed.mean, min(baro.mean, gnss.mean)),
            f"RMSE {fixed}, barometer {baro}, GPS {gnss}",
            unit="m",
            where="Figs. 2-4",
        ),
        holds(
            "the adaptive filter leaves good measurements alone",
            below(nominal.rms("adaptive_m").mean, 1.02 * fixed.mean),
            f"RMSE {nominal.rms('adaptive_m')}, fixed {fixed}",
            unit="m",
            where="abstract",
            note="(28) fires at one standard deviation: without any fault in "
            f"{100 * spread(nominal.fired).mean:.1f} % of the steps",
        ),
        holds(
            "S is a factor on a variance, never negative: share of steps with S < 0, (31) as "
            "printed",
            at_most(spread(nominal.negative).mean, 0.0),
            spread(nominal.negative),
            printed=0.0,
            where="(31)",
            note="without the condition (28), S is negative whenever the sensors agree within 13 "
            "m; K has a pole at a "
            "residual of 0. S = max(1, .) is meant",
        ),
    ]


def _table_1_rows(drift: Tally, literal: Tally) -> list[Row]:
    rows = []
    for iteration, printed in TABLE_1.items():
        ours, other = spread(drift.variance_m2[iteration]), spread(literal.variance_m2[iteration])
        row = compare(
            f"P at iteration {iteration}",
            printed,
            ours,
            2.0 * ours.sd,
            reading="k in kPa",
            unit="m²",
            note="within 2 sd of a run; k the iteration: a drift of "
            f"{abs(LITERAL.bias_m[iteration - 1]):.0f} m, "
            f"{abs(other.mean - printed) / max(other.sd, 1e-9):.0f} sd away",
        )
        rows.append(replace(row, ours=(ours, other)))
    return rows


def _drift_rows(drift: Tally, example: Run) -> list[Row]:
    adaptive, fixed = drift.rms("adaptive_m"), drift.rms("fixed_m")
    gnss, baro = drift.rms("gnss_m"), drift.rms("baro_m")
    factor = example.factor
    return [
        holds(
            "barometer and fixed filter are considerably worse than GPS",
            below(2 * gnss.mean, min(fixed.mean, baro.mean)),
            f"RMSE {baro} and {fixed}, GPS {gnss}",
            unit="m",
            where="Fig. 6",
        ),
        holds(
            "the adaptive filter is better than the fixed one",
            below(adaptive.mean, fixed.mean),
            f"RMSE {adaptive}, fixed {fixed}",
            unit="m",
            where="Fig. 9",
        ),
        holds(
            "its error variance is below that of GPS",
            below(adaptive.mean**2, gnss.mean**2),
            f"mean square {spread(np.square(drift.rmse['adaptive_m']))}, GPS "
            f"{spread(np.square(drift.rmse['gnss_m']))}",
            unit="m²",
            where="Table 1, (21)",
            note="P is below R_GPS by construction; it is not the variance of the error",
        ),
        holds(
            "S grows with the drift",
            below(float(np.mean(factor[:200])), float(np.mean(factor[-200:]))),
            f"{np.mean(factor[:200]):.0f} at first, {np.mean(factor[-200:]):.0f} at last (one run)",
            where="Fig. 10",
        ),
    ]


def _property_rows() -> list[Row]:
    gains = [gain(S, R_B, R_GPS) for S in (1.0, 3.0, 10.0)]
    small, large = 1e-3, 1e6
    K, P = gain(1.0, R_B, R_GPS), R_GPS * gain(1.0, R_B, R_GPS)
    closed = R_B * R_GPS / (R_B + R_GPS)
    return [
        holds("0 < K < 1", below(0.0, K, 1.0), K, where="(20)"),
        holds("0 < P < R_GPS", below(0.0, P, R_GPS), P, unit="m²", where="(21)"),
        compare("P = R_B R_GPS / (R_B + R_GPS)", closed, P, 1e-9, unit="m²", where="(22)"),
        compare("R_B - P = P R_B / R_GPS", P * R_B / R_GPS, R_B - P, 1e-9, unit="m²", where="(23)"),
        holds("R_B > P", below(P, R_B), P, unit="m²", where="(24)"),
        holds(
            "K decreases as S increases",
            below(*reversed(gains)),
            ", ".join(f"K({S}) = {value:.3f}" for S, value in zip((1, 3, 10), gains, strict=True)),
            where="after (30)",
            note="it rises; the text's conclusion, more weight on GPS, is right",
        ),
        holds(
            "R_B >> R_GPS: K = 1, P = R_GPS",
            near(gain(1.0, large, R_GPS), 1.0, 1e-3),
            f"K = {gain(1.0, large, R_GPS):.4f}, P = {R_GPS * gain(1.0, large, R_GPS):.2f}",
            where="(25)",
        ),
        holds(
            "R_B << R_GPS: P tends to 0",
            below(R_GPS * gain(1.0, small, R_GPS), 0.5 * small),
            f"P = {R_GPS * gain(1.0, small, R_GPS) / small:.4f} R_B",
            where="after (25)",
            note="P tends to R_B",
        ),
        Row(
            "computing time, adaptive over fixed",
            f"{0.024544 / 0.021502:.2f}",
            "not timed: a page depends on its seeds alone",
            where="sec. 5",
        ),
    ]


def _add_true_error(page: Page, drift: Tally) -> None:
    page.text(
        "When (28) fires, the estimate is exactly h_GPS - R_GPS / residual: GPS height, pushed "
        "away from the barometer. With a barometer error b its mean square error is R_GPS + 3 "
        "R_GPS^2 / b^2 to second order, above that of GPS alone (169 m²) at every drift, while P "
        "stays below."
    )
    mean_square = drift.mean_square_m2("adaptive_m")
    rows: list[list[Value]] = []
    for iteration, values in drift.variance_m2.items():
        near = slice(iteration - 26, iteration + 25)
        bias_m = float(DRIFT.bias_m[iteration - 1])
        expected_m2 = R_GPS + 3 * R_GPS**2 / bias_m**2
        rows.append(
            [
                str(iteration),
                f"{bias_m:.1f}",
                spread(values).mean,
                expected_m2,
                float(mean_square[near].mean()),
            ]
        )
    header = [
        "iteration",
        "b (m)",
        "P, mean (m²)",
        "R_GPS + 3 R_GPS^2 / b^2 (m²)",
        "mean square error (m²), 51 steps",
    ]
    page.grid("What the adaptive filter's error is", header, rows)


def _draw_descent(page: Page) -> None:
    caption = "True height by iteration (the paper's Fig. 1)."
    with page.figure("descent", caption, panel_in=1.8) as (panel,):
        panel.plot(
            np.arange(1, PRESSURE_KPA.size + 1), NOMINAL.truth_m, color=TRUTH, label="true height"
        )
        panel.set(title="height (m)", xlabel="iteration")
        panel.legend()


def _draw_nominal(page: Page, run: Run) -> None:
    k = np.arange(1, PRESSURE_KPA.size + 1)
    caption = (
        "Absolute errors of one run without drift (the paper's Figs. 2-4), and its "
        "normalised residual (Fig. 5)."
    )
    with page.figure("no-drift", caption, rows=2, columns=2, panel_in=2.1, sharex=True) as axes:
        panels = (
            ("barometer", run.baro_m, BARO),
            ("GPS", run.gnss_m, GNSS),
            ("fixed filter", run.fixed_m, FUSED),
        )
        for panel, (name, error, colour) in zip(axes, panels, strict=False):
            panel.plot(k, np.abs(error), color=colour, linewidth=0.6)
            panel.set(title=f"|error| of the {name} (m)", ylim=(0, 50))
        axes[3].plot(k, run.delta_m / math.sqrt(R_B + R_GPS), color=BOUND, linewidth=0.6)
        axes[3].set(title="normalised residual (34)", xlabel="iteration")
        axes[2].set(xlabel="iteration")


def _draw_drift(page: Page, run: Run) -> None:
    k = np.arange(1, PRESSURE_KPA.size + 1)
    caption = (
        "One run under drift: adaptive against fixed (Fig. 9), normalised residual (Fig. "
        "7), adaptive factor (Fig. 10)."
    )
    with page.figure("drift", caption, rows=3, panel_in=1.9, sharex=True) as axes:
        axes[0].plot(k, np.abs(run.baro_m), color=BARO, linewidth=0.5, label="barometer")
        axes[0].plot(k, np.abs(run.fixed_m), color=OTHER, linewidth=0.5, label="fixed filter")
        axes[0].plot(k, np.abs(run.gnss_m), color=GNSS, linewidth=0.5, label="GPS (Figs. 6, 8)")
        axes[0].plot(k, np.abs(run.adaptive_m), color=FUSED, linewidth=0.5, label="adaptive filter")
        axes[0].set(title="|error| (m)")
        axes[0].legend(loc="upper left", ncols=4)
        axes[1].plot(k, run.delta_m / math.sqrt(R_B + R_GPS), color=BOUND, linewidth=0.5)
        axes[1].set(title="normalised residual (34)")
        axes[2].plot(k, run.factor, color=FUSED, linewidth=0.5)
        axes[2].set(title="adaptive factor S", xlabel="iteration")


def _draw_rms(page: Page, drift: Tally) -> None:
    caption = (
        "RMS error over the seeds under drift, and what P claims. The adaptive filter is "
        "never better than GPS alone."
    )
    with page.figure("rms", caption) as (panel,):
        k = np.arange(1, PRESSURE_KPA.size + 1)
        for name, label, colour in (
            ("fixed_m", "fixed filter", OTHER),
            ("gnss_m", "GPS", GNSS),
            ("adaptive_m", "adaptive filter", FUSED),
        ):
            panel.plot(
                k, np.sqrt(drift.mean_square_m2(name)), color=colour, linewidth=0.7, label=label
            )
        beyond = np.abs(DRIFT.bias_m) > 35  # where the expansion in 1/b holds
        expected = np.sqrt(R_GPS + 3 * R_GPS**2 / DRIFT.bias_m[beyond] ** 2)
        panel.plot(
            k[beyond],
            expected,
            color="black",
            linestyle="--",
            label="sqrt(R_GPS + 3 R_GPS^2 / b^2)",
        )
        claimed = [math.sqrt(spread(values).mean) for values in drift.variance_m2.values()]
        panel.plot(
            list(TABLE_1),
            claimed,
            color="black",
            linestyle="none",
            marker="o",
            markersize=4,
            label="sqrt(P)",
        )
        panel.set(xlabel="iteration", title="RMS error (m)", ylim=(8, 24))
        panel.legend(loc="upper right", ncols=3)
