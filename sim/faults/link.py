"""Faults of the link: packets lost, late, duplicated or reordered. The frames are not changed.

SIM_STATE has no time stamp; its time is that of the frame before it, so the truth is lost or
delayed with that frame.
"""

from collections.abc import Iterable
from typing import Annotated, Literal

from pydantic import Field, field_validator

from companion.mavlink.codec import mavlink
from companion.samples import Packet
from sim.faults.base import (
    SIM_STATE,
    DelayQueue,
    Effect,
    Fault,
    KeyedRandom,
    PacketContext,
    Probability,
)


class LinkFault(Fault):
    """Parameters of all faults of the link."""

    message: str = ""
    """name of the only message that the fault affects, with the truth that follows it; empty is
    every message"""

    @field_validator("message")
    @classmethod
    def _is_known(cls, name: str) -> str:
        if name and not isinstance(getattr(mavlink, f"MAVLINK_MSG_ID_{name}", None), int):
            raise ValueError("is no message of the dialect; give a name such as GPS_RAW_INT")
        return name

    @property
    def ids(self) -> frozenset[int] | None:
        return (
            frozenset({getattr(mavlink, f"MAVLINK_MSG_ID_{self.message}")})
            if self.message
            else None
        )


class _RandomSelection(Effect):
    """Selects packets at random. The truth is selected with the frame before it."""

    def __init__(self, fault: LinkFault, random: KeyedRandom, probability: float) -> None:
        self._only, self._random, self._probability = fault.ids, random, probability
        self._selected = False

    def selects(self, context: PacketContext) -> bool:
        if context.message_id != SIM_STATE or (self._only is not None and SIM_STATE in self._only):
            chosen = self._only is None or context.message_id in self._only
            self._selected = context.active and chosen and self._is_drawn(context)
        return self._selected

    def _is_drawn(self, context: PacketContext) -> bool:
        return self._probability == 1.0 or self._random.uniform(*context.key) < self._probability


class Drop(LinkFault):
    """Packets are lost."""

    fault: Literal["drop"] = "drop"
    probability: Probability = 1.0
    """probability that a packet is selected, 0 to 1"""

    def effect(self, random: KeyedRandom) -> Effect:
        return _Drop(self, random, self.probability)


class _Drop(_RandomSelection):
    def feed(self, packet: Packet, context: PacketContext) -> Iterable[Packet]:
        return () if self.selects(context) else (packet,)


class Duplicate(LinkFault):
    """Packets arrive twice."""

    fault: Literal["duplicate"] = "duplicate"
    probability: Probability = 0.1
    """probability that a packet is selected, 0 to 1"""
    after_s: Annotated[float, Field(ge=0.0, le=60.0)] = 0.0
    """time between the packet and its duplicate"""

    def effect(self, random: KeyedRandom) -> Effect:
        return _Duplicate(self, random)


class _Duplicate(_RandomSelection):
    def __init__(self, fault: Duplicate, random: KeyedRandom) -> None:
        super().__init__(fault, random, fault.probability)
        self._after_us = round(fault.after_s * 1e6)
        self._queue = DelayQueue()

    def feed(self, packet: Packet, context: PacketContext) -> Iterable[Packet]:
        if not self.selects(context) or context.message_id == SIM_STATE:
            return (packet,)
        if not self._after_us:
            return (packet, packet)
        self._queue.add(packet.time_us + self._after_us, packet.data)
        return (packet,)

    def due(self, time_us: float) -> Iterable[Packet]:
        return self._queue.due(time_us)


class Reorder(LinkFault):
    """Packets arrive after packets that were sent later."""

    fault: Literal["reorder"] = "reorder"
    probability: Probability = 0.1
    """probability that a packet is selected, 0 to 1"""
    hold_s: Annotated[float, Field(gt=0.0, le=60.0)] = 0.2
    """time for which a selected packet is held back"""

    def effect(self, random: KeyedRandom) -> Effect:
        return _Reorder(self, random)


class _Reorder(_RandomSelection):
    def __init__(self, fault: Reorder, random: KeyedRandom) -> None:
        super().__init__(fault, random, fault.probability)
        self._hold_us = round(fault.hold_s * 1e6)
        self._queue = DelayQueue()

    def feed(self, packet: Packet, context: PacketContext) -> Iterable[Packet]:
        if not self.selects(context):
            return (packet,)
        self._queue.add(packet.time_us + self._hold_us, packet.data)
        return ()

    def due(self, time_us: float) -> Iterable[Packet]:
        return self._queue.due(time_us)


class Delay(LinkFault):
    """Packets arrive late and in order; their time stamps do not change."""

    fault: Literal["delay"] = "delay"
    delay_s: Annotated[float, Field(ge=0.0, le=600.0)] = 1.0
    """delay of every packet"""
    jitter_s: Annotated[float, Field(ge=0.0, le=600.0)] = 0.0
    """largest additional delay, uniformly distributed"""

    def effect(self, random: KeyedRandom) -> Effect:
        return _Delay(self, random)


class _Delay(_RandomSelection):
    def __init__(self, fault: Delay, random: KeyedRandom) -> None:
        super().__init__(fault, random, 1.0)
        self._fault = fault
        self._queue = DelayQueue()
        self._last_us = 0

    def feed(self, packet: Packet, context: PacketContext) -> Iterable[Packet]:
        if self.selects(context):
            extra_s = (
                self._fault.jitter_s * self._random.uniform(*context.key, 1)
                if self._fault.jitter_s
                else 0.0
            )
            due_us = packet.time_us + round((self._fault.delay_s + extra_s) * 1e6)
        elif self._queue and not self._only:  # earlier packets are still in the queue
            due_us = packet.time_us
        else:
            return (packet,)
        self._last_us = max(self._last_us, due_us) if self._queue else due_us
        self._queue.add(self._last_us, packet.data)
        return ()

    def due(self, time_us: float) -> Iterable[Packet]:
        return self._queue.due(time_us)
