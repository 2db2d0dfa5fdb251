"""The vertical bank held against its goals, beside every other estimator: `kollsman-sim
evaluate`.

`SECTIONS` is the table that the command line and the tests read. A section is one module in
`sections`, named after its key, with a function

    evaluate(context) -> SectionPage

that measures, and returns its page (`sim.studies.goals.section`): figures, tables, and the rows
that the goals are judged by. They are kept as JSON beside the page, so that the index can be made
from whatever sections have run. Adding a section is that module, a line in the table, and its goals
in `goals.py`.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from companion.jobs import Done
    from sim.studies.goals.section import SectionPage

Job = TypeVar("Job")
Result = TypeVar("Result")
Progress = Callable[[float, str], None]
"""Called with the fraction done (0..1) and what is being computed."""


@dataclass(frozen=True)
class Context:
    """The parameters of an evaluation."""

    seeds: int
    """number of Monte-Carlo runs"""
    workers: int
    """processes"""
    data: Path | None
    """folder of recorded flights; None leaves out what needs them"""
    out: Path
    """folder of the pages"""
    progress: Progress

    def recorded(self, names: Iterable[str]) -> dict[str, Path]:
        """Name -> log of those recorded flights that are anywhere below `data`."""
        if self.data is None:
            return {}
        found = {name: sorted(self.data.rglob(f"{name}.tlog")) for name in names}
        return {name: paths[0] for name, paths in found.items() if paths}

    def run(
        self,
        function: Callable[[Job], Result],
        jobs: Sequence[Job],
        weight: Callable[[Job], float] | None = None,
    ) -> "list[Done[Job, Result]]":
        """`function` of every job on a pool of processes (`sim.studies.runs`), with progress."""
        from companion.jobs import executor_of
        from sim.studies.runs import kept_parts, run

        def report(done: int, newest: object) -> None:
            self.progress(done / max(1, len(jobs)), f"{done} of {len(jobs)} jobs")

        with executor_of(self.workers) as executor:
            return run(function, jobs, executor, parts=kept_parts(), weight=weight, on_done=report)


@dataclass(frozen=True)
class Section:
    """One part of the evaluation."""

    key: str
    title: str
    seeds: int
    """default number of Monte-Carlo runs"""

    @property
    def module(self) -> str:
        """Imported only when the section is evaluated."""
        return f"sim.studies.goals.sections.{self.key}"

    def evaluate(self, context: Context) -> "SectionPage":
        """Measure, and return the page; its figures are written to the folder `context.out`."""
        page: SectionPage = import_module(self.module).evaluate(context)
        return page


_SECTIONS: tuple[Section, ...] = (
    Section("real", "Real flights", 8),
    Section("bound", "The papers' common scenarios and the Cramer-Rao bound", 200),
    Section("flights", "Simulated and recorded flights", 24),
    Section("faults", "Sensor faults", 2),
    Section("outages", "Outages of GNSS", 3),
    Section("states", "Each state over one flight", 2),
    Section("protection", "Protection level and false alarms", 1000),
)

SECTIONS: dict[str, Section] = {section.key: section for section in _SECTIONS}
"""The sections, by key."""
