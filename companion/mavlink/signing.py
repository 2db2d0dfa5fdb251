"""MAVLink 2 signing: whether a frame was made by somebody who has the key, and our own time stamps.

A signature is a link id, a time stamp of 48 bits in units of 10 us since 2015, and the first six
bytes of SHA-256 over the key and the frame. A receiver refuses a time stamp that is not newer than
the last of its stream (a sender's system, component and link id), and the first of a stream when it
is more than a minute behind the newest that it has seen: so nobody can repeat a recorded frame.
(Source: the MAVLink guide, "Message Signing".)
"""

import hashlib
import hmac
from collections.abc import Callable

from pydantic import Field
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.config import Settings
from companion.mavlink.framing import SIGNATURE, Frame, FrameReject

KEY_BYTES = 32
TAG_BYTES = 6
UNIT_US = 10
EPOCH_S = 1_420_070_400
"""2015-01-01 as UNIX time"""
LARGEST = (1 << 48) - 1
NEW_STREAM = 60 * 1_000_000 // UNIT_US
"""how far the first time stamp of a stream may be behind the newest of all"""
MOST_STREAMS = 256
UNSIGNED_ALLOWED = frozenset({mavlink.MAVLINK_MSG_ID_RADIO_STATUS, mavlink.MAVLINK_MSG_ID_RADIO})
"""A telemetry radio has no key; what it says of its link is not used for an altitude."""


class SigningSettings(Settings):
    """Section ``signing``: MAVLink 2 message signing."""

    key_file: str | None = Field(None, max_length=4096)
    """file with the signing key, readable by its owner alone, as `kollsman key FILE` makes it; when
    given, every message that we send is signed, and messages that are unsigned, signed with another
    key, or repeated are refused"""
    link_id: int = Field(0, ge=0, le=255)
    """link id in our signatures; programs that share system id, component id and key need different
    ones"""


class Signing:
    """Signs and verifies with one key.

    Parameters
    ----------
    key : 32 bytes.
    wall : the present time as a time stamp of signatures (see `stamp_of`).
    start : our first time stamp is larger than this.
    """

    def __init__(
        self, key: bytes, wall: Callable[[], int], *, link_id: int = 0, start: int = 0
    ) -> None:
        if len(key) != KEY_BYTES:
            raise ValueError(f"a signing key has {KEY_BYTES} bytes, not {len(key)}")
        self.key = key
        self.link_id = link_id
        self.newest = start
        """the newest time stamp sent, or received with a good signature"""
        self._wall = wall
        self._streams: dict[tuple[int, int, int], int] = {}

    def next_stamp(self) -> int:
        """A time stamp that no earlier frame of ours or of our peers has.

        The computer's clock may be wrong: one that is behind goes on from the newest time stamp.
        """
        self.newest = min(max(self.newest + 1, self._wall()), LARGEST)
        return self.newest

    def refusal(self, frame: Frame) -> FrameReject | None:
        """Why `frame` must not be used; None for one that is authentic and new."""
        if not frame.signed:
            return None if frame.message_id in UNSIGNED_ALLOWED else FrameReject.UNSIGNED
        if not hmac.compare_digest(frame.data[-TAG_BYTES:], tag(self.key, frame.data[:-TAG_BYTES])):
            return FrameReject.SIGNATURE
        link_id = frame.data[-SIGNATURE]
        stamp = int.from_bytes(frame.data[1 - SIGNATURE : -TAG_BYTES], "little")
        stream = (frame.system_id, frame.component_id, link_id)
        last = self._streams.pop(stream, self.newest - NEW_STREAM - 1)
        if stamp <= last:
            self._streams[stream] = last
            return FrameReject.REPEATED
        self._streams[stream] = stamp
        if len(self._streams) > MOST_STREAMS:
            del self._streams[next(iter(self._streams))]  # the longest silent
        self.newest = max(self.newest, stamp)
        return None


def tag(key: bytes, data: bytes) -> bytes:
    """The last six bytes of a signed frame: `data` is all of it before them."""
    return hashlib.sha256(key + data).digest()[:TAG_BYTES]


def stamp_of(unix_s: float) -> int:
    """A UNIX time in the unit of signatures, 10 us since 2015; 0 before."""
    return max(0, round((unix_s - EPOCH_S) * 1e6 / UNIT_US))
