"""Plain messages: those that arrive at a high rate, whose values are fields times a scale.

`PLAIN` says how each becomes a sample, as `companion.mavlink.convert` does (a test holds the two
equal); where the fields are in the payload comes from pymavlink's dialect. The compiled steps that
read them are in `companion.mavlink.plain_steps`.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.intake.clock_steps import BOOT, EITHER
from companion.kernels.atmosphere import G0_MPS2
from companion.mavlink.codec import mavlink
from companion.mavlink.columns import wire_dtype
from companion.mavlink.convert import ZERO_CELSIUS_K
from companion.mavlink.framing import CRC_EXTRA
from companion.mavlink.imu import ImuSelector
from companion.mavlink.plain_steps import FLOAT, IDS, PLAN, SIGNED, UNSIGNED
from companion.samples import Kind, Record, Rows, rows

FORMS = {"u": UNSIGNED, "i": SIGNED, "f": FLOAT}
UNITS = {"time_boot_ms": (BOOT, 1000), "time_usec": (EITHER, 1)}
"""what a stamp counts from, and its unit in microseconds"""


class Plain(NamedTuple):
    """How a message becomes a sample."""

    kind: Kind
    stamp: str
    instance: int
    values: tuple[tuple[str, float, float], ...]
    """field, scale and offset of each value of the sample, in its order"""
    zero: str = ""
    """a field that is 0 or not finite where the message holds one sample alone"""


def _pressure(instance: int) -> Plain:
    values = (("press_abs", 100.0, 0.0), ("temperature", 0.01, ZERO_CELSIUS_K))
    return Plain(Kind.PRESSURE, "time_boot_ms", instance, values, "" if instance else "press_diff")


def _imu(stamp: str, instance: int, force_scale: float) -> Plain:
    forces = tuple((name, force_scale, 0.0) for name in ("xacc", "yacc", "zacc"))
    rates = tuple((name, 1e-3, 0.0) for name in ("xgyro", "ygyro", "zgyro"))
    return Plain(Kind.IMU, stamp, instance, forces + rates)


ANGLES = ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")
PLAIN: dict[int, Plain] = {
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: _pressure(0),
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE2: _pressure(1),
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE3: _pressure(2),
    mavlink.MAVLINK_MSG_ID_SCALED_IMU: _imu("time_boot_ms", 0, 1e-3 * G0_MPS2),
    mavlink.MAVLINK_MSG_ID_SCALED_IMU2: _imu("time_boot_ms", 1, 1e-3 * G0_MPS2),
    mavlink.MAVLINK_MSG_ID_SCALED_IMU3: _imu("time_boot_ms", 2, 1e-3 * G0_MPS2),
    mavlink.MAVLINK_MSG_ID_RAW_IMU: _imu("time_usec", 0, 1.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE: Plain(
        Kind.ATTITUDE, "time_boot_ms", 0, tuple((name, 1.0, 0.0) for name in ANGLES)
    ),
}
"""The scale of RAW_IMU is the autopilot's choice (`companion.mavlink.imu`)."""


def plans(raw_imu_scale: float | None, without: set[int]) -> tuple[NDArray[np.int64], Rows]:
    """The place of each message's plan by its id, -1 for none, and the plans, `PLAN` rows.

    `raw_imu_scale` is that of the forces in RAW_IMU, None while it is not known; `without` are the
    ids of messages that have to be taken in another way.
    """
    places, found = np.full(IDS, -1, np.int64), rows(PLAN, len(PLAIN))
    for place, (message_id, plain) in enumerate(PLAIN.items()):
        _fill(found[place], message_id, plain)
        if message_id not in without:
            places[message_id] = place
        if message_id != mavlink.MAVLINK_MSG_ID_RAW_IMU:
            continue
        found[place]["scales"][:3] = raw_imu_scale or 0.0
        if raw_imu_scale is None:
            places[message_id] = -1
    return places, found


def _fill(plan: Record, message_id: int, plain: Plain) -> None:
    fields: Any = wire_dtype(message_id)
    plan["message_id"], plan["crc_extra"] = message_id, CRC_EXTRA[message_id]
    plan["kind"], plan["instance"] = plain.kind, plain.instance
    plan["rank"] = ImuSelector.rank(message_id, plain.instance)
    plan["base"], plan["stamp_us"] = UNITS[plain.stamp]
    plan["stamp"] = _field(fields, plain.stamp)
    plan["zero"] = _field(fields, plain.zero) if plain.zero else (0, 0, 0)
    plan["count"] = len(plain.values)
    for k, (name, scale, offset) in enumerate(plain.values):
        plan["fields"][k] = _field(fields, name)
        plan["scales"][k], plan["offsets"][k] = scale, offset


def _field(wire: np.dtype[Any], name: str) -> tuple[int, int, int]:
    """A `plain_steps.FIELD` row."""
    dtype, at = (wire.fields or {})[name][:2]
    return at, dtype.itemsize, FORMS[dtype.kind]
