"""The command ``kollsman``. The only module of the companion that prints.

What is heavy (Numba, NumPy, pymavlink) is imported by the commands, so that ``--help`` is instant.
"""

import errno
import json
import logging
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from companion import live_cli
from companion.common_cli import (
    ConfigOption,
    EstimatorOption,
    SetOption,
    resolve_settings,
    say_if_compiling,
)
from companion.errors import ConfigError, KollsmanError, LogFormatError
from companion.output import (
    discard_standard_output,
    open_standard_descriptors,
    set_up_logging,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from companion.logs import LogReader

OUTPUT_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EBADF}
"""What writing to standard output fails with: a full disk, a terminal that hung up."""

app = typer.Typer(
    name="kollsman",
    help="How high a MAVLink vehicle really is: barometer, GNSS and inertial sensors fused beside the autopilot.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

REPLAY_EXAMPLES = """\b
Examples:
  kollsman replay flight.tlog
  kollsman replay flight.tlog --csv altitude.csv
  kollsman replay flight.tlog --out with-altitude.tlog      (then open it in MAVExplorer)
  kollsman replay flight.tlog --json | jq .errors
"""

COMPARE_EXAMPLES = """\b
Examples:
  kollsman compare flight.tlog
  kollsman compare flight.tlog --plot errors.png
"""

TUNE_EXAMPLES = """\b
Examples:
  kollsman tune damping-loop flight.tlog
  kollsman tune damping-loop flight.tlog --out gains.yaml && kollsman replay flight.tlog --config gains.yaml
"""


def _version(wanted: bool) -> None:
    if wanted:
        from companion import __version__

        print(f"kollsman {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    *,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log more.")] = False,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say it, and exit.")
    ] = False,
) -> None:
    set_up_logging(logging.DEBUG if verbose else logging.INFO)
    if not verbose:
        logging.getLogger("numba").setLevel(logging.WARNING)


app.command(epilog=live_cli.RUN_EXAMPLES)(live_cli.run)


@app.command(epilog=REPLAY_EXAMPLES)
def replay(
    log: Annotated[Path, typer.Argument(help="A recorded log (.tlog).")],
    *,
    estimator: EstimatorOption = None,
    config: ConfigOption = None,
    changes: SetOption = None,
    csv: Annotated[
        Path | None, typer.Option(help="One line an estimate.", metavar="OUT.csv")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="The log with our ALTITUDE in it.", metavar="OUT.tlog")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="The report as JSON.")] = False,
    settle: Annotated[
        float, typer.Option(min=0, help="Seconds left out of the errors.", metavar="S")
    ] = 60.0,
) -> None:
    """Run a log through the same code as live, and report."""
    _refuse_same(log, out, csv)
    settings = resolve_settings(config, estimator, changes)
    say_if_compiling(settings.estimator)

    from companion.evaluation.report import Collector, build
    from companion.logs import open_log
    from companion.logs.tlog import TlogWriter
    from companion.pipeline import Pipeline
    from companion.sinks import CsvSink, Observers

    reader = open_log(log)
    collector = Collector()
    with ExitStack() as stack:
        pipeline = Pipeline(settings, datagrams=True, observer=collector, sends=out is not None)
        if csv:
            sink = stack.enter_context(CsvSink(csv, lambda: pipeline.health.health.name))
            pipeline.observe(Observers([collector, sink]))
        writer = stack.enter_context(TlogWriter(out)) if out else None
        started_s = time.perf_counter()
        for time_us, frame in _with_progress(reader, pipeline.wanted, log.name):
            sent = pipeline.feed_item(frame, time_us)
            if writer is not None:
                if not pipeline.heard_ourselves:  # of an earlier run: these are replaced
                    writer.write(time_us, frame.data)
                for data in sent:
                    writer.write(time_us, data)
        elapsed_s = time.perf_counter() - started_s
    report = build(
        pipeline,
        collector,
        {str(cause): count for cause, count in reader.counters.items() if count},
        settle,
    )
    report["log"], report["elapsed_s"] = str(log), round(elapsed_s, 3)
    if as_json:
        print(json.dumps(report, indent=2))
    else:
        _print_report(report)
    for path in (csv, out):
        if path and not as_json:
            print(f"wrote {path}")


@app.command(epilog=COMPARE_EXAMPLES)
def compare(
    log: Annotated[Path, typer.Argument(help="A recorded log (.tlog).")],
    *,
    config: ConfigOption = None,
    changes: SetOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="The table as JSON.")] = False,
    plot: Annotated[
        Path | None, typer.Option(help="Errors over time (extra `sim`).", metavar="OUT.png")
    ] = None,
    stanford: Annotated[
        Path | None,
        typer.Option(help="Error against protection level (extra `sim`).", metavar="OUT.png"),
    ] = None,
    alert_limit: Annotated[
        float, typer.Option(min=1, help="Of the Stanford diagram, in metres.", metavar="M")
    ] = 50.0,
    settle: Annotated[
        float, typer.Option(min=0, help="Seconds left out of the errors.", metavar="S")
    ] = 60.0,
) -> None:
    """Every estimator on one log, beside raw barometer, raw GNSS and the autopilot's own."""
    _refuse_same(log, plot)
    _refuse_same(log, stanford)
    settings = resolve_settings(config, None, changes)
    say_if_compiling()

    from companion.evaluation import compare as comparing
    from companion.evaluation import table as comparing_table

    with _bar(log.name, 1.0) as advance:
        found = comparing.compare(log, settings, settle, advance)
    if plot:
        comparing.plot(found, plot, f"{log.name}: altitude errors")
    if stanford:
        comparing.plot_protection(found, stanford, log.name, alert_limit)
    if as_json:
        print(json.dumps({"log": str(log), "settle_s": settle} | found.as_dict(), indent=2))
        return
    comparing_table.show(found)
    for path in filter(None, (plot, stanford)):
        print(f"wrote {path}")


def _tunable(estimator: str) -> "Callable[..., Any]":
    """The gain search of an estimator that has one."""
    from companion.estimators import ESTIMATORS

    method = ESTIMATORS.get(estimator)
    if method is None or method.tune is None:
        known = ", ".join(name for name, each in ESTIMATORS.items() if each.tune)
        raise ConfigError(f"{estimator!r} cannot be tuned; only {known} can")
    return method.tune


@app.command(epilog=TUNE_EXAMPLES)
def tune(
    estimator: Annotated[
        str, typer.Argument(help="damping-loop is the one that has gains to find.")
    ],
    log: Annotated[
        Path, typer.Argument(help="A recorded log (.tlog) with an IMU of 10 Hz or more.")
    ],
    *,
    config: ConfigOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the random search.")] = 0,
    generations: Annotated[int, typer.Option(min=1, max=10_000, help="How long it searches.")] = 60,
    out: Annotated[
        Path | None, typer.Option(help="Write the configuration there.", metavar="GAINS.yaml")
    ] = None,
) -> None:
    """Find an estimator's gains from a flight, by the genetic algorithm of its paper."""
    tune_method = _tunable(estimator)
    _refuse_same(log, out)
    settings = resolve_settings(config, estimator)
    say_if_compiling(estimator)

    from companion.evaluation.samples import samples_of

    with _bar(log.name, 2.0) as advance:
        samples = samples_of(log, settings, advance)
        section = settings.section(estimator)
        found = tune_method(samples, section, seed, generations, lambda share: advance(1.0 + share))
    print(found.table())
    print(f"\n{found.snippet()}", end="")
    if out:
        try:
            out.write_text(found.snippet(), encoding="utf-8")
        except OSError as error:
            raise ConfigError(f"{out}: cannot be written: {error.strerror}") from None
        print(f"\nwrote {out}")


@app.command()
def check(
    config: Annotated[
        Path | None, typer.Argument(help="A companion.yaml; without one, the defaults.")
    ] = None,
    *,
    keys: Annotated[
        bool, typer.Option("--keys", help="Instead, list every key as a Markdown table.")
    ] = False,
) -> None:
    """Validate a configuration file and print the resolved configuration."""
    if keys:
        print(_keys_table(), end="")
        return
    from companion.config import dump

    print(dump(resolve_settings(config, None)), end="")


def _keys_table() -> str:
    from companion.config import keys as every_key
    from companion.settings import CompanionSettings

    lines = ["| key | default | unit | allowed | meaning |", "|---|---|---|---|---|"]
    lines += [f"| `{key}` | {' | '.join(cells)} |" for key, *cells in every_key(CompanionSettings)]
    return "\n".join(lines) + "\n"


@app.command()
def links() -> None:
    """List the forms of a LINK."""
    from companion.links import help_text

    print(help_text())


@app.command()
def estimators() -> None:
    """List the estimators."""
    from companion.estimators import ESTIMATORS

    for name, method in ESTIMATORS.items():
        uses = ", ".join(kind.name.lower() for kind in sorted(method.uses) if kind.name != "STATUS")
        print(f"{name:18s}{method.summary} ({uses}; {method.citation})")


@app.command(name="warm-up")
def warm_up_command() -> None:
    """Compile everything now, so that the next start is quick (container images do this when
    built)."""
    from companion.settings import load_settings
    from companion.warmup import warm_up

    settings = load_settings()
    say_if_compiling(settings.estimator)
    started_s = time.perf_counter()
    warm_up(settings)
    print(f"compiled in {time.perf_counter() - started_s:.1f} s")


def _refuse_same(log: Path, *outputs: Path | None) -> None:
    for output in outputs:
        if output is not None and log.exists() and output.exists() and output.samefile(log):
            raise LogFormatError(f"{output}: is the log itself; choose another name for the output")


@contextmanager
def _bar(name: str, total: float) -> "Iterator[Callable[[float], None]]":
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
    ) as bar:
        task = bar.add_task(name, total=total)
        yield lambda done: bar.update(task, completed=done)


def _with_progress(reader: "LogReader", wanted: "frozenset[int]", name: str) -> Iterator[Any]:
    with _bar(name, reader.size_bytes) as advance:
        for count, timed_frame in enumerate(reader.items(wanted)):
            if count % 2000 == 0:
                advance(reader.position_bytes)
            yield timed_frame


def _print_report(report: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    boots = f", {report['reboots']} reboots" if report["reboots"] else ""
    vehicle = report["vehicle"] or "no vehicle"
    what = f"{report['duration_s']:.0f} s, {vehicle}{boots}, {report['estimator']}"
    print(f"{report['log']}: {what}, replayed in {report['elapsed_s']} s")
    verdicts = ("used", "gated", "stale", "invalid", "ignored")
    table = Table("samples", *verdicts, box=None, pad_edge=False)
    for kind, counts in report["samples"].items():
        table.add_row(kind, *(str(counts.get(verdict, "")) for verdict in verdicts))
    console.print(table)
    for title, key in (("left out", "set_aside"), ("damage", "damage")):
        if any(report[key].values()):
            print(
                f"{title}: "
                + ", ".join(f"{cause} {count}" for cause, count in report[key].items() if count)
            )
    altitude = report["altitude"]
    if altitude["estimates"]:
        print(
            f"altitude: {altitude['first_m']:.1f} m at first, {altitude['min_m']:.1f} to {altitude['max_m']:.1f} m, "
            f"{altitude['last_m']:.1f} m at last; median sd {altitude['median_sd_m']:.1f} m; "
            f"{altitude['published']} ALTITUDE sent; health at the end {report['health']}"
        )
    else:
        print("altitude: none; the log has no usable pair of barometer and GNSS")
    if report["errors"]:
        table = Table(
            "against truth (m)",
            "RMSE",
            "95 %",
            "max",
            "bias",
            "RMSE without bias",
            box=None,
            pad_edge=False,
        )
        for found in report["errors"].values():
            keys = ("rmse_m", "p95_m", "max_m", "bias_m", "unbiased_rmse_m")
            table.add_row(found["label"], *(f"{found[key]:.2f}" for key in keys))
        console.print(table)


def _tell(problem: str) -> None:
    """One line on stderr, where there is one."""
    with suppress(OSError, ValueError):
        print(f"kollsman: {problem}", file=sys.stderr, flush=True)


def main() -> None:
    """Entry point: an error that the user can act on is one line on stderr and exit code 1; wrong
    usage is 2."""
    open_standard_descriptors()
    try:
        try:
            app()
        finally:
            sys.stdout.flush()
    except KollsmanError as error:
        _tell(str(error))
        sys.exit(1)
    except BrokenPipeError:  # the reader of our output, such as `head`, has gone
        discard_standard_output()
        sys.exit(1)
    except OSError as error:
        if error.errno not in OUTPUT_ERRORS:
            raise
        _tell(f"the output cannot be written: {error.strerror}")
        discard_standard_output()
        sys.exit(1)


if __name__ == "__main__":
    main()
