"""Edits the fields of a frame by name, in MAVLink's units, and seals it with the right length and
checksum.

Fields that are not edited keep their bytes, as do sender, sequence number and flags. An edited
frame is unsigned, because the key of its signature is unknown. The zeros at the end of a MAVLink 2
payload are cut off, as the protocol requires.
"""

from functools import cache
from typing import Any, NamedTuple

from companion.mavlink.codec import mavlink
from companion.mavlink.framing import CHECKSUM, CRC_EXTRA, V1, V1_HEADER, V2_HEADER, mcrf4xx

STAMPS = {"time_boot_ms": 1000, "time_usec": 1}
"""Fields with the vehicle's time -> microseconds of one unit."""
_SEQUENCE = {True: 2, False: 4}
"""index of the sequence number in a header: True for MAVLink 1"""


class Header(NamedTuple):
    """Header fields of a frame of any dialect."""

    sequence: int
    component_id: int
    message_id: int


def header(data: bytes) -> Header:
    """The header of one whole frame."""
    if data[0] == V1:
        return Header(data[2], data[4], data[5])
    return Header(data[4], data[6], data[7] | data[8] << 8 | data[9] << 16)


class _Layout:
    """Positions and ranges of the fields of one message type."""

    def __init__(self, message_id: int) -> None:
        kind = mavlink.mavlink_map[message_id]
        self.unpack, self.pack, self.size = (
            kind.unpacker.unpack_from,
            kind.unpacker.pack,
            kind.unpacker.size,
        )
        self.index: dict[str, int] = {}
        self.bounds: dict[str, tuple[int, int] | None] = {}
        """range of an integer field; None for a float"""
        at = 0
        for name, order in zip(kind.ordered_fieldnames, range(len(kind.lengths)), strict=True):
            self.index[name] = at
            at += (
                1 if kind.fieldtypes[kind.fieldnames.index(name)] == "char" else kind.lengths[order]
            )
            self.bounds[name] = _bounds(kind.fieldtypes[kind.fieldnames.index(name)])
        self.stamps = {name: STAMPS[name] for name in kind.fieldnames if name in STAMPS}


def _bounds(kind: str) -> tuple[int, int] | None:
    if "int" not in kind:
        return None
    bits = int("".join(filter(str.isdigit, kind)))
    return (0, 2**bits - 1) if kind.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


@cache
def layout(message_id: int) -> _Layout | None:
    """The layout of a message; None if the dialect does not have it."""
    return _Layout(message_id) if message_id in mavlink.mavlink_map else None


class Editor:
    """One frame under edit, of a message that the dialect has. Integer fields are rounded and
    limited to their range."""

    def __init__(self, data: bytes, message_id: int) -> None:
        found = layout(message_id)
        if found is None:
            raise KeyError(message_id)
        self._layout = found
        self._data = data
        self._is_v1 = data[0] == V1
        self._head = V1_HEADER if self._is_v1 else V2_HEADER
        payload = data[self._head : self._head + data[1]]
        self._values: list[Any] = list(found.unpack(payload.ljust(found.size, b"\0")))
        self.message_id = message_id
        self.sequence = header(data).sequence

    def __contains__(self, name: str) -> bool:
        return name in self._layout.index

    def __getitem__(self, name: str) -> Any:
        return self._values[self._layout.index[name]]

    def __setitem__(self, name: str, value: float) -> None:
        bounds = self._layout.bounds[name]
        if bounds is not None:
            value = min(max(round(value), bounds[0]), bounds[1])
        self._values[self._layout.index[name]] = value

    @property
    def stamps(self) -> dict[str, int]:
        """The message's time fields -> microseconds of one unit."""
        return self._layout.stamps

    def close(self) -> bytes:
        """The whole frame; the original bytes when nothing was changed."""
        payload: bytes = self._layout.pack(*self._values)
        original = self._data[self._head : self._head + self._data[1]]
        if payload == original.ljust(self._layout.size, b"\0"):
            return with_sequence(self._data, self.sequence)
        payload = payload[: self._data[1]] if self._is_v1 else payload.rstrip(b"\0") or b"\0"
        head = bytearray(self._data[: self._head])
        head[1] = len(payload)
        head[_SEQUENCE[self._is_v1]] = self.sequence
        return _sealed(head, payload, self.message_id)


def with_sequence(data: bytes, sequence: int) -> bytes:
    """The frame with another sequence number; unchanged if it has that number, or if its message is
    unknown."""
    found, is_v1 = header(data), data[0] == V1
    if found.sequence == sequence or found.message_id not in CRC_EXTRA:
        return data
    size = V1_HEADER if is_v1 else V2_HEADER
    head = bytearray(data[:size])
    head[_SEQUENCE[is_v1]] = sequence
    return _sealed(head, data[size : size + data[1]], found.message_id)


def _sealed(head: bytearray, payload: bytes, message_id: int) -> bytes:
    if head[0] != V1:
        head[2] = 0  # unsigned
    body = bytes(head[1:]) + payload
    return (
        bytes(head[:1])
        + body
        + mcrf4xx(body + bytes([CRC_EXTRA[message_id]])).to_bytes(CHECKSUM, "little")
    )
