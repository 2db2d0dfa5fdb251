"""Campaigns: scenario x seed x estimator, on a pool of processes or a Dask cluster through one
executor interface.

A job is one flight: flown to a temporary log, read back as live samples are, and run through every
estimator. The rows of a job are a Parquet file of their own under ``parts/``, so that a campaign
that was killed goes on where it stopped; a flight that fails is a row that says why.
"""

import hashlib
import json
import logging
import math
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any

import numpy as np

from companion.errors import ConfigError
from companion.evaluation.compare import SETTLE_S, Comparison, compare
from companion.jit import source_hash
from companion.settings import CompanionSettings
from sim.flight import Flight, Summary
from sim.scenario import Scenario, load_scenario
from sim.studies.fault_windows import attribution, fault_windows

Row = dict[str, Any]
MEASURES = (
    "rmse_m", "p95_m", "max_m", "bias_m", "takeoff_rmse_m", "climb_rmse_mps", "nees", "coverage_2", "median_sd_m",
    "median_level_m", "detection_s", "wrong_share", "cost_us",
)  # fmt: skip
"""of a row; their means over the seeds are the summary's, but for the worst maximum"""
COUNTS = ("faults", "detected", "false_alarms", "exceedances")
"""of a row; the summary has their sums"""


@dataclass(frozen=True)
class Job:
    """One flight of a campaign. It carries its scenario, since a worker may be another computer."""

    scenario: Scenario
    seed: int
    estimators: tuple[str, ...]
    settings: CompanionSettings = field(default_factory=CompanionSettings)

    @property
    def key(self) -> str:
        """Changes with everything that the rows depend on."""
        content = [
            self.scenario.model_dump(mode="json"),
            self.seed,
            self.estimators,
            self.settings.model_dump(mode="json"),
            _code_hash(),
            version("jsbsim"),
        ]
        digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]
        return f"{self.scenario.name}-{self.seed}-{digest}"


@cache
def _code_hash() -> str:
    """Of both programs and of what the compiled parts depend on."""
    digest = hashlib.sha256(source_hash().encode())
    root = Path(__file__).parent.parent
    for path in sorted([*(root / "companion").rglob("*.py"), *(root / "sim").rglob("*.py")]):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def fly(job: Job) -> tuple[Summary, Comparison]:
    """Fly to a temporary log, and run the estimators over it."""
    with tempfile.TemporaryDirectory(prefix="kollsman-campaign-") as folder:
        tlog = Path(folder) / "flight.tlog"
        summary = Flight(job.scenario, tlog=tlog, seed=job.seed).run()
        return summary, compare(tlog, job.settings, SETTLE_S, estimators=job.estimators)


def run_job(job: Job) -> list[Row]:
    """Fly and judge; the rows of the estimators, the autopilot's own result and the raw sensors.
    Never raises."""
    started_s = time.perf_counter()
    head: Row = {"scenario": job.scenario.name, "seed": job.seed}
    try:
        summary, found = fly(job)
        harmed = fault_windows(job.scenario.faults, summary.duration_s)
        tail = {
            "flight_s": summary.duration_s,
            "elapsed_s": time.perf_counter() - started_s,
            "error": None,
        }
        return [
            head | {"source": result.pop("label")} | result | attribution(harmed, series) | tail
            for result, series in zip(found.as_dict()["results"], found.series, strict=True)
        ]
    except Exception as error:  # a failed flight is a row, whatever failed
        return [
            head
            | {"source": None, "elapsed_s": time.perf_counter() - started_s, "error": f"{error}"}
        ]


def run(
    jobs: Sequence[Job],
    executor: Executor,
    out: Path,
    on_progress: Callable[[int, list[Row]], None] | None = None,
) -> list[Row]:
    """Run what has no result yet, writing each result as it comes; all rows, in the order of
    `jobs`.

    `on_progress` is called with how many jobs are done and the rows of the newest (none for those
    found done).
    """
    parts = out / "parts"
    parts.mkdir(parents=True, exist_ok=True)
    keys = [job.key for job in jobs]
    done = {
        key: read(parts / f"{key}.parquet") for key in keys if (parts / f"{key}.parquet").exists()
    }
    if on_progress is not None:
        on_progress(len(done), [])
    todo = [(job, key) for job, key in zip(jobs, keys, strict=True) if key not in done]
    todo.sort(
        key=lambda each: -each[0].scenario.planned_s
    )  # a long flight begun last would leave the others idle
    waiting = {executor.submit(run_job, job): (job, key) for job, key in todo}
    for future in as_completed(waiting):
        job, key = waiting[future]
        rows = _rows_of(future, job)
        if all(row["error"] is None for row in rows):  # a failure is tried again by the next run
            write(rows, parts / f"{key}.parquet")
        done[key] = rows
        if on_progress is not None:
            on_progress(len(done), rows)
    rows = [row for key in keys for row in done[key]]
    write(rows, out / "campaign.parquet")
    return rows


def _rows_of(future: "Future[list[Row]]", job: Job) -> list[Row]:
    try:
        return future.result()
    except BrokenProcessPool:
        why = "a worker process was killed, and this flight with it"
        return [
            {
                "scenario": job.scenario.name,
                "seed": job.seed,
                "source": None,
                "elapsed_s": 0.0,
                "error": why,
            }
        ]


def _start_worker() -> None:
    """What a flight's companion warns of is in the results; many at once are noise.

    A worker ends with its parent, which may be killed before it can say so.
    """
    logging.getLogger("kollsman").setLevel(logging.ERROR)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def executor_of(workers: int, scheduler: str | None) -> Iterator[Executor]:
    """A pool of `workers` processes, or the Dask cluster whose scheduler is at an address such as
    tcp://host:8786.

    Raises `ConfigError` when Dask is not installed or the scheduler does not answer.
    """
    if scheduler is None:
        with ProcessPoolExecutor(
            workers, mp_context=get_context("spawn"), initializer=_start_worker
        ) as pool:
            try:
                yield pool
            except BaseException:  # Ctrl-C must not wait for all that was submitted
                pool.shutdown(wait=False, cancel_futures=True)
                raise
        return
    try:
        from distributed import Client
    except ImportError:
        raise ConfigError("--scheduler needs Dask: pip install 'kollsman[fleet]'") from None
    try:
        client = Client(scheduler, timeout=10, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise ConfigError(f"no Dask scheduler answers at {scheduler}: {error}") from None
    with client:
        yield client.get_executor()


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
        lines.append(line)
    return lines


def write(rows: Sequence[Row], path: Path) -> None:
    """Rows to Parquet; the file appears whole or not at all."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = list(dict.fromkeys(name for row in rows for name in row))
    table = pa.Table.from_pylist([{name: row.get(name) for name in names} for row in rows])
    partial = path.with_suffix(".partial")
    pq.write_table(table, partial)
    partial.replace(path)


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
