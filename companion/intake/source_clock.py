"""Unit and skew of one message's time stamps beside the vehicle's clock."""

import logging
from collections import deque

logger = logging.getLogger("kollsman.intake")

UNIT_WINDOW_US = 2_000_000
UNIT_RATIO = (500.0, 2000.0)
"""ratio of rates above which time stamps are in another unit than that of their field"""
UNIT_WINDOWS = 2
SECOND_US = 1_000_000
SKEW_US = 500_000
"""largest delay of a receiver, and of a message behind the boot clock"""


class Unit:
    """Tells stamps in microseconds where milliseconds belong, or the reverse."""

    def __init__(self, source: int) -> None:
        self.is_wrong = False
        self._source = source
        self._start: tuple[int, int] | None = None
        self._windows = 0

    def note(self, stamp_us: int, arrival_us: int) -> None:
        """Compare how stamps and arrivals advance, over windows of 2 s."""
        if self._start is None or not self._start[1] <= arrival_us <= self._start[1] + 60_000_000:
            self._start, self._windows = (stamp_us, arrival_us), 0
            return
        elapsed_us = arrival_us - self._start[1]
        if self.is_wrong or elapsed_us < UNIT_WINDOW_US:
            return
        ratio = (stamp_us - self._start[0]) / elapsed_us
        self._start = stamp_us, arrival_us
        fast = UNIT_RATIO[0] < ratio < UNIT_RATIO[1]
        slow = UNIT_RATIO[0] < (1.0 / ratio if ratio > 0.0 else 0.0) < UNIT_RATIO[1]
        self._windows = self._windows + 1 if fast or slow else 0
        if self._windows >= UNIT_WINDOWS:
            self.is_wrong = True
            units = "microseconds in milliseconds" if fast else "milliseconds in microseconds"
            logger.warning("message %d stamps %s: its stamps are not used", self._source, units)


class Skew:
    """The delay or lead that all time stamps of the last seconds have beside the vehicle's clock.

    A receiver's time that was set 1 s ahead and then right again is 1 s behind what was learned.
    """

    def __init__(self) -> None:
        self._seconds: deque[tuple[int, int, int]] = deque(maxlen=3)
        """for each second: its start, the least delay behind now, the least lead on boot stamps
        (both as time minus clock)"""

    def correct(self, time_us: int, now_us: int, boot_us: int) -> int:
        """The time without the part that every stamp of the last 2 to 3 s has in common."""
        seconds, behind_us, ahead_us = self._seconds, time_us - now_us, time_us - boot_us
        if seconds and not 0 <= now_us - seconds[-1][0] <= 2 * SECOND_US:
            seconds.clear()
        if seconds and now_us - seconds[-1][0] < SECOND_US:
            began_us, most_us, least_us = seconds.pop()
            seconds.append((began_us, max(most_us, behind_us), min(least_us, ahead_us)))
        else:
            seconds.append((now_us, behind_us, ahead_us))
        if len(seconds) < 3:
            return time_us
        newest_us = max(second[1] for second in seconds)
        oldest_us = min(second[2] for second in seconds)
        if newest_us < -SKEW_US:
            return time_us - newest_us
        return time_us - oldest_us if oldest_us > SKEW_US else time_us
