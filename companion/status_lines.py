"""What `kollsman run` tells its user: a display on a terminal, lines elsewhere, JSON objects.

Each reporter also tells systemd. None ever blocks or raises (`companion.output`).
"""

import dataclasses
import json
import math
import time
from typing import TYPE_CHECKING, Any

from companion.notify import Notifier
from companion.output import Output, timestamp

if TYPE_CHECKING:
    from rich.console import RenderableType

    from companion.service import Service
    from companion.status import Status
    from companion.terminal import Starting

PLAIN_PERIOD_S = 60.0
HEALTH_STYLES = {"OK": "bold green", "DEGRADED": "bold yellow", "LOST": "bold red"}


class Reporter:
    """Tells systemd only: what ``-q`` leaves."""

    def __init__(self) -> None:
        self._notifier = Notifier()

    def event(self, event: str, text: str, **fields: Any) -> None:
        """Something happened once: ready, http."""

    @property
    def starting(self) -> "Starting | None":
        """What shows the progress of the start; None where nothing does."""
        return None

    def ready(self, service: "Service", elapsed_s: float) -> None:
        """A service is about to start."""
        self._notifier.ready()
        estimator, url = service.settings.estimator, service.link.url
        text = f"ready in {elapsed_s:.1f} s: {estimator} on {url}; Ctrl-C stops"
        start_s = round(elapsed_s, 1)
        self.event("ready", text, start_s=start_s, estimator=estimator, link=url)

    def show(self, status: "Status") -> None:
        """The service goes on."""
        self._notifier.alive(format_status(status))
        self.status(status)

    def status(self, status: "Status") -> None:
        """Show the status where that is due."""

    def stopped(self, summary: str, paths: list[str]) -> None:
        """The service has ended; `paths` are its recordings."""
        self._notifier.stopping()
        self._notifier.close()
        self.close()
        lines = [f"stopped: {summary}", *(f"recorded {path}" for path in paths)]
        self.event("stopped", "\n".join(lines), summary=summary, recorded=paths)

    def close(self) -> None:
        """Show nothing any more; closing twice is fine."""


class Lines(Reporter):
    """A line a minute, and at each change of the health, the vehicle or the link."""

    def __init__(self, output: Output) -> None:
        super().__init__()
        self._output = output
        self._told: Any = None
        self._told_s = 0.0

    def event(self, event: str, text: str, **fields: Any) -> None:
        self._output.line(text)

    def status(self, status: "Status") -> None:
        now_s, state = time.monotonic(), (status.health, status.vehicle, status.link)
        if state == self._told and now_s - self._told_s < PLAIN_PERIOD_S:
            return
        self._told, self._told_s = state, now_s
        self.line(status)

    def line(self, status: "Status") -> None:
        """Write the status."""
        self._output.line(format_status(status))


class Objects(Lines):
    """The same as JSON: each line is an object with ``event``."""

    def event(self, event: str, text: str, **fields: Any) -> None:
        head = {"time": timestamp(time.time()), "event": event}
        self._output.line(json.dumps(head | _finite(fields), ensure_ascii=False, default=str))

    def line(self, status: "Status") -> None:
        fields = dataclasses.asdict(status) | {"health": status.health.name}
        self.event("status", "", **fields)


class Display(Reporter):
    """A few rows at the end of a terminal that stay up to date; log lines are printed above."""

    def __init__(self, output: Output) -> None:
        from companion.terminal import Screen, Starting

        super().__init__()
        self._starting = Starting()
        self._screen = Screen(output, self._starting)
        self._screen.open()
        self._status: Status | None = None
        self._is_open = True

    @property
    def starting(self) -> "Starting | None":
        return self._starting

    def event(self, event: str, text: str, **fields: Any) -> None:
        self._screen.line(text)

    def status(self, status: "Status") -> None:
        self._status = status
        self._screen.content = self._rows

    def close(self) -> None:
        if self._is_open:
            self._is_open = False
            self._screen.close(keep=self._status is not None)

    def _rows(self) -> "RenderableType":
        """The status in rows that fit any width."""
        from rich.console import Group
        from rich.text import Text

        status = self._status
        assert status is not None
        health = Text(f"{status.health.name:9s}", HEALTH_STYLES[status.health.name])
        rows = [
            health.append(status.reason, "default"),
            Text(f"{'altitude':9s}").append(_altitude(status), "bold"),
            Text(f"{'Hz':9s}{_rates(status)}"),
            Text(f"{'vehicle':9s}{status.vehicle} | {status.link}{_loss(status)}"),
        ]
        for row in rows:
            row.no_wrap, row.overflow = True, "ellipsis"
        return Group(*rows)


def reporter(output: Output, *, as_json: bool, is_quiet: bool) -> Reporter:
    """The reporter that suits `output`."""
    if is_quiet:
        return Reporter()
    if as_json:
        return Objects(output)
    from companion.terminal import can_redraw

    return Display(output) if can_redraw(output) else Lines(output)


def _finite(value: Any) -> Any:
    """`value` with None for what JSON cannot hold."""
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _altitude(status: "Status") -> str:
    if math.isnan(status.altitude_amsl_m):
        return "no altitude"
    level = f"  level {status.protection_level_m:.0f}" if status.protection_level_m > 0 else ""
    return (
        f"{status.altitude_amsl_m:8.1f} m  sd {status.altitude_sd_m:4.1f}{level}"
        f"  {status.climb_mps:+5.1f} m/s"
    )


def _rates(status: "Status") -> str:
    shown = ("pressure", "gnss", "imu", "altitude")
    return "  ".join(f"{name} {status.rates_hz.get(name, 0.0):.0f}" for name in shown)


def _loss(status: "Status") -> str:
    ids = status.vehicle.split()[0]
    heard = [senders[ids] for senders in status.traffic.values() if ids in senders]
    frames, lost = (sum(each[name] for each in heard) for name in ("frames", "lost"))
    return f"  lost {100 * lost / (frames + lost):.1f} %" if lost else ""


def format_status(status: "Status") -> str:
    """`status` as one readable line."""
    return (
        f"{status.health.name:8s} {_altitude(status)} | Hz: {_rates(status)} | {status.vehicle}"
        f" | {status.link}{_loss(status)} | {status.reason}"
    )
