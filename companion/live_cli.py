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
    LinkArgument,
    SetOption,
    resolve_settings,
    say_if_compiling,
)
from companion.notify import Notifier
from companion.output import Output, set_up_logging, timestamp

if TYPE_CHECKING:
    from companion.clock import Clock
    from companion.interim import Interim
    from companion.links import Link
    from companion.service import Service
    from companion.settings import CompanionSettings
    from companion.status import Status
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

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


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
    ids = {"system_id": system_id, "component_id": component_id}
    given = [f"identity.{key}={value}" for key, value in ids.items() if value is not None]
    changes = [*(changes or []), *given]

    def resolve() -> "CompanionSettings":
        settings = _with_options(resolve_settings(config, estimator, changes), record, http)
        say_if_compiling(settings.estimator)
        return settings

    from companion.interim import begin

    early = partial(begin, config=config, changes=changes)
    _serve([link, *(more or [])], early, resolve, Output(), started_s, as_json=as_json)


def _serve(
    urls: list[str],
    early: "Callable[[Link, Clock], Interim | None]",
    resolve: "Callable[[], CompanionSettings]",
    output: Output,
    started_s: float,
    *,
    as_json: bool,
) -> None:
    """Open the links and serve the vehicle on them until a stop signal.

    Parameters
    ----------
    early : begins to send on the autopilot's own height; None where the settings are wrong.
    resolve : the settings, which takes long: the estimators are imported.
    """
    from companion.clock import SystemClock
    from companion.links import open_links

    clock = SystemClock()
    with ExitStack() as stack, _stop_signals() as stopped:
        opened = open_links(urls, clock)
        stack.callback(opened.close)
        interim = early(opened, clock)
        if interim is not None:
            stack.callback(interim.stop)
        settings = resolve()
        assert interim is not None, "settings that are wrong raise"
        _run(opened, interim, settings, clock, stopped, output, started_s, as_json=as_json)


def _run(
    opened: "Link",
    interim: "Interim",
    settings: "CompanionSettings",
    clock: "Clock",
    stopped: list[int],
    output: Output,
    started_s: float,
    *,
    as_json: bool,
) -> None:
    """Serve the vehicle on the open link until a signal is in `stopped`."""
    with ExitStack() as stack:
        from companion.checkpoint import Checkpoint, fingerprint
        from companion.recording import Recording
        from companion.restarts import serve
        from companion.service import Service
        from companion.warmup import warm_up

        path = settings.record.path
        recorder = stack.enter_context(Recording(path, settings.record)) if path else None
        page = _live_page(settings.http, stack, output, as_json=as_json)
        warm_up(settings)
        keeper = Checkpoint(settings.checkpoint, [opened.url], fingerprint(settings))
        build = partial(
            Service,
            opened,
            settings,
            clock,
            recorder=recorder,
            checkpoint=keeper,
            follows=interim.identity,
            signing=interim.signing,
        )
        lines: StatusLine | None = None

        def make() -> Service:
            return build(earlier=lines.service if lines is not None else None)

        def run_one(service: Service) -> None:
            nonlocal lines
            lines = StatusLine(service, output, as_json=as_json)
            lines.ready(time.perf_counter() - started_s)
            service.run(lambda: bool(stopped), lines.show, page(service) if page else None)

        interim.stop()
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


def _with_options(
    settings: "CompanionSettings", record: str | None, http: str | None
) -> "CompanionSettings":
    changes: dict[str, Any] = {}
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
