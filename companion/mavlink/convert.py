"""MAVLink messages -> readings in SI units: the only file that knows MAVLink's units and sentinels.

A converter returns `Reading`s: the kind, the instance, the values in the order of the kind's dtype,
and the time stamp with its base. Placing that stamp on the vehicle's clock is the work of
`companion.intake.rows`. Every float of a reading is finite or NaN, whatever the message holds.

A converter takes one message, or the columns of many (`companion.mavlink.reading_columns`): the
fields of `m` are numbers or arrays, and what these do differently is in the arithmetic `x`.
"""

import math
from collections.abc import Callable
from enum import Enum
from functools import partial
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


class Numbers:
    """The arithmetic of one message."""

    @staticmethod
    def where(condition: Any, value: Any, other: Any) -> Any:
        """`value` where the condition is true."""
        return value if condition else other

    @staticmethod
    def finite(value: Any) -> Any:
        """The value where it is finite, else NaN."""
        return value if math.isfinite(value) else math.nan

    @staticmethod
    def each(function: Callable[..., Any], *values: Any, where: Any = True) -> Any:
        """The function of each message's values `where` a condition is true."""
        return function(*values) if where else math.nan

    @staticmethod
    def given(condition: Any, reading: Reading) -> Readings:
        """The reading where the condition is true, none elsewhere."""
        return (reading,) if condition else ()


Arithmetic = type[Numbers]
"""`Numbers`, or what has the same functions for arrays."""
Converter = Callable[..., Readings]
"""of (message or columns, arithmetic)"""
RADIANS = math.pi / 180.0
# Looked up in its class, a member of an enum costs ten times as much (Python 3.11).
_IMU, _PRESSURE, _GNSS, _ATTITUDE, _AIRSPEED = (
    Kind.IMU,
    Kind.PRESSURE,
    Kind.GNSS,
    Kind.ATTITUDE,
    Kind.AIRSPEED,
)
_BOOT, _EITHER = TimeBase.BOOT, TimeBase.EITHER


def scaled_pressure(m: Message, x: Arithmetic = Numbers, instance: int = 0) -> Readings:
    """SCALED_PRESSURE/2/3: hPa; the temperature is the sensor die's, in centidegrees. The first
    one's differential pressure is an airspeed; 0 where there is no such sensor."""
    values = (x.finite(m.press_abs * 100.0), m.temperature * 0.01 + ZERO_CELSIUS_K, 0)
    stamp_us = m.time_boot_ms * 1000
    pressure = Reading(_PRESSURE, _BOOT, stamp_us, instance, values)
    if instance:
        return (pressure,)
    has_speed = (m.press_diff != 0.0) & (abs(m.press_diff) < math.inf)
    speed = (x.each(airspeed_mps, m.press_diff * 100.0, where=has_speed),)
    return pressure, *x.given(has_speed, Reading(_AIRSPEED, _BOOT, stamp_us, 1, speed))


def station_pressure_pa(frame: Frame) -> float | None:
    """The pressure in a frame of a ground barometer, NaN where it is no number; None for another
    message."""
    message = decode(frame) if frame.message_id == SCALED_PRESSURE else None
    return float(scaled_pressure(message)[0].values[0]) if message is not None else None


def airspeed_mps(dynamic_pa: float) -> float:
    """Calibrated airspeed of a dynamic pressure (impact pressure of compressible flow at sea
    level); 0 below 0, NaN beyond the speed of sound, where there is a shock."""
    ratio = max(0.0, dynamic_pa) / 101_325.0
    return (
        340.294 * math.sqrt(5.0 * ((ratio + 1.0) ** (2.0 / 7.0) - 1.0))
        if ratio < 0.89
        else math.nan
    )


def vfr_hud(m: Message, x: Arithmetic = Numbers) -> Readings:
    """VFR_HUD: the airspeed that the autopilot shows, measured or estimated. It has no stamp."""
    return (Reading(_AIRSPEED, TimeBase.NONE, 0, 0, (x.finite(m.airspeed),)),)


def gps_raw(m: Message, x: Arithmetic = Numbers, instance: int = 0) -> Readings:
    """GPS_RAW_INT, GPS2_RAW: every extension field uses 0 for absent; eph, epv are DOP x 100, 65535
    unknown.

    GPS_RAW_INT has no vertical speed. A position of exactly 0, 0 is a receiver that does not know
    where it is.
    """
    nowhere, has_fix = (m.lat == 0) & (m.lon == 0), m.fix_type >= FIX_3D
    values = (
        x.where(nowhere, math.nan, m.lat * 1e-7),
        x.where(nowhere, math.nan, m.lon * 1e-7),
        x.where(nowhere, math.nan, m.alt * 1e-3),
        _present(m.alt_ellipsoid, 1e-3, x),
        _known_u16(m.vel, 0.01, x),
        _known_u16(m.cog, 0.01, x) * RADIANS,
        math.nan,
        _present(m.h_acc, 1e-3, x),
        _present(m.v_acc, 1e-3, x),
        _dop(m.eph, has_fix, x),
        _dop(m.epv, has_fix, x),
        m.fix_type,
        x.where(m.satellites_visible == UNKNOWN_U8, -1, m.satellites_visible),
        0,
    )
    return (Reading(_GNSS, _EITHER, m.time_usec, instance, values),)


def attitude(m: Message, x: Arithmetic = Numbers) -> Readings:
    """ATTITUDE: already in radians, forward-right-down."""
    values = (x.finite(m.roll), x.finite(m.pitch), x.finite(m.yaw), _body_rates(m, x))
    return (Reading(_ATTITUDE, _BOOT, m.time_boot_ms * 1000, 0, values),)


def attitude_quaternion(m: Message, x: Arithmetic = Numbers) -> Readings:
    """ATTITUDE_QUATERNION: w, x, y, z of the rotation from body to NED."""
    roll, pitch, yaw = x.each(_euler, m.q1, m.q2, m.q3, m.q4)
    values = (roll, pitch, yaw, _body_rates(m, x))
    is_rotation = abs(roll) <= math.pi
    return x.given(is_rotation, Reading(_ATTITUDE, _BOOT, m.time_boot_ms * 1000, 0, values))


def _euler(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a rotation; NaN where the quaternion is none."""
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not 0.9 < norm < 1.1:
        return math.nan, math.nan, math.nan
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw


def distance_sensor(m: Message, x: Arithmetic = Numbers) -> Readings:
    """DISTANCE_SENSOR: centimetres; out of its own range, or of quality 1, it saw nothing."""
    distance = m.current_distance
    seen = (m.min_distance <= distance) & (distance <= m.max_distance) & (distance > 0)
    distance_m = x.where(seen & (m.signal_quality != 1), distance * 0.01, math.nan)
    downward = x.where(m.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270, 1, 0)
    values = (distance_m, downward)
    return (Reading(Kind.RANGE, _BOOT, m.time_boot_ms * 1000, m.id % 4, values),)


def heartbeat(m: Message, x: Arithmetic = Numbers) -> Readings:
    """HEARTBEAT: armed or not."""
    armed = x.where((m.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED) != 0, 1, 0)
    return (Reading(Kind.STATUS, TimeBase.NONE, 0, 0, (armed, -1, 0)),)


def is_armed(message: Message) -> bool:
    """HEARTBEAT: whether the vehicle is armed."""
    return bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)


def extended_sys_state(m: Message, x: Arithmetic = Numbers) -> Readings:
    """EXTENDED_SYS_STATE: on the ground or in the air."""
    landed = x.where(m.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND, 1, 0)
    landed = x.where(m.landed_state == mavlink.MAV_LANDED_STATE_UNDEFINED, -1, landed)
    return (Reading(Kind.STATUS, TimeBase.NONE, 0, 0, (-1, landed, 0)),)


def system_time(m: Message, x: Arithmetic = Numbers) -> Readings:
    """SYSTEM_TIME: nothing but the boot clock, for vehicles whose other stamps may count from
    anything."""
    return (Reading(Kind.STATUS, _BOOT, m.time_boot_ms * 1000, 0, (-1, -1, 0)),)


def home_position(m: Message, x: Arithmetic = Numbers) -> Readings:
    """HOME_POSITION: millimetres AMSL. One at exactly 0, 0 was never set."""
    values = (m.latitude * 1e-7, m.longitude * 1e-7, m.altitude * 1e-3)
    is_set = (m.latitude != 0) | (m.longitude != 0)
    return x.given(is_set, Reading(Kind.HOME, TimeBase.NONE, 0, 0, values))


def imu_milli_g(m: Message, x: Arithmetic = Numbers, instance: int = 0) -> Readings:
    """SCALED_IMU/2/3: mG and mrad/s since boot milliseconds."""
    values = _inertial(m, 1e-3 * G0_MPS2)
    return (Reading(_IMU, _BOOT, m.time_boot_ms * 1000, instance, values),)


def raw_imu(m: Message, accelerometer_scale: float) -> Readings:
    """RAW_IMU: int16 in the unit of the autopilot's choice; rates are mrad/s wherever accelerations
    are scaled."""
    return (Reading(_IMU, _EITHER, m.time_usec, 0, _inertial(m, accelerometer_scale)),)


def highres_imu(m: Message, x: Arithmetic = Numbers) -> Readings:
    """HIGHRES_IMU: SI, and hPa (old PX4: Pa). ``fields_updated`` says which are new; 0 from senders
    that leave it."""
    updated, instance = _updated(m, x), m.id % 4
    force = (x.finite(m.xacc), x.finite(m.yacc), x.finite(m.zacc))
    rate = (x.finite(m.xgyro), x.finite(m.ygyro), x.finite(m.zgyro))
    given = m.abs_pressure
    pressure_pa = x.finite(given * x.where(given < 2000.0, 100.0, 1.0))
    die_k = x.finite(m.temperature + ZERO_CELSIUS_K)
    values = (pressure_pa, x.where((updated & 0x1000) != 0, die_k, math.nan), 0)
    has_pressure = ((updated & 0x200) != 0) & (given > 0)
    return (
        *x.given(
            (updated & 0x3F) != 0, Reading(_IMU, _EITHER, m.time_usec, instance, (force, rate))
        ),
        *x.given(has_pressure, Reading(_PRESSURE, _EITHER, m.time_usec, instance, values)),
    )


def _updated(m: Message, x: Arithmetic) -> Any:
    return x.where(m.fields_updated != 0, m.fields_updated, 0xFFFF)


def hygrometer(m: Message, x: Arithmetic = Numbers) -> Readings:
    """HYGROMETER_SENSOR: centidegrees, without a time stamp; a probe in the air."""
    return (_air(TimeBase.NONE, 0, m.id % 4, m.temperature * 0.01 + ZERO_CELSIUS_K),)


def airspeed_temperature(m: Message, x: Arithmetic = Numbers) -> Readings:
    """SCALED_PRESSURE.temperature_press_diff: the sensor of the airspeed; 0 is absent."""
    kelvin = m.temperature_press_diff * 0.01 + ZERO_CELSIUS_K
    reading = _air(_BOOT, m.time_boot_ms * 1000, 0, kelvin)
    return x.given(m.temperature_press_diff != 0, reading)


def imu_temperature(m: Message, x: Arithmetic = Numbers) -> Readings:
    """HIGHRES_IMU.temperature, degrees Celsius: a sensor's die."""
    kelvin = x.finite(m.temperature + ZERO_CELSIUS_K)
    reading = _air(_EITHER, m.time_usec, m.id % 4, kelvin)
    return x.given((_updated(m, x) & 0x1000) != 0, reading)


def _air(base: TimeBase, stamp_us: Any, instance: Any, kelvin: Any) -> Reading:
    return Reading(Kind.AIR, base, stamp_us, instance, (kelvin, *(math.nan,) * 4))


THERMOMETERS: dict[str, dict[int, Converter]] = {
    "hygrometer": {mavlink.MAVLINK_MSG_ID_HYGROMETER_SENSOR: hygrometer},
    "airspeed": {mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: airspeed_temperature},
    "imu": {mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: imu_temperature},
    "none": {},
}
"""Sources of the air temperature, by the value of ``intake.air_temperature``."""

CONVERTERS: dict[int, Converter] = {
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: scaled_pressure,
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE2: partial(scaled_pressure, instance=1),
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE3: partial(scaled_pressure, instance=2),
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: gps_raw,
    mavlink.MAVLINK_MSG_ID_GPS2_RAW: partial(gps_raw, instance=1),
    mavlink.MAVLINK_MSG_ID_SCALED_IMU: imu_milli_g,
    mavlink.MAVLINK_MSG_ID_SCALED_IMU2: partial(imu_milli_g, instance=1),
    mavlink.MAVLINK_MSG_ID_SCALED_IMU3: partial(imu_milli_g, instance=2),
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


def _inertial(m: Message, accelerometer_scale: float) -> tuple[Any, ...]:
    force = (
        m.xacc * accelerometer_scale,
        m.yacc * accelerometer_scale,
        m.zacc * accelerometer_scale,
    )
    return force, (m.xgyro * 1e-3, m.ygyro * 1e-3, m.zgyro * 1e-3)


def _body_rates(m: Message, x: Arithmetic) -> tuple[Any, Any, Any]:
    return x.finite(m.rollspeed), x.finite(m.pitchspeed), x.finite(m.yawspeed)


def _present(value: Any, scale: float, x: Arithmetic) -> Any:
    """An extension field: 0 means that it was not sent."""
    return x.where(value != 0, value * scale, math.nan)


def _known_u16(value: Any, scale: float, x: Arithmetic) -> Any:
    return x.where(value != UNKNOWN_U16, value * scale, math.nan)


def _dop(value: Any, has_fix: Any, x: Arithmetic) -> Any:
    """Dilution of precision; 0 and 65535 are unknown. 99.99 is hopeless without a fix, and unknown
    beside one: some receivers never fill it in."""
    unknown = (value == 0) | (value == UNKNOWN_U16) | ((value == NO_DOP) & has_fix)
    return x.where(unknown, math.nan, value * 0.01)
