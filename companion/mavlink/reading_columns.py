"""The columns of a message kind -> readings in columns: `companion.mavlink.convert` for many
messages at once, with the same values bit for bit (tests/unit/companion/mavlink hold this)."""

import math
from collections import namedtuple
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.kernels.atmosphere import G0_MPS2
from companion.mavlink import convert
from companion.mavlink.codec import mavlink
from companion.mavlink.convert import NO_DOP, UNKNOWN_U8, UNKNOWN_U16, ZERO_CELSIUS_K, TimeBase
from companion.samples import DTYPES, Kind, Rows, rows

RADIANS = math.pi / 180.0
LARGEST_STAMP_US = 1 << 61
"""as of `companion.intake.clock_steps`: a stamp above it is no time"""
UNSAID = "datum_sd_m"
"""field of a fix that no message says"""
Columns = NDArray[Any]
"""The payloads of one kind, a structured array with the fields' names."""
Array = NDArray[Any]


class Readings(NamedTuple):
    """Readings of one kind of sample out of the messages of one kind."""

    kind: Kind
    base: TimeBase
    places: Array
    """of each reading's message among the columns, or of its item in a log, shape (n,)"""
    stamp_us: Array
    samples: Rows
    """rows of the kind's dtype with ``instance`` and the values, shape (n,)"""


def singles(columns: Readings) -> Iterator[convert.Reading]:
    """Readings in columns as one after the other."""
    kind, base = columns.kind, columns.base
    names = (columns.samples.dtype.names or ())[3:]
    values = [columns.samples[name].tolist() for name in names if name != UNSAID]
    instances, stamps = columns.samples["instance"].tolist(), columns.stamp_us.tolist()
    for stamp_us, instance, *each in zip(stamps, instances, *values, strict=True):
        yield convert.Reading(kind, base, stamp_us, instance, tuple(each))


Converter = Callable[[Columns], list[Readings]]


def _readings(
    kind: Kind,
    base: TimeBase,
    columns: Columns,
    values: dict[str, Any],
    *,
    instance: Any = 0,
    stamp_us: Any = 0,
    where: Array | None = None,
) -> Readings:
    """Readings of the messages `where` (default: all); values are of all messages."""
    chosen = np.arange(columns.size) if where is None else np.flatnonzero(where)
    samples = rows(DTYPES[kind], chosen.size)
    samples["instance"] = np.broadcast_to(instance, columns.shape)[chosen]
    for name, value in values.items():
        samples[name] = value if np.ndim(value) == 0 else value[chosen]
    stamps = np.broadcast_to(np.asarray(stamp_us), columns.shape)[chosen]
    return Readings(kind, base, chosen, np.minimum(stamps, LARGEST_STAMP_US).astype("i8"), samples)


def _boot_us(columns: Columns) -> Array:
    return columns["time_boot_ms"].astype("i8") * 1000


def _double(values: Array) -> Array:
    """In double precision."""
    with np.errstate(invalid="ignore"):  # a signalling NaN
        return values.astype("f8")


def _float(values: Array) -> Array:
    """In double precision; what is not finite is NaN."""
    values = _double(values)
    return np.where(np.isfinite(values), values, np.nan)


def _present(values: Array, scale: float) -> Array:
    """An extension field: 0 means that it was not sent."""
    return np.where(values != 0, _double(values) * scale, np.nan)


def _known_u16(values: Array, scale: float) -> Array:
    return np.where(values != UNKNOWN_U16, _double(values) * scale, np.nan)


def _dop(values: Array, has_fix: Array) -> Array:
    unknown = (values == 0) | (values == UNKNOWN_U16) | ((values == NO_DOP) & has_fix)
    return np.where(unknown, np.nan, _double(values) * 0.01)


def _vectors(columns: Columns, names: tuple[str, str, str], scale: float | None = None) -> Array:
    values = [_double(columns[name]) for name in names]
    scaled = [_float(value) if scale is None else value * scale for value in values]
    return np.stack(scaled, axis=1)


def _scaled_pressure(columns: Columns, instance: int) -> list[Readings]:
    die_k = _double(columns["temperature"]) * 0.01 + ZERO_CELSIUS_K
    pressure_pa = _float(_double(columns["press_abs"]) * 100.0)
    values = {"pressure_pa": pressure_pa, "die_temperature_k": die_k}
    stamp_us = _boot_us(columns)
    found = [
        _readings(
            Kind.PRESSURE, TimeBase.BOOT, columns, values, instance=instance, stamp_us=stamp_us
        )
    ]
    dynamic_hpa = _double(columns["press_diff"])
    has_speed = (dynamic_hpa != 0.0) & np.isfinite(dynamic_hpa)
    if instance == 0 and has_speed.any():
        speed_mps = np.full(columns.size, np.nan)
        dynamic_pa = (dynamic_hpa[has_speed] * 100.0).tolist()
        speed_mps[has_speed] = list(map(convert.airspeed_mps, dynamic_pa))
        found.append(
            _readings(
                Kind.AIRSPEED,
                TimeBase.BOOT,
                columns,
                {"airspeed_mps": speed_mps},
                instance=1,
                stamp_us=stamp_us,
                where=has_speed,
            )
        )
    return found


def _vfr_hud(columns: Columns) -> list[Readings]:
    values = {"airspeed_mps": _float(columns["airspeed"])}
    return [_readings(Kind.AIRSPEED, TimeBase.NONE, columns, values)]


def _gps_raw(columns: Columns, instance: int) -> list[Readings]:
    nowhere = (columns["lat"] == 0) & (columns["lon"] == 0)
    has_fix = columns["fix_type"] >= convert.FIX_3D
    satellites = columns["satellites_visible"].astype("i8")

    def known(name: str, scale: float) -> Array:
        return np.where(nowhere, np.nan, _double(columns[name]) * scale)

    values = {
        "latitude_deg": known("lat", 1e-7),
        "longitude_deg": known("lon", 1e-7),
        "altitude_amsl_m": known("alt", 1e-3),
        "altitude_ellipsoid_m": _present(columns["alt_ellipsoid"], 1e-3),
        "ground_speed_mps": _known_u16(columns["vel"], 0.01),
        "course_rad": _known_u16(columns["cog"], 0.01) * RADIANS,
        "horizontal_sd_m": _present(columns["h_acc"], 1e-3),
        "vertical_sd_m": _present(columns["v_acc"], 1e-3),
        "hdop": _dop(columns["eph"], has_fix),
        "vdop": _dop(columns["epv"], has_fix),
        "fix_type": columns["fix_type"].astype("i8"),
        "satellites": np.where(satellites == UNKNOWN_U8, -1, satellites),
    }
    stamp_us = columns["time_usec"]
    return [
        _readings(Kind.GNSS, TimeBase.EITHER, columns, values, instance=instance, stamp_us=stamp_us)
    ]


def _attitude(columns: Columns) -> list[Readings]:
    values = {
        "roll_rad": _float(columns["roll"]),
        "pitch_rad": _float(columns["pitch"]),
        "yaw_rad": _float(columns["yaw"]),
        "angular_rate_b_radps": _vectors(columns, ("rollspeed", "pitchspeed", "yawspeed")),
    }
    return [_readings(Kind.ATTITUDE, TimeBase.BOOT, columns, values, stamp_us=_boot_us(columns))]


def _distance_sensor(columns: Columns) -> list[Readings]:
    distance = columns["current_distance"]
    seen = (
        (columns["min_distance"] <= distance)
        & (distance <= columns["max_distance"])
        & (columns["signal_quality"] != 1)
        & (distance > 0)
    )
    values = {
        "distance_m": np.where(seen, _double(distance) * 0.01, np.nan),
        "downward": (columns["orientation"] == mavlink.MAV_SENSOR_ROTATION_PITCH_270).astype("i8"),
    }
    instance, stamp_us = columns["id"].astype("i8") % 4, _boot_us(columns)
    return [
        _readings(Kind.RANGE, TimeBase.BOOT, columns, values, instance=instance, stamp_us=stamp_us)
    ]


def _status(columns: Columns, base: TimeBase, stamp_us: Any = 0, **values: Any) -> list[Readings]:
    values = {"armed": -1, "landed": -1} | values
    return [_readings(Kind.STATUS, base, columns, values, stamp_us=stamp_us)]


def _heartbeat(columns: Columns) -> list[Readings]:
    armed = (columns["base_mode"] & mavlink.MAV_MODE_FLAG_SAFETY_ARMED) != 0
    return _status(columns, TimeBase.NONE, armed=armed.astype("i8"))


def _extended_sys_state(columns: Columns) -> list[Readings]:
    state = columns["landed_state"]
    landed = np.where(state == mavlink.MAV_LANDED_STATE_ON_GROUND, 1, 0)
    landed = np.where(state == mavlink.MAV_LANDED_STATE_UNDEFINED, -1, landed)
    return _status(columns, TimeBase.NONE, landed=landed)


def _system_time(columns: Columns) -> list[Readings]:
    return _status(columns, TimeBase.BOOT, _boot_us(columns))


def _inertial(columns: Columns, scale: float) -> dict[str, Any]:
    return {
        "specific_force_b_mps2": _vectors(columns, ("xacc", "yacc", "zacc"), scale),
        "angular_rate_b_radps": _vectors(columns, ("xgyro", "ygyro", "zgyro"), 1e-3),
    }


def _imu_milli_g(columns: Columns, instance: int) -> list[Readings]:
    values, stamp_us = _inertial(columns, 1e-3 * G0_MPS2), _boot_us(columns)
    return [
        _readings(Kind.IMU, TimeBase.BOOT, columns, values, instance=instance, stamp_us=stamp_us)
    ]


def raw_imu(columns: Columns, accelerometer_scale: float) -> list[Readings]:
    """RAW_IMU, whose unit is the autopilot's choice."""
    values, stamp_us = _inertial(columns, accelerometer_scale), columns["time_usec"]
    return [_readings(Kind.IMU, TimeBase.EITHER, columns, values, stamp_us=stamp_us)]


def _highres_imu(columns: Columns) -> list[Readings]:
    updated = np.where(columns["fields_updated"] != 0, columns["fields_updated"], 0xFFFF)
    stamp_us, instance = columns["time_usec"], columns["id"].astype("i8") % 4
    values = {
        "specific_force_b_mps2": _vectors(columns, ("xacc", "yacc", "zacc")),
        "angular_rate_b_radps": _vectors(columns, ("xgyro", "ygyro", "zgyro")),
    }
    found = [
        _readings(
            Kind.IMU,
            TimeBase.EITHER,
            columns,
            values,
            instance=instance,
            stamp_us=stamp_us,
            where=(updated & 0x3F) != 0,
        )
    ]
    given = _double(columns["abs_pressure"])
    die_k = _float(_double(columns["temperature"]) + ZERO_CELSIUS_K)
    with np.errstate(invalid="ignore", over="ignore"):
        pressure_pa = _float(given * np.where(given < 2000.0, 100.0, 1.0))
    values = {
        "pressure_pa": pressure_pa,
        "die_temperature_k": np.where((updated & 0x1000) != 0, die_k, np.nan),
    }
    found.append(
        _readings(
            Kind.PRESSURE,
            TimeBase.EITHER,
            columns,
            values,
            instance=instance,
            stamp_us=stamp_us,
            where=((updated & 0x200) != 0) & (given > 0),
        )
    )
    return found


def _hygrometer(columns: Columns) -> list[Readings]:
    values = {"air_temperature_k": _double(columns["temperature"]) * 0.01 + ZERO_CELSIUS_K}
    instance = columns["id"].astype("i8") % 4
    return [_readings(Kind.AIR, TimeBase.NONE, columns, values, instance=instance)]


def _airspeed_temperature(columns: Columns) -> list[Readings]:
    kelvin = _present(columns["temperature_press_diff"], 0.01) + ZERO_CELSIUS_K
    values, known = {"air_temperature_k": kelvin}, np.isfinite(kelvin)
    stamp_us = _boot_us(columns)
    return [_readings(Kind.AIR, TimeBase.BOOT, columns, values, stamp_us=stamp_us, where=known)]


def _imu_temperature(columns: Columns) -> list[Readings]:
    updated = np.where(columns["fields_updated"] != 0, columns["fields_updated"], 0xFFFF)
    kelvin = _float(_double(columns["temperature"]) + ZERO_CELSIUS_K)
    return [
        _readings(
            Kind.AIR,
            TimeBase.EITHER,
            columns,
            {"air_temperature_k": kelvin},
            instance=columns["id"].astype("i8") % 4,
            stamp_us=columns["time_usec"],
            where=(updated & 0x1000) != 0,
        )
    ]


def _one_by_one(kind: Kind, base: TimeBase, make: Callable[[Any], convert.Readings]) -> Converter:
    """The converter of a kind that is converted one message at a time: it is rare, or needs
    functions that NumPy rounds in its own way."""

    def converter(columns: Columns) -> list[Readings]:
        light = namedtuple("light", columns.dtype.names or ())  # type: ignore[misc]
        found = [make(light(*values)) for values in columns.tolist()]
        where = np.array([len(each) == 1 for each in found], bool)
        readings = [each for one in found for each in one]
        samples = rows(DTYPES[kind], len(readings))
        for sample, reading in zip(samples, readings, strict=True):
            values = (0, 0, reading.instance, *reading.values)
            for name, value in zip(DTYPES[kind].names or (), values, strict=True):
                sample[name] = value
        stamps = np.array([reading.stamp_us for reading in readings], np.int64)
        return [Readings(kind, base, np.flatnonzero(where), stamps, samples)]

    return converter


THERMOMETERS: dict[str, dict[int, Converter]] = {
    "hygrometer": {mavlink.MAVLINK_MSG_ID_HYGROMETER_SENSOR: _hygrometer},
    "airspeed": {mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: _airspeed_temperature},
    "imu": {mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: _imu_temperature},
    "none": {},
}
"""As `convert.THERMOMETERS`."""

CONVERTERS: dict[int, Converter] = {
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: lambda columns: _scaled_pressure(columns, 0),
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE2: lambda columns: _scaled_pressure(columns, 1),
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE3: lambda columns: _scaled_pressure(columns, 2),
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: lambda columns: _gps_raw(columns, 0),
    mavlink.MAVLINK_MSG_ID_GPS2_RAW: lambda columns: _gps_raw(columns, 1),
    mavlink.MAVLINK_MSG_ID_SCALED_IMU: lambda columns: _imu_milli_g(columns, 0),
    mavlink.MAVLINK_MSG_ID_SCALED_IMU2: lambda columns: _imu_milli_g(columns, 1),
    mavlink.MAVLINK_MSG_ID_SCALED_IMU3: lambda columns: _imu_milli_g(columns, 2),
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: _highres_imu,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _one_by_one(
        Kind.ATTITUDE, TimeBase.BOOT, convert.attitude_quaternion
    ),
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: _one_by_one(
        Kind.HOME, TimeBase.NONE, convert.home_position
    ),
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: _distance_sensor,
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_sys_state,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: _system_time,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: _vfr_hud,
}
"""As `convert.CONVERTERS`."""
