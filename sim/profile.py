"""The flight profile: legs as data, and the sequence that turns them into the autopilot's targets."""

import math
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field

from companion.config import Settings
from companion.errors import SimulationError
from sim.aircraft import Truth
from sim.autopilot import Gains, Mode, Target

Heading = Annotated[float, Field(ge=0.0, lt=360.0)]
Altitude = Annotated[float, Field(ge=-400.0, le=20_000.0)]
Airspeed = Annotated[float, Field(ge=15.0, le=300.0)]
Duration = Annotated[float, Field(gt=0.0, le=100_000.0)]


class Wait(Settings):
    """Stand on the runway, engine idling."""

    leg: Literal["wait"]
    duration_s: Duration


class TakeOff(Settings):
    """Arm, run, rotate, and climb out to a height above the field."""

    leg: Literal["take_off"]
    height_m: Annotated[float, Field(ge=15.0, le=1000.0)] = 100.0


class Climb(Settings):
    """Full power at an airspeed to an altitude."""

    leg: Literal["climb"]
    altitude_amsl_m: Altitude
    airspeed_mps: Airspeed | None = None
    heading_deg: Heading | None = None


class Hold(Settings):
    """Level flight at the altitude of the leg before, for a time, turning first if a heading is given."""

    leg: Literal["hold"]
    duration_s: Duration
    airspeed_mps: Airspeed | None = None
    heading_deg: Heading | None = None


class Descend(Settings):
    """Down to an altitude at a vertical speed, and level off there."""

    leg: Literal["descend"]
    altitude_amsl_m: Altitude
    rate_mps: Annotated[float, Field(gt=0.0, le=60.0)] = 3.0
    airspeed_mps: Airspeed | None = None
    heading_deg: Heading | None = None


Leg = Annotated[Wait | TakeOff | Climb | Hold | Descend, Field(discriminator="leg")]

CAPTURE_M = 4.0
"""A climb or descent is over this close to its altitude; the hold that follows removes the rest."""


class Profile:
    """Walks through the legs. `update` returns the target of the moment; `done` says that the last leg is over."""

    def __init__(self, legs: Sequence[Leg], gains: Gains, field_elevation_m: float, heading_deg: float) -> None:
        if not legs:
            raise SimulationError("the profile has no legs")
        self._legs = list(legs)
        self._gains = gains
        self._field_m = field_elevation_m
        self._heading_rad = math.radians(heading_deg)
        self._altitude_m = field_elevation_m
        self._index = -1
        self._since_us = 0
        self._target = Target(Mode.PARKED, self._heading_rad)
        self.done = False

    @property
    def leg(self) -> Leg:
        """The leg being flown."""
        return self._legs[max(self._index, 0)]

    def update(self, truth: Truth) -> Target:
        if self._index < 0 or self._over(truth):
            if self._index + 1 < len(self._legs):
                self._index += 1
                self._begin(truth)
            else:
                self.done = True
        self._capture(truth)
        return self._target

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

    def _begin(self, truth: Truth) -> None:
        leg = self.leg
        self._since_us = truth.time_us
        if isinstance(leg, Climb | Hold | Descend) and leg.heading_deg is not None:
            self._heading_rad = math.radians(leg.heading_deg)
        match leg:
            case Wait():
                self._target = Target(Mode.PARKED, self._heading_rad)
            case TakeOff(height_m=height):
                self._altitude_m = self._field_m + height
                self._target = Target(Mode.TAKE_OFF, self._heading_rad, self._altitude_m)
            case Climb(altitude_amsl_m=altitude, airspeed_mps=airspeed):
                self._altitude_m = altitude
                self._target = Target(Mode.AIRSPEED, self._heading_rad, altitude, airspeed_mps=airspeed)
            case Hold(airspeed_mps=airspeed):
                self._target = Target(Mode.ALTITUDE, self._heading_rad, self._altitude_m, 3.0, airspeed)
            case Descend(altitude_amsl_m=altitude, rate_mps=rate, airspeed_mps=airspeed):
                self._altitude_m = altitude
                self._target = Target(Mode.ALTITUDE, self._heading_rad, altitude, rate, airspeed)

    def _over(self, truth: Truth) -> bool:
        leg = self.leg
        if isinstance(leg, Wait | Hold):
            return truth.time_us - self._since_us >= leg.duration_s * 1e6
        if isinstance(leg, TakeOff):
            return truth.altitude_amsl_m >= self._altitude_m
        return abs(truth.altitude_amsl_m - self._altitude_m) < CAPTURE_M

    def _capture(self, truth: Truth) -> None:
        """Level off from a climb: once the altitude loop would ask for no more than the present climb."""
        target = self._target
        if target.mode is not Mode.AIRSPEED:
            return
        ahead_m = target.altitude_amsl_m - truth.altitude_amsl_m
        if ahead_m * self._gains.altitude_p <= max(truth.climb_mps, 0.5):
            limit = max(truth.climb_mps, 1.0)
            self._target = Target(Mode.ALTITUDE, target.heading_rad, target.altitude_amsl_m, limit)
