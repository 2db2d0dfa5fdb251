"""Faults on the way from a simulated vehicle's port to where it sends."""

from collections.abc import Callable, Sequence

from companion.samples import Packet
from sim.faults import Fault, FaultChain


class FaultInjector:
    """Stands in for a port's delivery: takes frames, hands packets with the time of their arrival
    on."""

    def __init__(
        self,
        faults: Sequence[Fault],
        seed: int,
        now_us: Callable[[], int],
        deliver: Callable[[Packet], bool],
    ) -> None:
        self._stream = FaultChain(faults, seed)
        self._now_us = now_us
        self._deliver = deliver

    def __call__(self, frame: bytes) -> bool:
        """Send a frame now. What a fault lost or holds was sent all the same."""
        return self._pass(self._stream.feed(Packet(self._now_us(), frame)))

    def due(self, time_us: float) -> None:
        """Let go what was held back until now."""
        self._pass(self._stream.due(time_us))

    def _pass(self, packets: Sequence[Packet]) -> bool:
        taken = True
        for packet in packets:
            taken &= self._deliver(packet)
        return taken
