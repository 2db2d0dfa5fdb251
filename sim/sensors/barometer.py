"""A MEMS barometer on a static port.

Defaults, and where they come from:

- white noise 2.4 Pa (0.2 m): MS5611-01BA03 data sheet, resolution 1.2 Pa RMS at OSR 4096 and 2.7 Pa at OSR 1024;
- slow wander 5 Pa over 300 s: quiet real barometers of data/real show 0.05-0.13 m over 1 s, and metres over
  ten minutes, of which the weather is simulated separately;
- turn-on bias sd 50 Pa: MS5611, absolute accuracy +-150 Pa from 450 to 1100 hPa, read as three sigma;
- lag 0.1 s: pneumatic lag of a short static line (0.05-0.2 s);
- die 20 K above the air once warm, after minutes: measured boards run 10-30 K above (data/real: 26 to 38 C).
"""

import math
from collections.abc import Iterator
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from sim.sensors import GaussMarkov, SensorConfig, normals

NonNegative = Annotated[float, Field(ge=0.0, le=10_000.0)]
Positive = Annotated[float, Field(gt=0.0, le=1e6)]


class BarometerConfig(SensorConfig):
    """Noise parameters of the barometer."""

    rate_hz: Literal[1, 2, 4, 5, 10, 20, 25, 50] = 20
    """ArduPilot's drivers run at 10-20 Hz and repeat the value in between"""
    white_sd_pa: NonNegative = 2.4
    wander_sd_pa: NonNegative = 5.0
    wander_time_s: Positive = 300.0
    bias_pa: Annotated[float, Field(ge=-60_000.0, le=60_000.0)] = 0.0
    bias_sd_pa: NonNegative = 50.0
    lag_s: Annotated[float, Field(ge=0.0, le=10.0)] = 0.1
    warming_k: Annotated[float, Field(ge=-50.0, le=60.0)] = 20.0
    warming_time_s: Positive = 120.0


class Pressure(NamedTuple):
    """One reading."""

    time_us: int
    pressure_pa: float
    die_temperature_k: float


class Barometer:
    """Samples the static pressure at ``config.rate_hz``."""

    def __init__(self, config: BarometerConfig, seed: int) -> None:
        seed = seed if config.seed is None else config.seed
        self.config = config
        self.period_us = 1_000_000 // config.rate_hz
        dt_s = 1.0 / config.rate_hz
        self._white: Iterator[float] = normals(seed, "barometer", "white")
        self._wander = GaussMarkov(
            config.wander_sd_pa, config.wander_time_s, dt_s, normals(seed, "barometer", "wander")
        )
        self.bias_pa = config.bias_pa + config.bias_sd_pa * next(normals(seed, "barometer", "bias"))
        self._follow = 1.0 - math.exp(-dt_s / config.lag_s) if config.lag_s else 1.0
        self._port_pa: float | None = None

    def measure(self, time_us: int, pressure_pa: float, temperature_k: float) -> Pressure:
        """The reading of the true static pressure and air temperature. Call it every `period_us`."""
        config = self.config
        if self._port_pa is None:
            self._port_pa = pressure_pa
        self._port_pa += self._follow * (pressure_pa - self._port_pa)
        error_pa = self.bias_pa + self._wander.step() + config.white_sd_pa * next(self._white)
        warm = 1.0 - math.exp(-time_us * 1e-6 / config.warming_time_s)
        return Pressure(time_us, self._port_pa + error_pa, temperature_k + config.warming_k * warm)
