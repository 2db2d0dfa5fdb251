"""Coverage-guided fuzzing of what reads bytes from outside (needs `pip install atheris`).

    python -m tests.fuzz all 600          # each target for 600 s, at the same time
    python -m tests.fuzz codec            # one target until Ctrl-C; flags of libFuzzer may follow
    python -m tests.fuzz pipeline         # measured messages: conversion and intake
    python -m tests.fuzz senders          # every message, from the vehicle and from others
    python -m tests.fuzz tlog

Inputs that reach new code are kept in out/fuzz/TARGET, so a later run goes on from there; the first
run begins with whole frames. Progress is libFuzzer's. A finding ends its target; libFuzzer
leaves it as a file crash-*, and `all` ends with 1. The figures of `all` go to docs/endurance.md
with `python -m tests.endurance --cycles 0 --page`.

Every byte string must be taken without an exception, whole or in parts; the frames found must not
depend on how the bytes were cut. Each input is tried as it is, and with the checksums of its frames
set right, since no mutation finds a checksum. What the pipeline sends must be whole frames, and a
height in ALTITUDE a finite number.
"""

import contextlib
import importlib
import json
import math
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
    "companion.mavlink.identity",
    "companion.mavlink.parameters",
    "companion.mavlink.requests",
    "companion.mavlink.commands",
    "companion.mavlink.readings",
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
    from companion.mavlink.codec import Decoder, Encoder, Frame, decode, mavlink, scan

from companion.errors import LogFormatError  # noqa: E402
from companion.mavlink.framing import (  # noqa: E402
    CHECKSUM,
    CRC_EXTRA,
    V1,
    V1_HEADER,
    V2,
    V2_HEADER,
    mcrf4xx,
)
from companion.pipeline import Pipeline  # noqa: E402
from companion.samples import Packet  # noqa: E402
from companion.settings import CompanionSettings  # noqa: E402
from tests.endurance import FUZZED  # noqa: E402
from tests.vehicle import Vehicle, standing  # noqa: E402

SENDERS = ((1, 1), (255, 190), (1, 191), (51, 68), (1, 100), (9, 1), (0, 0), (1, 0))
TIME_US = 1_700_000_000_000_000


def codec(data: bytes) -> None:
    """The same frames, whole and byte by byte."""
    for each in (data, sealed(data)):
        whole, parts = Decoder(), Decoder()
        frames = whole.feed(each) + whole.flush()
        cut = [frame for byte in each for frame in parts.feed(bytes([byte]))] + parts.flush()
        assert frames == cut
        for frame in frames:
            decode(frame)


def sealed(data: bytes) -> bytes:
    """`data` with right checksums in all that looks like a frame."""
    made = bytearray(data)
    start = 0
    while start < len(made):
        header = {V1: V1_HEADER, V2: V2_HEADER}.get(made[start], 0)
        end = start + header + made[start + 1] if header and start + header < len(made) else 0
        if not end or end + CHECKSUM > len(made):
            start += 1
            continue
        number = made[start + header - 1]
        if header == V2_HEADER:
            number = int.from_bytes(made[start + 7 : start + 10], "little")
        covered = bytes(made[start + 1 : end]) + bytes([CRC_EXTRA.get(number, 0)])
        made[end : end + CHECKSUM] = mcrf4xx(covered).to_bytes(CHECKSUM, "little")
        start = end + CHECKSUM
    return bytes(made)


def pipeline(data: bytes) -> None:
    """Payloads of the messages that are measured, of any content, with a good checksum."""
    made = Pipeline(CompanionSettings())
    wanted = sorted(made.wanted)
    _feed(made, data, wanted, SENDERS[:1])


def senders(data: bytes) -> None:
    """Payloads of every message, from the vehicle, ground stations, others, and our own ids."""
    _feed(Pipeline(CompanionSettings()), data, sorted(mavlink.mavlink_map), SENDERS)


def _feed(
    made: Pipeline, data: bytes, numbers: list[int], speakers: tuple[tuple[int, int], ...]
) -> None:
    """The first byte chooses the message, with the second among many; the next the sender."""
    encoders = [Encoder(*ids) for ids in speakers]
    time_us = TIME_US
    heartbeat = mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)
    made.feed(Packet(time_us, encoders[0].encode(heartbeat)))
    while len(data) > 3:
        choice, sender, data = int.from_bytes(data[:2], "little"), data[2], data[3:]
        kind = mavlink.mavlink_map[numbers[choice % len(numbers)]]
        size = kind.unpacker.size
        message = kind(*_values(kind, data[:size].ljust(size, b"\0")))
        data = data[size:]
        time_us += 10_000
        encoder = encoders[sender % len(encoders)]
        _check(made.feed(Packet(time_us, encoder.encode(message)), sender >> 6 or None))
        _check(made.age(time_us + 5_000))


def _check(sent: list[bytes]) -> None:
    for data in sent:
        frame = scan(data)
        assert isinstance(frame, Frame)
        message = decode(frame)
        assert message is not None
        if message.get_type() == "ALTITUDE":
            assert math.isfinite(message.altitude_amsl)


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
    for each in (data, sealed(data)):
        with tempfile.NamedTemporaryFile(suffix=".tlog") as file:
            file.write(each)
            file.flush()
            try:
                for _ in TlogReader(Path(file.name)):
                    pass
            except LogFormatError:
                pass


TARGETS: dict[str, Callable[[bytes], None]] = {
    "codec": codec,
    "pipeline": pipeline,
    "senders": senders,
    "tlog": tlog,
}


def _write_first_inputs(name: str, corpus: Path) -> None:
    """Whole frames of a vehicle at rest, where the corpus is empty."""
    packets = [
        packet
        for version in (1, 2)
        for packet in standing(30.0, 30.4, vehicle=Vehicle(version=version))
    ]
    if name == "tlog":
        stamped = [packet.time_us.to_bytes(8, "big") + packet.data for packet in packets]
        found = [b"".join(stamped), b"".join(stamped[:3]), b"".join(p.data for p in packets)]
    elif name == "codec":
        found = [packet.data for packet in packets] + [b"".join(p.data for p in packets)]
    else:
        found = [bytes([number, 0, 0]) + packet.data for number, packet in enumerate(packets)]
    for number, data in enumerate(found):
        (corpus / f"first-{number}").write_bytes(data)


def run_all(seconds: int) -> int:
    """Every target for so long, as processes of their own at the same time; 1 when one of them
    found something."""
    folder = FUZZED.parent
    folder.mkdir(parents=True, exist_ok=True)
    logs = {name: folder / f"fuzz-{name}.log" for name in TARGETS}
    running: dict[str, subprocess.Popen[bytes]] = {}
    for name, path in logs.items():
        command = [sys.executable, "-m", "tests.fuzz", name, f"-max_total_time={seconds}"]
        with path.open("wb") as log:
            running[name] = subprocess.Popen(command, cwd=ROOT, stderr=log)
    failed = [name for name, process in running.items() if process.wait()]
    figures: dict[str, tuple[int, int]] = {}
    for name, path in logs.items():
        text = path.read_text(encoding="utf-8", errors="replace")
        done = re.search(r"Done (\d+) runs in (\d+) second", text)
        if done and name not in failed:
            figures[name] = (int(done[1]), int(done[2]))
    sys.stdout.write(f"{figures}\n" + "".join(f"{name} failed: {logs[name]}\n" for name in failed))
    FUZZED.write_text(json.dumps(figures), encoding="ascii")
    return int(bool(failed))


def main() -> None:
    if atheris is None:
        sys.exit("atheris is missing: pip install atheris")
    name = sys.argv.pop(1)
    if name == "all":
        sys.exit(run_all(int(sys.argv[1]) if len(sys.argv) > 1 else 600))
    corpus = ROOT / "out" / "fuzz" / name
    corpus.mkdir(parents=True, exist_ok=True)
    if not any(corpus.iterdir()):
        _write_first_inputs(name, corpus)
    atheris.Setup([*sys.argv, str(corpus)], TARGETS[name])
    atheris.Fuzz()


if __name__ == "__main__":
    main()
