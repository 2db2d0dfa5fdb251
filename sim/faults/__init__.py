"""Faults that transform a stream of packets, the same for a simulated vehicle and for a log.

    apply_faults(packets, [Drop(start_s=60, duration_s=10)], seed=1)    any iterable of packets
    FaultChain(faults, seed)                            packet by packet, for a live link

A packet is one whole frame. A fault edits the frames of one component (the autopilot), with a
correct checksum, and leaves all other frames and their sequence numbers unchanged. Its random
numbers depend on its seed and the packet alone, so a live run and its log get the same fault.

`FAULTS` drives the scenario files, the command ``kollsman-sim corrupt`` and its list. A new fault
is a class and its name in `AnyFault`.
"""

import difflib
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Annotated, Any, get_args

from pydantic import Field

from companion.config import validate
from companion.errors import ConfigError
from companion.mavlink.framing import V1, V2
from companion.samples import Packet
from sim.faults.base import Effect, Fault, KeyedRandom, PacketContext
from sim.faults.clock import ClockJump, Reboot
from sim.faults.editing import header
from sim.faults.gnss import Jamming, Outage, Slide, Spoofing, TwoDimensional
from sim.faults.link import Delay, Drop, Duplicate, Reorder
from sim.faults.readings import Freeze, Lag
from sim.faults.values import BlockedStaticPort, Noise, Ramp, Spike, Step, SwappedUnits, Swing

__all__ = ["FAULTS", "AnyFault", "Fault", "FaultChain", "apply_faults", "parse_fault"]

AnyFault = Annotated[
    Drop | Duplicate | Reorder | Delay  # of the link
    | Freeze | Lag | Spike | Step | Ramp | Swing | Noise  # of a sensor's values
    | SwappedUnits | BlockedStaticPort
    | Outage | TwoDimensional | Jamming | Spoofing | Slide  # of the receiver
    | ClockJump | Reboot,
    Field(discriminator="fault"),
]  # fmt: skip

FAULTS: Mapping[str, type[Fault]] = {
    kind.model_fields["fault"].default: kind for kind in get_args(get_args(AnyFault)[0])
}
"""name -> fault class; its fields are the parameters, its docstring is the help"""


_V1, _V2 = bytes([V1]), bytes([V2])


class _Stage:
    """One fault of a chain."""

    def __init__(self, fault: Fault, random: KeyedRandom) -> None:
        effect = fault.effect(random)
        self._feed, self.due, self._ids = effect.feed, effect.due, effect.ids
        self.holds = type(effect).due is not Effect.due
        self._component = fault.component
        self._start_us = round(fault.start_s * 1e6)
        self._duration_us = math.inf if fault.duration_s is None else round(fault.duration_s * 1e6)

    def feed(self, packet: Packet, age_us: int) -> Iterable[Packet]:
        data = packet.data
        if data[:1] == _V2:  # `header`, without a call: every packet of a flight comes here
            sequence, component_id, message_id = (
                data[4],
                data[6],
                data[7] | data[8] << 8 | data[9] << 16,
            )
        elif data[:1] == _V1:
            sequence, component_id, message_id = header(data)
        else:
            return (packet,)
        if self._ids is not None and message_id not in self._ids:
            return (packet,)
        if self._component and component_id != self._component:
            return (packet,)
        since_us = age_us - self._start_us
        return self._feed(
            packet, PacketContext(message_id, sequence, since_us, 0 <= since_us < self._duration_us)
        )


class FaultChain:
    """The faults of one stream; the first in the list acts first, nearest to the vehicle."""

    def __init__(self, faults: Sequence[Fault], seed: int) -> None:
        self._stages = [
            _Stage(
                fault,
                KeyedRandom(
                    seed if fault.seed is None else fault.seed, type(fault).__name__, number
                ),
            )
            for number, fault in enumerate(faults)
        ]
        self._holds = any(stage.holds for stage in self._stages)
        self._origin_us: int | None = None

    def feed(self, packet: Packet) -> list[Packet]:
        """Packets that leave the chain when `packet` enters it."""
        if self._origin_us is None:
            self._origin_us = packet.time_us
        packets = [packet]
        for stage in self._stages:
            if packets:
                packets = self._through(stage, packets)
        return packets

    def due(self, time_us: float) -> list[Packet]:
        """Delayed packets that are due at `time_us`. A live link calls this in every tick;
        ``math.inf`` at the end returns all of them."""
        packets: list[Packet] = []
        if self._holds:
            for stage in self._stages:
                packets = self._through(stage, packets) if packets else packets
                if stage.holds:
                    packets.extend(stage.due(time_us))
        return packets

    def _through(self, stage: _Stage, packets: list[Packet]) -> list[Packet]:
        origin_us = self._origin_us or 0
        found: list[Packet] = []
        for packet in packets:
            if stage.holds:  # packets that were due before it leave first
                found.extend(stage.due(packet.time_us))
            found.extend(stage.feed(packet, packet.time_us - origin_us))
        return found


def apply_faults(
    packets: Iterable[Packet], faults: Sequence[Fault], seed: int = 0
) -> Iterator[Packet]:
    """Apply `faults` to `packets`; return the packets that leave the last fault."""
    stream = FaultChain(faults, seed)
    for packet in packets:
        yield from stream.feed(packet)
    yield from stream.due(math.inf)


def parse_fault(text: str) -> Fault:
    """The fault of a command-line text such as ``drop:start_s=60,duration_s=10``.

    Raises ConfigError, in one line, for a text that describes no fault.
    """
    name, _, rest = text.partition(":")
    if name not in FAULTS:
        guess = difflib.get_close_matches(name, FAULTS, 1)
        raise ConfigError(
            f"--fault {text}: '{name}' is unknown; "
            + (f"did you mean `{guess[0]}`?" if guess else f"give one of {', '.join(FAULTS)}")
        )
    values: dict[str, Any] = {}
    for part in filter(None, rest.split(",")):
        key, equals, value = part.partition("=")
        if not equals or key in values or key == "fault":
            raise ConfigError(
                f"--fault {text}: '{part}' is malformed or repeated; expected key=value"
            )
        values[key] = value
    return validate(values, FAULTS[name], f"--fault {text}")
