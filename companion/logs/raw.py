"""Raw captures: MAVLink frames one after the other without times (.raw, .tlog.raw).

The vehicle's own boot stamps are the only clock there is: a frame arrives at the newest boot time
heard from its sender's system, and what has no stamp arrives with the frame before it.
"""

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import cast

import numpy as np

from companion.errors import LogFormatError
from companion.logs.files import opened, read
from companion.logs.reader import LogReader
from companion.mavlink.codec import Decoder, Frame, mavlink
from companion.mavlink.columns import BOOT_STAMP, columns, has_boot_stamp, tables
from companion.mavlink.record_scan import INDEX, scan_records
from companion.recorded import Batch
from companion.samples import Packet, Rows, rows

CHUNK = 1 << 20
PIECE = 1024
"""bytes that the decoder gets at a time, around a damaged place"""
SMALLEST_FRAME = 8
PROBE_BYTES = 1 << 18
FEWEST_FRAMES = 3
LOWEST_SHARE = 0.5
STAMP_BYTES = 8


def is_raw(head: bytes) -> bool:
    """Whether most frames in the first bytes of a file follow each other without a time between."""
    return _share_apart(head, 0) > LOWEST_SHARE


def is_tlog(head: bytes) -> bool:
    """Whether most frames in the first bytes of a file follow each other with a time between."""
    return _share_apart(head, STAMP_BYTES) > LOWEST_SHARE


def _share_apart(head: bytes, gap_bytes: int) -> float:
    """Share of the frames that begin `gap_bytes` after the end of the frame before."""
    found = frames_in(head)
    apart, end = 0, -1
    for at, frame in found:
        apart += at == end + gap_bytes
        end = at + len(frame.data)
    return apart / (len(found) - 1) if len(found) >= FEWEST_FRAMES else 0.0


@lru_cache(maxsize=1)
def frames_in(head: bytes) -> list[tuple[int, Frame]]:
    """(place, frame) of the frames in the first bytes of a file."""
    found, end = [], 0
    for frame in Decoder().feed(head):
        at = head.find(frame.data, end)
        found.append((at, frame))
        end = at + len(frame.data)
    return found


class RawReader(LogReader):
    """The good frames of a raw capture in file order.

    Raises `LogFormatError` when the file cannot be read or holds no MAVLink frame.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__(path)
        with opened(self.path) as file:
            head = read(file, self.path, PROBE_BYTES)
            self.size_bytes = self.path.stat().st_size
        if not head:
            raise LogFormatError(f"{self.path}: the file is empty")
        if not Decoder(datagrams=True).feed(head):
            raise LogFormatError(
                f"{self.path}: not a raw capture of MAVLink: no frame of a known dialect in it"
            )

    def __iter__(self) -> Iterator[Packet]:
        for time_us, frame in self.items():
            yield Packet(time_us, cast(Frame, frame).data)

    def batches(self) -> Iterator[Batch]:
        """The good frames of one chunk of the file after the other; their time is the vehicle's
        boot clock."""
        decoder, now_us = Decoder(), 0
        self.counters = decoder.counters
        self.position_bytes = self.frames = read_bytes = 0
        with opened(self.path) as file:
            while True:
                chunk = read(file, self.path, CHUNK)
                read_bytes += len(chunk)
                buffer, index = indexed(b"".join(_frames_of(decoder, chunk)))
                now_us = _stamp(buffer, index, now_us)
                times_us = np.ascontiguousarray(index["time_us"])
                ends = np.full(index.size, read_bytes)
                yield Batch(times_us, ends, read_bytes, buffer, index)
                if not chunk:
                    return


def _frames_of(decoder: Decoder, chunk: bytes) -> Iterator[bytes]:
    """The bytes of the frames that are complete with `chunk`, without what is between them; those
    that are left if it is empty.

    Whole frames are found by the compiled scan; a damaged place is left to `decoder`, which also
    keeps what is cut at the end of the chunk.
    """
    data, offset = np.frombuffer(chunk, np.uint8), 0
    index = rows(INDEX, len(chunk) // SMALLEST_FRAME + 1)
    while offset < len(chunk):
        kept = decoder.put_back(offset)
        if kept >= 0:
            offset -= kept
            _, stop = scan_records(data, offset, len(chunk), 0, 0, 0, *tables(), index, 0)
            yield chunk[offset:stop]
            offset = stop
        piece = chunk[offset : offset + PIECE]
        offset += len(piece)
        yield from (frame.data for frame in decoder.feed(piece))
    if not chunk:
        yield from (frame.data for frame in decoder.flush())


def indexed(frames: bytes) -> tuple[bytes, Rows]:
    """Good frames that follow each other, with their INDEX rows."""
    index = rows(INDEX, len(frames) // SMALLEST_FRAME + 1)
    data = np.frombuffer(frames, np.uint8)
    count, _ = scan_records(data, 0, len(frames), 0, 0, 0, *tables(), index, 0)
    return frames, index[:count]


def _stamp(buffer: bytes, index: Rows, now_us: int) -> int:
    """Fill in the times of frames; the newest time."""
    stamps = np.full(index.size, -1)
    data = np.frombuffer(buffer, np.uint8)
    is_autopilot = index["component_id"] == mavlink.MAV_COMP_ID_AUTOPILOT1
    for message_id in np.unique(index["message_id"][is_autopilot]).tolist():
        if has_boot_stamp(message_id):
            where = np.flatnonzero(is_autopilot & (index["message_id"] == message_id))
            boot_ms = columns(data, index[where], message_id)[BOOT_STAMP]
            stamps[where] = boot_ms.astype(np.int64) * 1000
    newest = np.maximum.accumulate(np.where(stamps >= 0, np.arange(index.size), -1))
    index["time_us"] = np.where(newest >= 0, stamps[newest], now_us)
    return int(index["time_us"][-1]) if index.size else now_us
