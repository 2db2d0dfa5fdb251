"""Coverage-guided fuzzing of what reads bytes from outside (needs `pip install atheris`).

    python -m tests.fuzz all 600          # each target for 600 s, one after the other
    python -m tests.fuzz codec            # one target until Ctrl-C; flags of libFuzzer may follow
    python -m tests.fuzz pipeline         # conversion and intake behind the codec
    python -m tests.fuzz tlog

Inputs that reach new code are kept in out/fuzz/TARGET, so a later run goes on from there. Progress
is libFuzzer's. `all` ends with 1 at the first finding, which libFuzzer leaves as a file crash-*;
its figures go to docs/endurance.md with `python -m tests.endurance --cycles 0 --page`.

Every byte string must be taken without an exception, whole or in parts; the frames found must not
depend on how the bytes were cut.
"""

import contextlib
import importlib
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.paths import ROOT

try:
    atheris: Any = importlib.import_module("atheris")
except ImportError:  # the targets also run without it, as plain functions
    atheris = None

READERS = [
    "companion.mavlink.codec",
    "companion.mavlink.framing",
    "companion.mavlink.convert",
    "companion.intake.rows",
    "companion.intake.vehicle_clock",
    "companion.logs.tlog",
]

MARK = "from companion.jit import step"
COMPILED = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for path in (ROOT / "companion").rglob("*.py")
    if MARK in path.read_text(encoding="utf-8")
]
"""Numba cannot compile what is instrumented."""

instrumented = atheris and atheris.instrument_imports(include=READERS, exclude=COMPILED)
with instrumented or contextlib.nullcontext():
    from companion.logs.tlog import TlogReader
    from companion.mavlink.codec import Decoder, Encoder, decode, mavlink

from companion.errors import LogFormatError  # noqa: E402
from companion.pipeline import Pipeline  # noqa: E402
from companion.samples import Packet  # noqa: E402
from companion.settings import CompanionSettings  # noqa: E402
from tests.endurance import FUZZED  # noqa: E402


def codec(data: bytes) -> None:
    """The same frames, whole and byte by byte."""
    whole, parts = Decoder(), Decoder()
    frames = whole.feed(data) + whole.flush()
    cut = [frame for byte in data for frame in parts.feed(bytes([byte]))] + parts.flush()
    assert frames == cut
    for frame in frames:
        decode(frame)


def pipeline(data: bytes) -> None:
    """Payloads of the messages that are measured, of any content, with a good checksum."""
    made = Pipeline(CompanionSettings())
    sender = Encoder(1, 1)
    made.feed(Packet(0, sender.encode(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))))
    wanted = sorted(made.wanted)
    time_us = 1_700_000_000_000_000
    while len(data) > 2:
        kind = mavlink.mavlink_map[wanted[data[0] % len(wanted)]]
        size = kind.unpacker.size
        payload = data[1 : 1 + size].ljust(size, b"\0")
        message = kind(*_values(kind, payload))
        time_us += 10_000
        made.feed(Packet(time_us, sender.encode(message)))
        data = data[1 + size :]


def _values(kind: object, payload: bytes) -> list[object]:
    fields = kind.unpacker.unpack(payload)  # type: ignore[attr-defined]
    values: list[object] = []
    for order in kind.orders:  # type: ignore[attr-defined]
        first = sum(kind.lengths[:order])  # type: ignore[attr-defined]
        length = kind.lengths[order]  # type: ignore[attr-defined]
        values.append(fields[first] if length == 1 else list(fields[first : first + length]))
    return values


def tlog(data: bytes) -> None:
    """A file of any content is read or refused with `LogFormatError`."""
    with tempfile.NamedTemporaryFile(suffix=".tlog") as file:
        file.write(data)
        file.flush()
        try:
            for _ in TlogReader(Path(file.name)):
                pass
        except LogFormatError:
            pass


TARGETS: dict[str, Callable[[bytes], None]] = {"codec": codec, "pipeline": pipeline, "tlog": tlog}


def run_all(seconds: int) -> int:
    """Every target for so long, as processes of their own; 1 at the first finding."""
    figures: dict[str, tuple[int, int]] = {}
    for name in TARGETS:
        command = [sys.executable, "-m", "tests.fuzz", name, f"-max_total_time={seconds}"]
        process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True)
        assert process.stderr is not None
        for line in process.stderr:
            sys.stderr.write(line)
            done = re.search(r"Done (\d+) runs in (\d+) second", line)
            if done:
                figures[name] = (int(done[1]), int(done[2]))
        if process.wait():
            return 1
    FUZZED.parent.mkdir(parents=True, exist_ok=True)
    FUZZED.write_text(json.dumps(figures), encoding="ascii")
    return 0


def main() -> None:
    if atheris is None:
        sys.exit("atheris is missing: pip install atheris")
    name = sys.argv.pop(1)
    if name == "all":
        sys.exit(run_all(int(sys.argv[1]) if len(sys.argv) > 1 else 600))
    corpus = ROOT / "out" / "fuzz" / name
    corpus.mkdir(parents=True, exist_ok=True)
    atheris.Setup([*sys.argv, str(corpus)], TARGETS[name])
    atheris.Fuzz()


if __name__ == "__main__":
    main()
