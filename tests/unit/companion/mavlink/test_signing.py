"""MAVLink 2 signing against pymavlink's implementation."""

import hashlib
import itertools
import math

import pytest

from companion.mavlink.codec import Decoder, Encoder, Frame, FrameReject, mavlink
from companion.mavlink.outputs import altitude_message
from companion.mavlink.signing import LARGEST, NEW_STREAM, Signing, stamp_of
from tests.vehicle import Vehicle, attitude, heartbeat

KEY = hashlib.sha256(b"a passphrase").digest()
OTHER = hashlib.sha256(b"another one").digest()
NOW = stamp_of(1_760_000_000.0)


def signing(now: int = NOW, start: int = 0) -> Signing:
    return Signing(KEY, lambda: now, start=start)


def signed(key: bytes = KEY, stamp: int = NOW, *, ids: tuple[int, int] = (1, 1)) -> Frame:
    """A frame that pymavlink has signed."""
    vehicle = Vehicle(*ids, key=key)
    vehicle._mav.signing.timestamp = stamp
    (frame,) = Decoder(datagrams=True).feed(vehicle.pack(attitude(30.0)))
    return frame


def pymavlink_receiver(key: bytes = KEY, newest: int = 0) -> mavlink.MAVLink:
    receiver = mavlink.MAVLink(None)
    receiver.robust_parsing = True  # what is refused is BAD_DATA
    receiver.signing.secret_key, receiver.signing.timestamp = key, newest
    return receiver


def test_pymavlink_accepts_what_we_sign() -> None:
    encoder, receiver = Encoder(1, 191, signing()), pymavlink_receiver(newest=NOW)
    for _ in range(3):  # each with a newer time stamp, though the clock stands still
        frame = encoder.encode(heartbeat(), version=1)
        (message,) = receiver.parse_buffer(bytearray(frame))
        assert message.get_type() == "HEARTBEAT"
    assert receiver.signing.goodsig_count == 3


def test_a_light_message_is_signed_as_any_other() -> None:
    """Our ALTITUDE is one."""
    heights = (5_000_000, 1.0, 501.25, 2.0, 3.0, math.nan, math.nan)
    light = altitude_message(heights[:-1])
    frame = Encoder(1, 191, signing()).encode(light)
    (message,) = pymavlink_receiver(newest=NOW).parse_buffer(bytearray(frame))
    assert (message.time_usec, message.altitude_amsl) == (5_000_000, 501.25)
    assert (message.altitude_local, message.altitude_relative) == (2.0, 3.0)


def test_we_accept_what_pymavlink_signs() -> None:
    made, vehicle = signing(), Vehicle(key=KEY)
    vehicle._mav.signing.timestamp = NOW
    for boot_s in (30.0, 30.1, 30.2):
        (frame,) = Decoder(datagrams=True).feed(vehicle.pack(attitude(boot_s)))
        assert made.refusal(frame) is None


def test_another_key_and_a_changed_byte_are_refused() -> None:
    good = signed()
    assert signing().refusal(signed(OTHER)) is FrameReject.SIGNATURE
    for index in range(1, len(good.data)):  # the start byte is not covered, and cannot differ
        bad = bytearray(good.data)
        bad[index] ^= 1
        forged = good._replace(data=bytes(bad))
        assert signing().refusal(forged) is FrameReject.SIGNATURE


def test_unsigned_is_refused_except_from_a_radio() -> None:
    (frame,) = Decoder(datagrams=True).feed(Vehicle().pack(heartbeat()))
    assert signing().refusal(frame) is FrameReject.UNSIGNED
    radio = mavlink.MAVLink_radio_status_message(0, 0, 0, 0, 0, 0, 0)
    (frame,) = Decoder(datagrams=True).feed(Vehicle(51, 68).pack(radio))
    assert signing().refusal(frame) is None


def test_a_repeated_frame_is_refused_and_a_bad_one_does_not_move_the_stream() -> None:
    made = signing()
    first, forged, second = signed(stamp=NOW), signed(OTHER, NOW + 1000), signed(stamp=NOW + 1)
    assert made.refusal(first) is None
    assert made.refusal(first) is FrameReject.REPEATED
    assert made.refusal(forged) is FrameReject.SIGNATURE
    assert made.refusal(second) is None
    assert made.refusal(signed(stamp=NOW, ids=(1, 2))) is None  # a stream of its own


def test_the_first_of_a_stream_may_be_a_minute_old() -> None:
    assert signing(start=NOW).refusal(signed(stamp=NOW - NEW_STREAM)) is None
    late = signed(stamp=NOW - NEW_STREAM - 1)
    assert signing(start=NOW).refusal(late) is FrameReject.REPEATED


def test_a_clock_that_is_behind_follows_the_vehicle() -> None:
    """A computer without a clock module that starts in 1970: our first frame is refused, and
    those after the first of the vehicle are taken."""
    made = signing(now=0)
    receiver = pymavlink_receiver(newest=NOW)
    encoder = Encoder(1, 191, made)
    (refused,) = receiver.parse_buffer(bytearray(encoder.encode(heartbeat())))
    assert refused.get_type() == "BAD_DATA"
    assert made.refusal(signed(stamp=NOW)) is None
    (taken,) = receiver.parse_buffer(bytearray(encoder.encode(heartbeat())))
    assert taken.get_type() == "HEARTBEAT"


def test_stamps_only_grow() -> None:
    times = iter([NOW, NOW - 10_000_000, NOW + 5, NOW + 5, LARGEST + 9])
    made = Signing(KEY, lambda: next(times), start=NOW - 1)
    stamps = [made.next_stamp() for _ in range(4)]
    assert all(later > earlier for earlier, later in itertools.pairwise(stamps))
    assert made.next_stamp() == LARGEST


def test_a_key_has_32_bytes() -> None:
    with pytest.raises(ValueError, match="32 bytes"):
        Signing(b"short", lambda: 0)
