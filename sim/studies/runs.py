"""Jobs of every study on one runner, and the one way to fly a scenario to a log.

A job is a frozen dataclass or a named tuple; a function of one job returns its result. `run`
computes results on a pool of processes or a Dask cluster, keeps those of finished jobs in a folder,
and takes them from there when the same job is run again, so that a study that was stopped
continues. A job that fails has an error in place of a result; it is tried again by the next run.
"""

import hashlib
import json
import logging
import pickle
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import BaseModel

import companion
import sim
from companion.jit import cache_directory, source_hash
from sim.flight import Flight, Summary
from sim.scenario import Scenario

Row = dict[str, Any]
Job = TypeVar("Job")
Result = TypeVar("Result")

KEPT_S = 14 * 86_400.0


@dataclass(frozen=True)
class Done(Generic[Job, Result]):
    """A job that was run: its result, or why it failed."""

    job: Job
    result: Result | None
    error: str | None = None


OnDone = Callable[[int, Done[Any, Any] | None], None]
"""Called with how many jobs are done and the newest one; None for those whose results were kept."""


def run(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    executor: Executor,
    *,
    parts: Path | None = None,
    weight: Callable[[Job], float] | None = None,
    on_done: OnDone | None = None,
) -> list[Done[Job, Result]]:
    """`function` of every job, in the order of `jobs`.

    Parameters
    ----------
    function
        of a module's top level, so that a process can be sent there
    parts
        folder where results are kept; None keeps nothing
    weight
        how long a job takes, in any unit: the longest start first, which keeps all workers busy
    """
    keys = [key_of(function, job) for job in jobs]
    done: dict[str, Done[Job, Result]] = {}
    todo: dict[str, Job] = {}
    for key, job in zip(keys, jobs, strict=True):
        path = parts / f"{key}.pickle" if parts is not None else None
        if path is not None and path.exists():
            done[key] = Done(job, pickle.loads(path.read_bytes()))
        else:
            todo[key] = job
    if on_done is not None:
        on_done(len(done), None)
    ordered = sorted(todo, key=lambda key: -weight(todo[key]) if weight else 0.0)
    waiting = {executor.submit(_quietly, function, todo[key]): key for key in ordered}
    for future in as_completed(waiting):
        key = waiting[future]
        done[key] = _outcome(future, todo[key])
        if done[key].error is None and parts is not None:
            _keep(parts / f"{key}.pickle", done[key].result)
        if on_done is not None:
            on_done(len(done), done[key])
    return [done[key] for key in keys]


def results(done: Sequence[Done[Any, Result]]) -> list[Result]:
    """The results of the jobs that succeeded."""
    return [each.result for each in done if each.result is not None]


def _keep(path: Path, result: Any) -> None:
    """Write a result; the file appears whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    partial.write_bytes(pickle.dumps(result))
    partial.replace(path)


def _outcome(future: "Future[Result]", job: Job) -> Done[Job, Result]:
    try:
        return Done(job, future.result())
    except BrokenProcessPool:
        return Done(job, None, "a worker process was killed, and this job with it")
    except Exception as error:  # a job that fails is a result, whatever failed
        return Done(job, None, f"{error}" or type(error).__name__)


def _quietly(function: Callable[[Job], Result], job: Job) -> Result:
    """Faults are injected on purpose: what the companion logs of them is not news."""
    logging.getLogger("kollsman").setLevel(logging.CRITICAL)
    return function(job)


def kept_parts() -> Path:
    """Where a study that has no folder of its own keeps its results: in the user's cache. Those
    that are older than `KEPT_S` are removed."""
    folder = cache_directory() / "studies"
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder.iterdir():
        with suppress(OSError):  # another study may remove it too
            if time.time() - path.stat().st_mtime > KEPT_S:
                path.unlink()
    return folder


# Keys


def key_of(function: Callable[[Job], Any], job: Job) -> str:
    """The name of a job's result: it changes with everything that the result depends on."""
    content = json.dumps([plain(job), _code_hash(), version("jsbsim")], sort_keys=True)
    return f"{_name(function, job)}-{hashlib.sha256(content.encode()).hexdigest()[:16]}"


def _name(function: Callable[[Job], Any], job: Job) -> str:
    named = getattr(job, "label", None)
    return named if isinstance(named, str) and named else getattr(function, "__name__", "job")


def plain(value: Any) -> Any:
    """A job, or a part of one, as JSON has it; of a file what it holds counts, not its name."""
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if is_dataclass(value) and not isinstance(value, type):
        return {each.name: plain(getattr(value, each.name)) for each in fields(value)}
    if isinstance(value, (list, tuple)):
        return [plain(each) for each in value]
    if isinstance(value, dict):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, Path):
        return _file_hash(value) if value.is_file() else str(value)
    return value if isinstance(value, (str, int, float, bool, type(None))) else repr(value)


@cache
def _file_hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@cache
def _code_hash() -> str:
    """Of both programs and of what the compiled parts depend on."""
    digest = hashlib.sha256(source_hash().encode())
    for package in (companion, sim):
        root = Path(str(package.__file__)).parent
        for path in sorted(root.rglob("*.py")):
            digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return digest.hexdigest()


# Flights


@contextmanager
def flown(
    scenario: Scenario, seed: int | None = None, **options: Any
) -> Iterator[tuple[Path, Summary]]:
    """Fly a scenario to a temporary log; yields its path, valid inside the ``with``, and the
    summary.

    `options` go to `sim.flight.Flight`. Raises `SimulationError`.
    """
    with tempfile.TemporaryDirectory(prefix="kollsman-flight-") as folder:
        tlog = Path(folder) / "flight.tlog"
        yield tlog, Flight(scenario, tlog=tlog, seed=seed, **options).run()
