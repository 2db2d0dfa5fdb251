"""TIMESYNC: how far the vehicle's clock is from ours, and so how old its telemetry is on arrival.

We ask with our clock (``ts1``); the vehicle answers with it and its own (``tc1``). With the same
delay both ways the vehicle's clock was read in the middle of the round trip. Of the last answers
the one with the shortest round trip is used: it errs by half of that at most (Cristian, 1989).
Estimates do not use it: they take the vehicle's clock alone.
"""

import math
from collections import deque

from companion.mavlink.codec import Message, mavlink

FIRST, FIRST_PERIOD_US, PERIOD_US = 5, 500_000, 5_000_000
KEPT = 12
LONGEST_US = 10_000_000
JUMP_US = 500_000
"""An answer that contradicts the others by more than this and half its round trip: the vehicle's
clock restarted."""


class TimeSync:
    """Our requests, and what the answers say."""

    def __init__(self) -> None:
        self.asked = 0
        self.answered = 0
        self._due_us: int | None = None
        self._pending: deque[int] = deque(maxlen=4)
        self._rounds: deque[tuple[int, int]] = deque(maxlen=KEPT)
        """(round trip, vehicle's clock minus ours), us"""

    def poll(self, now_us: int) -> Message | None:
        """The request to send now, if one is due."""
        if self._due_us is not None and now_us < self._due_us:
            return None
        period_us = FIRST_PERIOD_US if self.asked < FIRST else PERIOD_US
        self._due_us = now_us + period_us
        self.asked += 1
        self._pending.append(now_us)
        return mavlink.MAVLink_timesync_message(0, now_us * 1000)

    def take(self, message: Message, now_us: int) -> None:
        """An answer of the vehicle; one to somebody else's request is ignored."""
        asked_us, rest = divmod(message.ts1, 1000)
        if rest or message.tc1 <= 0 or asked_us not in self._pending:
            return
        self._pending.remove(asked_us)
        round_us = now_us - asked_us
        if not 0 <= round_us <= LONGEST_US:
            return
        offset_us = message.tc1 // 1000 - (asked_us + now_us) // 2
        best = self._best
        if best is not None and abs(offset_us - best[1]) > JUMP_US + (round_us + best[0]) // 2:
            self._rounds.clear()
        self.answered += 1
        self._rounds.append((round_us, offset_us))

    @property
    def _best(self) -> tuple[int, int] | None:
        return min(self._rounds, default=None)

    @property
    def round_trip_s(self) -> float:
        """The shortest lately; NaN before the first answer."""
        best = self._best
        return math.nan if best is None else best[0] * 1e-6

    def age_s(self, now_us: int, vehicle_us: int) -> float:
        """How old a time of the vehicle's boot clock is at `now_us`; NaN where not known."""
        best = self._best
        return (
            math.nan if best is None or vehicle_us < 0 else (now_us + best[1] - vehicle_us) * 1e-6
        )
