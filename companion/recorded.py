"""What a log's reader gives: items, in the order of the file, one at a time or in columns.

A telemetry log gives MAVLink frames. An autopilot's own log has no frames: it gives readings in SI
units, heights to compare with, and frames of a HEARTBEAT made up once a second, so that vehicle,
arming and health are found by the same code.
"""

import dataclasses
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from companion.mavlink.codec import Frame
from companion.mavlink.columns import messages
from companion.mavlink.convert import Reading
from companion.mavlink.reading_columns import Readings, singles
from companion.samples import Rows

Places: TypeAlias = NDArray[np.int64]


class Sensed(NamedTuple):
    """A reading, and which of the log's tables it is from."""

    source: int
    """tells sensors with own clocks apart, as message ids do; above every MAVLink id"""
    reading: Reading


class Height(NamedTuple):
    """A height to compare with: a simulator's truth, or the autopilot's own."""

    is_truth: bool
    time_us: int
    altitude_amsl_m: float
    climb_mps: float


class Throttle(NamedTuple):
    """What the pilot or autopilot asks of the motors; no estimator uses it."""

    time_us: int
    share: float
    """0 to 1"""


Item: TypeAlias = Frame | Sensed | Height | Throttle

FRAME_FIELDS = ("message_id", "system_id", "component_id", "sequence", "version", "signed")
"""of `Frame`, behind its bytes, as `record_scan.INDEX` names them"""


class Heights(NamedTuple):
    """`Height` in columns."""

    is_truth: bool
    places: Places
    """of the items in their log or batch, shape (n,), increasing"""
    rows: Rows
    """of HEIGHT, shape (n,)"""


class Throttles(NamedTuple):
    """`Throttle` in columns."""

    places: Places
    time_us: NDArray[np.int64]
    share: NDArray[np.float64]


@dataclass(frozen=True)
class Batch:
    """Items of a log that follow each other, in columns."""

    times_us: NDArray[np.int64]
    """when each item arrived, shape (n,)"""
    ends: NDArray[np.int64]
    """position in the file behind each item"""
    end: int
    """position in the file behind the batch"""
    buffer: bytes
    """holds the frames"""
    index: Rows
    """`record_scan.INDEX` rows of the frames"""
    places: Places | None = None
    """of the frames among the items, increasing; None: all items are frames"""
    readings: list[tuple[int, Readings]] = field(default_factory=list)
    """(source, readings) of logs without frames"""
    heights: list[Heights] = field(default_factory=list)
    throttles: list[Throttles] = field(default_factory=list)

    @property
    def size(self) -> int:
        """Number of items."""
        return int(self.times_us.size)

    @property
    def data(self) -> NDArray[np.uint8]:
        """`buffer` as an array."""
        return np.frombuffer(self.buffer, np.uint8)

    def part(self, first: int, stop: int) -> "Batch":
        """The items from `first` to before `stop`; their places count from `first`."""
        places, index = self.frames(first, stop)
        return dataclasses.replace(
            self,
            times_us=self.times_us[first:stop],
            ends=self.ends[first:stop],
            end=int(self.ends[stop - 1]) if first < stop < self.size else self.end,
            index=index,
            places=None if self.places is None else places,
            readings=[(k, _moved(each, first, stop)) for k, each in self.readings],
            heights=[_moved(each, first, stop) for each in self.heights],
            throttles=[_moved(each, first, stop) for each in self.throttles],
        )

    def frames(self, first: int, stop: int) -> tuple[Places, Rows]:
        """The frames among the items from `first` to before `stop`: their places, counted from
        `first`, and their rows of `index`."""
        if self.places is None:
            return np.arange(stop - first), np.asarray(self.index[first:stop])
        rows = slice(*np.searchsorted(self.places, (first, stop)).tolist())
        return self.places[rows] - first, np.asarray(self.index[rows])

    def item(self, place: int) -> tuple[int, Item]:
        """(arrival_us, item) of one place."""
        if self.places is None:
            return int(self.times_us[place]), self.frame(place)
        return next(self.part(place, place + 1).items())

    def frame(self, number: int) -> Frame:
        """The frame of a row of `index`."""
        row = self.index[number]
        data = self.buffer[int(row["start"]) : int(row["stop"])]
        frame = Frame(data, *(int(row[name]) for name in FRAME_FIELDS))  # type: ignore[arg-type]
        return frame._replace(signed=bool(frame.signed))

    def items(self, wanted: Collection[int] = ()) -> Iterator[tuple[int, Item]]:
        """(arrival_us, item) of all; frames of `wanted` kinds carry their message."""
        times_us = self.times_us.tolist()
        if self.places is None:
            return zip(times_us, self._frames(wanted), strict=True)
        found: list[Any] = [None] * self.size
        _put(found, self.places, self._frames(wanted))
        for source, each in self.readings:
            _put(found, each.places, (Sensed(source, reading) for reading in singles(each)))
        for heights in self.heights:
            rows = heights.rows.tolist()
            _put(found, heights.places, (Height(heights.is_truth, *row) for row in rows))
        for asked in self.throttles:
            columns = asked.time_us.tolist(), asked.share.tolist()
            _put(found, asked.places, map(Throttle, *columns))
        return zip(times_us, found, strict=True)

    def _frames(self, wanted: Collection[int]) -> Iterator[Frame]:
        index = self.index
        decoded: list[Any] = [None] * index.size
        for message_id in set(np.unique(index["message_id"]).tolist()) & set(wanted):
            where = np.flatnonzero(index["message_id"] == message_id)
            found = messages(self.data, index[where], message_id)
            for place, message in zip(where.tolist(), found, strict=False):
                decoded[place] = message
        fields = [index[name].tolist() for name in FRAME_FIELDS]
        fields[-1] = list(map(bool, fields[-1]))
        extents = zip(index["start"].tolist(), index["stop"].tolist(), strict=True)
        data = (self.buffer[start:stop] for start, stop in extents)
        return map(Frame, data, *fields, decoded)


def _put(found: list[Any], places: Places, items: Iterable[Item]) -> None:
    for place, item in zip(places.tolist(), items, strict=True):
        found[place] = item


def _moved(columns: Any, first: int, stop: int) -> Any:
    """Those from place `first` to before `stop`, of columns as named tuples with ``places``."""
    rows = slice(*np.searchsorted(columns.places, (first, stop)).tolist())
    chosen = (each[rows] if isinstance(each, np.ndarray) else each for each in columns)
    moved = type(columns)._make(chosen)
    return moved._replace(places=moved.places - first)
