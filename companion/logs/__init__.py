"""Logs of packets: reading, writing, pacing. A new format is one file and one line in `FORMATS`."""

from collections import Counter
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import NamedTuple, Protocol, Self

from companion.errors import LogFormatError
from companion.logs.tlog import TlogReader, TlogWriter
from companion.mavlink.codec import Frame, FrameReject
from companion.samples import Packet

__all__ = ["FORMATS", "Format", "LogReader", "LogWriter", "open_log"]


class LogReader(Protocol):
    """Packets in file order; every iteration starts anew."""

    counters: Counter[FrameReject]
    """what was left out in the current iteration, by cause"""
    size_bytes: int
    position_bytes: int

    def __iter__(self) -> Iterator[Packet]: ...

    def frames_of(self, wanted: Collection[int]) -> Iterator[tuple[int, Frame]]: ...


class LogWriter(Protocol):
    """A context manager that writes packets, one whole frame each."""

    def write(self, time_us: int, frame: bytes) -> None: ...

    def close(self) -> None: ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *error: object) -> None: ...


class Format(NamedTuple):
    """How to read and write one kind of log."""

    suffixes: tuple[str, ...]
    reader: Callable[[Path], LogReader]
    writer: Callable[[Path], LogWriter] | None
    help: str
    magic: bytes = b""
    """how every file of this kind begins; a format without one is recognised by suffix, or by
    trying"""


FORMATS = {
    "tlog": Format(
        (".tlog",), TlogReader, TlogWriter, "MAVLink telemetry log of a ground station or companion"
    ),
}


def open_log(path: str | Path) -> LogReader:
    """A reader for the log at `path`, chosen by how it begins, then by its suffix.

    Raises `LogFormatError` when it cannot be read or is of no known format.
    """
    path = Path(path)
    return _format_of(path).reader(path)


def _format_of(path: Path) -> Format:
    longest = max(len(known.magic) for known in FORMATS.values())
    try:
        with path.open("rb") as file:
            head = file.read(longest)
    except OSError:
        head = b""  # the reader says what is wrong with the file
    by_magic = [known for known in FORMATS.values() if known.magic and head.startswith(known.magic)]
    by_suffix = [known for known in FORMATS.values() if path.suffix.lower() in known.suffixes]
    without_magic = [known for known in FORMATS.values() if not known.magic]
    for known in by_magic + by_suffix + without_magic:
        return known
    raise LogFormatError(f"{path}: of no known format ({', '.join(FORMATS)})")
