"""Paper C: Mañero Contreras, Hajiyev 2019, against `companion.estimators.robust_altimeter.steps`.

The simulation of section 4 is `sim.studies.papers.altimeter_errors`. Whole samples (specific force,
pressure, fix) through the estimator's `run` give the same errors: see the last table of the page.

What the print leaves open, and what is wrong in it
---------------------------------------------------
- sigma_UB, the start, the number of iterations, the size of the bias and the factor of the variance
  are not given. Here: 600 iterations, 20 m, 100, a start with the spreads of Table 1, sigma_UB =
  0.1 (1, like sigma_B in Table 1, makes the mean error of IBI 3 m).
- Table 2 gives IIG 2.17 m, Table 4 the same undisturbed altimeter 1.25 m, Table 6 1.27 m.
- Whether IBI and IIG share one INS is not said: R of (13) and (18) holds its variance, 9 m2, in
  both. With one INS their errors are correlated and IBIG gains less; both readings are shown.
- (32) is read with the instantaneous normalised innovation and its spread of 1; with a windowed
  mean the robust filter is much weaker.
- Which of the two filters the tables are of is not said. With the robust one no choice comes near
  them.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.estimators.robust_altimeter import METHOD
from companion.estimators.robust_altimeter.settings import PUBLISH
from companion.kernels.atmosphere import geopotential_m, standard_pressure_pa
from companion.kernels.earth import gravity_mps2
from companion.samples import ESTIMATE, Kind, SampleLog, rows, sample
from sim.studies.page import BARO, BOUND, FUSED, GNSS, OTHER, Value, generators, spread
from sim.studies.papers import Progress
from sim.studies.papers.altimeter_errors import (
    ALTIMETERS,
    BIASED,
    FIRST_FAULTY,
    ITERATIONS,
    LAST_FAULTY,
    NOISY,
    NORMAL,
    START_SD,
    T_D_S,
    Model,
    Result,
    noises,
    open_loop_m,
    simulate,
)
from sim.studies.papers.page import Page, Row, below, both, compare, holds

Array = NDArray[np.float64]

TABLE_1 = Model()
TABLE_1_ROBUST = TABLE_1.having(robust=True)
FITTED = Model(sigma_a=0.6, sigma_ub=0.2)
ONE_INS = FITTED.having(shared=True)
COLUMNS = ("Table 1, optimal", "Table 1, robust", "fitted, one INS", "fitted, two INS")
MODELS = (TABLE_1, TABLE_1_ROBUST, ONE_INS, FITTED)
READING = "fitted, optimal filter, two INS"
COLOURS = (BARO, GNSS, FUSED)

SCENARIOS: dict[str, tuple[int, int]] = {
    "Table 2: no fault": (NORMAL, NORMAL),
    "Table 3: scenario 1, both noisy": (NOISY, NOISY),
    "Table 4: scenario 2, IBI biased": (BIASED, NORMAL),
    "Table 5: scenario 3, both biased": (BIASED, BIASED),
    "Table 6: scenario 4, IBI noisy": (NOISY, NORMAL),
    "Table 7: scenario 5, IBI noisy, IIG biased": (NOISY, BIASED),
}
MEANS = (
    (1.87, 2.17, 1.43),
    (9.37, 6.27, 4.45),
    (7.54, 1.25, 4.61),
    (7.57, 7.54, 7.28),
    (6.72, 1.27, 6.15),
    (6.59, 7.54, 5.62),
)
"""Printed mean errors of IBI, IIG, IBIG in Tables 2-7, m."""
DEVIATIONS = (
    (0.0418, 0.0588, 0.0165),
    (0.4376, 0.2392, 0.2009),
    (0.2734, 0.0920, 0.1849),
    (0.3587, 0.3577, 0.3473),
    (0.3687, 0.0279, 0.3437),
    (0.2370, 0.3075, 0.1979),
)
"""Printed standard deviations, m."""
WITHIN = 0.2
BIASES_M = (5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0)
PATIENCE_S = 120.0
LONG = 1200
"""Iterations of the run that shows the lock-out."""
LIVE_SEEDS = 10
OPTIMAL, ROBUST = "optimal", "robust, as printed"
KINDS = {
    OPTIMAL: TABLE_1,
    ROBUST: TABLE_1_ROBUST,
    "robust, re-acquires after 60 s": TABLE_1_ROBUST.having(reacquire_s=60.0),
    "robust, re-acquires after 120 s": TABLE_1_ROBUST.having(reacquire_s=PATIENCE_S),
}

Outcome = dict[str, tuple[Result, ...]]
"""Scenario -> a result for each of `MODELS`."""


def reproduce(seeds: int, out: Path, progress: Progress) -> Page:
    """The page of paper C."""
    draws = noises(generators("C", seeds))
    outcome: Outcome = {}
    for done, (title, faults) in enumerate(SCENARIOS.items()):
        progress(0.05 + 0.4 * done / len(SCENARIOS), title)
        outcome[title] = tuple(simulate(model.having(faults=faults), draws) for model in MODELS)
    page = Page("C", seeds, out)
    page.text(
        "An inertial channel drifts by the paper's error model; an altimeter with a barometer "
        "(IBI), one with GPS (IIG) and their fusion (IBIG) find its error. Between iterations 200 "
        "and 400 of 600 (0.5 s each) sensors are biased by 20 m (CBM) or their variance is "
        "100-fold (MNI). Values are means of the absolute error of estimating the error, in "
        "metres. R is 10 m² (13) and 13.9729 m² (18)."
    )
    for (title, results), printed in zip(outcome.items(), MEANS, strict=True):
        page.table(title, _mean_rows(results, printed), COLUMNS)
    page.text(
        "*Table 1* is what the paper says it uses (sigma of U_B, which it does not give: 0.1), "
        "with the optimal and with the robust gain. *Fitted* is the one set of assumptions that "
        "comes near all tables at once: optimal gain, sigma of the vertical acceleration 0.6 "
        "instead of 0.00002 m/s², sigma of U_B 0.2. The inertial channel is then so bad that each "
        "altimeter is little more than its sensor. The verdict is that of the fitted value with "
        "two INS, within 20 %; *one INS* draws the INS's part of both measurements (9 m² of R) "
        "once. Assumptions of ours, which the paper does not give: 600 iterations, a bias of 20 "
        "m, a factor of 100, and (32) with the instantaneous innovation. The paper contradicts "
        "itself: IIG, undisturbed in all three, has 2.17 m in Table 2, 1.25 m in Table 4 and 1.27 "
        "m in Table 6."
    )
    page.table(
        "The same tables: standard deviations",
        _deviation_rows(outcome),
        ("standard error of the mean",),
    )
    for index, name in ((-1, "two INS"), (2, "one INS")):
        page.table(f"What the text concludes ({name})", _claim_rows(outcome, index))
    progress(0.5, "robust against optimal")
    _add_sweep(page, draws)
    progress(0.8, "lock-out")
    _add_lock_out(page, noises(generators("C", min(seeds, 30)), LONG))
    page.table("Properties of the filters", _property_rows(outcome, draws))
    progress(0.9, "whole samples")
    _add_live(page, outcome, draws[:LIVE_SEEDS])
    _draw_scenarios(page, outcome, -1, "scenarios", "fitted, optimal")
    _draw_scenarios(page, outcome, 1, "robust", "Table 1, robust")
    return page


def _mean_rows(results: Sequence[Result], printed: Sequence[float]) -> list[Row]:
    made = []
    for altimeter in range(3):
        values = tuple(spread(result.mean_m(altimeter)) for result in results)
        row = compare(
            ALTIMETERS[altimeter],
            printed[altimeter],
            values[-1],
            WITHIN * printed[altimeter],
            reading=READING,
            unit="m",
        )
        made.append(
            replace(
                row, ours=values, note=f"{100 * (values[-1].mean / printed[altimeter] - 1):+.0f} %"
            )
        )
    return made


def _deviation_rows(outcome: Outcome) -> list[Row]:
    made = []
    for (title, results), printed in zip(outcome.items(), DEVIATIONS, strict=True):
        for altimeter in range(3):
            ours = spread(results[-1].standard_error_m(altimeter))
            value = printed[altimeter]
            made.append(
                compare(
                    f"{title.split(':')[0]}, {ALTIMETERS[altimeter]}",
                    value,
                    ours,
                    WITHIN * value,
                    reading=READING,
                )
            )
    return made


def _claim_rows(outcome: Outcome, index: int) -> list[Row]:
    """The text's conclusions, from the results of one of `MODELS`."""
    mean = {
        title: tuple(spread(results[index].mean_m(a)).mean for a in range(4))
        for title, results in outcome.items()
    }
    free, both_noisy, ibi_biased, both_biased, ibi_noisy, mixed = mean.values()

    def best(claim: str, values: Sequence[float], where: str) -> Row:
        return holds(claim, below(values[2], min(values[:2])), _words(values), where=where)

    return [
        holds(
            "without a fault IIG is worst, IBIG best",
            below(free[2], free[0], free[1]),
            _words(free),
            where="Table 2",
            note=f"IBIG is best in {100 * _share_best(outcome, index):.0f} % of the seeds",
        ),
        best("both noisy: IBIG is better than each", both_noisy, "4.4"),
        holds(
            "IBI biased: IBIG lies between, worse than IIG",
            below(ibi_biased[1], ibi_biased[2], ibi_biased[0]),
            _words(ibi_biased),
            where="4.5",
        ),
        best("both biased: IBIG is better than each", both_biased, "4.6"),
        holds(
            "IBI noisy: IBIG is worse than IIG",
            below(ibi_noisy[1], ibi_noisy[2]),
            _words(ibi_noisy),
            where="4.7",
        ),
        best("IBI noisy, IIG biased: IBIG is better than each", mixed, "4.8"),
        holds(
            "one faulty: the other altimeter, as the estimator recommends it, is better than IBIG",
            both(below(ibi_biased[3], ibi_biased[2]), below(ibi_noisy[3], ibi_noisy[2])),
            f"IBI biased {ibi_biased[3]:.2f} against {ibi_biased[2]:.2f}, noisy "
            f"{ibi_noisy[3]:.2f} against {ibi_noisy[2]:.2f}",
            where="sec. 5",
            note="isolated by prob(1/i) and disagreement, not by knowing the fault",
        ),
    ]


def _words(values: Sequence[float]) -> str:
    return " / ".join(f"{value:.2f}" for value in values[:3])


def _share_best(outcome: Outcome, index: int) -> float:
    """Share of the seeds in which IBIG has the smallest mean error without a fault."""
    free = next(iter(outcome.values()))[index]
    means = np.array([free.mean_m(altimeter) for altimeter in range(3)])
    return float(np.mean(means[2] < means[:2].min(axis=0)))


def _add_sweep(page: Page, draws: Array) -> None:
    """Mean errors of scenario 3 by the size of the bias, and the paper's conclusion from them."""
    means: dict[str, list[tuple[float, float]]] = {name: [] for name in KINDS}
    for bias_m in BIASES_M:
        for name, model in KINDS.items():
            result = simulate(model.having(faults=(BIASED, BIASED), bias_m=bias_m), draws)
            means[name].append((spread(result.mean_m(0)).mean, spread(result.mean_m(1)).mean))
    optimal, robust = (np.array(means[name]) for name in (OPTIMAL, ROBUST))
    better = [bool((robust[i] < 0.8 * optimal[i]).all()) for i in range(len(BIASES_M))]
    from_m = next((bias_m for i, bias_m in enumerate(BIASES_M) if all(better[i:])), math.inf)
    worst = int(np.argmax((robust / optimal).max(axis=1)))
    page.table(
        "Robust against optimal",
        [
            holds(
                "when a fault occurs the robust filter is considerably better, whatever its size",
                below(float((robust / optimal).max()), 0.8),
                f"both biased by {from_m:g} m or more",
                printed="always",
                where="sec. 5",
                note=f"biased by {BIASES_M[worst]:g} m it is "
                f"{(robust / optimal)[worst].max():.1f} times worse",
            ),
            holds(
                "the same for large faults",
                below(float((robust / optimal)[-1].max()), 0.8),
                f"{BIASES_M[-1]:g} m: {robust[-1].max():.1f} against {optimal[-1].min():.1f} m",
                where="sec. 5",
                reading=f"biases of {BIASES_M[-1]:g} m",
            ),
        ],
    )
    page.grid(
        "Both sensors biased: mean error of IBI / IIG (Table 1, m)",
        ["bias", *KINDS],
        [
            [
                f"{bias_m:g} m",
                *(f"{means[name][i][0]:.1f} / {means[name][i][1]:.1f}" for name in KINDS),
            ]
            for i, bias_m in enumerate(BIASES_M)
        ],
    )
    _draw_sweep(page, means)


def _draw_sweep(page: Page, means: dict[str, list[tuple[float, float]]]) -> None:
    caption = "Mean error of IIG against the size of a bias on both sensors for 100 s (Table 1)."
    with page.figure("bias", caption) as axes:
        shown = (OPTIMAL, ROBUST, f"robust, re-acquires after {PATIENCE_S:g} s")
        for name, colour in zip(shown, (BOUND, OTHER, FUSED), strict=True):
            axes[0].plot(
                BIASES_M, [iig for _, iig in means[name]], marker="o", color=colour, label=name
            )
        axes[0].set(title="mean |error| (m)", xlabel="bias (m)")
        axes[0].legend(loc="upper left")


def _add_lock_out(page: Page, draws: Array) -> None:
    """The robust filter after a bias of 15 m on both sensors, with and without the rule."""
    model = TABLE_1_ROBUST.having(faults=(BIASED, BIASED), bias_m=15.0)
    printed, ours = simulate(model, draws), simulate(model.having(reacquire_s=PATIENCE_S), draws)
    optimal = simulate(model.having(robust=False), draws)
    last = {
        name: tuple(spread(result.mean_m(a, LONG - 60)) for a in range(3))
        for name, result in (("printed", printed), ("ours", ours), ("optimal", optimal))
    }
    page.table(
        f"Five minutes after a bias of 15 m: mean error over the last 30 of {LONG * T_D_S:g} s",
        [
            Row(
                name,
                None,
                tuple(last[kind][a] for kind in ("printed", "ours", "optimal")),
                unit="m",
            )
            for a, name in enumerate(ALTIMETERS[:3])
        ],
        ("robust, as printed", f"robust, re-acquires after {PATIENCE_S:g} s", "optimal"),
    )
    time_s = T_D_S * np.arange(LONG)
    with page.figure(
        "lock-out",
        "IIG in one run: a bias of 15 m between 100 and 200 s, and prob(1/i).",
        rows=2,
        sharex=True,
    ) as axes:
        for result, colour, name in (
            (optimal, BOUND, "optimal"),
            (printed, OTHER, "robust"),
            (ours, FUSED, "re-acquires"),
        ):
            axes[0].plot(time_s, np.abs(result.errors_m[0, :, 1]), color=colour, label=name)
            if result is not optimal:
                axes[1].plot(time_s, result.probability[0, :, 1], color=colour)
        axes[0].set(yscale="symlog", title="|error| (m)")
        axes[0].legend()
        axes[1].set(xlabel="time (s)", title="prob(1/i)")


def _property_rows(outcome: Outcome, draws: Array) -> list[Row]:
    free, _, ibi_biased, *_ = outcome.values()
    open_loop = open_loop_m(FITTED.sigma_a, draws)
    literal = simulate(TABLE_1.having(sigma_ub=1.0), draws)
    fed_back = spread(np.abs(free[-1].errors_m[:, :, 1]).max(axis=1))
    return [
        holds(
            "the variances that weigh the altimeters see a fault: largest change with a bias",
            below(0.0, float(np.abs(free[-1].variance_m2 - ibi_biased[-1].variance_m2).max())),
            float(np.abs(free[-1].variance_m2 - ibi_biased[-1].variance_m2).max()),
            unit="m²",
            where="(19), (26)",
        ),
        compare(
            "sigma_B as a spread of the bias, driven by U_B of that sigma",
            1.0,
            1.0 * T_D_S / math.sqrt(1.0 - (1.0 - 0.01 * T_D_S) ** 2),
            0.01,
            unit="m",
            where="(2), Table 1",
            note="1 m needs 0.1997",
        ),
        compare(
            "mean error of IBI without a fault, U_B of sigma 1",
            1.87,
            spread(literal.mean_m(0)),
            WITHIN * 1.87,
            unit="m",
            where="Table 2",
            note=f"with 0.1: {spread(free[0].mean_m(0))} m",
        ),
        Row(
            "INS error after 300 s, open loop, sigma 0.6 m/s² (fitted)",
            None,
            spread(np.abs(open_loop[:, -1])),
            "m",
            "(21)",
            f"fed back it stays below {fed_back} m",
        ),
    ]


LEAD = 6
"""Iterations of the IMU alone before the first pressure and fix: the attitude is aligned in
them."""


def live_log(model: Model, draw: Array) -> SampleLog:
    """What a level vehicle 1000 m up would send: 10 Hz of specific force, a pressure and a fix in
    each iteration.

    The specific force has the errors of (5) and (6), pressure and fix the noise of (13) and (18).
    """
    a, g, bias = (sd * float(value) for sd, value in zip(START_SD[2:], draw[0, 2:5], strict=True))
    log = SampleLog()
    imu = sample(Kind.IMU, 0, angular_rate_b_radps=0.0)
    pressure = sample(Kind.PRESSURE, 0)
    fix = sample(Kind.GNSS, 0, vertical_sd_m=2.23, fix_type=3)
    for i in range(-LEAD, draw.shape[0] - 1):
        at_us = 1_000_000 * (LEAD + 1) + round(i * T_D_S * 1e6)
        imu["specific_force_b_mps2"] = (0.0, 0.0, -(gravity_mps2(45.0, 0.0) + a + g))
        for part in range(5):
            imu["time_us"] = at_us - 450_000 + part * 100_000
            log.append(Kind.IMU, imu)
        if i < 0:
            continue
        noise = draw[i + 1]
        read_m = geopotential_m(1000.0 + bias + math.sqrt(10.0) * float(noise[3]))
        pressure["time_us"], pressure["pressure_pa"] = at_us, standard_pressure_pa(read_m)
        log.append(Kind.PRESSURE, pressure)
        fix["time_us"], fix["altitude_amsl_m"] = (
            at_us,
            1000.0 + math.sqrt(13.9729) * float(noise[4]),
        )
        log.append(Kind.GNSS, fix)
        a += T_D_S * (model.sigma_a * noise[0] - 0.001 * a)
        g += T_D_S * (2e-5 * noise[1] - 0.005 * g)
        bias += T_D_S * (model.sigma_ub * noise[2] - 0.01 * bias)
    return log


def live_errors_m(model: Model, log: SampleLog, publish: str) -> Array:
    """Errors of whole samples through the estimator's `run`; the datum of the barometer is
    known."""
    params = model.params()
    params["publish"], params["reference_s"] = PUBLISH[publish], 1e18
    state = METHOD.init(params)
    datum = state["pair"]["datum"]
    datum["offset_m"], datum["at_m"], datum["age_s"] = 0.0, 1000.0, 1e18
    estimates, verdicts = rows(ESTIMATE, len(log)), np.zeros(len(log), np.int64)
    METHOD.run(state, params, log.tables, estimates, verdicts)
    return np.asarray(estimates["altitude_amsl_m"][5 * LEAD + 6 :: 7] - 1000.0)


def _add_live(page: Page, outcome: Outcome, draws: Array) -> None:
    free = next(iter(outcome.values()))[0]
    logs = [live_log(TABLE_1, draw) for draw in draws]
    lines: list[list[Value]] = []
    for altimeter, name in enumerate(ALTIMETERS[:3]):
        live = [np.abs(live_errors_m(TABLE_1, log, name.lower())).mean() for log in logs]
        lines.append([name, spread(free.mean_m(altimeter)[: draws.shape[0]]), spread(live)])
    page.grid(
        "Through the estimator's `run`, sample by sample (mean error without a fault, Table 1, "
        "optimal, m)",
        [
            f"the first {draws.shape[0]} seeds",
            "as simulated above",
            "specific force, pressure and fix",
        ],
        lines,
    )


def _draw_scenarios(page: Page, outcome: Outcome, index: int, name: str, what: str) -> None:
    """Figs. 3-8: errors of one run in each scenario, of one of `MODELS`."""
    time_s = T_D_S * np.arange(ITERATIONS)
    caption = f"Errors of one run in the paper's scenarios (Figs. 3-8; {what})."
    with page.figure(name, caption, rows=3, columns=2, panel_in=1.9, sharex=True) as axes:
        for axis, (title, results) in zip(axes, outcome.items(), strict=True):
            for altimeter, colour in enumerate(COLOURS):
                axis.plot(
                    time_s,
                    results[index].errors_m[0, :, altimeter],
                    color=colour,
                    label=ALTIMETERS[altimeter],
                    lw=0.7,
                )
            axis.axvspan(T_D_S * FIRST_FAULTY, T_D_S * LAST_FAULTY, color=BOUND, alpha=0.15, lw=0)
            axis.set_title(title.split(": ")[1])
        axes[0].legend(ncols=3)
        for axis in axes[-2:]:
            axis.set_xlabel("time (s)")
        for axis in axes[::2]:
            axis.set_ylabel("error (m)")
