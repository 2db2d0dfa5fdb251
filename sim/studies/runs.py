"""What every study shares: the keys of its jobs, its cache, and the one way to fly a scenario to a
log."""

import hashlib
import json
import pickle
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

import companion
import companion.jobs
import sim
from companion.jit import cache_directory, source_hash
from companion.jobs import Done, OnDone
from sim.flight import Flight, Summary
from sim.scenario import Scenario

Job = TypeVar("Job")
Result = TypeVar("Result")

KEPT_S = 14 * 86_400.0
PICKLE = companion.jobs.Storage(".pickle", pickle.dumps, pickle.loads)


def run(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    executor: Executor,
    *,
    parts: Path | None = None,
    weight: Callable[[Job], float] | None = None,
    on_done: OnDone | None = None,
) -> list[Done[Job, Result]]:
    """`companion.jobs.run` for jobs of the simulator: results may be any objects, and depend on
    the code of both programs (`key_of`)."""
    return companion.jobs.run(
        function,
        jobs,
        executor,
        key=partial(key_of, function),
        parts=parts,
        storage=PICKLE,
        weight=weight,
        on_done=on_done,
    )


def kept_parts() -> Path:
    """The folder in the user's cache for results of studies that have no folder of their own.
    Results older than `KEPT_S` are removed."""
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
    """A job, or a part of one, as JSON values; a file is represented by a hash of its content."""
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
    """Hash of both programs and of everything that the compiled parts depend on."""
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
