"""What every estimator says of two small simulated flights, kept as text: a change of numbers shows
in a review.

The flights are the scenarios beside this file, flown by JSBSim with their own seeds; every
estimator runs over the same samples with its default settings. One CSV file a flight and estimator
has a row every five seconds. `python -m tests.golden --update` writes the files anew; commit them
with a message that says why the numbers moved.
"""

import math
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

from companion.estimators import ESTIMATORS, Method, run_log
from companion.evaluation.samples import samples_of
from companion.samples import Kind, SampleLog
from sim.flight import Flight
from sim.scenario import load_scenario

FOLDER = Path(__file__).parent
FLIGHTS = ("hop", "front")
PERIOD_S = 5.0
COLUMNS = {
    "altitude_amsl_m": 2,
    "climb_mps": 2,
    "altitude_sd_m": 2,
    "height_above_takeoff_m": 2,
    "baro_offset_m": 2,
    "protection_level_m": 1,
    "faulty": 0,
}
"""Field of an estimate -> decimals in the file."""


@cache
def samples(flight: str) -> SampleLog:
    """The samples of one flight, as the pipeline hands them to an estimator."""
    with tempfile.TemporaryDirectory(prefix="kollsman-golden-") as folder:
        tlog = Path(folder) / "flight.tlog"
        Flight(load_scenario(FOLDER / f"{flight}.yaml"), tlog=tlog).run()
        return samples_of(tlog)


def lines(method: Method, log: SampleLog) -> Iterator[str]:
    """The CSV lines of one estimator: its estimate after the first barometer sample of every
    period."""
    estimates, _, _ = run_log(method, log)
    order = log.tables.order
    baro = np.asarray(order["kind"]) == Kind.PRESSURE
    said = np.asarray(estimates)[baro]
    elapsed_s = (log[Kind.PRESSURE]["time_us"][order["row"][baro]] - log.first_us) * 1e-6
    yield ",".join(["elapsed_s", *COLUMNS])
    _, first = np.unique(np.floor(elapsed_s / PERIOD_S), return_index=True)
    for row in first:
        cells = (
            f"{float(said[name][row]):.{decimals}f}" if math.isfinite(said[name][row]) else ""
            for name, decimals in COLUMNS.items()
        )
        yield ",".join([f"{elapsed_s[row]:.1f}", *cells])


def path_of(flight: str, estimator: str) -> Path:
    """Where the lines of one estimator on one flight are kept."""
    return FOLDER / flight / f"{estimator}.csv"


def update() -> list[Path]:
    """Write all files anew, remove those of estimators that are gone; the files that changed."""
    changed = []
    for flight in FLIGHTS:
        folder = FOLDER / flight
        folder.mkdir(exist_ok=True)
        for name, method in ESTIMATORS.items():
            path, text = path_of(flight, name), "\n".join(lines(method, samples(flight))) + "\n"
            if not path.exists() or path.read_text(encoding="utf-8") != text:
                path.write_text(text, encoding="utf-8", newline="\n")
                changed.append(path)
        for path in folder.glob("*.csv"):
            if path.stem not in ESTIMATORS:
                path.unlink()
                changed.append(path)
    return changed
