"""Endurance: cycles of disturbances against the service on a serial line, in real time.

    python -m tests.endurance --cycles 1000            # about an hour for each 800 cycles
    python -m tests.endurance --cycles 50 --kind unplug --kind junk

Reported for each kind: recovery (from the end of the disturbance until the vehicle hears ALTITUDE
again; median and 99th percentile), altitudes further than `WRONG_M` from the truth, and for the
whole run the growth of the resident memory. A crash ends the run with its traceback.
"""

import argparse
import random
import resource
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from companion.clock import SystemClock
from companion.links import open_link
from companion.service import Service
from companion.settings import CompanionSettings
from companion.warmup import warm_up
from tests.live import LiveVehicle, Pty, accept, until
from tests.vehicle import ALTITUDE_M, attitude

WRONG_M = 10.0
PATIENCE_S = 40.0


class Bench:
    """A vehicle and the service on the two ends of a pseudo-terminal."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.random = random.Random(seed)
        self.cable = Pty(folder / "autopilot")
        self.vehicle = LiveVehicle(self.cable, answer=accept)
        self.link = open_link(f"{self.cable.path}:921600")
        self.service = Service(self.link, CompanionSettings(), SystemClock())
        self._stop = threading.Event()
        self.failure: BaseException | None = None
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        try:
            while not self._stop.is_set():
                self.service.turn(0.1)
        except BaseException as error:
            self.failure = error

    def recovered_s(self) -> float:
        """How long until two altitudes in a row are heard."""
        since = time.monotonic()

        def is_back() -> bool:
            if self.failure is not None:
                raise self.failure
            return len(self.vehicle.messages("ALTITUDE", since)) >= 2

        return until(is_back, PATIENCE_S)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.vehicle.close()
        self.link.close()


def unplug(bench: Bench) -> None:
    """The cable is out for 0.2 to 4 s."""
    bench.cable.unplug()
    time.sleep(bench.random.uniform(0.2, 4.0))
    bench.cable.plug()


def junk(bench: Bench) -> None:
    """Bytes of noise between the frames."""
    for _ in range(bench.random.randint(1, 20)):
        bench.cable.send(bench.random.randbytes(bench.random.randint(1, 300)))
        time.sleep(0.01)


def half_frames(bench: Bench) -> None:
    """Frames that are cut."""
    for _ in range(bench.random.randint(1, 20)):
        frame = bench.vehicle.vehicle.pack(attitude(1.0))
        bench.cable.send(frame[: bench.random.randint(1, len(frame) - 1)])
        time.sleep(0.01)


def flood(bench: Bench) -> None:
    """Ten times the usual traffic for a second."""
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        boot_s = time.monotonic() - bench.vehicle._boot
        for _ in range(5):
            bench.vehicle.send(attitude(boot_s))
        time.sleep(0.01)


def clock_jump(bench: Bench) -> None:
    """The vehicle's clock jumps forward."""
    bench.vehicle._boot -= bench.random.uniform(5.0, 500.0)


def reboot(bench: Bench) -> None:
    """The autopilot is silent for two seconds and starts anew."""
    bench.vehicle.paused = True
    time.sleep(2.0)
    bench.vehicle.reboot()
    bench.vehicle.paused = False


KINDS: dict[str, Callable[[Bench], None]] = {
    kind.__name__: kind for kind in (unplug, junk, half_frames, flood, clock_jump, reboot)
}


def run(cycles: int, kinds: list[str], seed: int = 0) -> int:
    """Print the table; the number of wrong altitudes."""
    warm_up(CompanionSettings())
    found: dict[str, list[float]] = {kind: [] for kind in kinds}
    wrong = dict.fromkeys(kinds, 0)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder), seed)
        bench.recovered_s()
        before_kb = rss_kb()
        for number in range(cycles):
            kind = kinds[number % len(kinds)]
            bench.vehicle.heard.clear()
            KINDS[kind](bench)
            found[kind].append(bench.recovered_s())
            heights = [message.altitude_amsl for message in bench.vehicle.messages("ALTITUDE")]
            wrong[kind] += sum(abs(height - ALTITUDE_M) > WRONG_M for height in heights)
        after_kb = rss_kb()
        bench.close()
    lines = [
        "| disturbance | cycles | recovery p50 s | p99 s | wrong altitudes |",
        "|---|---|---|---|---|",
    ]
    for kind, times in found.items():
        if times:
            p50, p99 = np.percentile(times, [50, 99])
            lines.append(f"| {kind} | {len(times)} | {p50:.2f} | {p99:.2f} | {wrong[kind]} |")
    growth = 100 * (after_kb / before_kb - 1)
    lines.append(f"\nresident memory {before_kb / 1024:.0f} MB, {growth:+.1f} %; 0 crashes")
    sys.stdout.write("\n".join(lines) + "\n")
    return sum(wrong.values())


def rss_kb() -> int:
    """Resident memory now."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() // 1024


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--cycles", type=int, default=60)
    parser.add_argument("--kind", action="append", choices=KINDS, default=None)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    sys.exit(bool(run(options.cycles, options.kind or list(KINDS), options.seed)))
