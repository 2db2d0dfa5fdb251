"""The figures of paper H's page."""

import math

import numpy as np
from numpy.typing import NDArray

from companion.plots.style import BARO, BOUND, FUSED, GNSS, OTHER, TRUTH
from sim.studies.page import spread
from sim.studies.papers.adaptive_fusion.simulation import (
    DRIFT,
    NOMINAL,
    PRESSURE_KPA,
    R_B,
    R_GPS,
    TABLE_1,
    Run,
    Tally,
)
from sim.studies.papers.page import Page

Array = NDArray[np.float64]
TRACES = {
    "baro_m": ("barometer", BARO),
    "fixed_m": ("fixed filter", OTHER),
    "adaptive_m": ("adaptive filter", FUSED),
    "gnss_m": ("GPS", GNSS),
}
"""errors of a run, in the order in which they are drawn"""


def draw_descent(page: Page) -> None:
    caption = "True height by iteration (the paper's Fig. 1)."
    with page.figure("descent", caption, panel_in=1.8) as (panel,):
        panel.plot(
            np.arange(1, PRESSURE_KPA.size + 1), NOMINAL.truth_m, color=TRUTH, label="true height"
        )
        panel.set(title="height (m)", xlabel="iteration")
        panel.legend()


def draw_nominal(page: Page, run: Run) -> None:
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


AVERAGED = 51
"""steps of a moving root mean square"""


def moving_rms(error_m: Array) -> Array:
    """Root mean square of the `AVERAGED` errors around each step, fewer at the ends."""
    ones = np.ones(AVERAGED)
    count = np.convolve(np.ones(error_m.size), ones, mode="same")
    return np.asarray(np.sqrt(np.convolve(error_m**2, ones, mode="same") / count))


def draw_drift(page: Page, run: Run) -> None:
    k = np.arange(1, PRESSURE_KPA.size + 1)
    caption = (
        "One run under drift: absolute errors with the fixed filter (Fig. 6); of the adaptive "
        f"filter (Fig. 8, thin), and root mean squares of {AVERAGED} steps of all (Figs. 8, 9), "
        "the adaptive filter's above that of GPS; normalised residual (Fig. 7); adaptive factor "
        "(Fig. 10)."
    )
    with page.figure("drift", caption, rows=4, panel_in=1.9, sharex=True) as axes:
        for name, (label, colour) in TRACES.items():
            error_m = getattr(run, name)
            if name != "adaptive_m":
                axes[0].plot(k, np.abs(error_m), color=colour, linewidth=0.5, label=label)
            width = 2.8 if name == "adaptive_m" else 1.4
            axes[1].plot(k, moving_rms(error_m), color=colour, linewidth=width, label=label)
        axes[1].plot(k, np.abs(run.adaptive_m), color=FUSED, linewidth=0.3, alpha=0.4, zorder=1)
        axes[0].set(title="|error| (m), fixed filter")
        axes[1].set(title=f"|error| of the adaptive filter, RMS of {AVERAGED} steps (m)")
        axes[0].legend(loc="upper left", ncols=3)
        axes[1].legend(loc="upper left", ncols=4)
        axes[2].plot(k, run.delta_m / math.sqrt(R_B + R_GPS), color=BOUND, linewidth=0.5)
        axes[2].set(title="normalised residual (34)")
        axes[3].plot(k, run.factor, color=FUSED, linewidth=0.5)
        axes[3].set(title="adaptive factor S", xlabel="iteration")


def draw_rms(page: Page, drift: Tally) -> None:
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
            color=TRUTH,
            linestyle="--",
            label="sqrt(R_GPS + 3 R_GPS^2 / b^2)",
        )
        claimed = [math.sqrt(spread(values).mean) for values in drift.variance_m2.values()]
        panel.plot(
            list(TABLE_1),
            claimed,
            color=TRUTH,
            linestyle="none",
            marker="o",
            markersize=4,
            label="sqrt(P)",
        )
        panel.set(xlabel="iteration", title="RMS error (m)", ylim=(8, 24))
        panel.legend(loc="upper right", ncols=3)
