"""Barometer compensated for bias and scale factor from GNSS height and air temperature.

I-H. Whang, W-S. Ra, "Simple Altitude Estimator using Air-Data and GPS Measurements", IFAC World
Congress 2008. The paper's letters:

==================  =========================  ========================================================================
h^B                 ``baro``                   height of the standard atmosphere at the measured pressure (1)
h^GPS               ``fix_m``                  GNSS height
a, b                ``error``                  scale-factor and bias error, h^B - h = a (h - H_0) + b (2)
P^a, P^b            ``P_error``                their covariance; diagonal with ``covariance: marginal``
lambda              `scale_of_temperature`     pseudo measurement of a from temperature (6)
z, R                `z_innovation`             h^B - h^GPS (10), its variance R^B + R^GPS
x, P                ``motion``, ``P_motion``   height and climb of the alpha-beta filter (33), (34)
h^c                 `compensate`               compensated barometer height (32)
Gamma               ``L0_KPM``                 lapse rate of the standard atmosphere
H_0, T_0            ``H_0``, ``T_0``           reference height, and the standard temperature there
==================  =========================  ========================================================================

A cycle is one barometer sample: predict height and climb (33), add Q^a and Q^b (17), (18),
lambda-update (20)-(22) with the predicted height, z-update (25)-(31) when a fix has come,
compensate (32), correct height and climb. The paper's Gaussian-approximation z-update is that of a
Kalman filter for [a, b] whose correlation is dropped afterwards (shown in
tests/oracles/test_air_data_gnss.py), so one `kalman.correct` serves both the paper's filter and the
joint one.

Errata
------
(2)-(4), (6): a = T_0/T_0' - 1, so lambda has a minus; as printed, +15 K puts 1600 m at 1450 m. (7) divides by T_0^2,
and the spread of the lapse rate is K/m. z^a and S^a of (23) divide by h^GPS and are not formed. The regressor of (10)
is the predicted height above H_0, not h^GPS. 1 + a is held at .5 or above.

Departures
----------
- H_0 and T_0 are not latched at launch, since no first fix can be trusted: they are those of the
  standard atmosphere, and h^B is its full column in geometric metres. For a constant lapse rate its
  error is exactly affine in height.
- Q^a, Q^b, Q^h grow with time, so that every sample rate means the same; the paper's are for steps
  of 0.2 s.
- A fix meets the barometer height of its own time; one that is newer than the barometer waits for
  the next sample.
- A temperature is trusted when it is a sample of AIR. That of SCALED_PRESSURE is the sensor die's,
  10-30 K above the air, and unused by default; ``temperature: die`` subtracts ``die_offset_k``,
  with a spread to match.
- Preset ``tuned``: slow walks (b by 3 m in 200 s), the joint covariance, lambda = T_0/T_0' - 1
  without linearising, temperatures that are news only once a minute (the lapse rate's error changes
  no sooner), and the height moves with a new correction instead of filtering it, since a new b is
  no climb. Innovations beyond 3 sigma (barometer: 5) lose weight. When they last (10 s; barometer:
  1/4 s) the barometer has jumped, or a and b are wrong, and are learned anew.
- Without a barometer for three seconds the alpha-beta filter follows GNSS heights.
- ``altitude_sd_m`` is not the paper's P, whose Q^b means 45 m a second. It is the covariance of the
  correction after the last fix, grown as weather moves it, plus the barometer's noise and the half
  of the GNSS variance that is correlated over minutes and does not average out.

It uses no IMU.

Breaks when
-----------
GNSS wanders for minutes: it is taken for white, so b follows it. A barometer freezes in a climb: that looks like a = -1
until the fixes have contradicted it for long. Temperature above 11 km is not used, (5) ends there. With the paper's Q^b
the output is noisier than the barometer: 38 m rms from 70 m GPS, where the raw barometer has 6 m.
"""

import math
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from companion.config import Settings
from companion.estimators.judging import (
    AIR,
    GATED,
    GNSS,
    HIGHEST_AIR_K,
    IGNORED,
    INVALID,
    LOWEST_AIR_K,
    PRESSURE,
    STALE,
    STATUS,
    USED,
    forget,
    is_stale,
    judge_gnss,
    judge_pressure,
    place,
    reset,
    state_dtype,
    tally,
)
from companion.estimators.method import Method
from companion.jit import step
from companion.kernels.atmosphere import L0_KPM, T0_K, baro_altitude_m
from companion.kernels.gnss import gnss_sd_m
from companion.kernels.kalman import Array, correct, inflated, spread
from companion.kernels.ring import at, clear, push, ring_fields
from companion.samples import Kind, Rows, Tables, readable, rows

LOWEST_PA, HIGHEST_PA = 1_000.0, 120_000.0
TROPOPAUSE_M = 11_000.0
SILENCE_US = 3_000_000
AIR_REACH_US = 10_000_000
"""A temperature older than this no longer belongs to the height of the next pressure."""
RING_SIZE = 128  # the delay horizon of a second and more, at 100 Hz
LOWEST_A = -0.5
P_H0_M2, P_V0_M2PS2 = 100.0, 144.0
"""Of height and climb at the start, section 3."""
R_GAMMA_K2PM2 = 0.003**2
"""Variance of the lapse rate, section 3, K2/m2."""
GNSS_GATE, BARO_GATE = 3.0, 5.0
GNSS_PATIENCE_US, BARO_PATIENCE_US = 10_000_000, 250_000
"""How long innovations must lie beyond the gate on one side before they are believed."""
WEATHER_M2PS = 0.05
"""How weather moves the correction while there is no fix: 3 m in 200 s, 13 m in an hour."""
CORRELATED_SHARE = 0.5
"""Of the variance of a GNSS height: what ionosphere, orbits and multipath keep for minutes."""

EXACT, LINEAR, PRINTED = 0, 1, 2
LAWS = {"exact": EXACT, "linear": LINEAR, "printed": PRINTED}

STATE = state_dtype(
    ("error", "f8", (2,)),  # a, b
    ("P_error", "f8", (2, 2)),
    ("error_us", "i8"),  # until when Q^a and Q^b have been added
    ("P_settled", "f8", (2, 2)),  # P_error after the last fix, before its correlation is dropped
    ("settled_us", "i8"),
    ("motion", "f8", (2,)),  # height, climb; NaN before the first
    ("P_motion", "f8", (2, 2)),
    ("motion_us", "i8"),
    ("gnss_alone", "i8"),
    ("H", "f8", (2,)),
    ("K", "f8", (2,)),
    *ring_fields("baro", RING_SIZE),  # h^B of the last second or so
    ("baro_m", "f8"),  # the newest of them
    ("temperature_k", "f8"),  # waits for the next pressure
    ("lambda_us", "i8"),  # of the last lambda-update
    ("fix_us", "i8"),  # a fix that waits for the next pressure, -1 none
    ("fix_m", "f8"),
    ("fix_var_m2", "f8"),  # R^GPS of the last fix
    ("wander_m2", "f8"),  # what of the claimed variance does not average out
    ("innovation_m", "f8"),
    ("since_us", "i8"),  # the first fix: how long the barometer has been awaited
    ("gnss_run", "i8", (2,)),  # side of the gate (0 inside) and since when
    ("baro_run", "i8", (2,)),
    ("jump_m", "f8"),  # innovation with which baro_run began
)

PARAMS = np.dtype(
    [
        ("use_air", "i8"),
        ("use_die", "i8"),
        ("law", "i8"),
        ("regress_gnss", "i8"),
        ("joint", "i8"),
        ("carried", "i8"),
        ("gnss_gate", "f8"),  # inf: no gate
        ("baro_gate", "f8"),
        ("H_0", "f8"),
        ("T_0", "f8"),
        ("Q_a", "f8"),  # per second
        ("Q_b", "f8"),
        ("Q_h", "f8"),
        ("tau", "f8"),
        ("P_a0", "f8"),
        ("P_b0", "f8"),
        ("R_B", "f8"),
        ("R_GPS", "f8"),  # NaN: as the receiver claims
        ("gnss_sd_floor_m", "f8"),
        ("gnss_sd_unknown_m", "f8"),
        ("R_T", "f8"),
        ("temperature_time_s", "f8"),
        ("die_offset_k", "f8"),
        ("R_die", "f8"),
    ],
    align=True,
)

PAPER: dict[str, Any] = {
    "temperature_law": "linear",
    "covariance": "marginal",
    "correction": "filtered",
    "outliers": "kept",
    "scale_walk_per_second": 2e-5 / 0.2,
    "bias_walk_m2ps": 400.0 / 0.2,
    "climb_walk_m2ps3": 39.69 / 0.2,
    "scale_sd": 0.2,
    "bias_sd_m": 20.0,
    "baro_variance_m2": 25.0,
    "gnss_variance_m2": 4900.0,
    "temperature_time_s": 0.0,
}
"""Where section 3 of the paper differs from the defaults, which are the preset ``tuned``."""


class AirDataGnssSettings(Settings):
    """Section ``estimators.air-data-gnss``. The defaults are the preset ``tuned``; a key that is
    given overrides it."""

    preset: Literal["tuned", "paper"] = "tuned"
    """defaults of the other keys: physical ones, or those of the paper's simulation"""
    temperature: Literal["air", "die", "none"] = "air"
    """air: only a thermometer in the air is trusted; die: else the barometer's own, which is 10-30
    K too warm"""
    temperature_law: Literal["exact", "linear", "printed"] = "exact"
    """scale factor of a temperature: T0/T - 1, its linear part, or that with the paper's wrong sign"""
    regressor: Literal["predicted", "gnss"] = "predicted"
    """height with which GNSS tells bias from scale factor: the filter's own, or GNSS height as the
    paper prints"""
    covariance: Literal["joint", "marginal"] = "joint"
    """marginal: bias and scale factor taken as independent after each fix, as in the paper"""
    correction: Literal["carried", "filtered"] = "carried"
    """filtered: a new correction passes the height filter as if it were a measurement, as in the
    paper"""
    outliers: Literal["damped", "kept"] = "damped"
    """whether measurements far from the prediction lose weight"""
    reference_height_m: float = Field(0.0, ge=-500, le=9000)
    """H0: the scale factor counts from here"""
    scale_walk_per_second: float = Field(5e-9, gt=0, le=1)
    """Q^a: growth of the scale factor's variance in a second"""
    bias_walk_m2ps: float = Field(0.05, gt=0, le=1e6)
    """Q^b: growth of the bias' variance (m2) in a second"""
    climb_walk_m2ps3: float = Field(8.0, gt=0, le=1e6)
    """Q^h: growth of the climb's variance (m2/s2) in a second: 2 m/s2 that last a second"""
    climb_time_s: float = Field(100.0, ge=10, le=1e6)
    """tau: the climb decays with this time constant"""
    scale_sd: float = Field(0.05, gt=0, le=1)
    """spread of the scale factor at the start: 15 K"""
    bias_sd_m: float = Field(100.0, gt=0, le=10_000)
    """spread of the bias at the start: 12 hPa"""
    baro_variance_m2: float = Field(0.25, gt=0, le=1e6)
    """R^B: white noise of the barometer height, with gusts and propellers"""
    gnss_variance_m2: float | Literal["claimed"] = "claimed"
    """R^GPS: a number, or as the receiver claims"""
    gnss_sd_floor_m: float = Field(2.0, gt=0, le=100)
    """a claimed spread below this is not believed"""
    gnss_sd_unknown_m: float = Field(10.0, gt=0, le=1000)
    """spread of a receiver that claims nothing"""
    temperature_sd_k: float = Field(1.5, gt=0, le=100)
    """of an air temperature"""
    temperature_time_s: float = Field(60.0, ge=0, le=1e5)
    """temperatures closer together than this count as one; 0: each counts"""
    die_offset_k: float = Field(20.0, ge=-50, le=100)
    """how much warmer than the air the barometer's own thermometer is"""
    die_sd_k: float = Field(10.0, gt=0, le=100)
    """spread of that"""

    @model_validator(mode="before")
    @classmethod
    def _preset(cls, values: Any) -> Any:
        """The keys of the preset below those that are given."""
        if isinstance(values, dict) and values.get("preset") == "paper":
            return PAPER | values
        return values

    def params(self) -> Rows:
        row = rows(PARAMS)
        damped, claimed = self.outliers == "damped", self.gnss_variance_m2 == "claimed"
        row["use_air"] = self.temperature != "none"
        row["use_die"] = self.temperature == "die"
        row["law"] = LAWS[self.temperature_law]
        row["regress_gnss"] = self.regressor == "gnss"
        row["joint"] = self.covariance == "joint"
        row["carried"] = self.correction == "carried"
        row["gnss_gate"] = GNSS_GATE if damped else math.inf
        row["baro_gate"] = BARO_GATE if damped else math.inf
        row["H_0"] = self.reference_height_m
        row["T_0"] = T0_K + L0_KPM * self.reference_height_m
        row["Q_a"], row["Q_b"], row["Q_h"] = (
            self.scale_walk_per_second,
            self.bias_walk_m2ps,
            self.climb_walk_m2ps3,
        )
        row["tau"] = self.climb_time_s
        row["P_a0"], row["P_b0"] = self.scale_sd**2, self.bias_sd_m**2
        row["R_B"] = self.baro_variance_m2
        row["R_GPS"] = math.nan if claimed else self.gnss_variance_m2
        row["gnss_sd_floor_m"], row["gnss_sd_unknown_m"] = (
            self.gnss_sd_floor_m,
            self.gnss_sd_unknown_m,
        )
        row["R_T"], row["temperature_time_s"] = self.temperature_sd_k**2, self.temperature_time_s
        row["die_offset_k"], row["R_die"] = self.die_offset_k, self.die_sd_k**2
        return row


def init(params: Rows) -> Rows:
    """A fresh state: nothing known."""
    state = rows(STATE)
    start(state, params)
    return readable(state)


@step
def start(state: Rows, params: Rows) -> None:
    """Forget everything but the counters."""
    s, p = state[0], params[0]
    reset(state)
    clear(s.baro_us, s.baro_values)
    s.error[0], s.error[1] = 0.0, 0.0
    diagonal(s.P_error, p.P_a0, p.P_b0)
    diagonal(s.P_settled, p.P_a0, p.P_b0)
    s.motion[0], s.motion[1] = math.nan, math.nan
    diagonal(s.P_motion, P_H0_M2, P_V0_M2PS2)
    s.error_us, s.settled_us, s.motion_us, s.lambda_us, s.fix_us, s.since_us = (
        -1,
        -1,
        -1,
        -1,
        -1,
        -1,
    )
    s.gnss_alone = 0
    s.H[0], s.H[1] = 0.0, 0.0
    s.K[0], s.K[1] = 0.0, 0.0
    s.baro_m, s.temperature_k, s.innovation_m = math.nan, math.nan, math.nan
    s.fix_m, s.fix_var_m2, s.wander_m2 = math.nan, math.nan, 0.0
    s.gnss_run[0], s.gnss_run[1] = 0, 0
    s.baro_run[0], s.baro_run[1] = 0, 0
    s.jump_m = 0.0


@step
def diagonal(P: Array, first: float, second: float) -> None:
    """P = diag(first, second)."""
    P[0, 0], P[0, 1], P[1, 0], P[1, 1] = first, 0.0, 0.0, second


@step
def compensate(baro: float, a: float, b: float, H_0: float) -> float:
    """h^c of (32), with the height above H_0 as in (2): the inverse of h^B = h + a (h - H_0) + b."""
    return H_0 + (baro - H_0 - b) / (1.0 + a)


@step
def scale_of_temperature(law: int, T: float, T_0: float, above: float) -> float:
    """lambda of (6): the scale-factor error when the air is T at `above` metres over the reference
    height."""
    T_0_now = T - L0_KPM * above
    if law == EXACT:
        return T_0 / T_0_now - 1.0
    lam = (T_0_now - T_0) / T_0
    return lam if law == PRINTED else -lam


@step
def scale_variance(R_T: float, P_h: float, above: float, T_0: float) -> float:
    """Var v^a of (7), with T_0 squared (erratum)."""
    return (R_T + L0_KPM * L0_KPM * P_h + above * above * R_GAMMA_K2PM2) / (T_0 * T_0)


@step
def persists(run: Array, side: int, time_us: int, patience_us: int) -> bool:
    """Whether innovations have now been on this `side` of the gate (0: inside) for `patience_us`."""
    if side != run[0]:
        run[0], run[1] = side, time_us
    return side != 0 and time_us - run[1] >= patience_us


@step
def restart_motion(state: Rows, height: float, P_h: float) -> None:
    """Height from one measurement, climb unknown."""
    s = state[0]
    s.motion[0], s.motion[1] = height, 0.0
    diagonal(s.P_motion, P_h, P_V0_M2PS2)


@step
def predict_motion(state: Rows, params: Rows, dt: float) -> None:
    """x = F x, P = F P F' + G Q^h G' (33)."""
    s, p = state[0], params[0]
    decay = 1.0 - dt / p.tau
    P = s.P_motion
    s.motion[0] += dt * s.motion[1]
    s.motion[1] *= decay
    P[0, 0] += 2.0 * dt * P[0, 1] + dt * dt * P[1, 1]
    P[0, 1] = decay * (P[0, 1] + dt * P[1, 1])
    P[1, 0] = P[0, 1]
    P[1, 1] = decay * decay * P[1, 1] + p.Q_h * dt


@step
def correct_motion(state: Rows, params: Rows, height: float, R: float, time_us: int) -> int:
    """The alpha-beta update with a height of variance R (34): USED, or GATED when its weight was
    damped.

    Innovations that stay beyond the gate are a jump of the sensor: height starts anew there, and b,
    which a jump of the barometer changes, becomes as uncertain as the jump was large.
    """
    s, gate = state[0], params[0].baro_gate
    innovation = height - s.motion[0]
    R_damped = inflated(innovation, s.P_motion[0, 0] + R, R, gate)
    side = 0 if R_damped == R else (1 if innovation > 0.0 else -1)
    if side != s.baro_run[0]:
        s.jump_m = innovation
    if persists(s.baro_run, side, time_us, BARO_PATIENCE_US):
        s.baro_run[0] = 0
        s.motion[0] = height
        s.P_motion[0, 0], s.P_motion[0, 1], s.P_motion[1, 0] = R, 0.0, 0.0
        s.P_error[1, 1] += s.jump_m * s.jump_m
        s.P_settled[1, 1] += s.jump_m * s.jump_m
        return USED
    s.H[0], s.H[1] = 1.0, 0.0
    correct(s.motion, s.P_motion, s.H, s.K, innovation, R_damped)
    return USED if side == 0 else GATED


@step
def correct_error(state: Rows, params: Rows, innovation: float, R: float) -> None:
    """Correct [a, b] with the row in H; the height moves along unless the correction is to be
    filtered."""
    s, p = state[0], params[0]
    baro = s.motion[0] + s.error[0] * (s.motion[0] - p.H_0) + s.error[1]
    correct(s.error, s.P_error, s.H, s.K, innovation, R)
    s.error[0] = max(s.error[0], LOWEST_A)
    if p.carried == 1:
        s.motion[0] = compensate(baro, s.error[0], s.error[1], p.H_0)


@step
def lambda_update(state: Rows, params: Rows, T: float, R_T: float, time_us: int) -> None:
    """(20)-(22) with the temperature T of the air at the predicted height."""
    s, p = state[0], params[0]
    above = s.motion[0] - p.H_0
    if not s.motion[0] < TROPOPAUSE_M:
        return
    variance = scale_variance(R_T, s.P_motion[0, 0], above, p.T_0)
    if s.lambda_us >= 0:
        variance *= max(1.0, p.temperature_time_s / ((time_us - s.lambda_us) * 1e-6))
    s.lambda_us = time_us
    s.H[0], s.H[1] = 1.0, 0.0
    correct_error(
        state, params, scale_of_temperature(p.law, T, p.T_0, above) - s.error[0], variance
    )


@step
def baro_at(state: Rows, time_us: int) -> float:
    """h^B at an instant, carried on with the climb when that is newer than the newest; NaN when
    there is none near."""
    s = state[0]
    baro = at(s.baro_us, s.baro_values, time_us, SILENCE_US)
    newer_s = max(0.0, (time_us - s.last_us[PRESSURE, 0]) * 1e-6)
    return baro + (1.0 + s.error[0]) * s.motion[1] * newer_s


@step
def z_innovation(state: Rows, params: Rows, baro: float, fix_m: float) -> float:
    """z - a (h - H_0) - b of (10) for a fix when the barometer reads `baro`; H is left set for it."""
    s, p = state[0], params[0]
    height = s.motion[0] - (s.baro_m - baro) / (1.0 + s.error[0])
    s.H[0] = (fix_m if p.regress_gnss == 1 else height) - p.H_0
    s.H[1] = 1.0
    return baro - fix_m - s.H[0] * s.error[0] - s.error[1]


@step
def learn_anew(state: Rows, params: Rows, innovation: float) -> None:
    """Fixes have contradicted [a, b] for long: no scale factor, and a bias as wrong as the
    innovation says."""
    s, p = state[0], params[0]
    s.gnss_run[0] = 0
    s.error[1] += s.H[0] * s.error[0]
    s.error[0] = 0.0
    diagonal(s.P_error, p.P_a0, s.P_error[1, 1] + innovation * innovation)


@step
def z_update(state: Rows, params: Rows, time_us: int, fix_m: float, R_GPS: float) -> int:
    """(25), (26), (29)-(31) in one: USED, GATED when its weight was damped, STALE when no barometer
    height is near."""
    s = state[0]
    baro = baro_at(state, time_us)
    if math.isnan(baro):
        return STALE
    innovation = z_innovation(state, params, baro, fix_m)
    R = params[0].R_B + R_GPS
    R_damped = inflated(innovation, spread(s.P_error, s.H) + R, R, params[0].gnss_gate)
    side = 0 if R_damped == R else (1 if innovation > 0.0 else -1)
    if persists(s.gnss_run, side, time_us, GNSS_PATIENCE_US):
        learn_anew(state, params, innovation)
        R_damped = R
    s.innovation_m = -innovation
    correct_error(state, params, innovation, R_damped)
    for i in range(2):
        for j in range(2):
            s.P_settled[i, j] = s.P_error[i, j]
    s.settled_us = time_us
    if params[0].joint == 0:
        s.P_error[0, 1], s.P_error[1, 0] = 0.0, 0.0
    return USED if R_damped == R else GATED


@step
def take_waiting_fix(state: Rows, params: Rows) -> None:
    """The z-update of the fix that waited for the barometer."""
    s = state[0]
    if s.fix_us >= 0:
        z_update(state, params, s.fix_us, s.fix_m, s.fix_var_m2)
        s.fix_us = -1


@step
def take_temperature(state: Rows, params: Rows, die_temperature_k: float, time_us: int) -> None:
    """The lambda-update with the temperature that waits, else with that of the die where it is
    allowed to stand in."""
    s, p = state[0], params[0]
    air_is_near = s.last_us[AIR, 0] >= 0 and time_us - s.last_us[AIR, 0] <= AIR_REACH_US
    if air_is_near and not math.isnan(s.temperature_k):
        lambda_update(state, params, s.temperature_k, p.R_T, time_us)
    elif not air_is_near and p.use_die == 1 and not math.isnan(die_temperature_k):
        lambda_update(state, params, die_temperature_k - p.die_offset_k, p.R_die, time_us)
    s.temperature_k = math.nan


@step
def predict(state: Rows, params: Rows, time_us: int) -> None:
    """Bring height and errors to the time of a barometer height (17), (18), (33)."""
    s, p = state[0], params[0]
    if s.motion_us < 0 or time_us - s.motion_us > SILENCE_US:
        restart_motion(state, compensate(s.baro_m, s.error[0], s.error[1], p.H_0), P_H0_M2)
        s.gnss_alone = 0
    elif time_us > s.motion_us:
        predict_motion(state, params, (time_us - s.motion_us) * 1e-6)
    s.motion_us = max(s.motion_us, time_us)
    if s.error_us >= 0:
        dt = (time_us - s.error_us) * 1e-6
        s.P_error[0, 0] += p.Q_a * dt
        s.P_error[1, 1] += p.Q_b * dt
    s.error_us = time_us


@step
def on_pressure(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """One cycle of the paper."""
    s, p = state[0], params[0]
    if sample[0].instance != 0:
        return tally(state, PRESSURE, IGNORED)
    verdict = judge_pressure(state, sample, LOWEST_PA, HIGHEST_PA)
    if verdict != USED:
        return tally(state, PRESSURE, verdict)
    time_us = sample[0].time_us
    place(state, PRESSURE, 0, time_us)
    s.baro_m = baro_altitude_m(sample[0].pressure_pa)
    push(s.baro_us, s.baro_values, time_us, s.baro_m)
    predict(state, params, time_us)
    take_temperature(state, params, sample[0].die_temperature_k, time_us)
    if s.gnss_alone == 1:  # the barometer is back: what GNSS told meanwhile is a fix
        z_update(state, params, time_us, s.motion[0], s.P_motion[0, 0])
        s.gnss_alone = 0
    take_waiting_fix(state, params)
    a, b = s.error[0], s.error[1]
    h_c = compensate(s.baro_m, a, b, p.H_0)
    R_h = p.R_B / ((1.0 + a) * (1.0 + a))
    if p.carried == 0:
        s.H[0], s.H[1] = h_c - p.H_0, 1.0
        R_h += spread(s.P_error, s.H) / ((1.0 + a) * (1.0 + a))
    verdict = correct_motion(state, params, h_c, R_h, time_us)
    write_estimate(state, params, estimate)
    return tally(state, PRESSURE, verdict)


@step
def on_gnss(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A fix meets the barometer height of its own time, at once or when that comes; without a
    barometer it leads."""
    s, p = state[0], params[0]
    if sample[0].instance != 0:
        return tally(state, GNSS, IGNORED)
    verdict = judge_gnss(state, sample)
    if verdict != USED:
        return tally(state, GNSS, verdict)
    time_us, fix_m = sample[0].time_us, sample[0].altitude_amsl_m
    place(state, GNSS, 0, time_us)
    take_waiting_fix(state, params)
    sd_m = gnss_sd_m(sample, p.gnss_sd_floor_m, p.gnss_sd_unknown_m)
    s.wander_m2 = CORRELATED_SHARE * sd_m * sd_m
    s.fix_var_m2 = sd_m * sd_m if math.isnan(p.R_GPS) else p.R_GPS
    if s.since_us < 0:
        s.since_us = time_us
    if time_us - max(s.since_us, s.last_us[PRESSURE, 0]) > SILENCE_US:
        verdict = follow_gnss(state, params, time_us, fix_m)
    elif time_us <= s.last_us[PRESSURE, 0]:
        verdict = z_update(state, params, time_us, fix_m, s.fix_var_m2)
    else:
        s.fix_us, s.fix_m = time_us, fix_m
        verdict = foreseen(state, params)
    write_estimate(state, params, estimate)
    return tally(state, GNSS, verdict)


@step
def foreseen(state: Rows, params: Rows) -> int:
    """What will become of the waiting fix, unless the barometer jumps."""
    s, p = state[0], params[0]
    baro = baro_at(state, s.fix_us)
    if math.isnan(baro):
        return USED
    innovation = z_innovation(state, params, baro, s.fix_m)
    S = spread(s.P_error, s.H) + p.R_B + s.fix_var_m2
    return GATED if innovation * innovation > p.gnss_gate * p.gnss_gate * S else USED


@step
def follow_gnss(state: Rows, params: Rows, time_us: int, fix_m: float) -> int:
    """No barometer: the alpha-beta filter takes GNSS heights."""
    s = state[0]
    s.gnss_alone = 1
    if s.motion_us < 0 or time_us - s.motion_us > SILENCE_US:
        restart_motion(state, fix_m, s.fix_var_m2)
        s.motion_us = time_us
        return USED
    late_s = max(0.0, (s.motion_us - time_us) * 1e-6)
    if time_us > s.motion_us:
        predict_motion(state, params, (time_us - s.motion_us) * 1e-6)
        s.motion_us = time_us
    return correct_motion(state, params, fix_m + s.motion[1] * late_s, s.fix_var_m2, time_us)


@step
def on_air(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A temperature of the air waits for the next pressure, whose height it belongs to."""
    s = state[0]
    instance, T = sample[0].instance, sample[0].air_temperature_k
    if params[0].use_air == 0 or instance != 0 or (math.isnan(T) and sample[0].qnh_pa > 0.0):
        return tally(state, AIR, IGNORED)  # a QNH alone says nothing that GNSS does not
    if not LOWEST_AIR_K <= T <= HIGHEST_AIR_K:
        return tally(state, AIR, INVALID)
    if is_stale(state, AIR, instance, sample[0].time_us):
        return tally(state, AIR, STALE)
    place(state, AIR, instance, sample[0].time_us)
    s.temperature_k = T
    return tally(state, AIR, USED)


@step
def write_estimate(state: Rows, params: Rows, estimate: Rows) -> None:
    """Height and climb as filtered, and the error to expect of them (see Departures)."""
    s, p = state[0], params[0]
    if s.motion_us < 0:
        return
    variance = s.P_motion[0, 0] + s.wander_m2
    if s.gnss_alone == 0:
        s.H[0], s.H[1] = s.motion[0] - p.H_0, 1.0
        age_s = 0.0 if s.settled_us < 0 else max(0.0, (s.motion_us - s.settled_us) * 1e-6)
        variance = (
            spread(s.P_settled, s.H)
            + WEATHER_M2PS * age_s
            + min(p.R_B, s.P_motion[0, 0])
            + s.wander_m2
        )
    estimate[0].time_us = s.motion_us
    estimate[0].altitude_amsl_m = s.motion[0]
    estimate[0].climb_mps = s.motion[1]
    estimate[0].altitude_sd_m = math.sqrt(variance)
    estimate[0].climb_sd_mps = math.sqrt(s.P_motion[1, 1])
    estimate[0].baro_offset_m = (
        math.nan
        if s.gnss_alone == 1
        else compensate(s.baro_m, s.error[0], s.error[1], p.H_0) - s.baro_m
    )
    estimate[0].innovation_m = s.innovation_m
    estimate[0].baro_scale = s.error[0]


@step
def on_status(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A reboot restarts the vehicle's clock: start anew."""
    if sample[0].reboot == 1:
        start(state, params)
        forget(estimate)
    return tally(state, STATUS, USED)


@step
def run(state: Rows, params: Rows, tables: Tables, estimates: Rows, verdicts: Rows) -> None:
    """The steps over a whole log, in order of arrival."""
    estimate = estimates[:0]
    for i in range(tables.order.size):
        kind, row = tables.order[i].kind, tables.order[i].row
        if i > 0:
            estimates[i] = estimates[i - 1]
        estimate = estimates[i : i + 1]
        if kind == PRESSURE:
            verdicts[i] = on_pressure(state, params, tables.pressure[row : row + 1], estimate)
        elif kind == GNSS:
            verdicts[i] = on_gnss(state, params, tables.gnss[row : row + 1], estimate)
        elif kind == AIR:
            verdicts[i] = on_air(state, params, tables.air[row : row + 1], estimate)
        elif kind == STATUS:
            verdicts[i] = on_status(state, params, tables.status[row : row + 1], estimate)


METHOD = Method(
    name="air-data-gnss",
    summary="barometer bias and scale factor from GNSS height and air temperature",
    citation="Whang, Ra 2008",
    settings=AirDataGnssSettings,
    state=STATE,
    init=init,
    steps={
        Kind.PRESSURE: on_pressure,
        Kind.GNSS: on_gnss,
        Kind.AIR: on_air,
        Kind.STATUS: on_status,
    },
    run=run,
    datum_invariant=False,
    follows_baro_step=True,
)
