"""The commands for recorded logs: replay and compare. Part of the command ``kollsman``."""

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from companion.common_cli import (
    ConfigOption,
    EstimatorOption,
    SetOption,
    resolve_settings,
    say_if_compiling,
)
from companion.errors import ConfigError, LogFormatError

if TYPE_CHECKING:
    from companion.replay.expect import Outcome

REPLAY_EXAMPLES = """\b
Examples:
  kollsman replay flight.tlog
  kollsman replay flight.BIN --csv altitude.csv             (or OUT.parquet)
  kollsman replay flight.ulg --out with-altitude.tlog       (then open it in MAVExplorer)
  kollsman replay flight.tlog --json | jq '.sessions[0].sources'
  kollsman replay sitl.tlog --expect 'max<10' --expect 'nees<2' --junit result.xml
"""
COMPARE_EXAMPLES = """\b
Examples:
  kollsman compare flight.tlog
  kollsman compare flight.BIN --estimator vertical-bank --estimator damping-loop
  kollsman compare flight.tlog --plot errors.png
"""
BATCH_EXAMPLES = """\b
Examples:
  kollsman batch logs/ --out fleet
  kollsman batch 'logs/**/*.BIN' --out fleet --workers 4
  kollsman batch logs/ --out fleet --scheduler tcp://127.0.0.1:8786
"""
LogArgument = Annotated[
    Path, typer.Argument(help="A log: .tlog, .bin, .log, .ulg or a raw MAVLink capture.")
]
LogsArgument = Annotated[
    list[Path], typer.Argument(help="Logs: .tlog, .bin, .log, .ulg or raw MAVLink captures.")
]
SettleOption = Annotated[
    float,
    typer.Option(min=0, help="Seconds at the start of each session left out.", metavar="S"),
]
ExpectOption = Annotated[
    list[str] | None,
    typer.Option(
        "--expect",
        help="A condition such as 'max<10' (m); metrics max, p95, rmse, bias, unbiased, nees. "
        "Exit code 3 when a session does not meet it; repeatable.",
        metavar="METRIC<VALUE",
    ),
]
JunitOption = Annotated[
    Path | None, typer.Option(help="Write the outcomes of --expect there.", metavar="OUT.xml")
]


def replay(
    logs: LogsArgument,
    *,
    estimator: EstimatorOption = None,
    config: ConfigOption = None,
    changes: SetOption = None,
    csv: Annotated[
        Path | None,
        typer.Option(
            help="One row for each barometer and GNSS sample; Parquet where the name ends so.",
            metavar="OUT.csv",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="The log with our ALTITUDE in it.", metavar="OUT.tlog")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="The report as JSON (docs/report-schema.md).")
    ] = False,
    smooth: Annotated[
        bool,
        typer.Option("--smooth", help="Also the best altitude after the fact, in the rows."),
    ] = False,
    settle: SettleOption = 60.0,
    expect: ExpectOption = None,
    junit: JunitOption = None,
) -> None:
    """Run logs through the same code as live, and report each session."""
    for log in logs:
        refuse_same(log, out, csv)
    if len(logs) > 1 and (out or csv):
        raise ConfigError("--csv and --out take one log; name one, or use `kollsman batch`")
    settings = resolve_settings(config, estimator, changes)
    from companion.replay import expect as expecting

    expectations = expecting.parse(expect or [])
    say_if_compiling(settings.estimator)

    from companion.logs.tlog import TlogWriter
    from companion.replay.run import replay as replay_log
    from companion.replay.table import write

    reports, outcomes = [], []
    for log in logs:
        with ExitStack() as stack:
            writer = stack.enter_context(TlogWriter(out)) if out else None
            advance = stack.enter_context(bar(log.name, 1.0))
            found = replay_log(
                log, settings, settle_s=settle, smoothing=smooth, writer=writer, on_progress=advance
            )
        if csv:
            write(csv, found.tables())
        for session in found.report["sessions"]:
            where = f"{log.name} session {session['session']}"
            outcomes += expecting.hold(where, expectations, session["sources"].get("estimate"))
        reports.append(found.report)
        if not as_json:
            _show(found.report)
    if as_json:
        print(json.dumps(reports[0] if len(reports) == 1 else reports, indent=2))
    else:
        for path in filter(None, (csv, out)):
            print(f"wrote {path}")
    conclude("kollsman replay", outcomes, junit)


def compare(
    log: LogArgument,
    *,
    estimator: Annotated[
        list[str] | None,
        typer.Option(help="Only this one; repeatable. Default: all.", metavar="NAME"),
    ] = None,
    config: ConfigOption = None,
    changes: SetOption = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="The table as JSON (docs/report-schema.md).")
    ] = False,
    plot: Annotated[
        Path | None,
        typer.Option(help="Curves over time (extra `sim`); one file a session.", metavar="OUT.png"),
    ] = None,
    stanford: Annotated[
        Path | None,
        typer.Option(help="Error against protection level (extra `sim`).", metavar="OUT.png"),
    ] = None,
    alert_limit: Annotated[
        float, typer.Option(min=1, help="Of the Stanford diagram, in metres.", metavar="M")
    ] = 50.0,
    settle: SettleOption = 60.0,
) -> None:
    """Every estimator on one log, beside raw barometer, raw GNSS and the autopilot's own."""
    refuse_same(log, plot, stanford)
    settings = resolve_settings(config, None, changes)
    names = _estimators(estimator)
    say_if_compiling(*names)

    from companion.evaluation import compare as comparing
    from companion.evaluation import table as comparing_table
    from companion.replay.summary import document, utc

    with bar(log.name, 1.0) as advance:
        found = comparing.compare_sessions(log, settings, settle, advance, names)
    sessions, written = [], []
    for number, (session, comparison) in enumerate(found, 1):
        title = f"{log.name}" + (f", session {number}" if len(found) > 1 else "")
        if plot:
            written.append(_numbered(plot, number, len(found)))
            comparing.plot(comparison, written[-1], f"{title}: altitudes")
        if stanford:
            written.append(_numbered(stanford, number, len(found)))
            comparing.plot_protection(comparison, written[-1], title, alert_limit)
        vehicle = "/".join(map(str, session.vehicle)) if session.vehicle else None
        head = {"session": number, "vehicle": vehicle, "start_utc": utc(session.first_us)}
        sessions.append(head | comparison.as_dict())
        if not as_json:
            print(f"{title}: vehicle {vehicle or 'unknown'}, from {head['start_utc'] or 'boot'}")
            comparing_table.show(comparison)
    if as_json:
        print(json.dumps(document("compare", str(log), sessions, settle_s=settle), indent=2))
        return
    for path in written:
        print(f"wrote {path}")


def batch(
    places: Annotated[
        list[str],
        typer.Argument(help="Folders, logs or quoted patterns.", metavar="DIR_OR_GLOB..."),
    ],
    *,
    out: Annotated[Path, typer.Option(help="Folder for the results.", metavar="DIR")],
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes. Default: one a core.", metavar="N")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Run on the Dask cluster at this address.", metavar="tcp://HOST:PORT"),
    ] = None,
    estimator: EstimatorOption = None,
    config: ConfigOption = None,
    changes: SetOption = None,
    settle: SettleOption = 60.0,
    top: Annotated[
        int, typer.Option(min=1, help="Sessions to print, the worst first.", metavar="N")
    ] = 20,
) -> None:
    """Replay a folder of logs: which altitudes were wrong, and why. Goes on where it was stopped."""
    settings = resolve_settings(config, estimator, changes)
    say_if_compiling(settings.estimator)

    import os

    from companion.replay.batch import find_logs, run_batch
    from companion.warmup import warm_up

    logs = find_logs(places)
    if scheduler is None:
        warm_up(settings)  # once, instead of in every worker
    with _counting(len(logs)) as on_done:
        table = run_batch(
            logs,
            out,
            settings,
            settle_s=settle,
            workers=min(workers or os.cpu_count() or 1, len(logs)),
            scheduler=scheduler,
            on_done=on_done,
        )
    _show_fleet(table, top)
    print(f"wrote {out}/fleet.csv, fleet.parquet, fleet.json and rows/")
    if all(row["error"] is not None for row in table):
        raise LogFormatError("no log could be read; the reasons are in fleet.csv")


@contextmanager
def _counting(total: int) -> "Iterator[Callable[..., None]]":
    """Progress of a batch, with rate and time left: a bar on a terminal, else a line a minute."""
    import time

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
                say = f"{count} of {total} logs, {rate * 60:.0f} a minute, {left:.0f} s left"
                print(say, file=sys.stderr, flush=True)

        yield advance


def _show_fleet(table: "Sequence[dict[str, Any]]", top: int) -> None:
    from rich.console import Console
    from rich.table import Table

    shown = Table("log", "session", "wrong", "m", "verdict", box=None, pad_edge=False)
    for row in table[:top]:
        score = f"{row['score_m']:.1f}" if row["score_m"] is not None else ""
        name, number = Path(row["log"]).name, str(row["session"] or "")
        shown.add_row(name, number, row["wrong"], score, row["error"] or row["verdict"])
    console = Console(width=None if sys.stdout.isatty() else 160)
    console.print(shown)
    unreadable = sum(row["error"] is not None for row in table)
    wrong = sum(bool(row["wrong"]) for row in table)
    print(f"{len(table) - unreadable} sessions, {wrong} with a wrong altitude; {unreadable} unread")


def _estimators(names: list[str] | None) -> tuple[str, ...]:
    from companion.estimators import ESTIMATORS

    for name in names or []:
        if name not in ESTIMATORS:
            known = ", ".join(ESTIMATORS)
            raise ConfigError(f"no estimator is called {name!r}; there are: {known}")
    return tuple(names or ESTIMATORS)


def _numbered(path: Path, number: int, count: int) -> Path:
    """The file of one session: with its number where there are several."""
    return path if count == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}")


def refuse_same(log: Path, *outputs: Path | None) -> None:
    """Raise `LogFormatError` when an output would replace the log."""
    for output in outputs:
        if output is not None and log.exists() and output.exists() and output.samefile(log):
            raise LogFormatError(f"{output}: is the log itself; choose another name for the output")


def conclude(name: str, outcomes: "Sequence[Outcome]", junit: Path | None) -> None:
    """Say which expectations were not met, write the JUnit file, and exit with 3 if there were."""
    from companion.replay.expect import EXIT_WRONG, write_junit

    if junit:
        write_junit(junit, name, outcomes)
    for each in outcomes:
        if not each.met:
            print(f"kollsman: {each}", file=sys.stderr)
    if not all(each.met for each in outcomes):
        raise typer.Exit(EXIT_WRONG)


@contextmanager
def bar(name: str, total: float) -> "Iterator[Callable[[float], None]]":
    """A progress bar on a terminal; what it gives is called with how much is done."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (
        TextColumn(name),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(),
    )
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as progress:
        task = progress.add_task(name, total=total)
        yield lambda done: progress.update(task, completed=done)


def _show(report: dict[str, Any]) -> None:
    """One log for people."""
    sessions = report["sessions"]
    more = f", {len(sessions)} sessions" if len(sessions) > 1 else ""
    print(f"{report['log']}: {report['format']}{more}, replayed in {report['elapsed_s']:.1f} s")
    if report["damage"]:
        print("damage: " + ", ".join(f"{cause} {n}" for cause, n in report["damage"].items()))
    for session in sessions:
        _show_session(session)


def _show_session(session: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=100)
    start = session["start_utc"] or f"{session['start_boot_s']:.0f} s after boot"
    what = f"vehicle {session['vehicle'] or 'unknown'} ({session['autopilot']})"
    reboot = ", after a reboot" if session["after_reboot"] else ""
    print(
        f"\nsession {session['session']}: {what}, from {start}{reboot}, "
        f"{session['duration_s']:.0f} s, {session['estimator']}"
    )
    verdicts = ("used", "gated", "stale", "invalid", "ignored")
    table = Table("samples", *verdicts, box=None, pad_edge=False)
    for kind, counts in session["samples"].items():
        table.add_row(kind, *(str(counts.get(verdict, "")) for verdict in verdicts))
    console.print(table)
    if session["left_out"]:
        print("left out: " + ", ".join(f"{cause} {n}" for cause, n in session["left_out"].items()))
    altitude = session["altitude"]
    if altitude["estimates"]:
        print(
            f"altitude: {altitude['first_m']:.1f} m at first, {altitude['min_m']:.1f} to "
            f"{altitude['max_m']:.1f} m, {altitude['last_m']:.1f} m at last; "
            f"{altitude['published']} ALTITUDE sent; health at the end "
            f"{session['health']['at_end']}"
        )
    _show_sources(session, console)
    print(session["verdict"])


def _show_sources(session: dict[str, Any], console: Any) -> None:
    from rich.table import Table

    if not session["sources"]:
        return
    reference = session["reference"]
    if reference["kind"] == "truth":
        title = "error against truth (m)"
    else:
        title = f"difference to smoother, sd {reference['sd_m']:.1f} (m)"
    keys = {"RMS": "rmse_m", "95 %": "p95_m", "max": "max_m", "mean": "bias_m"}
    table = Table(title, *keys, "RMS without mean", box=None, pad_edge=False)
    for found in session["sources"].values():
        values = [found[key] for key in (*keys.values(), "unbiased_rmse_m")]
        table.add_row(found["label"], *(f"{value:.2f}" for value in values))
    console.print(table)
