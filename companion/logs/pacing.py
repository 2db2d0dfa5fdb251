"""Giving packets of a log their time back."""

import math
from collections.abc import Iterable, Iterator

from companion.clock import Clock
from companion.samples import Packet


def paced(
    packets: Iterable[Packet], clock: Clock, speed: float = 1.0, max_gap_s: float = 5.0
) -> Iterator[Packet]:
    """`packets`, each handed out when `clock` says that its time has come.

    `speed` 2 plays twice as fast, ``math.inf`` without waiting. A step of the log's time of more
    than `max_gap_s` counts as `max_gap_s`, a step back as none. A consumer that falls behind is not
    held up until it has caught up.

    Raises ValueError unless speed > 0.
    """
    if not speed > 0.0:
        raise ValueError(f"speed must be positive, not {speed}")
    return iter(packets) if math.isinf(speed) else _paced(packets, clock, speed, max_gap_s)


def _paced(
    packets: Iterable[Packet], clock: Clock, speed: float, max_gap_s: float
) -> Iterator[Packet]:
    start_us = clock.now_us()
    played_us = 0  # of the log's time, gaps shortened
    last_us: int | None = None
    for packet in packets:
        if last_us is not None:
            played_us += max(0, min(packet.time_us - last_us, round(max_gap_s * 1e6)))
        last_us = packet.time_us
        clock.sleep_s((start_us + played_us / speed - clock.now_us()) * 1e-6)
        yield packet
