"""The demonstration: this process is the simulated autopilot, a second one the companion, UDP on
loopback between.

What is judged at the end is what the autopilot's side received: our ALTITUDE messages against the
truth of the flight, beside the receiver's height, the barometer's and the autopilot's own estimate.
"""

import math
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from companion.errors import SimulationError
from companion.evaluation.metrics import Errors, truth_at
from companion.evaluation.report import Collector
from companion.kernels.atmosphere import baro_altitude_m
from companion.links import open_link
from companion.logs.tlog import TlogReader
from companion.mavlink.codec import Decoder, mavlink
from companion.mavlink.identity import OUR_COMPONENT_ID
from companion.pipeline import Pipeline
from companion.plots.drawing import GAP_S, figure, legend_outside, tell_clipped, unbroken, write_png
from companion.plots.ranges import error_range
from companion.plots.style import INK, SOURCES
from companion.replay.reports import write_reports
from companion.replay.run import replay
from companion.settings import CompanionSettings
from sim.flight import Flight, Progress
from sim.scenario import load_scenario

READY_TIMEOUT_S = 180.0
STOP_TIMEOUT_S = 10.0
LABELS = {
    "published": "Kollsman, as received",
    "autopilot": "autopilot's own",
    "gnss": "raw GNSS",
    "baro": "raw barometer",
}


@dataclass(frozen=True)
class DemoRow:
    """Heights on the autopilot's side at one simulated second; unknown is NaN."""

    time_s: float
    leg: str
    truth_m: float
    gnss_m: float
    baro_m: float
    autopilot_m: float
    kollsman_m: float


class Companion:
    """The companion in a process of its own; its output goes to `log`."""

    def __init__(
        self, url: str, log: Path, say: Callable[[str], None], options: Sequence[str] = ()
    ) -> None:
        command = [sys.executable, "-m", "companion.cli", "run", url, *options]
        self._log = log.open("w", encoding="utf-8")
        self._process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self._ready = threading.Event()
        self._say = say
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def wait_until_ready(self) -> None:
        """Wait for its line "ready"; the first start after an installation compiles."""
        for _ in range(round(READY_TIMEOUT_S * 10)):
            if self._ready.wait(0.1):
                return
            if self._process.poll() is not None:
                break
        raise SimulationError(f"the companion did not start; its output is in {self._log.name}")

    def stop(self) -> None:
        """End it as Ctrl-C does, and wait."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join(STOP_TIMEOUT_S)
        self._log.close()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _read(self) -> None:
        for line in self._process.stdout or ():
            self._log.write(line)
            self._log.flush()
            if line.startswith(("compiling", "live page")):
                self._say(f"companion: {line.strip()}")
            if line.startswith("ready"):
                self._say(f"companion: {line.strip()}")
                self._ready.set()


def free_port() -> int:
    """A UDP port on loopback that is free now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def fly(
    scenario: str,
    speed: float | None,
    out: Path,
    show: Callable[[DemoRow], None],
    say: Callable[[str], None],
    options: Sequence[str] = (),
    *,
    limit_s: float = math.inf,
) -> Path:
    """Fly `scenario`, `limit_s` of it at most, with a companion (with `options`) at the other end
    of a UDP socket; the log, with what came back in it."""
    out.mkdir(parents=True, exist_ok=True)
    tlog = out / f"{scenario}.tlog"
    port = free_port()
    companion = Companion(f"udpin:127.0.0.1:{port}", out / "companion.txt", say, options)
    try:
        companion.wait_until_ready()
        link = open_link(f"udpout:127.0.0.1:{port}")
        try:
            flight = Flight(load_scenario(scenario), links=[link], tlog=tlog, speed=speed)

            def on_progress(progress: Progress) -> None:
                show(reading(flight, progress))
                if progress.time_s >= limit_s:
                    flight.stop()

            summary = flight.run(on_progress)
        finally:
            link.close()
    finally:
        companion.stop()
    came = sum(
        count
        for (_, sender, _), count in summary.heard.counts.items()
        if sender == OUR_COMPONENT_ID
    )
    say(
        f"flown in {summary.elapsed_s:.0f} s ({summary.speed_ratio:.0f}x); {came} messages came "
        "back from the companion"
    )
    return tlog


def reading(flight: Flight, progress: Progress) -> DemoRow:
    """The values of the vehicle's last messages."""
    state, altitude = flight.vehicle.state, flight.vehicle.heard.altitude
    fix = state.fix
    return DemoRow(
        progress.time_s,
        progress.leg,
        progress.truth.altitude_amsl_m,
        fix.altitude_amsl_m if fix is not None and fix.fix_type >= 3 else math.nan,
        baro_altitude_m(state.pressure.pressure_pa) if state.pressure is not None else math.nan,
        state.position.altitude_amsl_m if state.position is not None else math.nan,
        altitude.altitude_amsl if altitude is not None else math.nan,
    )


def judge(tlog: Path) -> Collector:
    """Truth, sensors and the autopilot's own height out of the flight's log, and the ALTITUDE that
    came back."""
    collector = Collector()
    pipeline = Pipeline(CompanionSettings(), datagrams=True)
    decoder = Decoder(datagrams=True)

    class Ears:
        sample, truth, autopilot = collector.sample, collector.truth, collector.autopilot

        def published(self, message: object) -> None:
            """Ignored: this replay would send other messages than were received."""

    pipeline.observe(Ears())
    for packet in TlogReader(tlog):
        pipeline.feed(packet)
        for frame in decoder.feed(packet.data):
            if (
                frame.message_id == mavlink.MAVLINK_MSG_ID_ALTITUDE
                and frame.component_id == OUR_COMPONENT_ID
            ):
                collector.published(decoder.decode(frame))
    return collector


def report(tlog: Path, scenario: str) -> Path:
    """Replay the log, and write its flight report beside it; the page."""
    page = tlog.with_suffix(".html")
    return write_reports(replay(tlog), page, scenario)[0]


def errors(collector: Collector) -> dict[str, Errors]:
    """Errors of each source, by label."""
    found = {label: collector.errors(name) for name, label in LABELS.items()}
    return {label: each for label, each in found.items() if each is not None}


def error_table(collector: Collector) -> str:
    """The errors of each source, a line each below a header."""
    head = "against truth, after the first minute (m)"
    lines = [f"{head:42s}{'RMSE':>8s}{'95 %':>8s}{'max':>8s}{'bias':>8s}"]
    for label, found in errors(collector).items():
        values = (found.rmse_m, found.p95_m, found.max_m, found.bias_m)
        lines.append(f"{label:42s}" + "".join(f"{value:8.2f}" for value in values))
    return "\n".join(lines)


def plot(collector: Collector, path: Path, title: str) -> None:
    """The flight above, the errors of each source below."""
    truth_us, truth_m = collector.track("truth")
    with figure(2, panel_in=3.0, sharex=True, height_ratios=(2, 3)) as (canvas, (above, below)):
        above.plot(truth_us / 60e6, truth_m, **SOURCES["truth"].matplotlib())
        errors_m = []
        for name in ("gnss", "baro", "autopilot", "published"):
            times_us, values = collector.track(name)
            options = SOURCES[name].matplotlib() | {"label": LABELS[name]}
            errors_m.append(values - truth_at(times_us, truth_us, truth_m))
            below.plot(*unbroken(times_us / 60e6, errors_m[-1], GAP_S / 60.0), **options)
            if name in {"baro", "published"}:
                above.plot(times_us / 60e6, values, **options)
        canvas.suptitle(title, x=0.01, ha="left", fontsize=10)
        above.set_title("altitude above mean sea level (m)")
        below.set_title("error (m)")
        below.set_xlabel("time since boot (min)")
        below.axhline(0, color=INK, linewidth=0.8)
        below.set_ylim(*error_range(errors_m, 15.0, head_room=0.1))
        tell_clipped(below, errors_m)
        legend_outside(above)
        legend_outside(below)
        write_png(canvas, path)
