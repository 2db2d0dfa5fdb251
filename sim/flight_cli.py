"""Progress line, summary and demonstration table of a flight on the terminal; like `sim.cli`, it
prints."""

import math
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

    from companion.links import Link
    from sim.flight import Flight, Progress, Summary
    from sim.studies.demo import DemoRow


class DemoTable:
    """Prints one line each half simulated minute: the truth, and the altitude and error of each
    source."""

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


def run_with_progress(flight: "Flight") -> "Summary":
    """Fly with a progress line on stderr; SIGINT and SIGTERM end the flight and close its log."""
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
            description=f"{name}  {minutes:3d}:{seconds:02d}  "
            f"{progress.truth.altitude_amsl_m:6.0f} m  "
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
    """Print the duration of the flight, the messages it sent and the messages it received."""
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
            f"  last ALTITUDE: {heard.altitude.altitude_amsl:.1f} m AMSL at "
            f"{heard.altitude_us / 1e6:.1f} s"
        )
