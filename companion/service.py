"""The live loop: one link, one clock, one pipeline, one thread.

Everything that depends on the host's clock is here and nothing of it reaches an estimate: our
heartbeat, the requests to the vehicle, the silence of the link, and the notice that nothing was
heard.
"""

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from companion.backlog import Backlog
from companion.clock import Clock
from companion.errors import IdentityError, LogFormatError
from companion.estimators import ESTIMATORS
from companion.health import Health
from companion.links import Link
from companion.logs import LogWriter
from companion.mavlink.codec import Frame, FrameReject, Message, mavlink
from companion.mavlink.identity import Origin, autopilot_name
from companion.mavlink.streams import StreamRequester, wanted
from companion.pipeline import Observer, Pipeline
from companion.samples import Kind, Packet, Verdict
from companion.settings import CompanionSettings

logger = logging.getLogger("kollsman.service")

POLL_S = 0.1
QUIET_US = 200_000
"""a line silent for longer than any frame lasts: what is half received will not be completed"""
HEARTBEAT_US = 1_000_000
NOTICE_US = 5_000_000
STATUS_US = 1_000_000
FOREIGN_HEARTBEATS = 2
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


@dataclass(frozen=True)
class Status:
    """What the status line shows."""

    health: Health
    reason: str
    vehicle: str
    altitude_amsl_m: float
    altitude_sd_m: float
    climb_mps: float
    rates_hz: dict[str, float]
    """of each sensor kind and of our ALTITUDE, since the last status"""
    link: str


class Service:
    """Runs the companion on an open link until told to stop.

    Parameters
    ----------
    link, settings, clock : what to run on.
    recorder : where to write every frame heard and sent.
    observer : sees the pipeline from inside.
    """

    def __init__(
        self,
        link: Link,
        settings: CompanionSettings,
        clock: Clock,
        *,
        recorder: LogWriter | None = None,
        observer: Observer | None = None,
    ) -> None:
        self.link = link
        self.clock = clock
        self.settings = settings
        self.published = 0
        self.sent_frames = 0
        self.outdated = 0
        """frames that were not sent because they were made of old samples"""
        listeners = {mavlink.MAVLINK_MSG_ID_COMMAND_ACK: self._acknowledged}
        self.pipeline = Pipeline(settings, observer=observer, listeners=listeners)
        self.pipeline.on_own_ids(self._own_ids_heard)
        self._recorder = recorder
        self._requester: StreamRequester | None = None
        self._recent: deque[bytes] = deque(maxlen=256)
        self._foreign_heartbeats = 0
        start_us = clock.now_us()
        self._start_us = start_us
        self._backlog = Backlog()
        self._heard_us = start_us
        self._heartbeat_due_us = start_us
        self._flushed = True
        self._noticed = False
        self._status_us = start_us
        self._status_counts: dict[str, int] = {}

    def run(
        self, stop: Callable[[], bool], on_status: Callable[[Status], None] | None = None
    ) -> None:
        """Serve until `stop()`. `on_status` is called about once a second.

        Raises
        ------
        IdentityError
            Another program on the link uses our ids.
        """
        while not stop():
            self.turn(POLL_S)
            if on_status is not None and self.clock.now_us() - self._status_us >= STATUS_US:
                on_status(self.status())

    def turn(self, timeout_s: float) -> None:
        """One turn of the loop: wait for bytes at most `timeout_s`, handle them, do what is due."""
        timeout_s = 0.0 if self._backlog.behind else timeout_s
        data = self.link.receive(timeout_s)
        now_us = self.clock.now_us()
        self._backlog.received(now_us, timeout_s, bool(data))
        if data:
            self._heard_us, self._flushed = now_us, False
            frames = self.pipeline.feed(Packet(now_us, data))
            self._backlog.handled(now_us, self.pipeline.now_us)
            self._record_heard(now_us)
            self._send(self._current(frames), now_us)
        elif now_us - self._heard_us > QUIET_US and not self._flushed:
            self._flushed = True
            self._send(self.pipeline.flush(now_us), now_us)
            self._record_heard(now_us)
        self._housekeeping(now_us)

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
            health.reason,
            f"{vehicle[0]}/{vehicle[1]} {autopilot_name(identity.autopilot)}"
            if vehicle
            else "no vehicle",
            float(value["altitude_amsl_m"]),
            float(value["altitude_sd_m"]),
            float(value["climb_mps"]),
            rates_hz,
            self.link.state.name.lower(),
        )

    def _housekeeping(self, now_us: int) -> None:
        identity = self.pipeline.identity
        if now_us - self._heard_us > self.settings.health.heartbeat_s * 1e6:
            self._send(self.pipeline.lose("nothing heard from the vehicle"), now_us)
        if identity.vehicle is not None:
            if now_us >= self._heartbeat_due_us:
                self._heartbeat_due_us = now_us + HEARTBEAT_US
                self._send(self.pipeline.heartbeat(), now_us)
            self._request_streams(now_us)
        if not self._noticed and now_us - self._start_us > NOTICE_US:
            self._noticed = True
            notice = self.notice()
            if notice:
                logger.warning("%s", notice)

    def _request_streams(self, now_us: int) -> None:
        vehicle = self.pipeline.identity.vehicle
        if not self.settings.streams.request or vehicle is None:
            return
        if self._requester is None:
            uses = ESTIMATORS[self.settings.estimator].uses
            requests = wanted(self.settings.streams, uses, self.pipeline.identity.autopilot)
            listed = ", ".join(f"{request.name} {request.rate_hz:g} Hz" for request in requests)
            logger.info("asking the vehicle for %s", listed)
            self._requester = StreamRequester(requests, vehicle)
        message = self._requester.poll(now_us)
        if message is not None:
            self._send(self.pipeline.encode(message), now_us)

    def notice(self) -> str:
        """What is missing so far and what to check, in one line; empty when nothing is."""
        pipeline, link = self.pipeline, self.link
        received = link.statistics.received_bytes
        if received == 0:
            check = "check cable, port, baud rate, and that the autopilot sends here"
            return f"nothing received on {link.url} in 5 s: {check}"
        if pipeline.decoder.frames == 0:
            junk = pipeline.decoder.counters[FrameReject.JUNK]
            check = "check the baud rate, and that the port is set to MAVLink 2"
            return f"{received} bytes on {link.url} but no MAVLink ({junk} junk): {check}"
        if pipeline.identity.vehicle is None:
            check = "check what is connected, or vehicle.system_id"
            return f"MAVLink on {link.url} but no heartbeat of an autopilot: {check}"
        for kind, name in (
            (Kind.PRESSURE, "barometer (SCALED_PRESSURE)"),
            (Kind.GNSS, "GNSS (GPS_RAW_INT)"),
        ):
            if kind not in pipeline.filter.method.uses or pipeline.verdicts[kind][Verdict.USED]:
                continue
            heard = sum(pipeline.verdicts[kind])
            if heard:
                return f"{heard} messages of the {name} but none usable: wait for a 3D fix, or check the sensor"
            names = ", ".join(
                sorted(mavlink.mavlink_map[message_id].msgname for message_id in pipeline.heard)[:8]
            )
            return f"no {name} in 5 s, only {names}: check the stream rates of this port (README, recipes)"
        return ""

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
            if _message_id(frame) == mavlink.MAVLINK_MSG_ID_ALTITUDE:
                self.published += 1
            if self.link.statistics.received_bytes and now_us - self._heard_us < SESSION_US:
                self._record(now_us, frame)

    def _record_heard(self, now_us: int) -> None:
        for frame in self.pipeline.frames:
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

    def _acknowledged(self, message: Message) -> None:
        if self._requester is not None:
            self._requester.acknowledge(message)

    def _own_ids_heard(self, frame: Frame) -> None:
        """Our own frames may come back over a forwarding link; heartbeats we did not send mean a
        second companion."""
        if frame.message_id != mavlink.MAVLINK_MSG_ID_HEARTBEAT or frame.data in self._recent:
            return
        self._foreign_heartbeats += 1
        if self._foreign_heartbeats >= FOREIGN_HEARTBEATS:
            ids = f"{frame.system_id}/{frame.component_id}"
            raise IdentityError(
                f"another program on {self.link.url} already uses {ids}: stop it, or choose --component-id"
            )

    def summary(self) -> str:
        """One line for the end of a run."""
        identity, decoder = self.pipeline.identity, self.pipeline.decoder
        bad = {str(cause): count for cause, count in decoder.counters.items() if count}
        strangers = identity.counters[Origin.STRANGER]
        outdated = f", {self.outdated} outdated not sent" if self.outdated else ""
        return (
            f"{decoder.frames} frames heard ({identity.counters[Origin.VEHICLE]} of the vehicle, {strangers} others), "
            f"{self.sent_frames} sent ({self.published} ALTITUDE{outdated}), bad input: {bad or 'none'}"
        )


def _message_id(frame: bytes) -> int:
    return frame[5] if frame[0] == 0xFE else int.from_bytes(frame[7:10], "little")
