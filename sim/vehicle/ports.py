"""A port: one destination of the vehicle's messages, with its own rates, sequence numbers and
counts.

A live link starts at the default rates of the flavour (ArduPlane's 1 Hz) and obeys the requests
that it receives; a log gets the full set. Rates hold in simulated time.
"""

import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from heapq import heapify, heappop, heappush
from operator import itemgetter

from sim import TICK_US
from sim.vehicle.flavours import ARDUPILOT, Flavour
from sim.vehicle.frames import Packer
from sim.vehicle.stream import Fresh, State, Telemetry

MIN_INTERVAL_US = 20_000
"""shortest interval of any message: 50 Hz, the rate of the IMU samples"""
MAX_INTERVAL_US = 60_000_000
OFF = -1
_ANY, _MOTION, _FIX, _IMU, _PRESSURE = (
    Fresh  # looked up in its class, a member costs four times as much (Python 3.11)
)
_PLACE = itemgetter(1)


class _Stream:
    """One message on one port."""

    __slots__ = (
        "carriers", "default_us", "free", "fresh", "interval_us", "message_id", "moves", "packer",
        "payload", "place", "row", "sent",
    )  # fmt: skip

    def __init__(self, place: int, row: Telemetry, interval_us: int) -> None:
        self.place = place
        """in the flavour's table, which is the order of sending"""
        self.message_id = row.packer.message_id
        self.row = row
        self.packer, self.payload, self.fresh = row.packer, row.payload, row.fresh
        self.default_us = self.interval_us = interval_us
        self.carriers: tuple[int, ...] = ()
        """messages of ``row.follows`` that are streamed on this port"""
        self.free = True
        """whether it waits for nothing but its time"""
        self.moves = False
        """whether it waits for a new truth as well, and for nothing else"""
        self.sent = 0


class Port:
    """Sends to one destination. `deliver` takes a whole frame and says whether it was taken.

    `absent` are messages of sensors that the vehicle does not have: their rates can be set, and
    nothing is sent.
    """

    def __init__(
        self,
        name: str,
        deliver: Callable[[bytes], bool],
        rates_hz: Mapping[str, float],
        *,
        full: bool = False,
        flavour: Flavour = ARDUPILOT,
        absent: Collection[int] = (),
    ) -> None:
        self.name = name
        self._answers: Counter[str] = Counter()
        """messages sent beside the streams, by name"""
        self.sent_bytes = 0
        self.dropped = 0
        self.forwarded = 0
        """number of forwarded frames of other senders"""
        self.heard = False
        """whether a frame was received on this port"""
        self.slowdown = 1
        """factor by which all streams are slower, while parameters are listed"""
        self._flavour = flavour
        self._absent = absent
        self._deliver = deliver
        self._sequence = 0
        self._streams: dict[int, _Stream] = {}
        for place, (message_id, row) in enumerate(flavour.messages.items()):
            rate_hz = rates_hz.get(row.packer.name, row.full_hz if full else row.default_hz)
            self._streams[message_id] = _Stream(place, row, _interval_us(rate_hz))
        self._waiting: list[tuple[int, int, _Stream]] = []
        """heap of the streams by time and place"""
        self._fix_us = -1
        """measurement time of the last fix sent"""
        self._activate({})

    @property
    def due_us(self) -> float:
        """When the next message is due."""
        return self._waiting[0][0] if self._waiting else math.inf

    def due_of(self, message_id: int) -> float:
        """When `message_id` is due next."""
        times = (due_us for due_us, _, stream in self._waiting if stream.message_id == message_id)
        return next(times, math.inf)

    def stream(self, state: State) -> None:
        """Send every message that is due and has a new sample."""
        now_us, waiting = state.time_us, self._waiting
        if not waiting or waiting[0][0] > now_us:
            return
        due = []
        while waiting and waiting[0][0] <= now_us:
            due.append(heappop(waiting))
        if due[0][0] != due[-1][0]:  # else the heap gave them in the order of their places
            due.sort(key=_PLACE)
        moved = state.truth is not None and state.truth.time_us == now_us
        last_id = -1
        for was_due_us, place, stream in due:
            due_us = was_due_us
            if stream.free or (
                moved if stream.moves else self._is_new(stream, state, last_id, moved)
            ):
                payload = stream.payload(state)
                if payload is not None:
                    stream.sent += self._send(stream.packer, payload)
                    last_id = stream.message_id
                    # Behind by more than an interval (it had to wait for a fix): start over instead
                    # of catching up.
                    interval_us = stream.interval_us * self.slowdown
                    due_us += interval_us
                    if due_us <= now_us:
                        due_us = now_us + interval_us
            heappush(waiting, (due_us, place, stream))

    def _is_new(self, stream: _Stream, state: State, last_id: int, moved: bool) -> bool:
        """Whether there is a sample that was not sent, and the carrier of its time has just gone
        out."""
        if stream.carriers and last_id not in stream.carriers:
            return False
        fresh = stream.fresh
        if fresh is _ANY:
            return True
        if fresh is _MOTION:
            return moved
        if fresh is _IMU:
            return state.imu is not None and state.imu.time_us == state.time_us
        if fresh is _PRESSURE:
            return state.pressure is not None and state.pressure.time_us == state.time_us
        if state.fix is None or state.fix.measured_us == self._fix_us:
            return False
        self._fix_us = state.fix.measured_us
        return True

    def send(self, packer: Packer, payload: bytes) -> None:
        """Send one message now, beside the streams."""
        self._answers[packer.name] += self._send(packer, payload)

    def _send(self, packer: Packer, payload: bytes) -> bool:
        sequence = self._sequence
        self._sequence = (sequence + 1) & 0xFF
        frame = packer.frame(payload, sequence)
        if self._deliver(frame):
            self.sent_bytes += len(frame)
            return True
        self.dropped += 1
        return False

    @property
    def sent(self) -> Counter[str]:
        """Messages sent, by name."""
        streamed = {each.packer.name: each.sent for each in self._streams.values()}
        return Counter(streamed) + self._answers

    def forward(self, frame: bytes) -> None:
        """Send a frame of another sender unchanged."""
        if self._deliver(frame):
            self.forwarded += 1
        else:
            self.dropped += 1

    def set_interval(self, message_id: int, interval_us: int, now_us: int) -> None:
        """Microseconds between two of `message_id`: clamped, and in the flavour's steps; 0 restores
        the default, negative stops it."""
        stream = self._streams[message_id]
        if interval_us == 0:
            interval_us = stream.default_us
        elif interval_us > 0:
            interval_us = interval_us // self._flavour.step_us * self._flavour.step_us
            interval_us = self._in_a_bucket(
                stream, max(MIN_INTERVAL_US, min(interval_us, MAX_INTERVAL_US))
            )
        else:
            interval_us = OFF
        stream.interval_us = interval_us
        self._activate({stream.place: now_us + TICK_US})

    def _in_a_bucket(self, stream: _Stream, interval_us: int) -> int:
        """The nearest interval in use, when no further different interval is possible."""
        others = {other.interval_us for other in self._streams.values() if other is not stream}
        others.discard(OFF)
        if len(others) < self._flavour.buckets:
            return interval_us
        return min(others, key=lambda other_us: abs(other_us - interval_us))

    def hasten(self, message_id: int, now_us: int) -> None:
        """Send `message_id` at the next opportunity, if it is streamed: its content has changed."""
        self._activate({self._streams[message_id].place: now_us})

    def interval_us(self, message_id: int) -> int:
        """The interval in force; `OFF` when stopped."""
        return self._streams[message_id].interval_us

    def _activate(self, due_us: dict[int, int]) -> None:
        """Set when streams are due next, by place; the others keep their time (at first: now)."""
        due_us = {place: before_us for before_us, place, _ in self._waiting} | due_us
        active = [
            stream
            for stream in self._streams.values()
            if stream.interval_us != OFF and stream.message_id not in self._absent
        ]
        streamed = {stream.message_id for stream in active}
        for stream in active:
            stream.carriers = tuple(
                message_id for message_id in stream.row.follows if message_id in streamed
            )
            stream.free = stream.fresh is _ANY and not stream.carriers
            stream.moves = stream.fresh is _MOTION and not stream.carriers
        self._waiting = [(due_us.get(each.place, 0), each.place, each) for each in active]
        heapify(self._waiting)


def _interval_us(rate_hz: float) -> int:
    return max(MIN_INTERVAL_US, round(1e6 / rate_hz)) if rate_hz > 0 else OFF


def check_rates(rates_hz: Mapping[str, float], flavour: Flavour = ARDUPILOT) -> None:
    """ValueError naming the first message that is not streamed."""
    names = [row.packer.name for row in flavour.messages.values()]
    for name in rates_hz:
        if name not in names:
            raise ValueError(
                f"'{name}' is not streamed: use {', '.join(names)} (of {flavour.name})"
            )
