"""Heights without steps and leaps.

`Monotonic` joins the standard-atmosphere height across a reboot or a change of barometer. `Leap`
withholds an altitude that leaps further than a vehicle can move, until it comes back or has stayed
there for two seconds.
"""

import math

from companion.kernels.atmosphere import baro_altitude_m

LEAP_US = 2_000_000
TAKEOVER_S = 2.0
SILENT_US = 2_000_000


class Monotonic:
    """Height of the standard atmosphere above the first accepted pressure, without steps."""

    def __init__(self) -> None:
        self.altitude_m = math.nan
        self._offset_m = 0.0
        self._source: tuple[int, int] | None = None
        self._time_us = 0

    def update(self, boots: int, instance: int, time_us: int, pressure_pa: float) -> bool:
        """Take an accepted pressure, unless it is of another barometer while the one followed is
        alive.

        A reboot, a barometer that takes over from one that fell silent, and a jump of one that
        recovered from a fault are joined to where the altitude was.
        """
        source, elapsed_s = (boots, instance), (time_us - self._time_us) * 1e-6
        is_other = (
            self._source is not None and self._source[0] == boots and self._source[1] != instance
        )
        if is_other and elapsed_s <= TAKEOVER_S:
            return False
        baro_m = baro_altitude_m(pressure_pa)
        if math.isnan(self.altitude_m):
            self._offset_m = -baro_m
        elif source != self._source or abs(baro_m + self._offset_m - self.altitude_m) > _reach_m(
            elapsed_s, TAKEOVER_S
        ):
            self._offset_m = self.altitude_m - baro_m
        self.altitude_m = baro_m + self._offset_m
        self._source, self._time_us = source, time_us
        return True

    def at(self, now_us: int) -> float:
        """The value now: NaN when the last pressure is older than two seconds."""
        return self.altitude_m if abs(now_us - self._time_us) <= SILENT_US else math.nan


def _reach_m(elapsed_s: float, longest_s: float) -> float:
    """Largest change of a height between two samples, m; beyond it one of the two is wrong."""
    return 60.0 + 50.0 * min(max(0.0, elapsed_s), longest_s)


class Leap:
    """Detects an altitude that no vehicle can have reached since the last one."""

    def __init__(self) -> None:
        self._last: tuple[int, float] | None = None
        self._new: tuple[int, float] | None = None
        self._since_us = 0

    def withholds(self, time_us: int, altitude_m: float) -> bool:
        """Whether the altitude must wait. A clock that went back starts anew."""
        last = self._last
        if last is None or time_us < last[0] or self._reaches(last, time_us, altitude_m):
            self._last, self._new = (time_us, altitude_m), None
            return False
        new = self._new
        if new is None or not self._reaches(new, time_us, altitude_m):
            self._since_us = time_us
        self._new = (time_us, altitude_m)
        if time_us - self._since_us < LEAP_US:
            return True
        self._last, self._new = self._new, None
        return False

    @staticmethod
    def _reaches(start: tuple[int, float], time_us: int, altitude_m: float) -> bool:
        return abs(altitude_m - start[1]) <= _reach_m((time_us - start[0]) * 1e-6, 10.0)
