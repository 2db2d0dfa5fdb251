"""Links within one process: `pair` for tests, ``memory:NAME`` for two ends that know only a name.

No call waits in the kernel. Time passes on the link's clock, so a run with a manual clock is
deterministic.
"""

from collections import deque
from itertools import count

from companion.clock import Clock, SystemClock
from companion.errors import LinkError
from companion.links.base import BaseLink
from companion.links.urls import Endpoint

MAX_QUEUE = 10_000
POLL_S = 0.001

_rooms: dict[str, list["MemoryLink"]] = {}
_numbers = count(1)


class MemoryLink(BaseLink):
    """One of two ends that share a name. Each `send` is one `receive` of the other end."""

    def __init__(self, endpoint: Endpoint, clock: Clock) -> None:
        super().__init__(str(endpoint), clock)
        self._name = endpoint.address
        self._queue: deque[bytes] = deque()
        room = _rooms.setdefault(self._name, [])
        if len(room) == 2:
            raise LinkError(
                f"{endpoint}: already in use by two ends; close one or choose another name"
            )
        room.append(self)
        for end in room if len(room) == 2 else ():
            end._found("both ends are there")

    def _receive(self, timeout_s: float) -> bytes:
        deadline_us = self._clock.now_us() + round(timeout_s * 1e6)
        while not self._queue:
            left_s = (deadline_us - self._clock.now_us()) / 1e6
            if left_s <= 0.0:
                return b""
            self._clock.sleep_s(min(left_s, POLL_S))
        return self._queue.popleft()

    def _send(self, data: bytes) -> bool:
        other = self._other()
        if other is None or len(other._queue) >= MAX_QUEUE:
            return False
        other._queue.append(data)
        return True

    def _close(self) -> None:
        other = self._other()
        if other is not None:
            other._lost("the other end closed")
        room = _rooms[self._name]
        room.remove(self)
        if not room:
            del _rooms[self._name]

    def _other(self) -> "MemoryLink | None":
        return next((end for end in _rooms[self._name] if end is not self), None)


def pair(clock: Clock | None = None) -> tuple[MemoryLink, MemoryLink]:
    """Two connected links on one clock, under a name of their own."""
    endpoint = Endpoint("memory", f"pair-{next(_numbers)}")
    clock = clock or SystemClock()
    return MemoryLink(endpoint, clock), MemoryLink(endpoint, clock)
