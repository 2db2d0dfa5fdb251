"""MAVLink bytes <-> messages. No I/O, and no data raises an error: what is not a frame is counted
by `FrameReject`.

Resynchronisation
-----------------
Losing real frames and inventing frames are the two ways to be wrong after a damaged byte. What
decides here:

- A frame whose checksum is right is a frame.
- A frame of another dialect (see `framing`) with a start byte or nothing behind it is skipped by
  its length, so that its payload cannot be mistaken for frames.
- Everything else that looks like a start is not one. The search goes on one byte later, so that a
  stray 0xFD swallows none of the good frames behind it. If none turns up before the end that its
  header gives it was a damaged frame and counts as one; otherwise its bytes were junk.

The frames found do not depend on how the stream was cut into chunks. The price: a stray start byte
holds back the frames behind it until the length that its header gives (280 bytes at most) has
arrived. On a live link, `Decoder.flush` when the line has been silent for longer than a frame
lasts, or use ``Decoder(datagrams=True)`` where a packet holds whole frames.
"""

from collections import Counter, namedtuple
from collections.abc import Callable
from functools import cache
from operator import attrgetter
from typing import Any, NamedTuple, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.mavlink.framing import (
    CHECKSUM,
    CRC_EXTRA,
    FOREIGN,
    MAX_FRAME_SIZE,
    V1,
    V1_HEADER,
    V1_LENGTHS,
    V2,
    V2_HEADER,
    Frame,
    FrameReject,
    extent,
    mcrf4xx,
    next_start,
    scan,
)
from companion.mavlink.signing import Signing

__all__ = [
    "MAX_FRAME_SIZE",
    "FrameReject",
    "Decoder",
    "Encoder",
    "Frame",
    "Message",
    "decode",
    "light",
    "mavlink",
    "scan",
]

Message: TypeAlias = Any
"""A pymavlink message: ``get_type()``, ``get_srcSystem()``, its fields as attributes in MAVLink's
own units. A light one is a named tuple of the fields."""
_V1, _V2 = bytes([V1]), bytes([V2])


class Decoder:
    """Cuts a stream of bytes into frames, and counts what was none.

    With ``datagrams=True`` every `feed` is complete in itself: a frame cut at the end of one is
    dropped, and delays nothing in the next.
    """

    def __init__(self, *, datagrams: bool = False) -> None:
        self.counters: Counter[FrameReject] = Counter()
        self.frames = 0
        self._datagrams = datagrams
        self._rest = b""
        # The failed start whose extent is being searched: why it failed, its length by header, and
        # what is left of that.
        self._suspect: FrameReject | None = None
        self._suspect_size = 0
        self._suspect_left = 0

    @property
    def is_empty(self) -> bool:
        """Whether nothing is kept of what was fed."""
        return not self._rest and self._suspect is None

    def put_back(self, most: int) -> int:
        """Forget the bytes that are kept because a frame is not complete, for the caller to take
        them again; how many. -1 when they are more than `most`, or belong to a damaged place."""
        if self._suspect is not None or len(self._rest) > most:
            return -1
        count, self._rest = len(self._rest), b""
        return count

    def feed(self, data: bytes) -> list[Frame]:
        """The frames that are complete now. At most `MAX_FRAME_SIZE` bytes are kept for the next
        call."""
        return self._cut(self._rest + data, final=self._datagrams)

    def flush(self) -> list[Frame]:
        """Give up waiting for the rest of what was kept, and return the frames that this sets
        free."""
        return self._cut(self._rest, final=True)

    def decode(self, frame: Frame) -> Message | None:
        """`decode`, with a failure counted; a message that the frame carries is taken as it is."""
        message = frame.message if frame.message is not None else decode(frame)
        if message is None:
            self.counters[FrameReject.DECODE] += 1
        return message

    def read(self, frame: Frame) -> Message | None:
        """The same as a light message where its kind has one: many times faster."""
        message = frame.message if frame.message is not None else light(frame)
        if message is None:
            self.counters[FrameReject.DECODE] += 1
        return message

    def _cut(self, buffer: bytes, *, final: bool) -> list[Frame]:
        frames: list[Frame] = []
        offset, size = 0, len(buffer)
        while offset < size:
            found = scan(buffer, offset)
            if isinstance(found, Frame):
                frames.append(found)
                offset += len(found.data)
                if self._suspect is not None:
                    self._clear_suspect()
                continue
            if found is None:
                if not final:
                    break
                found = FrameReject.TRUNCATED
            end = self._pass(buffer, offset, found, final=final)
            if end is None:
                break
            offset = end
        if final:
            self._convict_suspect()
        self._rest = buffer[offset:]
        self.frames += len(frames)
        return frames

    def _pass(self, buffer: bytes, offset: int, cause: FrameReject, *, final: bool) -> int | None:
        """Count what is at `offset` and return where to go on; None when the next byte must be
        known first."""
        if cause in FOREIGN:
            end = offset + extent(buffer, offset)
            if end == len(buffer) and not final:
                return None
            if end == len(buffer) or next_start(buffer, end) == end:
                self._clear_suspect()
                self.counters[cause] += 1
                return end
        if self._suspect is None and cause is not FrameReject.JUNK:
            self._suspect = cause
            self._suspect_size = self._suspect_left = extent(buffer, offset)
        end = next_start(buffer, offset + 1)
        searched = end - offset
        if self._suspect is not None:
            self._suspect_left -= searched
            searched = max(0, -self._suspect_left)
            if self._suspect_left <= 0:
                self._convict_suspect()
        if searched:
            self.counters[FrameReject.JUNK] += searched
        return end

    def _convict_suspect(self) -> None:
        """No frame began inside the suspect: it was a damaged one."""
        if self._suspect is not None:
            self.counters[self._suspect] += 1
            self._suspect = None

    def _clear_suspect(self) -> None:
        """A frame began inside the suspect: what came before it was junk."""
        if self._suspect is not None:
            self.counters[FrameReject.JUNK] += self._suspect_size - self._suspect_left
            self._suspect = None


class _Layout(NamedTuple):
    """How to make a message from its payload."""

    make: Callable[..., Message]
    unpack: Callable[[bytes], tuple[Any, ...]]
    size: int
    fields: list[int | slice]
    """where the constructor's arguments are in the unpacked tuple (the wire sorts them by size)"""
    numbers_only: bool


@cache
def _layout(message_id: int) -> _Layout:
    kind = mavlink.mavlink_map[message_id]
    fields: list[int | slice] = []
    for order in kind.orders:
        first, length = sum(kind.lengths[:order]), kind.lengths[order]
        fields.append(first if length == 1 else slice(first, first + length))
    numbers_only = max(kind.lengths) == 1 and "char" not in kind.fieldtypes
    return _Layout(kind, kind.unpacker.unpack_from, kind.unpacker.size, fields, numbers_only)


def decode(frame: Frame) -> Message | None:
    """The message in `frame`, as pymavlink would give it (but twice as fast), or None when
    pymavlink refuses it."""
    data = frame.data
    length = data[1]
    head, flags = (V2_HEADER, (data[2], data[3])) if frame.version == 2 else (V1_HEADER, (0, 0))
    try:
        make, unpack, size, fields, numbers_only = _layout(frame.message_id)
        # MAVLink 2 does not send the zeros at the end of a payload, MAVLink 1 not the extension
        # fields.
        values = unpack(data[head : head + length].ljust(size, b"\0"))
        arguments = [values[index] for index in fields]
        message = make(*(arguments if numbers_only else map(_field, arguments)))
    except (
        Exception
    ):  # whatever a generated constructor may raise, a frame from outside must not stop us
        return None
    message._header = mavlink.MAVLink_header(
        frame.message_id, *flags, length, frame.sequence, frame.system_id, frame.component_id
    )
    message._msgbuf = data
    message._payload = data[head : head + length]
    message._crc = data[head + length] | data[head + length + 1] << 8
    return message


class Numbers(NamedTuple):
    """A kind whose fields are all single numbers."""

    unpack: Callable[[bytes], tuple[Any, ...]]
    pack: Callable[..., bytes]
    size: int
    make: Callable[[tuple[Any, ...]], Message]
    """makes a light message of the fields in the order of the wire"""
    fields: Callable[[Message], Any]
    """these fields of a message"""


@cache
def numbers(message_id: int) -> Numbers | None:
    """The layout of a kind, or None when it has texts, arrays or an id that is not known."""
    kind = mavlink.mavlink_map.get(message_id)
    if kind is None or max(kind.lengths) != 1 or "char" in kind.fieldtypes:
        return None
    names, wire = kind.ordered_fieldnames, kind.unpacker
    plain: Any = namedtuple(kind.msgname, names)  # type: ignore[misc]
    more: dict[str, Any] = {"__slots__": (), "get_type": staticmethod(lambda: kind.msgname)}
    if "id" not in names:
        more["id"] = message_id
    made: Any = type(kind.msgname, (plain,), more)
    fields = attrgetter(*names) if len(names) > 1 else lambda each: (getattr(each, names[0]),)
    return Numbers(wire.unpack, wire.pack, wire.size, made._make, fields)


def light(frame: Frame) -> Message | None:
    """The message in `frame` as a named tuple of its fields, and as `decode` gives it where these
    are not all single numbers."""
    found = numbers(frame.message_id)
    if found is None:
        return decode(frame)
    data = frame.data
    head = V2_HEADER if frame.version == 2 else V1_HEADER
    payload = data[head : head + data[1]]
    if len(payload) < found.size:
        payload = payload.ljust(found.size, b"\0")
    return found.make(found.unpack(payload[: found.size]))


def _field(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.rstrip(b"\0")
    return list(value) if isinstance(value, tuple) else value


@cache
def _packing(message_id: int) -> tuple[Callable[..., bytes], Callable[[Message], Any]]:
    """How to pack the payload of a kind, and the numbers and texts of a message to pack."""
    kind, found = mavlink.mavlink_map[message_id], numbers(message_id)
    if found is not None:
        return found.pack, found.fields
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    sizes = [
        (f"_{name}_raw" if types[name] == "char" else name, count)
        for name, count in zip(kind.ordered_fieldnames, kind.lengths, strict=True)
    ]

    def fields(message: Message) -> list[Any]:
        values: list[Any] = []
        for name, count in sizes:
            value = getattr(message, name)
            values += [value] if count == 1 else value[:count]
        return values

    return kind.unpacker.pack, fields


class Encoder:
    """Messages -> frames of one sender, with its sequence numbers, signed if `signing` is given."""

    def __init__(self, system_id: int, component_id: int, signing: Signing | None = None) -> None:
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._ids = system_id, component_id
        self._signing = signing
        if signing is not None:
            own = self._mav.signing
            own.secret_key, own.link_id, own.sign_outgoing = signing.key, signing.link_id, True

    def encode(self, message: Message, version: int = 2) -> bytes:
        """The frame in MAVLink `version` 1 or 2; ``b""`` if MAVLink 1 cannot carry the message (ids
        above 255).

        A signed frame is MAVLink 2. Raises struct.error for a value that its field cannot hold: a
        bug of the caller, not data.
        """
        if self._signing is not None:
            version, self._mav.signing.timestamp = 2, self._signing.next_stamp()
        message_id: int = type(message).id  # the instance's may be a field of that name
        if version == 1 and message_id > 0xFF:
            return b""
        sequence = self._mav.seq
        if self._signing is None:
            pack, fields = _packing(message_id)
            data = self._frame(message_id, pack(*fields(message)), sequence, version)
            if not isinstance(message, tuple):
                message._msgbuf = data
        else:
            kind = mavlink.mavlink_map[message_id]
            if isinstance(message, tuple):  # a light one
                values = dict(zip(kind.ordered_fieldnames, message, strict=True))
                message = kind(**values)
            data = message.pack(self._mav)
        self._mav.seq = (sequence + 1) % 256
        return data

    def _frame(self, message_id: int, payload: bytes, sequence: int, version: int) -> bytes:
        """A whole frame, unsigned."""
        if version == 1:
            payload = payload[: V1_LENGTHS[message_id].start]
            start, head = _V1, bytes((len(payload), sequence, *self._ids, message_id))
        else:
            payload = payload.rstrip(b"\0") or b"\0"
            start = _V2
            head = bytes((len(payload), 0, 0, sequence, *self._ids)) + message_id.to_bytes(
                3, "little"
            )
        body = head + payload
        crc = mcrf4xx(body + bytes((CRC_EXTRA[message_id],)))
        return start + body + crc.to_bytes(CHECKSUM, "little")
