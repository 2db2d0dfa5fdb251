"""Clock offset and age of telemetry from TIMESYNC."""

import math
import random

import pytest

from companion.mavlink.codec import mavlink
from companion.timesync import TimeSync

HOST_US = 1_700_000_000_000_000
BOOT_US = 50_000_000
"""the vehicle's clock when the host's is `HOST_US`"""


def exchange(sync: TimeSync, at_us: int, there_us: int, back_us: int, boot_us: int) -> None:
    """A request at `at_us`, and its answer; `boot_us` is the vehicle's clock then."""
    request = sync.poll(HOST_US + at_us)
    assert request is not None
    assert (request.tc1, request.ts1) == (0, (HOST_US + at_us) * 1000)
    answer = mavlink.MAVLink_timesync_message((boot_us + there_us) * 1000, request.ts1)
    sync.take(answer, HOST_US + at_us + there_us + back_us)


def test_the_offset_is_good_to_a_millisecond_under_jitter() -> None:
    sync, luck = TimeSync(), random.Random(1)
    for second in range(60):
        at_us = second * 5_000_000
        there_us, back_us = (5_000 + round(luck.expovariate(1 / 10_000)) for _ in range(2))
        exchange(sync, at_us, there_us, back_us, BOOT_US + at_us)
    assert sync.answered == 60
    age_s = sync.age_s(HOST_US + at_us, BOOT_US + at_us - 300_000)
    assert age_s == pytest.approx(0.3, abs=2e-3)
    assert sync.round_trip_s == pytest.approx(0.0105, abs=4e-3)


def test_a_restart_of_the_vehicle_starts_anew() -> None:
    sync = TimeSync()
    exchange(sync, 0, 1_000, 1_000, BOOT_US)
    exchange(sync, 5_000_000, 40_000, 40_000, 2_000_000)
    assert sync.age_s(HOST_US + 5_000_000, 2_000_000) == pytest.approx(0.0, abs=1e-6)


def test_answers_of_others_are_ignored() -> None:
    sync = TimeSync()
    request = sync.poll(HOST_US)
    assert request is not None
    for tc1, ts1 in ((5, 77), (0, request.ts1), (-5, request.ts1), (5, request.ts1 + 1)):
        sync.take(mavlink.MAVLink_timesync_message(tc1, ts1), HOST_US + 1000)
    assert sync.answered == 0
    assert math.isnan(sync.round_trip_s)
    assert math.isnan(sync.age_s(HOST_US, BOOT_US))
    answer = mavlink.MAVLink_timesync_message(BOOT_US * 1000, request.ts1)
    sync.take(answer, HOST_US + 20_000_000)  # too late to tell anything
    assert sync.answered == 0


def test_requests_are_few() -> None:
    sync = TimeSync()
    times = [at_us for at_us in range(0, 60_000_000, 10_000) if sync.poll(HOST_US + at_us)]
    assert times[:6] == [0, 500_000, 1_000_000, 1_500_000, 2_000_000, 2_500_000]
    assert len(times) == 6 + 11
