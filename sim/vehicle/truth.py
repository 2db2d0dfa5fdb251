"""The messages with the truth: SIM_STATE, ArduPilot's SIMSTATE, and a DEBUG_FLOAT_ARRAY of the air.

None has a time stamp of the vehicle's clock but the last, which goes to logs and to who requests
it.
"""

from math import cos, remainder, sin, tau

from sim.vehicle.frames import packer
from sim.vehicle.stream import State

SIM_STATE = packer("SIM_STATE")
SIMSTATE = packer("SIMSTATE")
TRUE_AIR = packer("DEBUG_FLOAT_ARRAY")
_NAME = b"trueAir"
_UNUSED = (0.0,) * 58


def sim_state(state: State) -> bytes | None:
    """The truth: altitude AMSL, velocity NED, attitude, and the true mean specific force and
    rates."""
    truth, motion = state.truth, state.motion
    if truth is None or motion is None:
        return None
    _, latitude_deg, longitude_deg, altitude_m, north, east, down, roll, pitch, yaw, *_ = truth
    cr, sr = cos(roll / 2), sin(roll / 2)
    cp, sp = cos(pitch / 2), sin(pitch / 2)
    cy, sy = cos(yaw / 2), sin(yaw / 2)
    return SIM_STATE.wire(
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        roll,
        pitch,
        remainder(yaw, tau),
        *motion[0],
        *motion[1],
        latitude_deg,
        longitude_deg,
        altitude_m,
        0.0,
        0.0,
        north,
        east,
        down,
        round(latitude_deg * 1e7),
        round(longitude_deg * 1e7),
    )


def simstate(state: State) -> bytes | None:
    """The truth without its altitude, as ArduPilot SITL streams it."""
    truth, motion = state.truth, state.motion
    if truth is None or motion is None:
        return None
    return SIMSTATE.wire(
        truth.roll_rad,
        truth.pitch_rad,
        remainder(truth.yaw_rad, tau),
        *motion.specific_force_b_mps2,
        *motion.angular_rate_b_radps,
        round(truth.latitude_deg * 1e7),
        round(truth.longitude_deg * 1e7),
    )


def true_air(state: State) -> bytes | None:
    """The truth of the air, in a message that loggers and plotters show: QNH (hPa), the column's
    pressure at sea level (hPa), temperature less the standard one (K), pressure altitude (m), wind
    towards north, east, down (m/s)."""
    if state.truth is None or state.true_air is None:
        return None
    air = state.true_air(state.truth)
    told = [air.qnh_pa * 0.01, air.sea_level_pa * 0.01, *air[2:]]
    return TRUE_AIR.wire(state.truth.time_us, 0, _NAME, *told, *_UNUSED[len(told) :])
