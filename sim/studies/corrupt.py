"""The command ``kollsman-sim corrupt``: a copy of a log with faults."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from companion.config.fields import keys
from companion.errors import LogFormatError
from companion.logs.tlog import TlogReader, TlogWriter
from companion.samples import Packet
from sim.faults import FAULTS, Fault, apply_faults

_REPORT_PACKETS = 2000


@dataclass
class Corruption:
    """Counts of the packets of a log."""

    read: int = 0
    written: int = 0
    touched: int = 0
    """written with other bytes or at another time"""


def corrupt(
    source: Path,
    target: Path,
    faults: Sequence[Fault],
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> Corruption:
    """Copy the frames of the tlog `source` to `target` through `faults`. `progress` gets bytes read
    and in all.

    Raises LogFormatError when `source` is no tlog, when `target` cannot be written, or when they
    are the same file.
    """
    if source.exists() and target.exists() and source.samefile(target):
        raise LogFormatError(f"{target}: is the log to be read; give the result another name")
    reader = TlogReader(source)
    found = Corruption()
    sound: set[tuple[int, bytes]] = set()

    def packets() -> Iterator[Packet]:
        for packet in reader:
            found.read += 1
            if progress is not None and found.read % _REPORT_PACKETS == 0:
                progress(reader.position_bytes, reader.size_bytes)
            sound.clear()
            sound.add(packet)
            yield packet

    with TlogWriter(target) as writer:
        for packet in apply_faults(packets(), faults, seed):
            writer.write(packet.time_us, packet.data)
            found.written += 1
            found.touched += packet not in sound
    return found


class Parameter(NamedTuple):
    """One parameter of a fault, in words."""

    name: str
    default: str
    allowed: str
    meaning: str


def parameters(kind: type[Fault], *, common: bool) -> list[Parameter]:
    """The parameters of a fault: its own, or those that all faults share."""
    return [
        Parameter(
            name,
            "required" if kind.model_fields[name].is_required() else default,
            f"{allowed} {unit}",
            meaning,
        )
        for name, default, unit, allowed, meaning in keys(kind)
        if name != "fault" and (name in Fault.model_fields) is common
    ]


def summary(kind: type[Fault]) -> str:
    """The fault in a line."""
    return " ".join((kind.__doc__ or "").split())


def table() -> Iterator[tuple[str, str, list[Parameter]]]:
    """Every fault: its name, what it does, its own parameters."""
    for name, kind in FAULTS.items():
        yield name, summary(kind), parameters(kind, common=False)
