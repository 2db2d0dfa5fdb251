"""PX4 logs (.ulg), read by pyulog (the extra `logs`).

Barometer: vehicle_air_data, or sensor_baro where that has more rows. GNSS: sensor_gps, or
vehicle_gps_position where that has more. The autopilot's own height is vehicle_global_position, the
truth of a simulator vehicle_global_position_groundtruth.
"""

import io
import math
from collections import Counter
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.errors import LogFormatError
from companion.logs.files import contents
from companion.logs.tables import TableReader, Tables, changes, heights, sensor, utc_offset_us
from companion.mavlink.codec import FrameReject, mavlink
from companion.mavlink.convert import ZERO_CELSIUS_K
from companion.mavlink.reading_columns import Readings
from companion.samples import MAX_INSTANCES, Kind

MAGIC = b"ULog\x01\x12\x35"
LAST_US = 1 << 55
"""A later time, 1141 years after 1970, is damage."""
ARMED = 2
"""vehicle_status.arming_state"""
DOWNWARD = int(mavlink.MAV_SENSOR_ROTATION_PITCH_270)
LOWEST_PA = 2000.0
"""old logs have hectopascal in the same field"""
SIMULATED = "PX4_SITL"
"""hardware of PX4's simulated vehicles"""
TOPICS = (
    "sensor_baro", "vehicle_air_data", "sensor_gps", "vehicle_gps_position", "sensor_combined",
    "vehicle_attitude", "vehicle_global_position", "vehicle_global_position_groundtruth",
    "vehicle_status", "vehicle_land_detected", "distance_sensor", "airspeed",
)  # fmt: skip
TYPES = {1: mavlink.MAV_TYPE_QUADROTOR, 2: mavlink.MAV_TYPE_FIXED_WING}
"""of vehicle_status.vehicle_type"""


class UlogReader(TableReader):
    """A PX4 .ulg. Raises `LogFormatError` when it is unreadable or pyulog is not installed."""

    def __init__(self, path: str | Path) -> None:
        path = Path(path)
        data = contents(path)
        try:
            from pyulog import ULog
        except ImportError:
            raise LogFormatError(
                f"{path}: PX4 logs need pyulog: pip install 'kollsman[logs]'"
            ) from None
        try:
            with redirect_stdout(io.StringIO()):  # the parser prints what it thinks of a file
                log = ULog(io.BytesIO(data), message_name_filter_list=list(TOPICS))
        except Exception as error:  # whatever a damaged file makes of the parser
            raise LogFormatError(f"{path}: not a PX4 log (.ulg), or damaged: {error}") from error
        lost = len(log.dropouts)
        tables = _tables(log)
        if not tables.sensors:
            raise LogFormatError(f"{path}: a PX4 log without any sensor Kollsman reads")
        counters = Counter({FrameReject.TRUNCATED: lost} if lost else {})
        super().__init__(path, tables, len(data), counters)


class _Topic:
    """The rows of one topic and instance."""

    def __init__(self, data: dict[str, NDArray[Any]], instance: int) -> None:
        known = np.flatnonzero(data["timestamp"] < LAST_US)
        order = known[np.argsort(data["timestamp"][known], kind="stable")]
        self._data = {name: values[order] for name, values in data.items()}
        self.instance = instance
        self.time_us = self._data["timestamp"].astype(np.int64)
        self.size = self.time_us.size

    def has(self, name: str) -> bool:
        return name in self._data

    def floats(self, *names: str, scale: float = 1.0) -> NDArray[np.float64]:
        """The first of `names` that there is, times `scale`; NaN when there is none."""
        for name in names:
            if name in self._data:
                return self._data[name].astype(np.float64) * scale
        return np.full(self.size, math.nan)

    def vector(self, name: str, count: int = 3) -> NDArray[np.float64]:
        return np.stack([self.floats(f"{name}[{axis}]") for axis in range(count)], axis=1)

    def integers(self, name: str, default: int) -> NDArray[np.int64]:
        values = self._data.get(name)
        return np.full(self.size, default) if values is None else values.astype(np.int64)

    def table(self, kind: Kind, *values: Any) -> Readings:
        return sensor(kind, self.time_us, self.time_us, self.instance, values)


def _tables(log: Any) -> Tables:
    topics: dict[str, list[_Topic]] = {}
    for data in log.data_list:
        if data.multi_id < MAX_INSTANCES and len(data.data["timestamp"]):
            topics.setdefault(data.name, []).append(_Topic(data.data, data.multi_id))
    tables = Tables(autopilot=int(mavlink.MAV_AUTOPILOT_PX4))
    for names, make in (
        (("vehicle_air_data", "sensor_baro"), _barometer),
        (("vehicle_gps_position", "sensor_gps"), _gnss),
        (("sensor_combined",), _imu),
        (("vehicle_attitude",), _attitude),
        (("distance_sensor",), _range),
        (("airspeed",), _airspeed),
        (("vehicle_land_detected",), _landed),
    ):
        found = [topics[name] for name in names if name in topics]
        if found:
            fullest = max(found, key=lambda each: max(topic.size for topic in each))
            tables.sensors += [make(topic) for topic in fullest]
    _vehicle(tables, log, topics)
    for name, is_truth in (
        ("vehicle_global_position_groundtruth", True),
        ("vehicle_global_position", False),
    ):
        for topic in topics.get(name, [])[:1]:
            climb = -topic.floats("vel_d")
            altitude = topic.floats("alt")
            if not altitude.any():
                continue  # a simulator that does not fill it in
            times_us = topic.time_us
            tables.heights.append(heights(times_us, times_us, altitude, climb, is_truth=is_truth))
    return tables


def _vehicle(tables: Tables, log: Any, topics: dict[str, list[_Topic]]) -> None:
    tables.parameters = {name: float(value) for name, value in log.initial_parameters.items()}
    system_id = int(tables.parameters.get("MAV_SYS_ID", 1))
    tables.system_id = system_id if 1 <= system_id <= 255 else 1
    tables.is_simulated = log.msg_info_dict.get("ver_hw") == SIMULATED
    tables.texts = [(int(m.timestamp), str(m.message)) for m in log.logged_messages]
    for status in topics.get("vehicle_status", [])[:1]:
        times = status.time_us.tolist()
        tables.armed = changes(times, (status.integers("arming_state", 0) == ARMED).tolist())
        modes = status.integers("nav_state", -1).tolist()
        tables.modes = changes(times, [f"nav_state {mode}" for mode in modes])
        kind = int(status.integers("vehicle_type", 0)[-1])
        tables.vehicle_type = int(TYPES.get(kind, mavlink.MAV_TYPE_GENERIC))
    for name in ("vehicle_gps_position", "sensor_gps"):
        for gps in topics.get(name, [])[:1]:
            unix_us = gps.integers("time_utc_usec", 0)
            offset_us = utc_offset_us(gps.time_us, unix_us, unix_us > 1_000_000_000_000_000)
            tables.utc_offset_us = tables.utc_offset_us or offset_us


def _barometer(topic: _Topic) -> Readings:
    pressure_pa = topic.floats("baro_pressure_pa", "pressure")
    pressure_pa = np.where(pressure_pa < LOWEST_PA, pressure_pa * 100.0, pressure_pa)
    die_k = topic.floats("baro_temp_celcius", "temperature") + ZERO_CELSIUS_K
    return topic.table(Kind.PRESSURE, pressure_pa, die_k, np.zeros(topic.size, np.int64))


def _gnss(topic: _Topic) -> Readings:
    new = topic.has("latitude_deg")
    degree, metre = (1.0, 1.0) if new else (1e-7, 1e-3)
    latitude = topic.floats("latitude_deg", "lat", scale=degree)
    longitude = topic.floats("longitude_deg", "lon", scale=degree)
    nowhere = (latitude == 0) & (longitude == 0)
    has_velocity = topic.integers("vel_ned_valid", 1) == 1
    return topic.table(
        Kind.GNSS,
        np.where(nowhere, math.nan, latitude),
        np.where(nowhere, math.nan, longitude),
        np.where(nowhere, math.nan, topic.floats("altitude_msl_m", "alt", scale=metre)),
        topic.floats("altitude_ellipsoid_m", "alt_ellipsoid", scale=metre),
        topic.floats("vel_m_s"),
        topic.floats("cog_rad"),
        np.where(has_velocity, -topic.floats("vel_d_m_s"), math.nan),
        topic.floats("eph"),
        topic.floats("epv"),
        topic.floats("hdop"),
        topic.floats("vdop"),
        topic.integers("fix_type", 0),
        topic.integers("satellites_used", -1),
        np.zeros(topic.size, np.int64),
    )


def _imu(topic: _Topic) -> Readings:
    return topic.table(Kind.IMU, topic.vector("accelerometer_m_s2"), topic.vector("gyro_rad"))


def _attitude(topic: _Topic) -> Readings:
    q = topic.vector("q", 4)
    w, x, y, z = (q / np.maximum(np.linalg.norm(q, axis=1, keepdims=True), 1e-9)).T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return topic.table(Kind.ATTITUDE, roll, pitch, yaw, np.full((topic.size, 3), math.nan))


def _range(topic: _Topic) -> Readings:
    distance_m = topic.floats("current_distance")
    seen = (distance_m >= topic.floats("min_distance")) & (
        distance_m <= topic.floats("max_distance")
    )
    downward = (topic.integers("orientation", DOWNWARD) == DOWNWARD).astype(np.int64)
    return topic.table(Kind.RANGE, np.where(seen, distance_m, math.nan), downward)


def _airspeed(topic: _Topic) -> Readings:
    return topic.table(Kind.AIRSPEED, topic.floats("indicated_airspeed_m_s"))


def _landed(topic: _Topic) -> Readings:
    unknown, zero = np.full(topic.size, -1), np.zeros(topic.size, np.int64)
    return topic.table(Kind.STATUS, unknown, topic.integers("landed", -1), zero)
