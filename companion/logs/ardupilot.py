"""Which columns of an ArduPilot log are which sensor, in SI units.

What the autopilot itself estimates (POS, XKF1, AHR2) and a simulator's truth (SIM) are heights to
compare with. Messages without a time since boot (ArduCopter before 3.1) cannot be placed.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.logs.tables import Tables, changes, heights, sensor, utc_offset_us
from companion.mavlink.codec import mavlink
from companion.mavlink.convert import ZERO_CELSIUS_K
from companion.mavlink.reading_columns import Readings
from companion.recorded import Heights, Throttles
from companion.samples import Kind

GPS_EPOCH_S = 315_964_800
LEAP_S = 18
WEEK_S = 604_800
LAST_US = 1 << 55
"""A later time, 1141 years after boot, is damage."""
EV_ARMED, EV_DISARMED = 10, 11
EV_LANDED, EV_NOT_LANDED = 18, 28
DOWNWARD = int(mavlink.MAV_SENSOR_ROTATION_PITCH_270)
RANGE_GOOD = 4
"""RFND.Stat"""
TYPES = {
    "ArduCopter": mavlink.MAV_TYPE_QUADROTOR,
    "ArduPlane": mavlink.MAV_TYPE_FIXED_WING,
    "ArduRover": mavlink.MAV_TYPE_GROUND_ROVER,
    "ArduSub": mavlink.MAV_TYPE_SUBMARINE,
}


class Columns(NamedTuple):
    """The rows of one message: where they are in the file, and its fields by label."""

    place: NDArray[np.int64]
    fields: dict[str, NDArray[Any]]

    def floats(self, *labels: str) -> NDArray[np.float64]:
        """The first of `labels` that the message has, as floats; NaN when it has none."""
        for label in labels:
            if label in self.fields and self.fields[label].dtype.kind in "iuf":
                return self.fields[label].astype(np.float64)
        return np.full(self.place.size, math.nan)

    def integers(self, label: str, default: int) -> NDArray[np.int64]:
        """A field as integers; `default` where it is missing or unknown."""
        values = self.floats(label)
        known = np.isfinite(values)
        return np.where(known, np.where(known, values, 0.0), default).astype(np.int64)

    def where(self, chosen: NDArray[np.bool_]) -> "Columns":
        """The rows that are chosen."""
        fields = {label: values[chosen] for label, values in self.fields.items()}
        return Columns(self.place[chosen], fields)

    @property
    def time_us(self) -> NDArray[np.int64]:
        """Time since boot; -1 where the message does not tell it."""
        for label, scale in (("TimeUS", 1), ("T", 1000), ("TimeMS", 1000)):
            known = self.fields.get(label)
            if known is not None and known.dtype.kind in "iuf" and label != "GMS":
                time = np.nan_to_num(known.astype(np.float64) * scale, nan=-1.0)
                return np.where(np.abs(time) < LAST_US, time, -1.0).astype(np.int64)
        return np.full(self.place.size, -1, np.int64)


def tables_of(messages: dict[str, Columns]) -> Tables:
    """The sensors of a log, by the names of its messages."""
    messages = {name: _placed(found) for name, found in messages.items()}
    tables = Tables(autopilot=int(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA))
    for names, make in (
        (("BARO", "BAR2", "BAR3"), _barometer),
        (("GPS", "GPS2"), lambda part: _gnss(part, messages.get("GPA"))),
        (("IMU", "IMU2", "IMU3"), _imu),
    ):
        for number, name in enumerate(names):
            tables.sensors += _instances(messages.get(name), number, make)
    for name, make in (("ATT", _attitude), ("RFND", _range), ("ARSP", _airspeed)):
        tables.sensors += _instances(messages.get(name), 0, make)
    _vehicle(tables, messages)
    tables.heights += _heights(messages)
    tables.throttles += _throttles(messages.get("CTUN"))
    return tables


def _placed(found: Columns) -> Columns:
    """Without rows of an impossible time."""
    has_time = any(label in found.fields for label in ("TimeUS", "TimeMS", "T"))
    return found.where(found.time_us >= 0) if has_time else found


def _instances(found: Columns | None, number: int, make: Any) -> list[Readings]:
    """One table for each instance that a message tells, `number` when it does not tell."""
    if found is None or not found.place.size or found.time_us[0] < 0:
        return []
    label = next((each for each in ("I", "Instance") if each in found.fields), None)
    if label is None:
        return [_table(make(found), found, number)]
    told = found.integers(label, 0)
    parts = {int(i): found.where(told == i) for i in np.unique(told) if 0 <= i < 4}
    return [_table(make(part), part, instance) for instance, part in parts.items()]


def _table(made: tuple[Kind, tuple[Any, ...]], found: Columns, instance: int) -> Readings:
    kind, values = made
    return sensor(kind, found.place, found.time_us, instance, values)


def _barometer(found: Columns) -> tuple[Kind, tuple[Any, ...]]:
    """BARO: pascal, degrees Celsius of the sensor; an unhealthy one repeats its last value."""
    pressure_pa = found.floats("Press")
    healthy = found.integers("Health", 1) != 0
    suspect = np.zeros(pressure_pa.size, np.int64)
    return Kind.PRESSURE, (
        np.where(healthy, pressure_pa, math.nan),
        found.floats("Temp") + ZERO_CELSIUS_K,
        suspect,
    )


def _gnss(found: Columns, accuracy: Columns | None) -> tuple[Kind, tuple[Any, ...]]:
    """GPS with its accuracies in GPA, which has the same time and instance; VZ is downwards."""
    nowhere = (found.floats("Lat") == 0) & (found.floats("Lng") == 0)
    horizontal_m, vertical_m, vdop, has_climb = _accuracy(found, accuracy)
    has_climb &= found.integers("Status", 0) >= 3
    hdop = found.floats("HDop")
    return Kind.GNSS, (
        np.where(nowhere, math.nan, found.floats("Lat")),
        np.where(nowhere, math.nan, found.floats("Lng")),
        np.where(nowhere, math.nan, found.floats("Alt")),
        np.full(hdop.size, math.nan),
        found.floats("Spd"),
        np.radians(found.floats("GCrs")),
        np.where(has_climb, -found.floats("VZ", "VelZ"), math.nan),
        horizontal_m,
        vertical_m,
        np.where(hdop > 0, hdop, math.nan),
        vdop,
        found.integers("Status", 0),
        found.integers("NSats", -1),
        np.zeros(hdop.size, np.int64),
    )


def _accuracy(found: Columns, accuracy: Columns | None) -> tuple[Any, Any, Any, Any]:
    """Horizontal and vertical accuracy (m), VDOP and whether VZ is measured, for each fix."""
    count = found.place.size
    unknown = np.full(count, math.nan)
    if accuracy is None or not accuracy.place.size:
        return unknown, unknown, unknown, np.isfinite(found.floats("VZ", "VelZ"))
    if "I" in found.fields and "I" in accuracy.fields:
        own = accuracy.integers("I", 0) == found.integers("I", 0)[0]
        accuracy = accuracy.where(own)
    if not accuracy.place.size:
        return unknown, unknown, unknown, np.isfinite(found.floats("VZ"))
    order = np.argsort(accuracy.time_us, kind="stable")
    accuracy = Columns(accuracy.place[order], {k: v[order] for k, v in accuracy.fields.items()})
    at = np.searchsorted(accuracy.time_us, found.time_us)
    at = np.minimum(at, accuracy.place.size - 1)
    same = np.abs(accuracy.time_us[at] - found.time_us) < 2000
    told = [
        np.where(same & (values[at] > 0), values[at], math.nan)
        for values in (accuracy.floats("HAcc"), accuracy.floats("VAcc"), accuracy.floats("VDop"))
    ]
    return told[0], told[1], told[2], np.where(same, accuracy.integers("VV", 1)[at] == 1, True)


def _imu(found: Columns) -> tuple[Kind, tuple[Any, ...]]:
    force = np.stack([found.floats(f"Acc{axis}") for axis in "XYZ"], axis=1)
    rate = np.stack([found.floats(f"Gyr{axis}") for axis in "XYZ"], axis=1)
    return Kind.IMU, (force, rate)


def _attitude(found: Columns) -> tuple[Kind, tuple[Any, ...]]:
    roll, pitch, yaw = (np.radians(found.floats(label)) for label in ("Roll", "Pitch", "Yaw"))
    rates = np.full((roll.size, 3), math.nan)
    return Kind.ATTITUDE, (roll, pitch, (yaw + np.pi) % (2 * np.pi) - np.pi, rates)


def _range(found: Columns) -> tuple[Kind, tuple[Any, ...]]:
    distance_m = found.floats("Dist", "Dist1")
    seen = (found.integers("Stat", RANGE_GOOD) == RANGE_GOOD) & (distance_m > 0)
    orientation = found.integers("Orient" if "Orient" in found.fields else "Orient1", DOWNWARD)
    return Kind.RANGE, (
        np.where(seen, distance_m, math.nan),
        (orientation == DOWNWARD).astype(np.int64),
    )


def _airspeed(found: Columns) -> tuple[Kind, tuple[Any, ...]]:
    used = found.integers("U", 1) != 0
    return Kind.AIRSPEED, (np.where(used, found.floats("Airspeed"), math.nan),)


def _vehicle(tables: Tables, messages: dict[str, Columns]) -> None:
    """Who flies, when it was armed, what it said, and what its clock was in UTC."""
    tables.parameters = _parameters(messages.get("PARM"))
    system_id = tables.parameters.get("SYSID_THISMAV", tables.parameters.get("MAV_SYSID", 1))
    tables.system_id = int(system_id) if 1 <= system_id <= 255 else 1
    texts = messages.get("MSG")
    if texts is not None and "Message" in texts.fields:
        tables.texts = list(
            zip(texts.time_us.tolist(), map(_text, texts.fields["Message"].tolist()), strict=True)
        )
    for _, text in tables.texts:
        tables.vehicle_type = next(
            (int(kind) for name, kind in TYPES.items() if text.startswith(name)),
            tables.vehicle_type,
        )
    modes = messages.get("MODE")
    if modes is not None and "Mode" in modes.fields:
        tables.modes = changes(modes.time_us.tolist(), list(map(_text, modes.fields["Mode"])))
    tables.armed = _armed(messages)
    _landed(tables, messages.get("EV"))
    gps = messages.get("GPS")
    if gps is not None and gps.place.size:
        week, ms = gps.floats("GWk", "Week"), gps.floats("GMS", "TimeMS")
        unix_us = np.nan_to_num((GPS_EPOCH_S - LEAP_S + week * WEEK_S) * 1e6 + ms * 1e3)
        tables.utc_offset_us = utc_offset_us(gps.time_us, unix_us.astype(np.int64), week > 1000)


def _text(value: Any) -> str:
    return value.decode("ascii", "replace") if isinstance(value, bytes) else f"{value:g}"


def _parameters(found: Columns | None) -> dict[str, float]:
    if found is None or "Name" not in found.fields:
        return {}
    names = map(_text, found.fields["Name"].tolist())
    return dict(zip(names, found.floats("Value").tolist(), strict=True))


def _armed(messages: dict[str, Columns]) -> list[tuple[int, bool]]:
    found: list[tuple[int, bool]] = []
    for name, label, on, off in (
        ("EV", "Id", EV_ARMED, EV_DISARMED),
        ("ARM", "ArmState", 1, 0),
        ("STAT", "Armed", 1, 0),
    ):
        told = messages.get(name)
        if told is None or not told.place.size or told.time_us[0] < 0:
            continue
        values = told.integers(label, -1)
        chosen = told.where((values == on) | (values == off))
        states = chosen.integers(label, -1) == on
        found += zip(chosen.time_us.tolist(), states.tolist(), strict=True)
    return sorted(found)


def _landed(tables: Tables, events: Columns | None) -> None:
    """On the ground or not, where the autopilot tells it."""
    if events is None or not events.place.size or events.time_us[0] < 0:
        return
    told = events.integers("Id", -1)
    chosen = events.where((told == EV_LANDED) | (told == EV_NOT_LANDED))
    if chosen.place.size:
        count, landed = chosen.place.size, chosen.integers("Id", -1) == EV_LANDED
        values = (np.full(count, -1), landed.astype(np.int64), np.zeros(count, np.int64))
        tables.sensors.append(sensor(Kind.STATUS, chosen.place, chosen.time_us, 0, values))


def _heights(messages: dict[str, Columns]) -> list[Heights]:
    found = []
    truth = messages.get("SIM")
    if truth is not None and truth.place.size:
        climb = _climb_at(messages.get("SIM2"), "VD", truth.time_us)
        found.append(heights(truth.place, truth.time_us, truth.floats("Alt"), climb, is_truth=True))
    for name in ("POS", "AHR2"):
        own = messages.get(name)
        if own is not None and own.place.size:
            state = messages.get("XKF1", messages.get("NKF1"))
            climb = _climb_at(state, "VD", own.time_us)
            found.append(heights(own.place, own.time_us, own.floats("Alt"), climb, is_truth=False))
            break
    return found


def _throttles(found: Columns | None) -> list[Throttles]:
    """CTUN.ThO: a share, a percentage (Plane), or thousandths (Copter before 3.4)."""
    if found is None or not found.place.size or found.time_us[0] < 0:
        return []
    share = np.maximum(found.floats("ThO", "ThrOut"), 0.0)
    largest = float(np.nanmax(share, initial=0.0))
    scale = 1.0 if largest <= 1.5 else 100.0 if largest <= 150.0 else 1000.0
    known = np.isfinite(share)
    return [Throttles(found.place[known], found.time_us[known], share[known] / scale)]


def _climb_at(state: Columns | None, label: str, time_us: NDArray[np.int64]) -> Any:
    """Minus a downward velocity, between its samples; of the first core where there are several."""
    if state is not None and "C" in state.fields:
        state = state.where(state.integers("C", 0) == 0)
    if state is None or not state.place.size:
        return np.full(time_us.size, math.nan)
    return -np.interp(time_us, state.time_us, state.floats(label), left=math.nan, right=math.nan)
