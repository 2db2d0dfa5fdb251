"""A short history of a scalar, so that a late measurement meets the value of its own time.

GNSS heights arrive 50-250 ms old. This is the one place that deals with that; live and replay share
it. A ring is two arrays inside an estimator's state: values, and their instants (-1 is empty) with
one place more, which holds the slot of the next value. Instants are pushed in order, as accepted
samples of one sensor are.
"""

import math
from typing import Any

from numpy.typing import NDArray

from companion.jit import step


def ring_fields(name: str, size: int) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """The two state fields ``<name>_us`` and ``<name>_values`` of a ring of `size` values."""
    return (f"{name}_us", "i8", (size + 1,)), (f"{name}_values", "f8", (size,))


@step
def clear(times_us: NDArray[Any], values: NDArray[Any]) -> None:
    """Empty the ring."""
    for i in range(values.size):
        times_us[i] = -1
        values[i] = math.nan
    times_us[values.size] = 0


@step
def push(times_us: NDArray[Any], values: NDArray[Any], time_us: int, value: float) -> None:
    """Add a value in place of the oldest. `time_us` must be newer than every instant in the
    ring."""
    slot = times_us[values.size]
    times_us[slot] = time_us
    values[slot] = value
    times_us[values.size] = slot + 1 if slot + 1 < values.size else 0


@step
def at(times_us: NDArray[Any], values: NDArray[Any], time_us: int, reach_us: int) -> float:
    """The value at an instant: linear between its neighbours, else the nearest within `reach_us`,
    else NaN."""
    size = values.size
    after, before = (
        -1,
        (times_us[size] + size - 1) % size,
    )  # from the newest backwards: most are hardly late
    for _ in range(size):
        if times_us[before] <= time_us:
            break
        after, before = before, (before + size - 1) % size
    has_before = 0 <= times_us[before] <= time_us and time_us - times_us[before] <= reach_us
    has_after = after >= 0 and times_us[after] - time_us <= reach_us
    if has_before and has_after:
        fraction = (time_us - times_us[before]) / (times_us[after] - times_us[before])
        return values[before] + fraction * (values[after] - values[before])
    if has_before:
        return values[before]
    return values[after] if has_after else math.nan


@step
def shift(values: NDArray[Any], change: float) -> None:
    """Add to every value: a corrected trajectory keeps its shape."""
    for i in range(values.size):
        values[i] += change
