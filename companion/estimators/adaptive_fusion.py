"""Adaptive baro/GPS data fusion.

C. Hajiyev, U. Hacizade, D. Cilden-Guler, "Integration of Barometric and GPS Altimeters via Adaptive
Data Fusion Algorithm", 2019. The paper's letters:

==============  =========================  =========================================================
h^B             ``baro_m``                 barometer height (1), with p_0 and T_0 of (31)
h^GPS           ``altitude_amsl_m``        GNSS height
R_B, R_GPS      ``R_B, R_GPS``             variances of the two, m2
Delta           ``delta``                  residual h^GPS - h^B (18)
S               ``S``                      adaptive factor on R_B (30)
K               ``K``                      gain (16), (27)
P               ``P``                      R_GPS K (17): the paper's figure, not an error variance
==============  =========================  =========================================================

The fixed filter is maximum-likelihood weighting, h = h^B + K Delta with K = R_B / (R_B + R_GPS)
(15)-(16). The adaptive one replaces R_B by S R_B whenever Delta^2 >= R_GPS + R_B (28), with S from
(30), so that a barometer that no longer agrees with GNSS loses its weight. It needs no IMU and has
no memory beyond the last correction K Delta. With ``gnss_variance_m2: 169`` it is the paper's
filter, with ``gain: fixed`` its non-adaptive one.

Errata
------
S is held at 1 where (28) does not fire: (31) as printed lets S become negative (59 % of the time
with the paper's variances and no fault), with a pole of the estimate at Delta = 0. K rises with S
(the text says it falls). For R_B << R_GPS, P tends to R_B (below (25): to 0).
`sim.studies.papers.adaptive_fusion` has the errata of the simulation.

Departures
----------
- The paper has one GPS height with each barometer height. Here the correction K Delta of the last
  fix is held between fixes and added to every new barometer height; Delta is formed with the
  barometer height at the fix's own time, interpolated, since a fix arrives late.
- Geometric height of the full standard atmosphere instead of (1), which is its troposphere in
  geopotential metres.
- p_0 and T_0 of (31) are those of the setting window: a QNH and the field's air temperature, from
  `companion.estimators.setting`. While none is given they are the standard's. When they change, the
  held Delta changes by as much as h^B.
- ``gnss_variance_m2``: the paper's constant 169 m2, or the reported variance
  (default).
- The estimate's ``altitude_sd_m`` is not sqrt(P). When (28) fires, the estimate is exactly h^GPS -
  R_GPS / Delta, with mean square error about R_GPS + 3 R_GPS^2 / Delta^2: above plain GPS, never
  below it as P says. When it does not fire the error is that of (13) plus the unexplained part of
  (1-K) Delta. It grows while there is no fix, as the barometer's error can
  (`companion.estimators.outage`).
- Climb is the slope of the barometer height, smoothed over one second; the paper has none.
- A fix without a barometer height within two seconds of it is taken as it is: GNSS height alone,
  the limit R_B -> infinity. The last correction is kept for a barometer that comes back.
- Without GNSS, or once the held correction is less certain than the setting, the altitude is h^B of
  the setting, if a QNH is known.

Breaks when
-----------
The air is not standard: (28) then fires always and the estimate is GNSS height, a little noisier
than GNSS itself (14.3 m against 13.0 in the paper's own drift). It fires without reason too, for 32
% of the readings of two healthy sensors, and then costs accuracy (9.6 m against 7.4 of the fixed
filter). Between fixes it is only as good as the barometer. The fixed filter keeps (1-K) of every
barometer error for ever.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from companion.estimators.judging import (
    AIR,
    GNSS,
    IGNORED,
    PRESSURE,
    STATUS,
    USED,
    forget,
    judge_gnss,
    judge_pressure,
    place,
    reset,
    score,
    state_dtype,
    tally,
)
from companion.estimators.method import Method
from companion.estimators.outage import OUTAGE, growth_m2, note_difference, outage_start
from companion.estimators.params import EstimatorSettings
from companion.estimators.setting import (
    SETTING,
    admit_setting,
    indicated_m,
    indicated_sd_m,
    is_set,
    note_air,
    note_level,
    setting_start,
)
from companion.jit import step
from companion.kernels.atmosphere import geometric_m, pressure_altitude_m
from companion.kernels.gnss import gnss_sd_m
from companion.kernels.ring import at, clear, push, ring_fields
from companion.samples import Kind, Rows, Tables, readable, rows

LOWEST_PA, HIGHEST_PA = 1_000.0, 120_000.0
BARO_TIMEOUT_US = 2_000_000
CLIMB_TIME_CONSTANT_S = 1.0
RING_SIZE = 128  # the delay horizon of a second and more, at 100 Hz

STATE = state_dtype(
    ("setting", SETTING),
    ("outage", OUTAGE),
    ("level_m", "f8"),  # newest pressure altitude, geopotential
    *ring_fields("level", RING_SIZE),  # the recent ones
    ("baro_m", "f8"),  # newest barometer height h^B
    ("climb_mps", "f8"),
    ("corrected_us", "i8"),  # time of the fix that the following come from, -1 before the first
    ("R_GPS_m2", "f8"),  # variance of that fix
    ("delta_m", "f8"),  # residual (18)
    ("S", "f8"),
    ("K", "f8"),
    ("P_m2", "f8"),  # (17), the paper's figure: not an error variance
    ("sd_m", "f8"),  # the spread to expect
)


class AdaptiveFusionSettings(EstimatorSettings):
    """Section ``estimators.adaptive-fusion``."""

    gain: Literal["adaptive", "fixed"] = "adaptive"
    """which of the paper's two filters: adaptive or fixed gain"""
    baro_variance_m2: float = Field(81.0, gt=0, le=1e6)
    """variance of the barometer height (R_B)"""
    gnss_variance_m2: Annotated[float, Field(gt=0, le=1e6)] | Literal["claimed"] = "claimed"
    """variance of a GNSS height (R_GPS): a number (the paper has 169), or claimed: from the
    reported accuracy"""
    gnss_sd_floor_m: float = Field(1.0, gt=0, le=100)
    """least standard deviation of a GNSS height; a smaller reported accuracy is raised to it"""
    gnss_sd_unknown_m: float = Field(13.0, gt=0, le=1000)
    """standard deviation of a GNSS height whose receiver reports no accuracy"""

    def derived(self) -> Mapping[str, Any]:
        """The letters of the paper."""
        reported = self.gnss_variance_m2 == "claimed"
        return {
            "adaptive": int(self.gain == "adaptive"),
            "R_B_m2": self.baro_variance_m2,
            "R_GPS_m2": math.nan if reported else self.gnss_variance_m2,  # NaN: as reported
        }


def init(params: Rows) -> Rows:
    """A fresh state: nothing known."""
    state = rows(STATE)
    start(state)
    return readable(state)


@step
def start(state: Rows) -> None:
    """Forget everything but the counters."""
    reset(state)
    clear(state[0].level_us, state[0].level_values)
    setting_start(state[0].setting)
    outage_start(state[0].outage)
    state[0].level_m = math.nan
    state[0].baro_m = math.nan
    state[0].climb_mps = math.nan
    state[0].corrected_us = -1
    state[0].R_GPS_m2 = math.nan
    state[0].delta_m = math.nan
    state[0].S = math.nan
    state[0].K = math.nan
    state[0].P_m2 = math.nan
    state[0].sd_m = math.nan


@step
def adaptive_factor(delta: float, R_B: float, R_GPS: float) -> float:
    """S of (30) where the condition (28) holds, else 1 (erratum: (31) prints it unguarded)."""
    if delta * delta >= R_GPS + R_B:
        return (delta * delta - R_GPS) / R_B
    return 1.0


@step
def gain(S: float, R_B: float, R_GPS: float) -> float:
    """K of (27); with S = 1 that of (16)."""
    return S * R_B / (S * R_B + R_GPS)


@step
def fused_sd_m(delta: float, S: float, K: float, R_B: float, R_GPS: float) -> float:
    """Root mean square error to expect of h^B + K Delta (see Departures; not the paper's P)."""
    if S > 1.0:
        return math.sqrt(R_GPS + 3.0 * R_GPS * R_GPS / (delta * delta))
    unexplained = max(0.0, delta * delta - R_B - R_GPS)
    return math.sqrt(R_GPS * K + (1.0 - K) * (1.0 - K) * unexplained)


@step
def adapt(state: Rows, params: Rows, delta_m: float) -> None:
    """Adaptive factor, gain and P for a residual (17), (27), (28), (30)."""
    s, p = state[0], params[0]
    s.delta_m = delta_m
    s.S = adaptive_factor(delta_m, p.R_B_m2, s.R_GPS_m2) if p.adaptive == 1 else 1.0
    s.K = gain(s.S, p.R_B_m2, s.R_GPS_m2)
    s.P_m2 = s.R_GPS_m2 * s.K
    s.sd_m = fused_sd_m(delta_m, s.S, s.K, p.R_B_m2, s.R_GPS_m2)


@step
def on_pressure(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """h = h^B + K Delta (15), with the correction of the last fix."""
    s = state[0]
    if sample[0].instance != 0:
        return tally(state, PRESSURE, IGNORED)
    verdict = judge_pressure(state, sample, LOWEST_PA, HIGHEST_PA)
    if verdict != USED:
        return tally(state, PRESSURE, verdict)
    s.level_m = pressure_altitude_m(sample[0].pressure_pa)
    note_level(s.setting, s.level_m)
    baro = indicated_m(s.setting, s.level_m)
    elapsed_s = (sample[0].time_us - s.last_us[PRESSURE, 0]) * 1e-6
    if s.last_us[PRESSURE, 0] < 0 or elapsed_s > BARO_TIMEOUT_US * 1e-6:
        s.climb_mps = math.nan
    else:
        slope = (baro - s.baro_m) / elapsed_s
        weight = elapsed_s / (elapsed_s + CLIMB_TIME_CONSTANT_S)
        s.climb_mps = (
            slope if math.isnan(s.climb_mps) else s.climb_mps + weight * (slope - s.climb_mps)
        )
    s.baro_m = baro
    place(state, PRESSURE, 0, sample[0].time_us)
    push(s.level_us, s.level_values, sample[0].time_us, s.level_m)
    write_estimate(state, params, estimate)
    return tally(state, PRESSURE, USED)


@step
def on_gnss(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """Residual of a fix (18), and what follows from it."""
    s, p = state[0], params[0]
    if sample[0].instance != 0:
        return tally(state, GNSS, IGNORED)
    verdict = judge_gnss(state, sample)
    if verdict != USED:
        return tally(state, GNSS, verdict)
    place(state, GNSS, 0, sample[0].time_us)
    sd_m = gnss_sd_m(sample, p.gnss_sd_floor_m, p.gnss_sd_unknown_m)
    R_GPS = sd_m * sd_m if math.isnan(p.R_GPS_m2) else p.R_GPS_m2
    level_m = at(s.level_us, s.level_values, sample[0].time_us, BARO_TIMEOUT_US)
    if math.isnan(level_m):
        write_gnss_alone(sample, R_GPS, estimate)
    else:
        s.corrected_us, s.R_GPS_m2 = sample[0].time_us, R_GPS
        adapt(state, params, sample[0].altitude_amsl_m - indicated_m(s.setting, level_m))
        score(state, s.delta_m, p.R_B_m2 + R_GPS)
        note_difference(
            s.outage,
            sample[0].time_us,
            sample[0].altitude_amsl_m,
            geometric_m(level_m),
            sample[0].ground_speed_mps,
            sd_m,
        )
        write_estimate(state, params, estimate)
    return tally(state, GNSS, USED)


@step
def on_air(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """p_0 and T_0 of (31), from the setting of the altimeter. A temperature alone is IGNORED."""
    s = state[0]
    verdict = admit_setting(state, sample, False)
    if verdict != USED:
        return verdict
    note_air(s.setting, sample, not math.isnan(s.level_m))
    if not math.isnan(s.level_m):
        note_level(s.setting, s.level_m)
        before_m = s.baro_m
        s.baro_m = indicated_m(s.setting, s.level_m)
        if s.corrected_us >= 0:
            adapt(state, params, s.delta_m + before_m - s.baro_m)
        write_estimate(state, params, estimate)
    return verdict


@step
def write_estimate(state: Rows, params: Rows, estimate: Rows) -> None:
    """The newest barometer height with the last correction, its spread grown by the time since; or
    without it, where a setting is known and has the smaller spread."""
    s = state[0]
    sd_m = math.inf
    if s.corrected_us >= 0:
        sd_m = math.sqrt(s.sd_m * s.sd_m + growth_m2(s.outage, s.now_us, geometric_m(s.level_m)))
    correction_m = s.K * s.delta_m
    if is_set(s.setting) and not math.isnan(s.level_m):
        indicated_sd = indicated_sd_m(s.setting, s.baro_m, s.now_us)
        if indicated_sd < sd_m:
            correction_m, sd_m = 0.0, indicated_sd
    if sd_m == math.inf:
        return
    estimate[0].time_us = s.last_us[PRESSURE, 0]
    estimate[0].altitude_amsl_m = s.baro_m + correction_m
    estimate[0].climb_mps = s.climb_mps
    estimate[0].altitude_sd_m = sd_m
    estimate[0].baro_offset_m = s.baro_m + correction_m - geometric_m(s.level_m)
    estimate[0].innovation_m = s.delta_m


@step
def write_gnss_alone(sample: Rows, R_GPS: float, estimate: Rows) -> None:
    """What a fix says where there is no barometer."""
    forget(estimate)
    estimate[0].time_us = sample[0].time_us
    estimate[0].altitude_amsl_m = sample[0].altitude_amsl_m
    estimate[0].climb_mps = sample[0].climb_mps
    estimate[0].altitude_sd_m = math.sqrt(R_GPS)


@step
def on_status(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A reboot restarts the vehicle's clock: start anew."""
    if sample[0].reboot == 1:
        start(state)
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
    name="adaptive-fusion",
    summary="maximum-likelihood weighting of barometer and GNSS, adaptive on their disagreement",
    citation="Hajiyev, Hacizade, Cilden-Guler 2019",
    settings=AdaptiveFusionSettings,
    state=STATE,
    init=init,
    steps={
        Kind.PRESSURE: on_pressure,
        Kind.GNSS: on_gnss,
        Kind.AIR: on_air,
        Kind.STATUS: on_status,
    },
    run=run,
    datum_invariant=True,
    follows_baro_step=True,
    tunable=("baro_variance_m2", "gnss_sd_floor_m"),
)
