"""Quality of a link: lost frames and jitter of each sender, and rejects by reason."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache

from companion.mavlink.codec import Frame, mavlink
from companion.mavlink.framing import V1_HEADER, V2_HEADER
from companion.mavlink.radio import RADIOS, Radio, radio_of

MOST_SENDERS = 64
LATEST = 128
"""Largest gap of sequence numbers that counts as loss; beyond it the frame is late or repeated, or
its sender restarted."""
JITTER_GAIN = 1 / 16
"""gain of the running mean of RFC 3550, section 6.4.1"""


@dataclass
class Sender:
    """One system and component on one link."""

    frames: int = 0
    lost: int = 0
    """frames missing by sequence number"""
    jitter_s: float = 0.0
    """mean deviation of the transit time (RFC 3550); 0 while no message tells the time"""
    _next: int | None = None
    """sequence number of its next frame"""
    _transit_us: dict[int, int] = field(default_factory=dict)

    def take(self, frame: Frame, now_us: int) -> None:
        """Count a frame that arrived at `now_us` on the host's clock."""
        self.frames += 1
        message_id, sequence = frame.message_id, frame.sequence
        if sequence != self._next and self._next is not None:
            gap = (sequence - self._next) % 256
            self.lost += gap if gap < LATEST else 0
        self._next = (sequence + 1) % 256
        if not _starts_with_boot_ms(message_id):
            return
        transit_us = now_us - _boot_ms(frame) * 1000
        before_us = self._transit_us.get(message_id)
        self._transit_us[message_id] = transit_us
        if before_us is not None and abs(transit_us - before_us) < 10_000_000:  # else a restart
            deviation_s = abs(transit_us - before_us) * 1e-6
            self.jitter_s += (deviation_s - self.jitter_s) * JITTER_GAIN

    @property
    def loss(self) -> float:
        """Share of the frames that did not arrive; NaN before the first."""
        total = self.frames + self.lost
        return self.lost / total if total else math.nan


class Traffic:
    """The senders heard on one link."""

    def __init__(self) -> None:
        self.senders: dict[tuple[int, int], Sender] = {}
        self.radio: tuple[Radio, int] | None = None
        """the newest report of a telemetry radio, and when it arrived on the host's clock"""

    def take(self, frames: Iterable[Frame], now_us: int) -> None:
        """Count frames that arrived together."""
        for frame in frames:
            ids = (frame.system_id, frame.component_id)
            sender = self.senders.get(ids)
            if sender is None:
                if len(self.senders) >= MOST_SENDERS:
                    continue
                sender = self.senders[ids] = Sender()
            sender.take(frame, now_us)
            if frame.message_id in RADIOS:
                radio = radio_of(frame)
                self.radio = (radio, now_us) if radio is not None else self.radio

    def as_dict(self) -> dict[str, dict[str, float]]:
        """For reports: ``"1/1": {frames, lost, jitter_s}``."""
        return {
            f"{system}/{component}": {
                "frames": sender.frames,
                "lost": sender.lost,
                "jitter_s": round(sender.jitter_s, 4),
            }
            for (system, component), sender in sorted(self.senders.items())
        }

    def __str__(self) -> str:
        parts = [
            f"{system}/{component} {100 * sender.loss:.1f} % lost, jitter "
            f"{1000 * sender.jitter_s:.0f} ms"
            for (system, component), sender in sorted(self.senders.items())
        ]
        return "; ".join(parts) or "nobody heard"


@cache
def _starts_with_boot_ms(message_id: int) -> bool:
    kind = mavlink.mavlink_map[message_id]
    return bool(kind.ordered_fieldnames[0] == "time_boot_ms")


def _boot_ms(frame: Frame) -> int:
    """``time_boot_ms`` of a message that has it first on the wire."""
    head = V2_HEADER if frame.version == 2 else V1_HEADER
    return int.from_bytes(frame.data[head : head + min(4, frame.data[1])], "little")
