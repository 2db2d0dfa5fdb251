"""What is heard on a link, by sender and message: counts, rates, gaps, last values; for
`doctor`."""

from collections import Counter
from collections.abc import Hashable
from dataclasses import dataclass, field

from companion.clock import Clock
from companion.links import Link, LinkState
from companion.links.base import HasFileno
from companion.mavlink.codec import Decoder, Frame, Message, decode, mavlink

TEXT_SAMPLE_BYTES = 4096
HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
COMMAND_ACK = mavlink.MAVLINK_MSG_ID_COMMAND_ACK
SET_MESSAGE_INTERVAL = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL

Speaker = tuple[int, int]
"""system and component id"""


@dataclass
class Stream:
    """One message of one sender."""

    count: int = 0
    times_us: list[int] = field(default_factory=list)
    """host's time of arrival"""
    last: Message | None = None
    boot_ms: list[int] = field(default_factory=list)
    """``time_boot_ms`` of each, where the message has one"""


@dataclass
class Sender:
    """The messages of one sender."""

    streams: dict[int, Stream] = field(default_factory=dict)
    version: int = 1
    signed: int = 0
    frames: int = 0
    lost: int = 0
    """frames missing by sequence number"""
    _sequence: int | None = None

    @property
    def heartbeat(self) -> Message | None:
        """Its last HEARTBEAT."""
        stream = self.streams.get(HEARTBEAT)
        return stream.last if stream is not None else None

    def take(self, frame: Frame, message: Message | None, now_us: int) -> None:
        self.frames += 1
        self.version = max(self.version, frame.version)
        self.signed += frame.signed
        if self._sequence is not None:
            gap = (frame.sequence - self._sequence - 1) % 256
            self.lost += gap if gap < 128 else 0  # else a late or repeated frame
        self._sequence = frame.sequence
        stream = self.streams.setdefault(frame.message_id, Stream())
        stream.count += 1
        stream.times_us.append(now_us)
        stream.last = message if message is not None else stream.last
        boot_ms = getattr(message, "time_boot_ms", None)
        if boot_ms is not None:
            stream.boot_ms.append(boot_ms)


class Hearing:
    """A link that keeps what it receives.

    Parameters
    ----------
    link : the link that is listened to.
    """

    def __init__(self, link: Link, clock: Clock) -> None:
        self._link = link
        self.url = link.url
        self.statistics = link.statistics
        self.source: Hashable = None
        self.bytes_per_s = link.bytes_per_s
        self._clock = clock
        self.started_us = clock.now_us()
        self.decoder = Decoder()
        self.senders: dict[Speaker, Sender] = {}
        self.refused: Counter[str] = Counter()
        """results of SET_MESSAGE_INTERVAL other than accepted"""
        self.text = b""
        """the first bytes heard"""

    @property
    def state(self) -> LinkState:
        return self._link.state

    def trust(self) -> None:
        """What was received last was MAVLink."""
        self._link.trust()

    def receive(self, timeout_s: float) -> bytes:
        data = self._link.receive(timeout_s)
        self.source = self._link.source
        now_us = self._clock.now_us()
        if len(self.text) < TEXT_SAMPLE_BYTES:
            self.text += data[:TEXT_SAMPLE_BYTES]
        for frame in self.decoder.feed(data):
            message = decode(frame)
            speaker = (frame.system_id, frame.component_id)
            self.senders.setdefault(speaker, Sender()).take(frame, message, now_us)
            if frame.message_id == COMMAND_ACK and message is not None:
                self._acknowledged(message)
        return data

    def descriptors(self) -> list[HasFileno]:
        return self._link.descriptors()

    def send(self, data: bytes) -> bool:
        return self._link.send(data)

    def close(self) -> None:
        self._link.close()

    def duration_s(self) -> float:
        """How long this has listened."""
        return max(1e-3, (self._clock.now_us() - self.started_us) * 1e-6)

    def rate_hz(self, speaker: Speaker, message_id: int) -> float:
        """Rate of a message in the second half of the time: after requests took effect."""
        stream = self.senders[speaker].streams.get(message_id) if speaker in self.senders else None
        if stream is None:
            return 0.0
        half_s = self.duration_s() / 2
        since_us = self._clock.now_us() - round(half_s * 1e6)
        return sum(when >= since_us for when in stream.times_us) / half_s

    def last(self, speaker: Speaker, message_id: int) -> Message | None:
        """The newest message of this kind, if one was heard."""
        sender = self.senders.get(speaker)
        stream = sender.streams.get(message_id) if sender is not None else None
        return stream.last if stream is not None else None

    def _acknowledged(self, message: Message) -> None:
        if message.command == SET_MESSAGE_INTERVAL and message.result not in (0, 5):
            name = mavlink.enums["MAV_RESULT"][message.result].name.removeprefix("MAV_RESULT_")
            self.refused[name] += 1
