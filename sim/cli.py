"""The command ``kollsman-sim``. Modules named cli.py print; no others do.

The commands import the heavy packages (JSBSim, NumPy, pymavlink), so that ``--help`` is instant.
"""

import sys
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.common_cli import Commands, read_speed, version_option
from companion.errors import KollsmanError
from companion.log_cli import ExpectOption, JunitOption, hold_log
from sim.flight_cli import DemoTable, print_summary, run_with_progress
from sim.studies import cli as fleet
from sim.studies import limits_cli
from sim.studies.goals import cli as evaluation
from sim.studies.papers import cli as papers_cli

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

    from companion.links import Link

app = typer.Typer(
    name="kollsman-sim",
    cls=Commands,
    help="Simulate a MAVLink autopilot: JSBSim flies an aircraft model through weather.",
    no_args_is_help=True,
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
    kollsman-sim fly weather-change --flavour px4 --link udpout:127.0.0.1:14540 \\
      --link udpout:127.0.0.1:14550
  Twenty times as fast, to whoever connects, and to a log:
    kollsman-sim fly weather-change --link tcpin:0.0.0.0:5760 --speed 20 --tlog flight.tlog
  Your own scenario with a different seed:
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
    kollsman-sim corrupt flight.tlog bad.tlog --fault drop:probability=0.2 \\
      --fault delay:delay_s=1.5,jitter_s=1 --fault spike:quantity=pressure,size=200,probability=0.01
"""


def _usage(message: str) -> typer.Exit:
    """Print one line that says what is wrong with the command line; the exception exits with 2."""
    print(f"kollsman-sim: {message}", file=sys.stderr)
    return typer.Exit(2)


def _speed(text: str) -> float | None:
    """A factor of real time; None is as fast as possible."""
    try:
        return read_speed(text)
    except ValueError as error:
        raise _usage(f"--speed {error}") from None


_ScenarioArgument = Annotated[
    str, typer.Argument(help="Name of a scenario (see `list`), or the path of a .yaml file.")
]
_LinkOption = Annotated[
    list[str] | None,
    typer.Option(help="Link that carries MAVLink; may be given several times.", metavar="URL"),
]
_StationLinkOption = Annotated[
    str | None,
    typer.Option(
        help="Link of its own for the scenario's ground station; default: the vehicle's links.",
        metavar="URL",
    ),
]
_SpeedOption = Annotated[
    str,
    typer.Option(
        help="Simulated seconds a real second, or max. Default: 1 with a link, max to a log alone.",
        metavar="X|max",
    ),
]
_SeedOption = Annotated[
    int | None,
    typer.Option(
        min=0,
        help="Seed in place of the scenario's; the same seed gives the same bytes.",
        metavar="N",
    ),
]
_AllStreamsOption = Annotated[
    bool,
    typer.Option(
        "--all-streams", help="Send links the log's message rates, not the flavour's slow ones."
    ),
]
_FlavourOption = Annotated[
    str,
    typer.Option(
        help="Simulated autopilot: ardupilot (Plane), copter, px4 or generic. Default: the "
        "scenario's.",
        metavar="AUTOPILOT",
    ),
]


@app.callback()
def _options(
    *,
    version: Annotated[bool, version_option("kollsman-sim")] = False,
) -> None: ...


def _opened(urls: list[str], stack: ExitStack) -> "list[Link]":
    """The open links, which `stack` closes."""
    from companion.links import open_link

    opened: list[Link] = []
    for url in urls:
        opened.append(open_link(url))
        stack.callback(opened[-1].close)
    return opened


@app.command(epilog=_FLY_EXAMPLES)
def fly(
    scenario: _ScenarioArgument,
    *,
    link: _LinkOption = None,
    tlog: Annotated[
        Path | None, typer.Option(help="Log file of all messages at full rate.", metavar="OUT")
    ] = None,
    speed: _SpeedOption = "",
    seed: _SeedOption = None,
    all_streams: _AllStreamsOption = False,
    flavour: _FlavourOption = "",
    station_link: _StationLinkOption = None,
    expect: ExpectOption = None,
    junit: JunitOption = None,
) -> None:
    """Fly one scenario to a link, a log, or both."""
    links = link or []
    if not links and tlog is None:
        raise _usage("nothing receives the flight: give a --link URL, a --tlog FILE, or both")
    if expect and tlog is None:
        raise _usage("--expect is held against the log: give a --tlog FILE")
    pace = _speed(speed or ("1" if links else "max"))

    from companion.replay.expect import parse
    from sim.flight import Flight
    from sim.scenario import load_scenario
    from sim.vehicle.flavours import FLAVOURS

    if flavour and flavour not in FLAVOURS:
        raise _usage(f"--flavour '{flavour}' is unknown: give one of {', '.join(FLAVOURS)}")
    parse(expect or [])  # a mistake is told before the flight
    config = load_scenario(scenario)
    if station_link and config.ground_station is None:
        raise _usage(f"--station-link: '{config.name}' has no ground_station")
    with ExitStack() as stack:
        opened = _opened(links, stack)
        flight = Flight(
            config,
            links=opened,
            station_link=next(iter(_opened([station_link] if station_link else [], stack)), None),
            tlog=tlog,
            seed=seed,
            all_streams=all_streams,
            speed=pace,
            flavour=FLAVOURS[flavour].name if flavour else None,
        )
        summary = run_with_progress(flight)
    print_summary(summary, tlog, opened)
    if expect and tlog is not None:
        hold_log(f"kollsman-sim fly {scenario}", tlog, expect, junit)


@app.command(epilog=_DEMO_EXAMPLES)
def demo(
    *,
    speed: Annotated[
        str, typer.Option(help="Simulated seconds a real second, or max.", metavar="X|max")
    ] = "20",
    scenario: Annotated[
        str, typer.Option(help="Name of a scenario (see `list`).")
    ] = "weather-front",
    minutes: Annotated[
        float, typer.Option(help="Simulated minutes after which the flight ends.", min=1.0)
    ] = 20.0,
    out: Annotated[
        Path, typer.Option(help="Folder for the log and the plot.", metavar="DIR")
    ] = Path("out/demo"),
    http: Annotated[
        str | None,
        typer.Option(
            help="Serve the companion's live page there during the flight, such as 8080.",
            metavar="HOST:PORT",
        ),
    ] = None,
) -> None:
    """Fly a scenario with simulator and companion as two processes over UDP, and compare the
    altitudes."""
    pace = _speed(speed)
    from sim.studies import demo as show

    print(
        f"starting the companion; then {scenario} flies at {speed}x, and the autopilot receives "
        "its ALTITUDE",
        flush=True,
    )
    options = ["--http", http] if http else []
    tlog = show.fly(
        scenario,
        pace,
        out,
        DemoTable().show,
        lambda text: print(text, flush=True),
        options,
        limit_s=60.0 * minutes,
    )
    collector = show.judge(tlog)
    print(f"\n{show.error_table(collector)}")
    picture = out / f"{scenario}.png"
    show.plot(collector, picture, f"{scenario}: what each source says, and by how much it is wrong")
    print(f"\nplot:   {picture}\nlog:    {tlog} (try: kollsman replay {tlog})", flush=True)
    print(f"report: {show.report(tlog, scenario)} (open it in a browser)")


app.command(epilog=fleet.CAMPAIGN_EXAMPLES)(fleet.campaign)
app.command(epilog=fleet.GALLERY_EXAMPLES)(fleet.gallery)


@app.command(name="list")
def list_scenarios(
    *,
    keys: Annotated[
        bool, typer.Option("--keys", help="Print every key of a scenario file as Markdown.")
    ] = False,
) -> None:
    """List the scenarios of the simulator."""
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
    table.add_column("flight, and what it should show")
    for name in scenario_paths():
        scenario = load_scenario(name)
        table.add_row(name, scenario.aircraft, f"{scenario.summary} {scenario.about}".strip())
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
            help="Fault to inject; may be given several times, the first acts first.",
            metavar="NAME[:key=value,...]",
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of all faults; same seed, same bytes.", metavar="N")
    ] = 1,
    show: Annotated[
        bool, typer.Option("--list", help="List the faults and their parameters.")
    ] = False,
) -> None:
    """Copy a log and inject faults: lost, late or reordered packets, failed sensors, clock
    jumps."""
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
        report = partial(_report_packets, bar, task)
        found = copy(source, target, faults, seed, report)
    print(
        f"{target}: {found.written} of {found.read} packets written, {found.touched} of them "
        "changed or delayed"
    )


def _report_packets(bar: "Bar", task: "TaskID", done: int, total: int) -> None:
    bar.update(task, completed=done, total=total)


def _print_faults() -> None:
    from rich.console import Console
    from rich.table import Table

    from sim.faults import Fault
    from sim.studies.corrupt import parameters, table

    shown = Table(box=None, pad_edge=False)
    for title in ("fault", "parameter", "default", "allowed", "meaning"):
        shown.add_column(title, style="bold" if title == "fault" else None)
    for name, meaning, own in table():
        shown.add_row(name, "", "", "", meaning)
        for row in own:
            shown.add_row("", *row)
    shown.add_row("all faults", "", "", "", "have these parameters too")
    for row in parameters(Fault, common=True):
        shown.add_row("", *row)
    Console().print(shown)


app.command(epilog=evaluation.EXAMPLES)(evaluation.evaluate)
app.command(epilog=fleet.FEEDBACK_EXAMPLES)(fleet.feedback)
app.command(epilog=limits_cli.EXAMPLES)(limits_cli.limits)
app.command(epilog=papers_cli.EXAMPLES)(papers_cli.reproduce)


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
