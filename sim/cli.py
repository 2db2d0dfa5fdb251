"""The command ``kollsman-sim``. The only module of the simulator that prints.

What is heavy (JSBSim, NumPy, pymavlink) is imported by the commands, so that ``--help`` is instant.
"""

import math
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.errors import KollsmanError
from sim.studies import cli as fleet
from sim.studies.goals import cli as evaluation

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

    from companion.links import Link
    from sim.flight import Flight, Progress, Summary
    from sim.studies.demo import DemoRow

app = typer.Typer(
    name="kollsman-sim",
    help="JSBSim flies a real aircraft model through weather and speaks MAVLink as an autopilot would.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

_FLY_EXAMPLES = """\b
Examples:
  As fast as possible to a log:
    kollsman-sim fly short-hop --tlog hop.tlog
  In real time to a ground station or the companion:
    kollsman-sim fly weather-change --link udpout:127.0.0.1:14550
  As PX4, the companion on one link and a ground station on another:
    kollsman-sim fly weather-change --flavour px4 --link udpout:127.0.0.1:14540 --link udpout:127.0.0.1:14550
  Twenty times as fast, to whoever connects, and to a log:
    kollsman-sim fly weather-change --link tcpin:0.0.0.0:5760 --speed 20 --tlog flight.tlog
  Your own scenario, another dice:
    kollsman-sim fly my-scenario.yaml --seed 7 --tlog flight.tlog
"""

_DEMO_EXAMPLES = """\b
Examples:
  kollsman-sim demo
  kollsman-sim demo --speed 60 --scenario short-hop
"""

_CORRUPT_EXAMPLES = """\b
Examples:
  A minute without the receiver, ten minutes into the log:
    kollsman-sim corrupt flight.tlog outage.tlog --fault outage:start_s=600,duration_s=60
  A lossy and late radio, and a barometer that spikes by 2 hPa:
    kollsman-sim corrupt flight.tlog bad.tlog --fault drop:probability=0.2 --fault delay:delay_s=1.5,jitter_s=1 \\
      --fault spike:quantity=pressure,size=200,probability=0.01
"""


def _usage(message: str) -> typer.Exit:
    """Say in one line what is wrong with the command line; the exception ends with code 2."""
    print(f"kollsman-sim: {message}", file=sys.stderr)
    return typer.Exit(2)


def _speed(text: str) -> float | None:
    """A factor of real time; None is as fast as possible."""
    if text == "max":
        return None
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.01 <= value <= 1000.0:
        raise _usage(f"--speed '{text}' is neither 'max' nor a number from 0.01 to 1000")
    return value


@app.command(epilog=_FLY_EXAMPLES)
def fly(
    scenario: Annotated[
        str, typer.Argument(help="Name of a scenario (see `list`), or the path of a .yaml file.")
    ],
    *,
    link: Annotated[
        list[str] | None,
        typer.Option(help="Where to speak MAVLink; may be given several times.", metavar="URL"),
    ] = None,
    tlog: Annotated[
        Path | None, typer.Option(help="Record everything at full rate.", metavar="OUT")
    ] = None,
    speed: Annotated[
        str,
        typer.Option(
            help="Times real time, or max. Default: 1 with a link, max to a log alone.",
            metavar="X|max",
        ),
    ] = "",
    seed: Annotated[
        int | None, typer.Option(min=0, help="In place of the scenario's; same seed, same bytes.")
    ] = None,
    all_streams: Annotated[
        bool,
        typer.Option(
            "--all-streams", help="Links get the log's rates unasked, instead of ArduPlane's 1 Hz."
        ),
    ] = False,
    flavour: Annotated[
        str,
        typer.Option(
            help="ardupilot, px4 or generic. Default: the scenario's.", metavar="AUTOPILOT"
        ),
    ] = "",
) -> None:
    """Fly one scenario to a link, a log, or both."""
    links = link or []
    if not links and tlog is None:
        raise _usage("nowhere to fly to: give a --link URL, a --tlog FILE, or both")
    pace = _speed(speed or ("1" if links else "max"))

    from companion.links import open_link
    from sim.flight import Flight
    from sim.scenario import load_scenario
    from sim.vehicle.flavours import FLAVOURS

    if flavour and flavour not in FLAVOURS:
        raise _usage(f"--flavour '{flavour}' is none of {', '.join(FLAVOURS)}")
    face = FLAVOURS[flavour].name if flavour else None
    config = load_scenario(scenario)
    opened: list[Link] = []
    with ExitStack() as stack:
        for url in links:
            opened.append(open_link(url))
            stack.callback(opened[-1].close)
        flight = Flight(
            config,
            links=opened,
            tlog=tlog,
            seed=seed,
            all_streams=all_streams,
            speed=pace,
            flavour=face,
        )
        summary = run_with_progress(flight)
    print_summary(summary, tlog, opened)


@app.command(epilog=_DEMO_EXAMPLES)
def demo(
    *,
    speed: Annotated[str, typer.Option(help="Times real time, or max.", metavar="X|max")] = "20",
    scenario: Annotated[
        str, typer.Option(help="Name of a scenario (see `list`).")
    ] = "weather-change",
    out: Annotated[
        Path, typer.Option(help="Folder for the log and the plot.", metavar="DIR")
    ] = Path("out/demo"),
) -> None:
    """Simulator and companion as two processes over UDP: watch the altitudes part while a front
    passes."""
    pace = _speed(speed)
    from sim.studies import demo as show

    print(
        f"starting the companion; then {scenario} flies at {speed}x, and the autopilot receives its ALTITUDE",
        flush=True,
    )
    tlog = show.fly(scenario, pace, out, _DemoTable().show, lambda text: print(text, flush=True))
    collector = show.judge(tlog)
    print(
        f"\n{'against truth, after the first minute (m)':42s}{'RMSE':>8s}{'95 %':>8s}{'max':>8s}{'bias':>8s}"
    )
    for label, found in show.errors(collector).items():
        print(
            f"{label:42s}{found.rmse_m:8.2f}{found.p95_m:8.2f}{found.max_m:8.2f}{found.bias_m:8.2f}"
        )
    picture = out / f"{scenario}.png"
    show.plot(collector, picture, f"{scenario}: what each source says, and by how much it is wrong")
    print(f"\nplot: {picture}\nlog:  {tlog} (try: kollsman replay {tlog})")


class _DemoTable:
    """A line every half simulated minute: truth, and what each source says beside its error."""

    PERIOD_S = 30

    def __init__(self) -> None:
        self._headed = False

    def show(self, now: "DemoRow") -> None:
        if round(now.time_s) % self.PERIOD_S:
            return
        if not self._headed:
            self._headed = True
            head = "".join(
                f"{name:>17s}" for name in ("GNSS", "barometer", "autopilot", "Kollsman")
            )
            print(f"\n{'time':>6s}  {'truth':>8s}{head}   leg", flush=True)
        cells = "".join(
            _beside(value, now.truth_m)
            for value in (now.gnss_m, now.baro_m, now.autopilot_m, now.kollsman_m)
        )
        minutes, seconds = divmod(round(now.time_s), 60)
        print(f"{minutes:3d}:{seconds:02d}  {now.truth_m:6.0f} m{cells}   {now.leg}", flush=True)


def _beside(value: float, truth: float) -> str:
    return f"{value:9.1f} {value - truth:+6.1f} " if math.isfinite(value) else f"{'-':>17s}"


app.command(epilog=fleet.CAMPAIGN_EXAMPLES)(fleet.campaign)
app.command(epilog=fleet.GALLERY_EXAMPLES)(fleet.gallery)


@app.command(name="list")
def list_scenarios(
    *,
    keys: Annotated[
        bool, typer.Option("--keys", help="Instead, every key of a scenario file, as Markdown.")
    ] = False,
) -> None:
    """Show the scenarios that come with the simulator."""
    if keys:
        from sim.scenario_keys import page

        print(page(), end="")
        return

    from rich.console import Console
    from rich.table import Table

    from sim.scenario import load_scenario, scenario_paths

    table = Table(box=None, pad_edge=False)
    table.add_column("scenario", style="bold")
    table.add_column("aircraft")
    table.add_column("what it is, and what it should show")
    for name in scenario_paths():
        scenario = load_scenario(name)
        table.add_row(name, scenario.aircraft, f"{scenario.summary} {scenario.expected}".strip())
    Console().print(table)


@app.command(epilog=_CORRUPT_EXAMPLES)
def corrupt(
    source: Annotated[
        Path | None, typer.Argument(help="The log to read.", metavar="IN.tlog")
    ] = None,
    target: Annotated[
        Path | None, typer.Argument(help="The log to write.", metavar="OUT.tlog")
    ] = None,
    *,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="May be given several times; the first acts first.", metavar="NAME[:key=value,...]"
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same bytes.")] = 1,
    show: Annotated[
        bool, typer.Option("--list", help="Show the faults and their parameters.")
    ] = False,
) -> None:
    """Copy a log with faults: packets lost, late or out of order, sensors that fail, clocks that
    jump."""
    if show:
        _print_faults()
        return
    if source is None or target is None or not fault:
        raise _usage(
            "give IN.tlog, OUT.tlog and at least one --fault NAME; --list shows the faults"
        )

    from rich.console import Console
    from rich.progress import Progress as ProgressBar

    from sim.faults import parse_fault
    from sim.studies.corrupt import corrupt as copy

    faults = [parse_fault(text) for text in fault]
    console = Console(stderr=True)
    with ProgressBar(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(source.name, total=None)
        found = copy(
            source,
            target,
            faults,
            seed,
            lambda done, total: bar.update(task, completed=done, total=total),
        )
    print(
        f"{target}: {found.written} of {found.read} packets written, {found.touched} of them changed or at another time"
    )


def _print_faults() -> None:
    from rich.console import Console
    from rich.table import Table

    from sim.faults import Fault
    from sim.studies.corrupt import parameters, table

    shown = Table(box=None, pad_edge=False)
    for title in ("fault", "parameter", "default", "allowed", "what it is"):
        shown.add_column(title, style="bold" if title == "fault" else None)
    for name, meaning, own in table():
        shown.add_row(name, "", "", "", meaning)
        for row in own:
            shown.add_row("", *row)
    shown.add_row("all of them", "", "", "", "have these too")
    for row in parameters(Fault, common=True):
        shown.add_row("", *row)
    Console().print(shown)


@app.command()
def reproduce(
    papers: Annotated[
        list[str] | None,
        typer.Argument(help="Key letters: H W C R K. Default: all.", metavar="[KEY]..."),
    ] = None,
    *,
    seeds: Annotated[
        int | None,
        typer.Option(min=2, help="Monte-Carlo runs a paper. Default: each paper's own number."),
    ] = None,
    out: Annotated[
        Path, typer.Option(help="Folder of the pages and figures.", metavar="DIR")
    ] = Path("out/papers"),
) -> None:
    """Rebuild the simulations of the five papers and hold the estimators against what they print."""
    from rich.console import Console
    from rich.progress import Progress as ProgressBar

    from sim.studies.papers import PAPERS
    from sim.studies.papers.page import summary

    keys = list(dict.fromkeys(key.upper() for key in papers or PAPERS))
    unknown = [key for key in keys if key not in PAPERS]
    if unknown:
        raise _usage(f"no paper '{unknown[0]}'; there are {', '.join(PAPERS)}")
    console = Console(stderr=True)
    with ProgressBar(console=console, transient=True, disable=not console.is_terminal) as bar:
        for key in keys:
            paper = PAPERS[key]
            task = bar.add_task(paper.slug, total=1.0)
            report = partial(_report_share, bar, task, paper.slug)
            page = paper.reproduce(seeds or paper.seeds, out, report)
            path = page.write()
            report(1.0, "done")
            print(f"{key}  {path}  {page.seeds} seeds: {summary(page.counts)}")


app.command(epilog=evaluation.EXAMPLES)(evaluation.evaluate)


def _report_share(bar: "Bar", task: "TaskID", name: str, fraction: float, what: str) -> None:
    bar.update(task, completed=fraction, description=f"{name}: {what}")


def run_with_progress(flight: "Flight") -> "Summary":
    """Fly with a progress line on stderr; SIGINT and SIGTERM end the flight in good order."""
    from rich.console import Console
    from rich.progress import Progress as ProgressBar
    from rich.progress import SpinnerColumn, TextColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"))
    console = Console(stderr=True)
    progress = ProgressBar(
        *columns, console=console, transient=True, disable=not console.is_terminal
    )
    with progress as bar, _stopped_by_signals(flight):
        return flight.run(_reporter(bar, flight.scenario.name))


def _reporter(bar: "Bar", name: str) -> "Callable[[Progress], None]":
    task = bar.add_task(name, total=None)

    def report(progress: "Progress") -> None:
        minutes, seconds = divmod(int(progress.time_s), 60)
        bar.update(
            task,
            description=f"{name}  {minutes:3d}:{seconds:02d}  {progress.truth.altitude_amsl_m:6.0f} m  "
            f"{progress.truth.climb_mps:+5.1f} m/s  {progress.speed_ratio:5.1f}x  {progress.leg}",
        )

    return report


@contextmanager
def _stopped_by_signals(flight: "Flight") -> Iterator[None]:
    def stop(*_: object) -> None:
        flight.stop()

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def print_summary(summary: "Summary", tlog: Path | None, links: "list[Link]") -> None:
    """What was flown, sent and heard."""
    minutes, seconds = divmod(summary.duration_s, 60)
    state = "flown" if summary.completed else "stopped"
    print(
        f"{state}: {minutes:.0f} min {seconds:.1f} s of flight in {summary.elapsed_s:.1f} s "
        f"({summary.speed_ratio:.1f}x real time)"
    )
    where = ", ".join([*([str(tlog)] if tlog else []), *(link.url for link in links)])
    total = summary.sent.total()
    print(f"sent: {total} messages, {summary.sent_bytes / 1e6:.2f} MB to {where}", end="")
    print(f" ({summary.dropped} dropped: nobody there)" if summary.dropped else "")
    print("  " + ", ".join(f"{name} {count}" for name, count in summary.sent.most_common()))
    if links:
        _print_heard(summary)


def _print_heard(summary: "Summary") -> None:
    heard = summary.heard
    if not heard.counts:
        print("heard: nothing")
        return
    onward = f", {summary.forwarded} of them sent on to another link" if summary.forwarded else ""
    print(f"heard: {heard.counts.total()} messages, {summary.received_bytes / 1e6:.2f} MB{onward}")
    sources: dict[tuple[int, int], list[str]] = {}
    for (system_id, component_id, name), count in heard.counts.most_common():
        sources.setdefault((system_id, component_id), []).append(f"{name} {count}")
    for (system_id, component_id), names in sorted(sources.items()):
        print(f"  {system_id}/{component_id}: {', '.join(names)}")
    if heard.altitude is not None and heard.altitude_us is not None:
        print(
            f"  last ALTITUDE: {heard.altitude.altitude_amsl:.1f} m AMSL at {heard.altitude_us / 1e6:.1f} s"
        )


def main() -> None:
    """Entry point: an error that the user can act on is one line on stderr and exit code 1; wrong
    usage is 2."""
    try:
        app()
    except KollsmanError as error:
        print(f"kollsman-sim: {error}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
