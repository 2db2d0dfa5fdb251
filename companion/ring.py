"""A short history of a scalar, so that a late measurement meets the value of its own time.

GNSS heights arrive 50-250 ms old. This is the one place that deals with that; live and replay share it.
A ring is two arrays of one size inside an estimator's state: instants (-1 is empty) and values; the oldest goes first.
"""

import math
from typing import Any

from numpy.typing import NDArray

from companion.jit import step


def ring_fields(name: str, size: int) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """The two state fields ``<name>_us`` and ``<name>_values`` of a ring of `size`."""
    return (f"{name}_us", "i8", (size,)), (f"{name}_values", "f8", (size,))


@step
def clear(times_us: NDArray[Any], values: NDArray[Any]) -> None:
    """Empty the ring."""
    for i in range(times_us.size):
        times_us[i] = -1
        values[i] = math.nan


@step
def push(times_us: NDArray[Any], values: NDArray[Any], time_us: int, value: float) -> None:
    """Add a value at an instant, in place of the oldest."""
    oldest = 0
    for i in range(1, times_us.size):
        if times_us[i] < times_us[oldest]:
            oldest = i
    times_us[oldest] = time_us
    values[oldest] = value


@step
def at(times_us: NDArray[Any], values: NDArray[Any], time_us: int, reach_us: int) -> float:
    """The value at an instant: linear between its neighbours, else the nearest within `reach_us`, else NaN."""
    before, after = -1, -1
    for i in range(times_us.size):
        if times_us[i] < 0:
            continue
        if times_us[i] <= time_us and (before < 0 or times_us[i] > times_us[before]):
            before = i
        if times_us[i] >= time_us and (after < 0 or times_us[i] < times_us[after]):
            after = i
    if before >= 0 and time_us - times_us[before] > reach_us:
        before = -1
    if after >= 0 and times_us[after] - time_us > reach_us:
        after = -1
    if before < 0 and after < 0:
        return math.nan
    if before < 0:
        return values[after]
    if after < 0 or times_us[after] == times_us[before]:
        return values[before]
    fraction = (time_us - times_us[before]) / (times_us[after] - times_us[before])
    return values[before] + fraction * (values[after] - values[before])
