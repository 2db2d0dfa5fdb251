"""The pipeline: packets in, estimates and MAVLink frames out.

Live and replay run this same code; it knows no link, no file and no host clock, so the same bytes
give the same estimates and the same output messages, bit for bit.
"""

import copy
from collections.abc import Callable, Mapping
from typing import Protocol

from companion.estimators import ESTIMATORS, Filter
from companion.health import Health, HealthMonitor
from companion.intake import Intake, SampleReject
from companion.mavlink import convert
from companion.mavlink.codec import Decoder, Encoder, Frame, Message, mavlink
from companion.mavlink.identity import Identity, Origin
from companion.mavlink.imu import ImuSelector
from companion.mavlink.outputs import Outputs, heartbeat
from companion.recorded import Item, Sensed
from companion.samples import Kind, Packet, Rows, Verdict
from companion.settings import CompanionSettings

HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
RAW_IMU = mavlink.MAVLINK_MSG_ID_RAW_IMU
HIGHRES_IMU = mavlink.MAVLINK_MSG_ID_HIGHRES_IMU
SYSTEM_TIME = mavlink.MAVLINK_MSG_ID_SYSTEM_TIME
ALTITUDE = mavlink.MAVLINK_MSG_ID_ALTITUDE
SIM_STATE = mavlink.MAVLINK_MSG_ID_SIM_STATE
GLOBAL_POSITION_INT = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
COMMANDS = frozenset({mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT})
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
    """

    def __init__(
        self,
        settings: CompanionSettings,
        *,
        datagrams: bool = False,
        observer: Observer | None = None,
        listeners: Mapping[int, Callable[[Message], None]] | None = None,
        sends: bool = True,
    ) -> None:
        self.settings = settings
        self._sends = sends
        self.decoder = Decoder(datagrams=datagrams)
        self.identity = Identity(settings.vehicle.system_id, settings.identity.component_id)
        self.intake = Intake(settings.intake)
        self.filter = Filter(ESTIMATORS[settings.estimator], settings.section(settings.estimator))
        self.health = HealthMonitor(settings.health, self.filter.method.uses)
        self.outputs = Outputs(settings.publish)
        self.verdicts = [[0] * len(Verdict) for _ in Kind]
        """how many samples of each kind got each verdict"""
        self.heard: dict[int, int] = {}
        """messages of the vehicle by id"""
        self.frames: list[Frame] = []
        """the frames of the last packet"""
        self._imu = ImuSelector()
        self._listeners = dict(listeners or {})
        self._encoder: Encoder | None = None
        self._wanted = set(convert.CONVERTERS) | {RAW_IMU, SYSTEM_TIME, ALTITUDE, *self._listeners}
        self.observe(observer)
        self._scaled_pressure_us = -PRESSURE_TIMEOUT_US
        self._tells_air = self._knows_air = (
            settings.air.qnh_hpa is not None or settings.air.temperature_c is not None
        )
        self._conflict: Callable[[Frame], None] | None = None

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
        vehicle, component_id = self.identity.vehicle, self.identity.component_id
        ours = (vehicle[0], component_id) if vehicle is not None else None
        return any((frame.system_id, frame.component_id) == ours for frame in self.frames)

    def observe(self, observer: Observer | None) -> None:
        """Let `observer` see what happens from now on."""
        self._observer = observer
        self._wants_imu = observer is not None or Kind.IMU in self.filter.method.uses
        if observer is not None:
            self._wanted |= {SIM_STATE, GLOBAL_POSITION_INT}

    def branch(self, observer: Observer) -> "Pipeline":
        """A second pipeline that goes on from here by itself, as if the packets differed from now
        on. It sends nothing.

        The two share the decoder, which keeps nothing between datagrams but its counters.
        """
        other = copy.deepcopy(
            self, {id(each): each for each in (self.decoder, self._encoder, self._observer)}
        )
        other._encoder = None
        other.observe(observer)
        return other

    def on_own_ids(self, callback: Callable[[Frame], None]) -> None:
        """Call back for every frame that carries our own ids."""
        self._conflict = callback

    def feed(self, packet: Packet) -> list[bytes]:
        """Take in a packet; the frames to send because of it."""
        return self._take(self.decoder.feed(packet.data), packet.time_us)

    def feed_item(self, item: Item, arrival_us: int) -> list[bytes]:
        """Take in what a log's reader has found; the frames to send because of it."""
        if isinstance(item, Frame):
            return self._take([item], arrival_us)
        self.frames = []
        if isinstance(item, Sensed):
            return self._reading(item.reading, item.source, arrival_us)
        self._compare(item.is_truth, item[1:])
        return []

    def flush(self, arrival_us: int) -> list[bytes]:
        """The line fell silent: give up on a half-received frame."""
        return self._take(self.decoder.flush(), arrival_us)

    def lose(self, reason: str) -> list[bytes]:
        """Nothing is heard any more, says the host's clock."""
        return (
            self._encode(self.outputs.status_text(Health.LOST, reason))
            if self.health.lose(reason)
            else []
        )

    def heartbeat(self) -> list[bytes]:
        """Our own heartbeat, once there is a vehicle."""
        return self._encode([heartbeat(self.health.health)])

    def encode(self, message: Message) -> list[bytes]:
        """A message of the service's own, such as a request to the vehicle."""
        return self._encode([message])

    def _take(self, frames: list[Frame], arrival_us: int) -> list[bytes]:
        self.frames = frames
        sent: list[bytes] = []
        for frame in frames:
            sent += self._frame(frame, arrival_us)
        return sent

    def _frame(self, frame: Frame, arrival_us: int) -> list[bytes]:
        identity = self.identity
        if identity.vehicle is None and frame.message_id == HEARTBEAT:
            message = self.decoder.decode(frame)
            if message is not None and identity.offer(frame, message):
                self._encoder = Encoder(
                    self.settings.identity.system_id or frame.system_id,
                    self.settings.identity.component_id,
                )
        origin = identity.origin(frame, arrival_us)
        if origin is Origin.OURSELVES:
            if self._conflict is not None:
                self._conflict(frame)
        elif frame.message_id in COMMANDS:
            return self._command(frame)
        if origin is not Origin.VEHICLE:
            return []
        self.heard[frame.message_id] = self.heard.get(frame.message_id, 0) + 1
        if frame.message_id not in self._wanted:
            return []
        message = self.decoder.decode(frame)
        return self._message(message, frame.message_id, arrival_us) if message is not None else []

    def _command(self, frame: Frame) -> list[bytes]:
        """A command addressed to us: we have none, and say so."""
        message = self.decoder.decode(frame)
        if (
            message is None
            or self.identity.vehicle is None
            or message.target_component != self.identity.component_id
        ):
            return []
        if message.target_system != self.identity.vehicle[0]:
            return []
        refusal = mavlink.MAV_RESULT_UNSUPPORTED
        answer = mavlink.MAVLink_command_ack_message(
            message.command, refusal, 0, 0, frame.system_id, frame.component_id
        )
        return self._encode([answer])

    def _message(self, message: Message, message_id: int, arrival_us: int) -> list[bytes]:
        listener = self._listeners.get(message_id)
        if listener is not None and getattr(message, "target_component", 0) in (
            0,
            self.identity.component_id,
        ):
            listener(message)  # an answer to somebody else's request is not ours
        if message_id == HEARTBEAT:
            self.identity.note(message)
            self.health.heartbeat(self.now_us)
        elif message_id == ALTITUDE:
            self.outputs.vehicle_altitude(self.now_us)
        elif message_id == SYSTEM_TIME:
            self.intake.clock.note_unix(message.time_unix_usec, message.time_boot_ms * 1000)
        elif message_id == SIM_STATE:
            self._compare(True, (self.now_us, *convert.sim_state(message)))
        elif message_id == GLOBAL_POSITION_INT:
            self._compare(False, convert.global_position(message))
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
        return converter(message) if converter is not None else ()

    def _reading(self, reading: convert.Reading, message_id: int, arrival_us: int) -> list[bytes]:
        time_us, reboot = self.intake.place(reading, message_id, arrival_us)
        sent: list[bytes] = []
        if reboot is not None:
            self.health.restart()
            self.outputs.restart()
            self._scaled_pressure_us = -PRESSURE_TIMEOUT_US
            self._tells_air = self._knows_air
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
        if self._tells_air and kind is Kind.PRESSURE:
            self._tells_air = False
            known = self.settings.air
            self._sample(Kind.AIR, 0, self.intake.air(known.qnh_hpa, known.temperature_c, row))
        return self._step(kind, instance, row)

    def _step(self, kind: Kind, instance: int, row: Rows) -> list[bytes]:
        """Give a sample to the estimator and its verdict to all who follow it."""
        verdict = self.filter.step(kind, row)
        self.verdicts[kind][verdict] += 1
        if instance == 0:
            self.health.sample(kind, verdict, self.now_us)
        self.outputs.sample(kind, row, verdict, self.filter.estimate)
        if self._observer is not None:
            self._observer.sample(kind, row, verdict, self.filter.estimate)
        return self._react(used=verdict is Verdict.USED)

    def _react(self, *, used: bool) -> list[bytes]:
        """What is due now that the vehicle's clock has moved: health, ALTITUDE if the estimate is
        new, DEBUG."""
        now_us, estimate = self.now_us, self.filter.estimate
        changed = (used or self.health.is_due(now_us)) and self.health.assess(now_us, estimate)
        health = self.health.health
        messages: list[Message] = []
        if used:
            altitude = self.outputs.altitude(now_us, health, estimate)
            if altitude is not None:
                messages.append(altitude)
                if self._observer is not None:
                    self._observer.published(altitude)
        if not self._sends:
            return []
        if changed:
            messages += self.outputs.status_text(health, self.health.reason)
        messages += self.outputs.debug(now_us, health, estimate, self.filter.state)
        return self._encode(messages) if messages else []

    def _encode(self, messages: list[Message]) -> list[bytes]:
        if self._encoder is None or not self._sends:
            return []
        frames = (self._encoder.encode(message, self.identity.version) for message in messages)
        return [frame for frame in frames if frame]
