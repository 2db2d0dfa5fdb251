"""Weather that depends on place and time: fronts, gradients, the day's course, gusts, mountain
waves.

Each field is a section of a scenario. Its method `at` returns the change at a place and time; the
changes of all fields add up.
"""

import math
from collections.abc import Callable, Mapping
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from companion.config import Settings

EARTH_RATE_RADPS = 7.292115e-5
_DENSITY_KGPM3 = 1.225
"""density of the low-level air in the balance of wind and pressure"""
_FRICTION_HEIGHT_M, _FRICTION_KEEPS, _FRICTION_TURN_RAD = 600.0, 0.6, math.radians(25.0)
"""friction layer: at the ground the wind has 0.6 of its strength and blows 25 degrees towards the
lower pressure"""
_STABILITY_HZ = 0.012
"""Brunt and Vaisala's frequency (rad/s) of a standard troposphere"""
_GUST_EVERY_S, _GUST_S = 60.0, 12.0
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0

Time = Annotated[float, Field(ge=0.0, le=1e6)]
Speed = Annotated[float, Field(ge=0.0, le=80.0)]
Direction = Annotated[float, Field(ge=0.0, lt=360.0)]
Distance = Annotated[float, Field(ge=-2e6, le=2e6)]


class WeatherPoint(NamedTuple):
    """Place and time at which the weather is evaluated."""

    time_s: float
    north_m: float
    east_m: float
    """distance east of the runway, m"""
    altitude_m: float
    height_m: float
    """height above the runway, m"""
    latitude_deg: float
    wind_mps: tuple[float, float]
    """steady wind towards north and east, m/s"""

    def towards(self, direction_deg: float) -> float:
        """Distance from the runway along a direction, m."""
        angle = math.radians(direction_deg)
        return self.north_m * math.cos(angle) + self.east_m * math.sin(angle)


class Change(NamedTuple):
    """Change that one field adds to the weather."""

    sea_level_pa: float = 0.0
    offset_k: float = 0.0
    north_mps: float = 0.0
    east_mps: float = 0.0
    down_mps: float = 0.0
    local_pa: float = 0.0
    """change of the static pressure at this point alone, not of the column, Pa"""


class Wind(Settings):
    """A steady wind, and the direction it comes from."""

    speed_mps: Annotated[float, Field(ge=0.0, le=60.0)] = 0.0
    """wind speed at all heights"""
    from_deg: Direction = 0.0
    """true direction from which the wind blows"""

    @property
    def vector_mps(self) -> tuple[float, float]:
        """Wind towards north and east, m/s."""
        direction = math.radians(self.from_deg)
        return -self.speed_mps * math.cos(direction), -self.speed_mps * math.sin(direction)


class Front(Settings):
    """A front: a line with a pressure trough, and other air and another wind behind it.

    With a ``speed_mps`` it passes over time; with speed zero it stands, and the aircraft flies
    through it.
    """

    kind: Literal["cold", "warm"] = "cold"
    """kind of front; it sets the defaults of cold or warm: width 8 or 40 km, trough 2 or 1 hPa,
    step +3 or -3 hPa and -8 or +6 K"""
    from_deg: Direction = 270.0
    """true direction from which the front comes, or in which it stands"""
    distance_m: Distance = 30_000.0
    """distance of the front from the runway at boot"""
    speed_mps: Speed = 12.0
    """speed of the front towards the runway and beyond; 0 lets it stand"""
    width_m: Annotated[float, Field(gt=0.0, le=1e6)] | None = None
    """distance on each side of the line within which 76 % of the changes happen"""
    trough_hpa: Annotated[float, Field(ge=0.0, le=30.0)] | None = None
    """pressure deficit along the line"""
    pressure_step_hpa: Annotated[float, Field(ge=-30.0, le=30.0)] | None = None
    """pressure change from before to behind the front"""
    temperature_step_k: Annotated[float, Field(ge=-25.0, le=25.0)] | None = None
    """temperature change of the whole column from before to behind the front"""
    wind_behind: Wind | None = None
    """Wind behind the front; left out, the wind does not change."""

    def value(self, name: str) -> float:
        """A parameter of this front; the default of its kind if it is not given."""
        own: float | None = getattr(self, name)
        return FRONTS[self.kind][name] if own is None else own

    def at(self, point: WeatherPoint) -> Change:
        width = self.value("width_m")
        behind = (
            self.speed_mps * point.time_s - self.distance_m + point.towards(self.from_deg)
        ) / width
        behind = max(-40.0, min(40.0, behind))
        share = 0.5 * (1.0 + math.tanh(behind))
        pressure_hpa = share * self.value("pressure_step_hpa") - self.value(
            "trough_hpa"
        ) / math.cosh(behind)
        north = east = 0.0
        if self.wind_behind is not None:
            after = self.wind_behind.vector_mps
            north, east = (
                share * (after[0] - point.wind_mps[0]),
                share * (after[1] - point.wind_mps[1]),
            )
        return Change(pressure_hpa * 100.0, share * self.value("temperature_step_k"), north, east)


FRONTS: Mapping[str, Mapping[str, float]] = {
    # A cold front is narrow (minutes), and the pressure rises behind it. A warm front is broad, and
    # the pressure stays low.
    "cold": {
        "width_m": 8_000.0,
        "trough_hpa": 2.0,
        "pressure_step_hpa": 3.0,
        "temperature_step_k": -8.0,
    },
    "warm": {
        "width_m": 40_000.0,
        "trough_hpa": 1.0,
        "pressure_step_hpa": -3.0,
        "temperature_step_k": 6.0,
    },
}


class Gradient(Settings):
    """A horizontal pressure gradient and its geostrophic wind, reduced in the friction layer."""

    hpa_per_100km: Annotated[float, Field(ge=0.0, le=10.0)] = 1.5
    """horizontal pressure gradient"""
    towards_deg: Direction = 180.0
    """true direction in which the pressure rises"""
    wind: bool = True
    """whether the geostrophic wind of the gradient blows"""

    def at(self, point: WeatherPoint) -> Change:
        slope = self.hpa_per_100km * 100.0 / 100_000.0
        pressure_pa = slope * point.towards(self.towards_deg)
        if not self.wind:
            return Change(pressure_pa)
        coriolis = 2.0 * EARTH_RATE_RADPS * math.sin(math.radians(point.latitude_deg))
        speed = slope / (_DENSITY_KGPM3 * abs(coriolis))
        aloft = max(0.0, min(1.0, point.height_m / _FRICTION_HEIGHT_M))
        speed *= _FRICTION_KEEPS + (1.0 - _FRICTION_KEEPS) * aloft
        # The high is on the right of the wind in the northern hemisphere; friction turns it towards
        # the low.
        side = math.copysign(1.0, coriolis)
        direction = math.radians(self.towards_deg) - side * (
            math.pi / 2.0 + _FRICTION_TURN_RAD * (1.0 - aloft)
        )
        return Change(pressure_pa, 0.0, speed * math.cos(direction), speed * math.sin(direction))


class Diurnal(Settings):
    """The course of a day: temperature highest at 15 h, atmospheric tide highest at 10 h and 22
    h."""

    start_h: Annotated[float, Field(ge=0.0, lt=24.0)] = 9.0
    """local solar time of the boot"""
    temperature_k: Annotated[float, Field(ge=0.0, le=25.0)] = 6.0
    """amplitude of the temperature"""
    pressure_hpa: Annotated[float, Field(ge=0.0, le=5.0)] = 0.5
    """amplitude of the atmospheric tide: 1.2 hPa at the equator, 0.5 at 45 degrees [Chapman and
    Lindzen 1970, chapter 2]"""

    def at(self, point: WeatherPoint) -> Change:
        hour = self.start_h + point.time_s / 3600.0
        pressure_hpa = self.pressure_hpa * math.cos(math.tau * (hour - 10.0) / 12.0)
        return Change(
            pressure_hpa * 100.0, self.temperature_k * math.cos(math.tau * (hour - 15.0) / 24.0)
        )


class Gust(Settings):
    """One discrete gust, (1 - cos) in time [CS 23.333 (c)]."""

    time_s: Time
    """time since boot at which the gust begins"""
    duration_s: Annotated[float, Field(ge=0.5, le=600.0)] = 8.0
    """duration of the gust"""
    speed_mps: Speed = 8.0
    """horizontal wind speed at the middle of the gust"""
    from_deg: Direction = 0.0
    """true direction from which the wind blows"""
    up_mps: Annotated[float, Field(ge=-15.0, le=15.0)] = 0.0
    """vertical wind at the middle of the gust, positive upwards"""

    def at(self, point: WeatherPoint) -> Change:
        share = (point.time_s - self.time_s) / self.duration_s
        if not 0.0 < share < 1.0:
            return Change()
        size = 0.5 * (1.0 - math.cos(math.tau * share))
        direction = math.radians(self.from_deg)
        return Change(
            0.0,
            0.0,
            -size * self.speed_mps * math.cos(direction),
            -size * self.speed_mps * math.sin(direction),
            -size * self.up_mps,
        )


class ReportedGusts(NamedTuple):
    """The gusts of weather reports: one (1 - cos) gust a minute.

    A station reports the highest wind of ten minutes. When in its minute a gust comes, and which
    part of the reported one it is, follows multiples of irrational numbers, which leave no gaps:
    the strongest of ten is above nine tenths.
    """

    excess_mps: Callable[[float], float]
    """reported gust speed above the mean wind over time, m/s"""

    def at(self, point: WeatherPoint) -> Change:
        excess_mps, speed_mps = self.excess_mps(point.time_s), math.hypot(*point.wind_mps)
        if excess_mps <= 0.0 or speed_mps <= 0.0:
            return Change()
        minute, second = divmod(point.time_s, _GUST_EVERY_S)
        share = (second - (minute * _GOLDEN % 1.0) * (_GUST_EVERY_S - _GUST_S)) / _GUST_S
        if not 0.0 < share < 1.0:
            return Change()
        part = 0.5 + 0.5 * (minute * math.sqrt(2.0) % 1.0)
        size = part * 0.5 * (1.0 - math.cos(math.tau * share)) * excess_mps / speed_mps
        return Change(north_mps=size * point.wind_mps[0], east_mps=size * point.wind_mps[1])


class MountainWave(Settings):
    """A standing wave behind a ridge: vertical wind, and a static pressure that differs from the
    column's.

    Linear theory of a hydrostatic wave that carries energy upwards: p' = rho N / k w, in phase with
    the updraught w, k the wave number and N the air's stability [Gill, Atmosphere-Ocean Dynamics,
    section 6.8]. 4 m/s over 20 km make 1.9 hPa, 16 m of height.
    """

    up_mps: Annotated[float, Field(ge=0.0, le=12.0)] = 3.0
    """amplitude of the vertical wind"""
    wavelength_m: Annotated[float, Field(ge=2_000.0, le=100_000.0)] = 15_000.0
    """distance from one updraught to the next"""
    along_deg: Direction = 90.0
    """true direction across the ridge, away from the runway"""
    distance_m: Distance = 5_000.0
    """distance of the ridge from the runway; the wave begins behind it"""
    rise_m: Annotated[float, Field(gt=0.0, le=10_000.0)] = 1_000.0
    """height above the runway at which the wave has 1 - 1/e of its amplitude"""

    def at(self, point: WeatherPoint) -> Change:
        beyond_m = point.towards(self.along_deg) - self.distance_m
        if beyond_m <= 0.0 or point.height_m <= 0.0:
            return Change()
        number = math.tau / self.wavelength_m
        up = (
            self.up_mps
            * math.sin(number * beyond_m)
            * (1.0 - math.exp(-point.height_m / self.rise_m))
        )
        density = _DENSITY_KGPM3 * math.exp(-point.altitude_m / 9_500.0)
        return Change(down_mps=-up, local_pa=density * _STABILITY_HZ / number * up)
