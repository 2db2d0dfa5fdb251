"""The command ``kollsman run``. What it prints goes through `output`, which never blocks or
raises."""

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from companion.common_cli import (
    ConfigOption,
    EstimatorOption,
    LinkArgument,
    SetOption,
    compile_for,
    is_quiet,
    resolve_settings,
)
from companion.output import Output, use_json
from companion.status_lines import Reporter, reporter

if TYPE_CHECKING:
    from companion.clock import Clock
    from companion.interim import Interim
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

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StoppedEarly(BaseException):
    """A stop signal before the service was ready: compiling may last minutes more."""


@dataclass
class Stop:
    """The stop signals received so far."""

    received: list[int] = field(default_factory=list)
    is_ready: bool = False
    """whether the service looks at `received`; before, a signal raises `StoppedEarly`"""


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
    int | None,
    typer.Option(min=1, max=255, help="Our system id; default: the vehicle's.", metavar="N"),
]
ComponentIdOption = Annotated[
    int | None, typer.Option(min=1, max=255, help="Our component id (default 191).", metavar="N")
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
    ids = {"system_id": system_id, "component_id": component_id}
    given = [f"identity.{key}={value}" for key, value in ids.items() if value is not None]
    changes = [*(changes or []), *given]

    def resolve() -> "CompanionSettings":
        return _with_options(resolve_settings(config, estimator, changes), record, http)

    from companion.interim import begin

    early = partial(begin, config=config, changes=changes)
    telling = reporter(Output(), as_json=as_json, is_quiet=is_quiet())
    with closing(telling):
        try:
            _serve([link, *(more or [])], early, resolve, telling, started_s)
        except StoppedEarly:
            telling.stopped("before the service was ready", [])


def _serve(
    urls: list[str],
    early: "Callable[[Link, Clock], Interim | None]",
    resolve: "Callable[[], CompanionSettings]",
    telling: Reporter,
    started_s: float,
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
    with ExitStack() as stack, _stop_signals() as stop:
        opened = open_links(urls, clock)
        stack.callback(opened.close)
        interim = early(opened, clock)
        if interim is not None:
            stack.callback(interim.stop)
        settings = resolve()
        assert interim is not None, "settings that are wrong raise"
        _run(opened, interim, settings, clock, stop, telling, started_s)


def _run(
    opened: "Link",
    interim: "Interim",
    settings: "CompanionSettings",
    clock: "Clock",
    stop: Stop,
    telling: Reporter,
    started_s: float,
) -> None:
    """Serve the vehicle on the open link until `stop` has a signal."""
    with ExitStack() as stack:
        from companion.checkpoint import Checkpoint, fingerprint
        from companion.recording import Recording
        from companion.reference_link import open_reference
        from companion.restarts import serve
        from companion.service import Service

        path = settings.record.path
        recorder = stack.enter_context(Recording(path, settings.record)) if path else None
        page = _live_page(settings.http, stack, telling)
        compile_for(settings, [settings.estimator], telling.starting)
        reference = open_reference(settings.air, stack, clock)
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
            reference=reference,
        )
        services: list[Service] = []

        def make() -> Service:
            services[:] = [build(earlier=services[0] if services else None)]
            return services[0]

        def run_one(service: Service) -> None:
            telling.ready(service, time.perf_counter() - started_s)
            service.run(lambda: bool(stop.received), telling.show, page(service) if page else None)

        stop.is_ready = True
        interim.stop()
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
    from companion.web.server import serve
    from companion.web.snapshot import Snapshots

    board, server = serve(settings.address, settings, stack)
    telling.event("http", server.told, url=server.url)
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


@contextmanager
def _stop_signals() -> Iterator[Stop]:
    """SIGINT, SIGTERM and SIGHUP ask for a clean stop; a second SIGINT is an ordinary interrupt.
    Before the service is ready, they end the block of this manager at once.

    SIGHUP stays ignored under nohup. SIGINT does not: shells start background jobs with it ignored,
    and whoever sends it all the same means it.
    """
    asked = Stop()

    def stop(number: int, _frame: object) -> None:
        if number == signal.SIGINT and number in asked.received:
            raise KeyboardInterrupt
        asked.received.append(number)
        if not asked.is_ready and len(asked.received) == 1:
            raise StoppedEarly

    before = {
        number: signal.signal(number, stop)
        for number in STOP_SIGNALS
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
