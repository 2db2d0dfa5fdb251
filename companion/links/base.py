"""What every link has: states, counters, and the delay before the next attempt to connect."""

import logging
import select
from abc import ABC, abstractmethod
from collections.abc import Hashable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from companion.clock import Clock

log = logging.getLogger("kollsman.links")


class LinkState(Enum):
    """Whether there is a peer, as the last `Link.receive` or `Link.send` found."""

    OPEN = "open"
    """a peer was heard, or a connection or a port is open"""
    WAITING = "waiting"
    """there has been no peer and no connection yet"""
    LOST = "lost"
    """the peer or connection was lost; `Link.receive` reconnects"""


@dataclass
class Statistics:
    """Counters of one link since it was opened."""

    received_bytes: int = 0
    sent_bytes: int = 0
    dropped_bytes: int = 0
    """bytes of sends that returned False"""
    reconnects: int = 0
    """number of changes from LOST to OPEN"""


class Link(Protocol):
    """Bytes to and from an autopilot. Once it is open, no method raises an error of the
    environment."""

    url: str
    """canonical URL; it shows the assigned port where port 0 was given"""
    statistics: Statistics
    source: Hashable
    """the peer that sent the last bytes, on a link with several peers; None on others"""
    bytes_per_s: float | None
    """capacity in each direction; None where it is unknown or not limiting"""

    @property
    def state(self) -> LinkState:
        """See `LinkState`."""
        ...

    def receive(self, timeout_s: float) -> bytes:
        """The next bytes, as soon as there are any; b"" after about `timeout_s` without.

        New peers and reconnections are handled here, so call it often.
        """
        ...

    def trust(self) -> None:
        """The last `receive` returned MAVLink: its peer may be sent to."""
        ...

    def send(self, data: bytes) -> bool:
        """Send whole frames without blocking. False: they were dropped, because there is no peer or
        it is too slow."""
        ...

    def descriptors(self) -> list["HasFileno"]:
        """The descriptors to wait on for the next bytes; empty where only `receive` can tell."""
        ...

    def close(self) -> None:
        """Release everything. Closing twice does no harm; a closed link receives b"" and drops what
        is sent."""
        ...


class BaseLink(ABC):
    """Counters, state changes and closing, around three short methods of a transport. Only state
    changes are logged."""

    def __init__(self, url: str, clock: Clock) -> None:
        self.url = url
        self.statistics = Statistics()
        self.source: Hashable = None
        self.bytes_per_s: float | None = None
        self._clock = clock
        self._state = LinkState.WAITING
        self._closed = False

    @property
    def state(self) -> LinkState:
        return self._state

    def receive(self, timeout_s: float) -> bytes:
        data = b"" if self._closed else self._receive(max(0.0, timeout_s))
        self.statistics.received_bytes += len(data)
        return data

    def send(self, data: bytes) -> bool:
        sent = not self._closed and self._send(data)
        if sent:
            self.statistics.sent_bytes += len(data)
        else:
            self.statistics.dropped_bytes += len(data)
        return sent

    def descriptors(self) -> list["HasFileno"]:
        """What to wait on for the next bytes; empty where only `receive` can tell."""
        return []

    def trust(self) -> None:  # noqa: B027
        """A link with one peer always trusts it."""

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._close()
            self._lost("closed")

    def _found(self, who: str) -> None:
        """There is a peer: OPEN."""
        if self._state is not LinkState.OPEN:
            self.statistics.reconnects += self._state is LinkState.LOST
            self._state = LinkState.OPEN
            log.info("%s: open (%s)", self.url, who)

    def _lost(self, why: object) -> None:
        """The peer is gone: LOST, unless there never was one."""
        if self._state is LinkState.OPEN:
            self._state = LinkState.LOST
            log.log(
                logging.INFO if self._closed else logging.WARNING, "%s: lost (%s)", self.url, why
            )

    @abstractmethod
    def _receive(self, timeout_s: float) -> bytes: ...

    @abstractmethod
    def _send(self, data: bytes) -> bool: ...

    @abstractmethod
    def _close(self) -> None: ...


class Backoff:
    """Delay before the next attempt: none, then `first_s`, doubled up to `longest_s`; a success
    resets it."""

    def __init__(self, clock: Clock, first_s: float = 0.2, longest_s: float = 5.0) -> None:
        self._clock = clock
        self._first_s = self._next_s = first_s
        self._longest_s = longest_s
        self._due_us = clock.now_us()

    def wait_s(self) -> float:
        """Time until the next attempt, s; zero or less when it is due."""
        return (self._due_us - self._clock.now_us()) / 1e6

    def failed(self, longest_s: float | None = None) -> None:
        """Double the delay, up to `longest_s`."""
        longest_s = self._longest_s if longest_s is None else longest_s
        wait_s = min(self._next_s, longest_s)
        self._due_us = self._clock.now_us() + round(wait_s * 1e6)
        self._next_s = min(2.0 * wait_s, self._longest_s)

    def succeeded(self) -> None:
        self._next_s = self._first_s


class HasFileno(Protocol):
    """An object that `select` accepts."""

    def fileno(self) -> int: ...


class Incoming:
    """Waits for the bytes of one source; three times as fast as `select.select`."""

    def __init__(self, source: HasFileno) -> None:
        self._poll = select.poll()
        self._poll.register(source, select.POLLIN)

    def within(self, timeout_s: float) -> bool:
        """Whether there are bytes, an end or an error to read within `timeout_s` of real time."""
        return bool(self._poll.poll(timeout_s * 1000.0))


def readable(source: HasFileno, timeout_s: float) -> bool:
    """Whether `source` has bytes, an end or an error to read within `timeout_s` of real time."""
    return bool(select.select([source], [], [], timeout_s)[0])


def writable(sink: HasFileno, timeout_s: float) -> bool:
    """Whether `sink` takes bytes, or has connected or failed to, within `timeout_s` of real
    time."""
    return bool(select.select([], [sink], [], timeout_s)[1])
