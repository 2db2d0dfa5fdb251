"""A streamed message of the simulated vehicle, and the values that messages are made of."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum

from sim.aircraft_state import Motion, Truth
from sim.sensors.barometer import Pressure
from sim.sensors.gnss import Fix
from sim.sensors.imu import ImuSample
from sim.vehicle.frames import Packer
from sim.vehicle.own_estimate import Position
from sim.weather import TrueAir


@dataclass(slots=True)
class State:
    """The values that the messages hold at one instant."""

    time_us: int = 0
    armed: bool = False
    truth: Truth | None = None
    motion: Motion | None = None
    """true mean motion over the last IMU sample"""
    attitude_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    throttle: float = 0.0
    """commanded throttle, 0 to 1"""
    imu: ImuSample | None = None
    pressure: Pressure | None = None
    air_temperature_k: float = math.nan
    """reading of the probe in the air; NaN without one"""
    fix: Fix | None = None
    position: Position | None = None
    home: Position | None = None
    origin: Position | None = None
    """origin of the vehicle's own estimate"""
    ground_pressure_pa: float = math.nan
    """first reading, to which the barometer was calibrated at boot"""
    parameters: Mapping[str, float] = field(default_factory=dict)
    true_air: Callable[[Truth], TrueAir] | None = None
    """true values of the air at the aircraft"""


class Fresh(Enum):
    """The sample that a message carries; the message is not repeated before there is a new one."""

    ANY = 0
    """no sample: the last values are sent whenever the message is due"""
    MOTION = 1
    FIX = 2
    IMU = 3
    PRESSURE = 4


@dataclass(frozen=True)
class Telemetry:
    """One streamed message."""

    packer: Packer
    payload: Callable[[State], bytes | None]
    """function that returns the payload; None while there is nothing to send"""
    default_hz: float
    """rate on a link without requests: ArduPlane's 1 Hz; 0 is sent on request only"""
    full_hz: float
    """rate in a log, and with --all-streams"""
    group: int = -1
    """MAV_DATA_STREAM of REQUEST_DATA_STREAM; -1 none"""
    fresh: Fresh = Fresh.ANY
    follows: tuple[int, ...] = ()
    """ids of messages that carry its time; it is sent right after one of them"""
