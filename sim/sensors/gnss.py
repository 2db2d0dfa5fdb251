"""A GNSS receiver: position with white and correlated errors, late, and blind until its first fix.

Defaults, and where they come from:

- height error 3 m white and 3 m Gauss-Markov over 300 s, 5 Hz, 0.11 s late: those of the recorded
  flights data/flights/jsbsim_*, so that results compare. The real receivers of data/real have less
  white noise (0.03-0.2 m over 1 s) and more wander (7-59 m in 2-10 minutes): the presets have that;
- horizontal error half of it: u-blox M8 data sheet (UBX-15031086), 2.5 m CEP, and vertical errors
  are about twice that;
- velocity 0.1 m/s: M8 data sheet, 0.05 m/s at 50 %, doubled for manoeuvres;
- latency: ArduPilot measured 0.05-0.25 s; its time stamp is the time of parsing, not of
  measurement.

The accuracies it reports are honest (the standard deviations of its own errors) unless told
otherwise: the receivers of data/real that wander by 7-59 m report 0.9-1.8.

Multipath near the ground is one more slow error, of height alone, that the receiver knows nothing
of: reflections come from below, and fade as the antenna climbs away from them. Its size, height and
time are assumed: metres, a building, half a minute.
"""

import math
from collections import deque
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from pydantic import Field

from companion.config import Settings
from sim.aircraft_state import Truth
from sim.constants import EARTH_M_PER_DEG
from sim.sensors import GaussMarkov, SensorConfig, normals

Metres = Annotated[float, Field(ge=0.0, le=1000.0)]


# [c] was found again in a copy of the data sheet, or with somebody who quotes it; the rest was not.
PRESETS: Mapping[str, Mapping[str, Any]] = {
    # u-blox, NEO-M8 data sheet UBX-15031086: 2.5 m CEP [c], which is 2.12 m an axis (CEP / 1.177),
    # height twice that, as the sheet has none; 0.05 m/s at 50 % [c], 0.042 m/s an axis for two and
    # 0.074 for one; 26 s from cold [c]. The white part is that of data/real; the latency is inside
    # the 0.05-0.25 s that ArduPilot measured.
    "u-blox M8": {
        "height_white_sd_m": 0.15, "height_wander_sd_m": 4.2, "horizontal_white_sd_m": 0.1,
        "horizontal_wander_sd_m": 2.1, "velocity_sd_mps": 0.05, "first_fix_s": 26.0,
        "latency_s": 0.15, "latency_jitter_s": 0.02,
    },
    # u-blox, ZED-F9P data sheet UBX-17051259: RTK 0.01 m + 1 ppm CEP [c], 0.0085 m an axis, and as
    # much in height at 50 % [c], 0.015 m, both on a baseline so short that the ppm do not count (1
    # mm a kilometre); 0.05 m/s [c]; 24 s from cold [c]. That the errors live for a minute is
    # assumed, and so is the latency.
    "F9P RTK": {
        "height_white_sd_m": 0.005, "height_wander_sd_m": 0.015, "horizontal_white_sd_m": 0.004,
        "horizontal_wander_sd_m": 0.0085, "wander_time_s": 60.0, "velocity_sd_mps": 0.05,
        "first_fix_s": 24.0, "latency_s": 0.15, "latency_jitter_s": 0.03, "hdop": 0.6, "vdop": 1.0,
        "satellites": 24, "fix": 6,
    },
    # data/real: 7-59 m of wander in 2-10 minutes, 0.03-0.2 m over 1 s, reported accuracy about 1 m
    # all the time.
    "cheap": {
        "height_white_sd_m": 0.2, "height_wander_sd_m": 12.0, "wander_time_s": 200.0,
        "horizontal_white_sd_m": 0.1, "horizontal_wander_sd_m": 5.0, "velocity_sd_mps": 0.2,
        "first_fix_s": 45.0, "latency_s": 0.25, "latency_jitter_s": 0.05, "accuracy": "stuck",
        "stuck_accuracy_m": 1.2, "satellites": 9, "hdop": 1.1, "vdop": 1.6, "multipath_sd_m": 6.0,
    },
    # ArduPilot's SITL, defaults of SIM_GPS1_* (SIM_GPS.cpp) and what its u-blox reports: no error
    # at all (NOISE, VERR, DRFTALT 0), reported accuracy 0.3 m (ACC), 100 ms (LAG_MS), 5 Hz, ten
    # satellites, an RTK fix, HDOP 1.21, VDOP 2.00, one height for sea level and ellipsoid.
    "ArduPilot SITL": {
        "height_white_sd_m": 0.0, "height_wander_sd_m": 0.0, "horizontal_white_sd_m": 0.0,
        "horizontal_wander_sd_m": 0.0, "velocity_sd_mps": 0.0, "first_fix_s": 1.0,
        "latency_s": 0.1, "accuracy": "stuck", "stuck_accuracy_m": 0.3, "satellites": 10,
        "hdop": 1.21, "vdop": 2.0, "fix": 6, "undulation_m": 0.0,
    },
}  # fmt: skip


TYPE_SD_M: Mapping[int, tuple[float, float]] = {3: (0.15, 4.2), 4: (0.15, 1.2), 5: (0.05, 0.3)}
"""White and slow height error of a receiver that has fallen to a lower fix type: single fixes as
the preset u-blox M8; DGPS and RTK float are assumed, decimetres for an ambiguity that is not fixed.
At its own type a receiver has its own errors."""


class FixChange(Settings):
    """A change of the receiver's fix type, with the accuracy that belongs to the type."""

    time_s: Annotated[float, Field(ge=0.0, le=200_000.0)]
    """time of the change since boot"""
    fix: Literal[3, 4, 5, 6]
    """MAVLink's fix type from then on"""


class GnssConfig(SensorConfig):
    """Noise parameters of the receiver."""

    PRESETS: ClassVar = PRESETS

    rate_hz: Literal[1, 2, 5, 10, 25] = 5
    """fixes a second"""
    height_white_sd_m: Metres = 3.0
    """standard deviation of the white height error of a fix"""
    height_wander_sd_m: Metres = 3.0
    """standard deviation of the slow height error, a first-order Gauss-Markov process"""
    horizontal_white_sd_m: Metres = 1.0
    """standard deviation of the white error of a fix to the north, and to the east"""
    horizontal_wander_sd_m: Metres = 1.5
    """standard deviation of the slow error to the north, and to the east"""
    wander_time_s: Annotated[float, Field(gt=0.0, le=1e5)] = 300.0
    """correlation time of the slow errors"""
    velocity_sd_mps: Annotated[float, Field(ge=0.0, le=100.0)] = 0.1
    """standard deviation of the velocity of each axis; the receiver reports it as its accuracy"""
    latency_s: Annotated[float, Field(ge=0.0, le=5.0)] = 0.11
    """latency of a fix, from its time of validity to its arrival at the autopilot"""
    latency_jitter_s: Annotated[float, Field(ge=0.0, le=5.0)] = 0.0
    """standard deviation of a normal number whose magnitude is added to the latency"""
    stamp: Literal["arrival", "measurement"] = "arrival"
    """meaning of GPS_RAW_INT.time_usec: when the autopilot parsed the fix (as ArduPilot), or when
    it was true"""
    first_fix_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 8.0
    """time from boot to the first fix"""
    fix: Literal[3, 4, 5, 6] = 3
    """MAVLink's fix type: 3 is 3D, 4 DGPS, 5 RTK float, 6 RTK fixed"""
    fix_changes: tuple[FixChange, ...] = ()
    """changes of the fix type during the flight, such as an RTK receiver that loses its base"""
    undulation_m: Annotated[float, Field(ge=-110.0, le=90.0)] = 47.6
    """height of the geoid above the ellipsoid; default: EGM96 at 47 N 8 E; 0 as in ArduPilot SITL,
    which has no geoid and sends one height in both fields"""
    hdop: Annotated[float, Field(gt=0.0, le=50.0)] = 0.8
    """reported horizontal dilution of precision (eph)"""
    vdop: Annotated[float, Field(gt=0.0, le=50.0)] = 1.3
    """reported vertical dilution of precision (epv)"""
    satellites: Annotated[int, Field(ge=4, le=60)] = 14
    """reported number of satellites"""
    accuracy: Literal["honest", "optimistic", "stuck"] = "honest"
    """reported accuracy (h_acc, v_acc): the errors' standard deviations, a part of them, or
    constant"""
    optimism: Annotated[float, Field(gt=0.0, le=1.0)] = 0.3
    """share of the errors' standard deviations that an optimistic receiver reports"""
    stuck_accuracy_m: Metres = 1.0
    """constant h_acc and v_acc of a receiver with `accuracy: stuck`"""
    multipath_sd_m: Metres = 0.0
    """standard deviation of the height error by multipath on the ground"""
    multipath_height_m: Annotated[float, Field(gt=0.0, le=1000.0)] = 30.0
    """height of the multipath error's decay to 1/e"""
    multipath_time_s: Annotated[float, Field(gt=0.0, le=1e4)] = 30.0
    """correlation time of the multipath error"""


class Fix(NamedTuple):
    """A fix as the autopilot receives it. Everything but the times is meaningless below fix
    type 3."""

    measured_us: int
    stamp_us: int
    fix_type: int
    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    altitude_ellipsoid_m: float
    north_mps: float
    east_mps: float
    climb_mps: float
    """GPS_RAW_INT has none; logs of the autopilot's own have"""
    horizontal_sd_m: float
    vertical_sd_m: float
    velocity_sd_mps: float
    satellites: int
    hdop_centi: int
    vdop_centi: int


class GnssReceiver:
    """`measure` at ``config.rate_hz``; `deliver` returns the fix whose latency has passed.

    `ground_m` is the height of the ground that reflects.
    """

    def __init__(self, config: GnssConfig, seed: int, ground_m: float = 0.0) -> None:
        seed = seed if config.seed is None else config.seed
        self.config = config
        self.period_us = 1_000_000 // config.rate_hz
        self._latency_us = round(config.latency_s * 1e6)
        self._first_fix_us = round(config.first_fix_s * 1e6)
        self._ground_m = ground_m
        dt_s = 1.0 / config.rate_hz

        def wander(axis: str, sd_m: float) -> GaussMarkov:
            return GaussMarkov(
                sd_m, config.wander_time_s, dt_s, normals(seed, "gnss", axis, "wander")
            )

        self._wander_north = wander("north", config.horizontal_wander_sd_m)
        self._wander_east = wander("east", config.horizontal_wander_sd_m)
        self._wander_up = wander("up", config.height_wander_sd_m)
        self._white_north = normals(seed, "gnss", "north", "white")
        self._white_east = normals(seed, "gnss", "east", "white")
        self._white_up = normals(seed, "gnss", "up", "white")
        self._velocity = normals(seed, "gnss", "velocity")
        self._climb = normals(seed, "gnss", "climb")
        self._jitter = normals(seed, "gnss", "jitter")
        self._multipath = GaussMarkov(
            config.multipath_sd_m, config.multipath_time_s, dt_s, normals(seed, "gnss", "multipath")
        )
        # One figure for a horizontal error, as receivers give it: the root of both axes' variances.
        self.horizontal_sd_m = math.hypot(
            config.horizontal_white_sd_m, config.horizontal_wander_sd_m
        ) * math.sqrt(2.0)
        self.vertical_sd_m = math.hypot(config.height_white_sd_m, config.height_wander_sd_m)
        if config.accuracy == "optimistic":
            self.horizontal_sd_m *= config.optimism
            self.vertical_sd_m *= config.optimism
        elif config.accuracy == "stuck":
            self.horizontal_sd_m = self.vertical_sd_m = config.stuck_accuracy_m
        self._dop_centi = round(config.hdop * 100.0), round(config.vdop * 100.0)
        self._fallen: dict[int, GaussMarkov] = {
            change.fix: wander(f"type {change.fix}", TYPE_SD_M[change.fix][1])
            for change in config.fix_changes
            if change.fix in TYPE_SD_M and change.fix != config.fix
        }
        self._underway: deque[tuple[int, Fix]] = deque()
        """fixes that have not arrived yet, by time of arrival"""
        self.arrives_us: float = math.inf
        """when the next fix arrives"""
        self._last_arrival_us = 0

    def measure(self, truth: Truth) -> None:
        """Take a fix of the truth; it arrives later. The error processes run before the first fix
        too."""
        config = self.config
        north_m = self._wander_north.step() + config.horizontal_white_sd_m * next(self._white_north)
        east_m = self._wander_east.step() + config.horizontal_white_sd_m * next(self._white_east)
        up_m = self._wander_up.step() + config.height_white_sd_m * next(self._white_up)
        if config.multipath_sd_m:
            height_m = max(0.0, truth.altitude_amsl_m - self._ground_m)
            up_m += self._multipath.step() * math.exp(-height_m / config.multipath_height_m)
        fix_type, fallen_m, vertical_sd_m = self._fallen_to(truth.time_us)
        up_m += fallen_m
        north_mps = truth.north_mps + config.velocity_sd_mps * next(self._velocity)
        east_mps = truth.east_mps + config.velocity_sd_mps * next(self._velocity)
        arrival_us = self._arrival_us(truth.time_us)
        stamp_us = arrival_us if config.stamp == "arrival" else truth.time_us
        altitude_m = truth.altitude_amsl_m + up_m
        per_degree_m = EARTH_M_PER_DEG * math.cos(math.radians(truth.latitude_deg))
        fix = Fix(
            truth.time_us,
            stamp_us,
            fix_type if truth.time_us >= self._first_fix_us else 1,
            truth.latitude_deg + north_m / EARTH_M_PER_DEG,
            truth.longitude_deg + east_m / per_degree_m,
            altitude_m,
            altitude_m + config.undulation_m,
            north_mps,
            east_mps,
            config.velocity_sd_mps * next(self._climb) - truth.down_mps,
            self.horizontal_sd_m,
            vertical_sd_m,
            config.velocity_sd_mps,
            config.satellites,
            *self._dop_centi,
        )
        self._underway.append((arrival_us, fix))
        self.arrives_us = self._underway[0][0]

    def _fallen_to(self, time_us: int) -> tuple[int, float, float]:
        """Fix type, further height error and reported accuracy at a time."""
        config, fix_type = self.config, self.config.fix
        if not config.fix_changes:
            return fix_type, 0.0, self.vertical_sd_m
        for change in config.fix_changes:
            fix_type = change.fix if time_us >= change.time_s * 1e6 else fix_type
        errors_m = {fix: wander.step() for fix, wander in self._fallen.items()}
        if fix_type not in errors_m:
            return fix_type, 0.0, self.vertical_sd_m
        white_m, slow_m = TYPE_SD_M[fix_type]
        error_m = errors_m[fix_type] + white_m * next(self._white_up)
        return fix_type, error_m, math.hypot(white_m, slow_m)

    def _arrival_us(self, measured_us: int) -> int:
        """Later ones do not overtake: they come out of one serial line."""
        arrival_us = measured_us + self._latency_us
        if self.config.latency_jitter_s:
            arrival_us += round(abs(self.config.latency_jitter_s * next(self._jitter)) * 1e6)
            arrival_us = max(arrival_us, self._last_arrival_us + 1)
            self._last_arrival_us = arrival_us
        return arrival_us

    def deliver(self, time_us: int) -> Fix | None:
        """The newest fix that has arrived by now and was not delivered before."""
        fix = None
        while self._underway and self._underway[0][0] <= time_us:
            _, fix = self._underway.popleft()
        self.arrives_us = self._underway[0][0] if self._underway else math.inf
        return fix
