"""What all faults have in common: when they act, on whose frames, with which random numbers, and how they
hold packets back."""

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
    """Random numbers that depend on a seed and on what they are for, not on how many were drawn
    before.

    So the same sample meets the same luck on every link of a vehicle, in a live run and in its log.
    """

    def __init__(self, seed: int, name: str, number: int) -> None:
        self._key = hashlib.blake2b(f"{seed} {name} {number}".encode(), digest_size=16).digest()

    def _halves(self, numbers: tuple[int, ...]) -> tuple[float, float]:
        data = self._key + _NUMBERS[len(numbers)].pack(*numbers)
        first, second = _HALVES.unpack(hashlib.blake2b(data, digest_size=16).digest())
        return ((first >> 11) + 0.5) * 2.0**-53, ((second >> 11) + 0.5) * 2.0**-53

    def uniform(self, *numbers: int) -> float:
        """Between 0 and 1, neither of them."""
        return self._halves(numbers)[0]

    def normal(self, *numbers: int) -> float:
        """Box and Muller's standard normal number."""
        first, second = self._halves(numbers)
        return math.sqrt(-2.0 * math.log(first)) * math.cos(math.tau * second)


class PacketContext:
    """When a packet meets a fault."""

    __slots__ = ("active", "message_id", "sequence", "since_s", "since_us")

    def __init__(self, message_id: int, sequence: int, since_us: int, active: bool) -> None:
        self.message_id = message_id
        self.sequence = sequence
        self.since_us = since_us
        self.since_s = since_us * 1e-6
        """since the fault began; negative before"""
        self.active = active

    @property
    def key(self) -> tuple[int, int, int]:
        """What the dice of a link go by."""
        return self.since_us, self.message_id, self.sequence


class Effect:
    """A fault at work on one stream. `ids` are the messages it wants to see; None is all of them.

    `feed` takes every such packet, in the window or not, and says what goes on; `due` gives back
    what was held.
    """

    ids: frozenset[int] | None = None

    def feed(self, packet: Packet, context: PacketContext) -> Iterable[Packet]:
        raise NotImplementedError

    def due(self, time_us: float) -> Iterable[Packet]:
        del time_us
        return ()


class Edit(Effect):
    """Changes fields of some messages while the fault lasts, one sample at a time. False of
    `change` drops it."""

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
    """Packets that come later, each at its own time."""

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
    """The parameters of all faults. A subclass's first line is its help, its fields are its
    parameters."""

    start_s: Seconds = 0.0
    """since the first packet of the stream"""
    duration_s: Annotated[float, Field(gt=0.0, le=1e6)] | None = None
    """without it, to the end"""
    component: Annotated[int, Field(ge=0, le=255)] = 1
    """whose frames: 1 is the autopilot, 0 everybody"""
    seed: Annotated[int, Field(ge=0)] | None = None
    """of this fault alone; without it, the flight's or that of the command line"""

    announced: ClassVar[bool] = False
    """whether the sensor itself says how unwell it is, so that nobody need accuse it"""

    @property
    def faulty_sensor(self) -> FaultySensor:
        """Whose readings are wrong, in the words of an estimator's field ``faulty``; NONE where no
        sensor is."""
        return FaultySensor.NONE

    def effect(self, random: KeyedRandom) -> Effect:
        """The fault at work on one stream."""
        raise NotImplementedError
