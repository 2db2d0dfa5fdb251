"""Interpolation between the points that a scenario or a station gives."""

import bisect
from collections.abc import Sequence


class Ramp:
    """A piecewise-linear function of time, constant outside its points."""

    def __init__(self, points: Sequence[tuple[float, float]], default: float) -> None:
        self._times = [time for time, _ in points] or [0.0]
        self._values = [value for _, value in points] or [default]
        self.constant = len(set(self._values)) == 1
        """whether the value is the same at all times"""

    def __call__(self, time_s: float) -> float:
        after = bisect.bisect_right(self._times, time_s)
        if after == 0:
            return self._values[0]
        if after == len(self._times):
            return self._values[-1]
        start, end = self._times[after - 1], self._times[after]
        share = (time_s - start) / (end - start)
        return self._values[after - 1] + share * (self._values[after] - self._values[after - 1])
