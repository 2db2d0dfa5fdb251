"""The command ``kollsman-sim reproduce``; like `sim.cli`, it prints."""

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sim.studies.papers import PAPERS, Paper

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

EXAMPLES = """\b
Examples:
  kollsman-sim reproduce
  kollsman-sim reproduce H W --check-root 1 --check-root 2
  kollsman-sim reproduce K --seed-root 7 --seeds 20
"""


def reproduce(
    papers: Annotated[
        list[str] | None,
        typer.Argument(help="Key letters: H W C R K. Default: all.", metavar="[KEY]..."),
    ] = None,
    *,
    seeds: Annotated[
        int | None,
        typer.Option(
            min=2,
            help="Number of Monte-Carlo runs of each paper. Default: each paper's own.",
            metavar="N",
        ),
    ] = None,
    seed_root: Annotated[
        int,
        typer.Option(
            min=0, help="Root of all seeds; another root draws other random numbers.", metavar="N"
        ),
    ] = 0,
    check_root: Annotated[
        list[int] | None,
        typer.Option(
            min=0,
            help="Repeat with this seed root too, and say which verdicts it changes (repeatable).",
            metavar="N",
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option(help="Folder of the pages and figures.", metavar="DIR")
    ] = Path("out/papers"),
) -> None:
    """Repeat the simulations of the five papers and compare the estimators with the printed
    results."""
    from sim.studies.page import SEED_ROOT

    SEED_ROOT.set(seed_root)
    roots = list(dict.fromkeys(check_root or []))
    if seed_root in roots:
        raise _wrong_usage(
            f"--check-root {seed_root} is the page's own seed root: give another number"
        )
    keys = list(dict.fromkeys(key.upper() for key in papers or PAPERS))
    unknown = [key for key in keys if key not in PAPERS]
    if unknown:
        raise _wrong_usage(f"paper '{unknown[0]}' is unknown: give one of {', '.join(PAPERS)}")
    _write_pages([PAPERS[key] for key in keys], seeds, roots, out)


def _write_pages(papers: list[Paper], seeds: int | None, roots: list[int], out: Path) -> None:
    """Reproduce papers with a progress bar, and print a line for each page."""
    from rich.console import Console
    from rich.progress import Progress as ProgressBar

    from sim.studies.papers.luck import draw_again
    from sim.studies.papers.page import summary

    console = Console(stderr=True)
    with ProgressBar(console=console, transient=True, disable=not console.is_terminal) as bar:
        for paper in papers:
            task = bar.add_task(paper.slug, total=1.0)
            report = partial(_report_share, bar, task, paper.slug)
            page = paper.reproduce(seeds or paper.seeds, out, report)
            draw_again(paper, page, roots, report)
            path = page.write()
            report(1.0, "done")
            luck = f"; {len(page.lucky)} depend on luck" if roots else ""
            print(f"{paper.key}  {path}  {page.seeds} seeds: {summary(page.counts)}{luck}")


def _report_share(bar: "Bar", task: "TaskID", name: str, fraction: float, what: str) -> None:
    bar.update(task, completed=fraction, description=f"{name}: {what}")


def _wrong_usage(message: str) -> typer.Exit:
    """Print one line that says what is wrong with the command line; the exception exits with 2."""
    print(f"kollsman-sim: {message}", file=sys.stderr)
    return typer.Exit(2)
