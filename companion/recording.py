"""Recording every frame heard and sent, for months: one tlog a session, never over an existing
file.

A session begins with the first frame, and anew after `QUIET_S` without one. The files are written
by a thread of their own, so that neither a slow card nor a full disk delays the estimate. What the
disk does not take is dropped and counted; recording goes on in a new file once there is space
again.

A name is a folder (``DIR/kollsman-20261128T143000Z.tlog``), a file, or a pattern of `strftime` with
the date in UTC (``flights/%Y-%m-%d/%H%M%S.tlog``). Where the file exists already the next free
number is appended: ``flight-2.tlog``.
"""

import contextlib
import logging
import os
import queue
import shutil
import struct
import threading
import time
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO, Self

from pydantic import Field

from companion.config import Settings
from companion.errors import LogFormatError

logger = logging.getLogger("kollsman.recording")

STAMP = struct.Struct(">Q")
QUIET_S = 300.0
"""Silence of the link that ends a session."""
BATCH_S = 0.1
"""How often the file is written: what a killed process loses at most."""
POLL_S = 1.0
SYNC_S = 5.0
"""How much a power failure loses at most, where the disk obeys fsync."""
RETRY_S = 10.0
QUEUE_SIZE = 20_000
MEGABYTE = 1_000_000
STEM = "kollsman-%Y%m%dT%H%M%SZ.tlog"
LONGEST_NUMBER = 100_000


class RecordSettings(Settings):
    """Section ``record``."""

    path: str | None = Field(None, max_length=4096)
    """folder, file or strftime pattern to which every frame heard and sent is recorded; none: no
    recording; option --record replaces it"""
    rotate_mb: float = Field(256.0, ge=0.1, le=1_000_000)
    """size in megabytes at which a recording goes on in a new file"""
    free_mb: float = Field(200.0, ge=0, le=100_000_000)
    """free space in megabytes that recording leaves on the disk; it pauses below"""


class Recording:
    """A log writer that never raises after construction.

    Parameters
    ----------
    path : folder, file name or strftime pattern.
    settings : rotation and free space.

    Raises `LogFormatError` when the folder cannot be made or written.
    """

    def __init__(self, path: str | Path, settings: RecordSettings | None = None) -> None:
        self.paths: list[Path] = []
        """files written so far"""
        self.dropped = 0
        """frames that were not recorded"""
        self._settings = settings or RecordSettings()
        self._pattern = _pattern(path)
        _check_folder(Path(datetime.now(UTC).strftime(self._pattern)))
        self._queue: queue.Queue[tuple[int, bytes] | None] = queue.Queue(QUEUE_SIZE)
        self._file: BinaryIO | None = None
        self._size = 0
        self._last_us: int | None = None
        self._synced_s = time.monotonic()
        self._retry_s = 0.0
        self._problem = ""
        self._thread = threading.Thread(target=self._work, name="recording", daemon=True)
        self._thread.start()

    def write(self, time_us: int, frame: bytes) -> None:
        """Take one whole frame that was read or sent at `time_us` (UNIX microseconds)."""
        try:
            self._queue.put_nowait((time_us, frame))
        except queue.Full:
            self.dropped += 1

    def close(self) -> None:
        """Write what is queued and close the file; closing twice does no harm."""
        if self._thread.is_alive():
            with contextlib.suppress(queue.Full):
                self._queue.put(None, timeout=2.0)
            self._thread.join(5.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _work(self) -> None:
        """The thread: records in batches."""
        while True:
            try:
                batch = [self._queue.get(timeout=POLL_S)]
            except queue.Empty:
                batch = []
            if batch and batch[0] is not None:
                time.sleep(BATCH_S)
            with contextlib.suppress(queue.Empty):
                while len(batch) < QUEUE_SIZE:
                    batch.append(self._queue.get_nowait())
            self._store([item for item in batch if item is not None])
            if None in batch:
                self._finish()
                return

    def _store(self, records: list[tuple[int, bytes]]) -> None:
        try:
            for first, last in _sessions(records, self._last_us):
                self._append(records[first:last], is_new=first > 0 or self._quiet_before(records))
            self._sync()
        except OSError as error:
            self._pause(error.strerror or str(error))
        if records:
            self._last_us = records[-1][0]

    def _quiet_before(self, records: list[tuple[int, bytes]]) -> bool:
        return self._last_us is not None and abs(records[0][0] - self._last_us) > QUIET_S * MEGABYTE

    def _append(self, records: list[tuple[int, bytes]], *, is_new: bool) -> None:
        if is_new or self._size >= self._settings.rotate_mb * MEGABYTE:
            self._finish()
        if self._file is None and not self._open(records[0][0]):
            self.dropped += len(records)
            return
        assert self._file is not None
        data = b"".join(STAMP.pack(time_us) + frame for time_us, frame in records)
        try:
            _write_all(self._file, data)
        except OSError:
            self.dropped += len(records)
            with contextlib.suppress(OSError):
                self._file.truncate(self._size)  # half a record would cost the reader the next
            raise
        self._size += len(data)

    def _open(self, time_us: int) -> bool:
        """Make the next file; False while that is not possible."""
        now_s = time.monotonic()
        if now_s < self._retry_s:
            return False
        path = Path(datetime.fromtimestamp(time_us / 1e6, UTC).strftime(self._pattern))
        path.parent.mkdir(parents=True, exist_ok=True)
        if not self._has_space(path.parent):
            return False
        self._file, path = _create(path)
        self._size = 0
        self.paths.append(path)
        self._problem = ""
        logger.info("recording to %s", path)
        return True

    def _sync(self) -> None:
        """Every few seconds: to the disk, and whether there is space left."""
        now_s = time.monotonic()
        if self._file is None or now_s - self._synced_s < SYNC_S:
            return
        self._synced_s = now_s
        os.fsync(self._file.fileno())
        self._has_space(self.paths[-1].parent)

    def _has_space(self, folder: Path) -> bool:
        free_mb = shutil.disk_usage(folder).free / MEGABYTE
        if free_mb >= self._settings.free_mb:
            return True
        self._pause(f"less than {self._settings.free_mb:g} MB (record.free_mb) free for {folder}")
        return False

    def _pause(self, problem: str) -> None:
        """Close the file and try again later; a problem that goes on is logged once."""
        self._finish()
        self._retry_s = time.monotonic() + RETRY_S
        if problem != self._problem:
            logger.error("recording pauses: %s; the estimate goes on", problem)
        self._problem = problem

    def _finish(self) -> None:
        if self._file is None:
            return
        file, self._file = self._file, None
        with contextlib.suppress(OSError):
            os.fsync(file.fileno())
        with contextlib.suppress(OSError):
            file.close()
        if self._size == 0:  # nothing of it could be written
            with contextlib.suppress(OSError):
                self.paths.pop().unlink()


def _pattern(path: str | Path) -> str:
    text = str(path)
    if text.endswith(os.sep) or Path(text).is_dir() or not Path(text).suffix:
        return str(Path(text.replace("%", "%%") if Path(text).is_dir() else text) / STEM)
    return text


def _sessions(records: list[tuple[int, bytes]], last_us: int | None) -> list[tuple[int, int]]:
    """Where `records` are cut: at steps of time of more than `QUIET_S`."""
    cuts = [
        index
        for index in range(1, len(records))
        if abs(records[index][0] - records[index - 1][0]) > QUIET_S * 1e6
    ]
    edges = [0, *cuts, len(records)]
    return [pair for pair in pairwise(edges) if pair[0] < pair[1]]


def _create(path: Path) -> tuple[BinaryIO, Path]:
    """A new file at `path`, or at the first free number behind its name."""
    for number in range(1, LONGEST_NUMBER):
        numbered = path if number == 1 else path.with_stem(f"{path.stem}-{number}")
        try:
            return numbered.open("xb", buffering=0), numbered
        except FileExistsError:
            continue
    raise OSError(f"{path}: too many recordings of this name")


def _write_all(file: BinaryIO, data: bytes) -> None:
    """The kernel takes a part of `data` where the rest does not fit on the disk."""
    view = memoryview(data)
    while view:
        view = view[file.write(view) :]


def _check_folder(path: Path) -> None:
    """A mistake in the name is reported at the start, not in the air."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LogFormatError(
            f"{path}: the folder {path.parent} cannot be made: {error.strerror}"
        ) from error
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise LogFormatError(
            f"{path}: the folder {path.parent} cannot be written: permission denied"
        )
