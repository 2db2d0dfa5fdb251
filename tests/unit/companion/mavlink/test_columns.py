"""The compiled scan and the columns against the decoder that works one frame at a time."""

import random
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.mavlink.codec import Frame, decode, mavlink, scan
from companion.mavlink.columns import columns, layout, messages, tables
from companion.mavlink.framing import CRC_EXTRA, V1_LENGTHS, mcrf4xx
from companion.mavlink.record_scan import INDEX, scan_records
from companion.samples import Rows, rows

LAST_US = 32_503_680_000_000_000
NUMBERS = sorted(number for number in mavlink.mavlink_map if layout(number) is not None)


def frame(message_id: int, payload: bytes, version: int = 2, signed: bool = False) -> bytes:
    """A frame with a right checksum, whatever its payload."""
    if version == 1:
        body = bytes([len(payload), 7, 1, 2, message_id]) + payload
        start, tail = b"\xfe", b""
    else:
        head = bytes([len(payload), int(signed), 0, 7, 1, 2]) + message_id.to_bytes(3, "little")
        body, start, tail = head + payload, b"\xfd", bytes(13) if signed else b""
    crc = mcrf4xx(body + bytes([CRC_EXTRA[message_id]]))
    return start + body + crc.to_bytes(2, "little") + tail


def indexed(data: bytes) -> Rows:
    index = rows(INDEX, len(data) // 16 + 1)
    array = np.frombuffer(data, np.uint8)
    count, _ = scan_records(array, 0, len(data), LAST_US, 0, 8, *tables(), index, 0)
    return index[:count]


def records(frames: list[bytes]) -> bytes:
    return b"".join(struct.pack(">Q", 1_000 + i) + each for i, each in enumerate(frames))


@pytest.mark.parametrize("message_id", NUMBERS[:: max(1, len(NUMBERS) // 60)])
def test_columns_are_what_pymavlink_decodes(message_id: int) -> None:
    rng = random.Random(message_id)
    size = mavlink.mavlink_map[message_id].unpacker.size
    payloads = [rng.randbytes(size), rng.randbytes(rng.randrange(1, size + 1)), bytes(1)]
    payloads.append(bytes([rng.randrange(1, 256)]) + bytes(size - 1))
    data = records([frame(message_id, payload) for payload in payloads])
    index = indexed(data)
    assert index.size == len(payloads)
    array = np.frombuffer(data, np.uint8)
    light = list(messages(array, index, message_id))
    found = columns(array, index, message_id)
    for i, row in enumerate(index):
        whole = scan(data, int(row["start"]))
        assert isinstance(whole, Frame)
        message = decode(whole)
        assert message is not None
        for name in message.fieldnames:
            expected = getattr(message, name)
            np.testing.assert_array_equal(getattr(light[i], name), expected)
            np.testing.assert_array_equal(found[name][i], expected)


def test_texts_and_arrays_have_no_light_messages() -> None:
    assert layout(mavlink.MAVLINK_MSG_ID_STATUSTEXT) is None
    assert layout(mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR) is None


def test_a_kind_that_is_not_known_has_no_columns() -> None:
    with pytest.raises(KeyError):
        columns(np.zeros(1, np.uint8), rows(INDEX, 1), 65_000)


def test_a_text_is_a_column() -> None:
    number = mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ
    data = records([frame(number, struct.pack("<hBB16s", -1, 7, 191, b"AIR_QNH"))])
    (row,) = columns(np.frombuffer(data, np.uint8), indexed(data), number)
    assert row.tolist() == (-1, 7, 191, b"AIR_QNH")


@settings(deadline=None, max_examples=200)
@given(
    st.lists(
        st.tuples(st.sampled_from(sorted(CRC_EXTRA)), st.integers(0, 255), st.integers(0, 2)),
        min_size=1,
        max_size=6,
    ),
    st.integers(0, 2000),
    st.integers(0, 255),
)
def test_the_scan_stops_where_a_frame_is_none(
    wanted: list[tuple[int, int, int]], place: int, value: int
) -> None:
    frames = []
    for message_id, length, how in wanted:
        version = 1 if how == 0 and message_id < 256 else 2
        size = min(length, V1_LENGTHS[message_id].stop - 1) if version == 1 else length
        frames.append(frame(message_id, bytes(range(size)), version, how == 2))
    data = bytearray(records(frames))
    data[place % len(data)] = value
    index = indexed(bytes(data))
    offset = 0
    for row in index:
        whole = scan(bytes(data), offset + 8)
        assert isinstance(whole, Frame)
        assert int(row["time_us"]) == int.from_bytes(data[offset : offset + 8])
        assert (row["start"], row["stop"]) == (offset + 8, offset + 8 + len(whole.data))
        names = ("message_id", "system_id", "component_id", "sequence", "version", "signed")
        assert tuple(int(row[name]) for name in names) == tuple(map(int, whole[1:7]))
        offset = int(row["stop"])
    if offset < len(data):
        late = int.from_bytes(data[offset : offset + 8]) > LAST_US
        assert late or not isinstance(scan(bytes(data), offset + 8), Frame)
