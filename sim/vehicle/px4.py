"""What PX4 streams, at the rates of its mode ONBOARD, as its ``streams/*.hpp`` fill the fields.

Stamps are those of the samples, in microseconds since boot; a sample is sent once. RAW_IMU it does
not know, SCALED_IMU it sends when asked. SCALED_PRESSURE comes at 1 Hz until asked; HIGHRES_IMU
carries the pressure as well. It streams ATTITUDE at 100 Hz and here at 50, the rate of the
simulated motion. The truth, SIM_STATE and that of the air, which PX4 has not, goes to logs and to
who asks.

Departures: HIGHRES_IMU is not corrected by the estimated biases, and the vehicle's own height is
that of ``estimate.py`` (barometric) and not EKF2's.
"""

import math
from collections.abc import Mapping

from sim.constants import G0_MPS2, ZERO_CELSIUS_K
from sim.sensors.barometer import Pressure
from sim.vehicle import ardupilot as common
from sim.vehicle.ardupilot import int16
from sim.vehicle.frames import packer
from sim.vehicle.magnetic_field import field_b_mgauss
from sim.vehicle.own_estimate import isa_altitude_m
from sim.vehicle.stream import Fresh, State, Telemetry
from sim.vehicle.truth import SIM_STATE, TRUE_AIR, sim_state, true_air

_AUTOPILOT_PX4 = 12
_FIXED_WING = 1
_AUTO, _LOITER, _MISSION = 4 << 16, 3 << 24, 4 << 24
"""custom_mode: the main mode, and the sub modes of AUTO"""
_DISARMED, _ARMED = (29, _AUTO | _LOITER, 3), (157, _AUTO | _MISSION, 4)
"""base_mode (custom, auto, guided, stabilised), custom_mode, system_status: Hold on the ground,
then Mission"""
_NEW_US = 20_000
"""age below which a pressure was not in the HIGHRES_IMU before; that comes at 50 Hz"""
_MOTION_BITS, _PRESSURE_BITS = 0x01FF, 0x1E00
_NO_DOP = 9999
"""dilution of precision without a fix, hundredths, as a u-blox reports it"""
STANDARD_QNH_HPA = 1013.25


def heartbeat(state: State) -> bytes:
    base_mode, custom_mode, status = _ARMED if state.armed else _DISARMED
    return _HEARTBEAT.wire(custom_mode, _FIXED_WING, _AUTOPILOT_PX4, base_mode, status, 3)


def baro_altitude_m(state: State, sample: Pressure) -> float:
    """``vehicle_air_data.baro_alt_meter``: the standard atmosphere above the pressure of
    SENS_BARO_QNH."""
    qnh_pa = max(1.0, state.parameters.get("SENS_BARO_QNH", STANDARD_QNH_HPA) * 100.0)
    return isa_altitude_m(max(1.0, sample.pressure_pa), qnh_pa)


def raised_m(parameters: Mapping[str, float], pressure_pa: float) -> float:
    """Offset that SENS_BARO_QNH adds to the altitude at a pressure, m."""
    qnh_hpa = parameters["SENS_BARO_QNH"]
    if qnh_hpa == STANDARD_QNH_HPA:
        return 0.0
    standard = math.pow(max(1.0, pressure_pa) / (STANDARD_QNH_HPA * 100.0), 0.190263)
    chosen = math.pow(max(1.0, pressure_pa) / max(1.0, qnh_hpa * 100.0), 0.190263)
    return 44_330.77 * (standard - chosen)


def highres_imu(state: State) -> bytes | None:
    """SI units and gauss, pressures hPa, with bits for what is new in it."""
    sample, truth, pressure = state.imu, state.truth, state.pressure
    if sample is None or truth is None or pressure is None:
        return None
    north, east, down = field_b_mgauss(truth)
    is_new = sample.time_us - pressure.time_us < _NEW_US
    return _HIGHRES_IMU.wire(
        sample.time_us,
        *sample.specific_force_b_mps2,
        *sample.angular_rate_b_radps,
        north * 1e-3,
        east * 1e-3,
        down * 1e-3,
        pressure.pressure_pa * 0.01,
        _pitot_hpa(truth.airspeed_mps),
        baro_altitude_m(state, pressure),
        pressure.die_temperature_k - ZERO_CELSIUS_K,
        _MOTION_BITS | _PRESSURE_BITS if is_new else _MOTION_BITS,
        0,
    )


def scaled_imu(state: State) -> bytes | None:
    """mG, mrad/s, mGauss."""
    sample, truth = state.imu, state.truth
    if sample is None or truth is None:
        return None
    to_mg = 1000.0 / G0_MPS2
    return _SCALED_IMU.wire(
        sample.time_us // 1000,
        *(int16(force * to_mg) for force in sample.specific_force_b_mps2),
        *(int16(rate * 1000.0) for rate in sample.angular_rate_b_radps),
        *(int16(part) for part in field_b_mgauss(truth)),
        sample.die_temperature_cdegc,
    )


def scaled_pressure(state: State) -> bytes | None:
    """Stamped with the time of the sample."""
    sample, truth = state.pressure, state.truth
    if sample is None or truth is None:
        return None
    die_cdegc = round((sample.die_temperature_k - ZERO_CELSIUS_K) * 100.0)
    time_ms = sample.time_us // 1000
    return _SCALED_PRESSURE.wire(
        time_ms, sample.pressure_pa * 0.01, _pitot_hpa(truth.airspeed_mps), die_cdegc, 0
    )


def gps_raw_int(state: State) -> bytes | None:
    """eph and epv are dilutions times a hundred, metres are in h_acc and v_acc; the time is 0
    before UTC is known."""
    fix = state.fix
    if fix is None:
        return None
    if fix.fix_type < 3:
        return _GPS_RAW_INT.named(fix_type=fix.fix_type, eph=_NO_DOP, epv=_NO_DOP)
    course_deg = math.degrees(math.atan2(fix.east_mps, fix.north_mps)) % 360.0
    return _GPS_RAW_INT.wire(
        fix.stamp_us,
        round(fix.latitude_deg * 1e7),
        round(fix.longitude_deg * 1e7),
        round(fix.altitude_amsl_m * 1e3),
        fix.hdop_centi,
        fix.vdop_centi,
        min(int(math.hypot(fix.north_mps, fix.east_mps) * 100.0), 65534),
        int(course_deg * 100.0),
        fix.fix_type,
        fix.satellites,
        round(fix.altitude_ellipsoid_m * 1e3),
        int(fix.horizontal_sd_m * 1e3),
        int(fix.vertical_sd_m * 1e3),
        int(fix.velocity_sd_mps * 1e3),
        0,
        0,
    )


def altitude(state: State) -> bytes | None:
    """ALTITUDE: NaN is unknown. Before there is an origin, AMSL is the barometer's height."""
    nan = math.nan
    monotonic_m = baro_altitude_m(state, state.pressure) if state.pressure is not None else nan
    position, origin, home = state.position, state.origin, state.home
    if position is None or origin is None:
        amsl_m, local_m, relative_m = monotonic_m, nan, nan
    else:
        amsl_m = position.altitude_amsl_m
        local_m = amsl_m - origin.altitude_amsl_m
        relative_m = amsl_m - home.altitude_amsl_m if home is not None else local_m
    return _ALTITUDE.wire(state.time_us, monotonic_m, amsl_m, local_m, relative_m, nan, nan)


def _pitot_hpa(airspeed_mps: float) -> float:
    return 0.5 * 1.225 * airspeed_mps**2 * 0.01


_HEARTBEAT = packer("HEARTBEAT")
_SYS_STATUS = packer("SYS_STATUS")
_VFR_HUD = packer("VFR_HUD")
_SYSTEM_TIME = packer("SYSTEM_TIME")
_ATTITUDE = packer("ATTITUDE")
_HIGHRES_IMU = packer("HIGHRES_IMU")
_SCALED_IMU = packer("SCALED_IMU")
_SCALED_PRESSURE = packer("SCALED_PRESSURE")
_HYGROMETER_SENSOR = packer("HYGROMETER_SENSOR")
_GPS_RAW_INT = packer("GPS_RAW_INT")
_GLOBAL_POSITION_INT = packer("GLOBAL_POSITION_INT")
_ALTITUDE = packer("ALTITUDE")
_EXTENDED_SYS_STATE = packer("EXTENDED_SYS_STATE")
_HOME_POSITION = packer("HOME_POSITION")
_TIMED = (_HIGHRES_IMU.message_id, _ATTITUDE.message_id)

_TABLE = (
    Telemetry(_HEARTBEAT, heartbeat, 1.0, 1.0),
    Telemetry(_SYS_STATUS, common.sys_status, 5.0, 5.0),
    Telemetry(_SYSTEM_TIME, common.system_time, 1.0, 1.0),
    Telemetry(_SCALED_PRESSURE, scaled_pressure, 1.0, 20.0, fresh=Fresh.PRESSURE),
    Telemetry(_SCALED_IMU, scaled_imu, 0.0, 25.0, fresh=Fresh.IMU),
    Telemetry(_ATTITUDE, common.attitude, 50.0, 50.0, fresh=Fresh.MOTION),
    Telemetry(_HIGHRES_IMU, highres_imu, 50.0, 50.0, fresh=Fresh.IMU),
    Telemetry(SIM_STATE, sim_state, 0.0, 25.0, fresh=Fresh.MOTION, follows=_TIMED),
    Telemetry(_HYGROMETER_SENSOR, common.hygrometer_sensor, 1.0, 1.0),
    Telemetry(_GPS_RAW_INT, gps_raw_int, 50.0, 50.0, fresh=Fresh.FIX),
    Telemetry(_GLOBAL_POSITION_INT, common.global_position_int, 50.0, 50.0, fresh=Fresh.MOTION),
    Telemetry(_ALTITUDE, altitude, 10.0, 10.0),
    Telemetry(_VFR_HUD, common.vfr_hud, 10.0, 10.0),
    Telemetry(_EXTENDED_SYS_STATE, common.extended_sys_state, 5.0, 5.0),
    Telemetry(_HOME_POSITION, common.home_position, 0.5, 0.5),
    Telemetry(TRUE_AIR, true_air, 0.0, 1.0),
)

TELEMETRY: Mapping[int, Telemetry] = {row.packer.message_id: row for row in _TABLE}
