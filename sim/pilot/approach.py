"""Approach and landing from any position: join the centre line, follow the glide path, flare, roll
out.

The runway is a line through the place where the scenario begins; distances along it count from the
aiming point, in the direction of landing. Turns are led by ground track, so that wind is allowed
for.
"""

import math
from dataclasses import dataclass
from enum import Enum, auto

from companion.errors import SimulationError
from sim.aircraft_state import Truth
from sim.constants import MEAN_EARTH_M_PER_DEG
from sim.pilot.autopilot import Mode, Target
from sim.pilot.gains import Gains

_AIM_M = 300.0
"""distance of the glide path's end beyond the beginning of the runway"""
_SLOWING_MPS2 = 0.5
"""deceleration of an idling aircraft in level flight, a low estimate"""
_INTERCEPT_RAD = 0.7
"""largest angle at which the centre line is approached"""
_ESTABLISHED_M = 150.0
"""distance from the centre line below which the descent on the glide path begins"""
_GLIDE_RATIO = 20.0
"""glide ratio of a glider, a low estimate"""
_ALIGNED_RAD = 0.5
_TOUCH_S = 4.0
"""time on the wheels before a touch-and-go takes off again"""
_STOPPED_MPS = 0.5
_BRAKE = 0.4


@dataclass(frozen=True)
class LandingSite:
    """The runway: its threshold, and the height of the aircraft's centre of gravity on the
    wheels."""

    latitude_deg: float
    longitude_deg: float
    heading_deg: float
    elevation_m: float
    rest_height_m: float
    powered: bool
    """whether the aircraft can fly level"""


class Phase(Enum):
    """Phase of an approach."""

    JOIN = auto()
    FINAL = auto()
    FLARE = auto()
    ROLL_OUT = auto()


class Approach:
    """One approach and landing from `truth`; `update` returns the present target until `done`."""

    def __init__(
        self, site: LandingSite, gains: Gains, glide_deg: float, touch_and_go: bool, truth: Truth
    ) -> None:
        self._site = site
        self._gains = gains
        self._slope = math.tan(math.radians(glide_deg))
        self._touch_and_go = touch_and_go
        self._heading_rad = math.radians(site.heading_deg)
        self._ground_m = site.elevation_m + site.rest_height_m
        self._level_m = truth.altitude_amsl_m
        self._phase = Phase.JOIN
        self._configured = False
        """whether the aircraft slows down with gear and flaps extending"""
        self._on_path = False
        self._touchdown_us = 0
        self.done = False
        true_ratio = max(
            1.0, math.hypot(truth.north_mps, truth.east_mps) / max(truth.airspeed_mps, 1.0)
        )
        clean_mps = gains.clean_mps * min(true_ratio, 2.0)
        self._turn_m = clean_mps**2 / (9.81 * math.tan(gains.bank_limit_rad))
        slowing_m = max((clean_mps**2 - gains.approach_mps**2) / (2.0 * _SLOWING_MPS2), 0.0)
        self._slow_m = -((self._level_m - self._ground_m) / self._slope + slowing_m)
        """latest position along the runway at which to slow down, m"""
        self._gate_m = self._slow_m - 6.0 * self._turn_m
        if not site.powered:
            self._gate_m = -self._glider_gate_m(truth)
            self._slow_m = self._gate_m + 4.0 * self._turn_m

    def _glider_gate_m(self, truth: Truth) -> float:
        """Distance before the aiming point at which a glider can turn in, with a tenth more height
        than the glide path's."""
        along_m, right_m = self._along_and_right(truth)
        to_go_m = along_m + abs(right_m) + 4.0 * self._turn_m
        gate_m = (self._height_m(truth) - to_go_m / _GLIDE_RATIO) / (
            1.1 * self._slope + 1.0 / _GLIDE_RATIO
        )
        if gate_m < 4.0 * self._turn_m or self._height_m(truth) < -along_m / _GLIDE_RATIO:
            raise SimulationError(
                f"at {truth.time_us / 1e6:.2f} s the glider is too low for the runway: "
                f"{self._height_m(truth):.0f} m above it, {abs(along_m):.0f} m along and "
                f"{abs(right_m):.0f} m across: land from a higher leg"
            )
        return gate_m

    def update(self, truth: Truth) -> Target:
        along_m, right_m = self._along_and_right(truth)
        self._advance(truth, along_m, right_m)
        match self._phase:
            case Phase.JOIN:
                to_gate_rad = self._heading_rad + math.atan2(-right_m, self._gate_m - along_m)
                heading_rad = _crabbed(truth, to_gate_rad)
                return self._level(heading_rad)
            case Phase.FINAL:
                return self._final(truth, along_m, right_m)
            case Phase.FLARE:
                climb_mps = -self._height_m(truth) / self._gains.flare_s - self._gains.touchdown_mps
                return Target(Mode.FLARE, self._inbound(truth, right_m), climb_mps=climb_mps)
            case Phase.ROLL_OUT:
                heading_rad = self._heading_rad - max(-0.06, min(0.06, 0.004 * right_m))
                return Target(
                    Mode.ROLL_OUT, heading_rad, brake=0.0 if self._touch_and_go else _BRAKE
                )

    def _advance(self, truth: Truth, along_m: float, right_m: float) -> None:
        if self._phase is Phase.JOIN:
            at_gate = math.hypot(along_m - self._gate_m, right_m) < 1.5 * self._turn_m
            intercept_m = abs(right_m) / math.tan(_INTERCEPT_RAD) + 3.0 * self._turn_m
            straight_in = (
                self._aligned(truth) and self._gate_m < along_m < self._slow_m - intercept_m
            )
            if at_gate or straight_in:
                self._phase = Phase.FINAL
        elif self._phase is Phase.FINAL:
            sink_mps = max(truth.down_mps - self._gains.touchdown_mps, 0.0)
            if (
                self._height_m(truth) < self._gains.flare_s * sink_mps
                and abs(right_m) < _ESTABLISHED_M
            ):
                self._phase = Phase.FLARE
        elif self._phase is Phase.FLARE and truth.on_ground:
            self._phase = Phase.ROLL_OUT
            self._touchdown_us = truth.time_us
        elif self._phase is Phase.ROLL_OUT:
            speed_mps = math.hypot(truth.north_mps, truth.east_mps)
            rolled_s = (truth.time_us - self._touchdown_us) * 1e-6
            self.done = rolled_s >= _TOUCH_S if self._touch_and_go else speed_mps < _STOPPED_MPS

    def _final(self, truth: Truth, along_m: float, right_m: float) -> Target:
        heading_rad = self._inbound(truth, right_m)
        path_m = self._ground_m - along_m * self._slope
        speed_mps = math.hypot(truth.north_mps, truth.east_mps)
        self._configured |= abs(right_m) < 0.25 * self._turn_m and self._aligned(truth)
        if not self._configured:
            return self._level(heading_rad)
        if not self._on_path:
            altitude_m = self._level_m if self._site.powered else truth.altitude_amsl_m
            # A second and a half ahead, as the push-over takes its time.
            self._on_path = (
                path_m - 1.5 * speed_mps * self._slope < altitude_m
                and abs(right_m) < _ESTABLISHED_M
            )
            if not self._site.powered:
                return self._level(heading_rad)
            return Target(Mode.APPROACH, heading_rad, self._level_m, 3.0, self._gains.approach_mps)
        sink_mps = speed_mps * self._slope
        return Target(
            Mode.APPROACH,
            heading_rad,
            path_m,
            0.5 * sink_mps,
            self._gains.approach_mps,
            climb_mps=-sink_mps,
        )

    def _level(self, heading_rad: float) -> Target:
        """Level flight at the altitude of the start; without an engine, the flattest glide."""
        if self._site.powered:
            return Target(Mode.ALTITUDE, heading_rad, self._level_m, 3.0, self._gains.clean_mps)
        return Target(Mode.AIRSPEED, heading_rad, airspeed_mps=self._gains.cruise_mps, throttle=0.0)

    def _aligned(self, truth: Truth) -> bool:
        return abs(math.remainder(truth.yaw_rad - self._heading_rad, math.tau)) < _ALIGNED_RAD

    def _inbound(self, truth: Truth, right_m: float) -> float:
        """The heading that leads to the centre line and along it, critically damped with the
        heading's own lag."""
        speed_mps = max(math.hypot(truth.north_mps, truth.east_mps), 1.0)
        distance_m = 4.0 * speed_mps**2 / (9.81 * self._gains.heading_p)
        angle_rad = max(-_INTERCEPT_RAD, min(_INTERCEPT_RAD, right_m / distance_m))
        return _crabbed(truth, self._heading_rad - angle_rad)

    def _along_and_right(self, truth: Truth) -> tuple[float, float]:
        site = self._site
        north_m = (truth.latitude_deg - site.latitude_deg) * MEAN_EARTH_M_PER_DEG
        east_deg = math.remainder(truth.longitude_deg - site.longitude_deg, 360.0)
        east_m = east_deg * MEAN_EARTH_M_PER_DEG * math.cos(math.radians(site.latitude_deg))
        sin, cos = math.sin(self._heading_rad), math.cos(self._heading_rad)
        return north_m * cos + east_m * sin - _AIM_M, east_m * cos - north_m * sin

    def _height_m(self, truth: Truth) -> float:
        """Height of the wheels above the runway, m."""
        return truth.altitude_amsl_m - self._ground_m


def _crabbed(truth: Truth, track_rad: float) -> float:
    """The heading at which the ground track is `track_rad` in the present wind."""
    drift_rad = math.remainder(
        math.atan2(truth.east_mps, truth.north_mps) - truth.yaw_rad, math.tau
    )
    return track_rad - drift_rad
