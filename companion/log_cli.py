"""The commands for one log: replay and compare. Part of the command ``kollsman``."""

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
    compile_first,
    resolve_settings,
)
from companion.errors import ConfigError, LogFormatError
from companion.play_cli import LogHttpOption, LogSpeedOption, log_page
from companion.report_cli import show

if TYPE_CHECKING:
    from companion.play_cli import LogPage
    from companion.replay.expect import Outcome
    from companion.replay.run import Replayed
    from companion.settings import CompanionSettings

TABLE_SUFFIXES = ("", ".csv", ".txt", ".parquet")
REPLAY_EXAMPLES = """\b
Examples:
  kollsman replay flight.tlog
  kollsman replay flight.BIN --csv altitude.csv             (or OUT.parquet)
  kollsman replay flight.ulg --out with-altitude.tlog       (then open it in MAVExplorer)
  kollsman replay flight.BIN --report flight.html           (open it in a browser)
  kollsman replay flight.tlog --http 8080 --speed 20        (the live page, 20 times as fast)
  kollsman replay flight.tlog --json | jq '.sessions[0].sources'
  kollsman replay sitl.tlog --expect 'max<10' --expect 'nees<2' --junit result.xml
"""
COMPARE_EXAMPLES = """\b
Examples:
  kollsman compare flight.tlog
  kollsman compare flight.BIN --estimator vertical-bank --estimator damping-loop
  kollsman compare flight.tlog --plot errors.png
"""
LogArgument = Annotated[
    Path, typer.Argument(help="A log: .tlog, .bin, .log, .ulg or a raw MAVLink capture.")
]
LogsArgument = Annotated[
    list[Path], typer.Argument(help="Logs: .tlog, .bin, .log, .ulg or raw MAVLink captures.")
]
SettleOption = Annotated[
    float,
    typer.Option(
        min=0, help="Time at the start of each session that the errors leave out, s.", metavar="S"
    ),
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
CsvOption = Annotated[
    Path | None,
    typer.Option(
        help="File of estimates, one row for each barometer and GNSS sample; Parquet if its name "
        "ends in .parquet.",
        metavar="OUT.csv",
    ),
]
ReportOption = Annotated[
    Path | None,
    typer.Option(
        help="The flight report: a page with verdict, linked charts and tables; the charts alone "
        "where the name ends with .png.",
        metavar="OUT.html",
    ),
]
OutOption = Annotated[
    Path | None, typer.Option(help="Copy of the log with our ALTITUDE in it.", metavar="OUT.tlog")
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print the report as JSON (docs/report-schema.md).")
]
SmoothOption = Annotated[
    bool,
    typer.Option(
        "--smooth",
        help="Add the altitude after the fact to the rows of --csv, and its error where the log "
        "has truth.",
    ),
]
PlotOption = Annotated[
    Path | None,
    typer.Option(
        help="Picture of the curves over time (extra `sim`); one file for each session.",
        metavar="OUT.png",
    ),
]
StanfordOption = Annotated[
    Path | None,
    typer.Option(
        help="Picture of the error against the protection level (extra `sim`).", metavar="OUT.png"
    ),
]
AlertLimitOption = Annotated[
    float, typer.Option(min=1, help="Alert limit of the Stanford diagram, m.", metavar="M")
]
SomeEstimatorsOption = Annotated[
    list[str] | None,
    typer.Option("--estimator", help="Estimator to run; repeatable. Default: all.", metavar="NAME"),
]
JunitOption = Annotated[
    Path | None, typer.Option(help="JUnit file for the outcomes of --expect.", metavar="OUT.xml")
]


def replay(
    logs: LogsArgument,
    *,
    estimator: EstimatorOption = None,
    config: ConfigOption = None,
    changes: SetOption = None,
    csv: CsvOption = None,
    out: OutOption = None,
    report: ReportOption = None,
    as_json: JsonOption = False,
    smooth: SmoothOption = False,
    settle: SettleOption = 60.0,
    expect: ExpectOption = None,
    junit: JunitOption = None,
    http: LogHttpOption = None,
    speed: LogSpeedOption = "1",
) -> None:
    """Run logs through the same code as live, and report each session."""
    _refuse_outputs(logs, out, csv, report, http, junit)
    settings = resolve_settings(config, estimator, changes)
    from companion.replay import expect as expecting

    expectations = expecting.parse(expect or [])
    compile_first(settings, settings.estimator)
    reports, outcomes = [], []
    pages: list[Path] = []
    with log_page(http, speed, settings) as live:
        for log in logs:
            try:
                found = _replay_one(log, settings, settle, csv, out, live, smoothing=smooth)
            except LogFormatError as error:
                reports.append(_unread(log, error, alone=len(logs) == 1))
                outcomes += expecting.hold(log.name, expectations, None)
                continue
            if report:
                from companion.replay.reports import write_reports

                pages = write_reports(found, report, log.name)
            outcomes += expecting.hold_all(log.name, expectations, found.report)
            reports.append(found.report)
            if not as_json:
                show(found.report)
        if as_json:
            print(json.dumps(reports[0] if len(reports) == 1 else reports, indent=2))
        else:
            print("".join(f"wrote {path}\n" for path in (csv, out, *pages) if path), end="")
        if live:
            live.stay()
    conclude("kollsman replay", outcomes, junit)
    _refuse_unread(reports)


def _refuse_unread(reports: list[dict[str, Any]]) -> None:
    unread = sum("error" in each for each in reports)
    if unread:
        raise LogFormatError(f"{unread} of {len(reports)} logs could not be read: see above")


def _unread(log: Path, error: LogFormatError, *, alone: bool) -> dict[str, Any]:
    """The report of one of several logs that cannot be read; its reason is said at once. Raises
    `error` where the log is alone."""
    from companion.replay.schema import document

    if alone:
        raise error
    print(f"kollsman: {error}", file=sys.stderr)
    found: dict[str, Any] = document("replay", str(log), [], error=str(error))
    return found


def _refuse_outputs(
    logs: list[Path],
    out: Path | None,
    csv: Path | None,
    report: Path | None,
    http: str | None,
    junit: Path | None,
) -> None:
    """Refuse what cannot be written, before a log is read."""
    refuse_outputs(logs, out, csv, report, junit)
    if csv and csv.suffix.lower() not in TABLE_SUFFIXES:
        raise ConfigError(f"{csv}: --csv writes .csv or .parquet; end the name so")
    if len(logs) > 1 and (out or csv or report or http):
        raise ConfigError(
            "--csv, --out, --report and --http take one log; name one, or use `kollsman batch`"
        )
    if report:
        from companion.replay.reports import check

        check(report)


def _replay_one(
    log: Path,
    settings: "CompanionSettings",
    settle_s: float,
    csv: Path | None,
    out: Path | None,
    live: "LogPage | None",
    *,
    smoothing: bool,
) -> "Replayed":
    """Replay a log, show it where a live page is wanted, and write the tables and the log that were
    asked for."""
    from companion.logs.tlog import TlogWriter
    from companion.replay.record import Recording
    from companion.replay.run import replay as replay_log
    from companion.replay.table import write

    with ExitStack() as stack:
        writer = stack.enter_context(TlogWriter(out)) if out else None
        advance = stack.enter_context(bar(log.name, 1.0))
        player = live.player(log, writer) if live else None
        found = replay_log(
            log,
            settings,
            settle_s=settle_s,
            smoothing=smoothing,
            writer=player or writer,
            on_progress=advance,
            observe=player.observe if player else Recording,
        )
    if csv:
        write(csv, found.tables())
    return found


def compare(
    log: LogArgument,
    *,
    estimator: SomeEstimatorsOption = None,
    config: ConfigOption = None,
    changes: SetOption = None,
    as_json: JsonOption = False,
    plot: PlotOption = None,
    stanford: StanfordOption = None,
    alert_limit: AlertLimitOption = 50.0,
    settle: SettleOption = 60.0,
    expect: ExpectOption = None,
    junit: JunitOption = None,
) -> None:
    """Compare every estimator on one log with raw barometer, raw GNSS and the autopilot's
    altitude; --expect holds for each."""
    refuse_outputs([log], plot, stanford, junit)
    settings = resolve_settings(config, None, changes)
    names = _estimators(estimator, expect)
    compile_first(settings, *names)

    from companion.evaluation import compare as comparing
    from companion.evaluation import table as comparing_table
    from companion.plots import comparison as plots
    from companion.replay.findings import utc
    from companion.replay.schema import document

    with bar(log.name, 1.0) as advance:
        found = comparing.compare_sessions(log, settings, settle, advance, names)
    sessions, written = [], []
    for number, (session, comparison) in enumerate(found, 1):
        title = f"{log.name}" + (f", session {number}" if len(found) > 1 else "")
        if plot:
            written.append(_numbered(plot, number, len(found)))
            plots.plot(comparison, written[-1], f"{title}: altitudes")
        if stanford:
            written.append(_numbered(stanford, number, len(found)))
            plots.plot_protection(comparison, written[-1], title, alert_limit)
        vehicle = "/".join(map(str, session.vehicle)) if session.vehicle else None
        head = {"session": number, "vehicle": vehicle, "start_utc": utc(session.first_us)}
        sessions.append(head | comparison.as_dict())
        if not as_json:
            print(f"{title}: vehicle {vehicle or 'unknown'}, from {head['start_utc'] or 'boot'}")
            comparing_table.show(comparison)
    if as_json:
        print(json.dumps(document("compare", str(log), sessions, settle_s=settle), indent=2))
    else:
        print("".join(f"wrote {path}\n" for path in written), end="")
    _hold_estimators(log.name, names, sessions, expect, junit)


def _hold_estimators(
    name: str,
    estimators: tuple[str, ...],
    sessions: list[dict[str, Any]],
    expect: list[str] | None,
    junit: Path | None,
) -> None:
    """Hold expectations against each estimator in each session."""
    from companion.replay.expect import hold, parse

    expectations = parse(expect or [])
    rows = [(each["session"], row) for each in sessions for row in each["results"]]
    outcomes = [
        outcome
        for number, row in rows
        if row["label"] in estimators
        for outcome in hold(f"{name} session {number} {row['label']}", expectations, row)
    ]
    conclude("kollsman compare", outcomes, junit)


def _estimators(names: list[str] | None, expect: list[str] | None) -> tuple[str, ...]:
    """The estimators to run. A mistake in them or in --expect is told before the log is read."""
    from companion.estimators import ESTIMATORS
    from companion.replay.expect import parse

    parse(expect or [])
    for name in names or []:
        if name not in ESTIMATORS:
            known = ", ".join(ESTIMATORS)
            raise ConfigError(f"no estimator is called {name!r}; there are: {known}")
    return tuple(names or ESTIMATORS)


def _numbered(path: Path, number: int, count: int) -> Path:
    """The file of one session: with its number where there are several."""
    return path if count == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}")


def refuse_outputs(logs: "Sequence[Path]", *outputs: Path | None) -> None:
    """Raise `ConfigError` when an output would replace a log or another output, or has no
    folder."""
    seen: list[Path] = []
    for output in filter(None, outputs):
        if output.is_file() and any(log.exists() and output.samefile(log) for log in logs):
            raise ConfigError(f"{output}: is the log itself; choose another name for the output")
        if output.is_dir():
            raise ConfigError(f"{output}: is a folder; name a file in it")
        if not output.parent.is_dir():
            raise ConfigError(f"{output}: the folder {output.parent} does not exist: create it")
        if output.resolve() in seen and (output.is_file() or not output.exists()):
            raise ConfigError(f"{output}: is named for two outputs; choose another name for one")
        seen.append(output.resolve())


def hold_log(name: str, log: Path, texts: list[str], junit: Path | None) -> None:
    """Replay a log and hold expectations against it: how a simulated flight is checked."""
    from companion.replay import expect as expecting
    from companion.replay.run import replay as replay_log

    outcomes = expecting.hold_all(log.name, expecting.parse(texts), replay_log(log).report)
    for each in outcomes:
        print(each)
    conclude(name, outcomes, junit)


def conclude(name: str, outcomes: "Sequence[Outcome]", junit: Path | None) -> None:
    """Say which expectations were not met, write the JUnit file, and exit with 3 if there were."""
    from companion.replay.expect import EXIT_WRONG, write_junit

    if junit and not outcomes:
        raise ConfigError("--junit is for the outcomes of --expect: give one, such as 'max<10'")
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
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(),
    )
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as progress:
        task = progress.add_task(name, total=total)
        yield lambda done: progress.update(task, completed=done)
