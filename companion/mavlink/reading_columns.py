"""The columns of a message kind -> readings in columns, by the converters of
`companion.mavlink.convert`: the same values as of one message at a time, bit for bit."""

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.mavlink.convert import Converter, Reading, TimeBase
from companion.samples import DTYPES, Kind, Rows, readable

LARGEST_STAMP_US = 1 << 61
"""as of `companion.intake.clock_steps`: a stamp above it is no time"""
UNSAID = "datum_sd_m"
"""field of a fix that no message says"""
Array = NDArray[Any]


class Readings(NamedTuple):
    """Readings of one kind of sample out of the messages of one kind."""

    kind: Kind
    base: TimeBase
    places: Array
    """of each reading's message among the columns, or of its item in a log, shape (n,)"""
    stamp_us: Array
    samples: Rows
    """rows of the kind's dtype with ``instance`` and the values, shape (n,)"""


def singles(columns: Readings) -> Iterator[Reading]:
    """Readings in columns as one after the other."""
    kind, base = columns.kind, columns.base
    names = (columns.samples.dtype.names or ())[3:]
    values = [columns.samples[name].tolist() for name in names if name != UNSAID]
    instances, stamps = columns.samples["instance"].tolist(), columns.stamp_us.tolist()
    for stamp_us, instance, *each in zip(stamps, instances, *values, strict=True):
        yield Reading(kind, base, stamp_us, instance, tuple(each))


class Fields:
    """The columns of a message kind as attributes: floats in double precision."""

    def __init__(self, columns: Array) -> None:
        self._columns = columns

    def __getattr__(self, name: str) -> Array:
        values = self._columns[name]
        if values.dtype.kind == "f":
            return values.astype("f8")
        return values if values.dtype == np.uint64 else values.astype("i8")


class _Some(NamedTuple):
    """A reading of the messages `where` a condition is true."""

    where: Any
    reading: Reading


class Columns:
    """The arithmetic of many messages: `convert.Numbers` for arrays."""

    where = staticmethod(np.where)

    @staticmethod
    def finite(values: Array) -> Array:
        return np.where(np.isfinite(values), values, np.nan)

    @staticmethod
    def each(function: Callable[..., Any], *values: Array, where: Any = True) -> Array:
        """One message at a time: NumPy rounds some functions in its own way."""
        chosen = np.flatnonzero(np.broadcast_to(where, values[0].shape))
        told = [function(*each) for each in zip(*(v[chosen].tolist() for v in values), strict=True)]
        found = np.full((values[0].size, *np.shape(told)[1:]), math.nan)
        found[chosen] = np.reshape(told, (chosen.size, *found.shape[1:]))
        return found.T

    @staticmethod
    def given(condition: Array, reading: Reading) -> tuple[_Some, ...]:
        return (_Some(condition, reading),) if condition.any() else ()


def readings_of(converter: Converter, columns: Array) -> Iterator[Readings]:
    """The readings of the messages in `columns`, a structured array with the fields' names."""
    with np.errstate(invalid="ignore", over="ignore"):  # a signalling NaN, a float near the largest
        found: Any = converter(Fields(columns), Columns)
    for each in found:
        where, reading = each if isinstance(each, _Some) else (True, each)
        yield _rows(reading, np.flatnonzero(np.broadcast_to(where, columns.shape)), columns.size)


def _rows(reading: Reading, chosen: Array, size: int) -> Readings:
    """The rows of a reading of `size` messages, of which some are chosen."""

    def picked(value: Any) -> Any:
        return value[chosen] if chosen.size < size and np.ndim(value) else value

    samples = readable(np.zeros(chosen.size, DTYPES[reading.kind]))
    names = samples.dtype.names or ()
    samples["instance"] = picked(reading.instance)
    for name, value in zip(names[3:], reading.values, strict=False):
        if isinstance(value, tuple):  # a vector
            for axis, part in enumerate(value):
                samples[name][:, axis] = picked(part)
        else:
            samples[name] = picked(value)
    if UNSAID in names:
        samples[UNSAID] = math.nan
    stamps = np.minimum(np.broadcast_to(picked(reading.stamp_us), chosen.shape), LARGEST_STAMP_US)
    return Readings(reading.kind, reading.base, chosen, stamps.astype("i8"), samples)
