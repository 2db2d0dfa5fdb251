"""Section ``outages``: the spread of every estimator while there is no GNSS, in all weather."""

from collections.abc import Sequence
from itertools import product

import numpy as np

from companion.estimators import ESTIMATORS
from companion.jobs import Row, results
from sim.studies.goals import Context
from sim.studies.goals.goals import Measured
from sim.studies.goals.outage_flights import LENGTHS_S, Recorded, Simulated, fly
from sim.studies.goals.section import SectionPage
from sim.studies.page import Value
from sim.studies.real import found, source_of
from sim.studies.real.matrix import WRONG_M, group

SCENARIOS = (
    "weather-front", "warm-front-cruise", "cold-front-descent", "low-level-qnh-drift",
    "hour-long-cruise", "inversion-approach", "mountain-wave", "static-port-error",
    "real-light-aircraft", "real-small-uav",
)  # fmt: skip
BEYOND = ("weather-change", "metar-day", "airliner-front")
"""scenarios whose pressure changes faster than in any hour of a year: shown, not judged"""
IMU_HZ = (0, 50)
RETURN_S = 5.0


def evaluate(context: Context) -> SectionPage:
    """Fly on a process pool, then fill the page."""
    seeds = range(1, context.seeds + 1)
    jobs: list[Simulated | Recorded] = [
        Simulated(name, seed) for name, seed in product((*SCENARIOS, *BEYOND), seeds)
    ]
    for path in found(context.data) if context.data is not None else []:
        source = source_of(path)
        if source is not None and not source.own_gnss:
            jobs += [Recorded(path, imu_hz, seed) for imu_hz, seed in product(IMU_HZ, seeds)]
    done = context.run(fly, jobs)
    rows = [row for found_rows in results(done) for row in found_rows]
    page = SectionPage("outages", context)
    page.measured(*_goals([row for row in rows if row["flight"] not in BEYOND]))
    page.text(_ABOUT)
    _tables(page, rows)
    page.failures(done)
    return page


def mean_nees(rows: Sequence[Row]) -> float:
    """Mean over the outages of the mean of (error / spread)^2 in each."""
    return float(np.mean([row["nees"] for row in rows])) if rows else float("nan")


def _goals(rows: Sequence[Row]) -> list[Measured]:
    measured = []
    for name in ESTIMATORS:
        own = [row for row in rows if row["estimator"] == name]
        for length_s in LENGTHS_S:
            each = [row for row in own if row["length_s"] == length_s]
            what, note = f"{name}, {length_s:g} s", f"{len(each)} outages"
            measured.append(Measured("outages-nees", what, mean_nees(each), 1.5, note=note))
        if not own:
            continue
        worst = max(own, key=lambda row: float(row["sent_max_m"]))
        late = sum(row["first_sent_s"] > RETURN_S for row in own)
        measured += [
            Measured(
                "outages-sent", name, worst["sent_max_m"], WRONG_M, unit="m", note=worst["flight"]
            ),
            Measured("outages-return", name, late, 0.0, note=f"of {len(own)} later"),
        ]
    return measured


def _tables(page: SectionPage, rows: Sequence[Row]) -> None:
    for length_s in LENGTHS_S:
        of_length = [row for row in rows if row["length_s"] == length_s]
        lines: list[list[Value]] = []
        for (flight,), each in group(of_length, "flight").items():
            by_name = {name: own for (name,), own in group(each, "estimator").items()}
            lines.append([flight, *(_cell(by_name[name]) for name in ESTIMATORS)])
        page.grid(
            f"{length_s:g} s without GNSS: NEES, share sent %, largest error sent m",
            ["flight", *ESTIMATORS],
            lines,
        )


def _cell(rows: Sequence[Row]) -> str:
    share = 100.0 * float(np.mean([row["sent_share"] for row in rows]))
    largest = max(float(row["sent_max_m"]) for row in rows)
    return f"{mean_nees(rows):.2f}, {share:.0f}, {largest:.0f}"


_ABOUT = f"""Each flight has outages of 60, 300 and 600 s, as many as fit, with four minutes of
contact before each. Every estimator runs over it with the independent check and the rules of
health. The weather of {", ".join(BEYOND)} changes faster than in any hour of a year of METARs
(31 m/h); these flights are shown, and not judged."""
