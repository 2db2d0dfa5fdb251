"""A thermometer in the air: the probe of a hygrometer, sent as HYGROMETER_SENSOR.

Its error has three parts: a bias drawn once, white noise, and the lag of the probe. Defaults are
those of a digital probe in a vented housing (Sensirion SHT3x data sheet: +-0.2 K typical,
repeatability 0.04 K; response time 8 s in moving air). It is not fitted unless the scenario says
so.
"""

import math
from typing import Annotated

from pydantic import Field

from sim.sensors import SensorConfig, normals

PERIOD_US = 1_000_000


class ThermometerConfig(SensorConfig):
    """Section ``sensors.thermometer``."""

    fitted: bool = False
    """Whether the vehicle has a probe for the air temperature."""
    bias_k: Annotated[float, Field(ge=-30.0, le=30.0)] = 0.0
    """Constant error of the probe, K, such as the heat of the fuselage."""
    bias_sd_k: Annotated[float, Field(ge=0.0, le=30.0)] = 0.2
    """Standard deviation of a further constant error, K, drawn once."""
    white_sd_k: Annotated[float, Field(ge=0.0, le=30.0)] = 0.04
    """Standard deviation of the white noise, K."""
    lag_s: Annotated[float, Field(ge=0.0, le=600.0)] = 8.0
    """Time constant of the probe, s."""


class Thermometer:
    """Samples the air temperature once a second."""

    def __init__(self, config: ThermometerConfig, seed: int) -> None:
        seed = seed if config.seed is None else config.seed
        self.config = config
        self.period_us = PERIOD_US
        self._white = normals(seed, "thermometer", "white")
        bias = next(normals(seed, "thermometer", "bias"))
        self._bias_k = config.bias_k + config.bias_sd_k * bias
        self._follow = 1.0 - math.exp(-PERIOD_US * 1e-6 / config.lag_s) if config.lag_s else 1.0
        self._probe_k = math.nan

    def measure(self, temperature_k: float) -> float:
        """The reading of the true air temperature, K; NaN when no probe is fitted. Call it every
        `period_us`."""
        if not self.config.fitted:
            return math.nan
        if math.isnan(self._probe_k):
            self._probe_k = temperature_k
        self._probe_k += self._follow * (temperature_k - self._probe_k)
        return self._probe_k + self._bias_k + self.config.white_sd_k * next(self._white)
