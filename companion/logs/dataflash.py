"""ArduPilot dataflash logs, binary (.bin) and as text (.log): messages as columns by name.

The layouts are the log's own FMT messages; what their format letters mean is pymavlink's table.
Which columns are which sensor is in `companion.logs.ardupilot`.
"""

import logging
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.errors import LogFormatError
from companion.logs.ardupilot import Columns, tables_of
from companion.logs.dataflash_scan import FMT, FMT_LENGTH, scan_messages
from companion.logs.files import contents
from companion.logs.tables import TableReader
from companion.mavlink.codec import FrameReject
from companion.mavlink.record_scan import gather

logger = logging.getLogger("kollsman.logs")

MAGIC = b"\xa3\x95"
CODES = {letter: letter for letter in "bBhHiIfdqQ"} | {
    "M": "b", "g": "e", "n": "4s", "N": "16s", "Z": "64s", "c": "h", "C": "H", "e": "i", "E": "I",
    "L": "i",
}  # fmt: skip
"""`struct` code of a format letter of ArduPilot's log messages (libraries/AP_Logger/README.md); "a"
is 32 of "h" """
SCALES = {"c": 0.01, "C": 0.01, "e": 0.01, "E": 0.01, "L": 1e-7}
"""unit of an integer"""
TEXT_MAGIC = b"FMT,"
HEADER = 3
INDEX_ROWS = 1 << 18
FEWEST_USED = 0.5
"""share of a binary log that must be messages"""


class BinReader(TableReader):
    """An ArduPilot .bin. Raises `LogFormatError` when it is unreadable or mostly not messages."""

    def __init__(self, path: str | Path) -> None:
        path = Path(path)
        data = np.frombuffer(contents(path), np.uint8)
        columns, junk = read_bin(data)
        if junk > (1.0 - FEWEST_USED) * data.size or not columns:
            raise LogFormatError(
                f"{path}: not a dataflash log (.bin), or badly damaged: {junk} of {data.size} "
                "bytes belong to no message"
            )
        super().__init__(
            path, tables_of(columns), data.size, Counter({FrameReject.JUNK: junk} if junk else {})
        )


class TextReader(TableReader):
    """An ArduPilot .log. Raises `LogFormatError` when it is unreadable or has no message."""

    def __init__(self, path: str | Path) -> None:
        path = Path(path)
        data = contents(path)
        columns, bad = read_text(data.decode("ascii", "replace"))
        if not columns:
            raise LogFormatError(f"{path}: not a dataflash log in text (.log): no FMT line fits")
        counters = Counter({FrameReject.DECODE: bad} if bad else {})
        super().__init__(path, tables_of(columns), len(data), counters)


def read_bin(data: NDArray[np.uint8]) -> tuple[dict[str, Columns], int]:
    """The columns of every message by name, and how many bytes belong to no message."""
    places, junk = _index(data)
    types = data[places + 2] if places.size else np.zeros(0, np.uint8)
    formats = {}
    for at in places[types == FMT].tolist():
        kind, length, name, letters, labels = _format(data[at : at + FMT_LENGTH].tobytes())
        formats[kind] = (length, name, letters, labels)
    columns: dict[str, Columns] = {}
    for kind in np.unique(types).tolist():
        if kind in formats:
            length, name, letters, labels = formats[kind]
            dtype = _dtype(letters, labels)
            if dtype is None or dtype.itemsize != length - HEADER:
                logger.info("%s: its format %s does not fit its length, left out", name, letters)
                continue
            at = places[types == kind]
            table = np.empty((at.size, dtype.itemsize), np.uint8)
            gather(data, at + HEADER, np.full(at.size, dtype.itemsize), table)
            fields = _scaled(table.view(dtype)[:, 0], letters, labels)
            columns[name] = Columns(at, fields)
    return columns, junk


def _index(data: NDArray[np.uint8]) -> tuple[NDArray[np.int64], int]:
    lengths = np.zeros(256, np.int64)
    lengths[FMT] = FMT_LENGTH
    parts, offset, found = [np.zeros(0, np.int64)], 0, np.zeros(2, np.int64)
    while offset < data.size:
        places = np.empty(INDEX_ROWS, np.int64)
        offset = scan_messages(data, offset, lengths, places, found)
        parts.append(places[: int(found[0])].copy())
    return np.concatenate(parts), int(found[1])


def _format(message: bytes) -> tuple[int, int, str, str, list[str]]:
    """Type, length, name, format letters and labels of an FMT message."""
    name, letters, labels = (
        part.split(b"\0", 1)[0].decode("ascii", "replace")
        for part in (message[5:9], message[9:25], message[25:89])
    )
    return message[3], message[4], name, letters, labels.split(",")


def _dtype(letters: str, labels: list[str]) -> np.dtype[Any] | None:
    if len(letters) != len(labels) or len(set(labels)) != len(labels) or "" in labels:
        return None
    fields: list[Any] = []
    for letter, label in zip(letters, labels, strict=True):
        if letter == "a":
            fields.append((label, "<i2", (32,)))
        elif letter in CODES:
            code = CODES[letter]
            fields.append((label, f"S{code[:-1]}" if code.endswith("s") else np.dtype(f"<{code}")))
        else:
            return None
    return np.dtype(fields)


def _scaled(rows: NDArray[Any], letters: str, labels: list[str]) -> dict[str, NDArray[Any]]:
    """Columns in their units; texts as they are."""
    scales = {label: SCALES.get(letter) for letter, label in zip(letters, labels, strict=True)}
    return {
        label: rows[label] * scale if scale is not None else rows[label]
        for label, scale in scales.items()
    }


def read_text(text: str) -> tuple[dict[str, Columns], int]:
    """The columns of every message by name, and how many lines fit no format."""
    labels: dict[str, tuple[str, list[str]]] = {}
    rows: dict[str, tuple[list[int], list[list[str]]]] = {}
    bad = place = 0
    for line in text.splitlines():
        place += len(line) + 1
        cells = [cell.strip() for cell in line.split(",")]
        name = cells[0]
        if name == "FMT" and len(cells) > 5:
            if len(cells[4]) == len(cells) - 5:
                labels[cells[3]] = cells[4], cells[5:]
        elif name in labels and len(cells) >= len(labels[name][1]) + 1:
            places, values = rows.setdefault(name, ([], []))
            places.append(place)
            values.append(cells[1 : len(labels[name][1]) + 1])
        elif line.strip() and place > len(line) + 1 and labels:
            bad += 1
    found = {}
    for name, (places, values) in rows.items():
        letters, names = labels[name]
        by_label = zip(names, zip(*values, strict=True), letters, strict=True)
        fields = {label: _text_column(cells, letter) for label, cells, letter in by_label}
        found[name] = Columns(np.array(places, np.int64), fields)
    return found, bad


def _text_column(cells: tuple[str, ...], letter: str) -> NDArray[Any]:
    if letter in "nNZM" and not all(map(_is_number, cells)):
        return np.array([cell.encode() for cell in cells])
    return np.array([float(cell) if _is_number(cell) else np.nan for cell in cells])


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
