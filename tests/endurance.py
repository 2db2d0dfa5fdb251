"""Endurance: cycles of disturbances against the service on a serial line, in real time.

    python -m tests.endurance --cycles 1000 --page     # of each kind at the same time: 80 minutes
    python -m tests.endurance --cycles 50 --kind unplug --kind junk --processes 2

Each kind of disturbance has a process and a service of its own, or several that share its cycles.
Every cycle is a line in out/endurance/KIND-SEED.jsonl; a run that was stopped continues there
(`--anew` starts over). `--page` writes the figures of all that is there to docs/endurance.md, with
those of `python -m tests.fuzz all`.

Reported for each kind: recovery (from the end of the disturbance until the vehicle hears ALTITUDE
again; median and 99th percentile), altitudes further than `WRONG_M` from the truth, and the growth
of the resident memory of a process after its first `SETTLING` cycles. A crash ends the run with its
traceback. The record of a cycle also holds how long the first frame took, and the reason of health
that the recovery waited for.
"""

import argparse
import json
import random
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from companion.clock import SystemClock
from companion.health import Health
from companion.links import open_link
from companion.service import Service
from companion.settings import CompanionSettings
from companion.warmup import warm_up
from tests.live import LiveVehicle, Pty, accept, until
from tests.paths import ROOT
from tests.vehicle import ALTITUDE_M, attitude

WRONG_M = 10.0
PATIENCE_S = 40.0
SETTLING = 20
RECORDS = ROOT / "out" / "endurance"
FUZZED = RECORDS / "fuzz.json"
PAGE = ROOT / "docs" / "endurance.md"
INTRODUCTION = f"""Written by `python -m tests.endurance --page`, not by hand.

The service on a serial line, disturbed again and again. Recovery is the time from the end of the
disturbance until the vehicle hears two ALTITUDE again; wrong is more than {WRONG_M:g} m from the
truth. Memory is the resident memory of service and test together. Each kind had processes of its
own, all at the same time. A cycle begins as soon as ALTITUDE is back: an autopilot that restarts
three seconds after its last start takes longer to be told from late copies of its messages
(the largest of `reboot`).
"""


class Recovery(NamedTuple):
    """How the altitude came back."""

    recovery_s: float
    first_frame_s: float
    waited_for: str
    """last reason of LOST until then; empty: health was not LOST"""


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

    def recovery(self) -> "Recovery":
        """Wait until two altitudes in a row are heard."""
        since = time.monotonic()
        heard_before = self.service.pipeline.decoder.frames
        first_s, waited_for = 0.0, ""

        def is_back() -> bool:
            nonlocal first_s, waited_for
            if self.failure is not None:
                raise self.failure
            pipeline = self.service.pipeline
            if pipeline.decoder.frames == heard_before:
                first_s = time.monotonic() - since
            if pipeline.health.health is Health.LOST:
                waited_for = pipeline.health.reason
            return len(self.vehicle.messages("ALTITUDE", since)) >= 2

        return Recovery(until(is_back, PATIENCE_S), first_s, waited_for)

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
    first_frame_s: float
    waited_for: str
    wrong: int
    """altitudes that were wrong"""
    rss_mb: float
    growth: float
    """of the resident memory since the first `SETTLING` cycles of this run, a share"""


def run(kind: str, cycles: int, seed: int) -> None:
    """Run what is missing of `cycles` of one kind in one process."""
    done = len(cycles_in(path_of(kind, seed)))
    if done >= cycles:
        return
    warm_up(CompanionSettings())
    RECORDS.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory() as folder,
        path_of(kind, seed).open("a", encoding="ascii") as file,
    ):
        bench = Bench(Path(folder), 1000 * seed + done)
        bench.recovery()
        settled_kb = rss_kb()
        for number in range(done, cycles):
            bench.vehicle.heard.clear()
            KINDS[kind](bench)
            recovery = bench.recovery()
            heights = [message.altitude_amsl for message in bench.vehicle.messages("ALTITUDE")]
            wrong = sum(abs(height - ALTITUDE_M) > WRONG_M for height in heights)
            after_kb = rss_kb()
            settled_kb = after_kb if number - done < SETTLING else settled_kb
            growth = after_kb / settled_kb - 1.0
            cycle = Cycle(kind, *recovery, wrong, after_kb / 1024, growth)
            file.write(json.dumps(asdict(cycle)) + "\n")
            file.flush()
            if number % 50 == 49:
                sys.stderr.write(f"{kind}: {number + 1} of {cycles}\n")
        bench.close()


def run_together(kinds: list[str], cycles: int, seeds: range) -> int:
    """Each kind and seed in a process of its own; how many of them failed."""
    command = [sys.executable, "-m", "tests.endurance", "--cycles", str(cycles)]
    running = [
        subprocess.Popen([*command, "--kind", kind, "--seed", str(seed)], cwd=ROOT)
        for kind in kinds
        for seed in seeds
    ]
    return sum(process.wait() != 0 for process in running)


def path_of(kind: str, seed: int) -> Path:
    """Where the cycles of a kind are recorded."""
    return RECORDS / f"{kind}-{seed}.jsonl"


def cycles_in(path: Path) -> list[Cycle]:
    """The cycles of earlier runs in one record."""
    if not path.exists():
        return []
    lines = path.read_text(encoding="ascii").splitlines()
    return [Cycle(**json.loads(line)) for line in lines if line.endswith("}")]


def cycles_of(kind: str) -> list[Cycle]:
    """All cycles of a kind."""
    return [cycle for path in sorted(RECORDS.glob(f"{kind}-*.jsonl")) for cycle in cycles_in(path)]


def table() -> str:
    """The figures of all kinds, in Markdown."""
    lines = [
        "| disturbance | cycles | recovery p50 s | p99 s | largest s | wrong altitudes "
        "| memory MB | growth |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for kind in sorted(KINDS):
        cycles = cycles_of(kind)
        if not cycles:
            continue
        p50, p99, most = np.percentile([cycle.recovery_s for cycle in cycles], [50, 99, 100])
        wrong = sum(cycle.wrong for cycle in cycles)
        growth = max(cycle.growth for cycle in cycles)
        lines.append(
            f"| {kind} | {len(cycles)} | {p50:.2f} | {p99:.2f} | {most:.2f} | {wrong} "
            f"| {cycles[-1].rss_mb:.0f} | {100 * growth:+.1f} % |"
        )
    return "\n".join(lines) + "\n"


def write_page() -> None:
    """docs/endurance.md: what was measured so far."""
    fuzzed = json.loads(FUZZED.read_text(encoding="ascii")) if FUZZED.exists() else {}
    rows = [f"| {name} | {runs} | {seconds} | 0 |" for name, (runs, seconds) in fuzzed.items()]
    fuzz = ["| target | inputs | seconds | findings |", "|---|---|---|---|", *rows]
    PAGE.write_text(
        f"# Endurance\n\n{INTRODUCTION}\n{table()}\n"
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
    parser.add_argument("--cycles", type=int, default=10, help="of each kind")
    parser.add_argument("--kind", action="append", choices=KINDS, default=None)
    parser.add_argument("--processes", type=int, default=1, help="that share the cycles of a kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--anew", action="store_true", help="forget the cycles of earlier runs")
    parser.add_argument("--page", action="store_true", help="write docs/endurance.md")
    options = parser.parse_args()
    chosen: list[str] = options.kind or list(KINDS)
    if options.anew:
        for path in RECORDS.glob("*-*.jsonl"):
            path.unlink()
    seeds = range(options.seed, options.seed + options.processes)
    if len(chosen) == len(seeds) == 1:
        run(chosen[0], options.cycles, options.seed)
        failed = 0
    else:
        failed = run_together(chosen, -(-options.cycles // len(seeds)), seeds)
        sys.stdout.write(table())
    if options.page:
        write_page()
    sys.exit(failed or any(cycle.wrong for name in chosen for cycle in cycles_of(name)))
