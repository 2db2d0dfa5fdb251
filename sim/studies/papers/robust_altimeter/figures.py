"""The figures of paper C's page."""

import numpy as np

from companion.plots.style import BARO, BOUND, FUSED, GNSS
from sim.studies.papers.page import Page
from sim.studies.papers.robust_altimeter.altimeter_errors import (
    ALTIMETERS,
    FIRST_FAULTY,
    ITERATIONS,
    LAST_FAULTY,
    T_D_S,
)
from sim.studies.papers.robust_altimeter.models import Outcome

COLOURS = (BARO, GNSS, FUSED)


def draw_scenarios(page: Page, outcome: Outcome, index: int, name: str, what: str) -> None:
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
            axis.axvspan(
                T_D_S * FIRST_FAULTY,
                T_D_S * LAST_FAULTY,
                color=BOUND,
                alpha=0.15,
                lw=0,
                label="time of the faults",
            )
            axis.set_title(title.split(": ")[1])
        axes[1].legend(ncols=2)
        for axis in axes[-2:]:
            axis.set_xlabel("time (s)")
        for axis in axes[::2]:
            axis.set_ylabel("error (m)")
