"""The vehicle's own estimate, for ATTITUDE, GLOBAL_POSITION_INT and HOME_POSITION: plausible,
simple, and not truth.

Height follows the barometer alone, as ArduPilot's EKF3 does by default: its AMSL origin is one
early GNSS fix, error included, and is never corrected, so that the weather goes into it in full
(EKF3 measured: 23 m RMSE where the barometer drifts). Position is the last fix carried on with its
velocity. Attitude is the truth with a slow error of a fraction of a degree.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Annotated, NamedTuple

from pydantic import Field

from sim.aircraft_state import Truth
from sim.constants import EARTH_M_PER_DEG
from sim.sensors import GaussMarkov, SensorConfig, normals
from sim.sensors.barometer import Pressure
from sim.sensors.gnss import Fix

ORIGIN_DELAY_S = 10.0
"""EKF3 takes its origin about ten seconds after the first 3D fix, when its checks of the receiver
have passed."""
_SMOOTHING_S = 0.5
_RAISED_M = 0.01
"""difference at which AP_Baro takes its offset as it is"""


class EstimateConfig(SensorConfig):
    """Errors of the vehicle's own attitude."""

    tilt_sd_deg: Annotated[float, Field(ge=0.0, le=30.0)] = 0.3
    """standard deviation of the error of the estimated roll and pitch"""
    heading_sd_deg: Annotated[float, Field(ge=0.0, le=90.0)] = 1.0
    """standard deviation of the error of the estimated yaw"""
    attitude_time_s: Annotated[float, Field(gt=0.0, le=1e5)] = 60.0
    """correlation time of the errors of roll, pitch and yaw"""


class Position(NamedTuple):
    """The vehicle's own estimate of its position and velocity."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    north_mps: float
    east_mps: float
    climb_mps: float


_new_position: Callable[[tuple[float, ...]], Position] = partial(tuple.__new__, Position)
"""`Position` of a tuple, without the Python code of its constructor"""


class OwnEstimate:
    """Fed with the vehicle's sensors; `position` is None until there is an origin."""

    def __init__(
        self, config: EstimateConfig, seed: int, attitude_dt_s: float, raise_time_s: float = 0.0
    ) -> None:
        """`raise_time_s`: time constant with which a raised barometric altitude is followed."""
        self._raise_time_s = raise_time_s
        seed = seed if config.seed is None else config.seed

        def error(name: str, sd_deg: float) -> Callable[[], float]:
            noise, time_s = normals(seed, "estimate", name), config.attitude_time_s
            return GaussMarkov(math.radians(sd_deg), time_s, attitude_dt_s, noise).step

        self._roll = error("roll", config.tilt_sd_deg)
        self._pitch = error("pitch", config.tilt_sd_deg)
        self._yaw = error("yaw", config.heading_sd_deg)
        self.restart()

    def restart(self) -> None:
        """The vehicle boots: height and origin are unknown again."""
        self._height_m = math.nan
        self._raised_m = math.nan
        self._climb_mps = 0.0
        self._pressure_us = 0
        self._fix: Fix | None = None
        self._first_fix_us: int | None = None
        self._origin_offset_m: float | None = None

    def on_pressure(self, sample: Pressure, raised_m: float = 0.0) -> None:
        """Critically damped alpha-beta filter of the ISA altitude: no lag in a steady climb.

        `raised_m` is by how much the parameters raise it.
        """
        dt_s = (sample.time_us - self._pressure_us) * 1e-6
        self._pressure_us = sample.time_us
        height_m = isa_altitude_m(sample.pressure_pa) + self._follow(raised_m, dt_s)
        if math.isnan(self._height_m):
            self._height_m = height_m
            return
        keep = math.exp(-dt_s / _SMOOTHING_S)
        predicted_m = self._height_m + self._climb_mps * dt_s
        innovation_m = height_m - predicted_m
        self._height_m = predicted_m + (1.0 - keep**2) * innovation_m
        self._climb_mps += (1.0 - keep) ** 2 * innovation_m / dt_s

    def _follow(self, raised_m: float, dt_s: float) -> float:
        """The part of `raised_m` that is in effect after `dt_s` more: a low-pass, whole from a
        centimetre on."""
        left_m = raised_m - self._raised_m
        if self._raise_time_s and abs(left_m) > _RAISED_M:  # not before the first
            self._raised_m += left_m * -math.expm1(-dt_s / self._raise_time_s)
        else:
            self._raised_m = raised_m
        return self._raised_m

    def on_fix(self, fix: Fix) -> bool:
        """Take a fix; True when it set the origin."""
        if fix.fix_type < 3:
            return False
        self._fix = fix
        self._per_degree_m = EARTH_M_PER_DEG * math.cos(math.radians(fix.latitude_deg))
        """length of a degree of longitude at the fix"""
        if self._first_fix_us is None:
            self._first_fix_us = fix.stamp_us
        ready = fix.stamp_us - self._first_fix_us >= ORIGIN_DELAY_S * 1e6
        if self._origin_offset_m is None and ready and not math.isnan(self._height_m):
            self._origin_offset_m = fix.altitude_amsl_m - self._height_m
            return True
        return False

    def position(self, time_us: int) -> Position | None:
        fix, offset_m = self._fix, self._origin_offset_m
        if fix is None or offset_m is None:
            return None
        age_s, north_mps, east_mps = (time_us - fix.measured_us) * 1e-6, fix.north_mps, fix.east_mps
        climb_mps = self._climb_mps
        return _new_position(
            (
                fix.latitude_deg + north_mps * age_s / EARTH_M_PER_DEG,
                fix.longitude_deg + east_mps * age_s / self._per_degree_m,
                self._height_m + climb_mps * (time_us - self._pressure_us) * 1e-6 + offset_m,
                north_mps,
                east_mps,
                climb_mps,
            )
        )

    def attitude(self, truth: Truth) -> tuple[float, float, float]:
        """Roll, pitch, yaw (rad). Call it once every ``attitude_dt_s``: the errors advance."""
        return (
            truth.roll_rad + self._roll(),
            truth.pitch_rad + self._pitch(),
            math.remainder(truth.yaw_rad + self._yaw(), math.tau),
        )


def isa_altitude_m(pressure_pa: float, sea_level_pa: float = 101_325.0) -> float:
    """Height, m, at which autopilots' standard troposphere above `sea_level_pa` has a pressure."""
    return 44_330.77 * (1.0 - math.pow(pressure_pa / sea_level_pa, 0.190263))
