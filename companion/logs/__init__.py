"""Logs: reading and writing. A new format is one file and one line in `FORMATS`."""

import contextlib
import stat
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, Protocol, Self

from companion.errors import LogFormatError
from companion.logs import dataflash, raw, ulog
from companion.logs.dataflash import BinReader, TextReader
from companion.logs.raw import RawReader
from companion.logs.reader import LogReader
from companion.logs.tlog import TlogReader, TlogWriter
from companion.logs.ulog import UlogReader

__all__ = ["FORMATS", "Format", "LogReader", "LogWriter", "open_log"]

HEAD_BYTES = 1 << 14


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
    recognises: Callable[[bytes], bool] | None = None
    """whether a file that begins with these bytes (16 kB at most) is of this kind; a format without
    it is recognised by suffix, or by trying"""


FORMATS = {
    "raw": Format(
        (".raw",), RawReader, None, "MAVLink capture without times (also .tlog.raw)", raw.is_raw
    ),
    "bin": Format(
        (".bin",),
        BinReader,
        None,
        "ArduPilot dataflash log",
        lambda head: head.startswith(dataflash.MAGIC),
    ),
    "log": Format(
        (".log",),
        TextReader,
        None,
        "ArduPilot dataflash log as text",
        lambda head: dataflash.TEXT_MAGIC in head[:4096] and head[:4096].isascii(),
    ),
    "ulg": Format(
        (".ulg",),
        UlogReader,
        None,
        "PX4 log (extra `logs`)",
        lambda head: head.startswith(ulog.MAGIC[:4]),
    ),
    "tlog": Format(
        (".tlog",),
        TlogReader,
        TlogWriter,
        "MAVLink telemetry log of a ground station or companion",
        raw.is_tlog,
    ),
}


def open_log(path: str | Path) -> LogReader:
    """A reader for the log at `path`, chosen by how it begins, then by its suffix.

    Raises `LogFormatError` when it cannot be read or is of no known format.
    """
    path = Path(path)
    with contextlib.suppress(OSError):  # the reader says what is wrong with the file
        mode = path.stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise LogFormatError(
                f"{path}: is a pipe or a device; a log is read more than once: copy it to a file"
            )
    return _format_of(path).reader(path)


def _format_of(path: Path) -> Format:
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError:
        head = b""  # the reader says what is wrong with the file
    for known in FORMATS.values():
        if known.recognises is not None and known.recognises(head):
            return known
    for known in FORMATS.values():
        if path.suffix.lower() in known.suffixes:
            return known
    return FORMATS["tlog"]  # it says what the file seems to be instead
