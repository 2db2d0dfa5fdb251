"""Faults of the vehicle's clock: a jump, and a reboot in flight."""

from collections.abc import Iterable
from typing import Annotated, Literal

from pydantic import Field

from companion.samples import Packet
from sim.faults.base import Effect, Fault, KeyedRandom, PacketContext
from sim.faults.editing import Editor, layout, with_sequence

_UNIX_US = 10**15
"""A larger time_usec counts from 1970, a smaller one from boot."""


def _shift(message: Editor, by_us: int, *, unix_too: bool) -> None:
    for name, size_us in message.stamps.items():
        value = message[name]
        if unix_too or value * size_us < _UNIX_US:
            message[name] = max(0, value + by_us // size_us) % (2**32 if size_us == 1000 else 2**64)


class ClockJump(Fault):
    """Every time stamp of the vehicle has a constant error."""

    fault: Literal["clock_jump"] = "clock_jump"
    jump_s: Annotated[float, Field(ge=-1e6, le=1e6)] = 30.0
    """error of the clock, positive if it is ahead"""

    def effect(self, random: KeyedRandom) -> Effect:
        return _Jump(round(self.jump_s * 1e6))


class _Jump(Effect):
    def __init__(self, jump_us: int) -> None:
        self._jump_us = jump_us

    def feed(self, packet: Packet, context: PacketContext) -> Iterable[Packet]:
        found = layout(context.message_id)
        if not context.active or found is None or not found.stamps:
            return (packet,)
        message = Editor(packet.data, context.message_id)
        _shift(message, self._jump_us, unix_too=True)
        return (Packet(packet.time_us, message.close()),)


class Reboot(Fault):
    """The vehicle is silent, then sends again with its clock and its sequence numbers from zero."""

    fault: Literal["reboot"] = "reboot"
    duration_s: Annotated[float, Field(gt=0.0, le=3600.0)] = 3.0
    """duration of the silence"""

    def effect(self, random: KeyedRandom) -> Effect:
        return _Reboot(round(self.duration_s * 1e6))


class _Reboot(Effect):
    def __init__(self, silence_us: int) -> None:
        self._silence_us = silence_us
        self._ahead_us: int | None = None
        """largest difference between the boot clock and the time since the fault began, which is
        the one of a packet without latency"""
        self._sequence = 0

    def feed(self, packet: Packet, context: PacketContext) -> Iterable[Packet]:
        found = layout(context.message_id)
        stamped = found is not None and bool(found.stamps)
        back = context.since_us >= self._silence_us
        if not back and not stamped:
            return () if context.active else (packet,)
        message = Editor(packet.data, context.message_id) if stamped else None
        if message is not None and not back:
            self._learn(message, context)
        if not back:
            return () if context.active else (packet,)
        data = packet.data
        if message is not None:
            _shift(message, -(self._silence_us + (self._ahead_us or 0)), unix_too=False)
            data = message.close()
        data = with_sequence(data, self._sequence)
        self._sequence = (self._sequence + 1) & 0xFF
        return (Packet(packet.time_us, data),)

    def _learn(self, message: Editor, context: PacketContext) -> None:
        for name, size_us in message.stamps.items():
            stamp_us = message[name] * size_us
            if 0 < stamp_us < _UNIX_US:
                ahead_us = stamp_us - context.since_us
                self._ahead_us = (
                    ahead_us if self._ahead_us is None else max(self._ahead_us, ahead_us)
                )
