"""MAVLink messages -> readings in SI units: the only file that knows MAVLink's units and sentinels.

A converter returns `Reading`s: the kind, the instance, the values in the order of the kind's dtype,
and the time stamp with its base. Placing that stamp on the vehicle's clock is the work of
`companion.intake.rows`. Every float of a reading is finite or NaN, whatever the message holds.
"""

import math
from collections.abc import Callable
from enum import Enum
from typing import Any, NamedTuple

from companion.kernels.atmosphere import G0_MPS2
from companion.mavlink.codec import Frame, Message, decode, mavlink
from companion.samples import Kind

ZERO_CELSIUS_K = 273.15
UNKNOWN_U16 = 65535
UNKNOWN_U8 = 255
NO_DOP = 9999
FIX_3D = 3
SCALED_PRESSURE = mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE


class TimeBase(Enum):
    """What a stamp counts from."""

    __hash__ = object.__hash__  # an enum's own is Python code, and one is hashed for each reading

    BOOT = "microseconds since boot"
    EITHER = "microseconds since boot or since 1970"
    NONE = "no stamp: take the newest time heard"


class Reading(NamedTuple):
    """One measurement out of a message, in SI units."""

    kind: Kind
    base: TimeBase
    stamp_us: int
    instance: int
    values: tuple[Any, ...]
    """the fields of the kind's dtype behind ``instance``"""


Readings = tuple[Reading, ...]
# Looked up in its class, a member of an enum costs ten times as much (Python 3.11).
_IMU, _PRESSURE, _GNSS, _ATTITUDE, _AIRSPEED = (
    Kind.IMU,
    Kind.PRESSURE,
    Kind.GNSS,
    Kind.ATTITUDE,
    Kind.AIRSPEED,
)
_BOOT, _EITHER = TimeBase.BOOT, TimeBase.EITHER


def scaled_pressure(message: Message, instance: int) -> Readings:
    """SCALED_PRESSURE/2/3: hPa; the temperature is the sensor die's, in centidegrees. The first
    one's differential pressure is an airspeed; 0 where there is no such sensor."""
    values = (pressure_pa(message), message.temperature * 0.01 + ZERO_CELSIUS_K, 0)
    stamp_us = message.time_boot_ms * 1000
    pressure = Reading(_PRESSURE, _BOOT, stamp_us, instance, values)
    if instance or message.press_diff == 0.0 or not math.isfinite(message.press_diff):
        return (pressure,)
    speed = (airspeed_mps(message.press_diff * 100.0),)
    return pressure, Reading(_AIRSPEED, _BOOT, stamp_us, 1, speed)


def pressure_pa(message: Message) -> float:
    """SCALED_PRESSURE: the absolute pressure; NaN where that is no number."""
    return _finite(message.press_abs * 100.0)


def station_pressure_pa(frame: Frame) -> float | None:
    """The pressure in a frame of a ground barometer; None for another message."""
    message = decode(frame) if frame.message_id == SCALED_PRESSURE else None
    return pressure_pa(message) if message is not None else None


def airspeed_mps(dynamic_pa: float) -> float:
    """Calibrated airspeed of a dynamic pressure (impact pressure of compressible flow at sea
    level); 0 below 0, NaN beyond the speed of sound, where there is a shock."""
    ratio = max(0.0, dynamic_pa) / 101_325.0
    return (
        340.294 * math.sqrt(5.0 * ((ratio + 1.0) ** (2.0 / 7.0) - 1.0))
        if ratio < 0.89
        else math.nan
    )


def vfr_hud(message: Message) -> Readings:
    """VFR_HUD: the airspeed that the autopilot shows, measured or estimated. It has no stamp."""
    return (Reading(_AIRSPEED, TimeBase.NONE, 0, 0, (_finite(message.airspeed),)),)


def gps_raw(message: Message, instance: int) -> Readings:
    """GPS_RAW_INT, GPS2_RAW: every extension field uses 0 for absent; eph, epv are DOP x 100, 65535
    unknown.

    GPS_RAW_INT has no vertical speed. A position of exactly 0, 0 is a receiver that does not know
    where it is.
    """
    nowhere = message.lat == 0 and message.lon == 0
    values = (
        math.nan if nowhere else message.lat * 1e-7,
        math.nan if nowhere else message.lon * 1e-7,
        math.nan if nowhere else message.alt * 1e-3,
        _present(message.alt_ellipsoid, 1e-3),
        _known_u16(message.vel, 0.01),
        math.radians(_known_u16(message.cog, 0.01)),
        math.nan,
        _present(message.h_acc, 1e-3),
        _present(message.v_acc, 1e-3),
        _dop(message.eph, has_fix=message.fix_type >= FIX_3D),
        _dop(message.epv, has_fix=message.fix_type >= FIX_3D),
        message.fix_type,
        -1 if message.satellites_visible == UNKNOWN_U8 else message.satellites_visible,
        0,
    )
    return (Reading(_GNSS, _EITHER, message.time_usec, instance, values),)


def attitude(message: Message) -> Readings:
    """ATTITUDE: already in radians, forward-right-down."""
    values = (
        _finite(message.roll),
        _finite(message.pitch),
        _finite(message.yaw),
        _body_rates(message),
    )
    return (Reading(_ATTITUDE, _BOOT, message.time_boot_ms * 1000, 0, values),)


def attitude_quaternion(message: Message) -> Readings:
    """ATTITUDE_QUATERNION: w, x, y, z of the rotation from body to NED."""
    w, x, y, z = message.q1, message.q2, message.q3, message.q4
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not 0.9 < norm < 1.1:
        return ()
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    values = (roll, pitch, yaw, _body_rates(message))
    return (Reading(_ATTITUDE, _BOOT, message.time_boot_ms * 1000, 0, values),)


def distance_sensor(message: Message) -> Readings:
    """DISTANCE_SENSOR: centimetres; out of its own range, or of quality 1, it saw nothing."""
    seen = (
        message.min_distance <= message.current_distance <= message.max_distance
        and message.signal_quality != 1
    )
    distance_m = (
        message.current_distance * 0.01 if seen and message.current_distance > 0 else math.nan
    )
    downward = int(message.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270)
    values = (distance_m, downward)
    return (Reading(Kind.RANGE, _BOOT, message.time_boot_ms * 1000, message.id % 4, values),)


def heartbeat(message: Message) -> Readings:
    """HEARTBEAT: armed or not."""
    return (Reading(Kind.STATUS, TimeBase.NONE, 0, 0, (int(is_armed(message)), -1, 0)),)


def is_armed(message: Message) -> bool:
    """HEARTBEAT: whether the vehicle is armed."""
    return bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)


def extended_sys_state(message: Message) -> Readings:
    """EXTENDED_SYS_STATE: on the ground or in the air."""
    on_ground = {mavlink.MAV_LANDED_STATE_ON_GROUND: 1, mavlink.MAV_LANDED_STATE_UNDEFINED: -1}
    return (
        Reading(Kind.STATUS, TimeBase.NONE, 0, 0, (-1, on_ground.get(message.landed_state, 0), 0)),
    )


def system_time(message: Message) -> Readings:
    """SYSTEM_TIME: nothing but the boot clock, for vehicles whose other stamps may count from
    anything."""
    return (Reading(Kind.STATUS, _BOOT, message.time_boot_ms * 1000, 0, (-1, -1, 0)),)


def home_position(message: Message) -> Readings:
    """HOME_POSITION: millimetres AMSL. One at exactly 0, 0 was never set."""
    if message.latitude == 0 and message.longitude == 0:
        return ()
    values = (message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3)
    return (Reading(Kind.HOME, TimeBase.NONE, 0, 0, values),)


def imu_milli_g(message: Message, instance: int) -> Readings:
    """SCALED_IMU/2/3: mG and mrad/s since boot milliseconds."""
    values = _inertial(message, 1e-3 * G0_MPS2)
    return (Reading(_IMU, _BOOT, message.time_boot_ms * 1000, instance, values),)


def raw_imu(message: Message, accelerometer_scale: float) -> Readings:
    """RAW_IMU: int16 in the unit of the autopilot's choice; rates are mrad/s wherever accelerations
    are scaled."""
    values = _inertial(message, accelerometer_scale)
    return (Reading(_IMU, _EITHER, message.time_usec, 0, values),)


def highres_imu(message: Message) -> Readings:
    """HIGHRES_IMU: SI, and hPa (old PX4: Pa). ``fields_updated`` says which are new; 0 from senders
    that leave it."""
    updated = message.fields_updated or 0xFFFF
    readings: list[Reading] = []
    if updated & 0x3F:
        force = (_finite(message.xacc), _finite(message.yacc), _finite(message.zacc))
        rate = (_finite(message.xgyro), _finite(message.ygyro), _finite(message.zgyro))
        readings.append(Reading(_IMU, _EITHER, message.time_usec, message.id % 4, (force, rate)))
    if updated & 0x200 and message.abs_pressure > 0:
        pressure_pa = message.abs_pressure * (100.0 if message.abs_pressure < 2000.0 else 1.0)
        die_k = _finite(message.temperature + ZERO_CELSIUS_K) if updated & 0x1000 else math.nan
        values = (_finite(pressure_pa), die_k, 0)
        readings.append(Reading(_PRESSURE, _EITHER, message.time_usec, message.id % 4, values))
    return tuple(readings)


def hygrometer(message: Message) -> Readings:
    """HYGROMETER_SENSOR: centidegrees, without a time stamp; a probe in the air."""
    kelvin = message.temperature * 0.01 + ZERO_CELSIUS_K
    return (_air(TimeBase.NONE, 0, message.id % 4, kelvin),)


def airspeed_temperature(message: Message) -> Readings:
    """SCALED_PRESSURE.temperature_press_diff: the sensor of the airspeed; 0 is absent."""
    kelvin = _present(message.temperature_press_diff, 0.01) + ZERO_CELSIUS_K
    if math.isnan(kelvin):
        return ()
    return (_air(_BOOT, message.time_boot_ms * 1000, 0, kelvin),)


def imu_temperature(message: Message) -> Readings:
    """HIGHRES_IMU.temperature, degrees Celsius: a sensor's die."""
    if not (message.fields_updated or 0xFFFF) & 0x1000:
        return ()
    kelvin = _finite(message.temperature + ZERO_CELSIUS_K)
    return (_air(_EITHER, message.time_usec, message.id % 4, kelvin),)


def _air(base: TimeBase, stamp_us: int, instance: int, kelvin: float) -> Reading:
    return Reading(Kind.AIR, base, stamp_us, instance, (kelvin, *(math.nan,) * 4))


THERMOMETERS: dict[str, dict[int, Callable[[Message], Readings]]] = {
    "hygrometer": {mavlink.MAVLINK_MSG_ID_HYGROMETER_SENSOR: hygrometer},
    "airspeed": {mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: airspeed_temperature},
    "imu": {mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: imu_temperature},
    "none": {},
}
"""Sources of the air temperature, by the value of ``intake.air_temperature``."""

CONVERTERS: dict[int, Callable[[Message], Readings]] = {
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: lambda message: scaled_pressure(message, 0),
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE2: lambda message: scaled_pressure(message, 1),
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE3: lambda message: scaled_pressure(message, 2),
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: lambda message: gps_raw(message, 0),
    mavlink.MAVLINK_MSG_ID_GPS2_RAW: lambda message: gps_raw(message, 1),
    mavlink.MAVLINK_MSG_ID_SCALED_IMU: lambda message: imu_milli_g(message, 0),
    mavlink.MAVLINK_MSG_ID_SCALED_IMU2: lambda message: imu_milli_g(message, 1),
    mavlink.MAVLINK_MSG_ID_SCALED_IMU3: lambda message: imu_milli_g(message, 2),
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: highres_imu,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: attitude,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: attitude_quaternion,
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: distance_sensor,
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: extended_sys_state,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: home_position,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: system_time,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: vfr_hud,
}
"""RAW_IMU is missing: its scale needs memory (`companion.mavlink.imu`)."""


def sim_state(message: Message) -> tuple[float, float]:
    """SIM_STATE: true (altitude_amsl_m, climb_mps). It has no time stamp."""
    return message.alt, -message.vd


def hil_state(message: Message) -> tuple[float, float]:
    """HIL_STATE_QUATERNION, sent by PX4's simulators: true (altitude_amsl_m, climb_mps)."""
    return message.alt * 1e-3, message.vz * -0.01


TRUTHS: dict[int, Callable[[Message], tuple[float, float] | None]] = {
    mavlink.MAVLINK_MSG_ID_SIM_STATE: sim_state,
    mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION: hil_state,
    mavlink.MAVLINK_MSG_ID_SIMSTATE: lambda message: None,  # it has attitude and place alone
}
"""Messages of a simulated vehicle with its true altitude and climb."""


def global_position(message: Message) -> tuple[int, float, float]:
    """GLOBAL_POSITION_INT: the autopilot's own (time_us since boot, altitude_amsl_m, climb_mps)."""
    return message.time_boot_ms * 1000, message.alt * 1e-3, message.vz * -0.01


def _inertial(message: Message, accelerometer_scale: float) -> tuple[Any, ...]:
    force = (
        message.xacc * accelerometer_scale,
        message.yacc * accelerometer_scale,
        message.zacc * accelerometer_scale,
    )
    rate = (message.xgyro * 1e-3, message.ygyro * 1e-3, message.zgyro * 1e-3)
    return force, rate


def _body_rates(message: Message) -> tuple[float, float, float]:
    return _finite(message.rollspeed), _finite(message.pitchspeed), _finite(message.yawspeed)


def _finite(value: float) -> float:
    return value if math.isfinite(value) else math.nan


def _present(value: float, scale: float) -> float:
    """An extension field: 0 means that it was not sent."""
    return value * scale if value != 0 else math.nan


def _known_u16(value: int, scale: float) -> float:
    return value * scale if value != UNKNOWN_U16 else math.nan


def _dop(value: int, *, has_fix: bool) -> float:
    """Dilution of precision; 0 and 65535 are unknown. 99.99 is hopeless without a fix, and unknown
    beside one: some receivers never fill it in."""
    unknown = (0, UNKNOWN_U16, NO_DOP) if has_fix else (0, UNKNOWN_U16)
    return value * 0.01 if value not in unknown else math.nan
