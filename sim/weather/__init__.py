"""The weather of a flight: pressure, temperature, humidity and wind at each place and time.

The sea-level pressure and the temperature deviation go into JSBSim's atmosphere, which integrates
the column above hydrostatically: at a given geometric altitude both move the static pressure, and
so a barometer. With a temperature profile or humidity, ``column`` integrates the column and
replaces JSBSim's for the whole flight.

``fields`` has the weather that depends on the place; ``metar`` derives weather from reports.
"""

import itertools
import math
from typing import Annotated, NamedTuple

from pydantic import Field, model_validator

from companion.config import Settings
from sim.aircraft import Aircraft
from sim.aircraft_state import Truth
from sim.constants import EARTH_M_PER_DEG
from sim.weather.column import Column, pressure_altitude_m, standard_k
from sim.weather.fields import (
    Change,
    Diurnal,
    Front,
    Gradient,
    Gust,
    MountainWave,
    ReportedGusts,
    Time,
    WeatherPoint,
    Wind,
)
from sim.weather.metar import Day, Metar
from sim.weather.ramp import Ramp
from sim.weather.year import Hours, Year

STANDARD_HPA = 1013.25
_NO_CORIOLIS_DEG = 10.0
_RESOLVE_K = 5e-4
"""Change of the temperature offset below which the column is not integrated again: 0.04 Pa at 2400
m."""
_RESOLVE_HUMIDITY = 2.5e-4
"""Change of the humidity below which the column is not integrated again; as much at 15 C"""


class PressurePoint(Settings):
    """Sea-level pressure at a time since boot; linear in between, constant before the first and
    after the last."""

    time_s: Time
    """time since boot"""
    sea_level_hpa: Annotated[float, Field(ge=850.0, le=1100.0)]
    """pressure of the air column at sea level; the QNH on a standard day"""


class TemperaturePoint(Settings):
    """Deviation of the whole column from the standard atmosphere's temperature at a time since
    boot."""

    time_s: Time
    """time since boot"""
    offset_k: Annotated[float, Field(ge=-60.0, le=45.0)]
    """temperature deviation from the standard atmosphere at every height (ISA + offset)"""


class ProfilePoint(Settings):
    """Deviation from the standard atmosphere's temperature at an altitude; linear in between,
    constant outside."""

    altitude_amsl_m: Annotated[float, Field(ge=-500.0, le=20_000.0)]
    """altitude above mean sea level of this point"""
    offset_k: Annotated[float, Field(ge=-60.0, le=45.0)]
    """temperature deviation from the standard atmosphere at this altitude"""


class Turbulence(Settings):
    """Dryden turbulence of MIL-F-8785C, as JSBSim has it.

    Below 600 m above *sea level* (JSBSim does not ask for the ground) its strength follows the wind
    at 6 m (20 ft), with a vertical standard deviation of a tenth of it; above it follows the
    severity.
    """

    severity: Annotated[int, Field(ge=0, le=7)] = 0
    """severity above 600 m AMSL: 0 none, 3 light, 4 moderate, 6 severe"""
    wind_at_6m_mps: Annotated[float, Field(ge=0.0, le=40.0)] = 0.0
    """wind speed at 6 m that scales the turbulence below 600 m AMSL; it adds no wind"""


class WeatherConfig(Settings):
    """The weather of a scenario. Empty ramps are the standard day."""

    pressure: tuple[PressurePoint, ...] = ()
    temperature: tuple[TemperaturePoint, ...] = ()
    profile: tuple[ProfilePoint, ...] = ()
    """Temperature profile over height, for another lapse rate or an inversion."""
    relative_humidity: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """relative humidity of the whole troposphere, 0 to 1; moist air is lighter"""
    wind: Wind = Wind()
    turbulence: Turbulence = Turbulence()
    front: Front | None = None
    gradient: Gradient | None = None
    diurnal: Diurnal | None = None
    mountain_wave: MountainWave | None = None
    gusts: tuple[Gust, ...] = ()
    year: Year | None = None
    metar: Metar | None = None
    """METAR reports; they replace pressure, temperature, relative_humidity and wind."""

    @model_validator(mode="after")
    def _in_order(self) -> "WeatherConfig":
        for name, places in (
            ("pressure ramp", [point.time_s for point in self.pressure]),
            ("temperature ramp", [point.time_s for point in self.temperature]),
            ("temperature profile", [point.altitude_amsl_m for point in self.profile]),
        ):
            if any(after <= before for before, after in itertools.pairwise(places)):
                what = "altitudes" if "profile" in name else "times"
                raise ValueError(f"the {what} of the {name} must increase")
        told_twice = (
            self.pressure or self.temperature or self.relative_humidity or self.wind != Wind()
        )
        if self.metar is not None and told_twice:
            raise ValueError(
                "metar replaces pressure, temperature, humidity and wind: delete metar, or delete "
                "these"
            )
        return self

    @property
    def fields(self) -> list[Front | Gradient | Diurnal | MountainWave | Gust]:
        """The fields, which depend on place and time."""
        single = (self.front, self.gradient, self.diurnal, self.mountain_wave)
        return [field for field in (*single, *self.gusts) if field is not None]


AnyField = Front | Gradient | Diurnal | MountainWave | Gust | ReportedGusts | Hours


class Now(NamedTuple):
    """The true weather at the aircraft."""

    sea_level_pa: float
    """sea-level pressure of the column at the aircraft, without the pressure of a wave, Pa"""
    offset_k: float
    north_mps: float
    east_mps: float
    down_mps: float


class TrueAir(NamedTuple):
    """True values of the air at the aircraft."""

    qnh_pa: float
    """altimeter setting that shows the elevation on a field below the aircraft as high as the
    runway, Pa"""
    sea_level_pa: float
    """sea-level pressure of the column at the aircraft (QFF), Pa; it differs from the QNH by the
    temperature of the air below the field"""
    offset_k: float
    """temperature at the aircraft minus the standard atmosphere's there, K"""
    pressure_altitude_m: float
    """geopotential height at which the standard atmosphere has the aircraft's static pressure, m"""
    north_mps: float
    east_mps: float
    down_mps: float
    """velocity of the air without turbulence, m/s"""


class Weather:
    """Applies a `WeatherConfig` to an aircraft; each `update` sets the weather of one instant."""

    def __init__(self, config: WeatherConfig, aircraft: Aircraft, seed: int = 1) -> None:
        self._aircraft = aircraft
        self._fields: list[AnyField] = [*config.fields]
        if config.year is not None:
            self._fields.append(Hours(config.year, seed))
        latitude_deg, longitude_deg, _ = aircraft.position()
        self._origin_deg = (latitude_deg, longitude_deg)
        layers = Column([(point.altitude_amsl_m, point.offset_k) for point in config.profile])
        day = self._day(config, layers)
        self._pressure_hpa, self._offset_k = (
            Ramp(day.sea_level_hpa, STANDARD_HPA),
            Ramp(day.offset_k, 0.0),
        )
        self._humidity = Ramp(day.relative_humidity, 0.0)
        self._wind_mps = Ramp(day.north_mps, 0.0), Ramp(day.east_mps, 0.0)
        if any(gust for _, gust in day.gust_mps):
            self._fields.append(ReportedGusts(Ramp(day.gust_mps, 0.0)))
        moist = any(humidity for _, humidity in day.relative_humidity)
        self._column = layers if config.profile or moist else None
        self._standard, self._own = Column(), Column()
        """columns for the QNH: the standard day's, and a copy of JSBSim's"""
        self._station, self._station_k = Column(), 0.0
        """the column over the ground station, and its temperature offset"""
        self._own_k = 0.0
        self._qnh_of: Now | None = None
        """the weather whose QNH `_qnh_pa` is"""
        self._qnh_pa = math.nan
        self._solved: tuple[float, float] | None = None
        self._applied_air: tuple[float, float, float] | None = None
        self._applied_wind: tuple[float, float, float] | None = None
        ramps = (self._pressure_hpa, self._offset_k, self._humidity, *self._wind_mps)
        self._constant = not self._fields and all(ramp.constant for ramp in ramps)
        aircraft.set_turbulence(config.turbulence.severity, config.turbulence.wind_at_6m_mps)
        self.update(0.0)

    def _day(self, config: WeatherConfig, layers: Column) -> Day:
        """The weather that depends on time alone."""
        if config.metar is not None:
            return config.metar.day(self._aircraft.ground_m, layers)
        north_mps, east_mps = config.wind.vector_mps
        return Day(
            [(point.time_s, point.sea_level_hpa) for point in config.pressure],
            [(point.time_s, point.offset_k) for point in config.temperature],
            [(0.0, config.relative_humidity)],
            [(0.0, north_mps)],
            [(0.0, east_mps)],
            [],
        )

    def at(self, time_s: float) -> tuple[float, float]:
        """Sea-level pressure (Pa) and temperature deviation (K) of the ramps, without the
        fields."""
        return self._pressure_hpa(time_s) * 100.0, self._offset_k(time_s)

    def update(self, time_s: float) -> None:
        """Set the weather of this time at the aircraft."""
        if self._constant and self._applied_air is not None:
            return
        sea_level_pa, offset_k = self.at(time_s)
        north, east, down = self._wind_mps[0](time_s), self._wind_mps[1](time_s), 0.0
        ratio = 1.0
        if self._fields:
            point = self._point(time_s, (north, east))
            changes = [field.at(point) for field in self._fields]
            total = Change(*map(math.fsum, zip(*changes, strict=True)))
            sea_level_pa += total.sea_level_pa
            offset_k += total.offset_k
            north, east, down = north + total.north_mps, east + total.east_mps, total.down_mps
            ratio += total.local_pa / self._aircraft.air()[0]
        self.now = Now(sea_level_pa, offset_k, north, east, down)
        self._apply((sea_level_pa * ratio, offset_k, self._humidity(time_s)), (north, east, down))

    def truth(self, truth: Truth) -> TrueAir:
        """The air of the last `update` at the position of `truth`."""
        now = self.now
        if self._qnh_of is not now:
            self._qnh_of, self._qnh_pa = now, self._reduced_pa()
        return TrueAir(
            self._qnh_pa,
            now.sea_level_pa,
            truth.temperature_k - standard_k(truth.altitude_amsl_m),
            pressure_altitude_m(truth.pressure_pa),
            now.north_mps,
            now.east_mps,
            now.down_mps,
        )

    def station_air(self, time_s: float, elevation_m: float) -> tuple[float, float]:
        """Pressure (Pa) and air temperature (K) at a place on the ground beside the start, where
        the height is `elevation_m` and the weather that of there."""
        sea_level_pa, offset_k = self.at(time_s)
        if self._fields:
            latitude_deg = self._origin_deg[0]
            latitude_deg = math.copysign(max(abs(latitude_deg), _NO_CORIOLIS_DEG), latitude_deg)
            wind_mps = (self._wind_mps[0](time_s), self._wind_mps[1](time_s))
            height_m = elevation_m - self._aircraft.ground_m
            point = WeatherPoint(time_s, 0.0, 0.0, elevation_m, height_m, latitude_deg, wind_mps)
            total = Change(*map(math.fsum, zip(*(f.at(point) for f in self._fields), strict=True)))
            sea_level_pa += total.sea_level_pa
            offset_k += total.offset_k
        column = self._column
        if column is None:
            column = self._station
            if offset_k != self._station_k:
                column.solve(offset_k)
                self._station_k = offset_k
        air = column.at(elevation_m, sea_level_pa)
        return air.pressure_pa, air.temperature_k

    def _reduced_pa(self) -> float:
        """The field's pressure reduced to sea level through the standard column, Pa."""
        column = self._column
        if column is None:
            column = self._own
            if self.now.offset_k != self._own_k:
                column.solve(self.now.offset_k)
                self._own_k = self.now.offset_k
        field_pa, standard_pa = (
            air.at(self._aircraft.ground_m, 1.0).pressure_pa for air in (column, self._standard)
        )
        return self.now.sea_level_pa * field_pa / standard_pa

    def _apply(self, air: tuple[float, float, float], wind_mps: tuple[float, float, float]) -> None:
        """`air`: sea-level pressure (Pa), temperature offset (K), relative humidity."""
        if wind_mps != self._applied_wind:
            self._aircraft.set_wind(*wind_mps)
            self._applied_wind = wind_mps
        if air == self._applied_air:
            return
        sea_level_pa, offset_k, humidity = air
        if self._column is not None:
            self._solve(self._column, offset_k, humidity)
            column = self._column
            self._aircraft.set_column(lambda altitude_m: column.at(altitude_m, sea_level_pa))
        else:
            self._aircraft.set_air(sea_level_pa, offset_k)
        self._applied_air = air

    def _solve(self, column: Column, offset_k: float, humidity: float) -> None:
        """Only for a change that shows."""
        before_k, before = self._solved or (math.inf, math.inf)
        if abs(offset_k - before_k) > _RESOLVE_K or abs(humidity - before) > _RESOLVE_HUMIDITY:
            column.solve(offset_k, humidity)
            self._solved = offset_k, humidity

    def _point(self, time_s: float, wind_mps: tuple[float, float]) -> WeatherPoint:
        latitude_deg, longitude_deg, altitude_m = self._aircraft.position()
        north_m = (latitude_deg - self._origin_deg[0]) * EARTH_M_PER_DEG
        east_deg = math.remainder(longitude_deg - self._origin_deg[1], 360.0)
        east_m = east_deg * EARTH_M_PER_DEG * math.cos(math.radians(latitude_deg))
        # There is no balance of wind and pressure at the equator.
        latitude_deg = math.copysign(max(abs(latitude_deg), _NO_CORIOLIS_DEG), latitude_deg)
        height_m = altitude_m - self._aircraft.ground_m
        return WeatherPoint(time_s, north_m, east_m, altitude_m, height_m, latitude_deg, wind_mps)
