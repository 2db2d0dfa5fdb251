"""What a vehicle said in a session beside its sensors: flight modes and texts."""

import itertools
import os
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from companion.mavlink.codec import Frame, Message, mavlink
from companion.mavlink.radio import RADIOS, Radio, radio_of
from companion.recorded import Batch

if TYPE_CHECKING:
    from companion.pipeline import Pipeline

MOST_TEXTS = 2000
LATEST = 128
"""A sequence number further ahead is a late or repeated frame, or a restart of its sender."""


class Events:
    """Listens to the vehicle's HEARTBEAT and STATUSTEXT; times are of the vehicle's clock."""

    def __init__(self, pipeline: "Pipeline") -> None:
        self._pipeline = pipeline
        self._beats: list[tuple[int, Message]] = []
        """those that changed the mode"""
        self._modes: list[tuple[int, str]] | None = None
        self.texts: list[tuple[int, str]] = []
        """(time_us, what the vehicle said)"""
        pipeline.listen(mavlink.MAVLINK_MSG_ID_HEARTBEAT, self._heartbeat)
        pipeline.listen(mavlink.MAVLINK_MSG_ID_STATUSTEXT, self._text)

    def _heartbeat(self, message: Message) -> None:
        newest = self._beats[-1][1] if self._beats else None
        if self._pipeline.now_us >= 0 and (newest is None or _mode(newest) != _mode(message)):
            self._beats.append((self._pipeline.now_us, message))

    def _text(self, message: Message) -> None:
        if len(self.texts) < MOST_TEXTS and self._pipeline.now_us >= 0:
            text = message.text
            plain = text if isinstance(text, str) else bytes(text).decode("utf-8", "replace")
            self.texts.append((self._pipeline.now_us, plain.rstrip("\0")))

    def recorded(self, modes: Iterable[tuple[int, str]], texts: Iterable[tuple[int, str]]) -> None:
        """Take the modes and texts of an autopilot's own log, (time_us, text) each."""
        self._modes = list(modes)
        self.texts = list(itertools.islice(texts, MOST_TEXTS))

    @property
    def modes(self) -> list[tuple[int, str]]:
        """(time_us, flight mode) at each change."""
        if self._modes is not None:
            return self._modes
        named = ((time_us, mode_name(message)) for time_us, message in self._beats)
        return [each for each in named if each[1]]


def _mode(heartbeat: Message) -> tuple[int, int]:
    is_custom = heartbeat.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    return is_custom, heartbeat.custom_mode


def mode_name(heartbeat: Message) -> str:
    """The flight mode in a HEARTBEAT, such as "AUTO"; empty where it names none."""
    os.environ.setdefault("MAVLINK_DIALECT", "ardupilotmega")  # the images hold no other
    from pymavlink import mavutil

    if not heartbeat.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return ""
    if heartbeat.autopilot == mavlink.MAV_AUTOPILOT_PX4:
        return str(mavutil.interpret_px4_mode(heartbeat.base_mode, heartbeat.custom_mode))
    modes = mavutil.mode_mapping_bynumber(heartbeat.type) or {}
    return str(modes.get(heartbeat.custom_mode, f"mode {heartbeat.custom_mode}"))


class LinkQuality:
    """Frames of each sender that arrived, and that are missing by sequence number, in each second
    of the log's clock; what the telemetry radio reports."""

    def __init__(self) -> None:
        self._seconds: dict[tuple[int, int], dict[int, list[int]]] = {}
        self._sequence: dict[tuple[int, int], int] = {}
        self.radio: list[tuple[int, Radio]] = []
        """(time_us of the log's clock, report)"""

    def take(self, time_us: int, frame: Frame) -> None:
        """Count a frame; `time_us` is when it arrived."""
        sender = frame.system_id, frame.component_id
        before = self._sequence.get(sender)
        gap = 0 if before is None else (frame.sequence - before - 1) % 256
        self._sequence[sender] = frame.sequence
        counts = self._seconds.setdefault(sender, {}).setdefault(time_us // 1_000_000, [0, 0])
        counts[0] += 1
        counts[1] += gap if gap < LATEST else 0
        if frame.message_id in RADIOS and (radio := radio_of(frame)) is not None:
            self.radio.append((time_us, radio))

    def take_block(self, batch: Batch) -> None:
        """Count the frames of a batch."""
        index = np.asarray(batch.index)
        numbers = np.asarray(index["system_id"], np.int64) * 256 + index["component_id"]
        for place in np.flatnonzero(np.isin(index["message_id"], list(RADIOS))).tolist():
            if (radio := radio_of(batch.frame(place))) is not None:
                self.radio.append((int(index["time_us"][place]), radio))
        for number in np.flatnonzero(np.bincount(numbers)).tolist():
            sender = number // 256, number % 256
            where = np.flatnonzero(numbers == number)
            sequence = index["sequence"][where].astype(np.int64)
            before = self._sequence.get(sender, int(sequence[0]) - 1)
            gaps = np.diff(sequence, prepend=before) - 1
            gaps %= 256
            gaps[gaps >= LATEST] = 0
            self._sequence[sender] = int(sequence[-1])
            seconds, places = in_seconds(index["time_us"][where])
            frames, lost = np.bincount(places), np.bincount(places, gaps)
            counts = self._seconds.setdefault(sender, {})
            for second, count, missing in zip(seconds, frames.tolist(), lost.tolist(), strict=True):
                counted = counts.setdefault(second, [0, 0])
                counted[0] += count
                counted[1] += int(missing)

    def of(self, sender: tuple[int, int] | None) -> list[tuple[int, int, int]]:
        """(second of the log's clock, frames, lost frames) of a system and component."""
        counts = self._seconds.get(sender, {}) if sender is not None else {}
        return [(second, frames, lost) for second, (frames, lost) in sorted(counts.items())]


def in_seconds(times_us: NDArray[np.int64]) -> tuple[list[int], NDArray[np.int64]]:
    """The seconds in which there are times, and of each time the place of its second among them."""
    if not times_us.size:
        return [], np.zeros(0, np.int64)
    seconds = times_us // 1_000_000
    new = np.flatnonzero(np.diff(seconds, prepend=seconds[0] - 1))
    if np.all(np.diff(seconds) >= 0):  # as nearly always
        return seconds[new].tolist(), np.repeat(np.arange(new.size), np.diff([*new, seconds.size]))
    found, places = np.unique(seconds, return_inverse=True)
    return found.tolist(), places
