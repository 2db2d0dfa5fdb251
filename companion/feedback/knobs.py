"""The parameters that shift an autopilot's barometric altitude, and what must be true of the others
before one is written.

Sources: ArduPilot's parameter reference (BARO_ALT_OFFSET "altitude offset in meters added to
barometric altitude"; EK3_SRC1_POSZ 1 is the barometer), PX4's (SENS_BARO_QNH in hPa, EKF2_HGT_REF 0
is the barometer). MAVLink tells the type of a parameter but not its range: the ranges are those of
the two references, or narrower.
"""

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from companion.mavlink.codec import Message, mavlink

REAL32: int = mavlink.MAV_PARAM_TYPE_REAL32
ARDUPILOT: int = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
PX4: int = mavlink.MAV_AUTOPILOT_PX4
SCALE_M, EXPONENT = 44_330.77, 0.190263
"""constants of the standard troposphere: height = SCALE_M (1 - (p / qnh) ** EXPONENT)"""
_INTEGERS = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<Bxxx",
    mavlink.MAV_PARAM_TYPE_INT8: "<bxxx",
    mavlink.MAV_PARAM_TYPE_UINT16: "<Hxx",
    mavlink.MAV_PARAM_TYPE_INT16: "<hxx",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
}


@dataclass(frozen=True)
class Knob:
    """One parameter that shifts the altitude of one autopilot."""

    autopilot: int
    """MAV_AUTOPILOT of the only autopilot that has it"""
    parameter: str
    lowest: float
    highest: float
    """range of its values, in its own unit"""
    conditions: Mapping[str, tuple[float, str]]
    """parameters that are read first: the value that each must have, and what another one means"""
    raised: Callable[[float, float], float]
    """(original value, metres) -> the value that raises the altitude by so many metres"""
    metres: Callable[[float, float], float]
    """(original value, value) -> by how many metres it raises the altitude"""

    @property
    def names(self) -> tuple[str, ...]:
        """Every parameter to read, that of the knob first."""
        return (self.parameter, *self.conditions)


def _qnh_raised(original: float, metres: float) -> float:
    return float(original * (1.0 - metres / SCALE_M) ** (-1.0 / EXPONENT))


def _qnh_metres(original: float, value: float) -> float:
    """At sea level; a little less above it, by 2.3 % for each kilometre."""
    return float(SCALE_M * (1.0 - (original / value) ** EXPONENT))


KNOBS: Mapping[str, Knob] = {
    "baro-alt-offset": Knob(
        ARDUPILOT,
        "BARO_ALT_OFFSET",
        -200.0,
        200.0,
        {
            "AHRS_EKF_TYPE": (3, "EKF3 is not in use"),
            "EK3_SRC1_POSZ": (1, "height is not the barometer's"),
            "EK3_OGN_HGT_MASK": (0, "EKF3 corrects it by itself"),
        },
        lambda original, metres: original + metres,
        lambda original, value: value - original,
    ),
    "qnh": Knob(
        PX4,
        "SENS_BARO_QNH",
        850.0,
        1100.0,
        {
            "EKF2_HGT_REF": (0, "height is not the barometer's"),
            "EKF2_BARO_CTRL": (1, "the barometer is not used"),
        },
        _qnh_raised,
        _qnh_metres,
    ),
}
"""The parameters, by the value of ``feedback.mode``."""


def parameter_value(message: Message, autopilot: int) -> float:
    """The value in a PARAM_VALUE: PX4 puts the bytes of an integer in the float, ArduPilot its
    value."""
    layout = _INTEGERS.get(message.param_type)
    if autopilot != PX4 or layout is None:
        return float(message.param_value)
    return float(struct.unpack(layout, struct.pack("<f", message.param_value))[0])


def single(value: float) -> float:
    """`value` as a parameter holds it, in single precision."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def same(value: float, other: float) -> bool:
    """Whether a parameter holds what was written, in single precision."""
    return abs(value - other) <= 1e-6 * max(1.0, abs(other))
