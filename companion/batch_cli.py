"""The command for a folder of logs: batch. Part of the command ``kollsman``."""

import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from companion.common_cli import (
    ConfigOption,
    EstimatorOption,
    SetOption,
    compile_first,
    resolve_settings,
)
from companion.errors import LogFormatError
from companion.log_cli import SettleOption

BATCH_EXAMPLES = """\b
Examples:
  kollsman batch logs/ --out fleet
  kollsman batch 'logs/**/*.BIN' --out fleet --workers 4
  kollsman batch logs/ --out fleet --scheduler tcp://127.0.0.1:8786
"""
PlacesArgument = Annotated[
    list[str], typer.Argument(help="Folders, logs or quoted patterns.", metavar="DIR_OR_GLOB...")
]
FolderOption = Annotated[Path, typer.Option(help="Folder for the results.", metavar="DIR")]
WorkersOption = Annotated[
    int | None,
    typer.Option(min=1, help="Number of processes. Default: one for each core.", metavar="N"),
]
SchedulerOption = Annotated[
    str | None,
    typer.Option(help="Run on the Dask cluster at this address.", metavar="tcp://HOST:PORT"),
]
TopOption = Annotated[
    int, typer.Option(min=1, help="Sessions to print, the worst first.", metavar="N")
]


def batch(
    places: PlacesArgument,
    *,
    out: FolderOption,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    estimator: EstimatorOption = None,
    config: ConfigOption = None,
    changes: SetOption = None,
    settle: SettleOption = 60.0,
    top: TopOption = 20,
) -> None:
    """Replay a folder of logs: which altitudes were wrong, and why. A stopped batch continues."""
    settings = resolve_settings(config, estimator, changes)
    compile_first(settings, settings.estimator)

    from companion.replay.batch import BatchFailedError, find_logs, other_files, run_batch
    from companion.warmup import warm_up

    logs, others = find_logs(places), other_files(places)
    if scheduler is None:
        warm_up(settings)  # once, instead of in every worker
    failure: BatchFailedError | None = None
    with _counting(len(logs)) as on_done:
        try:
            table = run_batch(
                logs,
                out,
                settings,
                settle_s=settle,
                workers=min(workers or os.cpu_count() or 1, len(logs)),
                scheduler=scheduler,
                on_done=on_done,
            )
        except BatchFailedError as error:
            table, failure = error.table, error
    _show_fleet(table, top)
    if others:
        named = ", ".join(f"{suffix} {count}" for suffix, count in sorted(others.items()))
        print(f"{others.total()} other files are no logs by their names: {named}")
    print(f"wrote {out}/fleet.csv, fleet.parquet, fleet.json and rows/")
    if (out / "index.html").exists():
        print(f"wrote {out}/index.html: a report of each flight")
    if failure is not None:
        raise failure
    if all(row["error"] is not None for row in table):
        raise LogFormatError("no log could be read; the reasons are in fleet.csv")


@contextmanager
def _counting(total: int) -> "Iterator[Callable[..., None]]":
    """Progress of a batch, with rate and time left: a bar on a terminal, else a line a minute."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as Remaining

    console, started_s = Console(stderr=True), time.monotonic()
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"), Remaining())
    said_s, first = started_s, 0
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as progress:
        task = progress.add_task("", total=total)

        def advance(count: int, newest: Any) -> None:
            nonlocal said_s, first
            now_s = time.monotonic()
            if newest is None:
                first = count
            rate = (count - first) / max(1e-3, now_s - started_s)
            progress.update(task, completed=count, description=f"{rate * 60:.0f} logs/min")
            if not console.is_terminal and (now_s - said_s >= 60.0 or count == total):
                said_s = now_s
                left = (total - count) / rate if rate > 0 else 0.0
                say = f"{count} of {total} logs, {rate * 60:.2g} a minute, {left:.0f} s left"
                print(say, file=sys.stderr, flush=True)

        try:
            yield advance
        except KeyboardInterrupt:
            print("kollsman: stopped; the same command goes on with what is left", file=sys.stderr)
            raise


def _sizes(row: "dict[str, Any]") -> "tuple[float | None, float | None]":
    return row["published_p95_m"], row["autopilot_p95_m"]


def _show_fleet(table: "Sequence[dict[str, Any]]", top: int) -> None:
    from rich.console import Console
    from rich.table import Table

    shown = Table(
        "log", "session", "wrong", "Kollsman", "autopilot", "why", box=None, pad_edge=False
    )
    read = [row for row in table if row["error"] is None]
    for row in read[:top]:
        shown.add_row(
            Path(row["log"]).name,
            str(row["session"]),
            row["wrong"],
            *("" if each is None else f"{each:.1f}" for each in _sizes(row)),
            row["reason"],
        )
    console = Console(width=None if sys.stdout.isatty() else 160, markup=False)
    if read:
        console.print(shown)
        print(
            "Kollsman, autopilot: 95 % of |difference| to truth, else to the smoothed altitude, m"
        )
    if len(read) > top:
        print(f"... and {len(read) - top} more (--top N shows more)")
    for row in table:
        if row["error"] is not None:
            print(f"not read: {Path(row['log']).name}: {row['error']}")
    wrong = sum(bool(row["wrong"]) for row in read)
    plural = "" if len(read) == 1 else "s"
    unread = len(table) - len(read)
    print(f"{len(read)} session{plural}, {wrong} with a wrong altitude; {unread} not read")
