"""What every link shares: its states and counters, and when to try again."""

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
    """Whether somebody is at the other end, as far as the last `Link.receive` or `Link.send` could
    tell."""

    OPEN = "open"
    """a peer was heard, a connection or a port is there"""
    WAITING = "waiting"
    """no peer yet: nobody heard, nobody connected"""
    LOST = "lost"
    """there was one; it comes back by itself, inside `Link.receive`"""


@dataclass
class Statistics:
    """Counters of one link since it was opened."""

    received_bytes: int = 0
    sent_bytes: int = 0
    dropped_bytes: int = 0
    """of sends that returned False"""
    reconnects: int = 0
    """how often it went from LOST to OPEN"""


class Link(Protocol):
    """Bytes to and from an autopilot. After opening, nothing that the environment does raises."""

    url: str
    """canonical; shows the real port where the given one was 0"""
    statistics: Statistics
    source: Hashable
    """the peer that the last bytes came from, where there may be several; None elsewhere"""
    bytes_per_s: float | None
    """what the link carries each way; None where that is unknown or plenty"""

    @property
    def state(self) -> LinkState:
        """See `LinkState`."""
        ...

    def receive(self, timeout_s: float) -> bytes:
        """The next bytes, as soon as there are any; b"" after about `timeout_s` without.

        Peers are learned and lost connections come back in here, so call it often.
        """
        ...

    def trust(self) -> None:
        """What the last `receive` brought was MAVLink: its peer may be sent to."""
        ...

    def send(self, data: bytes) -> bool:
        """Hand whole frames to the link, without blocking. False: dropped, nobody is there or
        cannot keep up."""
        ...

    def descriptors(self) -> list["HasFileno"]:
        """What to wait on for the next bytes; empty where only `receive` can tell."""
        ...

    def close(self) -> None:
        """Give everything back. Closing twice is fine; a closed link receives b"" and drops what is
        sent."""
        ...


class BaseLink(ABC):
    """Counters, state changes (the only thing logged) and closing, around three short methods of a
    transport."""

    def __init__(self, url: str, clock: Clock) -> None:
        self.url = url
        self.statistics = Statistics()
        self.source: Hashable = None
        self.bytes_per_s: float | None = None
        self._trusted = False
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

    def trust(self) -> None:
        """A link with one peer trusts it anyway."""
        self._trusted = True

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._close()
            self._lost("closed")

    def _found(self, who: str) -> None:
        """Somebody is there: OPEN."""
        if self._state is not LinkState.OPEN:
            self.statistics.reconnects += self._state is LinkState.LOST
            self._state = LinkState.OPEN
            log.info("%s: open (%s)", self.url, who)

    def _lost(self, why: object) -> None:
        """Nobody is there any more: LOST, unless there never was."""
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
    """When to try again: at once, then after `first_s`, doubling to `longest_s`; success starts it
    over."""

    def __init__(self, clock: Clock, first_s: float = 0.2, longest_s: float = 5.0) -> None:
        self._clock = clock
        self._first_s = self._next_s = first_s
        self._longest_s = longest_s
        self._due_us = clock.now_us()

    def wait_s(self) -> float:
        """How long until the next attempt; zero or less when it is due."""
        return (self._due_us - self._clock.now_us()) / 1e6

    def failed(self, longest_s: float | None = None) -> None:
        """Wait longer than last time, but no longer than `longest_s`."""
        longest_s = self._longest_s if longest_s is None else longest_s
        wait_s = min(self._next_s, longest_s)
        self._due_us = self._clock.now_us() + round(wait_s * 1e6)
        self._next_s = min(2.0 * wait_s, self._longest_s)

    def succeeded(self) -> None:
        self._next_s = self._first_s


class HasFileno(Protocol):
    """What select takes."""

    def fileno(self) -> int: ...


def readable(source: HasFileno, timeout_s: float) -> bool:
    """Whether `source` has bytes, an end or an error to read within `timeout_s` of real time."""
    return bool(select.select([source], [], [], timeout_s)[0])


def writable(sink: HasFileno, timeout_s: float) -> bool:
    """Whether `sink` takes bytes, or has connected or failed to, within `timeout_s` of real
    time."""
    return bool(select.select([], [sink], [], timeout_s)[1])
