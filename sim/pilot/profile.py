"""The flight profile: legs as data, and the sequence that gives the autopilot its targets."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field

from companion.config import Settings
from companion.errors import SimulationError
from sim.aircraft_state import Truth
from sim.pilot.approach import Approach, LandingSite
from sim.pilot.autopilot import Mode, Target
from sim.pilot.gains import Gains
from sim.vehicle.own_estimate import Position

Heading = Annotated[float, Field(ge=0.0, lt=360.0)]
Altitude = Annotated[float, Field(ge=-400.0, le=20_000.0)]
Airspeed = Annotated[float, Field(ge=15.0, le=300.0)]
Rate = Annotated[float, Field(gt=0.0, le=60.0)]
Bank = Annotated[float, Field(ge=-60.0, le=60.0)]
Duration = Annotated[float, Field(gt=0.0, le=100_000.0)]


class Flown(Settings):
    """Keys that all legs in the air have."""

    airspeed_mps: Airspeed | None = None
    """calibrated airspeed of the leg; None takes the aircraft's own"""
    heading_deg: Heading | None = None
    """heading of the leg; None keeps the heading of the leg before"""
    bank_deg: Bank | None = None
    """bank at which the leg circles instead of holding a heading, positive to the right"""


class Wait(Settings):
    """Stand on the runway, engine idling."""

    leg: Literal["wait"]
    duration_s: Duration
    """duration of the leg"""


class TakeOff(Settings):
    """Arm, run, rotate, and climb out to a height above the field."""

    leg: Literal["take_off"]
    height_m: Annotated[float, Field(ge=15.0, le=1000.0)] = 100.0
    """height above the runway at which the leg ends"""


class Climb(Flown):
    """Climb to an altitude at full power and an airspeed or, with a rate, at that vertical
    speed."""

    leg: Literal["climb"]
    altitude_amsl_m: Altitude
    """altitude above mean sea level at which the leg ends, within 4 m"""
    rate_mps: Rate | None = None
    """vertical speed of the climb; None climbs at full power and the airspeed"""


class Hold(Flown):
    """Level flight at the altitude of the leg before, for a time, turning first if a heading is
    given."""

    leg: Literal["hold"]
    duration_s: Duration
    """duration of the leg"""


class Descend(Flown):
    """Descend to an altitude at a vertical speed and level off. Speed brakes extend when the
    airspeed is too high."""

    leg: Literal["descend"]
    altitude_amsl_m: Altitude
    """altitude above mean sea level at which the leg ends, within 4 m"""
    rate_mps: Rate = 3.0
    """vertical speed of the descent, positive downwards"""


class Glide(Flown):
    """Descend to an altitude with the engine idling; the pitch holds the airspeed."""

    leg: Literal["glide"]
    altitude_amsl_m: Altitude
    """altitude above mean sea level below which the leg ends"""


class Land(Settings):
    """Join the centre line at the present altitude, follow the glide path, flare, touch down and
    stop on the runway.

    A touch-and-go ends while the aircraft rolls, and a take_off follows."""

    leg: Literal["land"]
    glide_deg: Annotated[float, Field(ge=2.0, le=8.0)] = 3.0
    """slope of the glide path, degrees"""
    touch_and_go: bool = False
    """whether the aircraft takes off again after four seconds on the wheels"""


Leg = Annotated[Wait | TakeOff | Climb | Hold | Descend | Glide | Land, Field(discriminator="leg")]

CAPTURE_M = 4.0
"""Distance from its altitude at which a climb or descent ends; the hold that follows removes the
rest."""


class Profile:
    """Runs the legs in order. `update` returns the present target; `done` says that the last
    leg is over."""

    def __init__(
        self, legs: Sequence[Leg], gains: Gains, site: LandingSite, aloft_m: float | None = None
    ) -> None:
        """`aloft_m`: the altitude at which the flight begins, if not on the runway."""
        if not legs:
            raise SimulationError("the profile has no legs")
        self._legs = list(legs)
        self._gains = gains
        self._site = site
        self._approach: Approach | None = None
        self._heading_rad = math.radians(site.heading_deg)
        self._altitude_m = site.elevation_m if aloft_m is None else aloft_m
        self._index = -1
        self.leg: Leg = self._legs[0]
        """the one being flown"""
        self._climbs = False
        """whether it climbs by airspeed, until the altitude is captured"""
        self._until_us = math.inf
        """end of a leg that lasts for a time"""
        self._target = Target(Mode.PARKED, self._heading_rad)
        self.done = False

    def update(self, truth: Truth) -> Target:
        if self._index < 0 or self._over(truth):
            if self._index + 1 < len(self._legs):
                self._index += 1
                self.leg = self._legs[self._index]
                self._begin(truth)
            elif not self.done:
                self.done = True
                if self._approach is not None and self._approach.done:
                    self._approach = None
                    self._target = Target(Mode.PARKED, self._heading_rad)
        if self._approach is not None:
            return self._approach.update(truth)
        if self._climbs:
            self._capture(truth)
        return self._target

    def seen(self, truth: Truth, own: Position | None) -> Truth:
        """What an autopilot sees that flies by the vehicle's own estimate: its altitude in a leg in
        the air, the truth otherwise."""
        if own is None or not isinstance(self.leg, Flown):
            return truth
        return truth._replace(altitude_amsl_m=own.altitude_amsl_m)

    def describe(self) -> str:
        """The leg in a few words, for STATUSTEXT and the progress bar."""
        match self.leg:
            case Wait():
                return "Standing"
            case TakeOff():
                return "Takeoff"
            case Climb(altitude_amsl_m=altitude):
                return f"Climb to {altitude:.0f}m"
            case Hold(heading_deg=heading):
                where = "" if heading is None else f" heading {heading:.0f}"
                return f"Hold {self._altitude_m:.0f}m{where}"
            case Descend(altitude_amsl_m=altitude):
                return f"Descend to {altitude:.0f}m"
            case Glide(altitude_amsl_m=altitude):
                return f"Glide to {altitude:.0f}m"
            case Land(touch_and_go=touch_and_go):
                return "Touch and go" if touch_and_go else "Landing"

    def _begin(self, truth: Truth) -> None:
        leg = self.leg
        self._climbs, self._until_us = False, math.inf
        if isinstance(leg, Wait | Hold):
            self._until_us = truth.time_us + math.ceil(leg.duration_s * 1e6)
        self._approach = None
        if self._target.bank_rad is not None:
            self._heading_rad = truth.yaw_rad
        if isinstance(leg, Flown) and leg.heading_deg is not None:
            self._heading_rad = math.radians(leg.heading_deg)
        match leg:
            case Wait():
                self._target = Target(Mode.PARKED, self._heading_rad)
            case TakeOff(height_m=height):
                self._altitude_m = self._site.elevation_m + height
                self._heading_rad = math.radians(self._site.heading_deg)
                self._target = Target(Mode.TAKE_OFF, self._heading_rad, self._altitude_m)
            case Land(glide_deg=glide, touch_and_go=touch_and_go):
                self._heading_rad = math.radians(self._site.heading_deg)
                self._approach = Approach(self._site, self._gains, glide, touch_and_go, truth)
            case _:
                self._target = self._flown(leg)
                self._climbs = self._target.mode is Mode.AIRSPEED and not isinstance(leg, Glide)

    def _flown(self, leg: Climb | Hold | Descend | Glide) -> Target:
        """The target of a leg in the air."""
        if not isinstance(leg, Hold):
            self._altitude_m = leg.altitude_amsl_m
        rate_mps = leg.rate_mps if isinstance(leg, Climb | Descend) else None
        by_airspeed = isinstance(leg, Glide) or (isinstance(leg, Climb) and rate_mps is None)
        return Target(
            Mode.AIRSPEED if by_airspeed else Mode.ALTITUDE,
            self._heading_rad,
            self._altitude_m,
            rate_mps or 3.0,
            leg.airspeed_mps,
            throttle=0.0 if isinstance(leg, Glide) else 1.0,
            bank_rad=None if leg.bank_deg is None else math.radians(leg.bank_deg),
        )

    def _over(self, truth: Truth) -> bool:
        if self._until_us < math.inf:
            return truth.time_us >= self._until_us
        leg = self.leg
        if self._approach is not None:
            return self._approach.done
        if isinstance(leg, Glide):
            return truth.altitude_amsl_m <= self._altitude_m
        if isinstance(leg, TakeOff):
            return truth.altitude_amsl_m >= self._altitude_m
        return abs(truth.altitude_amsl_m - self._altitude_m) < CAPTURE_M

    def _capture(self, truth: Truth) -> None:
        """Level off from a climb: once the altitude loop would ask for no more than the present
        climb."""
        target = self._target
        ahead_m = target.altitude_amsl_m - truth.altitude_amsl_m
        if ahead_m * self._gains.altitude_p <= max(truth.climb_mps, 0.5):
            limit, self._climbs = max(truth.climb_mps, 1.0), False
            self._target = replace(
                target, mode=Mode.ALTITUDE, vertical_speed_limit_mps=limit, airspeed_mps=None
            )
