"""The vertical bank: our own estimator. A bank of vertical channels over how fast weather drifts.

`vertical_channel` is one channel, a Kalman filter of eight states. Three of them run side by side and differ in one
prior alone: how large the drift rate of the barometer's error is (calm, fair, stormy). They interact (Blom and
Bar-Shalom's interacting multiple model): weather changes its mind once in `switching_s`; every second each channel
restarts from the mixture of all, weighed by the chance that the weather changed to it (`mix`), and measurements move
the weights by their likelihood (`weigh`). The estimate is mean and covariance of the mixture (`combine`). So a calm day
has the accuracy of a filter that trusts its barometer, and a front has one that does not.

All channels stand at one instant, ``filter_us``. Specific force is turned up by `companion.attitude` and integrated
between the measurements (`integrate`); the channels are propagated only when a measurement comes (`advance`), which is
exact, since bias and state do not change in between. A measurement older than that instant sees the height of its own
time. A stretch without IMU samples that can be integrated counts as blind: no acceleration, much noise.

Measurements
------------
Pressure is geometric height of the standard atmosphere, h + o + e. Its noise is no less than the median of what
consecutive heights differ by beyond the motion; beyond three sigma an innovation's variance is inflated (`inflated`),
and after `BARO_CLIPPED` such ones of one sign the offset is learned anew. The same value again is no measurement.

GNSS height is h + g. Its spread is split into a slow part, which is the state g, and a white one; both have floors,
since receivers claim decimetres with metres of error. Beyond five sigma a fix is refused. GNSS climb, where a source
gives it, is taken with no less than 0.6 m/s, as its errors last.

Only the prior of the offset (100 m, twelve hectopascals) says anything about the sea-level pressure.

Breaks when
-----------
The slow GNSS error is the floor: nothing tells it from height but a barometer that is known to be stable.
"""

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from companion.atmosphere import baro_altitude_m
from companion.attitude import (
    attitude_fields,
    attitude_gnss,
    attitude_imu,
    attitude_start,
    attitude_vehicle,
    imu_can_be_integrated,
    up_acceleration_mps2,
)
from companion.config import Settings
from companion.estimators.method import (
    ATTITUDE,
    GATED,
    GNSS,
    IGNORED,
    IMU,
    PRESSURE,
    STATUS,
    USED,
    Method,
    forget,
    gnss_sd_m,
    judge_attitude,
    judge_gnss,
    judge_imu,
    judge_pressure,
    place,
    reset,
    state_dtype,
    tally,
)
from companion.estimators.vertical_channel import (
    ACCEL,
    CLIMB,
    FAST,
    GNSS_BIAS,
    HEIGHT,
    OFFSET,
    RATE,
    SCALE,
    SIZE,
    absorb,
    begin,
    decay,
    dot,
    duplicate,
    expect_baro,
    gather,
    propagate,
    sees_climb,
    sees_height,
)
from companion.jit import step
from companion.kalman import inflated
from companion.ring import at, clear, push, ring_fields
from companion.samples import Kind, Rows, Tables, readable, rows

LOWEST_PA, HIGHEST_PA = 1_000.0, 120_000.0
BANK = 3
FILTERS = 3
OUTPUT_US = 100_000
BLIND_US = 250_000
"""IMU samples further apart than this leave a gap that nothing is known about."""
NORMAL_INTERVAL_S = 0.02
LONGEST_STEP_S = 1.0
MIX_US = 1_000_000
BARO_GATE = 3.0
BARO_CLIPPED = 15
GNSS_GATE = 5.0
NOISE_STEP = 0.1
MEDIAN_TO_SD = 1.4826
RING_SIZE = 160
RING_SPACING_US = 8_000

STATE = state_dtype(
    *attitude_fields(),
    *ring_fields("fallen", RING_SIZE),
    ("x", "f8", (FILTERS, SIZE)),
    ("P", "f8", (FILTERS, SIZE, SIZE)),
    ("steady", "f8", (FILTERS, SIZE)),
    ("walk", "f8", (FILTERS, SIZE)),
    ("weight", "f8", (BANK,)),  # model probabilities when last mixed
    ("evidence", "f8", (BANK,)),  # log likelihood since
    ("probability", "f8", (BANK,)),  # of both
    ("mixed_x", "f8", (BANK, SIZE)),
    ("mixed_P", "f8", (BANK, SIZE, SIZE)),
    ("mean", "f8", (SIZE,)),
    ("cov", "f8", (SIZE, SIZE)),
    ("keep", "f8", (SIZE,)),
    ("H", "f8", (SIZE,)),
    ("K", "f8", (SIZE,)),
    ("filter_us", "i8"),  # the instant of all filters, -1 before the first measurement
    ("mixed_us", "i8"),
    ("up_us", "i8"),
    ("up_mps2", "f8"),
    ("inertial_us", "i8"),
    ("gained_v", "f8"),  # u integrated since filter_us
    ("gained_h", "f8"),
    ("gained_psd", "f8"),
    ("V", "f8"),  # u integrated once and twice since the start
    ("S", "f8"),
    ("path_m", "f8"),  # displacement since the start as the bank sees it
    ("baro_seen", "i8"),
    ("baro_m", "f8"),
    ("baro_pa", "f8"),
    ("baro_path_m", "f8"),
    ("baro_median_m", "f8"),
    ("baro_clipped", "i8"),
    ("gnss_steady_m2", "f8"),
    ("gnss_median_m", "f8"),
    ("innovation_m", "f8"),
    ("gnss_failed", "i8"),  # bits of the last five fixes
)

PARAMS = np.dtype(
    [
        ("vehicle_attitude", "i8"),
        ("accel_noise_mps2_rthz", "f8"),
        ("blind_noise_mps2_rthz", "f8"),
        ("accel_bias_sd_mps2", "f8"),
        ("accel_bias_walk_mps2_rts", "f8"),
        ("offset_sd_m", "f8"),
        ("offset_walk_m_rts", "f8"),
        ("rate_sd_mps", "f8", (BANK,)),
        ("rate_time_s", "f8"),
        ("weather_prior", "f8", (BANK,)),
        ("switching_s", "f8"),
        ("fast_sd_m", "f8"),
        ("fast_time_s", "f8"),
        ("scale_sd", "f8"),
        ("scale_walk_rts", "f8"),
        ("baro_sd_m", "f8"),
        ("gnss_time_s", "f8"),
        ("gnss_slow_share", "f8"),
        ("gnss_slow_floor_m", "f8"),
        ("gnss_white_share", "f8"),
        ("gnss_white_floor_m", "f8"),
        ("gnss_sd_unknown_m", "f8"),
        ("gnss_climb_sd_mps", "f8"),
    ],
    align=True,
)


class VerticalBankSettings(Settings):
    """Section ``estimators.vertical-bank``. Each state can be switched off by a spread of 0, the bank by three equal
    rates."""

    vehicle_attitude: bool = False
    """take the autopilot's attitude while it agrees with our own; an EKF's is wild while it starts and under jamming"""
    accel_noise_mps2_rthz: float = Field(0.05, gt=0, le=10)
    """white noise of the upward acceleration, vibration and attitude noise included; grows with the IMU's interval"""
    blind_noise_mps2_rthz: float = Field(1.5, gt=0, le=100)
    """the same without IMU: manoeuvres"""
    accel_bias_sd_mps2: float = Field(0.2, ge=0, le=10)
    """of a consumer accelerometer after warm-up, and a tilt of some degrees"""
    accel_bias_walk_mps2_rts: float = Field(2e-3, ge=0, le=1)
    """growth of the bias in root seconds"""
    offset_sd_m: float = Field(100.0, gt=0, le=10_000)
    """barometer's slow error at sea level at the start: 12 hPa. A tighter prior that is wrong costs metres"""
    offset_walk_m_rts: float = Field(0.05, ge=0, le=10)
    """its random walk: 3 m in an hour, besides the drift rate"""
    rate_sd_mps: tuple[
        Annotated[float, Field(ge=0, le=10)], Annotated[float, Field(ge=0, le=10)], Annotated[float, Field(ge=0, le=10)]
    ] = (0.01, 0.1, 0.4)
    """drift rate of the barometer's error on a calm, a fair and a stormy day: 4, 40, 160 hPa an hour"""
    rate_time_s: float = Field(600.0, gt=0, le=1e5)
    """for how long a drift rate lasts"""
    weather_prior: tuple[
        Annotated[float, Field(gt=0, le=1)], Annotated[float, Field(gt=0, le=1)], Annotated[float, Field(gt=0, le=1)]
    ] = (0.8, 0.15, 0.05)
    """share of time with each"""
    switching_s: float = Field(1200.0, gt=0, le=1e6)
    """for how long the weather stays the same kind"""
    fast_sd_m: float = Field(0.5, ge=0, le=100)
    """barometer's fast error: gusts over the static port, sensor wander"""
    fast_time_s: float = Field(60.0, gt=0, le=1e5)
    """for how long that lasts"""
    scale_sd: float = Field(0.05, ge=0, le=1)
    """change of the barometer's error with height: 15 K"""
    scale_walk_rts: float = Field(5e-4, ge=0, le=1)
    """its random walk: .03 (9 K) in an hour"""
    baro_sd_m: float = Field(0.4, gt=0, le=100)
    """white noise of the barometer height; more when the stream shows more"""
    gnss_time_s: float = Field(250.0, gt=0, le=1e5)
    """for how long the slow part of the GNSS height error lasts"""
    gnss_slow_share: float = Field(0.7, ge=0, le=1)
    """slow part of the spread that the receiver claims"""
    gnss_slow_floor_m: float = Field(2.5, ge=0, le=100)
    """and no less than this"""
    gnss_white_share: float = Field(0.7, ge=0, le=1)
    """white part of the spread that the receiver claims"""
    gnss_white_floor_m: float = Field(1.0, gt=0, le=100)
    """and no less than this"""
    gnss_sd_unknown_m: float = Field(10.0, gt=0, le=1000)
    """spread of a receiver that claims nothing"""
    gnss_climb_sd_mps: float = Field(0.6, gt=0, le=100)
    """of a GNSS climb: more than its noise, as its errors last for seconds"""

    def params(self) -> Rows:
        row = rows(PARAMS)
        for name in PARAMS.names or ():
            row[name] = getattr(self, name)
        return row


def init(params: Rows) -> Rows:
    """A fresh state: nothing known."""
    state = readable(rows(STATE))
    start(state, params)
    return state


@step
def start(state: Rows, params: Rows) -> None:
    """Forget everything but the counters."""
    s, p = state[0], params[0]
    reset(state)
    attitude_start(state)
    clear(s.fallen_us, s.fallen_values)
    s.filter_us = -1
    s.mixed_us = -1
    s.up_us = -1
    s.up_mps2 = math.nan
    s.inertial_us = -1
    s.gained_v, s.gained_h, s.gained_psd = 0.0, 0.0, 0.0
    s.V, s.S, s.path_m = 0.0, 0.0, 0.0
    s.baro_seen = 0
    s.baro_m, s.baro_pa, s.baro_path_m = math.nan, math.nan, 0.0
    s.baro_median_m = p.baro_sd_m
    s.baro_clipped = 0
    s.gnss_steady_m2 = 0.0
    s.gnss_median_m = p.gnss_white_floor_m
    s.innovation_m = math.nan
    s.gnss_failed = 0
    for i in range(FILTERS):
        begin(s.x[i], s.P[i])
        for k in range(SIZE):
            s.steady[i, k] = 0.0
            s.walk[i, k] = 0.0
        rate = p.rate_sd_mps[i]
        s.P[i, CLIMB, CLIMB] = 900.0
        s.P[i, ACCEL, ACCEL] = p.accel_bias_sd_mps2 * p.accel_bias_sd_mps2
        s.walk[i, ACCEL] = p.accel_bias_walk_mps2_rts * p.accel_bias_walk_mps2_rts
        s.walk[i, OFFSET] = p.offset_walk_m_rts * p.offset_walk_m_rts
        s.walk[i, SCALE] = p.scale_walk_rts * p.scale_walk_rts
        s.steady[i, RATE] = rate * rate
        s.steady[i, FAST] = p.fast_sd_m * p.fast_sd_m
        s.P[i, RATE, RATE] = s.steady[i, RATE]
        s.P[i, FAST, FAST] = s.steady[i, FAST]
    for i in range(BANK):
        s.weight[i] = p.weather_prior[i]
        s.probability[i] = p.weather_prior[i]
        s.evidence[i] = 0.0


@step
def integrate(state: Rows, params: Rows, to_us: int) -> None:
    """Integrate the newest upward acceleration until `to_us`; without one that is fresh, count the time as blind."""
    s, p = state[0], params[0]
    if s.inertial_us < 0:
        s.inertial_us = to_us
    dt = (to_us - s.inertial_us) * 1e-6
    if dt <= 0.0:
        return
    seen = not math.isnan(s.up_mps2) and to_us - s.up_us <= BLIND_US
    up = s.up_mps2 if seen else 0.0
    noise = p.blind_noise_mps2_rthz
    if seen:
        noise = p.accel_noise_mps2_rthz * max(1.0, s.attitude_interval_s / NORMAL_INTERVAL_S)
    s.gained_h += s.gained_v * dt + 0.5 * up * dt * dt
    s.gained_v += up * dt
    s.gained_psd += noise * noise * dt
    s.S += s.V * dt + 0.5 * up * dt * dt
    s.V += up * dt
    s.inertial_us = to_us
    newest = s.fallen_us[(s.fallen_us[RING_SIZE] + RING_SIZE - 1) % RING_SIZE]
    if to_us - newest >= RING_SPACING_US:
        push(s.fallen_us, s.fallen_values, to_us, s.S)


@step
def advance(state: Rows, params: Rows, to_us: int) -> None:
    """Bring every filter to `to_us`."""
    s, p = state[0], params[0]
    integrate(state, params, to_us)
    if s.filter_us < 0:
        s.filter_us = to_us
        s.gained_v, s.gained_h, s.gained_psd = 0.0, 0.0, 0.0
        return
    total_s = (to_us - s.filter_us) * 1e-6
    if total_s <= 0.0:
        return
    steps = min(100, int(total_s / LONGEST_STEP_S) + 1)
    dt = total_s / steps
    decay(s.keep, dt, p.rate_time_s, p.fast_time_s, p.gnss_time_s)
    psd = s.gained_psd / total_s
    moved = 0.0
    for _ in range(steps):
        dv = s.gained_v / steps
        dh = s.gained_h if steps == 1 else 0.5 * dv * dt
        for i in range(FILTERS):
            d = propagate(s.x[i], s.P[i], s.keep, s.steady[i], s.walk[i], dt, dv, dh, psd)
            if i < BANK:
                moved += s.probability[i] * d
    s.path_m += moved
    s.gained_v, s.gained_h, s.gained_psd = 0.0, 0.0, 0.0
    s.filter_us = to_us
    mix(state, params)


@step
def weigh(state: Rows) -> None:
    """Model probabilities: those of the last mixing times the likelihood since."""
    s = state[0]
    best = max(s.evidence[0], s.evidence[1], s.evidence[2])
    total = 0.0
    for i in range(BANK):
        s.probability[i] = s.weight[i] * math.exp(s.evidence[i] - best)
        total += s.probability[i]
    for i in range(BANK):
        s.probability[i] /= total


@step
def combine(state: Rows) -> None:
    """Mean and covariance of the bank."""
    s = state[0]
    weigh(state)
    for k in range(SIZE):
        s.mean[k] = 0.0
        for i in range(BANK):
            s.mean[k] += s.probability[i] * s.x[i, k]
    for k in range(SIZE):
        for m in range(SIZE):
            s.cov[k, m] = 0.0
            for i in range(BANK):
                apart = (s.x[i, k] - s.mean[k]) * (s.x[i, m] - s.mean[m])
                s.cov[k, m] += s.probability[i] * (s.P[i, k, m] + apart)


@step
def mix(state: Rows, params: Rows) -> None:
    """Interaction: each filter restarts from what the others say, weighed by how likely the weather changed to it."""
    s, p = state[0], params[0]
    elapsed_us = s.filter_us - s.mixed_us
    if s.mixed_us >= 0 and elapsed_us < MIX_US:
        return
    change = 0.0 if s.mixed_us < 0 else 1.0 - math.exp(-elapsed_us * 1e-6 / p.switching_s)
    s.mixed_us = s.filter_us
    weigh(state)
    for j in range(BANK):
        now = (1.0 - change) * s.probability[j] + change * p.weather_prior[j]
        s.weight[j] = now
        for k in range(SIZE):
            s.mixed_x[j, k] = 0.0
        for i in range(BANK):
            share = (change * p.weather_prior[j] + (1.0 - change if i == j else 0.0)) * s.probability[i] / now
            s.H[i] = share
            for k in range(SIZE):
                s.mixed_x[j, k] += share * s.x[i, k]
        for k in range(SIZE):
            for m in range(SIZE):
                s.mixed_P[j, k, m] = 0.0
                for i in range(BANK):
                    apart = (s.x[i, k] - s.mixed_x[j, k]) * (s.x[i, m] - s.mixed_x[j, m])
                    s.mixed_P[j, k, m] += s.H[i] * (s.P[i, k, m] + apart)
    for j in range(BANK):
        duplicate(s.x[j], s.P[j], s.mixed_x[j], s.mixed_P[j])
        s.evidence[j] = 0.0


@step
def track(median: float, value: float) -> float:
    """Median of |value|, recursively."""
    return median * (1.0 + NOISE_STEP) if abs(value) > median else median / (1.0 + NOISE_STEP)


@step
def on_imu(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    s = state[0]
    if sample[0].instance != 0:
        return tally(state, IMU, IGNORED)
    verdict = judge_imu(state, sample)
    if verdict != USED:
        return tally(state, IMU, verdict)
    time_us = sample[0].time_us
    place(state, IMU, 0, time_us)
    attitude_imu(state, sample)
    if not imu_can_be_integrated(state):
        s.up_mps2 = math.nan
        return tally(state, IMU, IGNORED)
    up = up_acceleration_mps2(state, sample)
    before_us, s.up_us = s.up_us, time_us
    s.up_mps2 = up
    if math.isnan(up):
        return tally(state, IMU, IGNORED)
    if time_us - before_us > BLIND_US:
        s.up_mps2 = math.nan
        integrate(state, params, time_us)
        s.up_mps2 = up
    else:
        integrate(state, params, time_us)
    if s.filter_us >= 0 and time_us - s.filter_us >= OUTPUT_US:
        advance(state, params, time_us)
        write_estimate(state, params, estimate)
    return tally(state, IMU, USED)


@step
def on_attitude(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    if sample[0].instance != 0:
        return tally(state, ATTITUDE, IGNORED)
    verdict = judge_attitude(state, sample)
    if verdict == USED:
        place(state, ATTITUDE, 0, sample[0].time_us)
        if params[0].vehicle_attitude == 1:
            attitude_vehicle(state, sample)
    return tally(state, ATTITUDE, verdict)


@step
def on_pressure(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    s, p = state[0], params[0]
    if sample[0].instance != 0:
        return tally(state, PRESSURE, IGNORED)
    verdict = judge_pressure(state, sample, LOWEST_PA, HIGHEST_PA)
    if verdict != USED:
        return tally(state, PRESSURE, verdict)
    time_us = sample[0].time_us
    place(state, PRESSURE, 0, time_us)
    advance(state, params, time_us)
    baro_m = baro_altitude_m(sample[0].pressure_pa)
    late_s = (s.filter_us - time_us) * 1e-6
    if s.baro_seen == 0:
        for i in range(FILTERS):
            expect_baro(s.x[i], s.P[i], baro_m, p.offset_sd_m * p.offset_sd_m, p.scale_sd * p.scale_sd)
        s.baro_seen = 1
    elif sample[0].pressure_pa == s.baro_pa:
        write_estimate(state, params, estimate)
        return tally(state, PRESSURE, USED)  # the same value again is no measurement
    else:
        s.baro_median_m = track(s.baro_median_m, baro_m - s.baro_m - (s.path_m - s.baro_path_m))
    s.baro_m, s.baro_pa, s.baro_path_m = baro_m, sample[0].pressure_pa, s.path_m
    white = max(p.baro_sd_m, MEDIAN_TO_SD * s.baro_median_m / math.sqrt(2.0))
    R = white * white
    sees_height(s.H, late_s)
    s.H[OFFSET] = 1.0
    s.H[FAST] = 1.0
    reacquire(state, baro_m, R)
    for i in range(BANK):
        innovation = baro_m - dot(s.H, s.x[i])
        spread = gather(s.P[i], s.H, s.K)
        S = spread + inflated(innovation, spread + R, R, BARO_GATE)
        absorb(s.x[i], s.P[i], s.K, innovation, S)
        s.evidence[i] -= 0.5 * (math.log(S) + innovation * innovation / S)
    write_estimate(state, params, estimate)
    return tally(state, PRESSURE, USED)


@step
def on_gnss(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    s, p = state[0], params[0]
    if sample[0].instance != 0:
        return tally(state, GNSS, IGNORED)
    verdict = judge_gnss(state, sample)
    if verdict != USED:
        return tally(state, GNSS, verdict)
    time_us = sample[0].time_us
    place(state, GNSS, 0, time_us)
    attitude_gnss(state, sample)
    if s.filter_us < time_us:
        advance(state, params, time_us)
    late_s = (s.filter_us - time_us) * 1e-6
    sd = gnss_sd_m(sample, 0.0, p.gnss_sd_unknown_m)
    slow = max(p.gnss_slow_floor_m, p.gnss_slow_share * sd)
    white = max(p.gnss_white_floor_m, p.gnss_white_share * sd)
    R = white * white
    grown = slow * slow - s.gnss_steady_m2
    s.gnss_steady_m2 = slow * slow
    for i in range(FILTERS):
        s.steady[i, GNSS_BIAS] = slow * slow
        s.P[i, GNSS_BIAS, GNSS_BIAS] += max(0.0, grown)
    back = late_s * s.V - (s.S - at(s.fallen_us, s.fallen_values, time_us, BLIND_US)) if late_s > 0.0 else 0.0
    if math.isnan(back):
        back = 0.0
    sees_height(s.H, late_s)
    s.H[GNSS_BIAS] = 1.0
    combine(state)
    s.innovation_m = sample[0].altitude_amsl_m - back - dot(s.H, s.mean)
    S = R + gather(s.cov, s.H, s.K)
    if s.innovation_m * s.innovation_m > GNSS_GATE * GNSS_GATE * S:
        verdict = GATED
    else:
        for i in range(BANK):
            innovation = sample[0].altitude_amsl_m - back - dot(s.H, s.x[i])
            S = R + gather(s.P[i], s.H, s.K)
            absorb(s.x[i], s.P[i], s.K, innovation, S)
            s.evidence[i] -= 0.5 * (math.log(S) + innovation * innovation / S)
        climb = sample[0].climb_mps
        if -200.0 < climb < 200.0:
            gained = 0.0 if math.isnan(s.up_mps2) else s.up_mps2 * late_s
            sees_climb(s.H, late_s)
            for i in range(BANK):
                innovation = climb + gained - dot(s.H, s.x[i])
                spread = gather(s.P[i], s.H, s.K)
                S = spread + inflated(innovation, spread + p.gnss_climb_sd_mps**2, p.gnss_climb_sd_mps**2, BARO_GATE)
                absorb(s.x[i], s.P[i], s.K, innovation, S)
                s.evidence[i] -= 0.5 * (math.log(S) + innovation * innovation / S)
    write_estimate(state, params, estimate)
    return tally(state, GNSS, verdict)


@step
def reacquire(state: Rows, baro_m: float, R: float) -> None:
    """After `BARO_CLIPPED` innovations beyond the gate on one side, the offset has jumped: learn it anew."""
    s = state[0]
    combine(state)
    innovation = baro_m - dot(s.H, s.mean)
    if innovation * innovation <= BARO_GATE * BARO_GATE * (gather(s.cov, s.H, s.K) + R):
        s.baro_clipped = 0
        return
    side = 1 if innovation > 0.0 else -1
    s.baro_clipped = s.baro_clipped + side if s.baro_clipped * side > 0 else side
    if abs(s.baro_clipped) >= BARO_CLIPPED:
        s.baro_clipped = 0
        for i in range(FILTERS):
            s.P[i, OFFSET, OFFSET] += innovation * innovation


@step
def on_status(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A reboot restarts the vehicle's clock: start anew."""
    if sample[0].reboot == 1:
        start(state, params)
        forget(estimate)
    return tally(state, STATUS, USED)


@step
def write_estimate(state: Rows, params: Rows, estimate: Rows) -> None:
    s, e = state[0], estimate[0]
    combine(state)
    e.time_us = s.filter_us
    e.altitude_amsl_m = s.mean[HEIGHT]
    e.climb_mps = s.mean[CLIMB]
    e.altitude_sd_m = math.sqrt(s.cov[HEIGHT, HEIGHT])
    e.climb_sd_mps = math.sqrt(s.cov[CLIMB, CLIMB])
    e.baro_offset_m = -s.mean[OFFSET]
    e.baro_rate_mps = s.mean[RATE]
    e.baro_scale = s.mean[SCALE]
    e.gnss_offset_m = s.mean[GNSS_BIAS]
    e.innovation_m = s.innovation_m
    for i in range(BANK):
        e.drift_probabilities[i] = s.probability[i]


@step
def run(state: Rows, params: Rows, tables: Tables, estimates: Rows, verdicts: Rows) -> None:
    """The steps over a whole log, in order of arrival."""
    estimate = estimates[:0]
    for i in range(tables.order.size):
        kind, row = tables.order[i].kind, tables.order[i].row
        if i > 0:
            estimates[i] = estimates[i - 1]
        estimate = estimates[i : i + 1]
        if kind == IMU:
            verdicts[i] = on_imu(state, params, tables.imu[row : row + 1], estimate)
        elif kind == PRESSURE:
            verdicts[i] = on_pressure(state, params, tables.pressure[row : row + 1], estimate)
        elif kind == GNSS:
            verdicts[i] = on_gnss(state, params, tables.gnss[row : row + 1], estimate)
        elif kind == ATTITUDE:
            verdicts[i] = on_attitude(state, params, tables.attitude[row : row + 1], estimate)
        elif kind == STATUS:
            verdicts[i] = on_status(state, params, tables.status[row : row + 1], estimate)


METHOD = Method(
    name="vertical-bank",
    summary="bank of eight-state vertical channels over weather drift rates, with integrity monitoring",
    citation="Kollsman",
    settings=VerticalBankSettings,
    state=STATE,
    init=init,
    steps={
        Kind.IMU: on_imu,
        Kind.PRESSURE: on_pressure,
        Kind.GNSS: on_gnss,
        Kind.ATTITUDE: on_attitude,
        Kind.STATUS: on_status,
    },
    run=run,
    datum_invariant=False,
    follows_baro_step=True,
)
