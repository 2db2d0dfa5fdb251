"""Pacing on a manual clock."""

import math
from itertools import pairwise

import pytest

from companion.clock import ManualClock
from companion.logs.pacing import paced
from companion.samples import Packet

SECOND = 1_000_000


def played_s(times_s: list[float], speed: float = 1.0, **options: float) -> list[float]:
    """When each packet of a log comes out, in seconds after the first."""
    clock = ManualClock()
    start_us = clock.now_us()
    packets = [Packet(round(time * SECOND), b"x") for time in times_s]
    return [
        round((clock.now_us() - start_us) / SECOND, 6)
        for _ in paced(packets, clock, speed, **options)
    ]


def test_keeps_the_rhythm() -> None:
    assert played_s([100.0, 100.5, 102.0]) == [0.0, 0.5, 2.0]


def test_speed() -> None:
    assert played_s([0.0, 1.0, 3.0], speed=4.0) == [0.0, 0.25, 0.75]
    assert played_s([0.0, 1.0], speed=0.5) == [0.0, 2.0]


def test_infinite_speed_does_not_wait() -> None:
    assert played_s([0.0, 1.0, 1e6], speed=math.inf) == [0.0, 0.0, 0.0]


def test_gaps_are_shortened_and_steps_back_ignored() -> None:
    assert played_s([0.0, 3600.0, 3601.0]) == [0.0, 5.0, 6.0]
    assert played_s([0.0, 3600.0], max_gap_s=2.0) == [0.0, 2.0]
    assert played_s([1000.0, 1001.0, 0.0, 1.0]) == [0.0, 1.0, 1.0, 2.0]


def test_rounding_does_not_add_up() -> None:
    times = played_s([index / 400 for index in range(4001)], speed=3.0)
    assert times[-1] == pytest.approx(10.0 / 3.0, abs=2e-6)
    assert all(later >= earlier for earlier, later in pairwise(times))


def test_a_late_consumer_catches_up() -> None:
    clock = ManualClock()
    start_us = clock.now_us()
    times = []
    for packet in paced([Packet(index * SECOND, b"x") for index in range(5)], clock):
        times.append((clock.now_us() - start_us) / SECOND)
        if packet.time_us == SECOND:
            clock.advance_s(2.5)
    assert times == [0.0, 1.0, 3.5, 3.5, 4.0]


def test_hands_packets_on_unchanged_and_reads_no_further_than_asked() -> None:
    source = iter([Packet(0, b"a"), Packet(1, b"b"), Packet(2, b"c")])
    player = paced(source, ManualClock())
    assert next(player) == Packet(0, b"a")
    assert next(source) == Packet(1, b"b")


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan])
def test_refuses_a_speed_that_is_none(speed: float) -> None:
    with pytest.raises(ValueError, match="speed"):
        paced([], ManualClock(), speed)
