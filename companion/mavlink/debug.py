"""The DEBUG family: NAMED_VALUE_FLOAT, DEBUG, DEBUG_VECT and DEBUG_FLOAT_ARRAY.

`NAMED` is the table that makes the messages and a part of docs/messages.md.
"""

import math
import struct
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from companion.health import Health
from companion.mavlink.codec import Message, mavlink
from companion.samples import Rows

LARGEST_FLOAT = 3.4028234e38
FLOAT_ARRAY_SIZE = 58
LONGEST_ARRAY = 16
"""Longest array of a state that klState shows: histories are longer."""


class Named(NamedTuple):
    """A NAMED_VALUE_FLOAT."""

    unit: str
    meaning: str
    value: Callable[[Any, float], float]
    """value from an ESTIMATE record and the altimeter setting in hPa"""


NAMED: Mapping[str, Named] = {
    "klAltSd": Named(
        "m", "standard deviation of the altitude", lambda e, _: float(e["altitude_sd_m"])
    ),
    "klVpl": Named(
        "m",
        "protection level of the altitude; NaN where the estimator has none",
        lambda e, _: float(e["protection_level_m"]),
    ),
    "klClimb": Named("m/s", "climb rate, up-positive", lambda e, _: float(e["climb_mps"])),
    "klBaroOff": Named(
        "m",
        "altitude minus that of the barometer in a standard atmosphere",
        lambda e, _: float(e["baro_offset_m"]),
    ),
    "klQnhHpa": Named(
        "hPa", "altimeter setting that makes the barometer show the altitude", lambda _, qnh: qnh
    ),
    "klFaulty": Named(
        "",
        "excluded sensor: 0 none, 1 barometer, 2 GNSS height, 3 IMU",
        lambda e, _: float(e["faulty"]),
    ),
}
HEALTH_NAME = "klHealth"


def debug_messages(
    now_us: int, health: Health, estimate: Rows, floats: list[float], qnh_hpa: float
) -> list[Message]:
    """One of each; in LOST only the health. `floats` are those of the state (`state_floats`)."""
    boot_ms = now_us // 1000 & 0xFFFFFFFF
    messages: list[Message] = [_named(boot_ms, HEALTH_NAME, int(health))]
    if health is Health.LOST:
        return messages
    value = estimate[0]
    sd_m, climb_mps = float(value["altitude_sd_m"]), float(value["climb_mps"])
    floats = [*floats[:-1], _single(float(value["protection_level_m"]))]
    messages += [_named(boot_ms, name, row.value(value, qnh_hpa)) for name, row in NAMED.items()]
    return [
        *messages,
        mavlink.MAVLink_debug_message(boot_ms, 0, _single(sd_m)),
        mavlink.MAVLink_debug_vect_message(
            b"kollsman", now_us, float(value["altitude_amsl_m"]), _single(climb_mps), _single(sd_m)
        ),
        mavlink.MAVLink_debug_float_array_message(now_us, b"klState", 0, floats),
    ]


def state_floats(state: Rows) -> list[float]:
    """The floats of an estimator's state in the order of its dtype, histories left out; 58 of them,
    zero-filled."""
    layout, filling = _layout(state.dtype)
    values = layout.unpack_from(state.tobytes())
    return [*map(_single, values), *filling]


@cache
def _layout(state: np.dtype[Any]) -> tuple[struct.Struct, list[float]]:
    """Where the floats are in the bytes of a state, and the zeros behind them."""
    text, at = "=", 0
    floats = _floats(state)[:FLOAT_ARRAY_SIZE]
    for kind, offset in floats:
        text, at = f"{text}{offset - at}x{kind.char}", offset + kind.itemsize
    return struct.Struct(text), [0.0] * (FLOAT_ARRAY_SIZE - len(floats))


def _floats(state: np.dtype[Any], start: int = 0) -> list[tuple[np.dtype[Any], int]]:
    """Type and offset of the floats and of the elements of short arrays of floats of a record,
    those of nested records in their place."""
    found: list[tuple[np.dtype[Any], int]] = []
    for kind, offset, *_ in (state.fields or {}).values():
        base, first = kind.base, start + offset
        if base.kind == "V":
            found += _floats(base, first)
        elif _is_shown(kind):
            found += [(base, first + base.itemsize * k) for k in range(math.prod(kind.shape))]
    return found


def state_labels(state: np.dtype[Any], prefix: str = "") -> list[str]:
    """The name of each float of `state_floats`, before its filling with zeros."""
    found: list[str] = []
    for name, (kind, *_) in (state.fields or {}).items():
        label = f"{prefix}{name}"
        if kind.base.kind == "V":
            found += state_labels(kind.base, f"{label}.")
        elif _is_shown(kind) and kind.shape:
            found += [f"{label}[{', '.join(map(str, at))}]" for at in np.ndindex(kind.shape)]
        elif _is_shown(kind):
            found.append(label)
    return found


def _is_shown(kind: np.dtype[Any]) -> bool:
    return kind.base.kind == "f" and (not kind.shape or kind.shape[0] <= LONGEST_ARRAY)


def _single(value: float) -> float:
    """A float that a message can hold: what is too large for single precision is infinite."""
    return (
        value
        if math.isnan(value) or abs(value) <= LARGEST_FLOAT
        else math.copysign(math.inf, value)
    )


def _named(boot_ms: int, name: str, value: float) -> Message:
    return mavlink.MAVLink_named_value_float_message(boot_ms, name.encode(), _single(value))
