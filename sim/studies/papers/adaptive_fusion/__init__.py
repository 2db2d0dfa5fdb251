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

from pathlib import Path

from sim.studies.papers import Progress
from sim.studies.papers.adaptive_fusion.figures import (
    draw_descent,
    draw_drift,
    draw_nominal,
    draw_rms,
)
from sim.studies.papers.adaptive_fusion.simulation import Run, Tally, monte_carlo
from sim.studies.papers.adaptive_fusion.tables import (
    add_true_error,
    descent_rows,
    drift_rows,
    nominal_rows,
    property_rows,
    table_1_rows,
)
from sim.studies.papers.page import Page


def reproduce(seeds: int, out: Path | None, progress: Progress) -> Page:
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
    page.table("The descent (section 5)", descent_rows())
    page.table("Without drift (Figs. 2-5)", nominal_rows(nominal))
    draw_descent(page)
    draw_nominal(page, examples[0])
    page.table(
        "Table 1: P of the adaptive filter under drift",
        table_1_rows(drift, literal),
        ("k: kPa", "k: iteration"),
    )
    page.table("Under drift (Figs. 6-10)", drift_rows(drift, examples[1]))
    draw_drift(page, examples[1])
    draw_rms(page, drift)
    add_true_error(page, drift)
    page.table("Properties that the text states", property_rows())
    return page
