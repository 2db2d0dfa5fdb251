"""Telemetry logs (.tlog): one record a frame, a big-endian 64-bit UNIX time in microseconds and
then the frame's bytes.

There is no header, no index and no checksum around a record, and what ground stations leave behind
is often damaged: junk at the start, zeros where the disk was full, a last frame cut short, a clock
that was never set. So `TlogReader` trusts as little as it needs to:

- Records that follow each other without a gap are taken at their word; the time may step either
  way, and a clock that says 1970 or 2908 is passed on as it is. Only a time after the year 3000 is
  refused, with its frame.
- A frame that fails where a record was due is skipped by its length when it is whole but of another
  dialect, or when the next record, or nothing, follows it.
- Otherwise the reader is lost and looks for the next frame with a good checksum whose time is
  within a day of its neighbours': the last good record and the one behind it. That keeps it from
  inventing frames out of junk, and from making a time out of junk for a real one.

Times that are little-endian or in milliseconds are recognised in the first records (`stamps_of`).
Ground stations built on pymavlink keep a link number in the lowest two bits of the time; it is left
there.
"""

import math
import os
import struct
from collections import Counter
from collections.abc import Generator, Iterator
from contextlib import closing
from pathlib import Path
from typing import Literal, Self, cast

import numpy as np
from numpy.typing import NDArray

from companion.errors import LogFormatError
from companion.logs.files import opened, read
from companion.logs.raw import frames_in
from companion.logs.reader import LogReader
from companion.mavlink.codec import MAX_FRAME_SIZE, Frame, FrameReject, scan
from companion.mavlink.columns import boot_stamp_us, tables
from companion.mavlink.framing import FOREIGN, extent, next_start
from companion.mavlink.record_scan import INDEX, scan_records
from companion.recorded import Batch
from companion.samples import Packet, Rows, rows

_STAMP = struct.Struct(">Q")
_pack_stamp = _STAMP.pack
_LAST_TIME_US = 32_503_680_000_000_000  # the year 3000
_NEIGHBOUR_US = 86_400_000_000
_CHUNK = 1 << 19
_SMALLEST_RECORD = 8 + 8  # a time and a frame without payload
_LOOKAHEAD = 4 * (_STAMP.size + MAX_FRAME_SIZE)  # a record, the one behind it, and some
_PROBE_BYTES = 1 << 24
_HEAD = 1 << 14
_MILLISECONDS = (946_684_800_000, 4_102_444_800_000)
"""of the years 2000 and 2100"""
_FLUSH_US = 1_000_000

_OTHER_FILES = (
    (b"\xd4\xc3\xb2\xa1", "a network capture (pcap); record a .tlog instead"),
    (b"\x0a\x0d\x0d\x0a", "a network capture (pcapng); record a .tlog instead"),
    (b"\x1f\x8b", "a gzip archive: unpack it first"),
    (b"\xfd7zXZ", "an xz archive: unpack it first"),
    (b"PK\x03\x04", "a zip archive: unpack it first, unless it is a NumPy file (.npz): no log"),
    (b"version https://git-lfs", "a Git LFS pointer: run `git lfs pull`"),
)


class TlogReader(LogReader):
    """The good frames of a tlog in file order, as `Packet`. Every iteration starts anew; one at a
    time.

    ``counters`` tell what was left out in the current iteration: JUNK in bytes (all that was
    skipped to find the next record), the other causes in frames. The memory used does not depend on
    the size of the file.

    Raises `LogFormatError` when the file cannot be read or has no good frame in its first 16 MB.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__(path)
        with opened(self.path) as file:
            self._order, self._unit_us = stamps_of(read(file, self.path, _HEAD))
        self._restart()
        self._probe()
        self._restart()

    def __iter__(self) -> Iterator[Packet]:
        return self._packets(math.inf)

    def batches(self) -> Iterator[Batch]:
        """The good records, one chunk of the file after the other."""
        return self._batches(math.inf)

    def _restart(self) -> None:
        self.counters.clear()
        self.frames = self.position_bytes = self._read_bytes = 0
        self._time_us: int | None = None
        self._lost = False

    def _packets(self, stop_bytes: float) -> Generator[Packet, None, None]:
        for batch in self._batches(stop_bytes):
            for time_us, frame in self.items_of(batch, ()):
                yield Packet(time_us, cast(Frame, frame).data)

    def _batches(self, stop_bytes: float) -> Generator[Batch, None, None]:
        """The records of one chunk of the file after the other."""
        self._restart()
        with opened(self.path) as file:
            self.size_bytes = os.fstat(file.fileno()).st_size
            buffer, at_end = b"", False
            while not at_end and self._read_bytes < stop_bytes:
                chunk = read(file, self.path, _CHUNK)
                at_end = len(chunk) < _CHUNK
                buffer += chunk
                limit = len(buffer) if at_end else len(buffer) - _LOOKAHEAD
                data = np.frombuffer(buffer, np.uint8)
                index = rows(INDEX, len(buffer) // _SMALLEST_RECORD + 1)
                count, offset = self._index(buffer, data, limit, index)
                index["time_us"][:count] *= self._unit_us
                start, self._read_bytes = self._read_bytes, self._read_bytes + offset
                found = index[:count]
                times_us = np.ascontiguousarray(found["time_us"])
                ends = start + found["stop"].astype("i8")
                yield Batch(times_us, ends, self._read_bytes, buffer, found)
                buffer = buffer[offset:]

    def _index(
        self, buffer: bytes, data: NDArray[np.uint8], limit: int, index: Rows
    ) -> tuple[int, int]:
        """Index the good records that begin before `limit`; their count and where they end."""
        count = offset = 0
        while offset < limit:
            if not self._lost:
                count, offset = scan_records(
                    data,
                    offset,
                    limit,
                    _LAST_TIME_US,
                    self._order == "little",
                    _STAMP.size,
                    *tables(),
                    index,
                    count,
                )
                if offset >= limit:
                    break
                if count:
                    self._time_us = int(index["time_us"][count - 1])
            frame = FrameReject.JUNK if self._lost else scan(buffer, offset + _STAMP.size)
            if isinstance(frame, Frame):
                self.counters[FrameReject.TIMESTAMP] += 1
                offset += _STAMP.size + len(frame.data)
            else:
                offset = self._recover(buffer, offset, limit, frame)
        if count:
            self._time_us = int(index["time_us"][count - 1])
        return count, offset

    def _recover(self, buffer: bytes, offset: int, limit: int, cause: FrameReject | None) -> int:
        """Where to go on when no good frame is where one was due; with `cause` None the file ends
        inside it."""
        end = offset + _STAMP.size + extent(buffer, offset + _STAMP.size)
        certain = (
            cause in FOREIGN or end == len(buffer) or self._record_stamp(buffer, end) is not None
        )
        if (
            cause is not None
            and cause is not FrameReject.JUNK
            and certain
            and self._stamp(buffer, offset) is not None
        ):
            self.counters[cause] += 1
            return end
        found = self._find(buffer, offset, limit)
        self._lost = found is None
        if found is None and cause is None:
            self.counters[FrameReject.TRUNCATED] += 1
            return len(buffer)
        end = limit if found is None else found
        self.counters[FrameReject.JUNK] += end - offset
        return end

    def _find(self, buffer: bytes, offset: int, limit: int) -> int | None:
        """The next record that begins at or after `offset` and before `limit`, if there is one to
        believe in."""
        at = next_start(buffer, offset + _STAMP.size)
        while at - _STAMP.size < limit and at < len(buffer):
            frame = scan(buffer, at)
            if not isinstance(frame, Frame):
                at = next_start(buffer, at + 1)
                continue
            if self._is_believable(buffer, at - _STAMP.size, at + len(frame.data)):
                return at - _STAMP.size
            self.counters[FrameReject.TIMESTAMP] += 1
            at = next_start(buffer, at + len(frame.data))
        return None

    def _is_believable(self, buffer: bytes, offset: int, end: int) -> bool:
        """Whether the time at `offset` is near that of the last good record, or of the record that
        follows at `end`."""
        time_us = self._stamp(buffer, offset)
        if time_us is None:
            return False
        neighbours = [
            time for time in (self._time_us, self._record_stamp(buffer, end)) if time is not None
        ]
        if not neighbours:
            return end == len(buffer)
        return any(abs(time_us - neighbour) <= _NEIGHBOUR_US for neighbour in neighbours)

    def _stamp(self, buffer: bytes, offset: int) -> int | None:
        """The time at `offset` in the file's own unit, if it is one."""
        stamp = int.from_bytes(buffer[offset : offset + _STAMP.size], self._order)
        return stamp if stamp <= _LAST_TIME_US else None

    def _record_stamp(self, buffer: bytes, offset: int) -> int | None:
        """The time of the record that seems to begin at `offset`, judged by its time and start byte
        alone."""
        at = offset + _STAMP.size
        is_record = at < len(buffer) and next_start(buffer, at) == at
        return self._stamp(buffer, offset) if is_record else None

    def _probe(self) -> None:
        """Raise `LogFormatError` unless there is something to read."""
        with closing(self._packets(_PROBE_BYTES)) as packets:
            if next(packets, None) is not None:
                return
        with opened(self.path) as file:
            found = _describe(read(file, self.path, _CHUNK), self.counters)
        raise LogFormatError(f"{self.path}: not a telemetry log (.tlog): {found}")


def stamps_of(head: bytes) -> tuple[Literal["big", "little"], int]:
    """Byte order and unit (in microseconds) of the times in the first bytes of a file.

    Some programs write little-endian times, some milliseconds. Big-endian microseconds are the
    rule: another order is taken when its times are of this century and those of the rule are not,
    and milliseconds when the vehicle's own clock runs a thousand times as fast as the stamps.
    """
    boot_us = 0
    big, little, boots = [], [], []
    for at, frame in frames_in(head):
        boot_us = boot_stamp_us(frame, boot_us)
        if at >= _STAMP.size:
            big.append(int.from_bytes(head[at - _STAMP.size : at], "big"))
            little.append(int.from_bytes(head[at - _STAMP.size : at], "little"))
            boots.append(boot_us)
    is_little = sum(map(_this_century, little)) > sum(stamp <= _LAST_TIME_US for stamp in big)
    stamps = little if is_little else big
    order: Literal["big", "little"] = "little" if is_little else "big"
    timed = [i for i, (stamp, boot) in enumerate(zip(stamps, boots, strict=True)) if boot and stamp]
    if len(timed) < 2 or not all(_MILLISECONDS[0] < stamps[i] < _MILLISECONDS[1] for i in timed):
        return order, 1
    passed_us = boots[timed[-1]] - boots[timed[0]]
    counted = stamps[timed[-1]] - stamps[timed[0]]
    return order, 1000 if passed_us > 0 and 0 <= counted < 0.02 * passed_us else 1


def _this_century(stamp: int) -> bool:
    """Of the years 2000 to 2100, in microseconds or milliseconds."""
    return any(_MILLISECONDS[0] * scale < stamp < _MILLISECONDS[1] * scale for scale in (1, 1000))


def record(time_us: int, frame: bytes) -> bytes:
    """One record of a tlog: its time (UNIX microseconds) and a frame."""
    return _pack_stamp(time_us) + frame


class TlogWriter:
    """Writes a tlog that other ground stations can play, replacing the file if there is one.

    A killed process loses at most the last second. Raises `LogFormatError` when the file cannot be
    written.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._flushed_us = -_FLUSH_US
        try:
            self._file = self.path.open("wb")
        except FileNotFoundError as error:
            raise LogFormatError(
                f"{self.path}: the folder {self.path.parent} does not exist: create it"
            ) from error
        except OSError as error:
            raise self._failure(error) from error

    def write(self, time_us: int, frame: bytes) -> None:
        """Append one whole frame that was read or sent at `time_us` (UNIX microseconds)."""
        self.write_records(record(time_us, frame), time_us)

    def write_records(self, records: bytes, time_us: int) -> None:
        """Append records (see `record`) of which the last is of `time_us`."""
        try:
            self._file.write(records)
            if not 0 <= time_us - self._flushed_us < _FLUSH_US:
                self._file.flush()
                self._flushed_us = time_us
        except OSError as error:
            raise self._failure(error) from error

    def close(self) -> None:
        """Write what is buffered and close the file; closing twice does no harm."""
        try:
            self._file.close()
        except OSError as error:
            raise self._failure(error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _failure(self, error: OSError) -> LogFormatError:
        return LogFormatError(f"{self.path}: cannot be written: {error.strerror or error}")


def _describe(head: bytes, counters: Counter[FrameReject]) -> str:
    """What a file without a good record seems to be, and what to do."""
    if not head:
        return "the file is empty"
    for magic, name in _OTHER_FILES:
        if head.startswith(magic):
            return f"it looks like {name}"
    if not head.strip(b"\0"):
        return "it begins with nothing but zeros"
    if counters[FrameReject.TIMESTAMP]:
        return "its frames have impossible times (after the year 3000)"
    if head.isascii() and b"\0" not in head:
        return "it is text without ArduPilot's FMT lines (CSV, JSON and the like are no logs)"
    return "no MAVLink frame of a known dialect was found in it"
