"""A batch of a log as the arrays that the compiled loops take (`companion.replay.block_steps`):
items, their readings, and the sample rows to fill."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.intake.geoid import undulation_m
from companion.intake.row_steps import DOUBTED
from companion.intake.vehicle_clock import BASES
from companion.mavlink import convert
from companion.mavlink.codec import mavlink
from companion.mavlink.columns import columns
from companion.mavlink.convert import Converter
from companion.mavlink.identity import SIGNING_TIMEOUT_US, VEHICLE_TYPES
from companion.mavlink.imu import ImuSelector
from companion.mavlink.own_heights import own_heights
from companion.mavlink.reading_columns import LARGEST_STAMP_US, Fields, Readings, readings_of
from companion.mavlink.requests import REQUESTS
from companion.reading_steps import READING
from companion.recorded import Batch
from companion.replay.block_steps import (
    ALTITUDE_HEARD,
    ITEM,
    OWN_HEIGHT,
    PLAIN,
    PYTHON,
    RECORDED_HEIGHT,
    RECORDED_TRUTH,
    SYSTEM_TIME,
    TRUTH,
    enter,
)
from companion.samples import DTYPES, HEIGHT, ORDER, Kind, Rows, Tables, readable, rows

HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
HIGHRES_IMU = mavlink.MAVLINK_MSG_ID_HIGHRES_IMU
RAW_IMU = mavlink.MAVLINK_MSG_ID_RAW_IMU
CUSTOM_MODE = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
SILENT = frozenset({mavlink.MAVLINK_MSG_ID_PARAM_VALUE})
"""kinds of the vehicle that do nothing where no messages are sent"""
WHAT = {
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: SYSTEM_TIME,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: OWN_HEIGHT,
    mavlink.MAVLINK_MSG_ID_ALTITUDE: ALTITUDE_HEARD,
    mavlink.MAVLINK_MSG_ID_SIM_STATE: TRUTH,
    mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION: TRUTH,
}
"""messages that do more than their readings"""
Beat = tuple[int, int, int, int]
"""type, autopilot, whether the mode is custom, mode: of a HEARTBEAT"""


@dataclass(frozen=True)
class Speaker:
    """What decides how the frames of a block are taken."""

    vehicle: tuple[int, int]
    own: tuple[int, int]
    version: int
    """of MAVLink that the vehicle was heard to speak"""
    autopilot: int
    vehicle_type: int
    imu_scale: float | None
    wanted: frozenset[int]
    listened: frozenset[int]
    air_temperature: str
    equal_heights: int
    """as `companion.intake.row_steps` has it"""
    session: int
    """changes when the listeners begin anew"""
    beat: Beat | None = field(default=None, compare=False)
    """the session's last HEARTBEAT that the pipeline took"""


@dataclass
class Arrays:
    """The items of a batch from one place on."""

    items: Rows
    readings: Rows
    tables: Tables
    untouched: Tables
    """a copy of the tables, from which a piece is taken anew"""
    python: NDArray[np.int64]
    """the items that the pipeline takes, increasing"""

    def readings_of(self, start: int, stop: int) -> Rows:
        """The readings of ``items[start:stop]``, which are not empty."""
        first, last = self.items[start], self.items[stop - 1]
        found: Rows = self.readings[int(first["first"]) : int(last["first"] + last["count"])]
        return found

    def restore(self, start: int, stop: int) -> None:
        """Forget what was filled into the tables by ``items[start:stop]``."""
        readings = self.readings_of(start, stop)
        readings["debug"] = 0
        kinds, places = np.asarray(readings["kind"]), np.asarray(readings["row"])
        for kind in np.unique(kinds).tolist():
            rows = places[kinds == kind]
            self.tables[1 + kind][rows] = self.untouched[1 + kind][rows]


Found = tuple[int, Readings]
"""(message or table, readings); their places are of their items"""


def arrays_of(batch: Batch, first: int, speaker: Speaker, signed_us: int | None) -> Arrays:
    """The arrays of the items of a batch from `first` on. `signed_us` is when the vehicle's last
    signed frame before arrived; None if there was none."""
    if first:
        batch = batch.part(first, batch.size)
    items = readable(np.zeros(batch.size, ITEM))
    items["arrival_us"] = batch.times_us
    special = np.zeros(batch.size, np.bool_)
    found = _of_frames(batch, items, special, speaker, signed_us)
    found += batch.readings
    for heights in batch.heights:
        what = RECORDED_TRUTH if heights.is_truth else RECORDED_HEIGHT
        items["what"][heights.places] = what
        items["a_us"][heights.places] = heights.rows["time_us"]
        items["altitude_m"][heights.places] = heights.rows["altitude_amsl_m"]
        items["climb_mps"][heights.places] = heights.rows["climb_mps"]
    items["what"][special] = PYTHON
    doubted = speaker.equal_heights == DOUBTED
    return _merged(items, found, np.flatnonzero(special), doubted=doubted)


def _of_frames(
    batch: Batch,
    items: Rows,
    special: NDArray[np.bool_],
    speaker: Speaker,
    signed_us: int | None,
) -> list[Found]:
    """The readings of the frames of a batch; fills in their `items`, and which are `special`: for
    the pipeline."""
    data, index = batch.data, np.asarray(batch.index)
    places = np.arange(index.size) if batch.places is None else batch.places
    ids = np.ascontiguousarray(index["message_id"])
    has_ids = sent_by(index, speaker.vehicle)
    is_vehicle = has_ids & ~_forged(index, has_ids, signed_us)
    items["is_frame"][places] = 1
    items["is_vehicle"][places] = is_vehicle
    is_odd = sent_by(index, speaker.own) & ~has_ids
    is_odd |= is_vehicle & (index["version"] > speaker.version)
    present = np.unique(ids)
    for message_id in REQUESTS & set(present.tolist()):
        asked = np.flatnonzero(ids == message_id)
        table = columns(data, index[asked], message_id)
        is_odd[asked] |= has_ids[asked] | _addressed(table, speaker.own)
    beats = np.flatnonzero(~has_ids & (ids == HEARTBEAT))
    is_odd[beats] |= ~_of_stations(columns(data, index[beats], HEARTBEAT))
    found: list[Found] = []
    converters = _converters(speaker)
    for message_id in present.tolist():
        if message_id in REQUESTS or message_id not in speaker.wanted - (SILENT - speaker.listened):
            continue
        where = np.flatnonzero((ids == message_id) & is_vehicle)
        converter = converters.get(message_id, [])
        known = bool(converter) or message_id in WHAT
        if not known or message_id in speaker.listened - {HEARTBEAT}:
            is_odd[where] = True
            continue
        table = columns(data, index[where], message_id)
        if message_id == HEARTBEAT:
            is_odd[where] |= _new_beats(table, speaker)
        _fill_items(items, places[where], table, message_id)
        of_messages = (each for make in converter for each in readings_of(make, table))
        found += [(message_id, r._replace(places=places[where[r.places]])) for r in of_messages]
    special[places] = is_odd
    return found


def sent_by(index: Rows, sender: tuple[int, int]) -> NDArray[np.bool_]:
    """Which frames, `record_scan.INDEX` rows, are of a system and component."""
    found: NDArray[np.bool_] = (index["system_id"] == sender[0]) & (
        index["component_id"] == sender[1]
    )
    return found


def _forged(index: Rows, has_ids: NDArray[np.bool_], signed_us: int | None) -> NDArray[np.bool_]:
    """Which frames with the vehicle's ids are unsigned though it signs, `record_scan.INDEX` rows:
    the rule of `companion.mavlink.identity`. `signed_us` is when a signed one arrived before."""
    signed = has_ids & (np.asarray(index["signed"]) != 0)
    if signed_us is None and not signed.any():
        return np.zeros(index.size, np.bool_)
    times_us = np.asarray(index["time_us"])
    newest = np.maximum.accumulate(np.where(signed, np.arange(index.size), -1))
    known_us = np.where(newest >= 0, times_us[newest], signed_us or 0)
    is_late = np.abs(times_us - known_us) >= SIGNING_TIMEOUT_US
    known = (newest >= 0) | (signed_us is not None)
    return has_ids & ~signed & known & ~is_late


def _addressed(requests: NDArray[Any], own: tuple[int, int]) -> NDArray[np.bool_]:
    """Which requests may be addressed to us: `companion.mavlink.requests` answers these."""
    systems, components = requests["target_system"], requests["target_component"]
    found: NDArray[np.bool_] = ((systems == own[0]) | (systems == 0)) & (
        (components == own[1]) | (components == 0)
    )
    return found


def _of_stations(beats: NDArray[Any]) -> NDArray[np.bool_]:
    """Which HEARTBEATs of others are of a ground station or of an accessory."""
    types = np.array(list(VEHICLE_TYPES))
    found: NDArray[np.bool_] = (
        (beats["type"] == mavlink.MAV_TYPE_GCS)
        | (beats["autopilot"] == mavlink.MAV_AUTOPILOT_INVALID)
        | ~np.isin(beats["type"], types)
    )
    return found


def stations(data: NDArray[np.uint8], index: Rows) -> dict[tuple[int, int], int]:
    """When each ground station among the senders of HEARTBEATs was heard last."""
    beats = columns(data, index, HEARTBEAT)
    index = index[beats["type"] == mavlink.MAV_TYPE_GCS]
    names = ("system_id", "component_id", "time_us")
    return {(s, c): us for s, c, us in zip(*(index[n].tolist() for n in names), strict=True)}


def _converters(speaker: Speaker) -> dict[int, list[Converter]]:
    """The converters of each kind of message, in the order of their readings."""
    found = {message_id: [make] for message_id, make in convert.CONVERTERS.items()}
    scale = speaker.imu_scale
    if scale is not None:
        found[RAW_IMU] = [lambda fields, _: convert.raw_imu(fields, scale)]
    for message_id, make in convert.THERMOMETERS[speaker.air_temperature].items():
        found[message_id] = [*found.get(message_id, []), make]
    return found


def _new_beats(table: NDArray[Any], speaker: Speaker) -> NDArray[np.bool_]:
    """Which HEARTBEATs say something new, for the pipeline to take."""
    custom = (table["base_mode"] & CUSTOM_MODE) != 0
    same = np.array([table["type"], table["autopilot"], custom, table["custom_mode"]], np.int64)
    before = np.roll(same, 1, axis=1)
    before[:, 0] = speaker.beat if speaker.beat is not None else -1
    known = (table["type"] == speaker.vehicle_type) & (table["autopilot"] == speaker.autopilot)
    new: NDArray[np.bool_] = (same != before).any(axis=0) | ~known
    return new


def _fill_items(
    items: Rows, where: NDArray[np.int64], table: NDArray[Any], message_id: int
) -> None:
    """What a message says beside its readings."""
    what, fields = WHAT.get(message_id, PLAIN), Fields(table)
    items["what"][where] = what
    if what == SYSTEM_TIME:
        largest = np.uint64(LARGEST_STAMP_US)
        items["a_us"][where] = np.minimum(fields.time_unix_usec, largest)
        items["b_us"][where] = fields.time_boot_ms * 1000
    elif what == OWN_HEIGHT:
        time_us, altitude_m, climb_mps = convert.global_position(fields)
        items["a_us"][where], items["altitude_m"][where] = time_us, altitude_m
        items["climb_mps"][where] = climb_mps
        items["above_home_m"][where] = own_heights(fields).height_above_home_m
    elif what == TRUTH:
        with np.errstate(invalid="ignore"):  # a signalling NaN
            altitude_m, climb_mps = convert.TRUTHS[message_id](fields) or (math.nan, math.nan)
        items["altitude_m"][where], items["climb_mps"][where] = altitude_m, climb_mps


def _merged(items: Rows, found: list[Found], python: NDArray[np.int64], *, doubted: bool) -> Arrays:
    """The readings of all messages in the order of the items; those of one item as they are
    converted."""
    places = [np.ascontiguousarray(each.places) for _, each in found]
    counts = np.bincount(np.concatenate([np.zeros(0, np.int64), *places]), minlength=items.size)
    items["count"], items["first"] = counts, np.cumsum(counts) - counts
    readings = readable(np.zeros(int(counts.sum()), READING))
    samples: dict[Kind, list[Found]] = {kind: [] for kind in Kind}
    sizes, used = dict.fromkeys(Kind, 0), np.zeros(items.size, np.int64)
    for (source, each), where in zip(found, places, strict=True):
        is_doubted = each.kind == Kind.GNSS and doubted
        enter(
            items,
            readings,
            used,
            where,
            np.ascontiguousarray(each.stamp_us),
            np.ascontiguousarray(each.samples["instance"]),
            _undulations_m(each.samples) if is_doubted else np.zeros(0),
            int(each.kind),
            BASES[each.base],
            source,
            ImuSelector.rank(source, 0),
            int(source == HIGHRES_IMU),
            sizes[each.kind],
        )
        samples[each.kind].append((source, each))
        sizes[each.kind] += where.size
    tables = Tables(readable(np.zeros(readings.size, ORDER)), *_tables(samples, items))
    untouched = Tables(*(table.copy() for table in tables))
    return Arrays(items, readings, tables, untouched, python)


def _undulations_m(fixes: Rows) -> NDArray[np.float64]:
    """Undulation of the geoid at fixes with equal heights, NaN at the others."""
    found = np.full(fixes.size, np.nan)
    for i in np.flatnonzero(fixes["altitude_amsl_m"] == fixes["altitude_ellipsoid_m"]).tolist():
        place = float(fixes["latitude_deg"][i]), float(fixes["longitude_deg"][i])
        found[i] = undulation_m(*place)
    return found


def _tables(samples: dict[Kind, list[Found]], items: Rows) -> Iterator[Rows]:
    """The rows of each kind, as they were entered."""
    arrival_us = np.asarray(items["arrival_us"])
    for kind in Kind:
        if not samples[kind]:
            yield rows(DTYPES[kind], 0)
            continue
        table = np.concatenate([np.asarray(each.samples) for _, each in samples[kind]])
        table["arrival_us"] = arrival_us[np.concatenate([e.places for _, e in samples[kind]])]
        yield readable(table)


def heights(items: Rows, *, truth: bool) -> Rows:
    """HEIGHT rows of a simulator's truth, or of the autopilot's own, that have a time."""
    what = np.asarray(items["what"])
    one, other = (TRUTH, RECORDED_TRUTH) if truth else (OWN_HEIGHT, RECORDED_HEIGHT)
    chosen = items[((what == one) | (what == other)) & (items["a_us"] >= 0)]
    found = np.zeros(chosen.size, HEIGHT)
    found["time_us"] = chosen["a_us"]
    found["altitude_amsl_m"], found["climb_mps"] = chosen["altitude_m"], chosen["climb_mps"]
    return found
