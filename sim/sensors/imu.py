"""A strapdown IMU at the centre of gravity, forward-right-down.

Each sample is the mean over its interval, as an anti-aliased and decimated IMU gives it, seen
through scale factors and misalignments, with a turn-on bias, a bias that walks and one that follows
the die's temperature, white noise, the vibration of the engine, an end of its range, and (in
RAW_IMU) the quantisation of ArduPilot's milli-g and milliradians.

Defaults are those of the recorded flights data/flights/jsbsim_* (README): 0.02 m/s2/sqrt(Hz), bias
0.1 m/s2 drifting, gyro bias 0.01 rad/s. They are what an airframe with a running engine adds to a
consumer IMU: the ICM-20602 data sheet alone has 100 ug/sqrt(Hz) = 0.001 m/s2/sqrt(Hz), 0.004
deg/s/sqrt(Hz) = 7e-5 rad/s/sqrt(Hz), zero offsets of 25 mg and 1 deg/s. Ranges are ArduPilot's
settings of that chip, 16 g and 2000 deg/s.

Vibration is a line at the engine's frequency. The mean over an interval takes most of it away, as a
low-pass does, and what remains appears at the alias; without that mean (``averaged: false``, a
sensor sampled at the output rate) all of it does. A flat four at 2400 rpm fires at 80 Hz;
ArduPilot's advice is to stay below 30 m/s2.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from sim.aircraft_state import Motion, Vector
from sim.constants import G0_MPS2, ZERO_CELSIUS_K
from sim.sensors import GaussMarkov, SensorConfig, normal_blocks, normals

Small = Annotated[float, Field(ge=0.0, le=10.0)]
Range = Annotated[float, Field(gt=0.0, le=1e4)]

_DEG = math.radians(1.0)
_MG = 1e-3 * G0_MPS2

# [c] was found again in a copy of the data sheet, or with somebody who quotes it; the rest was not.
PRESETS: Mapping[str, Mapping[str, Any]] = {
    # InvenSense, ICM-20602 data sheet DS-000176: noise 100 ug and 0.004 deg/s per root Hz [c];
    # scale +-1 % [c]; zero offsets +-25 mg and +-1 deg/s, +-0.5 mg/K and +-0.01 deg/s/K, cross axes
    # +-1 %: a third of each. The walks are not in it: assumed, what Allan plots of such chips show
    # (bias instability near 0.05 mg and 5 deg/h).
    "ICM-20602": {
        "accel_noise_mps2_rthz": 0.1 * _MG, "accel_bias_sd_mps2": 8.3 * _MG,
        "accel_walk_mps2_rts": 5e-5, "gyro_noise_radps_rthz": 0.004 * _DEG,
        "gyro_bias_sd_radps": 0.33 * _DEG, "gyro_walk_radps_rts": 2e-6,
        "accel_thermal_sd_mps2_per_k": 0.17 * _MG, "gyro_thermal_sd_radps_per_k": 0.0033 * _DEG,
        "scale_sd": 0.0033, "misalignment_sd_rad": 0.0033, "warming_k": 20.0,
    },
    # Analog Devices, ADIS16495 data sheet rev. C, the -1: 0.09 deg/sqrt(h), 0.8 deg/h and 3.2 ug in
    # run, axes within 0.05 deg, +-8 g, 125 deg/s [c]; 0.008 m/s/sqrt(h). A walk K gives the Allan
    # minimum 0.664 B with noise N at K = 0.866 (0.664 B)^2 / N. What is left of the biases after it
    # was calibrated on the ground is assumed: 0.1 mg, 5 deg/h.
    "tactical": {
        "accel_noise_mps2_rthz": 0.008 / 60.0, "accel_bias_sd_mps2": 0.1 * _MG,
        "accel_walk_mps2_rts": 2.8e-6, "gyro_noise_radps_rthz": 0.09 / 60.0 * _DEG,
        "gyro_bias_sd_radps": 5.0 / 3600.0 * _DEG, "gyro_walk_radps_rts": 2.2e-7, "scale_sd": 5e-4,
        "misalignment_sd_rad": 0.05 * _DEG, "accel_range_mps2": 8.0 * G0_MPS2,
        "gyro_range_radps": 125.0 * _DEG,
    },
}  # fmt: skip


class ImuConfig(SensorConfig):
    """Noise parameters of the IMU."""

    PRESETS: ClassVar = PRESETS

    rate_hz: Literal[1, 2, 5, 10, 25, 50] = 50
    """samples a second; each is the mean since the one before"""
    accel_noise_mps2_rthz: Small = 0.02
    """white noise of each accelerometer"""
    accel_bias_sd_mps2: Small = 0.1
    """standard deviation of the accelerometer bias of each axis at boot"""
    accel_walk_mps2_rts: Small = 3e-4
    """accelerometer bias random walk, m/s2 per root second: 0.01 m/s2 in twenty minutes"""
    gyro_noise_radps_rthz: Small = 5e-4
    """white noise of each gyro"""
    gyro_bias_sd_radps: Small = 0.01
    """standard deviation of the gyro bias of each axis at boot"""
    gyro_walk_radps_rts: Small = 1e-5
    """gyro bias random walk, rad/s per root second"""
    accel_thermal_sd_mps2_per_k: Small = 0.0
    """standard deviation of the bias for each kelvin that the die is below its final temperature"""
    gyro_thermal_sd_radps_per_k: Small = 0.0
    """standard deviation of the bias for each kelvin that the die is below its final temperature"""
    scale_sd: Annotated[float, Field(ge=0.0, le=0.2)] = 0.0
    """standard deviation of the scale error of each accelerometer and gyro, 0.01 is 1 %"""
    misalignment_sd_rad: Annotated[float, Field(ge=0.0, le=0.2)] = 0.0
    """standard deviation of the angle of each axis towards each other axis"""
    accel_range_mps2: Range = 16.0 * G0_MPS2
    """measuring range of an accelerometer; a larger value reads as the end of the range"""
    gyro_range_radps: Range = 2000.0 * _DEG
    """measuring range of a gyro; a larger value reads as the end of the range"""
    vibration_mps2: Annotated[float, Field(ge=0.0, le=500.0)] = 0.0
    """peak acceleration of the vibration on each axis"""
    vibration_hz: Annotated[float, Field(gt=0.0, le=2000.0)] = 80.0
    """frequency of the vibration, the engine's firing"""
    vibration_spread_hz: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0
    """standard deviation of the vibration's frequency, which wanders over two seconds"""
    averaged: bool = True
    """whether a sample is the mean of the vibration over its interval"""
    temperature_k: Annotated[float, Field(ge=200.0, le=400.0)] = 313.15
    """final temperature of the die, held by its heater"""
    warming_k: Annotated[float, Field(ge=0.0, le=80.0)] = 0.0
    """temperature of the die at boot below its final temperature"""
    warming_time_s: Annotated[float, Field(gt=0.0, le=1e5)] = 120.0
    """time constant of the die's warming from boot on"""


class ImuSample(NamedTuple):
    """One sample; the time is the end of the interval it is the mean of."""

    time_us: int
    specific_force_b_mps2: Vector
    angular_rate_b_radps: Vector
    die_temperature_cdegc: int


_new_sample: Callable[[tuple[Any, ...]], ImuSample] = partial(tuple.__new__, ImuSample)
"""`ImuSample` of a tuple, without the Python code of its constructor"""


class _Triad:
    """Three like sensors at nearly right angles: scale, misalignment, bias, walk, thermal bias,
    noise, range."""

    def __init__(
        self, seed: int, name: str, *,
        noise: float, bias_sd: float, walk: float, thermal_sd: float, limit: float,
        config: ImuConfig,
    ) -> None:  # fmt: skip
        dt_s = 1.0 / config.rate_hz
        turn_on = normals(seed, "imu", name, "bias")
        self.bias = [bias_sd * next(turn_on) for _ in range(3)]
        heat = normals(seed, "imu", name, "thermal")
        self.thermal = [thermal_sd * next(heat) for _ in range(3)] if thermal_sd else None
        self._error = self._draw(
            seed, name, walk * math.sqrt(dt_s), noise / math.sqrt(dt_s)
        ).__next__
        self._limit = limit
        self.mounting = _mounting(seed, name, config)
        self._perfect = self.mounting is None and self.thermal is None
        """whether only bias and noise are added"""

    def _draw(self, seed: int, name: str, walk: float, noise: float) -> Iterator[list[float]]:
        """Bias, walking from the turn-on one, and white noise of one sample after the other."""
        steps, white = (
            normal_blocks(seed, "imu", name, "walk"),
            normal_blocks(seed, "imu", name, "white"),
        )
        bias = np.array([self.bias])
        while True:
            biases = np.cumsum(np.vstack((bias, walk * next(steps).reshape(-1, 3))), axis=0)
            bias = biases[-1:]
            yield from (biases[1:] + noise * next(white).reshape(-1, 3)).tolist()

    def measure(self, true: Vector, cold_k: float) -> Vector:
        if not self._perfect:
            true = self._seen(true, cold_k)
        (x, y, z), (error_x, error_y, error_z) = true, self._error()
        x += error_x
        y += error_y
        z += error_z
        limit = self._limit
        if -limit <= x <= limit and -limit <= y <= limit and -limit <= z <= limit:
            return x, y, z
        return max(-limit, min(x, limit)), max(-limit, min(y, limit)), max(-limit, min(z, limit))

    def _seen(self, true: Vector, cold_k: float) -> Vector:
        """Scale, misalignment and thermal bias."""
        x, y, z = true
        if self.mounting is not None:
            x, y, z = (row[0] * x + row[1] * y + row[2] * z for row in self.mounting)
        if self.thermal is not None:
            heat_x, heat_y, heat_z = self.thermal
            x, y, z = x - cold_k * heat_x, y - cold_k * heat_y, z - cold_k * heat_z
        return x, y, z


def _mounting(seed: int, name: str, config: ImuConfig) -> list[Vector] | None:
    """Matrix that multiplies the true vector; None for a perfect sensor."""
    if not config.scale_sd and not config.misalignment_sd_rad:
        return None
    draw = normals(seed, "imu", name, "mounting")
    rows = []
    for axis in range(3):
        row = [
            (config.scale_sd if axis == other else config.misalignment_sd_rad) * next(draw)
            for other in range(3)
        ]
        row[axis] += 1.0
        rows.append((row[0], row[1], row[2]))
    return rows


class _Vibration:
    """A line at a wandering frequency, on three axes a third of a turn apart."""

    def __init__(self, seed: int, config: ImuConfig) -> None:
        self._dt_s = 1.0 / config.rate_hz
        self._size = config.vibration_mps2
        self._hz = config.vibration_hz
        self._averaged = config.averaged
        self._phase = math.tau * next(normals(seed, "imu", "vibration", "phase"))
        noise = normals(seed, "imu", "vibration", "frequency")
        self._wander = GaussMarkov(config.vibration_spread_hz, 2.0, self._dt_s, noise)

    def step(self) -> Vector:
        """What an interval has of it."""
        before = self._phase
        turned = math.tau * (self._hz + self._wander.step()) * self._dt_s
        self._phase = after = math.remainder(before + turned, math.tau)
        if self._averaged:
            scale = self._size / turned if turned else 0.0
            x, y, z = (
                scale * (math.cos(before + third) - math.cos(before + turned + third))
                for third in _THIRDS
            )
        else:
            x, y, z = (self._size * math.sin(after + third) for third in _THIRDS)
        return x, y, z


_THIRDS = (0.0, math.tau / 3.0, 2.0 * math.tau / 3.0)


class Imu:
    """Samples the mean motion at ``config.rate_hz``."""

    def __init__(self, config: ImuConfig, seed: int) -> None:
        seed = seed if config.seed is None else config.seed
        self.config = config
        self.period_us = 1_000_000 // config.rate_hz
        self._accelerometers = _Triad(
            seed,
            "accel",
            noise=config.accel_noise_mps2_rthz,
            bias_sd=config.accel_bias_sd_mps2,
            walk=config.accel_walk_mps2_rts,
            thermal_sd=config.accel_thermal_sd_mps2_per_k,
            limit=config.accel_range_mps2,
            config=config,
        )
        self._gyros = _Triad(
            seed,
            "gyro",
            noise=config.gyro_noise_radps_rthz,
            bias_sd=config.gyro_bias_sd_radps,
            walk=config.gyro_walk_radps_rts,
            thermal_sd=config.gyro_thermal_sd_radps_per_k,
            limit=config.gyro_range_radps,
            config=config,
        )
        self._vibration = _Vibration(seed, config) if config.vibration_mps2 else None
        self._warm_cdegc = _cdegc(config.temperature_k)

    def measure(self, time_us: int, motion: Motion) -> ImuSample:
        """The reading of the mean motion since the last call. Call it every `period_us`."""
        config, cold_k, die_cdegc = self.config, 0.0, self._warm_cdegc
        if config.warming_k:
            cold_k = config.warming_k * math.exp(-time_us * 1e-6 / config.warming_time_s)
            die_cdegc = _cdegc(config.temperature_k - cold_k)
        force = motion.specific_force_b_mps2
        if self._vibration is not None:
            shake = self._vibration.step()
            force = (force[0] + shake[0], force[1] + shake[1], force[2] + shake[2])
        return _new_sample(
            (
                time_us,
                self._accelerometers.measure(force, cold_k),
                self._gyros.measure(motion.angular_rate_b_radps, cold_k),
                die_cdegc,
            )
        )


def _cdegc(temperature_k: float) -> int:
    """Hundredths of a degree Celsius."""
    return round((temperature_k - ZERO_CELSIUS_K) * 100.0)
