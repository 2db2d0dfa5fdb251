"""A recorded flight with truth, from which samples are made as an estimator would have got them."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from companion.samples import DTYPES, HEIGHT, Kind, Rows, SampleLog, rows
from sim.studies.real.gnss_errors import GnssError

Array = NDArray[np.float64]

HOST_EPOCH_US = 1_700_000_000_000_000
WITHIN_TICK_US = {
    Kind.STATUS: 1, Kind.AIR: 2, Kind.AIRSPEED: 3, Kind.IMU: 4, Kind.PRESSURE: 5, Kind.ATTITUDE: 6,
    Kind.GNSS: 7,
}  # fmt: skip
"""Order in which an autopilot's messages of one instant arrive."""


@dataclass(frozen=True)
class Plan:
    """What the telemetry link carries, and what is laid on the recording."""

    imu_hz: int
    """rate of the IMU samples, Hz; 0 leaves them out"""
    attitude: bool
    """whether the autopilot's attitude is sent"""
    lag_s: float
    """lag of the recorded barometer that is taken out, s; 0 leaves the barometer as recorded"""
    seed: int
    """seed of every error that is added"""
    field_elevation: bool = False
    """whether the elevation of the field is known at the start, with a standard error of 1 m"""


class Recording(ABC):
    """One file with a recorded flight and its truth."""

    own_gnss: ClassVar[bool] = False
    """whether the recording has a receiver of its own beside the truth"""

    def __init__(self, path: Path) -> None:
        self.name = path.stem
        self.duration_s = math.nan

    @classmethod
    @abstractmethod
    def recognises(cls, path: Path) -> bool:
        """Whether a file is of this format, by its contents."""

    @abstractmethod
    def samples(self, plan: Plan, error: GnssError | None) -> SampleLog:
        """The flight as an estimator gets it.

        The truth of the height with `error` is the GNSS height; None takes the recording's own
        receiver, or a perfect one where there is none.
        """


def table(kind: Kind, elapsed_s: Array, **values: Any) -> Rows:
    """Rows of `kind`, stamped when they arrive, at `elapsed_s` since boot; other fields are
    unknown."""
    made = np.asarray(rows(DTYPES[kind], elapsed_s.size))
    # as a link does: floor to microseconds
    made["time_us"] = (elapsed_s * 1e6).astype(np.int64)
    made["arrival_us"] = (HOST_EPOCH_US + elapsed_s * 1e6).astype(np.int64) + WITHIN_TICK_US[kind]
    for name, value in values.items():
        made[name] = value
    return made


def truth_rows(elapsed_s: Array, altitude_m: Array, climb_mps: Array) -> Rows:
    """Rows of truth."""
    made = np.zeros(elapsed_s.size, HEIGHT)
    made["time_us"] = (elapsed_s * 1e6).astype(np.int64)
    made["altitude_amsl_m"], made["climb_mps"] = altitude_m, climb_mps
    return made


def status_rows(duration_s: float) -> Rows:
    """HEARTBEAT of an armed vehicle, once a second."""
    return table(Kind.STATUS, np.arange(2.0, duration_s), armed=1, landed=-1, reboot=0)


def elevation_row(elapsed_s: float, elevation_m: float, seed: int) -> Rows:
    """What is known of the field: its elevation, with a standard error of 1 m."""
    known_m = elevation_m + np.random.default_rng([seed, 7]).normal()
    return table(Kind.AIR, np.array([elapsed_s]), field_elevation_m=known_m)
