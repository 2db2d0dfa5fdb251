"""Clocks of the host, passed as arguments so that tests and replay need no sleeping."""

import time
from typing import Protocol


class Clock(Protocol):
    """The local host's time. Vehicle time is not a clock: it arrives in the samples."""

    def now_us(self) -> int:
        """UNIX microseconds, never going back while the process lives."""
        ...

    def sleep_s(self, duration_s: float) -> None:
        """Wait; a duration of zero or less returns at once."""
        ...


class SystemClock:
    """The monotonic clock, set once to UNIX time, so that a later step of the wall clock (a Pi
    without RTC) has no effect."""

    def __init__(self) -> None:
        self._offset_ns = time.time_ns() - time.monotonic_ns()

    def now_us(self) -> int:
        return (time.monotonic_ns() + self._offset_ns) // 1000

    def sleep_s(self, duration_s: float) -> None:
        if duration_s > 0:
            time.sleep(duration_s)


class ManualClock:
    """A clock that moves only by `advance_s` and `sleep_s`."""

    def __init__(self, now_us: int = 1_700_000_000_000_000) -> None:
        self._now_us = now_us

    def now_us(self) -> int:
        return self._now_us

    def sleep_s(self, duration_s: float) -> None:
        self.advance_s(max(0.0, duration_s))

    def advance_s(self, duration_s: float) -> None:
        self._now_us += round(duration_s * 1e6)
