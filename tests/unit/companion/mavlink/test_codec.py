"""The codec loses no frame and invents none, whatever surrounds the frames."""

import math
import random
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion.mavlink.codec import (
    MAX_FRAME_SIZE,
    Decoder,
    Encoder,
    Frame,
    FrameReject,
    decode,
    light,
    mavlink,
    scan,
)
from companion.mavlink.framing import mcrf4xx

MESSAGES: list[Any] = [
    mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3),
    mavlink.MAVLink_altitude_message(123_456_789, 1.5, 2.5, 3.5, -4.5, math.nan, math.nan),
    mavlink.MAVLink_debug_message(77, 3, 0.25),
    mavlink.MAVLink_debug_vect_message(b"baro", 55, 1.0, 2.0, 3.0),
    mavlink.MAVLink_named_value_float_message(9, b"kols_sd", 0.5),
    mavlink.MAVLink_debug_float_array_message(5, b"state", 1, [float(i) for i in range(58)]),
    mavlink.MAVLink_statustext_message(6, b"Kollsman: LOST", 0, 0),
    mavlink.MAVLink_raw_imu_message(1, 2, 3, -1000, 4, 5, 6, 7, 8, 9, 1, 2500),
    mavlink.MAVLink_gps_status_message(3, *[list(range(20))] * 5),
]
V1_MESSAGES = [message for message in MESSAGES if message.id <= 255]


def encoded(*, version: int) -> list[bytes]:
    encoder = Encoder(1, 191)
    return [
        encoder.encode(message, version) for message in (MESSAGES if version == 2 else V1_MESSAGES)
    ]


def signed_frame(sequence: int = 0) -> bytes:
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    sender.seq = sequence
    sender.signing.secret_key = b"k" * 32
    sender.signing.sign_outgoing = True
    sender.signing.timestamp = 10**12
    packed: bytes = MESSAGES[1].pack(sender)
    return packed


def with_checksum(body: bytes, extra: int) -> bytes:
    """A frame without its checksum -> with the checksum of a dialect whose CRC_EXTRA is `extra`."""
    return body + mcrf4xx(body[1:] + bytes([extra])).to_bytes(2, "little")


def foreign_frame(payload: bytes, message_id: int = 142) -> bytes:
    extra = (
        mavlink.mavlink_map[message_id].crc_extra ^ 0x55 if message_id in mavlink.mavlink_map else 7
    )
    header = bytes([0xFD, len(payload), 0, 0, 9, 255, 190]) + message_id.to_bytes(3, "little")
    return with_checksum(header + payload, extra)


FRAMES = [*encoded(version=2), *encoded(version=1), signed_frame()]
SHORT = [data for data in FRAMES if len(data) < 60]
frames_st = st.sampled_from(FRAMES)
# Start bytes are common, so that junk often looks like a frame.
junk_st = st.lists(
    st.one_of(st.sampled_from([0xFD, 0xFE, 0x00, 0x09]), st.integers(0, 255)), max_size=40
).map(bytes)


def cut(data: bytes) -> tuple[list[bytes], Decoder]:
    decoder = Decoder()
    return [frame.data for frame in decoder.feed(data) + decoder.flush()], decoder


def differently(data: bytes, sizes: list[int]) -> list[bytes]:
    edges = [0]
    while edges[-1] < len(data):
        edges.append(edges[-1] + sizes[len(edges) % len(sizes)])
    return [data[start:end] for start, end in pairwise(edges)]


@settings(deadline=None)
@given(st.lists(st.tuples(junk_st, frames_st), min_size=1, max_size=8), junk_st)
def test_junk_between_frames_loses_none_and_invents_none(
    parts: list[tuple[bytes, bytes]], tail: bytes
) -> None:
    stream = b"".join(junk + data for junk, data in parts) + tail
    starts = set()
    offset = 0
    for junk, data in parts:
        starts.add(offset + len(junk))
        offset += len(junk) + len(data)
    # Junk that is a frame by its checksum (or another dialect's) cannot be told from one.
    outside = [
        at for at in range(len(stream)) if at not in starts and not _inside(at, starts, stream)
    ]
    assume(not any(isinstance(scan(stream, at), Frame) for at in outside))
    assume(
        not any(scan(stream, at) in (FrameReject.DIALECT, FrameReject.UNKNOWN_ID) for at in outside)
    )
    found, decoder = cut(stream)
    assert found == [data for _, data in parts]
    assert decoder.frames == len(parts)


def _inside(at: int, starts: set[int], stream: bytes) -> bool:
    before = max((start for start in starts if start < at), default=None)
    frame = None if before is None else scan(stream, before)
    return before is not None and isinstance(frame, Frame) and at < before + len(frame.data)


@settings(deadline=None)
@given(
    st.lists(
        st.one_of(junk_st, frames_st, frames_st.map(lambda data: data[: len(data) // 2])),
        max_size=12,
    ),
    st.lists(st.integers(1, 300), min_size=1, max_size=6),
)
def test_chunks_do_not_matter(parts: list[bytes], sizes: list[int]) -> None:
    stream = b"".join(parts)
    whole, chunked = Decoder(), Decoder()
    frames = whole.feed(stream) + whole.flush()
    pieces = [
        frame for chunk in differently(stream, sizes) for frame in chunked.feed(chunk)
    ] + chunked.flush()
    assert pieces == frames
    assert chunked.counters == whole.counters


@pytest.mark.parametrize("data", FRAMES)
def test_every_truncation_waits_and_then_counts(data: bytes) -> None:
    for size in range(1, len(data)):
        decoder = Decoder()
        assert decoder.feed(data[:size]) == []
        assert sum(decoder.counters.values()) == 0
        decoder.flush()
        assert decoder.counters == {FrameReject.TRUNCATED: 1}
        assert [frame.data for frame in decoder.feed(data)] == [data]


@pytest.mark.parametrize("data", SHORT)
def test_every_corruption_of_one_byte_yields_no_wrong_frame(data: bytes) -> None:
    neighbour = FRAMES[0]
    checksum_end = len(data) - (13 if data[0] == 0xFD and data[2] & 1 else 0)
    for at in range(checksum_end):  # a signature is not covered by the checksum
        for flip in (0x01, 0x80, 0xFF):
            damaged = bytearray(data)
            damaged[at] ^= flip
            found, decoder = cut(neighbour + bytes(damaged) + neighbour * 12)
            assert found.count(neighbour) >= 13 - 12 * _is_foreign(bytes(damaged) + neighbour * 12)
            assert set(found) == {neighbour}
            assert sum(decoder.counters.values()) > 0


def _is_foreign(stream: bytes) -> bool:
    """One damaged frame in 256 passes for one of another dialect, and is skipped by its damaged
    length."""
    return scan(stream) in (FrameReject.DIALECT, FrameReject.UNKNOWN_ID)


def test_a_frame_of_another_dialect_hides_its_payload() -> None:
    good = FRAMES[0]
    for message_id in (142, 54_321):
        found, decoder = cut(good + foreign_frame(b"ab" + good + b"c", message_id) + good)
        assert found == [good, good]
        assert decoder.counters == {
            FrameReject.DIALECT if message_id == 142 else FrameReject.UNKNOWN_ID: 1
        }


def test_a_foreign_frame_at_the_end_needs_the_next_byte_but_no_more() -> None:
    decoder = Decoder()
    assert decoder.feed(foreign_frame(b"abc")) == []
    assert len(decoder.feed(FRAMES[0])) == 1
    assert decoder.counters == {FrameReject.DIALECT: 1}


def test_a_stray_start_byte_swallows_nothing() -> None:
    stream = FRAMES[0] * 30
    for stray in (b"\xfd", b"\xfe", b"\xfd\xff\x00\x00", b"\xfe\xff", b"\xfd\xfd\xfd"):
        found, decoder = cut(stray + stream)
        assert len(found) == 30
        assert decoder.counters == {FrameReject.JUNK: len(stray)}


def test_a_stray_start_byte_delays_by_no_more_than_a_frame() -> None:
    decoder = Decoder()
    decoder.feed(b"\xfd\xff\x01\x00")
    sent = 0
    while not (found := decoder.feed(FRAMES[0])):
        sent += len(FRAMES[0])
        assert sent <= MAX_FRAME_SIZE
    assert b"".join(frame.data for frame in found).startswith(FRAMES[0])


def test_flush_sets_waiting_frames_free() -> None:
    decoder = Decoder()
    assert decoder.feed(b"\xfd\xff\x00\x00" + FRAMES[0]) == []
    assert [frame.data for frame in decoder.flush()] == [FRAMES[0]]
    assert decoder.flush() == []


def test_a_cut_datagram_does_not_delay_the_next() -> None:
    decoder = Decoder(datagrams=True)
    assert decoder.feed(FRAMES[1][:-3]) == []
    assert [frame.data for frame in decoder.feed(FRAMES[0])] == [FRAMES[0]]
    assert decoder.counters == {FrameReject.TRUNCATED: 1}


def test_a_damaged_frame_counts_once() -> None:
    damaged = FRAMES[1][:-4] + b"\xfe\xfd" + FRAMES[1][-2:]
    assert scan(damaged) is FrameReject.CRC
    _, decoder = cut(FRAMES[0] + damaged + FRAMES[0] * 30)
    assert decoder.counters == {FrameReject.CRC: 1}


def test_unknown_flags_are_refused() -> None:
    data = bytearray(FRAMES[0])
    data[2] = 0x02
    found, decoder = cut(bytes(data) + FRAMES[0])
    assert found == [FRAMES[0]]
    assert decoder.counters == {FrameReject.FLAGS: 1}


def test_a_mavlink1_frame_of_impossible_length_is_not_ours() -> None:
    data = with_checksum(
        bytes([0xFE, 3, 0, 1, 1, 0]) + b"abc", mavlink.MAVLink_heartbeat_message.crc_extra
    )
    assert scan(data) is FrameReject.DIALECT


def test_noise_makes_no_frames() -> None:
    found, decoder = cut(random.Random(1).randbytes(300_000))
    assert found == []
    assert decoder.counters[FrameReject.JUNK] > 0


def test_frame_fields() -> None:
    encoder = Encoder(42, 191)
    encoder.encode(MESSAGES[0])
    for version in (1, 2):
        frame = scan(encoder.encode(MESSAGES[0], version))
        assert isinstance(frame, Frame)
        assert list(frame[1:7]) == [0, 42, 191, version, version, False]
    frame = scan(b"junk" + signed_frame(7) + b"more", 4)
    assert isinstance(frame, Frame)
    assert tuple(frame) == (signed_frame(7), 141, 1, 1, 7, 2, True, None)


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: str(message.get_type()))
def test_round_trip(message: Any, version: int) -> None:
    data = Encoder(1, 191).encode(message, version)
    if message.id > 255 and version == 1:
        assert data == b""
        return
    frame = scan(data)
    assert isinstance(frame, Frame)
    assert frame.data == data
    got = decode(frame)
    assert got is not None
    extensions = ("id", "temperature") if version == 1 and message.get_type() == "RAW_IMU" else ()
    for name in message.get_fieldnames():
        if name not in extensions:
            assert _same(getattr(got, name), getattr(message, name)), name
    for name in extensions:
        assert getattr(got, name) == 0


def _same(first: Any, second: Any) -> bool:
    if isinstance(first, float) and math.isnan(first):
        return math.isnan(second)
    return bool(first == second)


@pytest.mark.parametrize("version", [1, 2])
def test_every_message_is_framed_as_pymavlink_does(version: int) -> None:
    ours = Encoder(7, 191)
    theirs = mavlink.MAVLink(None, srcSystem=7, srcComponent=191)
    for message_id, kind in mavlink.mavlink_map.items():
        data = b"\xfd\xff" + bytes(8) + bytes(range(1, 256)) + bytes(2)
        message = decode(Frame(data, message_id, 7, 191, 0, 2, signed=False))
        if message is None or "char" in kind.fieldtypes or (version == 1 and message_id > 255):
            continue
        packed = message.pack(theirs, force_mavlink1=version == 1)
        theirs.seq = (theirs.seq + 1) % 256
        data = ours.encode(message, version)
        if len(data) == len(packed):
            assert data == packed
        else:  # pymavlink sends extension fields in MAVLink 1
            assert version == 1
            assert isinstance(scan(data), Frame)


def test_a_light_message_has_the_fields_of_the_whole_one() -> None:
    for data in encoded(version=2) + encoded(version=1):
        frame = scan(data)
        assert isinstance(frame, Frame)
        whole: Any = decode(frame)
        quick: Any = light(frame)
        assert quick.get_type() == whole.get_type()
        for name in whole.get_fieldnames():
            assert repr(getattr(quick, name)) == repr(getattr(whole, name))


def test_sequence_wraps_and_does_not_skip() -> None:
    encoder = Encoder(1, 1)
    sequences = [encoder.encode(MESSAGES[0])[4] for _ in range(300)]
    assert sequences == [number % 256 for number in range(300)]
    assert encoder.encode(MESSAGES[5], version=1) == b""
    assert encoder.encode(MESSAGES[0])[4] == 300 % 256


@settings(deadline=None)
@given(
    st.sampled_from(sorted(mavlink.mavlink_map)), st.binary(max_size=255), st.sampled_from([1, 2])
)
def test_decodes_any_payload_as_pymavlink_does(
    message_id: int, payload: bytes, version: int
) -> None:
    if version == 1:
        assume(message_id <= 255)
        body = bytes([0xFE, len(payload), 3, 1, 1, message_id]) + payload
    else:
        body = (
            bytes([0xFD, len(payload), 0, 0, 3, 1, 1]) + message_id.to_bytes(3, "little") + payload
        )
    data = with_checksum(body, mavlink.mavlink_map[message_id].crc_extra)
    frame = Frame(data, message_id, 1, 1, 3, version, False)
    ours, theirs = decode(frame), mavlink.MAVLink(None).decode(bytearray(data))
    assert ours is not None
    assert repr(ours.to_dict()) == repr(theirs.to_dict())  # repr: NaN is NaN
    assert vars(ours.get_header()) == vars(theirs.get_header())
    assert ours.get_crc() == theirs.get_crc()
    assert bytes(ours.get_msgbuf()) == bytes(theirs.get_msgbuf())


def test_parses_a_stream_as_pymavlink_does() -> None:
    choose = random.Random(3)
    stream = b"".join(choose.choice(FRAMES) for _ in range(500))
    receiver = mavlink.MAVLink(None)
    theirs = [bytes(message.get_msgbuf()) for message in receiver.parse_buffer(stream)]
    assert cut(stream)[0] == theirs


def test_a_payload_that_pymavlink_refuses_is_counted() -> None:
    decoder = Decoder()
    assert decoder.decode(Frame(FRAMES[0], 54_321, 1, 1, 0, 2, False)) is None
    assert decoder.counters == {FrameReject.DECODE: 1}
