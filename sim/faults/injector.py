"""The fault injector between a simulated vehicle's port and its link or log."""

from collections.abc import Callable, Sequence

from companion.samples import Packet
from sim.faults import Fault, FaultChain


class FaultInjector:
    """Replaces the delivery of a port: takes frames, applies faults, and delivers packets with
    their arrival times."""

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
        """Send a frame now. The result is True also for a frame that a fault drops or delays."""
        return self._pass(self._stream.feed(Packet(self._now_us(), frame)))

    def due(self, time_us: float) -> None:
        """Deliver the delayed packets that are due at `time_us`."""
        self._pass(self._stream.due(time_us))

    def _pass(self, packets: Sequence[Packet]) -> bool:
        taken = True
        for packet in packets:
            taken &= self._deliver(packet)
        return taken
