"""What all faults share: their parameters, keyed random numbers, and the queue of delayed
packets."""

import hashlib
import heapq
import math
import struct
from collections.abc import Callable, Iterable
from typing import Annotated, ClassVar

from pydantic import Field

from companion.config import Settings
from companion.mavlink.codec import mavlink
from companion.samples import FaultySensor, Packet
from sim.faults.editing import Editor

SIM_STATE: int = mavlink.MAVLINK_MSG_ID_SIM_STATE
Probability = Annotated[float, Field(gt=0.0, le=1.0)]
Seconds = Annotated[float, Field(ge=0.0, le=1e6)]
Metres = Annotated[float, Field(ge=-100_000.0, le=100_000.0)]


_NUMBERS = [struct.Struct(f"<{count}q") for count in range(8)]
_HALVES = struct.Struct("<QQ")


class KeyedRandom:
    """Random numbers that are a hash of a seed and of integers that the caller gives.

    They do not depend on earlier draws, so the same sample gets the same number on every link of a
    vehicle, in a live run and in its log.
    """

    def __init__(self, seed: int, name: str, number: int) -> None:
        self._key = hashlib.blake2b(f"{seed} {name} {number}".encode(), digest_size=16).digest()

    def _halves(self, numbers: tuple[int, ...]) -> tuple[float, float]:
        data = self._key + _NUMBERS[len(numbers)].pack(*numbers)
        first, second = _HALVES.unpack(hashlib.blake2b(data, digest_size=16).digest())
        return ((first >> 11) + 0.5) * 2.0**-53, ((second >> 11) + 0.5) * 2.0**-53

    def uniform(self, *numbers: int) -> float:
        """A number in the open interval (0, 1), keyed by `numbers`."""
        return self._halves(numbers)[0]

    def normal(self, *numbers: int) -> float:
        """A standard normal number (Box-Muller), keyed by `numbers`."""
        first, second = self._halves(numbers)
        return math.sqrt(-2.0 * math.log(first)) * math.cos(math.tau * second)


class PacketContext:
    """A packet's message, and its time relative to the fault window."""

    __slots__ = ("active", "message_id", "sequence", "since_s", "since_us")

    def __init__(self, message_id: int, sequence: int, since_us: int, active: bool) -> None:
        self.message_id = message_id
        self.sequence = sequence
        self.since_us = since_us
        self.since_s = since_us * 1e-6
        """time since the fault began, s; negative before"""
        self.active = active

    @property
    def key(self) -> tuple[int, int, int]:
        """Key of the random numbers of a link fault."""
        return self.since_us, self.message_id, self.sequence


class Effect:
    """The state of a fault on one stream. `ids` are the message ids that it receives; None is all.

    `feed` receives every such packet, inside and outside the fault window, and returns the packets
    that continue; `due` returns delayed packets.
    """

    ids: frozenset[int] | None = None

    def feed(self, packet: Packet, context: PacketContext) -> Iterable[Packet]:
        raise NotImplementedError

    def due(self, time_us: float) -> Iterable[Packet]:
        del time_us
        return ()


class Edit(Effect):
    """Edits messages within the fault window. `change` edits one message; its result False drops
    the packet."""

    def __init__(
        self, ids: Iterable[int], change: Callable[[Editor, PacketContext], bool | None]
    ) -> None:
        self.ids = frozenset(ids)
        self._change = change

    def feed(self, packet: Packet, context: PacketContext) -> Iterable[Packet]:
        if not context.active:
            return (packet,)
        message = Editor(packet.data, context.message_id)
        if self._change(message, context) is False:
            return ()
        return (Packet(packet.time_us, message.close()),)


class DelayQueue:
    """Delayed packets in the order of their due times."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, bytes]] = []
        self._count = 0

    def __bool__(self) -> bool:
        return bool(self._heap)

    def add(self, due_us: int, data: bytes) -> None:
        heapq.heappush(self._heap, (due_us, self._count, data))
        self._count += 1

    def due(self, time_us: float) -> list[Packet]:
        if not self._heap or self._heap[0][0] > time_us:
            return []
        found = []
        while self._heap and self._heap[0][0] <= time_us:
            due_us, _, data = heapq.heappop(self._heap)
            found.append(Packet(due_us, data))
        return found


class Fault(Settings):
    """Parameters that all faults have. The first line of a subclass is its help text, and its
    fields are its parameters."""

    start_s: Seconds = 0.0
    """time from the first packet of the stream to the start of the fault"""
    duration_s: Annotated[float, Field(gt=0.0, le=1e6)] | None = None
    """duration of the fault; left out, the fault lasts to the end"""
    component: Annotated[int, Field(ge=0, le=255)] = 1
    """MAVLink component id whose frames are changed: 1 is the autopilot, 0 is every component"""
    seed: Annotated[int, Field(ge=0)] | None = None
    """seed of this fault; left out, the seed of the flight or of the command line"""

    announced: ClassVar[bool] = False
    """whether the sensor reports the fault itself, so that an estimator need not detect it"""

    @property
    def faulty_sensor(self) -> FaultySensor:
        """The sensor that the fault makes wrong, as in the estimates' field ``faulty``; NONE if
        none."""
        return FaultySensor.NONE

    def effect(self, random: KeyedRandom) -> Effect:
        """A new effect of this fault for one stream."""
        raise NotImplementedError
