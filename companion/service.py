"""The live loop: one link, one clock, one pipeline, one thread.

Everything that depends on the host's clock is here, and no estimate depends on it: our heartbeat,
the requests to the vehicle, the silence of the link, and the notice that nothing was heard.
"""

import logging
import math
from collections import Counter, deque
from collections.abc import Callable
from functools import partial

from companion.admission import Admission
from companion.air_store import AirStore
from companion.backlog import Backlog
from companion.checkpoint import Checkpoint
from companion.clock import Clock
from companion.errors import LogFormatError
from companion.feedback import start_feedback
from companion.key_file import SigningStore
from companion.links import Link
from companion.links.routing import Router
from companion.links.traffic import Traffic
from companion.logs import LogWriter
from companion.mavlink.codec import Frame, Message, decode, mavlink, scan
from companion.mavlink.identity import Identity, Origin, autopilot_name
from companion.notices import notice
from companion.observer import Observer
from companion.pipeline import Pipeline
from companion.reference_link import ReferenceLink
from companion.samples import Kind, Packet
from companion.settings import CompanionSettings
from companion.status import KEPT_TEXTS, Status, Text
from companion.streaming import Streaming
from companion.timesync import TimeSync

logger = logging.getLogger("kollsman.service")

POLL_S = 0.1
QUIET_US = 200_000
"""a line silent for longer than any frame lasts: what is half received will not be completed"""
HEARTBEAT_US = 1_000_000
HOUSEKEEPING_US = 20_000
"""interval of what is due by the host's clock, while the vehicle's bytes keep coming"""
NOTICE_US = 5_000_000
STATUS_US = 1_000_000
FOREIGN_HEARTBEATS = 2
STATUSTEXT: int = mavlink.MAVLINK_MSG_ID_STATUSTEXT
SESSION_US = 60_000_000
"""Our own frames are recorded this long after the last that was heard."""
OUTDATED = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_ALTITUDE,
        mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT,
        mavlink.MAVLINK_MSG_ID_DEBUG,
        mavlink.MAVLINK_MSG_ID_DEBUG_VECT,
        mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY,
    }
)
"""Not sent when they are made of old samples."""


class Service:
    """Runs the companion on an open link until told to stop.

    Parameters
    ----------
    link, settings, clock : what to run on.
    recorder : where to write every frame heard and sent.
    observer : sees the pipeline from inside.
    checkpoint : where the state is kept in case this process is killed.
    follows : who was heard before; its vehicle is followed at once.
    earlier : a service on the same link that failed: the checkpoint is not continued.
    signing : the key, and where its time stamps are kept; None: nothing is signed or verified.
    reference : the link to a ground barometer.
    """

    def __init__(
        self,
        link: Link,
        settings: CompanionSettings,
        clock: Clock,
        *,
        recorder: LogWriter | None = None,
        observer: Observer | None = None,
        checkpoint: Checkpoint | None = None,
        follows: Identity | None = None,
        earlier: "Service | None" = None,
        signing: SigningStore | None = None,
        reference: ReferenceLink | None = None,
    ) -> None:
        self.link, self._reference = link, reference
        self.clock = clock
        self.settings = settings
        self.published = 0
        self.sent_frames = 0
        self.outdated = 0
        """frames that were not sent because they were made of old samples"""
        self.texts: deque[Text] = deque(maxlen=KEPT_TEXTS)
        """the last STATUSTEXT of the vehicle and our own"""
        listeners: dict[int, Callable[[Message], None]] = {
            mavlink.MAVLINK_MSG_ID_COMMAND_ACK: self._acknowledged,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._time_asked,
            STATUSTEXT: partial(self._keep_text, "vehicle"),
        }
        self.pipeline = Pipeline(
            settings,
            observer=observer,
            listeners=listeners,
            feedback=start_feedback(settings.feedback, link.url),
            signing=signing.signing if signing is not None else None,
        )
        self._signing = signing
        follows = earlier.pipeline.identity if earlier is not None else follows
        if follows is not None:
            self.pipeline.identity.resume(follows, clock.now_us())
        self.pipeline.on_own_ids = self._own_ids_heard
        self.pipeline.commands.store = self._store_air
        self._start(clock.now_us())
        self._checkpoint = checkpoint
        is_first = checkpoint is not None and earlier is None
        self._resumption = checkpoint.restore(self.pipeline) if checkpoint and is_first else None
        self.pipeline.on_rate_request = self._rate_requested
        self._streaming = Streaming(self.pipeline, settings, link.bytes_per_s)
        self._recorder = recorder
        self._recent: deque[bytes] = deque(maxlen=256)
        self._foreign_heartbeats = 0

    def _start(self, start_us: int) -> None:
        """What was kept is restored, and every instant of the host's clock is `start_us`."""
        self.timesync = TimeSync()
        self._air_store = AirStore([self.link.url])
        self._air_store.restore(self.pipeline.air, self.settings.air)
        self._start_us = start_us
        self._traffic = Traffic()
        self._backlog = Backlog()
        self._admission = Admission()
        self._heard_us = start_us
        self._heartbeat_due_us = start_us
        self._kept_us = start_us - HOUSEKEEPING_US
        self._flushed = True
        self._noticed = False
        self._status_us = start_us
        self._status_counts: dict[str, int] = {}

    def run(
        self,
        stop: Callable[[], bool],
        on_status: Callable[[Status], None] | None = None,
        on_turn: Callable[[], None] | None = None,
    ) -> None:
        """Serve until `stop()`. `on_status` is called about once a second, `on_turn` after each
        turn of the loop."""
        while not stop():
            self.turn(POLL_S)
            if on_turn is not None:
                on_turn()
            if on_status is not None and self.clock.now_us() - self._status_us >= STATUS_US:
                on_status(self.status())
        self.stop()

    def turn(self, timeout_s: float) -> None:
        """One turn of the loop: wait for bytes at most `timeout_s`, handle them, do what is due."""
        timeout_s = 0.0 if self._backlog.behind else timeout_s
        data = self.link.receive(timeout_s)
        now_us = self.clock.now_us()
        self._backlog.received(now_us, timeout_s, bool(data))
        if data and not self._admission.admits(self.link.source, len(data), now_us):
            data = b""
        if data:
            self._take(data, now_us)
            if now_us - self._kept_us < HOUSEKEEPING_US and self.pipeline.identity.vehicle:
                return
        elif now_us - self._heard_us > QUIET_US and not self._flushed:
            self._flushed = True
            self._send(self.pipeline.flush(now_us), now_us)
            self._record_heard(now_us)
        self._housekeeping(now_us)

    def _take(self, data: bytes, now_us: int) -> None:
        """Handle bytes; what they bring about is sent before they are counted."""
        link, pipeline = self.link, self.pipeline
        self._heard_us, self._flushed = now_us, False
        frames = pipeline.feed(Packet(now_us, data), link.source)
        heard = pipeline.frames
        if heard:
            link.trust()
            self._admission.framed(link.source, now_us)
        self._backlog.handled(now_us, pipeline.now_us)
        if self._recorder is not None:
            self._record_heard(now_us)
        if frames:
            self._send(self._current(frames), now_us)
        self._traffic.take(heard, now_us)
        self._keep_state(now_us)

    def status(self) -> Status:
        """The state now, and rates since the last call."""
        now_us = self.clock.now_us()
        elapsed_s = max(1e-3, (now_us - self._status_us) * 1e-6)
        counts = {kind.name.lower(): sum(self.pipeline.verdicts[kind]) for kind in Kind}
        counts["altitude"] = self.published
        rates_hz = {
            name: (count - self._status_counts.get(name, 0)) / elapsed_s
            for name, count in counts.items()
        }
        self._status_us, self._status_counts = now_us, counts
        health, identity, value = (
            self.pipeline.health,
            self.pipeline.identity,
            self.pipeline.estimate[0],
        )
        vehicle = identity.vehicle
        return Status(
            health.health,
            "; ".join([health.reason, *self.problems]),
            f"{vehicle[0]}/{vehicle[1]} {autopilot_name(identity.autopilot)}"
            if vehicle
            else "no vehicle",
            float(value["altitude_amsl_m"]),
            float(value["altitude_sd_m"]),
            float(value["protection_level_m"]),
            float(value["climb_mps"]),
            rates_hz,
            self.link.state.name.lower(),
            {url: traffic.as_dict() for url, traffic in self.traffic().items()},
            self.rejected(),
            self.timesync.round_trip_s,
            self.timesync.age_s(now_us, self.pipeline.now_us),
        )

    @property
    def heard_frames(self) -> int:
        """MAVLink frames of all senders."""
        return self.pipeline.decoder.frames

    @property
    def problems(self) -> list[str]:
        """Streams that are slow, missing or refused."""
        return [*self._streaming.problems, *self.pipeline.air.problems]

    def traffic(self) -> dict[str, Traffic]:
        """The senders heard on each link."""
        if isinstance(self.link, Router):
            return self.link.traffic()
        return {self.link.url: self._traffic}

    def rejected(self) -> dict[str, int]:
        """Bad input by cause, of all links."""
        counters = Counter(self.pipeline.decoder.counters)
        if isinstance(self.link, Router):
            counters += self.link.rejects
        return {str(cause): count for cause, count in counters.items() if count}

    def _housekeeping(self, now_us: int) -> None:
        """What is due by the host's clock. Our heartbeat goes out from the first second on every
        link, vehicle or not: many peers speak only to who spoke; it stops when this loop does."""
        self._kept_us = now_us
        if self._signing is not None:
            self._signing.keep()
        self._send(self.pipeline.age(now_us), now_us)
        if now_us >= self._heartbeat_due_us:
            self._heartbeat_due_us = now_us + HEARTBEAT_US
            self._send(self.pipeline.heartbeat(), now_us)
        request = self.timesync.poll(now_us) if self.pipeline.identity.vehicle else None
        if request is not None:
            self._send(self.pipeline.encode([request]), now_us)
        path = (self.link.statistics.reconnects, self.pipeline.identity.source)
        for message in self._streaming.poll(now_us, path):
            self._send(self.pipeline.encode([message]), now_us)
        if self._reference is not None:
            self._reference.poll(now_us, self._hear_reference)
        self.pipeline.announcements.streams(self.problems)
        if not self._noticed and now_us - self._start_us > NOTICE_US:
            self._noticed = True
            missing = notice(self.pipeline, self.link)
            if missing:
                logger.warning("%s", missing)

    def _hear_reference(self, frame: Frame) -> None:
        """A pressure of the ground barometer; recorded where a replay can tell it from the
        vehicle's."""
        self.pipeline.hear_reference(frame)
        if frame.system_id == self.settings.air.reference_system_id:
            self._record(self.clock.now_us(), frame.data)

    def stop(self) -> None:
        """End the run: the message rates are put back, and the last ALTITUDE carries the vehicle's
        own height, which a ground station then keeps on display."""
        now_us = self.clock.now_us()
        for message in self.pipeline.feedback.stop():
            self._send(self.pipeline.encode([message]), now_us)
        self._send(self.pipeline.farewell(now_us), now_us)
        for message in self._streaming.restore():
            self._send(self.pipeline.encode([message]), now_us)

    def _keep_state(self, now_us: int) -> None:
        if self._resumption is not None and not self._resumption.settled:
            self._resumption.check(now_us)
        elif self._checkpoint is not None:
            self._checkpoint.save(self.pipeline)

    def _current(self, frames: list[bytes]) -> list[bytes]:
        """`frames` without those that tell an altitude of long ago."""
        if not self._backlog.behind:
            return frames
        current = [frame for frame in frames if _message_id(frame) not in OUTDATED]
        self.outdated += len(frames) - len(current)
        return current

    def _send(self, frames: list[bytes], now_us: int) -> None:
        for frame in frames:
            if not self.link.send(frame):
                continue
            self.sent_frames += 1
            self._recent.append(frame)
            message_id = _message_id(frame)
            if message_id == mavlink.MAVLINK_MSG_ID_ALTITUDE:
                self.published += 1
            elif message_id == STATUSTEXT and isinstance(found := scan(frame), Frame):
                message = decode(found)
                if message is not None:
                    self._keep_text("Kollsman", message)
            if self.link.statistics.received_bytes and now_us - self._heard_us < SESSION_US:
                self._record(now_us, frame)

    def _record_heard(self, now_us: int) -> None:
        for frame in self.pipeline.frames:
            if frame.message_id != mavlink.MAVLINK_MSG_ID_SETUP_SIGNING:  # it holds the key
                self._record(now_us, frame.data)

    def _record(self, now_us: int, frame: bytes) -> None:
        """A recording that cannot go on (the disk is full) must not end the service."""
        if self._recorder is None:
            return
        try:
            self._recorder.write(now_us, frame)
        except LogFormatError as error:
            logger.error("recording stops: %s", error)
            self._recorder = None

    def _keep_text(self, who: str, message: Message) -> None:
        self.texts.append(Text.of(message, who, self.clock.now_us()))

    def _time_asked(self, message: Message) -> None:
        """The vehicle compares its clock with ours, or answers our request."""
        now_us = self.clock.now_us()
        if message.tc1:
            self.timesync.take(message, now_us)
        else:
            answer = mavlink.MAVLink_timesync_message(now_us * 1000, message.ts1)
            self._send(self.pipeline.encode([answer]), now_us)

    def _store_air(self, keeps: bool) -> bool:
        """A ground station wants what it set of the air kept for the next start, or forgotten."""
        return self._air_store.keep(self.pipeline.air if keeps else None)

    def _acknowledged(self, message: Message) -> None:
        self._streaming.acknowledge(message, self.clock.now_us())

    def _rate_requested(self, frame: Frame) -> None:
        self._streaming.other_request(
            self.clock.now_us(), f"{frame.system_id}/{frame.component_id}"
        )

    def _own_ids_heard(self, frame: Frame) -> None:
        """Our own frames may come back over a forwarding link; heartbeats we did not send mean a
        second program with our ids. It must not end us: anybody could send them."""
        if frame.message_id != mavlink.MAVLINK_MSG_ID_HEARTBEAT or frame.data in self._recent:
            return
        self._foreign_heartbeats += 1
        if self._foreign_heartbeats == FOREIGN_HEARTBEATS:
            self._foreign_heartbeats = 0
            may_move = self.settings.identity.on_conflict == "next"
            self.pipeline.announcements.ids(self.pipeline.identity.yield_ids(may_move))

    def summary(self) -> str:
        """One line for the end of a run."""
        identity, decoder = self.pipeline.identity, self.pipeline.decoder
        links = "".join(f"; {url}: {traffic}" for url, traffic in self.traffic().items())
        strangers = identity.counters[Origin.STRANGER]
        outdated = f", {self.outdated} outdated not sent" if self.outdated else ""
        trip_s = self.timesync.round_trip_s
        delay = f", round trip {1000 * trip_s:.0f} ms" if math.isfinite(trip_s) else ""
        return (
            f"{decoder.frames} frames heard ({identity.counters[Origin.VEHICLE]} of the vehicle, "
            f"{strangers} others), {self.sent_frames} sent ({self.published} ALTITUDE{outdated}), "
            f"bad input: {self.rejected() or 'none'}{delay}{links}"
        )


def _message_id(frame: bytes) -> int:
    return frame[5] if frame[0] == 0xFE else int.from_bytes(frame[7:10], "little")
