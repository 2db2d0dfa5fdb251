"""The autopilots that the vehicle can simulate: their messages, parameters and answers."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

from companion.mavlink.codec import mavlink
from sim.vehicle import ardupilot as telemetry
from sim.vehicle import parameters, px4
from sim.vehicle.frames import packer
from sim.vehicle.parameters import Parameter
from sim.vehicle.stream import State, Telemetry

FlavourName = Literal["ardupilot", "copter", "px4", "generic"]

_DENIED: int = mavlink.MAV_RESULT_DENIED
_FAILED: int = mavlink.MAV_RESULT_FAILED
_ACCEPTED: int = mavlink.MAV_RESULT_ACCEPTED
_ANSWERED: int = (
    mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
"""capabilities that are answered; a client that is promised files or missions requests them"""


@dataclass(frozen=True)
class Flavour:
    """One kind of autopilot."""

    name: FlavourName
    messages: Mapping[int, Telemetry]
    parameters: tuple[Parameter, ...]
    software: tuple[int, int, int]
    capabilities: int
    unknown_interval: int
    """result of SET_MESSAGE_INTERVAL for a message it does not stream"""
    unknown_query: int
    """result of GET_MESSAGE_INTERVAL for such a message; the interval is 0, "not available"
    """
    unknown_request: int
    """result of REQUEST_MESSAGE for such a message"""
    ardupilot: bool = False
    """whether it sends ArduPilot's texts, and PARAM_VALUE without an index unless it was requested
    by index"""
    shortest_us: int = 0
    """shortest interval that is granted: ArduPilot sends in at most 0.8 of its loops"""
    step_us: int = 1
    """step of which intervals are multiples"""
    buckets: int = 1000
    """number of different intervals on a link; a further one is rounded to the nearest"""
    groups: bool = True
    """whether REQUEST_DATA_STREAM is obeyed"""
    baro_hz: int = 20
    """rate of its barometer readings: ArduPilot's vehicles call AP_Baro::update at 10 Hz"""
    timesync_us: int = 0
    """period of its TIMESYNC requests; 0 sends none"""
    raised_m: Callable[[Mapping[str, float], float], float] = lambda values, pressure_pa: 0.0
    """(parameters, pressure) -> offset that the parameters add to the barometric altitude, m"""
    raise_time_s: float = 0.0
    """time constant with which the altitude follows that offset"""
    listing_slowdown: int = 1
    """factor by which streams are slower on a link while its parameters are listed"""

    def version_payload(self) -> bytes:
        """AUTOPILOT_VERSION."""
        major, minor, patch = self.software
        return packer("AUTOPILOT_VERSION").named(
            capabilities=self.capabilities,
            flight_sw_version=major << 24
            | minor << 16
            | patch << 8,  # the last byte: a development version
            flight_custom_version=list(b"kollsman"),
            uid=_UID,
        )


def _generic_heartbeat(state: State) -> bytes:
    base_mode, status = (
        (156, 4) if state.armed else (80, 3)
    )  # auto, guided, stabilised; manual, stabilised
    return packer("HEARTBEAT").wire(0, mavlink.MAV_TYPE_FIXED_WING, 0, base_mode, status, 3)


def _copter_heartbeat(state: State) -> bytes:
    """Stabilize in standby; AUTO, armed and active."""
    base_mode, custom_mode, status = (217, 3, 4) if state.armed else (81, 0, 3)
    kind, autopilot = mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    return packer("HEARTBEAT").wire(custom_mode, kind, autopilot, base_mode, status, 3)


def _shortest_us(loop_hz: float) -> int:
    """ArduPilot denies messages more often than in 0.8 of its loops."""
    return round(1e6 / (0.8 * loop_hz))


PLANE_LOOP_HZ, COPTER_LOOP_HZ = 50.0, 400.0
"""SCHED_LOOP_RATE's defaults: Plane grants at most 40 Hz"""
_UID = 0x6B6F6C6C736D616E  # "kollsman"
_HEARTBEAT: int = mavlink.MAVLINK_MSG_ID_HEARTBEAT
_GENERIC = {key: row for key, row in telemetry.TELEMETRY.items() if row.full_hz > 0.0}
_GENERIC[_HEARTBEAT] = replace(_GENERIC[_HEARTBEAT], payload=_generic_heartbeat)
_COPTER = {key: replace(row, default_hz=0.0) for key, row in telemetry.TELEMETRY.items()}
_COPTER[_HEARTBEAT] = replace(
    _COPTER[_HEARTBEAT], payload=_copter_heartbeat, default_hz=_GENERIC[_HEARTBEAT].default_hz
)
"""ArduCopter streams HEARTBEAT alone to a link without requests."""

ARDUPILOT = Flavour(
    name="ardupilot",
    messages=telemetry.TELEMETRY,
    parameters=parameters.ARDUPILOT,
    software=(4, 7, 0),
    capabilities=_ANSWERED,
    unknown_interval=_DENIED,
    unknown_query=_FAILED,
    unknown_request=_FAILED,
    ardupilot=True,
    shortest_us=_shortest_us(PLANE_LOOP_HZ),
    step_us=1000,
    buckets=10,
    baro_hz=10,
    timesync_us=10_000_000,
    raised_m=lambda values, pressure_pa: values["BARO_ALT_OFFSET"],
    raise_time_s=4.95,  # AP_Baro::update, 10 Hz: 2 % of the difference (5 % before 2023-12, #25808)
    listing_slowdown=4,
)
COPTER = replace(
    ARDUPILOT, name="copter", messages=_COPTER, shortest_us=_shortest_us(COPTER_LOOP_HZ)
)
PX4 = Flavour(
    name="px4",
    messages=px4.TELEMETRY,
    parameters=parameters.PX4,
    software=(1, 17, 0),
    capabilities=_ANSWERED | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE,
    unknown_interval=_FAILED,
    unknown_query=_ACCEPTED,
    unknown_request=_DENIED,
    groups=False,
    timesync_us=100_000,
    raised_m=px4.raised_m,
)
GENERIC = Flavour(
    name="generic",
    messages=_GENERIC,
    parameters=parameters.GENERIC,
    software=(1, 0, 0),
    capabilities=_ANSWERED,
    unknown_interval=_DENIED,
    unknown_query=_FAILED,
    unknown_request=_FAILED,
)

FLAVOURS: Mapping[str, Flavour] = {
    flavour.name: flavour for flavour in (ARDUPILOT, COPTER, PX4, GENERIC)
}
