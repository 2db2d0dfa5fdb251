"""A block of a telemetry log as the arrays that the compiled loops take
(`companion.replay.block_steps`): frames, their readings, and the sample rows to fill."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.intake.geoid import undulation_m
from companion.intake.row_steps import DOUBTED
from companion.intake.vehicle_clock import BASES
from companion.mavlink import reading_columns
from companion.mavlink.codec import mavlink
from companion.mavlink.columns import columns
from companion.mavlink.identity import VEHICLE_TYPES
from companion.mavlink.imu import ImuSelector
from companion.mavlink.reading_columns import Converter, Readings
from companion.mavlink.requests import REQUESTS
from companion.replay.block_steps import (
    ALTITUDE_HEARD,
    FRAME,
    OWN_HEIGHT,
    PLAIN,
    PYTHON,
    READING,
    SYSTEM_TIME,
    TRUTH,
)
from companion.samples import DTYPES, HEIGHT, ORDER, Kind, Rows, Tables, readable, rows

HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
HIGHRES_IMU = mavlink.MAVLINK_MSG_ID_HIGHRES_IMU
RAW_IMU = mavlink.MAVLINK_MSG_ID_RAW_IMU
CUSTOM_MODE = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
OF_OTHERS = frozenset({*REQUESTS, mavlink.MAVLINK_MSG_ID_REQUEST_DATA_STREAM})
"""kinds that the pipeline takes of any sender"""
SILENT = frozenset({mavlink.MAVLINK_MSG_ID_PARAM_VALUE})
"""kinds of the vehicle that do nothing where no messages are sent"""
WHAT = {
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: SYSTEM_TIME,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: OWN_HEIGHT,
    mavlink.MAVLINK_MSG_ID_ALTITUDE: ALTITUDE_HEARD,
    mavlink.MAVLINK_MSG_ID_SIM_STATE: TRUTH,
}
"""messages that do more than their readings"""
Beat = tuple[int, int, int, int]
"""type, autopilot, whether the mode is custom, mode: of a HEARTBEAT"""


@dataclass(frozen=True)
class Speaker:
    """What decides how the frames of a block are taken."""

    vehicle: tuple[int, int]
    own: tuple[int, int]
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
    """The frames of a block from `first` on."""

    frames: Rows
    readings: Rows
    tables: Tables
    untouched: Tables
    """a copy of the tables, from which a piece is taken anew"""
    python: NDArray[np.int64]
    """the frames that the pipeline takes, increasing"""

    def restore(self) -> None:
        """Forget what was filled into the tables."""
        for table, untouched in zip(self.tables[1:], self.untouched[1:], strict=True):
            table[:] = untouched


def arrays_of(data: NDArray[np.uint8], index: Rows, speaker: Speaker) -> Arrays:
    """The arrays of frames, `index` rows of `record_scan.INDEX` that point into `data`."""
    index = np.asarray(index)
    frames = readable(np.zeros(index.size, FRAME))
    frames["arrival_us"] = index["time_us"]
    is_vehicle = _sent_by(index, speaker.vehicle)
    frames["is_vehicle"] = is_vehicle
    special = (index["signed"] != 0) | (_sent_by(index, speaker.own) & ~is_vehicle)
    special |= ~is_vehicle & np.isin(index["message_id"], list(OF_OTHERS))
    beats = np.flatnonzero(~is_vehicle & (index["message_id"] == HEARTBEAT))
    special[beats] |= ~_of_stations(columns(data, index[beats], HEARTBEAT))
    found: list[tuple[int, NDArray[np.int64], list[Readings]]] = []
    converters = _converters(speaker)
    for message_id in np.unique(index["message_id"][is_vehicle]).tolist():
        where = np.flatnonzero(is_vehicle & (index["message_id"] == message_id))
        is_request = message_id in OF_OTHERS
        special[where] |= is_request
        if is_request or message_id not in speaker.wanted - (SILENT - speaker.listened):
            continue
        converter = converters.get(message_id, [])
        known = bool(converter) or message_id in WHAT
        if not known or message_id in speaker.listened - {HEARTBEAT}:
            special[where] = True
            continue
        table = columns(data, index[where], message_id)
        if message_id == HEARTBEAT:
            special[where] |= _new_beats(table, speaker)
        _fill_frames(frames, where, table, WHAT.get(message_id, PLAIN))
        found.append((message_id, where, [each for make in converter for each in make(table)]))
    frames["what"][special] = PYTHON
    doubted = speaker.equal_heights == DOUBTED
    return _merged(frames, found, np.flatnonzero(special), doubted=doubted)


def _sent_by(index: Rows, sender: tuple[int, int]) -> NDArray[np.bool_]:
    found: NDArray[np.bool_] = (index["system_id"] == sender[0]) & (
        index["component_id"] == sender[1]
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
    found = {message_id: [make] for message_id, make in reading_columns.CONVERTERS.items()}
    scale = speaker.imu_scale
    if scale is not None:
        found[RAW_IMU] = [lambda table: reading_columns.raw_imu(table, scale)]
    for message_id, make in reading_columns.THERMOMETERS[speaker.air_temperature].items():
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


def _fill_frames(frames: Rows, where: NDArray[np.int64], table: NDArray[Any], what: int) -> None:
    """What a message says beside its readings."""
    frames["what"][where] = what
    if what == SYSTEM_TIME:
        largest = np.uint64(reading_columns.LARGEST_STAMP_US)
        frames["a_us"][where] = np.minimum(table["time_unix_usec"], largest)
        frames["b_us"][where] = table["time_boot_ms"].astype("i8") * 1000
    elif what == OWN_HEIGHT:
        frames["a_us"][where] = table["time_boot_ms"].astype("i8") * 1000
        frames["altitude_m"][where] = table["alt"] * 1e-3
        frames["above_home_m"][where] = table["relative_alt"] * 1e-3
        frames["climb_mps"][where] = table["vz"] * -0.01
    elif what == TRUTH:
        with np.errstate(invalid="ignore"):  # a signalling NaN
            frames["altitude_m"][where] = table["alt"]
            frames["climb_mps"][where] = -table["vd"]


def _merged(
    frames: Rows,
    found: list[tuple[int, NDArray[np.int64], list[Readings]]],
    python: NDArray[np.int64],
    *,
    doubted: bool,
) -> Arrays:
    """The readings of all messages in the order of the frames."""
    parts: list[Rows] = []
    samples: dict[Kind, list[Rows]] = {kind: [] for kind in Kind}
    sizes = dict.fromkeys(Kind, 0)
    for message_id, where, readings in found:
        for each in readings:
            part = np.zeros(each.messages.size, READING)
            part["above_m"] = np.nan
            part["frame"], part["kind"] = where[each.messages], each.kind
            part["row"] = sizes[each.kind] + np.arange(part.size)
            part["origin"], part["stamp_us"] = BASES[each.base], each.stamp_us
            part["source"], part["instance"] = message_id, each.samples["instance"]
            part["rank"] = np.where(part["instance"] == 0, ImuSelector.rank(message_id, 0), -1)
            part["is_highres"] = message_id == HIGHRES_IMU
            if each.kind == Kind.GNSS and doubted:
                part["above_m"] = _undulations_m(each.samples)
            each.samples["arrival_us"] = frames["arrival_us"][part["frame"]]
            samples[each.kind].append(each.samples)
            sizes[each.kind] += part.size
            parts.append(part)
    all_parts = np.concatenate(parts) if parts else np.zeros(0, READING)
    in_order = np.argsort(all_parts["frame"], kind="stable")  # of one frame as they are converted
    ordered = readable(all_parts[in_order])
    counts = np.bincount(np.asarray(ordered["frame"]), minlength=frames.size)
    frames["count"], frames["first"] = counts, np.cumsum(counts) - counts
    tables = _tables(samples, ordered.size)
    untouched = Tables(*(table.copy() for table in tables))
    return Arrays(frames, ordered, tables, untouched, python)


def _undulations_m(fixes: Rows) -> NDArray[np.float64]:
    """Undulation of the geoid at fixes with equal heights, NaN at the others."""
    found = np.full(fixes.size, np.nan)
    for i in np.flatnonzero(fixes["altitude_amsl_m"] == fixes["altitude_ellipsoid_m"]).tolist():
        place = float(fixes["latitude_deg"][i]), float(fixes["longitude_deg"][i])
        found[i] = undulation_m(*place)
    return found


def _tables(samples: dict[Kind, list[Rows]], size: int) -> Tables:
    """The tables of each kind, with room for an order of `size` samples."""
    merged = (
        readable(np.concatenate([np.asarray(each) for each in samples[kind]]))
        if samples[kind]
        else rows(DTYPES[kind], 0)
        for kind in Kind
    )
    return Tables(readable(np.zeros(size, ORDER)), *merged)


def heights(frames: Rows, what: int, time_field: str) -> Rows:
    """HEIGHT rows of the frames of one sort that have a time."""
    chosen = frames[(frames["what"] == what) & (frames[time_field] >= 0)]
    found = np.zeros(chosen.size, HEIGHT)
    found["time_us"] = chosen[time_field]
    found["altitude_amsl_m"], found["climb_mps"] = chosen["altitude_m"], chosen["climb_mps"]
    return found
