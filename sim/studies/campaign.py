"""Campaigns: scenario x seed x estimator, on a pool of processes or a Dask cluster through one
executor interface.

A job is one flight: flown to a temporary log, read back as live samples are, and run through every
estimator. The rows of a job are a file of their own under ``parts/`` (`sim.studies.runs`), so that
a campaign that was killed continues where it stopped; a flight that fails is a row that says why.
"""

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from companion.errors import ConfigError
from companion.evaluation.compare import SETTLE_S, Comparison, compare_log
from companion.evaluation.samples import samples_of
from companion.jobs import Done, Row
from companion.settings import CompanionSettings
from companion.whole_file import replacing
from sim.flight import Summary
from sim.scenario import Scenario, load_scenario
from sim.studies import runs
from sim.studies.expectations import missed
from sim.studies.fault_windows import attribution, fault_windows
from sim.studies.runs import flown

MEASURES = (
    "rmse_m", "p95_m", "max_m", "bias_m", "takeoff_rmse_m", "climb_rmse_mps", "nees", "coverage_2",
    "median_sd_m", "median_level_m", "detection_s", "wrong_share", "cost_us",
)  # fmt: skip
"""values of a row that the summary averages over the seeds; of the maximum it has the worst"""
COUNTS = ("faults", "detected", "false_alarms", "exceedances")
"""counts of a row that the summary adds up"""


@dataclass(frozen=True)
class Job:
    """One flight of a campaign. It carries its scenario, since a worker may be another computer."""

    scenario: Scenario
    seed: int
    estimators: tuple[str, ...]
    settings: CompanionSettings = field(default_factory=CompanionSettings)

    @property
    def label(self) -> str:
        """Beginning of the name of the file with its rows."""
        return f"{self.scenario.name}-{self.seed}"


class Flown(NamedTuple):
    """One flight, the results of every estimator, and the missed demands of the scenario."""

    summary: Summary
    found: Comparison
    missed: list[str]


def fly(job: Job) -> Flown:
    """Fly to a temporary log, run the estimators over it, and judge what would be published."""
    with flown(job.scenario, job.seed) as (tlog, summary):
        log = samples_of(tlog, job.settings)
    found = compare_log(log, job.settings, SETTLE_S, estimators=job.estimators)
    return Flown(summary, found, missed(job.scenario, log, job.settings))


def run_job(job: Job) -> list[Row]:
    """Fly and judge; the rows of the estimators, the autopilot's own result and the raw sensors."""
    started_s = time.perf_counter()
    summary, found, misses = fly(job)
    harmed = fault_windows(job.scenario.faults, summary.duration_s)
    tail = {
        "flight_s": summary.duration_s,
        "elapsed_s": time.perf_counter() - started_s,
        "missed": "; ".join(misses),
        "error": None,
    }
    return [
        _head(job) | {"source": result.pop("label")} | result | attribution(harmed, series) | tail
        for result, series in zip(found.as_dict()["results"], found.series, strict=True)
    ]


def _head(job: Job) -> Row:
    return {"scenario": job.scenario.name, "seed": job.seed}


def run(
    jobs: Sequence[Job],
    executor: Executor,
    out: Path,
    on_progress: Callable[[int, list[Row]], None] | None = None,
) -> list[Row]:
    """Run what has no result yet, writing each result as it comes; all rows, in the order of
    `jobs`. A flight that failed is one row with an ``error``.

    `on_progress` is called with how many jobs are done and the rows of the newest (none for those
    found done).
    """

    def report(count: int, newest: Done[Job, list[Row]] | None) -> None:
        if on_progress is not None:
            on_progress(count, [] if newest is None else _rows(newest))

    parts = out / "parts"
    parts.mkdir(parents=True, exist_ok=True)
    done = runs.run(
        run_job,
        jobs,
        executor,
        parts=parts,
        weight=lambda job: job.scenario.planned_s,
        on_done=report,
    )
    rows = [row for each in done for row in _rows(each)]
    write(rows, out / "campaign.parquet")
    return rows


def _rows(done: Done[Job, list[Row]]) -> list[Row]:
    if done.result is not None:
        return done.result
    return [_head(done.job) | {"source": None, "elapsed_s": 0.0, "error": done.error}]


def jobs_of(
    scenarios: Sequence[str],
    seeds: int,
    estimators: Sequence[str],
    settings: CompanionSettings | None = None,
) -> list[Job]:
    """Seeds 1 to `seeds` of every scenario (names or paths)."""
    settings = settings or CompanionSettings()
    return [
        Job(load_scenario(name), seed, tuple(estimators), settings)
        for name in scenarios
        for seed in range(1, seeds + 1)
    ]


def summary(rows: Sequence[Row]) -> list[Row]:
    """For each scenario and source the mean of every measure over its seeds, the worst maximum, and
    how many flew.

    Means leave out what is unknown, such as the detection time of a fault that was missed.
    """
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row["error"] is None:
            groups.setdefault((row["scenario"], row["source"]), []).append(row)
    lines = []
    for (scenario, source), members in groups.items():
        line: Row = {"scenario": scenario, "source": source, "flights": len(members)}
        for name in MEASURES:
            values = np.array(
                [math.nan if row.get(name) is None else row[name] for row in members], np.float64
            )
            values = values[np.isfinite(values)]
            choose = np.max if name == "max_m" else np.mean
            line[name] = float(choose(values)) if values.size else math.nan
            if name == "rmse_m":
                line["rmse_sd_m"] = float(np.std(values, ddof=1)) if values.size > 1 else math.nan
        for name in COUNTS:
            line[name] = sum(row.get(name) or 0 for row in members)
        line["missed"] = sum(bool(row.get("missed")) for row in members)
        lines.append(line)
    return lines


def write(rows: Sequence[Row], path: Path) -> None:
    """Rows to Parquet; the file appears whole or not at all."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = list(dict.fromkeys(name for row in rows for name in row))
    table = pa.Table.from_pylist([{name: row.get(name) for name in names} for row in rows])
    with replacing(path) as partial:
        pq.write_table(table, partial)


def read(path: Path) -> list[Row]:
    """The rows of a Parquet file."""
    import pyarrow.parquet as pq

    rows: list[Row] = pq.read_table(path).to_pylist()
    return rows


def require_parquet() -> None:
    """Raise `ConfigError` where Parquet cannot be written."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        raise ConfigError("campaigns need pyarrow: pip install 'kollsman[sim,fleet]'") from None


def failures(rows: Sequence[Row]) -> list[str]:
    """One line for each flight that failed."""
    return [
        f"{row['scenario']} seed {row['seed']}: {row['error']}"
        for row in rows
        if row["error"] is not None
    ]
