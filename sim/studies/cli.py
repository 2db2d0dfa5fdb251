"""The commands that fly many scenarios: ``kollsman-sim campaign`` and ``gallery``; like `sim.cli`,
they print."""

import math
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.log_cli import ExpectOption, JunitOption, conclude

if TYPE_CHECKING:
    from collections.abc import Sequence

    from companion.jobs import Row
    from companion.replay.expect import Expectation

FEEDBACK_EXAMPLES = """\b
Examples:
  kollsman-sim feedback
  kollsman-sim feedback --no-hours --out out/feedback
"""

CAMPAIGN_EXAMPLES = """\b
Examples:
  kollsman-sim campaign weather-change calm-circuit --seeds 20
  kollsman-sim campaign my.yaml --seeds 100 --estimator adaptive-fusion --workers 4
  kollsman-sim campaign weather-change --seeds 500 --scheduler tcp://10.0.0.5:8786
"""

GALLERY_EXAMPLES = """\b
Examples:
  kollsman-sim gallery
  kollsman-sim gallery spoofed-approach my.yaml --estimator vertical-bank --out out/gallery
"""


EstimatorsOption = Annotated[
    list[str] | None,
    typer.Option("--estimator", help="Estimator to run; repeatable. Default: all.", metavar="E"),
]
WorkersOption = Annotated[
    int | None,
    typer.Option(min=1, help="Number of processes. Default: one for each core.", metavar="N"),
]


def campaign(
    scenarios: Annotated[
        list[str], typer.Argument(help="Names of scenarios, or paths of .yaml files.")
    ],
    *,
    seeds: Annotated[
        int, typer.Option(min=1, help="Flights of each scenario, with seeds 1 to N.", metavar="N")
    ] = 10,
    estimator: EstimatorsOption = None,
    workers: WorkersOption = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            help="Address of the Dask scheduler that runs the flights.", metavar="tcp://HOST:PORT"
        ),
    ] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set", help="Set a key of companion.yaml; repeatable.", metavar="SECTION.KEY=VALUE"
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder of the results.", metavar="DIR")] = Path(
        "out/campaign"
    ),
    expect: ExpectOption = None,
    junit: JunitOption = None,
) -> None:
    """Fly scenarios with many seeds, run the estimators, and write Parquet rows and a table. A
    stopped campaign continues."""
    from companion.jobs import executor_of
    from companion.replay import expect as expecting
    from companion.settings import CompanionSettings
    from sim.studies import campaign as fleet

    fleet.require_parquet()
    expectations = expecting.parse(expect or [])
    settings = CompanionSettings().with_assignments(changes or [])
    jobs = fleet.jobs_of(scenarios, seeds, _estimators(estimator), settings)
    with (
        executor_of(workers or os.cpu_count() or 1, scheduler) as executor,
        _job_bar(len(jobs)) as report,
    ):
        rows = fleet.run(jobs, executor, out, report)
    _print_campaign(fleet.summary(rows), fleet.failures(rows))
    print(f"wrote {out / 'campaign.parquet'} ({len(rows)} rows)")
    _hold(rows, _estimators(estimator), expectations, junit)


def _hold(
    rows: "Sequence[Row]",
    estimators: "Sequence[str]",
    expectations: "Sequence[Expectation]",
    junit: Path | None,
) -> None:
    """Hold expectations against every flight of every estimator; a flight that failed meets
    none."""
    from companion.replay.expect import hold

    outcomes = [
        outcome
        for row in rows
        if row["source"] in estimators or row["error"] is not None
        for outcome in hold(
            f"{row['scenario']} seed {row['seed']} {row['source'] or 'failed'}", expectations, row
        )
    ]
    conclude("kollsman-sim campaign", outcomes, junit)


def gallery(
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(
            help="Names, or paths of .yaml files. Default: every scenario of the simulator."
        ),
    ] = None,
    *,
    estimator: EstimatorsOption = None,
    workers: WorkersOption = None,
    out: Annotated[
        Path, typer.Option(help="Folder of the page and figures.", metavar="DIR")
    ] = Path("docs/gallery"),
) -> None:
    """Fly every scenario once, and write a page with a figure and a table of errors of each.

    With names, only their sections of the page are renewed.
    """
    from companion.jobs import executor_of
    from sim.scenario import load_scenario, scenario_paths
    from sim.studies import campaign as fleet
    from sim.studies import gallery as pictures

    flights = [load_scenario(name) for name in scenarios or scenario_paths()]
    jobs = [fleet.Job(flight, flight.seed, _estimators(estimator)) for flight in flights]
    with (
        executor_of(workers or os.cpu_count() or 1, None) as executor,
        _flight_bar(len(jobs)) as advance,
    ):
        page = pictures.build(jobs, executor, out, lambda _: advance())
    size_mb = sum(path.stat().st_size for path in page.parent.iterdir()) / 1e6
    print(f"wrote {out / page.name}: {len(jobs)} scenarios, {size_mb:.2f} MB with the figures")


def feedback(
    *,
    hours: Annotated[
        bool,
        typer.Option(
            "--hours/--no-hours", help="Also fly an hour-long hold in the weather of each scenario."
        ),
    ] = True,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Number of processes. Default: one for each core.", metavar="N"),
    ] = None,
    out: Annotated[
        Path, typer.Option(help="Folder of the page and figures.", metavar="DIR")
    ] = Path("docs/feedback"),
) -> None:
    """Measure the feedback: a vehicle that flies by its own altitude, with and without it, through
    drifts, faults and weather."""
    from companion.jobs import executor_of
    from sim.studies import feedback as measured
    from sim.studies.runs import kept_parts

    cases = measured.CASES + (measured.HOURS if hours else ())
    with (
        executor_of(workers or os.cpu_count() or 1) as executor,
        _flight_bar(2 * len(cases)) as bar,
    ):
        page = measured.study(
            cases,
            executor,
            out,
            parts=kept_parts(),
            on_done=lambda done: bar(completed=done),
        )
    print(f"wrote {page}: {len(cases)} cases")


def _estimators(chosen: list[str] | None) -> tuple[str, ...]:
    """The estimators chosen on the command line, or all."""
    from companion.estimators import ESTIMATORS

    unknown = [name for name in chosen or [] if name not in ESTIMATORS]
    if unknown:
        print(
            f"kollsman-sim: no estimator is called '{unknown[0]}'; there are: "
            f"{', '.join(ESTIMATORS)}",
            file=sys.stderr,
        )
        raise typer.Exit(2)
    return tuple(chosen or ESTIMATORS)


@contextmanager
def _flight_bar(total: int) -> "Iterator[Callable[..., None]]":
    """A progress bar of flights on stderr; yields what moves it on, by one or to ``completed=``."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        BarColumn(),
        TextColumn("{task.completed}/{task.total} flights"),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task("", total=total)

        def advance(completed: int | None = None) -> None:
            if completed is None:
                bar.advance(task)
            else:
                bar.update(task, completed=completed)

        yield advance


@contextmanager
def _job_bar(total: int) -> "Iterator[Callable[[int, list[Row]], None]]":
    with _flight_bar(total) as advance:

        def report(done: int, rows: "list[Row]") -> None:
            advance(done)
            for row in rows[:1]:
                if row["error"] is not None:
                    print(
                        f"failed: {row['scenario']} seed {row['seed']}: {row['error']}",
                        file=sys.stderr,
                    )

        yield report


def _print_campaign(lines: "list[Row]", failed: list[str]) -> None:
    from companion import tables

    names = {
        "RMSE": "rmse_m", "+-": "rmse_sd_m", "95 %": "p95_m", "worst": "max_m",
        "climb": "climb_rmse_mps", "NEES": "nees", "in 2 sd": "coverage_2", "sd": "median_sd_m",
        "level": "median_level_m", "above": "exceedances", "us": "cost_us",
        "named s": "detection_s", "wrong": "wrong_share",
    }  # fmt: skip
    labels = {head: [line[head] for line in lines] for head in ("scenario", "source")}
    numbers = {"n": [str(line["flights"]) for line in lines]}
    for head, key in names.items():
        numbers[head] = ["" if math.isnan(line[key]) else f"{line[key]:.2f}" for line in lines]
    numbers["found"] = [
        f"{line['detected']}/{line['faults']}" if line["faults"] else "" for line in lines
    ]
    for head, key in (("false", "false_alarms"), ("missed", "missed")):
        numbers[head] = [str(line[key]) if line[key] else "" for line in lines]
    tables.show(labels, numbers)
    if failed:
        print(f"{len(failed)} flights failed; the next run tries them again")
