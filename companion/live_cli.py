"""The command ``kollsman run``. What it prints goes through `output`, which never blocks or
raises."""

import json
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from companion.common_cli import (
    ConfigOption,
    EstimatorOption,
    SetOption,
    compile_for,
    is_quiet,
    resolve_settings,
)
from companion.output import Output, use_json
from companion.status_lines import Reporter, reporter

if TYPE_CHECKING:
    from companion.links import Link
    from companion.service import Service
    from companion.settings import CompanionSettings
    from companion.web.settings import HttpSettings

RUN_EXAMPLES = """\b
Examples:
  SITL or a router that sends to us:        kollsman run udpin:0.0.0.0:14550
  ArduPilot SITL:                           kollsman run tcp:127.0.0.1:5762
  A Pixhawk on a Raspberry Pi's UART:       kollsman run /dev/ttyAMA0:921600
  A Pixhawk on USB, recorded:               kollsman run /dev/ttyACM0 --record flights/
  Autopilot and ground station, no router:
    kollsman run /dev/ttyAMA0:921600 --link udpout:192.168.1.20
  With a page for a browser:                kollsman run udpin:0.0.0.0:14550 --http 8080
"""

DOCTOR_EXAMPLES = """\b
Examples:
  kollsman doctor /dev/ttyAMA0:57600
  kollsman doctor udpin:0.0.0.0:14550 --seconds 30
"""

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


LinkArgument = Annotated[
    str,
    typer.Argument(
        help="Where the autopilot is; `kollsman links` lists the forms.", envvar="KOLLSMAN_LINK"
    ),
]
MoreOption = Annotated[
    list[str] | None,
    typer.Option(
        "--link",
        help="Another link, such as a ground station's; repeatable. MAVLink is routed between all "
        "of them.",
        metavar="LINK",
        envvar="KOLLSMAN_LINKS",
    ),
]
RecordOption = Annotated[
    str | None,
    typer.Option(
        help="Record every frame heard and sent: a folder (one dated file a session), a file, or a "
        "strftime pattern. An existing file is never overwritten.",
        metavar="DIR",
        envvar="KOLLSMAN_RECORD",
    ),
]
HttpOption = Annotated[
    str | None,
    typer.Option(
        "--http",
        help="Serve the live page, /metrics, /healthz and /api/state there, such as "
        "127.0.0.1:8080; read-only. Default: not served.",
        metavar="HOST:PORT",
        envvar="KOLLSMAN_HTTP",
    ),
]
SystemIdOption = Annotated[
    int | None, typer.Option(min=1, max=255, help="Our system id; default: the vehicle's.")
]
ComponentIdOption = Annotated[
    int | None, typer.Option(min=1, max=255, help="Our component id (default 191).")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Status and log lines as JSON objects.")]


def run(
    link: LinkArgument,
    *,
    more: MoreOption = None,
    estimator: EstimatorOption = None,
    config: ConfigOption = None,
    changes: SetOption = None,
    record: RecordOption = None,
    http: HttpOption = None,
    system_id: SystemIdOption = None,
    component_id: ComponentIdOption = None,
    as_json: JsonOption = False,
) -> None:
    """Serve a vehicle: read its sensors, send back ALTITUDE and the DEBUG family, until Ctrl-C."""
    started_s = time.perf_counter()
    if as_json:
        use_json()
    telling = reporter(Output(), as_json=as_json, is_quiet=is_quiet())
    with closing(telling):
        settings = resolve_settings(config, estimator, changes)
        settings = _with_options(settings, record, http, system_id, component_id)
        _serve([link, *(more or [])], settings, telling, started_s)


def _serve(
    urls: list[str], settings: "CompanionSettings", telling: Reporter, started_s: float
) -> None:
    """Open the links and serve the vehicle on them until a stop signal."""
    from companion.checkpoint import Checkpoint, fingerprint
    from companion.clock import SystemClock
    from companion.key_file import open_signing
    from companion.links import open_links
    from companion.recording import Recording
    from companion.restarts import serve
    from companion.service import Service

    clock = SystemClock()
    signing = open_signing(settings.signing)
    with ExitStack() as stack, _stop_signals() as stopped:
        opened = open_links(urls, clock)
        stack.callback(opened.close)
        path = settings.record.path
        recorder = stack.enter_context(Recording(path, settings.record)) if path else None
        page = _live_page(settings.http, stack, telling)
        compile_for(settings, [settings.estimator], telling.starting)
        keeper = Checkpoint(settings.checkpoint, [opened.url], fingerprint(settings))
        build = partial(
            Service, opened, settings, clock, recorder=recorder, checkpoint=keeper, signing=signing
        )
        services: list[Service] = []

        def make() -> Service:
            services[:] = [build(earlier=services[0] if services else None)]
            return services[0]

        def run_one(service: Service) -> None:
            telling.ready(service, time.perf_counter() - started_s)
            service.run(lambda: bool(stopped), telling.show, page(service) if page else None)

        _drain(opened)
        serve(make, run_one, clock)
        stack.close()
        paths = [str(path) for path in recorder.paths] if recorder is not None else []
        telling.stopped(services[0].summary(), paths)


def _live_page(
    settings: "HttpSettings", stack: ExitStack, telling: Reporter
) -> "Callable[[Service], Callable[[], None]] | None":
    """Serve the live page where the settings want one. What it returns takes a service, and gives
    what to call after each turn of its loop."""
    if settings.address is None:
        return None
    from companion.web.board import Board
    from companion.web.server import WebServer
    from companion.web.settings import read_address
    from companion.web.snapshot import Snapshots

    board, address = Board(), read_address(settings.address)
    server = WebServer(address, board, settings.hosts)
    stack.callback(server.close)
    server.start()
    reach = "" if address.is_loopback else "; every machine that reaches this one can read it"
    telling.event("http", f"live page: {server.url}{reach}", url=server.url)
    return lambda service: Snapshots(service, board).poll


def _drain(link: "Link") -> None:
    """Discard what arrived while the code was compiled or loaded: it is old."""
    end_s = time.monotonic() + 1.0
    while link.receive(0.0) and time.monotonic() < end_s:
        pass


def _with_options(
    settings: "CompanionSettings",
    record: str | None,
    http: str | None,
    system_id: int | None,
    component_id: int | None,
) -> "CompanionSettings":
    ids = {"system_id": system_id, "component_id": component_id}
    given = {key: value for key, value in ids.items() if value is not None}
    changes = {"identity": settings.identity.model_dump() | given}
    if record is not None:
        changes["record"] = settings.record.model_dump() | {"path": record}
    if http is not None:
        changes["http"] = settings.http.model_dump() | {"address": http}
    return settings.with_changes(**changes)


@contextmanager
def _stop_signals() -> Iterator[list[int]]:
    """SIGINT, SIGTERM and SIGHUP ask for a clean stop; a second SIGINT is an ordinary interrupt.

    SIGHUP stays ignored under nohup. SIGINT does not: shells start background jobs with it ignored,
    and whoever sends it all the same means it.
    """
    received: list[int] = []

    def stop(number: int, _frame: object) -> None:
        if number == signal.SIGINT and number in received:
            raise KeyboardInterrupt
        received.append(number)

    before = {
        number: signal.signal(number, stop)
        for number in STOP_SIGNALS
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def doctor(
    link: Annotated[
        str,
        typer.Argument(
            help="Where the autopilot is; `kollsman links` lists the forms.",
            envvar="KOLLSMAN_LINK",
        ),
    ],
    *,
    config: ConfigOption = None,
    seconds: Annotated[
        float, typer.Option(min=1, max=3600, help="Time to listen, s.", metavar="S")
    ] = 15.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Listen to a vehicle, and report what is heard, what is missing and which parameter to set.

    Exit code 1 when something is wrong.
    """
    from companion.terminal import starting

    with starting(Output(2)) as shown:
        settings = resolve_settings(config, None)
        compile_for(settings, [settings.estimator], shown)

    from companion import doctor as examining
    from companion.clock import SystemClock
    from companion.links import open_link

    clock, output = SystemClock(), Output()
    opened = open_link(link, clock)
    with ExitStack() as stack:
        stack.callback(opened.close)
        case, findings = examining.examine(opened, settings, clock, seconds)
    if as_json:
        listed = [
            {"grade": each.grade.name.lower(), "what": each.what, "cure": each.cure}
            for each in findings
        ]
        heard = [line.strip() for line in examining.report(case, [])]
        output.line(json.dumps({"findings": listed, "heard": heard}, ensure_ascii=False))
    else:
        for line in examining.report(case, findings):
            output.line(line)
    if any(each.grade is examining.Grade.WRONG for each in findings):
        raise typer.Exit(1)
