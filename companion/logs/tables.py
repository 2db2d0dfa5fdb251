"""Logs of an autopilot as tables of columns, and their rows as items in the order of the file.

A reader fills `Tables` with the readings of each sensor, whose places are those in the file;
`TableReader` merges them by these. A HEARTBEAT of the vehicle goes out once a second of boot time,
armed as the log says.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.errors import LogFormatError
from companion.logs.raw import indexed
from companion.logs.reader import LogReader
from companion.mavlink.codec import Encoder, FrameReject, Message, mavlink
from companion.mavlink.convert import TimeBase
from companion.mavlink.reading_columns import Readings
from companion.recorded import Batch, Heights, Places, Throttles
from companion.samples import DTYPES, HEIGHT, Kind, rows

Array = NDArray[np.float64]
FIRST_SOURCE = 1 << 24
"""above every MAVLink message id"""
CHUNK = 1 << 16
"""items of a batch"""
HEARTBEAT_US = 1_000_000
UNIX_US = 1_000_000_000_000_000
"""A time above this counts from 1970, not from boot."""


def sensor(
    kind: Kind, places: Places, time_us: Places, instance: int, values: tuple[Any, ...]
) -> Readings:
    """The readings of one sensor.

    Parameters
    ----------
    places : of each row in the file, shape (n,), increasing.
    time_us : since boot, shape (n,).
    values : the columns behind ``instance`` of the kind's dtype; shape (n,) or (n, 3) each.
    """
    samples = rows(DTYPES[kind], places.size)
    samples["instance"] = instance
    for name, column in zip((samples.dtype.names or ())[3:], values, strict=False):
        is_float = column.dtype.kind == "f"
        samples[name] = np.where(np.isfinite(column), column, np.nan) if is_float else column
    return Readings(kind, TimeBase.BOOT, places, time_us, samples)


def heights(
    places: Places, time_us: Places, altitude_m: Array, climb_mps: Array, *, is_truth: bool
) -> Heights:
    """Altitudes to compare with; those that are unknown are left out."""
    known = np.isfinite(altitude_m)
    found = np.zeros(int(known.sum()), HEIGHT)
    found["time_us"], found["altitude_amsl_m"] = time_us[known], altitude_m[known]
    found["climb_mps"] = climb_mps[known]
    return Heights(is_truth, places[known], found)


@dataclass
class Tables:
    """What a reader found in one log."""

    sensors: list[Readings] = field(default_factory=list)
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
    is_simulated: bool = False
    """whether the log says so"""
    texts: list[tuple[int, str]] = field(default_factory=list)
    """(time_us since boot, what the autopilot said)"""

    def columns(self) -> list[Readings | Heights | Throttles]:
        """All that has a place in the file."""
        return [*self.sensors, *self.heights, *self.throttles]

    def spoken(self, times_us: Places) -> list[bytes]:
        """The frames of the vehicle's HEARTBEAT at these times; with the first goes what only a
        simulated vehicle sends."""
        changes_us = np.array([time_us for time_us, _ in self.armed], np.int64)
        states = np.array([False, *(armed for _, armed in self.armed)])
        encoder = Encoder(self.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
        armed = states[np.searchsorted(changes_us, times_us, side="right")]
        frames = [encoder.encode(self._heartbeat(state)) for state in armed.tolist()]
        if self.is_simulated:
            frames.insert(1, encoder.encode(mavlink.MAVLink_simstate_message(*[0] * 11)))
        return frames

    def _heartbeat(self, armed: bool) -> Message:
        mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
        kind, autopilot = self.vehicle_type, self.autopilot
        state = mavlink.MAV_STATE_ACTIVE
        return mavlink.MAVLink_heartbeat_message(kind, autopilot, mode, 0, state, 3)


def time_of(columns: Readings | Heights | Throttles) -> Places:
    """The time of each row, since boot."""
    if isinstance(columns, Readings):
        return columns.stamp_us
    return np.asarray(columns.rows["time_us"]) if isinstance(columns, Heights) else columns.time_us


def _since_start(tables: Tables) -> Tables:
    """With times from the first row on, where they count from 1970 as a simulator's may."""
    first_us = min((int(each.stamp_us.min()) for each in tables.sensors), default=0)
    if first_us < UNIX_US:
        return tables
    tables.sensors = [each._replace(stamp_us=each.stamp_us - first_us) for each in tables.sensors]
    for each in tables.heights:
        each.rows["time_us"] -= first_us
    tables.throttles = [e._replace(time_us=e.time_us - first_us) for e in tables.throttles]
    tables.armed = [(time_us - first_us, armed) for time_us, armed in tables.armed]
    tables.modes = [(time_us - first_us, mode) for time_us, mode in tables.modes]
    tables.texts = [(time_us - first_us, text) for time_us, text in tables.texts]
    tables.utc_offset_us += first_us
    return tables


class TableReader(LogReader):
    """A log of tables as a reader: items in the order of the file."""

    def __init__(
        self, path: Path, tables: Tables, size_bytes: int, counters: Counter[FrameReject]
    ) -> None:
        super().__init__(path)
        if not tables.sensors:
            raise LogFormatError(
                f"{path}: no sensor in it that Kollsman reads, or none with a time since boot "
                "(ArduCopter before 3.1 wrote none)"
            )
        self.tables, self.counters, self.size_bytes = _since_start(tables), counters, size_bytes

    def batches(self) -> Iterator[Batch]:
        """All items, `CHUNK` at a time."""
        self.frames = self.position_bytes = 0
        whole = self._merged()
        for first in range(0, whole.size, CHUNK):
            yield whole.part(first, min(first + CHUNK, whole.size))
        self.position_bytes = self.size_bytes

    def _merged(self) -> Batch:
        """The whole log. Of rows at one place those of the first sensor come first; a HEARTBEAT
        comes before the row that it has its time from."""
        tables, columns = self.tables, self.tables.columns()
        sizes = [each.places.size for each in columns]
        numbers = np.repeat(np.arange(len(columns)), sizes)
        none = np.zeros(0, np.int64)
        at = np.concatenate([none, *(each.places for each in columns)])
        time_us = np.concatenate([none, *map(time_of, columns)])
        order = np.lexsort((numbers, at))
        beats = _beats(time_us[order])
        spoken = tables.spoken(time_us[order][beats])
        beats = np.sort(np.append(beats, beats[: len(spoken) - beats.size]))
        own, frames = indexed(b"".join(spoken))
        places = np.empty(order.size, np.int64)
        places[order] = np.arange(order.size) + np.searchsorted(
            beats, np.arange(order.size), side="right"
        )
        ends = np.cumsum(sizes)
        moved: list[Any] = [
            each._replace(places=places[end - size : end])
            for each, size, end in zip(columns, sizes, ends, strict=True)
        ]
        last = max((int(each.places[-1]) for each in tables.sensors if each.places.size), default=1)
        share = np.insert(at[order], beats, at[order][beats]) / max(1, last)
        position = np.minimum(share * self.size_bytes, self.size_bytes).astype(np.int64)
        arrival_us = np.insert(time_us[order], beats, time_us[order][beats]) + tables.utc_offset_us
        beat_places = beats + np.arange(beats.size)
        frames["time_us"] = arrival_us[beat_places]
        sensors, others = len(tables.sensors), len(tables.sensors) + len(tables.heights)
        return Batch(
            arrival_us,
            position,
            self.size_bytes,
            own,
            frames,
            beat_places,
            [(FIRST_SOURCE + number, each) for number, each in enumerate(moved[:sensors])],
            moved[sensors:others],
            moved[others:],
        )


def _beats(times_us: Places) -> Places:
    """The rows, which have these times, before which a HEARTBEAT goes out."""
    found, beat_us = [], -HEARTBEAT_US
    for row, time_us in enumerate(times_us.tolist()):
        if not beat_us <= time_us < beat_us + HEARTBEAT_US:
            beat_us = time_us
            found.append(row)
    return np.array(found, np.int64)


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
