"""The command ``kollsman-sim evaluate``; with `sim.cli` all of the simulator that prints."""

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from sim.studies.goals import SECTIONS, Context

EXAMPLES = """\b
Examples:
  kollsman-sim evaluate --data ~/flights --out docs/evaluation
  kollsman-sim evaluate bound --seeds 20
"""


def evaluate(
    sections: Annotated[
        list[str] | None,
        typer.Argument(
            help="Sections to evaluate. Default: all; the index is always written.",
            metavar="[SECTION]...",
        ),
    ] = None,
    *,
    seeds: Annotated[
        int | None,
        typer.Option(
            min=2, help="Number of Monte-Carlo runs. Default: each section's own.", metavar="N"
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Number of processes. Default: one for each core.", metavar="N"),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(
            help="Folder with recorded flights (jsbsim_A.tlog, ...) anywhere below it.",
            metavar="DIR",
            exists=True,
            file_okay=False,
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder of the pages.", metavar="DIR")] = Path(
        "out/evaluation"
    ),
) -> None:
    """Measure the vertical bank against its goals, beside every other estimator: one page for each
    section, and an index."""
    unknown = [key for key in sections or [] if key not in SECTIONS]
    if unknown:
        print(
            f"kollsman-sim: no section '{unknown[0]}'; there are {', '.join(SECTIONS)}",
            file=sys.stderr,
        )
        raise typer.Exit(2)
    _write(
        list(dict.fromkeys(sections or SECTIONS)), seeds, workers or os.cpu_count() or 1, data, out
    )


def _write(keys: list[str], seeds: int | None, workers: int, data: Path | None, out: Path) -> None:
    """Evaluate the sections, write their pages and the index, and print a line for each."""
    from rich.console import Console
    from rich.progress import Progress as ProgressBar
    from rich.progress import TaskID

    from sim.studies.goals.section import Index, summary

    console = Console(stderr=True)
    with ProgressBar(console=console, transient=True, disable=not console.is_terminal) as bar:
        for key in keys:
            task = bar.add_task(key, total=1.0)

            def report(fraction: float, what: str, task: TaskID = task, key: str = key) -> None:
                bar.update(task, completed=fraction, description=f"{key}: {what}")

            section = SECTIONS[key]
            page = section.evaluate(Context(seeds or section.seeds, workers, data, out, report))
            path = page.write()
            report(1.0, "done")
            print(f"{key}  {path}: {summary(page.rows)}")
    index = Index(out)
    print(f"index  {index.write()}: {summary(index.rows)}")
