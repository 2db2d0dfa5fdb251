"""Endurance: cycles of disturbances against the service on a serial line, in real time.

    python -m tests.endurance --cycles 6000 --page     # 1000 of each kind, some seven hours
    python -m tests.endurance --cycles 50 --kind unplug --kind junk

Every cycle is a line in out/endurance/cycles.jsonl; a run that was stopped continues there
(`--anew` starts over). `--page` writes the figures of all that is there to docs/endurance.md, with
those of `python -m tests.fuzz all`.

Reported for each kind: recovery (from the end of the disturbance until the vehicle hears ALTITUDE
again; median and 99th percentile), altitudes further than `WRONG_M` from the truth, and for each
run the growth of the resident memory. A crash ends the run with its traceback.
"""

import argparse
import json
import random
import resource
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from companion.clock import SystemClock
from companion.links import open_link
from companion.service import Service
from companion.settings import CompanionSettings
from companion.warmup import warm_up
from tests.live import LiveVehicle, Pty, accept, until
from tests.paths import ROOT
from tests.vehicle import ALTITUDE_M, attitude

WRONG_M = 10.0
PATIENCE_S = 40.0
RECORD = ROOT / "out" / "endurance" / "cycles.jsonl"
FUZZED = ROOT / "out" / "endurance" / "fuzz.json"
PAGE = ROOT / "docs" / "endurance.md"


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


@dataclass(frozen=True)
class Cycle:
    """One disturbance."""

    kind: str
    recovery_s: float
    wrong: int
    """altitudes that were wrong"""
    rss_mb: float
    growth: float
    """of the resident memory since the start of this run, a share"""


def run(cycles: int, kinds: list[str], seed: int, record: Path) -> list[Cycle]:
    """Run what is missing of `cycles`; all of them, those of earlier runs too."""
    done = cycles_of(record)
    todo = [kinds[number % len(kinds)] for number in range(len(done), cycles)]
    if not todo:
        return done
    warm_up(CompanionSettings())
    record.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, record.open("a", encoding="ascii") as lines:
        bench = Bench(Path(folder), seed + len(done))
        bench.recovered_s()
        before_kb = rss_kb()
        for kind in todo:
            bench.vehicle.heard.clear()
            KINDS[kind](bench)
            recovery_s = bench.recovered_s()
            heights = [message.altitude_amsl for message in bench.vehicle.messages("ALTITUDE")]
            wrong = sum(abs(height - ALTITUDE_M) > WRONG_M for height in heights)
            after_kb = rss_kb()
            done.append(Cycle(kind, recovery_s, wrong, after_kb / 1024, after_kb / before_kb - 1.0))
            lines.write(json.dumps(asdict(done[-1])) + "\n")
            lines.flush()
            sys.stderr.write(f"\r{len(done)}/{cycles} {kind}: {recovery_s:.2f} s, {wrong} wrong  ")
        bench.close()
    sys.stderr.write("\n")
    return done


def cycles_of(record: Path) -> list[Cycle]:
    """The cycles of earlier runs."""
    if not record.exists():
        return []
    lines = record.read_text(encoding="ascii").splitlines()
    return [Cycle(**json.loads(line)) for line in lines if line.endswith("}")]


def table(cycles: list[Cycle]) -> str:
    """The figures, in Markdown."""
    lines = [
        "| disturbance | cycles | recovery p50 s | p99 s | wrong altitudes |",
        "|---|---|---|---|---|",
    ]
    for kind in sorted({cycle.kind for cycle in cycles}):
        own = [cycle for cycle in cycles if cycle.kind == kind]
        p50, p99 = np.percentile([cycle.recovery_s for cycle in own], [50, 99])
        wrong = sum(cycle.wrong for cycle in own)
        lines.append(f"| {kind} | {len(own)} | {p50:.2f} | {p99:.2f} | {wrong} |")
    largest = max((cycle.growth for cycle in cycles), default=0.0)
    rss_mb = cycles[-1].rss_mb if cycles else 0.0
    lines.append(f"\nResident memory {rss_mb:.0f} MB, largest growth {100 * largest:+.1f} %.")
    return "\n".join(lines) + "\n"


def write_page() -> None:
    """docs/endurance.md: what was measured so far."""
    fuzzed = json.loads(FUZZED.read_text(encoding="ascii")) if FUZZED.exists() else {}
    rows = [f"| {name} | {runs} | {seconds} | 0 |" for name, (runs, seconds) in fuzzed.items()]
    fuzz = ["| target | inputs | seconds | findings |", "|---|---|---|---|", *rows]
    PAGE.write_text(
        "# Endurance\n\nWritten by `python -m tests.endurance --page`, not by hand.\n\n"
        "The service on a serial line, disturbed again and again. Recovery is the time from the "
        "end of\nthe disturbance until the vehicle hears two ALTITUDE again; wrong is more than "
        f"{WRONG_M:g} m from the truth.\n\n{table(cycles_of(RECORD))}\n"
        "## Fuzzing\n\nCoverage-guided (atheris), `python -m tests.fuzz all`.\n\n"
        + "\n".join(fuzz)
        + "\n",
        encoding="utf-8",
    )


def rss_kb() -> int:
    """Resident memory now."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() // 1024


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--cycles", type=int, default=60)
    parser.add_argument("--kind", action="append", choices=KINDS, default=None)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--anew", action="store_true", help="forget the cycles of earlier runs")
    parser.add_argument("--page", action="store_true", help="write docs/endurance.md")
    options = parser.parse_args()
    if options.anew:
        RECORD.unlink(missing_ok=True)
    found = run(options.cycles, options.kind or list(KINDS), options.seed, RECORD)
    sys.stdout.write(table(found))
    if options.page:
        write_page()
    sys.exit(any(cycle.wrong for cycle in found))
