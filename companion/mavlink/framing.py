"""What a MAVLink frame is: where it ends, and whether its checksum is right. Pure functions of
bytes.

A frame begins with 0xFD (MAVLink 2) or 0xFE (MAVLink 1) and carries its length, so it can be cut
out unread. Its checksum covers everything but the first byte, and ends with one byte that is not
sent: CRC_EXTRA, a hash of the message's definition. So a frame that fails can still tell whether it
was damaged, or is whole and of another dialect: then its checksum is right with some other
CRC_EXTRA (which one damaged frame in 256 is by chance).
"""

import re
import struct
from collections.abc import Callable
from enum import StrEnum
from functools import partial
from typing import Any, NamedTuple

from fastcrc import crc16
from pymavlink.dialects.v20 import ardupilotmega as mavlink

V1, V2 = 0xFE, 0xFD
V1_HEADER, V2_HEADER = 6, 10
CHECKSUM, SIGNATURE = 2, 13
MAX_FRAME_SIZE = V2_HEADER + 255 + CHECKSUM + SIGNATURE
_SIGNED = 0x01  # the only incompatibility flag there is
_V2_IDS = struct.Struct("<BBBHB").unpack_from
_START = re.compile(rb"[\xfd\xfe]")


def _v1_lengths(kind: Any) -> range:
    """Payload lengths from the size without extensions (fields with a default, last on the wire) to
    the size with them."""
    count = len(kind.fieldnames) - len(kind.__init__.__defaults__ or ())
    codes = kind.native_format.decode().lstrip("<")[:count]
    base = "".join(
        f"{length or 1}{code}"
        for code, length in zip(codes, kind.array_lengths[:count], strict=True)
    )
    return range(struct.calcsize("<" + base), kind.unpacker.size + 1)


mcrf4xx: Callable[..., int] = crc16.mcrf4xx
CRC_TABLE = [mcrf4xx(bytes([value]), 0) for value in range(256)]
_CRC_STEPS = frozenset(CRC_TABLE)
CRC_EXTRA: dict[int, int] = {number: kind.crc_extra for number, kind in mavlink.mavlink_map.items()}
_EXTRA_BYTES = {number: bytes([extra]) for number, extra in CRC_EXTRA.items()}
V1_LENGTHS: dict[int, range] = {
    number: _v1_lengths(kind) for number, kind in mavlink.mavlink_map.items()
}
"""Payload lengths by message id. They must fit, or MAVLink 1 finds a frame in every 2 MB of
noise."""


class Frame(NamedTuple):
    """One whole frame with a correct checksum. Its signature is verified by `signing`."""

    data: bytes
    """bytes from the start byte to the end of the checksum, or of the signature"""
    message_id: int
    system_id: int
    component_id: int
    sequence: int
    version: int
    """1 or 2"""
    signed: bool
    message: Any = None
    """the decoded message, where a log's reader has decoded it already"""


_new: Callable[[tuple[Any, ...]], Frame] = partial(tuple.__new__, Frame)
"""`Frame` of a tuple, without the Python code of its constructor"""


class FrameReject(StrEnum):
    """Why bytes did not become a message. JUNK counts bytes, all others count frames."""

    JUNK = "junk bytes"
    """bytes outside any frame"""
    CRC = "bad checksum"
    """damaged in transmission"""
    DIALECT = "other dialect"
    """undamaged, by another definition of a known message id"""
    UNKNOWN_ID = "unknown message"
    """undamaged, with an unknown message id"""
    FLAGS = "unknown flags"
    """incompatibility flags other than "signed", with which MAVLink forbids to read the frame"""
    TRUNCATED = "cut frame"
    """the stream, datagram or log ended inside it"""
    DECODE = "bad payload"
    """a good frame with a payload that pymavlink refuses"""
    TIMESTAMP = "bad time stamp"
    """a good frame of a log, with an impossible time"""
    UNSIGNED = "unsigned"
    """a good frame without a signature, where signatures are required"""
    SIGNATURE = "bad signature"
    """a good frame, signed with another key"""
    REPEATED = "repeated signature"
    """signed with our key, but not newer than what came before"""


FOREIGN = frozenset({FrameReject.DIALECT, FrameReject.UNKNOWN_ID})
"""The causes that leave no doubt about where the frame ends."""


def extent(buffer: bytes, offset: int) -> int:
    """The length in bytes of the frame whose start byte is at `offset`, by its header (the
    rest of the data, where the header does not tell)."""
    available = len(buffer) - offset
    if available >= 3 and buffer[offset] == V2:
        signature = SIGNATURE if buffer[offset + 2] & _SIGNED else 0
        return buffer[offset + 1] + V2_HEADER + CHECKSUM + signature
    if available >= 2 and buffer[offset] == V1:
        return buffer[offset + 1] + V1_HEADER + CHECKSUM
    return available


def scan(buffer: bytes, offset: int = 0) -> Frame | FrameReject | None:
    """What begins at `offset`: a frame, the reason why none does, or None when that takes more
    bytes."""
    available = len(buffer) - offset
    if available <= 0:
        return None
    start = buffer[offset]
    if start not in (V1, V2):
        return FrameReject.JUNK
    if available < 3:
        return None
    version, header, flags = (
        (2, V2_HEADER, buffer[offset + 2]) if start == V2 else (1, V1_HEADER, 0)
    )
    if flags & ~_SIGNED:
        return FrameReject.FLAGS
    length = buffer[offset + 1]
    body = offset + header + length
    end = body + CHECKSUM + (SIGNATURE if flags else 0)
    if end > offset + available:
        return None
    if version == 2:
        sequence, system_id, component_id, low, high = _V2_IDS(buffer, offset + 4)
        message_id = low | high << 16
    else:
        sequence, system_id, component_id, message_id = buffer[offset + 2 : offset + header]
    checksum = buffer[body] | buffer[body + 1] << 8
    extra = _EXTRA_BYTES.get(message_id)
    if extra is None or mcrf4xx(buffer[offset + 1 : body] + extra) != checksum:
        return _cause(buffer[offset + 1 : body], checksum, message_id)
    if version == 1 and length not in V1_LENGTHS[message_id]:
        return FrameReject.DIALECT
    data = buffer if end - offset == len(buffer) else buffer[offset:end]
    return _new((data, message_id, system_id, component_id, sequence, version, flags != 0, None))


def _cause(body: bytes, checksum: int, message_id: int) -> FrameReject:
    """Why a frame with this body and checksum is none.

    The last step of the checksum is table[(crc ^ extra) & 255] ^ crc >> 8, with CRC_EXTRA the byte
    that is not sent.
    """
    if checksum ^ mcrf4xx(body) >> 8 not in _CRC_STEPS:
        return FrameReject.CRC
    return FrameReject.UNKNOWN_ID if message_id not in CRC_EXTRA else FrameReject.DIALECT


def next_start(buffer: bytes, offset: int) -> int:
    """Where the next start byte at or after `offset` is; the end of the buffer if there is none."""
    match = _START.search(buffer, offset)
    return match.start() if match else len(buffer)
