"""State of the simulated aircraft in SI units: truth, controls, motion and air flow."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

Vector = tuple[float, float, float]


class Truth(NamedTuple):
    """The aircraft and the air around it at one instant. Angles in b relative to n, rates and
    forces in b."""

    time_us: int
    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    north_mps: float
    east_mps: float
    down_mps: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    roll_rate_radps: float
    pitch_rate_radps: float
    yaw_rate_radps: float
    pressure_pa: float
    temperature_k: float
    airspeed_mps: float
    """calibrated airspeed, m/s"""
    on_ground: bool

    @property
    def climb_mps(self) -> float:
        return -self.down_mps


new_truth: Callable[[tuple[Any, ...]], Truth] = partial(tuple.__new__, Truth)
"""`Truth` of a tuple, without the Python code of its constructor"""


class Controls(NamedTuple):
    """Positions of the controls, -1..1 or 0..1. Positive pitches up, rolls right, yaws right."""

    elevator: float = 0.0
    aileron: float = 0.0
    rudder: float = 0.0
    throttle: float = 0.0
    """thrust from idle (0) to full (1); -1..0 extends the speed brakes"""
    brake: float = 0.0
    steering: float = 0.0
    """deflection of the nose wheel"""
    flaps: float = 0.0
    gear: float = 1.0
    """position of the landing gear; 1 is down"""
    lift_dump: float = 0.0
    """deflection of the spoilers that reduce lift after touchdown, on aircraft that have them"""


new_controls: Callable[[tuple[float, ...]], Controls] = partial(tuple.__new__, Controls)
"""`Controls` of a tuple, without the Python code of its constructor"""


class Motion(NamedTuple):
    """Output of an ideal IMU at the centre of gravity, averaged over an interval."""

    specific_force_b_mps2: Vector
    angular_rate_b_radps: Vector
    """rate relative to inertial space, so it contains the Earth's rotation"""


new_motion: Callable[[tuple[Vector, Vector]], Motion] = partial(tuple.__new__, Motion)
"""`Motion` of a tuple, without the Python code of its constructor"""


class Flow(NamedTuple):
    """Quantities that disturb the pressure at a static port."""

    dynamic_pressure_pa: float
    sideslip_rad: float
    height_m: float
    """height of the centre of gravity above the ground, m"""
    load: float
    """load factor, positive upwards, 1 at rest"""
    throttle: float = 0.0
    """commanded thrust, 0 to 1"""
