"""The pipeline: packets in, estimates and MAVLink frames out.

Live and replay run this same code; it knows no link, no file and no host clock, so the same bytes
give the same estimates and the same output messages, bit for bit.
"""

import copy
import logging
from collections.abc import Callable, Hashable, Mapping
from functools import partial
from typing import Any, Protocol

from companion.checker import Checker
from companion.estimators import ESTIMATORS, Filter
from companion.feedback import Feedback, Situation
from companion.health import HealthMonitor, excluded
from companion.intake import Intake, SampleReject, restart_row
from companion.known_air import AirSettings, KnownAir
from companion.mavlink import convert
from companion.mavlink.codec import Decoder, Encoder, Frame, Message, mavlink
from companion.mavlink.commands import answers
from companion.mavlink.identity import Identity, Origin
from companion.mavlink.imu import ImuSelector
from companion.mavlink.outputs import SEVERITY, Outputs, Source, heartbeat
from companion.mavlink.parameters import Parameters
from companion.mavlink.texts import Allowance, StatusTexts
from companion.recorded import Item, Sensed
from companion.samples import Kind, Packet, Rows, Verdict
from companion.settings import CompanionSettings

logger = logging.getLogger("kollsman.pipeline")

HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
RAW_IMU = mavlink.MAVLINK_MSG_ID_RAW_IMU
HIGHRES_IMU = mavlink.MAVLINK_MSG_ID_HIGHRES_IMU
SYSTEM_TIME = mavlink.MAVLINK_MSG_ID_SYSTEM_TIME
ALTITUDE = mavlink.MAVLINK_MSG_ID_ALTITUDE
SIM_STATE = mavlink.MAVLINK_MSG_ID_SIM_STATE
GLOBAL_POSITION_INT = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
PARAM_VALUE = mavlink.MAVLINK_MSG_ID_PARAM_VALUE
DATA_STREAM = mavlink.MAVLINK_MSG_ID_REQUEST_DATA_STREAM
COMMANDS = frozenset({mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT})
PARAMETER_REQUESTS = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST,
        mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
        mavlink.MAVLINK_MSG_ID_PARAM_SET,
    }
)
SET_MESSAGE_INTERVAL = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
FORGERIES = frozenset({Origin.FORGED, Origin.ELSEWHERE})
OTHERS_US = 5_000_000
ANSWERS_PER_S = 10
OWN_HEIGHT_TEXT = "ALTITUDE: the autopilot's own height"
PRESSURE_TIMEOUT_US = 2_000_000


class Observer(Protocol):
    """Whoever wants to see what happens inside: evaluation, CSV, tests. Rows are valid during the
    call only."""

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        """A sample got its verdict; the estimate is as it was left by it."""

    def truth(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        """The simulator's truth."""

    def autopilot(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        """The autopilot's own result."""

    def published(self, message: Message) -> None:
        """An ALTITUDE of ours went out."""


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
    """

    def __init__(
        self,
        settings: CompanionSettings,
        *,
        datagrams: bool = False,
        observer: Observer | None = None,
        listeners: Mapping[int, Callable[[Message], None]] | None = None,
        sends: bool = True,
        feedback: Feedback | None = None,
    ) -> None:
        self.settings = settings
        self._sends = sends
        self.decoder = Decoder(datagrams=datagrams)
        self.identity = Identity(
            settings.vehicle.system_id,
            settings.identity.component_id,
            vehicle_component_id=settings.vehicle.component_id,
            own_system_id=settings.identity.system_id,
        )
        self.texts = StatusTexts()
        self._source = Source.NONE
        self._problems: list[str] = []
        self._begin()
        self.feedback = feedback or Feedback(settings.feedback)
        self.verdicts = [[0] * len(Verdict) for _ in Kind]
        """how many samples of each kind got each verdict"""
        self.heard: dict[int, int] = {}
        """messages of the vehicle by id"""
        self.frames: list[Frame] = []
        """the frames of the last packet"""
        self._listeners = dict(listeners or {})
        self._encoders: dict[tuple[int, int], Encoder] = {}
        self._answers = Allowance(ANSWERS_PER_S)
        self.parameters = Parameters(
            settings,
            AirSettings,
            lambda key: getattr(self.air, key),
            self._set_air_key,
        )
        self._thermometers = convert.THERMOMETERS[settings.intake.air_temperature]
        self._wanted = set(convert.CONVERTERS) | {
            *(RAW_IMU, SYSTEM_TIME, ALTITUDE, GLOBAL_POSITION_INT),
            *self._thermometers,
            *self._listeners,
        }
        if self.feedback.knob is not None:
            self._wanted.add(PARAM_VALUE)
        self.observe(observer)
        self._conflict: Callable[[Frame], None] | None = None
        self._rate_request: Callable[[Frame], None] | None = None

    def _begin(self) -> None:
        """Forget what was measured: another vehicle is followed from here on."""
        settings = self.settings
        self.intake = Intake(settings.intake)
        self.filter = Filter(ESTIMATORS[settings.estimator], settings.section(settings.estimator))
        self.health = HealthMonitor(settings.health, self.filter.method.uses)
        self.checker = Checker()
        self._excluded = 0
        self.outputs = Outputs(settings.publish)
        self._imu = ImuSelector()
        self._scaled_pressure_us = -PRESSURE_TIMEOUT_US
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
        """Whether the last packet was a frame with our own ids, as in a recording of an earlier
        run."""
        own = self.identity.own
        return any((frame.system_id, frame.component_id) == own for frame in self.frames)

    def observe(self, observer: Observer | None) -> None:
        """Let `observer` see what happens from now on."""
        self._observer = observer
        self._wants_imu = observer is not None or Kind.IMU in self.filter.method.uses
        if observer is not None:
            self._wanted.add(SIM_STATE)

    def branch(self, observer: Observer) -> "Pipeline":
        """A second pipeline that goes on from here by itself, as if the packets differed from now
        on. It sends nothing.

        The two share the decoder, which keeps nothing between datagrams but its counters.
        """
        shared = (self.decoder, self._observer, *self._encoders.values())
        other = copy.deepcopy(self, {id(each): each for each in shared})
        other._sends = False
        other.observe(observer)
        return other

    def set_air(
        self,
        *,
        qnh_hpa: float | None = None,
        temperature_c: float | None = None,
        field_elevation_m: float | None = None,
        metar: str | None = None,
    ) -> None:
        """Set what is known of the air in flight; the estimator gets it with the next pressure.

        Raises `ConfigError` for a value that is not possible.
        """
        self.air.set(
            qnh_hpa=qnh_hpa,
            temperature_c=temperature_c,
            field_elevation_m=field_elevation_m,
            metar=metar,
        )

    def _set_air_key(self, key: str, value: float) -> None:
        changes: dict[str, Any] = {key: value}
        self.set_air(**changes)

    def on_own_ids(self, callback: Callable[[Frame], None]) -> None:
        """Call back for every frame that carries our own ids."""
        self._conflict = callback

    def on_rate_request(self, callback: Callable[[Frame], None]) -> None:
        """Call back for every request of another program for the vehicle's message rates."""
        self._rate_request = callback

    def feed(self, packet: Packet, source: Hashable = None) -> list[bytes]:
        """Take in a packet; the frames to send because of it.

        `source` is the network address that it came from, on a link that has several.
        """
        return self._take(self.decoder.feed(packet.data), packet.time_us, source)

    def feed_item(self, item: Item, arrival_us: int) -> list[bytes]:
        """Take in what a log's reader has found; the frames to send because of it."""
        if isinstance(item, Frame):
            return self._take([item], arrival_us, None)
        self.frames = []
        if isinstance(item, Sensed):
            return self._reading(item.reading, item.source, arrival_us)
        self._compare(item.is_truth, item[1:])
        return []

    def flush(self, arrival_us: int) -> list[bytes]:
        """The line fell silent: give up on a half-received frame."""
        return self._take(self.decoder.flush(), arrival_us, None)

    def age(self, host_us: int) -> list[bytes]:
        """Time passed on the host's clock: lose a height that has become old, send texts that are
        due."""
        if self.health.age(host_us, partial(self._others, host_us)):
            self._tell_health()
            vehicle = self.identity.vehicle or (0, 0)
            at_s = max(0, self.now_us) * 1e-6
            self.identity.tell(
                f"{vehicle[0]}/{vehicle[1]} lost at {at_s:.1f} s of its clock: {self.health.reason}"
            )
        messages = self.texts.due(host_us)
        return self._encode(messages) if messages else []

    def heartbeat(self) -> list[bytes]:
        """Our own heartbeat."""
        return self._encode([heartbeat(self.health.health)])

    def tell_problems(self, problems: list[str]) -> None:
        """STATUSTEXT about streams that are slow, missing or refused, when that changes."""
        if problems == self._problems or not self.settings.publish.statustext:
            return
        kinds = [problem.split(":")[0] for problem in problems]
        if kinds != [problem.split(":")[0] for problem in self._problems]:
            severity = mavlink.MAV_SEVERITY_WARNING if problems else mavlink.MAV_SEVERITY_INFO
            text = f"Kollsman: {'; '.join(problems) or 'all streams arrive'}"
            self.texts.say("streams", tuple(kinds), severity, text)
        self._problems = problems

    def yield_ids(self, may_move: bool) -> None:
        """Another program uses our ids: take the next free ones, or say so and keep them."""
        text = self.identity.yield_ids(may_move)
        self.texts.say("ids", text, mavlink.MAV_SEVERITY_WARNING, text)

    def farewell(self, host_us: int) -> list[bytes]:
        """The last messages: ALTITUDE with the vehicle's own height, and a text that says so."""
        own_height = self.outputs.last_height(self.now_us)
        if own_height is None:
            return []
        text = b"Kollsman stops: the autopilot's own height"
        notice = mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_NOTICE, text)
        texts = [notice] if self.settings.publish.statustext else []
        return self._encode([own_height, *texts])

    def encode(self, message: Message) -> list[bytes]:
        """A message of the service's own, such as a request to the vehicle."""
        return self._encode([message])

    def _others(self, host_us: int) -> str:
        return ", ".join(self.identity.others(host_us - OTHERS_US))

    def _tell_excluded(self) -> None:
        """STATUSTEXT when another sensor is excluded, or none any more."""
        faulty = int(self.filter.estimate[0]["faulty"])
        if faulty == self._excluded or not self.settings.publish.statustext:
            return
        self._excluded = faulty
        text = excluded(self.filter.estimate) or "all sensors used again"
        self.texts.say("excluded", faulty, mavlink.MAV_SEVERITY_WARNING, f"Kollsman: {text}")

    def _tell_health(self) -> None:
        """STATUSTEXT about a change of health."""
        if self.settings.publish.statustext:
            health = self.health.health
            text = f"Kollsman {health.name}: {self.health.reason}"
            self.texts.say("health", health, SEVERITY[health], text)

    def _take(self, frames: list[Frame], arrival_us: int, source: Hashable) -> list[bytes]:
        self.frames = []
        sent: list[bytes] = []
        for frame in frames:
            sent += self._frame(frame, arrival_us, source)
            sent += self.age(arrival_us)
        return sent

    def _frame(self, frame: Frame, arrival_us: int, source: Hashable) -> list[bytes]:
        identity, message_id = self.identity, frame.message_id
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
        if origin is Origin.OURSELVES:
            if self._conflict is not None:
                self._conflict(frame)
        elif message_id in COMMANDS or message_id in PARAMETER_REQUESTS:
            return self._command(frame, arrival_us)
        elif message_id == DATA_STREAM and self._rate_request is not None:
            self._rate_request(frame)
        if origin is not Origin.VEHICLE:
            return []
        self.health.alive(arrival_us)
        self.heard[frame.message_id] = self.heard.get(frame.message_id, 0) + 1
        if frame.message_id not in self._wanted:
            return []
        message = self.decoder.decode(frame)
        return self._message(message, frame.message_id, arrival_us) if message is not None else []

    def _command(self, frame: Frame, arrival_us: int) -> list[bytes]:
        """A command or parameter request addressed to us, answered a few times a second at most."""
        message = self.decoder.decode(frame)
        if message is None:
            return []
        is_command = frame.message_id in COMMANDS
        asks_rate = is_command and message.command == SET_MESSAGE_INTERVAL
        if asks_rate and self._rate_request is not None:
            self._rate_request(frame)
        system_id, component_id = self.identity.own
        everybody = () if is_command else (0,)
        if message.target_system not in (system_id, *everybody) or message.target_component not in (
            component_id,
            *everybody,
        ):
            return []
        if not self._answers.takes(arrival_us):
            return []
        if is_command:
            return self._encode(answers(message, (frame.system_id, frame.component_id)))
        return self._encode(self.parameters.answer(message))

    def _message(self, message: Message, message_id: int, arrival_us: int) -> list[bytes]:
        listener = self._listeners.get(message_id)
        if listener is not None and getattr(message, "target_component", 0) in (
            0,
            self.identity.component_id,
        ):
            listener(message)  # an answer to somebody else's request is not ours
        if message_id == HEARTBEAT:
            self.identity.note(message)
            self.feedback.heartbeat(convert.is_armed(message))
        elif message_id == ALTITUDE:
            self.outputs.vehicle_altitude(self.now_us)
        elif message_id == SYSTEM_TIME:
            self.intake.clock.note_unix(message.time_unix_usec, message.time_boot_ms * 1000)
        elif message_id == SIM_STATE:
            self._compare(True, (self.now_us, *convert.sim_state(message)))
        elif message_id == GLOBAL_POSITION_INT:
            self._compare(False, convert.global_position(message))
            self.feedback.height(*convert.own_heights(message))
            own_height = self.outputs.own_height(message, self.now_us, self.health.health)
            return self._publish(own_height) if own_height is not None else []
        elif message_id == PARAM_VALUE:
            self.feedback.parameter(message)
        sent: list[bytes] = []
        for reading in self._readings(message, message_id):
            sent += self._reading(reading, message_id, arrival_us)
        return sent

    def _compare(self, is_truth: bool, height: tuple[int, float, float]) -> None:
        if self._observer is not None and height[0] >= 0:
            (self._observer.truth if is_truth else self._observer.autopilot)(*height)

    def _readings(self, message: Message, message_id: int) -> tuple[convert.Reading, ...]:
        if message_id == RAW_IMU:
            return self._imu.raw_imu(message, self.identity.autopilot)
        converter = convert.CONVERTERS.get(message_id)
        readings = converter(message) if converter is not None else ()
        thermometer = self._thermometers.get(message_id)
        return readings + thermometer(message) if thermometer is not None else readings

    def _reading(self, reading: convert.Reading, message_id: int, arrival_us: int) -> list[bytes]:
        time_us, reboot = self.intake.place(reading, message_id, arrival_us)
        sent: list[bytes] = []
        if reboot is not None:
            self.health.restart()
            self.outputs.restart()
            self.checker.restart()
            self.feedback.restart()
            self._scaled_pressure_us = -PRESSURE_TIMEOUT_US
            self.air.restart()
            sent += self._sample(Kind.STATUS, 0, reboot)
        if time_us is None:
            return sent
        if self._is_replaced(reading, message_id):
            self.intake.counters[SampleReject.REPLACED] += 1
        elif reading.kind is Kind.IMU and not self._wants_imu:
            self.verdicts[Kind.IMU][Verdict.IGNORED] += 1
        else:
            return sent + self._sample(
                reading.kind, reading.instance, self.intake.row(reading, time_us, arrival_us)
            )
        return sent + self._react(used=False)

    def _is_replaced(self, reading: convert.Reading, message_id: int) -> bool:
        """Whether the same sensor has a better message."""
        if reading.kind is Kind.IMU:
            return self._wants_imu and not self._imu.accepts(message_id, reading, self.now_us)
        if reading.kind is Kind.PRESSURE:
            if message_id == HIGHRES_IMU:
                return self.now_us - self._scaled_pressure_us < PRESSURE_TIMEOUT_US
            if reading.instance == 0:
                self._scaled_pressure_us = self.now_us
        return False

    def _sample(self, kind: Kind, instance: int, row: Rows) -> list[bytes]:
        self.air.sample(kind, row)
        known = self.air.tell(self.now_us) if kind is Kind.PRESSURE else None
        sent: list[bytes] = []
        if known is not None:
            sent = self._step(Kind.AIR, 0, self.intake.air(known, row))
        self.identity.measured(kind)
        return sent + self._step(kind, instance, row)

    def _step(self, kind: Kind, instance: int, row: Rows) -> list[bytes]:
        """Give a sample to the estimator and its verdict to all who follow it."""
        self.checker.sample(kind, row)
        verdict = self.filter.step(kind, row)
        self.verdicts[kind][verdict] += 1
        if row[0]["instance"] == 0 or verdict is Verdict.USED:
            self.health.sample(kind, verdict, self.now_us, int(row[0]["arrival_us"]))
        self.outputs.sample(kind, row, verdict, self.filter.estimate)
        if self._observer is not None:
            self._observer.sample(kind, row, verdict, self.filter.estimate)
        return self._react(used=verdict is Verdict.USED)

    def _react(self, *, used: bool) -> list[bytes]:
        """What is due now that the vehicle's clock has moved: health, ALTITUDE if the estimate is
        new, DEBUG."""
        now_us, estimate = self.now_us, self.filter.estimate
        messages: list[Message] = []
        changed = False
        if used or self.health.is_due(now_us):
            altitude_m = float(estimate[0]["altitude_amsl_m"])
            objection = self.intake.objection or self.checker.objection(now_us, altitude_m)
            changed = self.health.assess(now_us, estimate, objection)
            self._tell_excluded()
            if self.checker.asks_restart(now_us, supported=self.health.has_altitude):
                self._restart_estimator()
        health = self.health.health
        if used:
            altitude = self.outputs.altitude(now_us, health, estimate)
            if altitude is not None:
                self._tell_source(self.outputs.source)
                messages.append(altitude)
                if self._observer is not None:
                    self._observer.published(altitude)
        if not self._sends:
            return []
        if changed:
            self._tell_health()
        messages += self.outputs.debug(now_us, health, estimate, self.filter.state)
        identity = self.identity
        if identity.vehicle is not None:
            situation = Situation(health, estimate, identity.vehicle, identity.autopilot)
            messages += self.feedback.step(now_us, situation)
        return self._encode(messages) if messages else []

    def _publish(self, own_height: Message) -> list[bytes]:
        """The vehicle's own height in ALTITUDE."""
        self._tell_source(self.outputs.source)
        return self._encode([own_height])

    def _tell_source(self, source: Source) -> None:
        """STATUSTEXT when ALTITUDE carries the vehicle's own height from now on; that it is ours again
        is what the text about health says."""
        if source is self._source:
            return
        self._source = source
        if source is Source.VEHICLE and self.settings.publish.statustext:
            self.texts.say("source", source, mavlink.MAV_SEVERITY_NOTICE, OWN_HEIGHT_TEXT)
        else:
            self.texts.retract("source")

    def _restart_estimator(self) -> None:
        """Start the estimator anew. Observers see its samples only, as another would get them."""
        row = restart_row(self.now_us, self.now_us)
        self.filter.step(Kind.STATUS, row)
        self.air.restart()
        reason = f"estimator restarted, {self.health.reason}"
        logger.warning("%s (restart %d)", reason, self.checker.restarts)
        if self.settings.publish.statustext:
            text = f"Kollsman: {reason}"
            self.texts.say("restart", self.checker.restarts, mavlink.MAV_SEVERITY_WARNING, text)

    def _encode(self, messages: list[Message]) -> list[bytes]:
        if not self._sends:
            return []
        own, version = self.identity.own, self.identity.version
        if self.identity.vehicle is None:
            version = 2  # an autopilot that can speak MAVLink 2 may wait for it
        encoder = self._encoders.get(own)
        if encoder is None:
            encoder = self._encoders[own] = Encoder(*own)
        frames = (encoder.encode(message, version) for message in messages)
        return [frame for frame in frames if frame]
