"""A strapdown IMU at the centre of gravity, forward-right-down.

Each sample is the mean over its interval, as an anti-aliased and decimated IMU gives it, with a turn-on bias, a bias
that walks, white noise, and (in RAW_IMU) the quantisation of ArduPilot's milli-g and milliradians.

Defaults are those of the recorded flights data/flights/jsbsim_* (README): 0.02 m/s2/sqrt(Hz), bias 0.1 m/s2 drifting,
gyro bias 0.01 rad/s. They are what an airframe with a running engine adds to a consumer IMU: the ICM-20602 data sheet
alone has 100 ug/sqrt(Hz) = 0.001 m/s2/sqrt(Hz), 0.004 deg/s/sqrt(Hz) = 7e-5 rad/s/sqrt(Hz), zero offsets of 25 mg and
1 deg/s.
"""

import math
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from sim.aircraft import Motion, Vector
from sim.sensors import SensorConfig, normals

Small = Annotated[float, Field(ge=0.0, le=10.0)]


class ImuConfig(SensorConfig):
    """Noise parameters of the IMU."""

    rate_hz: Literal[1, 2, 5, 10, 25, 50] = 50
    accel_noise_mps2_rthz: Small = 0.02
    accel_bias_sd_mps2: Small = 0.1
    accel_walk_mps2_rts: Small = 3e-4
    """bias random walk, m/s2 per root second: 0.01 m/s2 in twenty minutes"""
    gyro_noise_radps_rthz: Small = 5e-4
    gyro_bias_sd_radps: Small = 0.01
    gyro_walk_radps_rts: Small = 1e-5
    temperature_k: Annotated[float, Field(ge=200.0, le=400.0)] = 313.15
    """of the die, held by its heater"""


class ImuSample(NamedTuple):
    """One sample; the time is the end of the interval it is the mean of."""

    time_us: int
    specific_force_b_mps2: Vector
    angular_rate_b_radps: Vector
    die_temperature_cdegc: int


class _Triad:
    """Three equal sensors at right angles: bias, walk, noise."""

    def __init__(self, seed: int, name: str, *, noise: float, bias_sd: float, walk: float, dt_s: float) -> None:
        turn_on = normals(seed, "imu", name, "bias")
        self.bias = [bias_sd * next(turn_on) for _ in range(3)]
        self._walk = walk * math.sqrt(dt_s)
        self._noise = noise / math.sqrt(dt_s)
        self._steps = normals(seed, "imu", name, "walk")
        self._white = normals(seed, "imu", name, "white")

    def measure(self, true: Vector) -> Vector:
        bias, walk, noise, steps, white = self.bias, self._walk, self._noise, self._steps, self._white
        bias[0] += walk * next(steps)
        bias[1] += walk * next(steps)
        bias[2] += walk * next(steps)
        return (
            true[0] + bias[0] + noise * next(white),
            true[1] + bias[1] + noise * next(white),
            true[2] + bias[2] + noise * next(white),
        )


class Imu:
    """Samples the mean motion at ``config.rate_hz``."""

    def __init__(self, config: ImuConfig, seed: int) -> None:
        seed = seed if config.seed is None else config.seed
        self.config = config
        self.period_us = 1_000_000 // config.rate_hz
        dt_s = 1.0 / config.rate_hz
        self._die_cdegc = round((config.temperature_k - 273.15) * 100.0)
        self._accelerometers = _Triad(
            seed,
            "accel",
            noise=config.accel_noise_mps2_rthz,
            bias_sd=config.accel_bias_sd_mps2,
            walk=config.accel_walk_mps2_rts,
            dt_s=dt_s,
        )
        self._gyros = _Triad(
            seed,
            "gyro",
            noise=config.gyro_noise_radps_rthz,
            bias_sd=config.gyro_bias_sd_radps,
            walk=config.gyro_walk_radps_rts,
            dt_s=dt_s,
        )

    def measure(self, time_us: int, motion: Motion) -> ImuSample:
        """The reading of the mean motion since the last call. Call it every `period_us`."""
        return ImuSample(
            time_us,
            self._accelerometers.measure(motion.specific_force_b_mps2),
            self._gyros.measure(motion.angular_rate_b_radps),
            self._die_cdegc,
        )
