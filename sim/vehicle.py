"""The MAVLink face of the simulated vehicle, ArduPlane's flavour: streams, commands, and an ear for the companion.

System 1, component 1, MAVLink 2 (as with SERIALn_PROTOCOL 2). The commands that concern streams are obeyed a port at a
time, and every command addressed to the vehicle is acknowledged: what it does not know is UNSUPPORTED. For a message
that is not in `TELEMETRY` an interval is DENIED and a request FAILED, as ArduPilot 4.7 answers for ALTITUDE.
"""

import math
from collections import Counter, deque
from collections.abc import Callable
from typing import Any

from companion.mavlink.codec import Decoder, Frame, mavlink
from sim.estimate import OwnEstimate
from sim.frames import packer
from sim.ports import COMPONENT_ID, MAX_INTERVAL_US, SYSTEM_ID, Port
from sim.sensors.barometer import Pressure
from sim.sensors.gnss import Fix
from sim.telemetry import TELEMETRY, State

_ACCEPTED: int = mavlink.MAV_RESULT_ACCEPTED
_DENIED: int = mavlink.MAV_RESULT_DENIED
_UNSUPPORTED: int = mavlink.MAV_RESULT_UNSUPPORTED
_FAILED: int = mavlink.MAV_RESULT_FAILED


class Heard:
    """What came back from others: counts, and the last ALTITUDE with the simulated time of its arrival."""

    def __init__(self) -> None:
        self.counts: Counter[tuple[int, int, str]] = Counter()
        """frames by (system id, component id, message name)"""
        self.altitude: Any = None
        self.altitude_us: int | None = None
        self.texts: deque[tuple[int, str]] = deque(maxlen=100)
        """STATUSTEXT: (arrival, simulated microseconds; text), the last hundred"""

    def take(self, frame: Frame, message: Any, time_us: int) -> None:
        self.counts[frame.system_id, frame.component_id, message.get_type()] += 1
        if frame.message_id == mavlink.MAVLINK_MSG_ID_ALTITUDE:
            self.altitude, self.altitude_us = message, time_us
        elif frame.message_id == mavlink.MAVLINK_MSG_ID_STATUSTEXT:
            self.texts.append((time_us, str(message.text)))


class Vehicle:
    """Holds the last value of everything, streams it to the ports, and answers what they hear.

    `record` is called with (time_us, frame) for every frame received: a ground station's log holds those too.
    """

    def __init__(self, estimate: OwnEstimate, record: Callable[[int, bytes], None] | None = None) -> None:
        self.state = State()
        self.heard = Heard()
        self.ports: list[Port] = []
        self.estimate = estimate
        self._decoders: dict[Port, Decoder] = {}
        self._record = record
        self._commands: dict[int, Callable[[Port, Any], int]] = {
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            mavlink.MAV_CMD_REQUEST_MESSAGE: self._request_message,
        }
        self._handlers: dict[int, Callable[[Port, Frame, Any], None]] = {
            mavlink.MAVLINK_MSG_ID_COMMAND_LONG: self._on_command,
            mavlink.MAVLINK_MSG_ID_COMMAND_INT: self._on_command,
            mavlink.MAVLINK_MSG_ID_REQUEST_DATA_STREAM: self._on_data_stream,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
        }

    def add_port(self, port: Port) -> None:
        self.ports.append(port)
        self._decoders[port] = Decoder()

    # Out

    def on_pressure(self, sample: Pressure) -> None:
        self.state.pressure = sample
        self.estimate.on_pressure(sample)

    def on_fix(self, fix: Fix) -> None:
        self.state.fix = fix
        if self.estimate.on_fix(fix):
            self.say("EKF3 IMU0 origin set")
            self._set_home()

    def arm(self) -> None:
        """Armed, in AUTO; home moves to where it stands, as ArduPilot does it."""
        self.state.armed = True
        self.say("Throttle armed")
        self._set_home()

    def _set_home(self) -> None:
        self.state.home = self.estimate.position(self.state.time_us)
        for port in self.ports:
            port.hasten(mavlink.MAVLINK_MSG_ID_HOME_POSITION, self.state.time_us)

    def say(self, text: str, severity: int = mavlink.MAV_SEVERITY_INFO) -> None:
        """STATUSTEXT to every port."""
        statustext = packer("STATUSTEXT")
        payload = statustext.named(severity=severity, text=text)
        for port in self.ports:
            port.send(statustext, payload)

    def stream(self) -> None:
        """Send what is due at ``state.time_us``."""
        for port in self.ports:
            port.stream(self.state)

    # In

    def receive(self, port: Port, data: bytes) -> None:
        """Take bytes that arrived at `port` now. Whatever they are, nothing raises."""
        decoder = self._decoders[port]
        for frame in decoder.feed(data):
            message = decoder.decode(frame)
            if message is None:
                continue
            if self._record is not None:
                self._record(self.state.time_us, frame.data)
            self.heard.take(frame, message, self.state.time_us)
            handler = self._handlers.get(frame.message_id)
            if handler is not None:
                handler(port, frame, message)

    def _on_command(self, port: Port, frame: Frame, message: Any) -> None:
        if message.target_system not in (0, SYSTEM_ID) or message.target_component not in (0, COMPONENT_ID):
            return
        command = self._commands.get(message.command)
        result = _UNSUPPORTED if command is None else command(port, message)
        acknowledgement = packer("COMMAND_ACK")
        payload = acknowledgement.named(
            command=message.command,
            result=result,
            target_system=frame.system_id,
            target_component=frame.component_id,
        )
        port.send(acknowledgement, payload)

    def _set_interval(self, port: Port, message: Any) -> int:
        message_id, interval_us = _whole(message.param1), _whole(message.param2)
        if message_id is None or interval_us is None or interval_us < -1:
            return _DENIED
        if message_id not in TELEMETRY:
            self.say(f"No ap_message for mavlink id ({message_id})")
            return _DENIED
        port.set_interval(message_id, interval_us, self.state.time_us)
        return _ACCEPTED

    def _get_interval(self, port: Port, message: Any) -> int:
        """An unknown message has interval 0, "not available", and the command fails."""
        message_id = _whole(message.param1)
        if message_id is None or not 0 <= message_id <= 0xFFFF:
            return _DENIED
        known = message_id in TELEMETRY
        interval_us = port.interval_us(message_id) if known else 0
        answer = packer("MESSAGE_INTERVAL")
        port.send(answer, answer.named(message_id=message_id, interval_us=interval_us))
        return _ACCEPTED if known else _FAILED

    def _request_message(self, port: Port, message: Any) -> int:
        message_id = _whole(message.param1)
        row = None if message_id is None else TELEMETRY.get(message_id)
        payload = None if row is None else row.payload(self.state)
        if row is None or payload is None:
            return _FAILED
        port.send(row.packer, payload)
        return _ACCEPTED

    def _on_data_stream(self, port: Port, frame: Frame, message: Any) -> None:
        """A whole group; on this port and until the end of the flight only (a real Plane saves it to parameters)."""
        del frame
        if message.target_system not in (0, SYSTEM_ID) or message.target_component not in (0, COMPONENT_ID):
            return
        on = message.start_stop and message.req_message_rate
        interval_us = min(round(1e6 / message.req_message_rate), MAX_INTERVAL_US) if on else -1
        for message_id, row in TELEMETRY.items():
            if row.group >= 0 and message.req_stream_id in (mavlink.MAV_DATA_STREAM_ALL, row.group):
                port.set_interval(message_id, interval_us, self.state.time_us)

    def _on_timesync(self, port: Port, frame: Frame, message: Any) -> None:
        """Answer a request (tc1 zero) with the boot clock in nanoseconds."""
        del frame
        if message.tc1 == 0:
            timesync = packer("TIMESYNC")
            port.send(timesync, timesync.named(tc1=self.state.time_us * 1000, ts1=message.ts1))


def _whole(value: float) -> int | None:
    """A command's parameter as the integer it stands for; None when it is none."""
    return round(value) if math.isfinite(value) else None
