"""A log on the live page: `kollsman replay LOG --http`.

The page shows what it would show of the vehicle in flight. Times, ages and rates are those of the
log, so they are the same at every speed. The player stands where a replay writes its frames, one
after the other, and waits there until each is due; it changes no result.
"""

import math
import time
from collections import Counter, deque
from collections.abc import Callable
from pathlib import Path

from companion.links.base import LinkState
from companion.links.traffic import Traffic
from companion.mavlink.codec import Frame, decode, mavlink, scan
from companion.pipeline import Pipeline
from companion.replay.merged import Writer
from companion.replay.record import Recording
from companion.settings import CompanionSettings
from companion.status import KEPT_TEXTS, Text
from companion.web.board import Board
from companion.web.snapshot import Snapshots

LONGEST_WAIT_S = 5.0
"""A gap in the log is not waited for longer than this in log time."""
NAP_S = 0.05
STATUSTEXT: int = mavlink.MAVLINK_MSG_ID_STATUSTEXT
ALTITUDE: int = mavlink.MAVLINK_MSG_ID_ALTITUDE


class LogClock:
    """The log's time: that of the newest frame, and on from there at the pace of the replay.

    Parameters
    ----------
    speed : seconds of the log in a real second; infinite: as fast as possible.
    """

    def __init__(
        self,
        speed: float,
        monotonic_s: Callable[[], float] = time.monotonic,
        sleep_s: Callable[[float], None] = time.sleep,
    ) -> None:
        self.speed = speed
        self._monotonic_s, self._sleep_s = monotonic_s, sleep_s
        self._now_us = 0
        self._anchor: tuple[int, float] | None = None
        """a time of the log, and when it is due"""

    def now_us(self) -> int:
        """Microseconds; never goes back."""
        return self._now_us

    def sleep_s(self, duration_s: float) -> None:
        """Nothing waits for the log but `reach`."""

    def reach(self, time_us: int, meanwhile: Callable[[], None]) -> None:
        """Wait until `time_us` of the log is due; `meanwhile` is called again and again."""
        if math.isfinite(self.speed):
            while (now_us := self._due_us(time_us)) < time_us:
                self._now_us = max(self._now_us, now_us)
                meanwhile()
                self._sleep_s(min(NAP_S, (time_us - now_us) * 1e-6 / self.speed))
        self._now_us = max(self._now_us, time_us)

    def _due_us(self, time_us: int) -> int:
        """The time of the log that is due now. After a gap or a step of the stamps it begins anew
        at `time_us`."""
        real_s = self._monotonic_s()
        if self._anchor is not None:
            due_us = self._anchor[0] + round((real_s - self._anchor[1]) * self.speed * 1e6)
            if abs(time_us - due_us) <= LONGEST_WAIT_S * max(1.0, self.speed) * 1e6:
                return due_us
        self._anchor = time_us, real_s
        return time_us


class _Log:
    """What stands in place of a link."""

    def __init__(self, path: Path) -> None:
        self.url = str(path)
        self.state = LinkState.OPEN


class Player:
    """Shows the first vehicle of a log on a board, session after session.

    Parameters
    ----------
    path : the log.
    onward : gets the frames too.
    """

    def __init__(
        self,
        path: Path,
        board: Board,
        settings: CompanionSettings,
        clock: LogClock,
        onward: Writer | None = None,
    ) -> None:
        self.link, self.clock, self.settings = _Log(path), clock, settings
        self.number = 0
        """of the session, from 1"""
        self.published = self.sent_frames = self.heard_frames = self.outdated = 0
        self.problems: list[str] = []
        self.texts: deque[Text] = deque(maxlen=KEPT_TEXTS)
        self.pipeline: Pipeline
        self._board, self._onward = board, onward
        self._traffic = Traffic()
        self._snapshots: Snapshots | None = None

    def observe(self, pipeline: Pipeline) -> Recording:
        """The observer of a new session, which is shown from now on."""
        self.pipeline = pipeline
        self.number += 1
        self._snapshots = None
        return Recording(pipeline)

    def write(self, time_us: int, frame: bytes) -> None:
        """Take a frame of the log or of ours; wait until it is due, and show the state."""
        if self._onward is not None:
            self._onward.write(time_us, frame)
        if self._snapshots is None:
            self.clock.reach(time_us, lambda: None)
            self._snapshots = Snapshots(self, self._board, "replay", self.number)
        self.clock.reach(time_us, self._snapshots.poll)
        found = scan(frame)
        if isinstance(found, Frame):
            self._take(found)
        self._snapshots.poll()

    def end(self) -> None:
        """The log has ended: its last state stays."""
        if self._snapshots is not None:
            self._board.put(self._snapshots.take(self.clock.now_us()))
        self._board.end()

    def traffic(self) -> dict[str, Traffic]:
        """The senders in the log."""
        return {self.link.url: self._traffic}

    def rejected(self) -> dict[str, int]:
        """Bad input by cause."""
        counters = Counter(self.pipeline.decoder.counters)
        return {str(cause): count for cause, count in counters.items() if count}

    def _take(self, frame: Frame) -> None:
        is_ours = (frame.system_id, frame.component_id) == self.pipeline.identity.own
        if is_ours:
            self.sent_frames += 1
            self.published += frame.message_id == ALTITUDE
        else:
            self.heard_frames += 1
            self._traffic.take([frame], self.clock.now_us())
        if frame.message_id == STATUSTEXT:
            self._keep_text(frame, "Kollsman" if is_ours else "vehicle")

    def _keep_text(self, frame: Frame, who: str) -> None:
        is_theirs = (frame.system_id, frame.component_id) == self.pipeline.identity.vehicle
        message = decode(frame) if is_theirs or who == "Kollsman" else None
        if message is not None:
            self.texts.append(Text.of(message, who, self.clock.now_us()))
