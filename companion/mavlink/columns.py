"""Payloads of a message kind as typed columns, and as light messages with the same attributes.

The layouts are made at run time from pymavlink's dialect table, never written down here. Only kinds
without texts and arrays have light messages; the others are decoded one at a time by
`companion.mavlink.codec.decode`. A light message is a named tuple of the fields'
values as pymavlink decodes them: zeros that MAVLink 2 left out and missing extension fields are 0.
"""

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.mavlink.codec import Frame, Message, light, mavlink, numbers
from companion.mavlink.framing import CRC_EXTRA, CRC_TABLE, V1_LENGTHS
from companion.mavlink.record_scan import STRIDE, gather
from companion.samples import Rows

CODES = {
    "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8",
    "f": "<f4", "d": "<f8",
}  # fmt: skip
"""code of the struct module -> dtype"""
TEXT = "c"


BOOT_STAMP = "time_boot_ms"


class Layout(NamedTuple):
    """How the payload of one kind lies on the wire."""

    dtype: np.dtype[Any]
    make: Callable[[tuple[Any, ...]], Message]


@cache
def layout(message_id: int) -> Layout | None:
    """The layout of a kind, or None when it has texts, arrays or an id that is not known."""
    found, dtype = numbers(message_id), wire_dtype(message_id)
    return None if found is None or dtype is None else Layout(dtype, found.make)


@cache
def wire_dtype(message_id: int) -> np.dtype[Any] | None:
    """The fields of a kind on the wire, or None when its id is not known."""
    kind = mavlink.mavlink_map.get(message_id)
    if kind is None:
        return None
    names, codes = kind.ordered_fieldnames, kind.native_format.decode().lstrip("<")
    fields: list[Any] = [
        (
            name,
            f"S{length}" if code == TEXT else CODES[code],
            (length,) if code != TEXT and length else (),
        )
        for name, code, length in zip(names, codes, kind.array_lengths, strict=True)
    ]
    return np.dtype(fields)


def columns(data: NDArray[np.uint8], index: Rows, message_id: int) -> NDArray[Any]:
    """The payloads of frames of one kind, shape (n,), a structured array with the fields' names.

    `index` are rows of `record_scan.INDEX` of that kind, `data` the buffer they point into. Raises
    `KeyError` for a kind that is not known.
    """
    dtype = wire_dtype(message_id)
    if dtype is None:
        raise KeyError(f"message {message_id} is not known")
    table = np.empty((index.size, dtype.itemsize), np.uint8)
    gather(data, index["payload"], index["length"], table)
    return table.view(dtype)[:, 0]


def messages(data: NDArray[np.uint8], index: Rows, message_id: int) -> Iterator[Message]:
    """The frames of one kind as light messages; arguments as for `columns`."""
    found = layout(message_id)
    if found is None:
        return iter(())
    return map(found.make, columns(data, index, message_id).tolist())


@cache
def tables() -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """What `record_scan.scan_records` needs: the checksum's tables, CRC_EXTRA and MAVLink 1 lengths
    by id."""
    extras = np.full(max(CRC_EXTRA) + 1, -1, np.int64)
    lengths = np.zeros((extras.size, 2), np.int64)
    for message_id, extra in CRC_EXTRA.items():
        extras[message_id] = extra
        lengths[message_id] = V1_LENGTHS[message_id].start, V1_LENGTHS[message_id].stop - 1
    crc = np.zeros((STRIDE, 256), np.int64)
    crc[0] = CRC_TABLE
    for zeros in range(1, STRIDE):  # the checksum's change by a byte with so many zeros behind it
        crc[zeros] = crc[0][crc[zeros - 1] & 0xFF] ^ crc[zeros - 1] >> 8
    return crc, extras, lengths


@cache
def has_boot_stamp(message_id: int) -> bool:
    """Whether a kind tells the time since boot, in milliseconds."""
    found = layout(message_id)
    return found is not None and BOOT_STAMP in (found.dtype.names or ())


def boot_stamp_us(frame: Frame, now_us: int) -> int:
    """The boot stamp of an autopilot's frame, else the time so far."""
    is_autopilot = frame.component_id == mavlink.MAV_COMP_ID_AUTOPILOT1
    message = light(frame) if is_autopilot and has_boot_stamp(frame.message_id) else None
    return int(message.time_boot_ms) * 1000 if message is not None else now_us
