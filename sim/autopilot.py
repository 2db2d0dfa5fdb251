"""An autopilot of our own: JSBSim's c172p has none, and those its other models bring fail (no autothrottle, sinking).

Inner loops hold pitch and bank; pitch follows the airspeed in a climb at full power and the vertical speed otherwise,
when the throttle follows the airspeed. It is fed with the truth, and its altitude reference is the *true* geometric
altitude, not the pressure altitude a real one would hold: a profile is then flown alike in all weathers, and what the
weather does to the barometer is seen in the sensors alone.

Gains are data, one `Gains` an aircraft. Updated at `UPDATE_HZ`.
"""

import math
from dataclasses import dataclass
from enum import Enum, auto
from typing import NamedTuple

from companion.errors import SimulationError
from sim.aircraft import Truth

UPDATE_HZ = 50
_DT_S = 1.0 / UPDATE_HZ


@dataclass(frozen=True)
class Gains:
    """An aircraft's speeds and loop gains. Angles in rad, surfaces -1..1, throttle 0..1."""

    rotate_mps: float
    climb_mps: float
    """calibrated airspeed of the climb"""
    cruise_mps: float
    minimum_mps: float
    """calibrated airspeed below which nothing but the nose goes down"""
    climb_out_pitch_rad: float
    pitch_limits_rad: tuple[float, float] = (-0.21, 0.28)
    bank_limit_rad: float = 0.35
    pitch_p: float = 3.0
    pitch_i: float = 1.5
    pitch_rate: float = 0.9
    bank_p: float = 0.9
    bank_i: float = 0.1
    roll_rate: float = 0.25
    heading_p: float = 1.0
    yaw_rate: float = 0.4
    ground_heading_p: float = 2.0
    ground_yaw_rate: float = 1.5
    airspeed_pitch_p: float = 0.015
    airspeed_pitch_i: float = 0.002
    path_p: float = 0.9
    path_i: float = 0.35
    altitude_p: float = 0.2
    """1/s: the vertical speed commanded for a metre of altitude error, also the shape of a level-off"""
    throttle_p: float = 0.06
    throttle_i: float = 0.012
    throttle_trim: float = 0.65
    airspeed_filter_s: float = 1.0
    climb_slew_mps2: float = 0.7
    """how fast the commanded vertical speed changes: a quarter of what would be felt"""
    airspeed_slew_mps2: float = 0.7


GAINS = {
    "c172p": Gains(rotate_mps=28.0, climb_mps=38.0, cruise_mps=47.0, minimum_mps=29.0, climb_out_pitch_rad=0.14),
}


class Mode(Enum):
    """What the vertical channel does."""

    PARKED = auto()
    TAKE_OFF = auto()
    AIRSPEED = auto()
    """full power, pitch holds the airspeed"""
    ALTITUDE = auto()
    """pitch holds the vertical speed that leads to the altitude, throttle holds the airspeed"""


@dataclass
class Target:
    """What the profile asks of the autopilot."""

    mode: Mode
    heading_rad: float
    altitude_amsl_m: float = 0.0
    vertical_speed_limit_mps: float = 3.0
    airspeed_mps: float | None = None
    """None is the aircraft's own speed for the mode"""


class Controls(NamedTuple):
    """Positive pitches up, rolls right, yaws right."""

    elevator: float
    aileron: float
    rudder: float
    throttle: float
    brake: float


class Autopilot:
    """Holds a `Target`; `update` is called at `UPDATE_HZ` with the truth."""

    def __init__(self, model: str) -> None:
        if model not in GAINS:
            raise SimulationError(f"no autopilot gains for aircraft '{model}': there are {', '.join(sorted(GAINS))}")
        self.gains = GAINS[model]
        self._pitch_sum = 0.0
        self._bank_sum = 0.0
        self._path_pitch = 0.0
        self._throttle = 0.0
        self._airspeed_mps = 0.0
        self._mode = Mode.PARKED
        self._pitch_command = 0.0
        self._climb_command_mps = 0.0
        self._airspeed_command_mps = 0.0

    def update(self, truth: Truth, target: Target) -> Controls:
        gains = self.gains
        self._airspeed_mps += (truth.airspeed_mps - self._airspeed_mps) * _DT_S / gains.airspeed_filter_s
        if target.mode is Mode.PARKED:
            return Controls(0.0, 0.0, 0.0, 0.0, 1.0)
        mode = target.mode
        if mode is Mode.TAKE_OFF and self._climbs_away(truth):
            mode = Mode.AIRSPEED
        if mode is not self._mode:
            self._enter(mode, truth)
        if mode is Mode.TAKE_OFF:
            return self._take_off(truth, target)
        if mode is Mode.AIRSPEED:
            throttle = 1.0
            pitch = self._pitch_for_airspeed(self._slewed_airspeed(target.airspeed_mps or gains.climb_mps))
        else:
            throttle = self._throttle_for_airspeed(self._slewed_airspeed(target.airspeed_mps or gains.cruise_mps))
            pitch = self._pitch_for_altitude(truth, target)
        self._pitch_command = pitch
        bank, rudder = self._lateral(truth, target)
        return Controls(self._elevator(truth, pitch), self._aileron(truth, bank), rudder, throttle, 0.0)

    def _climbs_away(self, truth: Truth) -> bool:
        """In the air with the speed to climb at: the pitch may follow the airspeed from here."""
        fast = self._mode is Mode.AIRSPEED or truth.airspeed_mps >= self.gains.climb_mps
        return fast and not truth.on_ground

    def _enter(self, mode: Mode, truth: Truth) -> None:
        """Take over without a bump: the new law starts from the pitch that the old one commanded."""
        self._mode = mode
        self._path_pitch = self._pitch_command
        self._throttle = 1.0
        self._climb_command_mps = truth.climb_mps
        self._airspeed_command_mps = self._airspeed_mps

    def _take_off(self, truth: Truth, target: Target) -> Controls:
        """Run straight, lift the nose at the rotation speed, climb out wings level."""
        gains = self.gains
        error = _wrapped(target.heading_rad - truth.yaw_rad)
        if truth.on_ground:
            rudder = _clamp(gains.ground_heading_p * error - gains.ground_yaw_rate * truth.yaw_rate_radps, -1.0, 1.0)
            if truth.airspeed_mps < gains.rotate_mps:
                self._pitch_command = truth.pitch_rad
                return Controls(0.0, self._aileron(truth, 0.0), rudder, 1.0, 0.0)
        else:
            rudder = -gains.yaw_rate * truth.yaw_rate_radps
        # The nose comes up at 4 degrees a second, as a pilot lifts it.
        self._pitch_command = min(self._pitch_command + 0.07 * _DT_S, gains.climb_out_pitch_rad)
        bank = 0.0 if truth.on_ground else _clamp(gains.heading_p * error, -0.2, 0.2)
        return Controls(self._elevator(truth, self._pitch_command), self._aileron(truth, bank), rudder, 1.0, 0.0)

    def _slewed_airspeed(self, airspeed_mps: float) -> float:
        self._airspeed_command_mps = _towards(
            self._airspeed_command_mps, airspeed_mps, self.gains.airspeed_slew_mps2 * _DT_S
        )
        return self._airspeed_command_mps

    def _pitch_for_airspeed(self, airspeed_mps: float) -> float:
        gains = self.gains
        error = self._airspeed_mps - airspeed_mps
        low, high = gains.pitch_limits_rad
        self._path_pitch = _clamp(self._path_pitch + gains.airspeed_pitch_i * error * _DT_S, low, high)
        return _clamp(self._path_pitch + gains.airspeed_pitch_p * error, low, high)

    def _pitch_for_altitude(self, truth: Truth, target: Target) -> float:
        gains = self.gains
        limit = target.vertical_speed_limit_mps
        wanted = _clamp(gains.altitude_p * (target.altitude_amsl_m - truth.altitude_amsl_m), -limit, limit)
        # Only going faster up or down is slewed: the altitude law itself shapes a level-off.
        if 0.0 <= wanted / (self._climb_command_mps or math.inf) <= 1.0:
            self._climb_command_mps = wanted
        else:
            self._climb_command_mps = _towards(self._climb_command_mps, wanted, gains.climb_slew_mps2 * _DT_S)
        slope_error = (self._climb_command_mps - truth.climb_mps) / max(self._airspeed_mps, gains.minimum_mps)
        low, high = gains.pitch_limits_rad
        if self._airspeed_mps < gains.minimum_mps:  # out of power: flying comes before holding the altitude
            slope_error = min(slope_error, -0.1)
        self._path_pitch = _clamp(self._path_pitch + gains.path_i * slope_error * _DT_S, low, high)
        return _clamp(self._path_pitch + gains.path_p * slope_error, low, high)

    def _throttle_for_airspeed(self, airspeed_mps: float) -> float:
        gains = self.gains
        error = airspeed_mps - self._airspeed_mps
        self._throttle = _clamp(self._throttle + gains.throttle_i * error * _DT_S, 0.0, 1.0)
        return _clamp(self._throttle + gains.throttle_p * error, 0.0, 1.0)

    def _lateral(self, truth: Truth, target: Target) -> tuple[float, float]:
        """Bank towards the heading, and a yaw damper that allows the turn's own rate."""
        gains = self.gains
        error = _wrapped(target.heading_rad - truth.yaw_rad)
        bank = _clamp(gains.heading_p * error, -gains.bank_limit_rad, gains.bank_limit_rad)
        turn_rate = 9.81 * math.sin(truth.roll_rad) / max(self._airspeed_mps, gains.minimum_mps)
        return bank, _clamp(gains.yaw_rate * (turn_rate - truth.yaw_rate_radps), -0.5, 0.5)

    def _elevator(self, truth: Truth, pitch_rad: float) -> float:
        gains = self.gains
        error = pitch_rad - truth.pitch_rad
        self._pitch_sum = _clamp(self._pitch_sum + gains.pitch_i * error * _DT_S, -0.6, 0.6)
        return _clamp(gains.pitch_p * error + self._pitch_sum - gains.pitch_rate * truth.pitch_rate_radps, -1.0, 1.0)

    def _aileron(self, truth: Truth, bank_rad: float) -> float:
        gains = self.gains
        error = bank_rad - truth.roll_rad
        self._bank_sum = _clamp(self._bank_sum + gains.bank_i * error * _DT_S, -0.3, 0.3)
        return _clamp(gains.bank_p * error + self._bank_sum - gains.roll_rate * truth.roll_rate_radps, -1.0, 1.0)


def _clamp(value: float, low: float, high: float) -> float:
    return low if value < low else high if value > high else value


def _towards(value: float, goal: float, step: float) -> float:
    return value + _clamp(goal - value, -step, step)


def _wrapped(angle_rad: float) -> float:
    """The same angle in -pi..pi."""
    return math.remainder(angle_rad, math.tau)
