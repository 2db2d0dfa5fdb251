"""Logs of an autopilot as tables of columns, and their rows as items in the order of the file.

A reader fills `Tables` with one `Table` a sensor; `items` merges them by their place in the file. A
HEARTBEAT of the vehicle goes out once a second of boot time, armed as the log says.
"""

import heapq
import math
from bisect import bisect_right
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.mavlink.codec import Encoder, Frame, FrameReject, mavlink, scan
from companion.mavlink.convert import Reading, TimeBase
from companion.recorded import Height, Item, Sensed, Throttle
from companion.samples import Kind

Array = NDArray[np.float64]
FIRST_SOURCE = 1 << 24
"""above every MAVLink message id"""
CHUNK = 4096
HEARTBEAT_US = 1_000_000
UNIX_US = 1_000_000_000_000_000
"""A time above this counts from 1970, not from boot."""


@dataclass(frozen=True)
class Table:
    """The readings of one sensor."""

    kind: Kind
    place: NDArray[np.int64]
    """of each row in the file, shape (n,), increasing"""
    time_us: NDArray[np.int64]
    """since boot, shape (n,)"""
    instance: int
    values: tuple[Any, ...]
    """the columns behind ``instance`` of the kind's dtype; shape (n,) or (n, 3) each"""


@dataclass(frozen=True)
class Heights:
    """Altitudes to compare with."""

    is_truth: bool
    place: NDArray[np.int64]
    time_us: NDArray[np.int64]
    altitude_amsl_m: Array
    climb_mps: Array


@dataclass(frozen=True)
class Throttles:
    """What was asked of the motors."""

    place: NDArray[np.int64]
    time_us: NDArray[np.int64]
    share: Array
    """0 to 1"""


@dataclass
class Tables:
    """What a reader found in one log."""

    sensors: list[Table] = field(default_factory=list)
    heights: list[Heights] = field(default_factory=list)
    throttles: list[Throttles] = field(default_factory=list)
    armed: list[tuple[int, bool]] = field(default_factory=list)
    """(time_us since boot, armed), increasing in time"""
    system_id: int = 1
    autopilot: int = int(mavlink.MAV_AUTOPILOT_GENERIC)
    vehicle_type: int = int(mavlink.MAV_TYPE_GENERIC)
    utc_offset_us: int = 0
    """UNIX time minus boot time; 0 when the log does not tell"""
    parameters: dict[str, float] = field(default_factory=dict)
    modes: list[tuple[int, str]] = field(default_factory=list)
    """(time_us since boot, flight mode)"""
    texts: list[tuple[int, str]] = field(default_factory=list)
    """(time_us since boot, what the autopilot said)"""

    def items(self) -> Iterator[tuple[int, int, Item]]:
        """(place in the file, arrival_us, item) in the order of the file."""
        streams = [
            _readings(table, FIRST_SOURCE + number, number)
            for number, table in enumerate(self.sensors)
        ]
        first = len(self.sensors)
        streams += [_heights(each, first + number) for number, each in enumerate(self.heights)]
        first += len(self.heights)
        streams += [_throttles(each, first + number) for number, each in enumerate(self.throttles)]
        encoder = Encoder(self.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
        beat_us = -HEARTBEAT_US
        for (place, _), time_us, item in heapq.merge(*streams, key=lambda entry: entry[0]):
            if not beat_us <= time_us < beat_us + HEARTBEAT_US:
                beat_us = time_us
                yield place, time_us + self.utc_offset_us, self._heartbeat(encoder, time_us)
            yield place, time_us + self.utc_offset_us, item

    def _heartbeat(self, encoder: Encoder, time_us: int) -> Frame:
        changes = bisect_right(self.armed, time_us, key=lambda change: change[0])
        armed = self.armed[changes - 1][1] if changes else False
        message = mavlink.MAVLink_heartbeat_message(
            self.vehicle_type,
            self.autopilot,
            mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0,
            0,
            mavlink.MAV_STATE_ACTIVE,
            3,
        )
        frame = scan(encoder.encode(message))
        assert isinstance(frame, Frame)
        return frame._replace(message=message)


def _since_start(tables: Tables) -> Tables:
    """With times from the first row on, where they count from 1970 as a simulator's may."""
    first_us = min((int(table.time_us.min()) for table in tables.sensors), default=0)
    if first_us < UNIX_US:
        return tables
    tables.sensors = [replace(each, time_us=each.time_us - first_us) for each in tables.sensors]
    tables.heights = [replace(each, time_us=each.time_us - first_us) for each in tables.heights]
    tables.throttles = [replace(each, time_us=each.time_us - first_us) for each in tables.throttles]
    tables.armed = [(time_us - first_us, armed) for time_us, armed in tables.armed]
    tables.modes = [(time_us - first_us, mode) for time_us, mode in tables.modes]
    tables.texts = [(time_us - first_us, text) for time_us, text in tables.texts]
    tables.utc_offset_us += first_us
    return tables


class TableReader:
    """A log of tables as a reader: items in the order of the file. Every iteration starts anew.

    ``counters`` tell what was left out, by cause; ``position_bytes`` how far the iteration is.
    """

    def __init__(
        self, path: Path, tables: Tables, size_bytes: int, counters: Counter[FrameReject]
    ) -> None:
        self.path = path
        self.tables = _since_start(tables)
        self.counters = counters
        self.size_bytes = size_bytes
        self.position_bytes = 0
        self.frames = 0
        """items given so far"""

    def items(self, wanted: Collection[int] = ()) -> Iterator[tuple[int, Item]]:
        """(arrival_us, item) in the order of the file; `wanted` is of no use here."""
        self.frames = self.position_bytes = 0
        last = max((int(table.place[-1]) for table in self.tables.sensors), default=1)
        for place, time_us, item in self.tables.items():
            self.frames += 1
            self.position_bytes = min(self.size_bytes, place * self.size_bytes // max(1, last))
            yield time_us, item
        self.position_bytes = self.size_bytes


def _readings(
    table: Table, source: int, number: int
) -> Iterator[tuple[tuple[int, int], int, Item]]:
    for start in range(0, table.place.size, CHUNK):
        part = slice(start, start + CHUNK)
        columns = [_plain(values[part]) for values in table.values]
        places, times = table.place[part].tolist(), table.time_us[part].tolist()
        for place, time_us, *values in zip(places, times, *columns, strict=True):
            reading = Reading(table.kind, TimeBase.BOOT, time_us, table.instance, tuple(values))
            yield (place, number), time_us, Sensed(source, reading)


def _heights(heights: Heights, number: int) -> Iterator[tuple[tuple[int, int], int, Item]]:
    rows = (heights.place, heights.time_us, heights.altitude_amsl_m, heights.climb_mps)
    for place, time_us, altitude_m, climb_mps in zip(*(a.tolist() for a in rows), strict=True):
        if math.isfinite(altitude_m):
            yield (place, number), time_us, Height(heights.is_truth, time_us, altitude_m, climb_mps)


def _throttles(throttles: Throttles, number: int) -> Iterator[tuple[tuple[int, int], int, Item]]:
    rows = (throttles.place, throttles.time_us, throttles.share)
    for place, time_us, share in zip(*(a.tolist() for a in rows), strict=True):
        if math.isfinite(share):
            yield (place, number), time_us, Throttle(time_us, share)


def _plain(column: Any) -> list[Any]:
    """A column as Python values: floats finite or NaN, vectors as tuples."""
    if column.dtype.kind == "f":
        column = np.where(np.isfinite(column), column, np.nan)
    values: list[Any] = column.tolist()
    return list(map(tuple, values)) if column.ndim == 2 else values


def utc_offset_us(
    boot_us: NDArray[np.int64], unix_us: NDArray[np.int64], known: NDArray[np.bool_]
) -> int:
    """Median of UNIX time minus boot time over the rows where the receiver knows the date."""
    return int(np.median((unix_us - boot_us)[known])) if known.any() else 0


def changes(time_us: Sequence[int], values: Sequence[Any]) -> list[tuple[int, Any]]:
    """(time_us, value) wherever a value differs from the one before."""
    found: list[tuple[int, Any]] = []
    for time, value in zip(time_us, values, strict=True):
        if not found or found[-1][1] != value:
            found.append((time, value))
    return found
