"""Paper W: Whang, Ra 2008, against `companion.estimators.air_data_gnss`.

The simulation of section 3: air data every 0.2 s (5 m, 1.5 K), GPS every second (70 m), a lapse
rate that is drawn anew every ten seconds. Samples reach the estimator as a vehicle would send them:
each barometer height becomes the pressure at which the standard atmosphere has it, each temperature
a sample of AIR, and `run_log` steps through the rows.

What the print leaves open, and what is wrong in it
---------------------------------------------------
- Figure 2, the trajectory, is not described: here two climbs to 180 m and back in 300 s.
- What moves the true a and b is not said. Three readings: weather (`WEATHER`), random walks with
  the filter's own Q per second (`WALK_SECOND`), and per step of 0.2 s (`WALK_STEP`).
- "0.003 degC/km around -0.0065 degC/km" is K/m.
- Figure 3 shows curves, no numbers: what can be held against it are the sentences about it.
"""

from pathlib import Path

from sim.studies.papers import Progress
from sim.studies.papers.air_data_gnss.figures import draw_curves, draw_temperature
from sim.studies.papers.air_data_gnss.simulation import (
    READINGS,
    SPARSE,
    VehicleRows,
    monte_carlo,
    rarer,
)
from sim.studies.papers.air_data_gnss.tables import (
    add_live,
    add_remedies,
    claim_rows,
    equation_rows,
    error_rows,
)
from sim.studies.papers.page import Page


def reproduce(seeds: int, out: Path | None, progress: Progress) -> Page:
    """The page of paper W."""
    stream, found = VehicleRows(), {}
    for done, reading in enumerate(READINGS):
        progress(0.2 * done, reading)
        found[reading] = monte_carlo(reading, seeds, stream)
    progress(0.6, "sparse GPS")
    sparse = {name: rarer(VehicleRows(every), seeds) for name, every in SPARSE.items()}
    progress(0.8, "page")
    page = Page("W", seeds, out)
    page.text(
        "Barometer height and air temperature every 0.2 s (5 m, 1.5 K), GPS height every second "
        "(70 m), a lapse rate that changes by 3 K/km every ten seconds, two climbs to 180 m in "
        "five minutes. The paper draws its trajectory but does not say what moves the air, so "
        "there are three readings: weather (a ground temperature 5-15 K off, 1-3 hPa an hour, a "
        "start within 0.5 hPa), and random walks of a and b with the filter's Q taken per second "
        "or per step. Root mean squares count from one minute on; samples go through the loop "
        "that replays logs."
    )
    page.table("The equations as printed", equation_rows())
    draw_temperature(page)
    page.table("Figure 3: what the errors come to", error_rows(found), READINGS)
    draw_curves(page, found)
    page.table("The claims", claim_rows(found, sparse))
    add_remedies(page, found, sparse)
    add_live(page)
    return page
