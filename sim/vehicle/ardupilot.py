"""The messages that a simulated vehicle streams. One table for each flavour drives streams, default
rates and commands.

Here are what all flavours share, and `TELEMETRY`, ArduPilot's table (PX4's is in ``px4.py``, the
choice of one in ``flavours.py``). Integers and units are ArduPilot's, as measured: RAW_IMU in mG
and mrad/s truncated as its C casts do, GPS_RAW_INT in whole milliseconds and with 65535 for
unknown, SCALED_PRESSURE stamped when sent.
"""

import math
import struct
from collections.abc import Mapping
from functools import cache

from companion.mavlink.codec import mavlink
from sim import BOOT_UNIX_US
from sim.constants import G0_MPS2, ZERO_CELSIUS_K
from sim.vehicle.frames import packer
from sim.vehicle.magnetic_field import field_b_mgauss
from sim.vehicle.stream import Fresh, State, Telemetry
from sim.vehicle.truth import SIM_STATE, SIMSTATE, TRUE_AIR, sim_state, simstate, true_air

MAV_TYPE_FIXED_WING = 1
MAV_AUTOPILOT_ARDUPILOTMEGA = 3
_DISARMED, _ARMED = (81, 0, 3), (217, 10, 4)
"""base_mode, custom_mode, system_status: MANUAL in standby, AUTO armed and active, as ArduPlane 4.7
sends them"""
_UNKNOWN_U16 = 65535
_MG = 1000.0 / G0_MPS2
"""milli-g in one m/s2"""
_MOTION_SENSORS: int = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
)
_PRESSURE_SENSORS: int = (
    mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_DIFFERENTIAL_PRESSURE
)
_RECEIVER: int = mavlink.MAV_SYS_STATUS_SENSOR_GPS
_ESTIMATE: int = mavlink.MAV_SYS_STATUS_AHRS | mavlink.MAV_SYS_STATUS_PREARM_CHECK
_ALL_SENSORS = _MOTION_SENSORS | _PRESSURE_SENSORS | _RECEIVER | _ESTIMATE


def heartbeat(state: State) -> bytes:
    base_mode, custom_mode, status = _ARMED if state.armed else _DISARMED
    return _HEARTBEAT.wire(
        custom_mode, MAV_TYPE_FIXED_WING, MAV_AUTOPILOT_ARDUPILOTMEGA, base_mode, status, 3
    )


def system_time(state: State) -> bytes:
    known = state.fix is not None and state.fix.fix_type >= 3
    return _SYSTEM_TIME.wire(BOOT_UNIX_US + state.time_us if known else 0, state.time_us // 1000)


def raw_imu(state: State) -> bytes | None:
    sample, truth = state.imu, state.truth
    if sample is None or truth is None:
        return None
    _, (x, y, z), (p, q, r), die_cdegc = sample
    ahead, right, below = field_b_mgauss(truth)
    try:
        return _RAW_IMU.wire(
            state.time_us,
            int(x * _MG), int(y * _MG), int(z * _MG),
            int(p * 1000.0), int(q * 1000.0), int(r * 1000.0),
            int(ahead), int(right), int(below),
            0,
            die_cdegc,
        )  # fmt: skip
    except (struct.error, OverflowError):  # beyond the range of the fields
        motion = (x * _MG, y * _MG, z * _MG, p * 1000.0, q * 1000.0, r * 1000.0)
        values = (*motion, ahead, right, below)
        return _RAW_IMU.wire(state.time_us, *map(int16, values), 0, die_cdegc)


def scaled_pressure(state: State) -> bytes | None:
    """As ArduPilot sends it: stamped when sent, and repeated when it is requested more often than
    the barometer measures."""
    sample, truth = state.pressure, state.truth
    if sample is None or truth is None:
        return None
    pitot_hpa = 0.5 * 1.225 * truth.airspeed_mps**2 * 0.01
    die_cdegc = round((sample.die_temperature_k - ZERO_CELSIUS_K) * 100.0)
    return _SCALED_PRESSURE.wire(
        state.time_us // 1000, sample.pressure_pa * 0.01, pitot_hpa, die_cdegc, 0
    )


def hygrometer_sensor(state: State) -> bytes | None:
    """The probe in the air, if one is fitted; its humidity is unknown."""
    if math.isnan(state.air_temperature_k):
        return None
    cdegc = round((state.air_temperature_k - ZERO_CELSIUS_K) * 100.0)
    return _HYGROMETER_SENSOR.named(id=0, temperature=cdegc, humidity=_UNKNOWN_U16)


def gps_raw_int(state: State) -> bytes | None:
    fix = state.fix
    if fix is None:
        return None
    if fix.fix_type < 3:
        unknown = {"eph": _UNKNOWN_U16, "epv": _UNKNOWN_U16, "cog": _UNKNOWN_U16}
        return _GPS_RAW_INT.named(fix_type=fix.fix_type, **unknown)
    speed = math.hypot(fix.north_mps, fix.east_mps)
    course_deg = math.degrees(math.atan2(fix.east_mps, fix.north_mps)) % 360.0
    return _GPS_RAW_INT.wire(
        fix.stamp_us // 1000 * 1000,
        round(fix.latitude_deg * 1e7),
        round(fix.longitude_deg * 1e7),
        round(fix.altitude_amsl_m * 1e3),
        fix.hdop_centi,
        fix.vdop_centi,
        min(round(speed * 100.0), _UNKNOWN_U16 - 1),
        round(course_deg * 100.0) % 36000,
        fix.fix_type,
        fix.satellites,
        round(fix.altitude_ellipsoid_m * 1e3),
        round(fix.horizontal_sd_m * 1e3),
        round(fix.vertical_sd_m * 1e3),
        round(fix.velocity_sd_mps * 1e3),
        0,
        0,
    )


def attitude(state: State) -> bytes | None:
    truth = state.truth
    if truth is None:
        return None
    rates = (truth.roll_rate_radps, truth.pitch_rate_radps, truth.yaw_rate_radps)
    return _ATTITUDE.wire(state.time_us // 1000, *state.attitude_rad, *rates)


def global_position_int(state: State) -> bytes | None:
    """None until there is an origin; ArduPilot sends positions near 0, 0 until then."""
    position = state.position
    if position is None:
        return None
    home_m = state.home.altitude_amsl_m if state.home else position.altitude_amsl_m
    return _GLOBAL_POSITION_INT.wire(
        state.time_us // 1000,
        round(position.latitude_deg * 1e7),
        round(position.longitude_deg * 1e7),
        round(position.altitude_amsl_m * 1e3),
        round((position.altitude_amsl_m - home_m) * 1e3),
        int16(position.north_mps * 100.0),
        int16(position.east_mps * 100.0),
        int16(-position.climb_mps * 100.0),
        round(math.degrees(state.attitude_rad[2]) * 100.0) % 36000,
    )


def vfr_hud(state: State) -> bytes | None:
    """Airspeed (calibrated), height (AMSL) and climb of the vehicle's own estimate."""
    truth, position = state.truth, state.position
    if truth is None:
        return None
    ground_mps = math.hypot(position.north_mps, position.east_mps) if position else 0.0
    return _VFR_HUD.wire(
        truth.airspeed_mps,
        ground_mps,
        position.altitude_amsl_m if position else 0.0,
        position.climb_mps if position else 0.0,
        round(math.degrees(state.attitude_rad[2])) % 360,
        round(100.0 * state.throttle),
    )


def sys_status(state: State) -> bytes:
    """The sensors and their health: the receiver is healthy from its first 3D fix on, the estimate
    from its origin on.

    There is no battery: voltage, current and charge are unknown."""
    healthy = _MOTION_SENSORS
    if state.pressure is not None:
        healthy |= _PRESSURE_SENSORS
    if state.fix is not None and state.fix.fix_type >= 3:
        healthy |= _RECEIVER
    if state.position is not None:
        healthy |= _ESTIMATE
    return _sys_status(healthy)


@cache
def _sys_status(healthy: int) -> bytes:
    return _SYS_STATUS.named(
        onboard_control_sensors_present=_ALL_SENSORS,
        onboard_control_sensors_enabled=_ALL_SENSORS,
        onboard_control_sensors_health=healthy,
        voltage_battery=_UNKNOWN_U16,
        current_battery=-1,
        battery_remaining=-1,
    )


def extended_sys_state(state: State) -> bytes | None:
    if state.truth is None:
        return None
    return _EXTENDED_SYS_STATE.wire(0, 1 if state.truth.on_ground else 2)


def home_position(state: State) -> bytes | None:
    home = state.home
    if home is None:
        return None
    return _HOME_POSITION.named(
        latitude=round(home.latitude_deg * 1e7),
        longitude=round(home.longitude_deg * 1e7),
        altitude=round(home.altitude_amsl_m * 1e3),
        q=[math.nan] * 4,
        time_usec=state.time_us,
    )


def highres_imu(state: State) -> bytes | None:
    """ArduPilot's, with the magnetic field a thousand times too large, ``diff_pressure`` the
    difference from the ground's pressure, and ``pressure_alt`` the estimate above sea level."""
    sample, truth, pressure = state.imu, state.truth, state.pressure
    if sample is None or truth is None or pressure is None:
        return None
    return _HIGHRES_IMU.wire(
        state.time_us,
        *sample.specific_force_b_mps2,
        *sample.angular_rate_b_radps,
        *field_b_mgauss(truth),
        pressure.pressure_pa * 0.01,
        (pressure.pressure_pa - state.ground_pressure_pa) * 0.01,
        state.position.altitude_amsl_m if state.position else 0.0,
        pressure.die_temperature_k - ZERO_CELSIUS_K,
        0x1FFF,
        0,
    )


def int16(value: float) -> int:
    """`value` without its fraction, no further than the type reaches."""
    return int(value) if -32768.0 <= value <= 32767.0 else 32767 if value > 0.0 else -32768


_HEARTBEAT = packer("HEARTBEAT")
_SYS_STATUS = packer("SYS_STATUS")
_VFR_HUD = packer("VFR_HUD")
_SYSTEM_TIME = packer("SYSTEM_TIME")
_ATTITUDE = packer("ATTITUDE")
_RAW_IMU = packer("RAW_IMU")
_HIGHRES_IMU = packer("HIGHRES_IMU")
_SCALED_PRESSURE = packer("SCALED_PRESSURE")
_HYGROMETER_SENSOR = packer("HYGROMETER_SENSOR")
_GPS_RAW_INT = packer("GPS_RAW_INT")
_GLOBAL_POSITION_INT = packer("GLOBAL_POSITION_INT")
_EXTENDED_SYS_STATE = packer("EXTENDED_SYS_STATE")
_HOME_POSITION = packer("HOME_POSITION")
_RAW_SENSORS, _EXTENDED_STATUS, _POSITION, _EXTRA1, _EXTRA2, _EXTRA3 = 1, 2, 6, 10, 11, 12

# In the order in which they are sent within a tick. SIM_STATE at 25 Hz: linear interpolation over
# 40 ms misses a turbulent 2 m/s2 by 0.4 mm, as much as the float32 it travels in, and every second
# RAW_IMU has its own attitude.
_TABLE = (
    Telemetry(_HEARTBEAT, heartbeat, 1.0, 1.0),
    Telemetry(_SYS_STATUS, sys_status, 1.0, 1.0, _EXTENDED_STATUS),
    Telemetry(_SYSTEM_TIME, system_time, 1.0, 1.0, _EXTRA3),
    Telemetry(_ATTITUDE, attitude, 1.0, 10.0, _EXTRA1, Fresh.MOTION),
    Telemetry(_RAW_IMU, raw_imu, 1.0, 50.0, _RAW_SENSORS, Fresh.MOTION),
    Telemetry(
        SIM_STATE,
        sim_state,
        1.0,
        25.0,
        _EXTRA1,
        Fresh.MOTION,
        (_RAW_IMU.message_id, _ATTITUDE.message_id),
    ),
    Telemetry(SIMSTATE, simstate, 0.0, 0.0, _EXTRA1, Fresh.MOTION),
    Telemetry(_SCALED_PRESSURE, scaled_pressure, 1.0, 20.0, _RAW_SENSORS),
    Telemetry(_HYGROMETER_SENSOR, hygrometer_sensor, 1.0, 1.0, _EXTRA3),
    Telemetry(_GPS_RAW_INT, gps_raw_int, 1.0, 5.0, _EXTENDED_STATUS, Fresh.FIX),
    Telemetry(_GLOBAL_POSITION_INT, global_position_int, 1.0, 10.0, _POSITION, Fresh.MOTION),
    Telemetry(_VFR_HUD, vfr_hud, 1.0, 1.0, _EXTRA2),
    Telemetry(_EXTENDED_SYS_STATE, extended_sys_state, 1.0, 1.0, _EXTENDED_STATUS),
    Telemetry(_HOME_POSITION, home_position, 0.2, 0.2),
    Telemetry(_HIGHRES_IMU, highres_imu, 0.0, 0.0),
    Telemetry(TRUE_AIR, true_air, 0.0, 1.0),
)

TELEMETRY: Mapping[int, Telemetry] = {row.packer.message_id: row for row in _TABLE}
HYGROMETER_ID = _HYGROMETER_SENSOR.message_id
NAMES: Mapping[str, int] = {row.packer.name: row.packer.message_id for row in _TABLE}
