"""Jobs of a section on a pool of processes, with progress."""

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from typing import TypeVar

from sim.studies.campaign import executor_of
from sim.studies.goals import Context

Job = TypeVar("Job")
Result = TypeVar("Result")


def run_jobs(
    function: Callable[[Job], Result], jobs: Sequence[Job], context: Context
) -> list[Result]:
    """`function` of every job, in the order of `jobs`. What is raised in a worker is raised here."""
    results: dict[int, Result] = {}
    with executor_of(context.workers, None) as executor:
        waiting = {
            executor.submit(_quietly, function, job): number for number, job in enumerate(jobs)
        }
        for done in as_completed(waiting):
            results[waiting[done]] = done.result()
            context.progress(len(results) / len(jobs), f"{len(results)} of {len(jobs)} jobs")
    return [results[number] for number in range(len(jobs))]


def _quietly(function: Callable[[Job], Result], job: Job) -> Result:
    """Faults are injected on purpose: what the companion would log of them is not news."""
    logging.getLogger("kollsman").setLevel(logging.CRITICAL)
    return function(job)
