"""Sensors, one file each, and what their random streams have in common.

Every sensor draws from a stream of its own, keyed by its name: adding a sensor, changing its seed
or its parameters leaves the samples of all others untouched. Within a sensor every noise process
has its own stream too.

A sensor's parameters are its own defaults, changed by a ``preset`` (a line of its `PRESETS`),
changed by the scenario.
"""

import math
import zlib
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from companion.config import Settings

_BLOCK = 240
"""whole vectors of three; few enough that the blocks of all streams stay in the processor's
cache"""


class SensorConfig(Settings):
    """Parameters that all sensors have."""

    PRESETS: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    """name -> parameters of a real device"""

    preset: str = ""
    """real device whose parameters replace the defaults; those given beside it count
    all the same"""
    seed: Annotated[int, Field(ge=0)] | None = None
    """seed of this sensor; left out, the seed of the flight"""

    @model_validator(mode="before")
    @classmethod
    def _from_preset(cls, values: Any) -> Any:
        name = values.get("preset") if isinstance(values, dict) else None
        return (
            {**cls.PRESETS[name], **values}
            if isinstance(name, str) and name in cls.PRESETS
            else values
        )

    @field_validator("preset")
    @classmethod
    def _is_known(cls, name: str) -> str:
        if name and name not in cls.PRESETS:
            raise ValueError(f"is no preset; there are {', '.join(cls.PRESETS) or 'none'}")
        return name


def normals(seed: int, *names: str) -> Iterator[float]:
    """An endless sequence of standard normal numbers: the same for the same seed and names,
    independent of every other stream."""
    for block in normal_blocks(seed, *names):
        yield from block.tolist()


def uniforms(seed: int, *names: str) -> Iterator[float]:
    """Numbers from 0 to 1, uniformly distributed, for ever; streams as those of `normals`."""
    generator = _generator(seed, names)
    while True:
        yield from generator.random(_BLOCK).tolist()


def normal_blocks(seed: int, *names: str) -> Iterator[NDArray[np.float64]]:
    """The same in arrays: so one number costs 0.03 us, and a call of the generator 1 us."""
    generator = _generator(seed, names)
    while True:
        yield generator.standard_normal(_BLOCK)


def _generator(seed: int, names: tuple[str, ...]) -> np.random.Generator:
    keys = tuple(zlib.crc32(name.encode()) for name in names)
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=keys)))


class GaussMarkov:
    """First-order Gauss-Markov process, stationary from the start.

    x(k+1) = a x(k) + sd sqrt(1 - a^2) n(k) with a = exp(-dt / time constant); autocovariance sd^2
    exp(-|tau| / time constant) [Gelb, Applied Optimal Estimation, 1974, eq. 3.8-29]. Exact for any
    spacing dt.
    """

    def __init__(
        self, sd: float, time_constant_s: float, dt_s: float, noise: Iterator[float]
    ) -> None:
        keep = math.exp(-dt_s / time_constant_s)
        drive = sd * math.sqrt(1.0 - keep**2)
        self.step: Callable[[], float] = _values(keep, drive, sd * next(noise), noise).__next__
        """advances by dt and returns the new value"""


def _values(keep: float, drive: float, value: float, noise: Iterator[float]) -> Iterator[float]:
    """The values of a Gauss-Markov process after `value`."""
    for normal in noise:
        value = keep * value + drive * normal
        yield value
