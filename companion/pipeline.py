"""The pipeline: packets in, estimates and MAVLink frames out.

Live and replay run this same code; it knows no link, no file and no host clock, so the same bytes
give the same estimates and the same output messages, bit for bit.
"""

import copy
import logging
from collections.abc import Callable, Hashable, Mapping

from companion.announcements import Announcements
from companion.checker import Checker
from companion.estimators import ESTIMATORS, Filter
from companion.feedback import Feedback, Situation
from companion.health import HealthMonitor
from companion.intake import Intake, SampleReject, restart_row
from companion.known_air import AirSettings, KnownAir
from companion.live import LivePath
from companion.mavlink import convert
from companion.mavlink.codec import Decoder, Frame, Message, mavlink
from companion.mavlink.commands import Commands
from companion.mavlink.identity import OURSELVES, VEHICLE, Origin
from companion.mavlink.outputs import Outputs, heartbeat, intervals
from companion.mavlink.own_heights import own_heights
from companion.mavlink.parameters import Parameters
from companion.mavlink.readings import ReadingSelector
from companion.mavlink.requests import REQUESTS, Requests, asks_rate
from companion.mavlink.sections import identity_of
from companion.mavlink.sender import Sender
from companion.mavlink.signing import Signing
from companion.observer import Observer
from companion.recorded import Height, Item, Sensed
from companion.samples import Kind, Packet, Rows, Verdict
from companion.settings import CompanionSettings

logger = logging.getLogger("kollsman.pipeline")

HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
SYSTEM_TIME = mavlink.MAVLINK_MSG_ID_SYSTEM_TIME
ALTITUDE = mavlink.MAVLINK_MSG_ID_ALTITUDE
GLOBAL_POSITION_INT = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
PARAM_VALUE = mavlink.MAVLINK_MSG_ID_PARAM_VALUE
DATA_STREAM = mavlink.MAVLINK_MSG_ID_REQUEST_DATA_STREAM
FORGERIES = (Origin.FORGED, Origin.ELSEWHERE)
OTHERS_US = 5_000_000


class Pipeline:
    """One vehicle, one estimator.

    Parameters
    ----------
    settings : the resolved configuration.
    datagrams : whether every packet holds whole frames (UDP, logs).
    observer : sees every sample, truth and publication.
    listeners : what else wants messages of the vehicle, by message id (answers to our requests).
    sends : False when nobody wants the frames to send: none are made, which saves half the time.
    feedback : one with a mark on disk; default: one without.
    signing : signs what is sent and refuses what is not signed; None: neither.
    """

    estimates = True  # whether samples reach the estimator
    in_blocks = True  # whether a replay may use loops, which call no overridden method

    def __init_subclass__(cls) -> None:
        methods = {name for name in vars(Pipeline) if not name.startswith("__")}
        own = {name for name in methods if getattr(cls, name) is not getattr(Pipeline, name)}
        cls.in_blocks = own <= {"estimates", "in_blocks"}

    def __init__(
        self,
        settings: CompanionSettings,
        *,
        datagrams: bool = False,
        observer: Observer | None = None,
        listeners: Mapping[int, Callable[[Message], None]] | None = None,
        sends: bool = True,
        feedback: Feedback | None = None,
        signing: Signing | None = None,
    ) -> None:
        self.settings = settings
        self.signing = signing
        self.sends = sends
        self.decoder = Decoder(datagrams=datagrams)
        other_id = settings.air.reference_system_id
        self.identity = identity_of(settings.vehicle, settings.identity, other_id)
        self.announcements = Announcements(enabled=settings.publish.statustext)
        self._begin()
        self.feedback = feedback or Feedback(settings.feedback)
        self.verdicts = [[0] * len(Verdict) for _ in Kind]
        """how many samples of each kind got each verdict"""
        self.heard: dict[int, int] = {}
        """messages of the vehicle by id"""
        self.frames: list[Frame] = []
        """the frames of the last packet"""
        self.listeners = dict(listeners or {})
        self._sender = Sender(signing)
        self.commands, self._host_us = Commands(intervals(settings.publish)), 0
        self._live = LivePath(self)
        self.parameters = Parameters(settings, AirSettings, lambda: self.air)
        self._requests = Requests(self.parameters, self.commands)
        self._wanted = self.readings.message_ids | {SYSTEM_TIME, ALTITUDE, GLOBAL_POSITION_INT}
        self._wanted |= self.listeners.keys() | convert.TRUTHS.keys()
        if self.feedback.knob is not None:
            self._wanted.add(PARAM_VALUE)
        self.observe(observer)
        self.on_own_ids: Callable[[Frame], None] | None = None
        """called for every frame that carries our own ids"""
        self.on_rate_request: Callable[[Frame], None] | None = None
        """called for every request of another program for the vehicle's message rates"""

    def _begin(self) -> None:
        """Forget what was measured: another vehicle is followed from here on."""
        settings = self.settings
        self.intake = Intake(settings.intake)
        self.filter = Filter(ESTIMATORS[settings.estimator], settings.section(settings.estimator))
        self.health = HealthMonitor(settings.health, self.filter.method.uses)
        self.checker = Checker()
        self.announcements.new_vehicle()
        self.outputs = Outputs(settings.publish)
        self.readings = ReadingSelector(settings.intake.air_temperature)
        self.air = KnownAir(settings.air)

    @property
    def wanted(self) -> frozenset[int]:
        """Ids of the messages that are decoded when the vehicle sends them."""
        return frozenset(self._wanted)

    @property
    def now_us(self) -> int:
        """The vehicle's clock: the newest boot time heard, -1 before the first."""
        return self.intake.clock.now_us

    @property
    def estimate(self) -> Rows:
        return self.filter.estimate

    @property
    def heard_ourselves(self) -> bool:
        """Whether the last packet was a frame with our own ids, as in a recording of ours."""
        own = self.identity.own
        return any((frame.system_id, frame.component_id) == own for frame in self.frames)

    def observe(self, observer: Observer | None) -> None:
        """Let `observer` see what happens from now on."""
        self._observer = observer
        self.wants_imu = observer is not None or Kind.IMU in self.filter.method.uses

    def listen(self, message_id: int, listener: Callable[[Message], None]) -> None:
        """Call `listener` for each message of this id, in place of the one before."""
        self.listeners[message_id] = listener
        self._wanted.add(message_id)

    def branch(self, observer: Observer) -> "Pipeline":
        """A second pipeline that goes on from here by itself. It sends nothing. The two share the
        decoder, which keeps nothing between datagrams but its counters."""
        shared = (self.decoder, self._observer, self._sender)
        other = copy.deepcopy(self, {id(each): each for each in shared})
        other.sends = False
        other.observe(observer)
        return other

    def arrived(self, host_us: int) -> None:
        """What follows is of a packet that arrived at `host_us`."""
        self.frames, self._host_us = [], host_us

    def feed(self, packet: Packet, source: Hashable = None) -> list[bytes]:
        """Take in a packet; the frames to send because of it.

        `source` is the network address that it came from, on a link that has several.
        """
        self.arrived(packet.time_us)
        return self._live.feed(packet.data, packet.time_us, source)

    def feed_item(self, item: Item, arrival_us: int) -> list[bytes]:
        """Take in what a log's reader has found; the frames to send because of it."""
        self.arrived(arrival_us)
        if isinstance(item, Frame):
            return self.take([item], arrival_us, None)
        if isinstance(item, Sensed):
            return self._reading(item.reading, item.source, arrival_us)
        if isinstance(item, Height):
            self._compare(item.is_truth, item[1:])
        return []

    def hear_reference(self, frame: Frame) -> None:
        """A frame of the reference barometer: its pressure, at the newest time of the vehicle."""
        self.air.hear(convert.station_pressure_pa(frame), self.now_us)

    def flush(self, arrival_us: int) -> list[bytes]:
        """The line fell silent: give up on a half-received frame."""
        self.arrived(arrival_us)
        return self.take(self.decoder.flush(), arrival_us, None)

    def age(self, host_us: int) -> list[bytes]:
        """Time passed on the host's clock: lose a height that is old, send texts that are due."""
        self._host_us, identity = host_us, self.identity
        if self.health.age(host_us, lambda: ", ".join(identity.others(host_us - OTHERS_US))):
            self.announcements.health(self.health)
            ids = "{}/{}".format(*(identity.vehicle or (0, 0)))
            lost_s = max(0, self.now_us) * 1e-6
            identity.tell(
                f"vehicle {ids} lost at {lost_s:.1f} s of its clock: {self.health.reason}"
            )
        return self.texts(host_us)

    def texts(self, host_us: int) -> list[bytes]:
        """The texts that are due on the host's clock."""
        messages = self.announcements.due(host_us)
        return self.encode(messages) if messages else []

    def heartbeat(self) -> list[bytes]:
        """Our own heartbeat."""
        return self.encode([heartbeat(self.health.health)])

    def farewell(self, host_us: int) -> list[bytes]:
        """The last messages: ALTITUDE with the vehicle's own height, and a text that says so."""
        own = self.outputs.last_height(self.now_us)
        return self.encode([own, *self.announcements.farewell()]) if own is not None else []

    def take(self, frames: list[Frame], arrival_us: int, source: Hashable) -> list[bytes]:
        """Take frames one after the other, in the steps that all messages have."""
        sent: list[bytes] = []
        for frame in frames:
            sent += self._frame(frame, arrival_us, source) + self.age(arrival_us)
        return sent

    def _frame(self, frame: Frame, arrival_us: int, source: Hashable) -> list[bytes]:
        identity, message_id = self.identity, frame.message_id
        refusal = self.signing.refusal(frame) if self.signing is not None else None
        if refusal is not None:
            self.decoder.counters[refusal] += 1
            return []
        speaker = (frame.system_id, frame.component_id)
        if message_id == HEARTBEAT and speaker not in (identity.vehicle, identity.own):
            message = self.decoder.decode(frame)
            changed = message and identity.heartbeat(frame, message, arrival_us, source)
            if changed and self.heard:  # not for the first vehicle
                self._begin()
                self.feedback.restart()
        origin = identity.origin(frame, arrival_us, source)
        if origin not in FORGERIES:
            self.frames.append(frame)
        if origin is OURSELVES:
            if self.on_own_ids is not None:
                self.on_own_ids(frame)
        elif message_id in REQUESTS:
            return self._request(frame, arrival_us)
        elif message_id == DATA_STREAM and self.on_rate_request is not None:
            self.on_rate_request(frame)
        if origin is not VEHICLE:
            if frame.system_id == self.settings.air.reference_system_id:
                self.hear_reference(frame)
            return []
        self.health.alive(arrival_us)
        self.heard[frame.message_id] = self.heard.get(frame.message_id, 0) + 1
        if frame.message_id not in self._wanted:
            return []
        message = self.decoder.read(frame)
        return self._message(message, frame.message_id, arrival_us) if message is not None else []

    def _request(self, frame: Frame, arrival_us: int) -> list[bytes]:
        """A command or parameter request, answered when it is addressed to us."""
        message = self.decoder.decode(frame)
        if message is None:
            return []
        if asks_rate(message, frame.message_id) and self.on_rate_request is not None:
            self.on_rate_request(frame)
        asker = (frame.system_id, frame.component_id)
        answers = self._requests.answer(message, asker, self.identity.own, arrival_us)
        return self.encode(answers) if answers else []

    def _message(self, message: Message, message_id: int, arrival_us: int) -> list[bytes]:
        listener, receivers = self.listeners.get(message_id), (0, self.identity.component_id)
        if listener is not None and getattr(message, "target_component", 0) in receivers:
            listener(message)  # an answer to somebody else's request is not ours
        if message_id == HEARTBEAT:
            self.identity.note(message)
            self.feedback.heartbeat(convert.is_armed(message))
        elif message_id == ALTITUDE:
            self.outputs.vehicle_altitude(self.now_us)
        elif message_id == SYSTEM_TIME:
            self.intake.clock.note_unix(message.time_unix_usec, message.time_boot_ms * 1000)
        elif message_id in convert.TRUTHS:
            found = convert.TRUTHS[message_id](message)
            self._compare(True, (self.now_us, *found) if found is not None else None)
        elif message_id == GLOBAL_POSITION_INT:
            self._compare(False, convert.global_position(message))
            self.feedback.height(*own_heights(message))
            own_height = self.outputs.own_height(message, self.now_us, self.health.health)
            if own_height is None:
                return []
            self.announcements.source(self.outputs.source)
            return self.encode([own_height])
        elif message_id == PARAM_VALUE:
            self.feedback.parameter(message)
        readings = self.readings.of(message, message_id, self.identity.autopilot)
        return [frame for each in readings for frame in self._reading(each, message_id, arrival_us)]

    def _compare(self, is_truth: bool, height: tuple[int, float, float] | None) -> None:
        if is_truth:
            self.intake.simulation.truth(height[1] if height is not None else None)
        if self._observer is not None and height is not None and height[0] >= 0:
            (self._observer.truth if is_truth else self._observer.autopilot)(*height)

    def _reading(self, reading: convert.Reading, message_id: int, arrival_us: int) -> list[bytes]:
        time_us, reboot = self.intake.place(reading, message_id, arrival_us)
        sent: list[bytes] = []
        if reboot is not None:
            parts = (self.health, self.outputs, self.checker, self.feedback, self.readings)
            for restart in (*(part.restart for part in parts), self.air.restart):
                restart()
            sent += self._sample(Kind.STATUS, reboot)
        if time_us is None:
            return sent
        if reading.kind is Kind.IMU and not self.wants_imu:
            self.verdicts[Kind.IMU][Verdict.IGNORED] += 1
        elif self.readings.is_replaced(reading, message_id, self.now_us):
            self.intake.counters[SampleReject.REPLACED] += 1
        else:
            row = self.intake.row(reading, time_us, arrival_us)
            return sent + self._sample(reading.kind, row, reading.instance)
        return sent + self._react(self.now_us, used=False)

    def _sample(self, kind: Kind, row: Rows, instance: int = 0) -> list[bytes]:
        """Give a sample to the estimator and its verdict to all who follow it."""
        self.air.sample(kind, row)
        now_us, sent = self.now_us, self.tell_air(kind, row)
        self.identity.measured(kind)
        verdict = Verdict.IGNORED
        if self.estimates:
            self.checker.sample(kind, row)
            verdict = self.filter.step(kind, row)
            if instance == 0 or verdict is Verdict.USED:
                self.health.sample(kind, verdict, now_us, int(row["arrival_us"][0]))
            self.outputs.sample(kind, row, verdict, self.filter.estimate)
        self.count(kind, row, verdict)
        return sent + self._react(now_us, used=verdict is Verdict.USED)

    def tell_air(self, kind: Kind, row: Rows) -> list[bytes]:
        """Tell the estimator what is known of the air and what it has not been told."""
        known = self.air.due(kind, self.now_us, self.filter.estimate)
        return self._sample(Kind.AIR, self.intake.air(known, row)) if known is not None else []

    def count(self, kind: Kind, row: Rows, verdict: Verdict) -> None:
        """Count a sample, and show it to the observer."""
        self.verdicts[kind][verdict] += 1
        if self._observer is not None:
            self._observer.sample(kind, row, verdict, self.filter.estimate)

    def _react(self, now_us: int, *, used: bool) -> list[bytes]:
        """What is due now that the vehicle's clock is at `now_us`: health, ALTITUDE, DEBUG."""
        if not self.estimates:
            return []
        estimate, changed = self.filter.estimate, False
        if used or self.health.is_due(now_us):
            objection = self.intake.objection or self.checker.judge(now_us, estimate)
            changed = self.health.assess(now_us, estimate, *objection)
            self.announcements.excluded(int(estimate["faulty"][0]), estimate)
            if self.checker.asks_restart(now_us, supported=self.health.has_altitude):
                self.restart_estimator()
        due = self.outputs.altitude(now_us, self.health.health, estimate) if used else None
        return self.publish(due, changed=changed)

    def publish(self, altitude: Message | None, *, changed: bool) -> list[bytes]:
        """The frames of an ALTITUDE and of what else is due; `changed` is whether health did."""
        messages: list[Message] = []
        if altitude is not None:
            self.announcements.source(self.outputs.source)
            messages.append(altitude)
            if self._observer is not None:
                self._observer.published(altitude)
        if not self.sends:
            return []
        if changed:
            self.announcements.health(self.health)
        now_us, health, estimate = self.now_us, self.health, self.filter.estimate
        if self.outputs.is_debug_due(now_us):
            messages += self.outputs.debug(now_us, health.health, estimate, self.filter.state)
        if self.feedback.knob is not None and (vehicle := self.identity.vehicle) is not None:
            situation = Situation(health.health, estimate, vehicle, self.identity.autopilot)
            messages += self.feedback.step(now_us, situation)
        return self.encode(messages) if messages else []

    def restart_estimator(self) -> None:
        """Start the estimator anew. Observers see its samples only, as another would get them."""
        self.filter.step(Kind.STATUS, restart_row(self.now_us, self.now_us))
        self.air.restart()
        reason = f"estimator restarted, {self.health.reason}"
        logger.warning("%s (restart %d)", reason, self.checker.restarts)
        self.announcements.restart(reason, self.checker.restarts)

    def encode(self, messages: list[Message]) -> list[bytes]:
        """The frames of messages of ours, such as a request to the vehicle."""
        if not self.sends:
            return []
        self.commands.sent(messages, self._host_us)
        return self._sender.encode(messages, self.identity)
