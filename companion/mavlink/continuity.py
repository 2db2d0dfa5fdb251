"""Heights without steps and leaps.

`Monotonic` joins the standard-atmosphere height across a reboot or a change of barometer. `Leap`
withholds an altitude that leaps further than a vehicle can move, until it comes back or has stayed
there for two seconds. Both are a state record and compiled steps.
"""

import math

import numpy as np

from companion.jit import step
from companion.kernels.atmosphere import baro_altitude_m
from companion.samples import Rows, rows

LEAP_US = 2_000_000
TAKEOVER_S = 2.0
SILENT_US = 2_000_000

MONOTONIC = np.dtype(
    [
        ("altitude_m", "f8"),
        ("offset_m", "f8"),
        ("boots", "i8"),  # of the last pressure; -1 before the first
        ("instance", "i8"),
        ("time_us", "i8"),
    ],
    align=True,
)
LEAP = np.dtype(
    [
        ("has_last", "i8"),
        ("last_us", "i8"),
        ("last_m", "f8"),
        ("has_new", "i8"),
        ("new_us", "i8"),
        ("new_m", "f8"),
        ("since_us", "i8"),
    ],
    align=True,
)


class Monotonic:
    """Height of the standard atmosphere above the first accepted pressure, without steps."""

    def __init__(self) -> None:
        self.state: Rows = rows(MONOTONIC)
        self.state["offset_m"], self.state["boots"] = 0.0, -1

    @property
    def altitude_m(self) -> float:
        """The newest value, however old; NaN before the first."""
        return float(self.state["altitude_m"][0])

    def update(self, boots: int, instance: int, time_us: int, pressure_pa: float) -> bool:
        """Take an accepted pressure, unless it is of another barometer while the one followed is
        alive.

        A reboot, a barometer that takes over from one that fell silent, and a jump of one that
        recovered from a fault are joined to where the altitude was.
        """
        return bool(join(self.state, boots, instance, time_us, pressure_pa))

    def at(self, now_us: int) -> float:
        """The value now: NaN when the last pressure is older than two seconds."""
        return float(monotonic_at(self.state, now_us))


class Leap:
    """Detects an altitude that no vehicle can have reached since the last one."""

    def __init__(self) -> None:
        self.state: Rows = rows(LEAP)

    def withholds(self, time_us: int, altitude_m: float) -> bool:
        """Whether the altitude must wait. A clock that went back starts anew."""
        return bool(withholds(self.state, time_us, altitude_m))


@step
def join(m: Rows, boots: int, instance: int, time_us: int, pressure_pa: float) -> bool:
    """`Monotonic.update` on a MONOTONIC row."""
    elapsed_s = (time_us - m[0].time_us) * 1e-6
    is_same = m[0].boots == boots and m[0].instance == instance
    if m[0].boots == boots and not is_same and elapsed_s <= TAKEOVER_S:
        return False
    baro_m = baro_altitude_m(pressure_pa)
    if math.isnan(m[0].altitude_m):
        m[0].offset_m = -baro_m
    elif not is_same or abs(baro_m + m[0].offset_m - m[0].altitude_m) > _reach_m(
        elapsed_s, TAKEOVER_S
    ):
        m[0].offset_m = m[0].altitude_m - baro_m
    m[0].altitude_m = baro_m + m[0].offset_m
    m[0].boots, m[0].instance, m[0].time_us = boots, instance, time_us
    return True


@step
def monotonic_at(m: Rows, now_us: int) -> float:
    """`Monotonic.at` on a MONOTONIC row."""
    return m[0].altitude_m if abs(now_us - m[0].time_us) <= SILENT_US else math.nan


@step
def _reach_m(elapsed_s: float, longest_s: float) -> float:
    """Largest change of a height between two samples, m; beyond it one of the two is wrong."""
    return 60.0 + 50.0 * min(max(0.0, elapsed_s), longest_s)


@step
def _reaches(start_us: int, start_m: float, time_us: int, altitude_m: float) -> bool:
    return abs(altitude_m - start_m) <= _reach_m((time_us - start_us) * 1e-6, 10.0)


@step
def withholds(leap: Rows, time_us: int, altitude_m: float) -> bool:
    """`Leap.withholds` on a LEAP row."""
    s = leap[0]
    if not s.has_last or time_us < s.last_us or _reaches(s.last_us, s.last_m, time_us, altitude_m):
        s.has_last, s.last_us, s.last_m, s.has_new = 1, time_us, altitude_m, 0
        return False
    if not s.has_new or not _reaches(s.new_us, s.new_m, time_us, altitude_m):
        s.since_us = time_us
    s.has_new, s.new_us, s.new_m = 1, time_us, altitude_m
    if time_us - s.since_us < LEAP_US:
        return True
    s.last_us, s.last_m, s.has_new = time_us, altitude_m, 0
    return False
