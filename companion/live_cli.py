"""The command ``kollsman run``. What it prints goes through `output`, which never blocks or
raises."""

import dataclasses
import json
import logging
import math
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from companion.common_cli import (
    ConfigOption,
    EstimatorOption,
    SetOption,
    resolve_settings,
    say_if_compiling,
)
from companion.notify import Notifier
from companion.output import Output, set_up_logging, timestamp

if TYPE_CHECKING:
    from companion.links import Link
    from companion.service import Service, Status
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
        set_up_logging(logging.getLogger().level, as_json=True)
    settings = resolve_settings(config, estimator, changes)
    say_if_compiling(settings.estimator)
    settings = _with_options(settings, record, http, system_id, component_id)
    _serve([link, *(more or [])], settings, Output(), started_s, as_json=as_json)


def _serve(
    urls: list[str],
    settings: "CompanionSettings",
    output: Output,
    started_s: float,
    *,
    as_json: bool,
) -> None:
    """Open the links and serve the vehicle on them until a stop signal."""
    from companion.checkpoint import Checkpoint, fingerprint
    from companion.clock import SystemClock
    from companion.key_file import open_signing
    from companion.links import open_links
    from companion.recording import Recording
    from companion.restarts import serve
    from companion.service import Service
    from companion.warmup import warm_up

    clock = SystemClock()
    signing = open_signing(settings.signing)
    with ExitStack() as stack, _stop_signals() as stopped:
        opened = open_links(urls, clock)
        stack.callback(opened.close)
        path = settings.record.path
        recorder = stack.enter_context(Recording(path, settings.record)) if path else None
        page = _live_page(settings.http, stack, output, as_json=as_json)
        warm_up(settings)
        keeper = Checkpoint(settings.checkpoint, [opened.url], fingerprint(settings))
        build = partial(
            Service, opened, settings, clock, recorder=recorder, checkpoint=keeper, signing=signing
        )
        lines: StatusLine | None = None

        def make() -> Service:
            return build(earlier=lines.service if lines is not None else None)

        def run_one(service: Service) -> None:
            nonlocal lines
            lines = StatusLine(service, output, as_json=as_json)
            lines.ready(time.perf_counter() - started_s)
            service.run(lambda: bool(stopped), lines.show, page(service) if page else None)

        _drain(opened)
        serve(make, run_one, clock)
        stack.close()
        if lines is not None:
            lines.stopped(recorder)


def _live_page(
    settings: "HttpSettings", stack: ExitStack, output: Output, *, as_json: bool
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
    if as_json:
        head = {"time": timestamp(time.time()), "event": "http"}
        output.line(json.dumps(head | {"url": server.url}))
    else:
        reach = "" if address.is_loopback else "; every machine that reaches this one can read it"
        output.line(f"live page: {server.url}{reach}")
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


class StatusLine:
    """One line that is rewritten on a terminal; elsewhere a line a minute and at each change of
    health. As JSON each is an object with ``event``: ready, status, stopped."""

    PLAIN_PERIOD_S = 60.0

    def __init__(self, service: "Service", output: Output, *, as_json: bool = False) -> None:
        self.service = service
        self._output = output
        self._json = as_json
        self._terminal = output.is_terminal and not as_json
        self._last: tuple[Any, float] = (None, 0.0)
        self._notifier = Notifier()

    def ready(self, elapsed_s: float) -> None:
        """The service is about to start."""
        self._notifier.ready()
        estimator, url = self.service.settings.estimator, self.service.link.url
        if self._json:
            self._object("ready", start_s=round(elapsed_s, 1), estimator=estimator, link=url)
        else:
            self._output.line(f"ready in {elapsed_s:.1f} s: {estimator} on {url}; Ctrl-C stops")

    def show(self, status: "Status") -> None:
        """The service goes on."""
        self._notifier.alive(format_status(status))
        if self._terminal:
            self._output.write(f"\r\x1b[2K{format_status(status)}")
            return
        health, when_s = self._last
        now_s = time.monotonic()
        if health == status.health and now_s - when_s < self.PLAIN_PERIOD_S:
            return
        self._last = (status.health, now_s)
        if self._json:
            self._object("status", **dataclasses.asdict(status) | {"health": status.health.name})
        else:
            self._output.line(format_status(status))

    def stopped(self, recorder: Any) -> None:
        """The service has ended."""
        self._notifier.stopping()
        self._notifier.close()
        paths = [str(path) for path in recorder.paths] if recorder is not None else []
        if self._json:
            self._object("stopped", summary=self.service.summary(), recorded=paths)
            return
        start = "\n" if self._terminal else ""
        self._output.line(f"{start}stopped: {self.service.summary()}")
        for path in paths:
            self._output.line(f"recorded {path}")

    def _object(self, event: str, **fields: Any) -> None:
        head = {"time": timestamp(time.time()), "event": event}
        self._output.line(json.dumps(head | _finite(fields), ensure_ascii=False, default=str))


def _finite(value: Any) -> Any:
    """`value` with None for what JSON cannot hold."""
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def format_status(status: "Status") -> str:
    """`status` as one readable line."""
    if status.altitude_amsl_m == status.altitude_amsl_m:
        level = f"  level {status.protection_level_m:.0f}" if status.protection_level_m > 0 else ""
        altitude = (
            f"{status.altitude_amsl_m:8.1f} m  sd {status.altitude_sd_m:4.1f}{level}"
            f"  {status.climb_mps:+5.1f} m/s"
        )
    else:
        altitude = "no altitude"
    shown = ("pressure", "gnss", "imu", "altitude")
    rates = "  ".join(f"{name} {status.rates_hz.get(name, 0.0):.0f}" for name in shown)
    ids = status.vehicle.split()[0]
    heard = [senders[ids] for senders in status.traffic.values() if ids in senders]
    frames, lost = (sum(each[name] for each in heard) for name in ("frames", "lost"))
    loss = f"  lost {100 * lost / (frames + lost):.1f} %" if lost else ""
    return (
        f"{status.health.name:8s} {altitude} | Hz: {rates} | {status.vehicle} | {status.link}{loss}"
        f" | {status.reason}"
    )


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
    settings = resolve_settings(config, None)
    say_if_compiling(settings.estimator)

    from companion import doctor as examining
    from companion.clock import SystemClock
    from companion.links import open_link
    from companion.warmup import warm_up

    clock, output = SystemClock(), Output()
    warm_up(settings)
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
