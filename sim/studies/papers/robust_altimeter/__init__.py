"""Paper C: Mañero Contreras, Hajiyev 2019, against `companion.estimators.robust_altimeter.steps`.

The simulation of section 4 is `altimeter_errors`. Whole samples (specific force, pressure, fix)
through the estimator's `run` give the same errors: see the last table of the page.

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

from pathlib import Path

from sim.studies.page import generators
from sim.studies.papers import Progress
from sim.studies.papers.page import Page
from sim.studies.papers.robust_altimeter.altimeter_errors import noises, simulate
from sim.studies.papers.robust_altimeter.faults import LONG, add_lock_out, add_sweep
from sim.studies.papers.robust_altimeter.figures import draw_scenarios
from sim.studies.papers.robust_altimeter.live import LIVE_SEEDS, add_live
from sim.studies.papers.robust_altimeter.models import COLUMNS, MEANS, MODELS, SCENARIOS, Outcome
from sim.studies.papers.robust_altimeter.tables import (
    claim_rows,
    deviation_rows,
    mean_rows,
    property_rows,
)


def reproduce(seeds: int, out: Path | None, progress: Progress) -> Page:
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
        page.table(title, mean_rows(results, printed), COLUMNS)
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
        deviation_rows(outcome),
        ("standard error of the mean",),
    )
    for index, name in ((-1, "two INS"), (2, "one INS")):
        page.table(f"What the text concludes ({name})", claim_rows(outcome, index))
    progress(0.5, "robust against optimal")
    add_sweep(page, draws)
    progress(0.8, "lock-out")
    add_lock_out(page, noises(generators("C", min(seeds, 30)), LONG))
    page.table("Properties of the filters", property_rows(outcome, draws))
    progress(0.9, "whole samples")
    add_live(page, outcome, draws[:LIVE_SEEDS])
    draw_scenarios(page, outcome, -1, "scenarios", "fitted, optimal")
    draw_scenarios(page, outcome, 1, "robust", "Table 1, robust")
    return page
