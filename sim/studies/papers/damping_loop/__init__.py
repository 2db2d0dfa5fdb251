"""Paper K: Keighobadi, Nourmohammadi, Rafatnia, against
`companion.estimators.baro_inertial.damping_loop` and `baro_ins_kf`.

The paper drives a car with a MEMS IMU and barometer over mountain roads and shows figures without
numbers; apart from its formulas, the gains (10) and the schedule (8) nothing is printed that could
be computed again. Its claims are tried on `mountain_road`. Samples reach the estimators as a
vehicle sends them, and are stepped through by their own `run`. Gains are found on the GPS velocity
of one drive, and judged by the true velocity of the others.

What the print leaves open, and what is wrong in it
---------------------------------------------------
- (1) is negative above sea level for either sign of L.
- (5) derives sea-level temperature and pressure from the height that they are to correct: circular.
- The gains (10) have three digits: they are 31, 20 and 27 thirty-firsts, 5 bits on [0, 3], [0, 1],
  [0, 1]. The floor of (8) is 1 / 240, one over N_pop x N_bits as in its reference: 16 strings of 15
  bits.
- (11), (12), (15): see `companion.estimators.baro_inertial.baro_ins_kf`.
"""

from pathlib import Path

from sim.studies.page import generators
from sim.studies.papers import Progress
from sim.studies.papers.damping_loop import mountain_road as road
from sim.studies.papers.damping_loop.sections import (
    add_atmosphere,
    add_comparison,
    add_genetic,
    add_loop,
)
from sim.studies.papers.damping_loop.simulation import (
    RATIO_DRIVES,
    best_noise,
    printed_over_least,
    tune,
)
from sim.studies.papers.page import Page


def reproduce(seeds: int, out: Path | None, progress: Progress) -> Page:
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
    add_atmosphere(page, drives)
    add_loop(page, tuned.best)
    add_genetic(page, tuned, printed_over_least(drives[:RATIO_DRIVES]))
    progress(0.8, "estimators")
    add_comparison(page, drives, tuned.best, best_noise(tuned_on))
    return page
