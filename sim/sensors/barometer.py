"""A MEMS barometer on a static port.

Defaults, and where they come from:

- white noise 2.4 Pa (0.2 m): MS5611-01BA03 data sheet, resolution 1.2 Pa RMS at OSR 4096 and 2.7 Pa
  at OSR 1024;
- slow wander 5 Pa over 300 s: quiet real barometers of data/real show 0.05-0.13 m over 1 s, and
  metres over ten minutes, of which the weather is simulated separately;
- turn-on bias sd 50 Pa: MS5611, accuracy +-150 Pa at 25 C and 750 hPa, read as three sigma;
- lag 0.1 s: pneumatic lag of a short static line (0.05-0.2 s);
- die 20 K above the air once warm, after minutes: measured boards run 10-30 K above (data/real: 26
  to 38 C).

The rest is off unless asked for:

- thermal drift: data/real, +1.5 Pa/K (a board from 26 to 38 C fell 1.5 m) and -1.8 Pa/K (37.8 to
  43.8 C rose 0.9 m), so its sign is the specimen's; BMP388 and DPS310 data sheets +-0.75 and 0.5
  Pa/K;
- static port error in parts of the dynamic pressure: 14 CFR 23.1325(e) allows 30 ft at 100 kt,
  which is 0.068;
- suction of a sideslip, in parts of the dynamic pressure times sin^2: a flush port on one side of a
  cylinder feels 1 - 4 sin^2 at its flank (potential flow), two joined ports on both sides about a
  tenth of that;
- ground effect: near the ground the wing's lift raises the pressure under it, in parts of the
  dynamic pressure, dying out over half a span;
- lift: once the wing carries, the flow around the airframe changes the pressure at the port; real
  light aircraft read 10-13 m low in flight at three of four (reference measurements of G1000 logs
  against SBAS), beside the error by dynamic pressure;
- drift: weather and warm-up that nobody simulates; the residual of real flights drifts by
  0.001-0.003 m/s over 1800 s, and walks by 0.02 m/sqrt(s);
- stamp jitter: a bus or a logger stamps a reading late, by up to 0.3 s at an avionics unit;
- thrust: the slipstream of propellers changes the pressure where the barometer sits, in proportion
  to the throttle; calibrations of multirotors in public logs are -40 to -200 Pa at full throttle;
- acceleration: the membrane's own weight. No data sheet of the presets tells it: turn the board
  over and halve the change.
"""

import math
from collections import deque
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from pydantic import Field

from sim.aircraft_state import Flow
from sim.sensors import GaussMarkov, SensorConfig, normals, uniforms

NonNegative = Annotated[float, Field(ge=0.0, le=10_000.0)]
Positive = Annotated[float, Field(gt=0.0, le=1e6)]
Coefficient = Annotated[float, Field(ge=-2.0, le=2.0)]

REFERENCE_K = 298.15
"""die temperature of the manufacturer's calibration: no thermal error there"""

# A limit of a data sheet (min, max) is read as three standard deviations, a typical value as one.
# [c] was found again in a copy of the sheet, or with somebody who quotes it; the rest is as its
# first reader noted it. No sheet tells how an error wanders in minutes: wander_sd_pa is assumed
# throughout.
PRESETS: Mapping[str, Mapping[str, Any]] = {
    # TE Connectivity, MS5611-01BA03 data sheet, "Performance specifications": 0.027 mbar RMS at
    # oversampling 1024, ArduPilot's [c]; +-1.5 mbar at 25 C and 750 mbar [c], +-2.5 mbar from -20
    # to 85 C [c], which leaves 100 Pa over 60 K, 0.6 Pa/K; but real boards (above) have 1.5-1.8,
    # and that counts here. Output in 0.01 mbar.
    "MS5611": {"white_sd_pa": 2.7, "bias_sd_pa": 50.0, "quantum_pa": 1.0,
               "thermal_sd_pa_per_k": 1.6},
    # Bosch, BST-BMP388-DS001 rev. 1.7: 0.9 Pa RMS at oversampling 8 and filter coefficient 3 (table
    # 8) [c]; that filter's delay, 3 samples at 50 Hz, is in the lag; +-50 Pa absolute, typical [c];
    # +-0.75 Pa/K, typical (table 2) [c]; 0.016 Pa resolution [c].
    "BMP388": {
        "white_sd_pa": 0.9, "bias_sd_pa": 50.0, "quantum_pa": 0.016, "thermal_sd_pa_per_k": 0.75,
        "lag_s": 0.16, "wander_sd_pa": 2.0,
    },
    # Infineon, DPS310 data sheet v1.2: 0.35 Pa RMS at oversampling 16 (table 16) [c], which
    # ArduPilot's driver sets; +-1 hPa absolute [c]; 0.5 Pa/K [c]; 0.06 Pa resolution.
    "DPS310": {
        "white_sd_pa": 0.35, "bias_sd_pa": 33.0, "quantum_pa": 0.06, "thermal_sd_pa_per_k": 0.5,
        "wander_sd_pa": 2.0,
    },
    # Measured on four light aircraft with avionics barometers against SBAS heights, in warm air:
    # the port reads high by 0.09-0.17 of the dynamic pressure, low by 10 m once the wing carries,
    # late by 0.5-1.2 s; drift 0.002 m/s over 1800 s and 0.02 m/sqrt(s) (12 Pa/m); fast error
    # 0.5-1 m over 60 s; white 0.1-0.3 m; stamps up to 0.3 s late. Ground effect and
    # warm-up are assumed.
    "real light aircraft": {
        "static_port": 0.13, "static_port_sd": 0.03, "lift_pa": 120.0, "lag_s": 1.0,
        "drift_sd_pa_per_s": 0.024, "walk_pa_rts": 0.24, "wander_sd_pa": 9.0, "wander_time_s": 60.0,
        "white_sd_pa": 2.4, "stamp_jitter_s": 0.3, "bias_sd_pa": 30.0, "ground_effect_sd": 0.05,
        "thermal_sd_pa_per_k": 0.3, "warming_time_s": 600.0,
    },
    # A MEMS part inside a small fuselage without a static port: the same drift and port error, with
    # either sign (propwash moves it by 4-7 m), a lag of 0.1 s, warm-up of 1-4 m (1.6 Pa/K,
    # data/real).
    "real small UAV": {
        "static_port": 0.0, "static_port_sd": 0.13, "lag_s": 0.1, "drift_sd_pa_per_s": 0.024,
        "walk_pa_rts": 0.24, "wander_sd_pa": 9.0, "wander_time_s": 60.0, "white_sd_pa": 2.4,
        "stamp_jitter_s": 0.05, "bias_sd_pa": 50.0, "ground_effect_sd": 0.1,
        "ground_effect_height_m": 2.0, "thermal_sd_pa_per_k": 1.6, "warming_time_s": 300.0,
    },
    # ArduPilot's SITL, defaults of SIM_BARO_* (AP_Baro_SITL.cpp): uniform within 0.2 m (RND), which
    # is 1.4 Pa, and no other error; the die warms by 20 K in 30 s (SIM_TEMP_BRD_OFF, _TCONST).
    "ArduPilot SITL": {
        "white_sd_pa": 1.4, "wander_sd_pa": 0.0, "bias_sd_pa": 0.0, "lag_s": 0.0,
        "warming_time_s": 30.0,
    },
}  # fmt: skip
LIFT_OFF_PA = 480.0
"""dynamic pressure at 28 m/s, at which a light aircraft's wing carries it"""
DRIFT_TIME_S = 1800.0


class BarometerConfig(SensorConfig):
    """Noise parameters of the barometer."""

    PRESETS: ClassVar = PRESETS

    rate_hz: Literal[1, 2, 4, 5, 10, 20, 25, 50] | None = None
    """new readings a second; left out, those of the autopilot: ArduPilot 10, others 20.
    Asked for more, PX4 waits for the next reading, and others repeat the last"""
    white_sd_pa: NonNegative = 2.4
    """standard deviation of the white noise of a reading"""
    wander_sd_pa: NonNegative = 5.0
    """standard deviation of the slow error, a first-order Gauss-Markov process"""
    wander_time_s: Positive = 300.0
    """correlation time of the slow error"""
    bias_pa: Annotated[float, Field(ge=-60_000.0, le=60_000.0)] = 0.0
    """constant error of every device"""
    bias_sd_pa: NonNegative = 50.0
    """standard deviation of the constant error between devices: one number a seed"""
    lag_s: Annotated[float, Field(ge=0.0, le=10.0)] = 0.1
    """time constant of the static line and the filter"""
    warming_k: Annotated[float, Field(ge=-50.0, le=60.0)] = 20.0
    """final temperature of the die above the air"""
    warming_time_s: Positive = 120.0
    """time constant of the die's warming from boot on"""
    thermal_pa_per_k: Annotated[float, Field(ge=-100.0, le=100.0)] = 0.0
    """error for each kelvin of the die above 25 C"""
    thermal_sd_pa_per_k: NonNegative = 0.0
    """standard deviation of `thermal_pa_per_k` between devices"""
    quantum_pa: NonNegative = 0.0
    """resolution of a reading"""
    static_port: Coefficient = 0.0
    """error in parts of the dynamic pressure; positive reads low in flight"""
    static_port_sd: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """standard deviation of `static_port` between devices"""
    lift_pa: Annotated[float, Field(ge=-1000.0, le=1000.0)] = 0.0
    """pressure rise at the port once the wing carries (480 Pa of dynamic pressure), in proportion
    below"""
    thrust_pa: Annotated[float, Field(ge=-1000.0, le=1000.0)] = 0.0
    """pressure rise at the port at full throttle, in proportion to the throttle"""
    drift_sd_pa_per_s: NonNegative = 0.0
    """standard deviation of the drift rate, a first-order Gauss-Markov process over 1800 s"""
    walk_pa_rts: NonNegative = 0.0
    """random walk of the error, Pa per square root of a second"""
    stamp_jitter_s: Annotated[float, Field(ge=0.0, le=2.0)] = 0.0
    """largest age of a reading at its time stamp, uniformly distributed"""
    sideslip: Coefficient = 0.0
    """suction in parts of the dynamic pressure times the squared sine of the sideslip"""
    ground_effect: Coefficient = 0.0
    """pressure rise at the ground in parts of the dynamic pressure"""
    ground_effect_sd: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """standard deviation of `ground_effect` between devices; either sign occurs"""
    ground_effect_height_m: Positive = 5.0
    """height of the ground effect's decay to 1/e"""
    acceleration_pa_per_g: Annotated[float, Field(ge=-1000.0, le=1000.0)] = 0.0
    """error for each g above the one at rest"""

    @property
    def has_drift(self) -> bool:
        """Whether the error drifts beyond its slow wander."""
        return self.drift_sd_pa_per_s > 0.0 or self.walk_pa_rts > 0.0


class Pressure(NamedTuple):
    """One reading."""

    time_us: int
    pressure_pa: float
    die_temperature_k: float


class Barometer:
    """Samples the static pressure at ``config.rate_hz``, or `usual_hz` where the configuration
    leaves that open."""

    def __init__(
        self, config: BarometerConfig, seed: int, usual_hz: int = 20, name: str = "barometer"
    ) -> None:
        """`name` keys its random streams."""
        seed = seed if config.seed is None else config.seed
        self.config = config
        rate_hz = config.rate_hz or usual_hz
        self.period_us = 1_000_000 // rate_hz
        dt_s = 1.0 / rate_hz
        self._white: Iterator[float] = normals(seed, name, "white")
        self._wander = GaussMarkov(
            config.wander_sd_pa, config.wander_time_s, dt_s, normals(seed, name, "wander")
        )
        self.bias_pa = config.bias_pa + config.bias_sd_pa * next(normals(seed, name, "bias"))
        self.thermal_pa_per_k = config.thermal_pa_per_k
        if config.thermal_sd_pa_per_k:
            self.thermal_pa_per_k += config.thermal_sd_pa_per_k * next(
                normals(seed, name, "thermal")
            )
        self.static_port = config.static_port + _specimen(config.static_port_sd, seed, name, "port")
        self.ground_effect = config.ground_effect + _specimen(
            config.ground_effect_sd, seed, name, "ground effect"
        )
        self._slow = _Drift(config, dt_s, seed, name) if config.has_drift else None
        self._late = _StampJitter(config.stamp_jitter_s, dt_s, seed, name)
        self._follow = 1.0 - math.exp(-dt_s / config.lag_s) if config.lag_s else 1.0
        self._port_pa: float | None = None
        self.feels_flow = any(
            (
                self.static_port,
                config.lift_pa,
                config.thrust_pa,
                config.sideslip,
                self.ground_effect,
                config.acceleration_pa_per_g,
            )
        )
        """whether `measure` wants to know the flow"""

    def measure(
        self, time_us: int, pressure_pa: float, temperature_k: float, flow: Flow | None = None
    ) -> Pressure:
        """The reading of the true static pressure and air temperature. Call it every
        `period_us`."""
        config = self.config
        error_pa = 0.0
        if flow is not None:
            pressure_pa += self.port_error_pa(flow)
            error_pa = config.acceleration_pa_per_g * (flow.load - 1.0)
        if self._port_pa is None:
            self._port_pa = pressure_pa
        self._port_pa += self._follow * (pressure_pa - self._port_pa)
        stamped_pa = self._late.reading_pa(self._port_pa)
        error_pa += self.bias_pa + self._wander.step() + config.white_sd_pa * next(self._white)
        warm = 1.0 - math.exp(-time_us * 1e-6 / config.warming_time_s)
        die_k = temperature_k + config.warming_k * warm
        if self.thermal_pa_per_k:
            error_pa += self.thermal_pa_per_k * (die_k - REFERENCE_K)
        if self._slow is not None:
            error_pa += self._slow.step()
        reading_pa = stamped_pa + error_pa
        if config.quantum_pa:
            reading_pa = round(reading_pa / config.quantum_pa) * config.quantum_pa
        return Pressure(time_us, reading_pa, die_k)

    def port_error_pa(self, flow: Flow) -> float:
        """What the flow adds to the static pressure at the port."""
        config = self.config
        ground = self.ground_effect * math.exp(
            -max(0.0, flow.height_m) / config.ground_effect_height_m
        )
        slip = config.sideslip * math.sin(flow.sideslip_rad) ** 2
        lift_pa = config.lift_pa * min(1.0, flow.dynamic_pressure_pa / LIFT_OFF_PA)
        flow_pa = flow.dynamic_pressure_pa * (ground - self.static_port - slip)
        return lift_pa + config.thrust_pa * max(0.0, flow.throttle) + flow_pa


def _specimen(sd: float, seed: int, name: str, term: str) -> float:
    """What makes a device differ from others of its kind: one number a seed."""
    return sd * next(normals(seed, name, term)) if sd else 0.0


class _Drift:
    """Error whose rate is a first-order Gauss-Markov process, and a random walk."""

    def __init__(self, config: BarometerConfig, dt_s: float, seed: int, name: str) -> None:
        self._dt_s = dt_s
        noise = normals(seed, name, "drift rate")
        self._rate = GaussMarkov(config.drift_sd_pa_per_s, DRIFT_TIME_S, dt_s, noise)
        self._walk_pa = config.walk_pa_rts * math.sqrt(dt_s)
        self._steps = normals(seed, name, "walk")
        self._error_pa = 0.0

    def step(self) -> float:
        """Advance by one reading; the error, Pa."""
        self._error_pa += self._rate.step() * self._dt_s + self._walk_pa * next(self._steps)
        return self._error_pa


class _StampJitter:
    """Readings that are older than their stamps say, by a random time up to `largest_s`."""

    def __init__(self, largest_s: float, dt_s: float, seed: int, name: str) -> None:
        self._largest_s, self._dt_s = largest_s, dt_s
        self._uniform = uniforms(seed, name, "stamps") if largest_s else None
        self._past: deque[float] = deque(maxlen=math.ceil(largest_s / dt_s) + 2)

    def reading_pa(self, port_pa: float) -> float:
        """The pressure that is told when that at the port is `port_pa` now."""
        if self._uniform is None:
            return port_pa
        self._past.appendleft(port_pa)
        steps = next(self._uniform) * self._largest_s / self._dt_s
        newer = min(int(steps), len(self._past) - 1)
        older = min(newer + 1, len(self._past) - 1)
        share = steps - int(steps)
        return self._past[newer] + share * (self._past[older] - self._past[newer])
