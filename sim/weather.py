"""The weather over a flight: piecewise-linear ramps in time, a steady wind, turbulence. JSBSim turns it into air.

The sea-level pressure and the temperature deviation go into JSBSim's atmosphere, which integrates the column above
hydrostatically: at a given geometric altitude both move the static pressure, and so a barometer.
"""

import bisect
import itertools
import math
from collections.abc import Sequence
from typing import Annotated

from pydantic import Field, model_validator

from companion.config import Settings
from sim.aircraft import Aircraft

STANDARD_HPA = 1013.25

Time = Annotated[float, Field(ge=0.0, le=1e6)]


class PressurePoint(Settings):
    """Sea-level pressure at a time since boot; linear in between, constant before the first and after the last."""

    time_s: Time
    sea_level_hpa: Annotated[float, Field(ge=850.0, le=1100.0)]


class TemperaturePoint(Settings):
    """Deviation of the whole column from the standard atmosphere's temperature at a time since boot."""

    time_s: Time
    offset_k: Annotated[float, Field(ge=-60.0, le=45.0)]


class Wind(Settings):
    """A steady wind, and the direction it comes from."""

    speed_mps: Annotated[float, Field(ge=0.0, le=60.0)] = 0.0
    from_deg: Annotated[float, Field(ge=0.0, lt=360.0)] = 0.0


class Turbulence(Settings):
    """Dryden turbulence of MIL-F-8785C, as JSBSim has it.

    Below 600 m above *sea level* (JSBSim does not ask for the ground) its strength follows the wind at 6 m (20 ft),
    with a vertical standard deviation of a tenth of it; above it follows the severity.
    """

    severity: Annotated[int, Field(ge=0, le=7)] = 0
    """0 none, 3 light, 4 moderate, 6 severe"""
    wind_at_6m_mps: Annotated[float, Field(ge=0.0, le=40.0)] = 0.0


class WeatherConfig(Settings):
    """The weather of a scenario. Empty ramps are the standard day."""

    pressure: tuple[PressurePoint, ...] = ()
    temperature: tuple[TemperaturePoint, ...] = ()
    wind: Wind = Wind()
    turbulence: Turbulence = Turbulence()

    @model_validator(mode="after")
    def _in_order(self) -> "WeatherConfig":
        for name, points in (("pressure", self.pressure), ("temperature", self.temperature)):
            times = [point.time_s for point in points]
            if any(after <= before for before, after in itertools.pairwise(times)):
                raise ValueError(f"the times of the {name} ramp must increase")
        return self


class Ramp:
    """A piecewise-linear function of time, constant outside its points."""

    def __init__(self, points: Sequence[tuple[float, float]], default: float) -> None:
        self._times = [time for time, _ in points] or [0.0]
        self._values = [value for _, value in points] or [default]

    def __call__(self, time_s: float) -> float:
        after = bisect.bisect_right(self._times, time_s)
        if after == 0:
            return self._values[0]
        if after == len(self._times):
            return self._values[-1]
        start, end = self._times[after - 1], self._times[after]
        share = (time_s - start) / (end - start)
        return self._values[after - 1] + share * (self._values[after] - self._values[after - 1])


class Weather:
    """Applies a `WeatherConfig` to an aircraft; `update` as often as the ramps are to be smooth."""

    def __init__(self, config: WeatherConfig, aircraft: Aircraft) -> None:
        self._aircraft = aircraft
        self._pressure_hpa = Ramp([(p.time_s, p.sea_level_hpa) for p in config.pressure], STANDARD_HPA)
        self._offset_k = Ramp([(p.time_s, p.offset_k) for p in config.temperature], 0.0)
        self._applied: tuple[float, float] | None = None
        direction = math.radians(config.wind.from_deg)
        speed = config.wind.speed_mps
        aircraft.set_wind(-speed * math.cos(direction), -speed * math.sin(direction))
        aircraft.set_turbulence(config.turbulence.severity, config.turbulence.wind_at_6m_mps)
        self.update(0.0)

    def at(self, time_s: float) -> tuple[float, float]:
        """Sea-level pressure (Pa) and temperature deviation (K)."""
        return self._pressure_hpa(time_s) * 100.0, self._offset_k(time_s)

    def update(self, time_s: float) -> None:
        air = self.at(time_s)
        if air != self._applied:
            self._aircraft.set_air(*air)
            self._applied = air
