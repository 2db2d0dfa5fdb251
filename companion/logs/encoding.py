"""Items of an autopilot's own log as MAVLink frames, for a telemetry log that ground stations open.

What MAVLink cannot hold is left out: rates finer than a millisecond, vertical GNSS velocity.
"""

import math
from functools import cache

from companion.kernels.atmosphere import G0_MPS2
from companion.mavlink.codec import Encoder, Frame, Message, mavlink
from companion.mavlink.convert import UNKNOWN_U16, ZERO_CELSIUS_K, Reading
from companion.recorded import Height, Item, Throttle
from companion.samples import Kind


@cache
def encoder_of(system_id: int) -> Encoder:
    return Encoder(system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)


def frame_of(item: Item, system_id: int = 1) -> bytes:
    """The bytes of an item as the autopilot of `system_id` would send it; ``b""`` for a reading
    that no message holds."""
    if isinstance(item, Frame):
        return item.data
    if isinstance(item, Throttle):
        return b""
    message = _height(item) if isinstance(item, Height) else _reading(item.reading)
    return encoder_of(system_id).encode(message) if message is not None else b""


def _reading(reading: Reading) -> Message | None:
    boot_ms = reading.stamp_us // 1000 & 0xFFFFFFFF
    values = reading.values
    if reading.kind is Kind.PRESSURE and math.isfinite(values[0]):
        make = (
            mavlink.MAVLink_scaled_pressure_message,
            mavlink.MAVLink_scaled_pressure2_message,
            mavlink.MAVLink_scaled_pressure3_message,
        )[min(reading.instance, 2)]
        die_c = values[1] - ZERO_CELSIUS_K
        return make(boot_ms, values[0] * 0.01, 0.0, _int(die_c * 100, -32768, 32767))
    if reading.kind is Kind.GNSS and reading.instance == 0:
        return _gnss(reading)
    if reading.kind is Kind.ATTITUDE and math.isfinite(values[0]):
        return mavlink.MAVLink_attitude_message(boot_ms, *values[:3], 0.0, 0.0, 0.0)
    if reading.kind is Kind.IMU and reading.instance == 0:
        force = (_int(value / G0_MPS2 * 1e3, -32768, 32767) for value in values[0])
        rate = (_int(value * 1e3, -32768, 32767) for value in values[1])
        return mavlink.MAVLink_raw_imu_message(reading.stamp_us, *force, *rate, 0, 0, 0)
    return None


def _gnss(reading: Reading) -> Message:
    (lat, lon, alt, ellipsoid, speed, course, _, h_sd, v_sd, hdop, vdop, fix, satellites, _) = (
        reading.values
    )
    return mavlink.MAVLink_gps_raw_int_message(
        reading.stamp_us,
        fix,
        _int(lat * 1e7, -(1 << 31), (1 << 31) - 1),
        _int(lon * 1e7, -(1 << 31), (1 << 31) - 1),
        _int(alt * 1e3, -(1 << 31), (1 << 31) - 1),
        _int(hdop * 100, 0, UNKNOWN_U16, UNKNOWN_U16),
        _int(vdop * 100, 0, UNKNOWN_U16, UNKNOWN_U16),
        _int(speed * 100, 0, UNKNOWN_U16, UNKNOWN_U16),
        _int(math.degrees(course) % 360 * 100, 0, 35999, UNKNOWN_U16),
        satellites if 0 <= satellites < 255 else 255,
        _int(ellipsoid * 1e3, -(1 << 31), (1 << 31) - 1),
        _int(h_sd * 1e3, 0, (1 << 32) - 1),
        _int(v_sd * 1e3, 0, (1 << 32) - 1),
        0,
        0,
    )


def _height(height: Height) -> Message:
    climb = height.climb_mps if math.isfinite(height.climb_mps) else 0.0
    if height.is_truth:
        zeros = [0.0] * 13
        return mavlink.MAVLink_sim_state_message(
            *zeros, 0.0, 0.0, height.altitude_amsl_m, 0.0, 0.0, 0.0, 0.0, -climb
        )
    boot_ms = height.time_us // 1000 & 0xFFFFFFFF
    altitude_mm = _int(height.altitude_amsl_m * 1e3, -(1 << 31), (1 << 31) - 1)
    sink = _int(-climb * 100, -32768, 32767)
    return mavlink.MAVLink_global_position_int_message(
        boot_ms, 0, 0, altitude_mm, 0, 0, 0, sink, UNKNOWN_U16
    )


def _int(value: float, lowest: int, highest: int, unknown: int = 0) -> int:
    """Rounded, and held within what the field can hold; `unknown` for NaN."""
    return min(max(round(value), lowest), highest) if math.isfinite(value) else unknown
