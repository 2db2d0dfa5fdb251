"""Plans of plain messages give what the converters give, bit for bit."""

import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.intake.clock_steps import LARGEST_STAMP_US
from companion.mavlink.codec import Encoder, light, mavlink, scan
from companion.mavlink.convert import CONVERTERS, raw_imu
from companion.mavlink.framing import CRC_TABLE
from companion.mavlink.plain import PLAIN, plans
from companion.mavlink.plain_steps import MOST_FIELDS, find, is_plain, read, stamp_of

SCALE = 9.80665e-3
PLACES, PLANS = plans(SCALE)


def plain(data: bytes) -> tuple[int, list[float]] | None:
    """(stamp, values) by the plan; None for another message, or one with a second sample."""
    frame = np.frombuffer(data, np.uint8).copy()
    place = find(frame, 1, 1, PLACES, PLANS, np.array(CRC_TABLE))
    if place < 0:
        return None
    plan, bits, values = PLANS[place : place + 1], np.zeros(1, np.uint32), np.zeros(MOST_FIELDS)
    if not is_plain(frame, plan, bits, bits.view(np.float32)):
        return None
    read(frame, plan, bits, bits.view(np.float32), values)
    return int(stamp_of(frame, plan)), values[: int(plan["count"][0])].tolist()


def flat(values: Any) -> list[float]:
    return [x for v in values for x in (v if isinstance(v, tuple) else (v,))]


@settings(deadline=None, max_examples=100)
@given(message_id=st.sampled_from(PLAIN), payload=st.binary(min_size=64, max_size=64))
def test_values_and_stamps_are_those_of_the_converters(message_id: int, payload: bytes) -> None:
    kind = mavlink.mavlink_map[message_id]
    fields = kind.unpacker.unpack(payload[: kind.unpacker.size])
    message = kind(*(fields[order] for order in kind.orders))
    data = Encoder(1, 1).encode(message)
    frame: Any = scan(data)
    told = light(frame)
    is_raw = message_id == mavlink.MAVLINK_MSG_ID_RAW_IMU
    readings = raw_imu(told, SCALE) if is_raw else CONVERTERS[message_id](told)

    found = plain(data)

    if len(readings) > 1:
        assert found is None
        return
    assert found is not None
    stamp_us, values = found
    assert stamp_us == min(readings[0].stamp_us, LARGEST_STAMP_US)
    wanted = flat(readings[0].values)[: len(values)]
    same = [
        struct.pack("<d", a) == struct.pack("<d", b) or (math.isnan(a) and math.isnan(b))
        for a, b in zip(values, wanted, strict=True)
    ]
    assert all(same), (values, wanted)


def test_only_whole_unsigned_undamaged_frames_of_the_vehicle_have_a_plan() -> None:
    message = mavlink.MAVLink_attitude_message(1, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0)
    data = Encoder(1, 1).encode(message)
    assert plain(data) is not None
    damaged = bytearray(data)
    damaged[12] ^= 1
    others = (
        bytes(damaged),
        data[:-1],
        data + b"\0",
        Encoder(1, 2).encode(message),
        Encoder(2, 1).encode(message),
        Encoder(1, 1).encode(message, version=1),
        Encoder(1, 1).encode(mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 3, 3)),
        b"",
    )
    for other in others:
        assert plain(other) is None


@pytest.mark.parametrize(("scale", "without"), [(None, ()), (SCALE, PLAIN)])
def test_a_message_without_a_plan(scale: float | None, without: tuple[int, ...]) -> None:
    places, _ = plans(scale, without)
    assert places[mavlink.MAVLINK_MSG_ID_RAW_IMU] == -1
