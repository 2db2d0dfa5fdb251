"""Paper C: robust against optimal filter by the size of a bias, and the lock-out."""

import math

import numpy as np
from numpy.typing import NDArray

from companion.plots.style import BOUND, FUSED, INERTIAL, OTHER
from sim.studies.page import spread
from sim.studies.papers.page import Page, Row, below, holds
from sim.studies.papers.robust_altimeter.altimeter_errors import (
    ALTIMETERS,
    BIASED,
    T_D_S,
    Result,
    simulate,
)
from sim.studies.papers.robust_altimeter.models import TABLE_1, TABLE_1_ROBUST

Array = NDArray[np.float64]
BIASES_M = (5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0)
PATIENCE_S = 120.0
LONG = 1200
"""Iterations of the run that shows the lock-out."""
OPTIMAL, ROBUST = "optimal", "robust, as printed"
KINDS = {
    OPTIMAL: TABLE_1,
    ROBUST: TABLE_1_ROBUST,
    "robust, re-acquires after 60 s": TABLE_1_ROBUST.having(reacquire_s=60.0),
    "robust, re-acquires after 120 s": TABLE_1_ROBUST.having(reacquire_s=PATIENCE_S),
}


def add_sweep(page: Page, draws: Array) -> None:
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
        styles = ((BOUND, "-", 1.1), (OTHER, "--", 1.4), (INERTIAL, "-", 1.1), (FUSED, "-", 3.0))
        for order, (name, (colour, style, width)) in enumerate(zip(KINDS, styles, strict=True)):
            axes[0].plot(
                BIASES_M,
                [iig for _, iig in means[name]],
                marker="o",
                markersize=4,
                color=colour,
                linestyle=style,
                linewidth=width,
                label=name,
                zorder=10 - order,
            )
        axes[0].set(title="mean |error| (m)", xlabel="bias (m)")
        axes[0].legend(loc="upper left")


def add_lock_out(page: Page, draws: Array) -> None:
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
    _draw_lock_out(page, optimal, ours, printed)


def _draw_lock_out(page: Page, optimal: Result, ours: Result, printed: Result) -> None:
    """Error and probability of IIG in the first run."""
    time_s = T_D_S * np.arange(LONG)
    with page.figure(
        "lock-out",
        "IIG in one run: a bias of 15 m between 100 and 200 s, and prob(1/i).",
        rows=2,
        sharex=True,
    ) as axes:
        for result, colour, name in (
            (optimal, BOUND, "optimal"),
            (ours, FUSED, f"robust, re-acquires after {PATIENCE_S:g} s"),
            (printed, OTHER, "robust, as printed"),
        ):
            style = "--" if result is printed else "-"
            axes[0].plot(
                time_s,
                np.abs(result.errors_m[0, :, 1]),
                color=colour,
                linestyle=style,
                label=name,
            )
            if result is not optimal:
                axes[1].plot(
                    time_s,
                    result.probability[0, :, 1],
                    color=colour,
                    linestyle=style,
                    linewidth=0.8,
                )
        axes[0].set(yscale="symlog", title="|error| (m)")
        axes[0].legend()
        axes[1].set(xlabel="time (s)", title="prob(1/i)")
