"""The MAVLink interface of the simulated vehicle: streams, commands, parameters, and the messages
of the companion.

System 1, component 1, MAVLink 2 (as with SERIALn_PROTOCOL 2). The commands that concern streams are
obeyed a port at a time, and every command addressed to the vehicle is acknowledged: what it does
not know is UNSUPPORTED. What it answers for a message that it does not stream is its flavour's
(`sim.vehicle.flavours`): ArduPilot 4.7 denies an interval of ALTITUDE and fails a request. What one
port brings goes on to others as `sim.vehicle.routing` says.
"""

import math
from collections import Counter, deque
from collections.abc import Callable
from typing import Any

from companion.mavlink.codec import Decoder, Frame, mavlink
from sim.sensors.barometer import Pressure
from sim.sensors.gnss import Fix
from sim.vehicle.flavours import ARDUPILOT, Flavour
from sim.vehicle.frames import COMPONENT_ID, SYSTEM_ID, packer
from sim.vehicle.own_estimate import OwnEstimate
from sim.vehicle.parameters import Parameters
from sim.vehicle.ports import MAX_INTERVAL_US, Port
from sim.vehicle.routing import Routing
from sim.vehicle.stream import State

_ACCEPTED: int = mavlink.MAV_RESULT_ACCEPTED
_DENIED: int = mavlink.MAV_RESULT_DENIED
_UNSUPPORTED: int = mavlink.MAV_RESULT_UNSUPPORTED
_BYTEWISE: int = mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
_VERSION_ID: int = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION


class Heard:
    """Messages of other programs: counts, and the last ALTITUDE with the simulated time of its
    arrival."""

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
    """Holds the last values, streams them to the ports, and answers what the ports receive.

    `record` is called with (time_us, frame) for every frame received: a ground station's log holds
    those too.
    """

    def __init__(
        self,
        estimate: OwnEstimate,
        record: Callable[[int, bytes], None] | None = None,
        flavour: Flavour = ARDUPILOT,
    ) -> None:
        self.flavour = flavour
        bytewise = bool(
            flavour.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        )
        self.parameters = Parameters(
            flavour.parameters, indexed=not flavour.ardupilot, bytewise=bytewise
        )
        self.state = State(parameters=self.parameters.values)
        self.heard = Heard()
        self.ports: list[Port] = []
        self.estimate = estimate
        self._decoders: dict[Port, Decoder] = {}
        self._record = record
        self._routing = Routing()
        self._listing: dict[Port, int] = {}
        """ports that the parameters are listed on, and the index of the next"""
        self._timesync_us: dict[Port, int] = {}
        """ports from which something has been heard, and when the time is asked for there"""
        self._commands: dict[int, Callable[[Port, Any], int]] = {
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            mavlink.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._request_version,
            mavlink.MAV_CMD_GET_HOME_POSITION: self._request_home,
        }
        self._handlers: dict[int, Callable[[Port, Frame, Any], None]] = {
            mavlink.MAVLINK_MSG_ID_COMMAND_LONG: self._on_command,
            mavlink.MAVLINK_MSG_ID_COMMAND_INT: self._on_command,
            mavlink.MAVLINK_MSG_ID_REQUEST_DATA_STREAM: self._on_data_stream,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._on_parameter_list,
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._on_parameter_read,
            mavlink.MAVLINK_MSG_ID_PARAM_SET: self._on_parameter_set,
            mavlink.MAVLINK_MSG_ID_PING: self._on_ping,
            mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: self._on_mission_list,
            mavlink.MAVLINK_MSG_ID_MISSION_COUNT: self._on_mission_count,
        }

    def add_port(self, port: Port) -> None:
        self.ports.append(port)
        self._decoders[port] = Decoder()

    # Out

    def on_pressure(self, sample: Pressure) -> None:
        if self.state.pressure is None:
            self.state.ground_pressure_pa = sample.pressure_pa
            self._calibrate(sample)
        self.state.pressure = sample
        raised_m = self.flavour.raised_m(self.parameters.values, sample.pressure_pa)
        self.estimate.on_pressure(sample, raised_m)

    def _calibrate(self, sample: Pressure) -> None:
        """ArduPilot calibrates its barometer to the ground's pressure at boot and at arming."""
        if "BARO1_GND_PRESS" in self.parameters.values:
            self.parameters.values["BARO1_GND_PRESS"] = sample.pressure_pa

    def reboot(self) -> None:
        """The vehicle's own estimate begins anew at its present position; ArduPilot's calibration
        at boot sets BARO_ALT_OFFSET to 0. Streams and clock go on: see the fault ``reboot`` for
        those."""
        if "BARO_ALT_OFFSET" in self.parameters.values:
            self.parameters.values["BARO_ALT_OFFSET"] = 0.0
        self.state.pressure = self.state.home = self.state.origin = None
        self.estimate.restart()

    def on_fix(self, fix: Fix) -> None:
        self.state.fix = fix
        if self.estimate.on_fix(fix):
            self.say("EKF3 IMU0 origin set" if self.flavour.ardupilot else "GNSS origin set")
            self.state.origin = self.estimate.position(self.state.time_us)
            self._set_home()

    def arm(self, armed: bool = True) -> None:
        """Armed, in AUTO; home moves to where it stands, as ArduPilot does it. Or disarmed
        again."""
        self.state.armed = armed
        word = "armed" if armed else "disarmed"
        self.say(f"Throttle {word}" if self.flavour.ardupilot else word.capitalize())
        if armed:
            if self.state.pressure is not None:
                self._calibrate(self.state.pressure)
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
        if self._timesync_us:
            self._ask_for_the_time()
        if self._listing:
            self._list_parameters()

    def _ask_for_the_time(self) -> None:
        """Send TIMESYNC with the boot clock in ts1 (ArduPilot adds its system id, to recognise the
        answers to its requests)."""
        now_us = self.state.time_us
        for port, due_us in self._timesync_us.items():
            if due_us <= now_us:
                self._timesync_us[port] = now_us + self.flavour.timesync_us
                timesync = packer("TIMESYNC")
                ts1 = now_us * 1000 + (SYSTEM_ID if self.flavour.ardupilot else 0)
                port.send(timesync, timesync.named(ts1=ts1))

    def _list_parameters(self) -> None:
        """One a tick on each port that asked."""
        for port, index in list(self._listing.items()):
            port.send(packer("PARAM_VALUE"), self.parameters.payload(index, by_index=True))
            self._listing[port] = index + 1
            if index + 1 == len(self.parameters):
                del self._listing[port]
                port.slowdown = 1

    # In

    def receive(self, port: Port, data: bytes) -> None:
        """Handle bytes that arrived at `port` now. No bytes raise an error."""
        decoder = self._decoders[port]
        for frame in decoder.feed(data):
            message = decoder.decode(frame)
            if message is None:
                continue
            if self._record is not None:
                self._record(self.state.time_us, frame.data)
            self.heard.take(frame, message, self.state.time_us)
            if not port.heard:
                port.heard = True
                if self.flavour.timesync_us:
                    self._timesync_us[port] = self.state.time_us + self.flavour.timesync_us
            for other in self._routing.onward(port, frame, message):
                other.forward(frame.data)
            handler = self._handlers.get(frame.message_id)
            if handler is not None:
                handler(port, frame, message)

    def _on_command(self, port: Port, frame: Frame, message: Any) -> None:
        if not _is_ours(message):
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
        if message_id not in self.flavour.messages:
            if self.flavour.ardupilot:
                self.say(f"No ap_message for mavlink id ({message_id})")
            return self.flavour.unknown_interval
        if 0 < interval_us < self.flavour.shortest_us:
            return _DENIED
        port.set_interval(message_id, interval_us, self.state.time_us)
        return _ACCEPTED

    def _get_interval(self, port: Port, message: Any) -> int:
        """An unknown message has interval 0, "not available"."""
        message_id = _whole(message.param1)
        if message_id is None or not 0 <= message_id <= 0xFFFF:
            return _DENIED
        known = message_id in self.flavour.messages
        interval_us = port.interval_us(message_id) if known else 0
        answer = packer("MESSAGE_INTERVAL")
        port.send(answer, answer.named(message_id=message_id, interval_us=interval_us))
        return _ACCEPTED if known else self.flavour.unknown_query

    def _request_message(self, port: Port, message: Any) -> int:
        message_id = _whole(message.param1)
        if message_id == _VERSION_ID:
            return self._request_version(port, message)
        return self._send_now(port, message_id)

    def _request_home(self, port: Port, message: Any) -> int:
        """GET_HOME_POSITION, the older command, which MAVROS uses."""
        del message
        return self._send_now(port, mavlink.MAVLINK_MSG_ID_HOME_POSITION)

    def _send_now(self, port: Port, message_id: int | None) -> int:
        row = None if message_id is None else self.flavour.messages.get(message_id)
        payload = None if row is None else row.payload(self.state)
        if row is None or payload is None:
            return self.flavour.unknown_request
        port.send(row.packer, payload)
        return _ACCEPTED

    def _request_version(self, port: Port, message: Any) -> int:
        del message
        port.send(packer("AUTOPILOT_VERSION"), self.flavour.version_payload())
        return _ACCEPTED

    def _on_data_stream(self, port: Port, frame: Frame, message: Any) -> None:
        """A whole group; on this port and until the end of the flight only (a real Plane saves it
        to parameters)."""
        del frame
        if not _is_ours(message) or not self.flavour.groups:
            return
        on = message.start_stop and message.req_message_rate
        interval_us = min(round(1e6 / message.req_message_rate), MAX_INTERVAL_US) if on else -1
        for message_id, row in self.flavour.messages.items():
            if row.group >= 0 and message.req_stream_id in (mavlink.MAV_DATA_STREAM_ALL, row.group):
                port.set_interval(message_id, interval_us, self.state.time_us)

    def _on_timesync(self, port: Port, frame: Frame, message: Any) -> None:
        """Answer a request (tc1 zero) with the boot clock in nanoseconds."""
        del frame
        if message.tc1 == 0:
            timesync = packer("TIMESYNC")
            port.send(timesync, timesync.named(tc1=self.state.time_us * 1000, ts1=message.ts1))

    def _on_ping(self, port: Port, frame: Frame, message: Any) -> None:
        """PING: returned to its sender; ArduPilot does not support it."""
        if not self.flavour.ardupilot and (message.target_system, message.target_component) == (
            0,
            0,
        ):
            ping = packer("PING")
            sender = {"target_system": frame.system_id, "target_component": frame.component_id}
            port.send(ping, ping.named(time_usec=message.time_usec, seq=message.seq, **sender))

    def _on_parameter_list(self, port: Port, frame: Frame, message: Any) -> None:
        """List the parameters from the first one, also while a list is sent."""
        del frame
        if _is_ours(message):
            self._listing[port] = 0
            port.slowdown = self.flavour.listing_slowdown

    def _on_parameter_read(self, port: Port, frame: Frame, message: Any) -> None:
        """Send the requested parameter; an unknown one is not answered."""
        del frame
        if _is_ours(message):
            index = self.parameters.find(str(message.param_id), message.param_index)
            if index is not None:
                payload = self.parameters.payload(index, by_index=message.param_index >= 0)
                port.send(packer("PARAM_VALUE"), payload)

    def _on_parameter_set(self, port: Port, frame: Frame, message: Any) -> None:
        """Set a parameter; PARAM_VALUE with the new value goes to every port in use, or to the
        requesting one if it did not change."""
        del frame
        name = str(message.param_id)
        index = self.parameters.find(name, -1)
        if not _is_ours(message) or index is None:
            return
        changed = self.parameters.set(name, message.param_value, message.param_type)
        if not changed and self.flavour.ardupilot:
            if not math.isfinite(message.param_value):
                return
            self.say(f"Param write denied ({name})", mavlink.MAV_SEVERITY_WARNING)
        for other in self.ports:
            if other is port or (changed and other.heard):
                other.send(packer("PARAM_VALUE"), self.parameters.payload(index, by_index=False))

    def _on_mission_list(self, port: Port, frame: Frame, message: Any) -> None:
        """Answer that there is no mission."""
        if _is_ours(message):
            count = packer("MISSION_COUNT")
            sender = {"target_system": frame.system_id, "target_component": frame.component_id}
            port.send(count, count.named(count=0, mission_type=message.mission_type, **sender))

    def _on_mission_count(self, port: Port, frame: Frame, message: Any) -> None:
        """Refuse a mission."""
        if _is_ours(message):
            answer = packer("MISSION_ACK")
            payload = answer.named(
                target_system=frame.system_id,
                target_component=frame.component_id,
                type=mavlink.MAV_MISSION_UNSUPPORTED,
                mission_type=message.mission_type,
            )
            port.send(answer, payload)


def _is_ours(message: Any) -> bool:
    return message.target_system in (0, SYSTEM_ID) and message.target_component in (0, COMPONENT_ID)


def _whole(value: float) -> int | None:
    """A command's parameter as an integer; None when it is not one."""
    return round(value) if math.isfinite(value) else None
