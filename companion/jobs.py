"""Many independent jobs on one runner: a pool of processes by default, a Dask cluster by address.

A job is a frozen dataclass or a named tuple, and a function of one job returns its result. `run`
keeps the result of every finished job in a folder and takes it from there when the same job is run
again, so that a study or a batch that was stopped or killed continues. A job that raises has an
error in place of a result; the next run tries it again.
"""

import json
import logging
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any, Generic, TypeVar

from companion import whole_file
from companion.errors import ConfigError, KollsmanError
from companion.output import quiet

Row = dict[str, Any]
Job = TypeVar("Job")
Result = TypeVar("Result")
Function = Callable[[Job], Result]

KILLED = "a worker process was killed, and this job with it"
ATTEMPTS = 3
"""number of attempts for a job whose worker process was killed"""


@dataclass(frozen=True)
class Done(Generic[Job, Result]):
    """A job that was run: its result, or why it failed."""

    job: Job
    result: Result | None
    error: str | None = None


OnDone = Callable[[int, Done[Any, Any] | None], None]
"""Called with how many jobs are done and the newest one; None for those whose results were kept."""


@dataclass(frozen=True)
class Storage:
    """How a result is kept in a file."""

    suffix: str
    write: Callable[[Any], bytes]
    read: Callable[[bytes], Any]


JSON = Storage(".json", lambda result: json.dumps(result).encode(), json.loads)
"""storage of results that are dictionaries, lists, texts and numbers"""


def run(
    function: Function[Job, Result],
    jobs: Sequence[Job],
    executor: Executor,
    *,
    key: Callable[[Job], str],
    parts: Path | None = None,
    storage: Storage = JSON,
    weight: Callable[[Job], float] | None = None,
    on_done: OnDone | None = None,
) -> list[Done[Job, Result]]:
    """`function` of every job, in the order of `jobs`.

    Parameters
    ----------
    function : of a module's top level, so that a process can be sent there.
    key : a file name for a job that changes with everything its result depends on.
    parts : folder where results are kept; None keeps nothing.
    storage : how a result becomes a file of `parts`.
    weight : how long a job takes, in any unit: the longest start first, which keeps all workers
        busy.
    """
    keys = [key(job) for job in jobs]
    done: dict[str, Done[Job, Result]] = {}
    for each, job in zip(keys, jobs, strict=True):
        path = _path(parts, each, storage)
        if path is not None and path.exists():
            done[each] = Done(job, storage.read(path.read_bytes()))
    if on_done is not None:
        on_done(len(done), None)
    todo = {each: job for each, job in zip(keys, jobs, strict=True) if each not in done}
    ordered = sorted(todo, key=lambda each: -weight(todo[each]) if weight else 0.0)
    waiting = {executor.submit(quietly, function, todo[each]): each for each in ordered}
    for future in as_completed(waiting):
        name = waiting[future]
        done[name] = _outcome(future, todo[name])
        path = _path(parts, name, storage)
        if path is not None and done[name].error is None:
            _keep(path, storage.write(done[name].result))
        if on_done is not None:
            on_done(len(done), done[name])
    return [done[each] for each in keys]


def run_on(
    workers: int,
    scheduler: str | None,
    function: Function[Job, Result],
    jobs: Sequence[Job],
    **options: Any,
) -> list[Done[Job, Result]]:
    """`run` on `executor_of`; jobs whose worker process was killed are tried again, in a new pool.

    `options` go to `run`; it needs ``parts``, which tells what is done.
    """
    for attempt in range(ATTEMPTS):
        with executor_of(workers, scheduler) as executor:
            found = run(function, jobs, executor, **options)
        killed = sum(each.error == KILLED for each in found)
        if not killed or attempt == ATTEMPTS - 1:
            break
        logging.getLogger("kollsman.jobs").warning("%s: %d jobs are tried again", KILLED, killed)
    return found


def _path(parts: Path | None, key: str, storage: Storage) -> Path | None:
    return parts / f"{key}{storage.suffix}" if parts is not None else None


def _keep(path: Path, content: bytes) -> None:
    """Write the result of a job; the file appears whole or not at all. Raises `ConfigError`."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        whole_file.write(path, content)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from None


def results(done: Sequence[Done[Any, Result]]) -> list[Result]:
    """The results of the jobs that succeeded."""
    return [each.result for each in done if each.result is not None]


def _outcome(future: "Future[Result]", job: Job) -> Done[Job, Result]:
    try:
        return Done(job, future.result())
    except BrokenProcessPool:
        return Done(job, None, KILLED)
    except Exception as error:  # a job that fails is a result, whatever failed
        return Done(job, None, _told(error))


def _told(error: Exception) -> str:
    """One line; what is no error of the environment is an error of the code, and says so."""
    if isinstance(error, KollsmanError):
        return str(error)
    return f"failed, please report it: {type(error).__name__}: {error}"


def quietly(function: Function[Job, Result], job: Job) -> Result:
    """What the companion logs of one of many jobs is not news."""
    with quiet(logging.CRITICAL):
        return function(job)


@contextmanager
def executor_of(workers: int, scheduler: str | None = None) -> Iterator[Executor]:
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


def _start_worker() -> None:
    """A worker ends with its parent, which may be killed before it can say so."""
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
