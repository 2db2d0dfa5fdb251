"""The simulated autopilot. JSBSim's c172p has none, and those of its other models do not hold speed
or altitude.

Inner loops hold pitch and bank; pitch follows the airspeed in a climb at full power and the
vertical speed otherwise, when the throttle follows the airspeed. Its input is the
truth, and its altitude reference is the *true* geometric altitude, not the pressure altitude of a
real autopilot: a profile is then flown alike in all weathers, and the weather changes the sensors
alone.

Speed brakes are the throttle's range below idle. Updated at `UPDATE_HZ`; the gains are data
(`sim.pilot.gains`).
"""

import math
from dataclasses import dataclass
from enum import Enum, auto

from companion.errors import SimulationError
from sim.aircraft_state import Controls, Truth, new_controls
from sim.pilot.gains import GAINS

UPDATE_HZ = 50
_DT_S = 1.0 / UPDATE_HZ
_GEAR_UP_MPS = 2.0
"""climb rate above which the landing gear is retracted"""
_FLARE_BANK_RAD = 0.09
_ALOFT_THROTTLE = 0.6
_RETARD_PER_S = 0.4
"""rate at which the throttle closes in the flare"""


class Mode(Enum):
    """Mode of the vertical channel."""

    PARKED = auto()
    TAKE_OFF = auto()
    AIRSPEED = auto()
    """throttle fixed, pitch holds the airspeed"""
    ALTITUDE = auto()
    """pitch holds the vertical speed that leads to the altitude, throttle holds the airspeed"""
    APPROACH = auto()
    """the same with gear and flaps out, along an altitude that moves at `climb_mps`"""
    FLARE = auto()
    """engines idle, pitch holds `climb_mps`"""
    ROLL_OUT = auto()
    """on the ground: straight on, spoilers out, brakes as given"""


@dataclass
class Target:
    """Targets that the profile gives the autopilot."""

    mode: Mode
    heading_rad: float
    altitude_amsl_m: float = 0.0
    vertical_speed_limit_mps: float = 3.0
    airspeed_mps: float | None = None
    """calibrated airspeed; None is the aircraft's own for the mode"""
    throttle: float = 1.0
    """throttle in mode AIRSPEED"""
    climb_mps: float = 0.0
    """vertical speed along the approach path, or in the flare"""
    bank_rad: float | None = None
    """bank at which to circle instead of holding the heading"""
    brake: float = 0.0
    """brake in the roll-out"""


# Looked up in its class, a member costs four times as much (Python 3.11).
_PARKED, _TAKE_OFF, _AIRSPEED, _ALTITUDE, _APPROACH, _FLARE, _ROLL_OUT = Mode


class Autopilot:
    """Holds a `Target`; `update` is called at `UPDATE_HZ` with the truth."""

    def __init__(self, model: str) -> None:
        if model not in GAINS:
            raise SimulationError(
                f"aircraft '{model}' has no autopilot gains: give one of {', '.join(sorted(GAINS))}"
            )
        self.gains = GAINS[model]
        self._pitch_sum = 0.0
        self._bank_sum = 0.0
        self._bank_command = 0.0
        self._effectiveness = 1.0
        """factor of the surface deflections above the dynamic pressure at which the gains were
        tuned"""
        self._path_pitch = 0.0
        self._throttle = 0.0
        self._sum_throttle = 0.0
        self._flap_setting = 0.0
        self._airspeed_mps = 0.0
        self._mode = _PARKED
        self._pitch_command = 0.0
        self._climb_command_mps = 0.0
        self._airspeed_command_mps = 0.0

    def update(self, truth: Truth, target: Target) -> Controls:
        gains = self.gains
        self._airspeed_mps += (
            (truth.airspeed_mps - self._airspeed_mps) * _DT_S / gains.airspeed_filter_s
        )
        if target.mode is _PARKED:
            return Controls(0.0, 0.0, 0.0, 0.0, 1.0)
        mode = target.mode
        if mode is _TAKE_OFF and self._climbs_away(truth):
            mode = _AIRSPEED
        if self._mode is _PARKED and not truth.on_ground:
            self._start_aloft(truth)
        full_mps = gains.full_surface_mps
        self._effectiveness = (
            1.0 if self._airspeed_mps <= full_mps else (full_mps / self._airspeed_mps) ** 2
        )
        if mode is not self._mode:
            self._enter(mode, truth)
        if mode is _TAKE_OFF:
            return self._take_off(truth, target)
        if mode is _ROLL_OUT:
            return self._roll_out(truth, target)
        self._throttle = self._throttle_for(mode, target)
        pitch = self._pitch_for(mode, truth, target)
        self._pitch_command = pitch
        bank, rudder = self._lateral(truth, target)
        if mode is _FLARE:  # the wing tips are near the ground
            bank = _clamp(bank, -_FLARE_BANK_RAD, _FLARE_BANK_RAD)
        gear = 1.0 if mode is _APPROACH or mode is _FLARE else 0.0
        elevator, aileron = self._elevator(truth, pitch), self._aileron(truth, bank)
        return new_controls(
            (elevator, aileron, rudder, self._throttle, 0.0, 0.0, self._flaps(mode), gear, 0.0)
        )

    def _throttle_for(self, mode: Mode, target: Target) -> float:
        if mode is _AIRSPEED:
            return target.throttle
        if mode is _FLARE:
            return min(self._throttle, _towards(self._throttle, 0.0, _RETARD_PER_S * _DT_S))
        # On the approach half as fast, because the extending flaps decelerate too.
        haste = 0.5 if mode is _APPROACH else 1.0
        return self._throttle_for_airspeed(
            self._slewed_airspeed(target.airspeed_mps or self.gains.cruise_mps, haste)
        )

    def _pitch_for(self, mode: Mode, truth: Truth, target: Target) -> float:
        gains = self.gains
        if mode is _AIRSPEED:
            return self._pitch_for_airspeed(
                self._slewed_airspeed(target.airspeed_mps or gains.climb_mps)
            )
        if mode is _FLARE:
            return self._pitch_for_climb(truth, target.climb_mps, 0.0, gains.flare_gain)
        limit = target.vertical_speed_limit_mps
        wanted = _clamp(
            gains.altitude_p * (target.altitude_amsl_m - truth.altitude_amsl_m), -limit, limit
        )
        lowest_mps = 0.9 * gains.approach_mps if mode is _APPROACH else gains.minimum_mps
        return self._pitch_for_climb(
            truth, self._slewed_climb(wanted + target.climb_mps), lowest_mps
        )

    def _flaps(self, mode: Mode) -> float:
        """Out as the commanded airspeed falls from the clean one to the approach's; in once fast
        after take-off."""
        gains = self.gains
        if mode is _APPROACH:
            slowness = (gains.clean_mps - self._airspeed_command_mps) / (
                gains.clean_mps - gains.approach_mps
            )
            self._flap_setting = max(
                self._flap_setting, gains.landing_flaps * _clamp(slowness, 0.0, 1.0)
            )
        elif mode is not _FLARE and self._airspeed_mps > gains.clean_mps:
            self._flap_setting = 0.0
        return self._flap_setting

    def _climbs_away(self, truth: Truth) -> bool:
        """In the air with the speed to climb at: the pitch may follow the airspeed from here."""
        enough_mps = self.gains.climb_out_mps or self.gains.climb_mps
        fast = self._mode is _AIRSPEED or truth.airspeed_mps >= enough_mps
        return fast and not truth.on_ground

    def _start_aloft(self, truth: Truth) -> None:
        self._airspeed_mps = truth.airspeed_mps
        self._pitch_command = truth.pitch_rad
        self._throttle = _ALOFT_THROTTLE

    def _enter(self, mode: Mode, truth: Truth) -> None:
        """Change the mode without a step: the new law starts from the pitch that the old one
        commanded."""
        self._mode = mode
        self._path_pitch = self._pitch_command
        self._sum_throttle = self._throttle
        self._climb_command_mps = truth.climb_mps
        self._airspeed_command_mps = self._airspeed_mps

    def _take_off(self, truth: Truth, target: Target) -> Controls:
        """Run straight, lift the nose at the rotation speed, climb out wings level."""
        gains = self.gains
        self._throttle, self._flap_setting = 1.0, gains.take_off_flaps
        error = _wrapped(target.heading_rad - truth.yaw_rad)
        if truth.on_ground:
            rudder = self._ground_rudder(truth, error)
            if truth.airspeed_mps < gains.rotate_mps:
                self._pitch_command = truth.pitch_rad
                return Controls(
                    0.0,
                    self._aileron(truth, 0.0),
                    rudder,
                    1.0,
                    0.0,
                    gains.take_off_nose_wheel * rudder,
                    gains.take_off_flaps,
                )
        else:
            rudder = -gains.yaw_rate * truth.yaw_rate_radps
        # The nose comes up at 4 degrees a second, as a pilot lifts it.
        self._pitch_command = min(self._pitch_command + 0.07 * _DT_S, gains.climb_out_pitch_rad)
        bank = 0.0 if truth.on_ground else _clamp(gains.heading_p * error, -0.2, 0.2)
        return Controls(
            self._elevator(truth, self._pitch_command), self._aileron(truth, bank), rudder, 1.0,
            flaps=gains.take_off_flaps,
            gear=float(truth.on_ground or truth.climb_mps < _GEAR_UP_MPS),
        )  # fmt: skip

    def _roll_out(self, truth: Truth, target: Target) -> Controls:
        """Engines idle, the nose let down at two degrees a second, then straight on."""
        # Without power there is no slipstream over the rudder, and a crosswind weathercocks: twice
        # as firmly.
        rudder = self._ground_rudder(truth, 2.0 * _wrapped(target.heading_rad - truth.yaw_rad))
        self._throttle = 0.0
        self._pitch_command = max(self._pitch_command - 0.035 * _DT_S, -0.02)
        slow = truth.airspeed_mps < 0.5 * self.gains.rotate_mps
        elevator = 0.0 if slow else self._elevator(truth, self._pitch_command)
        # A side wind would lift the wing that it meets until the other touches the ground: four
        # times as firmly.
        aileron = self._aileron(truth, -3.0 * truth.roll_rad)
        return Controls(
            elevator, aileron, rudder, -self.gains.speedbrake, target.brake,
            self.gains.nose_wheel * rudder, self._flap_setting, lift_dump=1.0,
        )  # fmt: skip

    def _ground_rudder(self, truth: Truth, error_rad: float) -> float:
        gains = self.gains
        return _clamp(
            gains.ground_heading_p * error_rad - gains.ground_yaw_rate * truth.yaw_rate_radps,
            -1.0,
            1.0,
        )

    def _slewed_airspeed(self, airspeed_mps: float, haste: float = 1.0) -> float:
        self._airspeed_command_mps = _towards(
            self._airspeed_command_mps, airspeed_mps, haste * self.gains.airspeed_slew_mps2 * _DT_S
        )
        return self._airspeed_command_mps

    def _pitch_for_airspeed(self, airspeed_mps: float) -> float:
        gains = self.gains
        error = self._airspeed_mps - airspeed_mps
        low, high = gains.pitch_limits_rad
        self._path_pitch = _clamp(
            self._path_pitch + gains.airspeed_pitch_i * error * _DT_S, low, high
        )
        return _clamp(self._path_pitch + gains.airspeed_pitch_p * error, low, high)

    def _slewed_climb(self, wanted_mps: float) -> float:
        # Only going faster up or down is slewed: the altitude law itself shapes a level-off.
        if 0.0 <= wanted_mps / (self._climb_command_mps or math.inf) <= 1.0:
            self._climb_command_mps = wanted_mps
        else:
            self._climb_command_mps = _towards(
                self._climb_command_mps, wanted_mps, self.gains.climb_slew_mps2 * _DT_S
            )
        return self._climb_command_mps

    def _pitch_for_climb(
        self, truth: Truth, climb_mps: float, lowest_mps: float, gain: float = 1.0
    ) -> float:
        """The pitch that holds a vertical speed; below the airspeed `lowest_mps`, the pitch that
        regains speed."""
        gains = self.gains
        slope_error = (
            gain * (climb_mps - truth.climb_mps) / max(self._airspeed_mps, gains.minimum_mps)
        )
        low, high = gains.pitch_limits_rad
        if (
            self._airspeed_mps < lowest_mps
        ):  # out of power: flying comes before holding the altitude
            slope_error = min(slope_error, -0.1)
        self._path_pitch = _clamp(self._path_pitch + gains.path_i * slope_error * _DT_S, low, high)
        return _clamp(self._path_pitch + gains.path_p * slope_error, low, high)

    def _throttle_for_airspeed(self, airspeed_mps: float) -> float:
        gains = self.gains
        error = airspeed_mps - self._airspeed_mps
        lowest = -gains.speedbrake
        self._sum_throttle = _clamp(
            self._sum_throttle + gains.throttle_i * error * _DT_S, lowest, 1.0
        )
        return _clamp(self._sum_throttle + gains.throttle_p * error, lowest, 1.0)

    def _lateral(self, truth: Truth, target: Target) -> tuple[float, float]:
        """Bank that turns to the heading, and a yaw damper that allows the rate of the turn."""
        gains, bank = self.gains, target.bank_rad
        if bank is None:
            error = _wrapped(target.heading_rad - truth.yaw_rad)
            bank = _clamp(gains.heading_p * error, -gains.bank_limit_rad, gains.bank_limit_rad)
        self._bank_command = _towards(self._bank_command, bank, gains.roll_in_radps * _DT_S)
        if gains.yaw_rate == 0.0:
            return self._bank_command, 0.0
        turn_rate = 9.81 * math.sin(truth.roll_rad) / max(self._airspeed_mps, gains.minimum_mps)
        return self._bank_command, _clamp(
            gains.yaw_rate * (turn_rate - truth.yaw_rate_radps), -0.5, 0.5
        )

    def _elevator(self, truth: Truth, pitch_rad: float) -> float:
        gains = self.gains
        error = pitch_rad - truth.pitch_rad
        total = self._pitch_sum + gains.pitch_i * error * _DT_S
        self._pitch_sum = total = -0.6 if total < -0.6 else 0.6 if total > 0.6 else total
        surface = gains.pitch_p * error + total - gains.pitch_rate * truth.pitch_rate_radps
        surface *= self._effectiveness
        return -1.0 if surface < -1.0 else 1.0 if surface > 1.0 else surface

    def _aileron(self, truth: Truth, bank_rad: float) -> float:
        gains = self.gains
        error = bank_rad - truth.roll_rad
        total = self._bank_sum + gains.bank_i * error * _DT_S
        self._bank_sum = total = -0.3 if total < -0.3 else 0.3 if total > 0.3 else total
        surface = gains.bank_p * error + total - gains.roll_rate * truth.roll_rate_radps
        surface *= self._effectiveness
        return -1.0 if surface < -1.0 else 1.0 if surface > 1.0 else surface


def _clamp(value: float, low: float, high: float) -> float:
    return low if value < low else high if value > high else value


def _towards(value: float, goal: float, step: float) -> float:
    change = goal - value
    return value + (-step if change < -step else step if change > step else change)


def _wrapped(angle_rad: float) -> float:
    """The same angle in -pi..pi."""
    return math.remainder(angle_rad, math.tau)
