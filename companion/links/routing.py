"""Several links as one, with MAVLink routing between them, so that no router is needed beside us.

A frame that one link receives is given to us and forwarded to the other links. A frame without a
target, or with target system 0, goes to all; a frame with a target goes to the links on which that
target was heard. No frame goes back to its own link, and a frame that another link brings again
within `REPEAT_US` is dropped, so that a loop carries every frame once. RADIO_STATUS, which
describes its own link alone, and SETUP_SIGNING, which holds a key, are not forwarded.
"""

import select
import struct
import time
from collections import Counter
from collections.abc import Hashable, Sequence
from functools import cache

from companion.clock import Clock
from companion.links.base import HasFileno, Link, LinkState, Statistics
from companion.links.traffic import Traffic
from companion.mavlink.codec import Decoder, Frame, FrameReject, mavlink, scan
from companion.mavlink.framing import V1_HEADER, V2_HEADER

REPEAT_US = 2_000_000
QUIET_US = 200_000
MOST_ROUTES = 256
NAP_S = 0.005
LOCAL = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_RADIO_STATUS,
        mavlink.MAVLINK_MSG_ID_RADIO,
        mavlink.MAVLINK_MSG_ID_SETUP_SIGNING,  # it holds the key
    }
)

Ids = tuple[int, int]


class _Port:
    """One link of the router."""

    def __init__(self, link: Link) -> None:
        self.link = link
        self.decoder = Decoder()
        self.traffic = Traffic()
        self.heard: set[Ids] = set()
        """the senders on this link"""
        self.heard_us = 0


class Router:
    """A `Link` over several links. `receive` returns whole frames of one of them.

    Parameters
    ----------
    links : open; the first is the autopilot's where it matters (bandwidth).
    """

    def __init__(self, links: Sequence[Link], clock: Clock) -> None:
        self._ports = [_Port(link) for link in links]
        self._clock = clock
        self._next = 0
        self._seen: dict[bytes, tuple[int, int]] = {}
        """frame -> (port, time of arrival), oldest first"""
        self.url = " + ".join(link.url for link in links)
        self.statistics = Statistics()
        self.source: Hashable = None
        self.bytes_per_s = links[0].bytes_per_s
        self.repeated = 0
        """frames dropped because another link had brought them already"""
        self.forwarded = 0

    @property
    def state(self) -> LinkState:
        states = [port.link.state for port in self._ports]
        order = (LinkState.OPEN, LinkState.LOST, LinkState.WAITING)
        return next(state for state in order if state in states)

    @property
    def rejects(self) -> Counter[FrameReject]:
        """Counts of bad input on all links, by reason."""
        return sum((port.decoder.counters for port in self._ports), Counter[FrameReject]())

    def traffic(self) -> dict[str, Traffic]:
        """The senders of each link."""
        return {port.link.url: port.traffic for port in self._ports}

    def trust(self) -> None:
        """Each link is trusted when a frame is found in its bytes."""

    def receive(self, timeout_s: float) -> bytes:
        end_s = time.monotonic() + timeout_s
        while True:
            for _ in self._ports:
                index = self._next
                self._next = (index + 1) % len(self._ports)
                data = self._receive(index)
                if data:
                    return data
            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                return b""
            self._wait(left_s)

    def send(self, data: bytes) -> bool:
        """Send a frame of our own to all links, or to those on which its target was heard."""
        found = scan(data)
        ports: Sequence[int] = range(len(self._ports))
        if isinstance(found, Frame):
            ports = self._toward(found, -1) or ports
        sent = [self._ports[index].link.send(data) for index in ports]
        self._update()
        return any(sent)

    def close(self) -> None:
        for port in self._ports:
            port.link.close()

    def _receive(self, index: int) -> bytes:
        port = self._ports[index]
        data = port.link.receive(0.0)
        now_us = self._clock.now_us()
        if data:
            port.heard_us = now_us
            frames = port.decoder.feed(data)
        elif now_us - port.heard_us > QUIET_US:
            frames = port.decoder.flush()
        else:
            frames = []
        if not frames:
            return b""
        port.link.trust()
        port.traffic.take(frames, now_us)
        self.source = (index, port.link.source)
        fresh = [frame for frame in frames if self._is_first(frame, index, now_us)]
        for frame in fresh:
            if len(port.heard) < MOST_ROUTES:
                port.heard.add((frame.system_id, frame.component_id))
            self._forward(frame, index)
        self._update()
        return b"".join(frame.data for frame in fresh)

    def _is_first(self, frame: Frame, index: int, now_us: int) -> bool:
        """Whether no other link has brought the frame within `REPEAT_US`."""
        for data, (_, seen_us) in list(self._seen.items()):
            if now_us - seen_us <= REPEAT_US:
                break
            del self._seen[data]
        seen = self._seen.get(frame.data)
        if seen is not None and seen[0] != index:
            self.repeated += 1
            return False
        self._seen.pop(frame.data, None)
        self._seen[frame.data] = (index, now_us)
        return True

    def _forward(self, frame: Frame, index: int) -> None:
        if frame.message_id in LOCAL:
            return
        for other in self._toward(frame, index):
            self.forwarded += self._ports[other].link.send(frame.data)

    def _toward(self, frame: Frame, index: int) -> list[int]:
        """The links to which `frame`, received on link `index`, is forwarded."""
        others = [number for number in range(len(self._ports)) if number != index]
        system, component = target_of(frame)
        if system == 0:
            return others
        exactly = [number for number in others if (system, component) in self._ports[number].heard]
        somewhere = [
            number
            for number in others
            if any(ids[0] == system for ids in self._ports[number].heard)
        ]
        return exactly or somewhere

    def descriptors(self) -> list[HasFileno]:
        return [each for port in self._ports for each in port.link.descriptors()]

    def _wait(self, timeout_s: float) -> None:
        known = all(port.link.descriptors() for port in self._ports)
        nap_s = min(timeout_s, 0.1 if known else NAP_S)
        try:
            select.select(self.descriptors(), [], [], nap_s)
        except (OSError, ValueError):  # one was closed under us
            time.sleep(nap_s)

    def _update(self) -> None:
        """Sum the counters of all links."""
        every = [port.link.statistics for port in self._ports]
        for name in vars(self.statistics):
            setattr(self.statistics, name, sum(getattr(each, name) for each in every))


@cache
def _target_offsets(message_id: int) -> tuple[int | None, int | None]:
    """Where ``target_system`` and ``target_component`` are in the payload."""
    kind = mavlink.mavlink_map[message_id]
    offsets: dict[str, int] = {}
    at = 0
    codes = kind.native_format.decode().lstrip("<")
    fields = zip(kind.ordered_fieldnames, codes, kind.array_lengths, strict=True)
    for name, code, length in fields:
        offsets[name] = at
        at += struct.calcsize(f"<{length or 1}{code}")
    return offsets.get("target_system"), offsets.get("target_component")


def target_of(frame: Frame) -> Ids:
    """Target system and component of a frame; 0 is everybody."""
    head = V2_HEADER if frame.version == 2 else V1_HEADER
    payload = frame.data[head : head + frame.data[1]]
    system, component = (
        payload[at] if at is not None and at < len(payload) else 0
        for at in _target_offsets(frame.message_id)
    )
    return system, component
