"""A GNSS receiver: position with white and correlated errors, late, and blind until its first fix.

Defaults, and where they come from:

- height error 3 m white and 3 m Gauss-Markov over 300 s, 5 Hz, 0.11 s late: those of the recorded flights
  data/flights/jsbsim_*, so that results compare. The real receivers of data/real have less white noise (0.03-0.2 m over
  1 s) and more wander (7-59 m in 2-10 minutes): a scenario that wants those sets them;
- horizontal error half of it: u-blox M8 data sheet (UBX-15031086), 2.5 m CEP, and vertical errors are about twice that;
- velocity 0.1 m/s: M8 data sheet, 0.05 m/s at 50 %, doubled for manoeuvres;
- latency: ArduPilot measured 0.05-0.25 s; its time stamp is the time of parsing, not of measurement.

The accuracies it reports are honest: the standard deviations of its own errors.
"""

import math
from collections import deque
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from sim.aircraft import Truth
from sim.sensors import GaussMarkov, SensorConfig, normals

Metres = Annotated[float, Field(ge=0.0, le=1000.0)]

_EARTH_M_PER_DEG = 111_319.49  # of latitude; enough for an error of metres


class GnssConfig(SensorConfig):
    """Noise parameters of the receiver."""

    rate_hz: Literal[1, 2, 5, 10, 25] = 5
    height_white_sd_m: Metres = 3.0
    height_wander_sd_m: Metres = 3.0
    horizontal_white_sd_m: Metres = 1.0
    horizontal_wander_sd_m: Metres = 1.5
    wander_time_s: Annotated[float, Field(gt=0.0, le=1e5)] = 300.0
    velocity_sd_mps: Annotated[float, Field(ge=0.0, le=100.0)] = 0.1
    latency_s: Annotated[float, Field(ge=0.0, le=5.0)] = 0.11
    stamp: Literal["arrival", "measurement"] = "arrival"
    """what GPS_RAW_INT.time_usec says: when the autopilot parsed the fix (as ArduPilot), or when it was true"""
    first_fix_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 8.0
    undulation_m: Annotated[float, Field(ge=-110.0, le=90.0)] = 47.6
    """geoid above ellipsoid; EGM96 at 47 N 8 E"""
    hdop: Annotated[float, Field(gt=0.0, le=50.0)] = 0.8
    vdop: Annotated[float, Field(gt=0.0, le=50.0)] = 1.3
    satellites: Annotated[int, Field(ge=4, le=60)] = 14


class Fix(NamedTuple):
    """What the autopilot has from the receiver. Everything but the times is meaningless below fix type 3."""

    measured_us: int
    stamp_us: int
    fix_type: int
    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    altitude_ellipsoid_m: float
    north_mps: float
    east_mps: float
    horizontal_sd_m: float
    vertical_sd_m: float
    velocity_sd_mps: float
    satellites: int
    hdop_centi: int
    vdop_centi: int


class GnssReceiver:
    """`measure` at ``config.rate_hz``; `deliver` returns the fix whose latency has passed."""

    def __init__(self, config: GnssConfig, seed: int) -> None:
        seed = seed if config.seed is None else config.seed
        self.config = config
        self.period_us = 1_000_000 // config.rate_hz
        self._latency_us = round(config.latency_s * 1e6)
        self._first_fix_us = round(config.first_fix_s * 1e6)
        dt_s = 1.0 / config.rate_hz

        def wander(axis: str, sd_m: float) -> GaussMarkov:
            return GaussMarkov(sd_m, config.wander_time_s, dt_s, normals(seed, "gnss", axis, "wander"))

        self._wander_north = wander("north", config.horizontal_wander_sd_m)
        self._wander_east = wander("east", config.horizontal_wander_sd_m)
        self._wander_up = wander("up", config.height_wander_sd_m)
        self._white_north = normals(seed, "gnss", "north", "white")
        self._white_east = normals(seed, "gnss", "east", "white")
        self._white_up = normals(seed, "gnss", "up", "white")
        self._velocity = normals(seed, "gnss", "velocity")
        # One figure for a horizontal error, as receivers give it: the root of both axes' variances.
        self.horizontal_sd_m = math.hypot(config.horizontal_white_sd_m, config.horizontal_wander_sd_m) * math.sqrt(2.0)
        self.vertical_sd_m = math.hypot(config.height_white_sd_m, config.height_wander_sd_m)
        self._underway: deque[Fix] = deque()

    def measure(self, truth: Truth) -> None:
        """Take a fix of the truth; it arrives later. The error processes run before the first fix too."""
        config = self.config
        north_m = self._wander_north.step() + config.horizontal_white_sd_m * next(self._white_north)
        east_m = self._wander_east.step() + config.horizontal_white_sd_m * next(self._white_east)
        up_m = self._wander_up.step() + config.height_white_sd_m * next(self._white_up)
        north_mps = truth.north_mps + config.velocity_sd_mps * next(self._velocity)
        east_mps = truth.east_mps + config.velocity_sd_mps * next(self._velocity)
        arrival_us = truth.time_us + self._latency_us
        stamp_us = arrival_us if config.stamp == "arrival" else truth.time_us
        altitude_m = truth.altitude_amsl_m + up_m
        per_degree_m = _EARTH_M_PER_DEG * math.cos(math.radians(truth.latitude_deg))
        self._underway.append(
            Fix(
                truth.time_us,
                stamp_us,
                3 if truth.time_us >= self._first_fix_us else 1,
                truth.latitude_deg + north_m / _EARTH_M_PER_DEG,
                truth.longitude_deg + east_m / per_degree_m,
                altitude_m,
                altitude_m + config.undulation_m,
                north_mps,
                east_mps,
                self.horizontal_sd_m,
                self.vertical_sd_m,
                config.velocity_sd_mps,
                config.satellites,
                round(config.hdop * 100.0),
                round(config.vdop * 100.0),
            )
        )

    def deliver(self, time_us: int) -> Fix | None:
        """The newest fix that has arrived by now and was not delivered before."""
        fix = None
        while self._underway and self._underway[0].measured_us + self._latency_us <= time_us:
            fix = self._underway.popleft()
        return fix
