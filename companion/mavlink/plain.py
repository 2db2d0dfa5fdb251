"""Plain messages: those at a high rate, whose values are fields times a scale.

How each becomes a sample is traced from its converter (`companion.mavlink.convert`), called once
with symbols in place of numbers; where the fields are in the payload comes from pymavlink's
dialect. The compiled steps that follow such a plan are in `companion.mavlink.plain_steps`.
"""

from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.intake.vehicle_clock import BASES
from companion.mavlink.codec import mavlink
from companion.mavlink.columns import wire_dtype
from companion.mavlink.convert import CONVERTERS, Converter, Reading, raw_imu
from companion.mavlink.framing import CRC_EXTRA
from companion.mavlink.imu import ImuSelector
from companion.mavlink.plain_steps import FLOAT, IDS, PLAN, SIGNED, UNSIGNED
from companion.samples import Record, Rows, rows

RAW_IMU = mavlink.MAVLINK_MSG_ID_RAW_IMU
PLAIN: tuple[int, ...] = (
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE,
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE2,
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE3,
    mavlink.MAVLINK_MSG_ID_SCALED_IMU,
    mavlink.MAVLINK_MSG_ID_SCALED_IMU2,
    mavlink.MAVLINK_MSG_ID_SCALED_IMU3,
    mavlink.MAVLINK_MSG_ID_ATTITUDE,
    RAW_IMU,
)
FORMS = {"u": UNSIGNED, "i": SIGNED, "f": FLOAT}


class _Term(NamedTuple):
    """A field times a scale plus an offset; as a condition, that the field is neither 0 nor
    infinite."""

    field: str
    scale: float = 1.0
    offset: float = 0.0

    def __mul__(self, scale: float) -> "_Term":  # type: ignore[override]
        if self.scale != 1.0 or self.offset:
            raise TypeError(f"{self} is scaled twice")
        return self._replace(scale=scale)

    def __add__(self, offset: float) -> "_Term":  # type: ignore[override]
        return self._replace(offset=offset)

    def __ne__(self, _: object) -> Any:
        return self

    def __lt__(self, _: object) -> Any:
        return self

    def __and__(self, _: object) -> "_Term":
        return self

    def __abs__(self) -> "_Term":
        return self


class _Symbols:
    """The fields of a message as terms."""

    def __getattr__(self, name: str) -> _Term:
        return _Term(name)


class _Tracing:
    """The arithmetic of terms (`convert.Numbers`): all that is left out is that what is not finite
    is NaN, and a second sample."""

    @staticmethod
    def finite(value: _Term) -> _Term:
        return value

    @staticmethod
    def each(_: Any, value: _Term, *, where: Any) -> _Term:
        return value

    @staticmethod
    def given(condition: _Term, _: Reading) -> tuple[_Term, ...]:
        return (condition,)


def plans(
    raw_imu_scale: float | None, without: Collection[int] = ()
) -> tuple[NDArray[np.int64], Rows]:
    """The place of each message's plan by its id, -1 for none, and the plans, `PLAN` rows.

    `raw_imu_scale` is that of the forces in RAW_IMU, None while it is not known; `without` are the
    ids of messages that have to be taken in another way.
    """
    places, found = np.full(IDS, -1, np.int64), rows(PLAN, len(PLAIN))
    for place, message_id in enumerate(PLAIN):
        if message_id in without or (message_id == RAW_IMU and raw_imu_scale is None):
            continue
        scale = raw_imu_scale or 0.0
        converter = CONVERTERS.get(message_id, lambda m, _, scale=scale: raw_imu(m, scale))
        _fill(found[place], message_id, converter)
        places[message_id] = place
    return places, found


def _fill(plan: Record, message_id: int, converter: Converter) -> None:
    found: Any = converter(_Symbols(), _Tracing)
    reading, second, wire = found[0], found[1:], wire_dtype(message_id)
    plan["message_id"], plan["crc_extra"] = message_id, CRC_EXTRA[message_id]
    plan["kind"], plan["instance"] = reading.kind, reading.instance
    plan["rank"] = ImuSelector.rank(message_id, reading.instance)
    plan["counts_from"], plan["stamp_us"] = BASES[reading.base], reading.stamp_us.scale
    plan["stamp"] = _field(wire, reading.stamp_us)
    plan["zero"] = _field(wire, second[0]) if second else (0, 0, 0)
    terms = _terms(reading.values)
    plan["count"] = len(terms)
    for k, term in enumerate(terms):
        plan["fields"][k] = _field(wire, term)
        plan["scales"][k], plan["offsets"][k] = term.scale, term.offset


def _terms(values: Any) -> list[_Term]:
    """The terms among values and vectors, in their order."""
    if isinstance(values, _Term):
        return [values]
    return [term for each in values for term in _terms(each)] if isinstance(values, tuple) else []


def _field(wire: Any, term: _Term) -> tuple[int, int, int]:
    """A `plain_steps.FIELD` row."""
    dtype, at = wire.fields[term.field][:2]
    return at, dtype.itemsize, FORMS[dtype.kind]
