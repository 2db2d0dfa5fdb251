"""Barometer in a GNSS/INS extended Kalman filter.

P. F. Roysdon, J. A. Farrell, "Technical Note: Summary of Baro Pressure for GPS-INS Vertical Channel
Stability". The paper's letters:

==================  ========================  ==========================================================
h_p                 ``h_p``                   barometric altitude (12), here closed-form
p, v, q             ``position_radm`` ...     position, velocity, attitude quaternion of (14)
b_a, b_g            ``force_bias_mps2`` ...   accelerometer and gyroscope bias of (14)
b_bb, b_bsf         ``b_m, s``                barometer bias and scale factor: h = h_p + b + s h_p
dP_d, dv_d          ``dx[2], dx[5]``          errors of the vertical channel, north-east-down
dt_b                ``dt_b``                  barometer's time less the state's
z, H                ``z, H``                  baro residual (15) and its row (16)
sigma_b^2           ``baro_sd_m``             1.0 m2 (the paper prints "1.0 m")
==================  ========================  ==========================================================

State: seventeen errors, true minus estimated; the first fifteen are those of
`companion.estimators.baro_gnss_ins.strapdown`, then b and s. The paper's n_s = 20 counts four
numbers of the quaternion (three errors here) and the receiver's clock bias and drift. Those two
need pseudoranges: GPS_RAW_INT has none, so this filter is loosely coupled and has no clock states.
"Fewer than four satellites" is then a time without fixes.

How it runs: RAW_IMU drives the mechanisation; each pressure and each fix corrects it. Attitude is
aligned in motion by `companion.kernels.attitude`: roll and pitch from specific force less the
acceleration that GNSS shows, yaw from the course once the vehicle moves, before that with a spread
of half a turn, which leaves the vertical channel as good as it is at rest. Before alignment, below
10 Hz of IMU (verdict IGNORED), in gaps of it, or a minute without GNSS velocity, the same state
runs as height, climb and barometer errors under white acceleration
(`companion.estimators.baro_gnss_ins.filter`). ATTITUDE is not used unless the settings say so.

Errata
------
- (12) is off by -251.6 m at sea level and by kilometres at the ends of its range: kept as
  `cubic_altitude_m`, not used.
- (11): an inch of mercury has 3386.389 Pa. (13): its derivative is positive, and is taken at the
  measured pressure.
- (8) gives the height above ground the wrong sign: it should read (p_ground - p) / (rho g).
- (15) and (16) agree, and b is what is added to the barometer, not its error.
- h_m in (16) must not follow the measured altitude. Its noise is also in z, and the product drives
  s steadily down (a minute of 5 m noise at 20 Hz: s = -0.6); and a row that changes from sample to
  sample makes b and s look separable in level flight. Here h_m is held until the altitude has
  changed by 10 m.

Departures
----------
- The 5 Pa gate between samples is replaced by one against the trend
  (`companion.estimators.baro_gnss_ins.spikes`), which neither forbids climbs nor latches. Its 8 Pa
  grow with the sensor's noise and with the sample interval. Where it had to learn a jump, b's
  variance grows by the square of it.
- b and s cannot be told apart in level flight, so s has a prior: temperatures that are 4 % from
  standard (11 K), as in recorded flights (-7 to +1 %). b has one of 100 m, 12 hPa. b walks 0.3
  m/sqrt(s), 18 m an hour: a fast front.
- sigma_b is the least: a sensor that is noisier than that, as its trend shows, gets its own noise.
- A pressure equal to the last one is no news (autopilots repeat their newest value) and corrects
  nothing.
- Innovations of the barometer beyond 3 sigma count as if they were at 3 sigma; fifteen of them in a
  row on one side are a step, which b takes; three seconds of them are a wrong IMU, which then rests
  for 30 s (verdict GATED).
- GNSS heights beyond 3 sigma of the claimed accuracy are GATED until they have lasted
  (`take_height`), never for good.
- A fix is late: it meets the state of its own time (`companion.estimators.baro_gnss_ins.track`),
  with its age in H as dt_b in (16).
- GNSS errors are correlated in time: fixes within 2 s count as one (R grows by 2 s / interval), and
  three quarters of the claimed variance are added to that of the state in ``altitude_sd_m``, since
  no averaging removes them.

Breaks when
-----------
The receiver's slow error exceeds what it claims: the height follows it within a minute. The air's scale error changes
with height (an inversion): s is one number. The vehicle moves across its nose (multirotors): the course is no heading;
when the velocities contradict for 5 s the IMU rests and is aligned again.
"""

import math
from typing import Literal

import numpy as np
from pydantic import Field

from companion.config import Settings
from companion.estimators.baro_gnss_ins.corrections import (
    correct_climb,
    correct_height,
    correct_horizontal,
    correct_tilt,
    correct_yaw,
    watch_height,
)
from companion.estimators.baro_gnss_ins.filter import (
    BARO_BIAS,
    BARO_SCALE,
    DOWN,
    GATE,
    begin,
    carry,
    catch_up,
    inject,
    ins_fields,
    ins_start,
    set_yaw,
    suspend,
    widen_common,
)
from companion.estimators.baro_gnss_ins.spikes import (
    SCALE_HEIGHT_M,
    accepts,
    noise_pa,
    spike_fields,
    spike_start,
)
from companion.estimators.baro_gnss_ins.strapdown import (
    POSITION,
    VELOCITY,
    set_attitude,
    tilt_between,
    turn_body,
)
from companion.estimators.baro_gnss_ins.track import look_up
from companion.estimators.judging import (
    ATTITUDE,
    GATED,
    GNSS,
    IGNORED,
    IMU,
    PRESSURE,
    STATUS,
    USED,
    forget,
    judge_attitude,
    judge_gnss,
    judge_imu,
    judge_pressure,
    place,
    reset,
    state_dtype,
    tally,
)
from companion.estimators.method import Method
from companion.jit import step
from companion.kernels.atmosphere import (
    G0_MPS2,
    L0_KPM,
    P0_PA,
    R_AIR,
    T0_K,
    baro_altitude_m,
    pressure_altitude_m,
)
from companion.kernels.attitude import (
    attitude_gnss,
    attitude_imu,
    attitude_vehicle,
    imu_can_be_integrated,
)
from companion.kernels.gnss import gnss_sd_m
from companion.kernels.kalman import correct, inflated, spread
from companion.samples import Kind, Rows, Tables, readable, rows

LOWEST_PA, HIGHEST_PA = 1_000.0, 120_000.0
CUBIC = (-2.1558e-11, 5.0154e-6, -4.8540e-1, 1.9866e4)
"""coefficients of (12), highest power first"""
INCH_OF_MERCURY_PA = 3386.389
"""(11) prints 3385"""
HELD_M = 10.0
"""h_m of (16) is held while the altitude is this near: s is known well enough for that"""
STEP_SAMPLES = 15
LEAST_DOUBT_S, MOST_DOUBT_S = 10.0, 90.0
DOUBTFUL_GATE = 2.0
"""of fixes that follow a contradiction"""
MEAN_S = 5.0
"""time constant of the mean innovation of GNSS heights; while it is beyond one sigma, they do not
agree"""
DISPUTE_S = 30.0
VEHICLE_TILT_SD_RAD, VEHICLE_YAW_SD_RAD = 0.03, 0.1
VEHICLE_TIME_S = 5.0
"""the autopilot's attitude errors stay the same for about this long"""

STATE = state_dtype(
    *ins_fields(),
    *spike_fields(),
    ("pressure_pa", "f8"),  # the last one, NaN none
    ("h_p_m", "f8"),  # its altitude
    ("h_m", "f8"),  # the altitude in H, held in level flight
    (
        "one_sided",
        "i8",
    ),  # innovations beyond the gate in a row: positive or negative, by their side
    ("gnss_sd_m", "f8"),  # claimed by the last fix that was used, NaN none
    ("agreed_s", "f8"),  # for how long fixes have agreed, and contradicted since
    ("contradicted_s", "f8"),
    ("innovation_m", "f8"),  # of the last fix, and its mean over those used
    ("mean_innovation_m", "f8"),
    ("jumped", "i8"),  # 1 when the present contradiction began between two fixes
    ("disputed_m", "f8"),  # how far h moved when it was refuted; decays
    ("vehicle_quaternion", "f8", (4,)),
)

PARAMS = np.dtype(
    [
        ("use_vehicle_attitude", "i8"),
        ("baro_sd_m", "f8"),
        ("baro_bias_sd_m", "f8"),
        ("baro_walk_m_rts", "f8"),
        ("baro_scale_sd_ratio", "f8"),
        ("baro_scale_walk_rts", "f8"),
        ("spike_gate_pa", "f8"),
        ("gnss_sd_floor_m", "f8"),
        ("gnss_sd_unknown_m", "f8"),
        ("gnss_velocity_sd_mps", "f8"),
        ("gnss_correlation_s", "f8"),
        ("gnss_correlated_ratio", "f8"),
        ("accel_noise_mps2_rthz", "f8"),
        ("accel_bias_sd_mps2", "f8"),
        ("accel_walk_mps2_rts", "f8"),
        ("gyro_noise_radps_rthz", "f8"),
        ("gyro_bias_sd_radps", "f8"),
        ("gyro_walk_radps_rts", "f8"),
        ("coast_noise_mps2_rthz", "f8"),
    ],
    align=True,
)


class BaroGnssInsSettings(Settings):
    """Section ``estimators.baro-gnss-ins``."""

    attitude: Literal["own", "vehicle"] = "own"
    """where attitude comes from: aligned in motion from the IMU and GNSS, or also the vehicle's
    ATTITUDE"""
    baro_sd_m: float = Field(1.0, gt=0, le=100)
    """white error of a pressure altitude (the paper's sigma_b)"""
    baro_bias_sd_m: float = Field(100.0, gt=0, le=1000)
    """prior of the barometer's bias: 12 hPa of weather"""
    baro_walk_m_rts: float = Field(0.3, ge=0, le=10)
    """random walk of the bias, per root second: 18 m in an hour"""
    baro_scale_sd_ratio: float = Field(0.04, ge=0, le=1)
    """prior of the barometer's scale factor: air 11 K from standard"""
    baro_scale_walk_rts: float = Field(1e-4, ge=0, le=0.1)
    """random walk of the scale factor, per root second: 2 K in an hour"""
    spike_gate_pa: float = Field(8.0, gt=0, le=1000)
    """least deviation from the trend that makes a pressure a spike"""
    gnss_sd_floor_m: float = Field(2.0, gt=0, le=100)
    """a claimed spread below this is not believed"""
    gnss_sd_unknown_m: float = Field(10.0, gt=0, le=1000)
    """spread of a receiver that claims nothing"""
    gnss_velocity_sd_mps: float = Field(0.3, gt=0, le=10)
    """spread of GNSS velocity, lateness within a manoeuvre included"""
    gnss_correlation_s: float = Field(2.0, ge=0, le=600)
    """fixes within this time count as one"""
    gnss_correlated_ratio: float = Field(0.75, ge=0, le=1)
    """share of the claimed variance that no averaging removes: added to the reported spread"""
    accel_noise_mps2_rthz: float = Field(0.05, gt=0, le=10)
    """white noise of the accelerometers on an airframe with a running motor"""
    accel_bias_sd_mps2: float = Field(0.2, gt=0, le=10)
    """prior of their bias: 20 mg"""
    accel_walk_mps2_rts: float = Field(1e-3, ge=0, le=1)
    """random walk of their bias, per root second"""
    gyro_noise_radps_rthz: float = Field(2e-3, gt=0, le=1)
    """white noise of the gyros, on the same airframe"""
    gyro_bias_sd_radps: float = Field(0.02, gt=0, le=1)
    """prior of their bias: 1 degree a second"""
    gyro_walk_radps_rts: float = Field(1e-4, ge=0, le=1)
    """random walk of their bias, per root second"""
    coast_noise_mps2_rthz: float = Field(1.5, gt=0, le=10)
    """white acceleration of the vehicle while no IMU tells it"""

    def params(self) -> Rows:
        row = rows(PARAMS)
        row["use_vehicle_attitude"] = self.attitude == "vehicle"
        for name in (PARAMS.names or ())[1:]:
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
    s = state[0]
    reset(state)
    ins_start(state, params)
    spike_start(state, params[0].spike_gate_pa)
    s.pressure_pa, s.h_p_m, s.h_m = math.nan, math.nan, math.nan
    s.gnss_sd_m, s.innovation_m = math.nan, math.nan
    s.one_sided = 0
    s.mean_innovation_m, s.disputed_m, s.jumped = 0.0, 0.0, 0
    set_attitude(s.vehicle_quaternion, 0.0, 0.0, 0.0)
    s.agreed_s, s.contradicted_s = 0.0, 0.0


# The paper's altimetry


@step
def cubic_altitude_m(pressure_pa: float) -> float:
    """Barometric altitude by the third-order fit (12), as printed.

    Not used: wrong by -251.6 m at 1013.25 hPa, by -1216 m at -1 km, by -1653 m at 18.3 km, and 60 %
    too steep at sea level. The closed form is `companion.kernels.atmosphere.pressure_altitude_m`.
    """
    return ((CUBIC[0] * pressure_pa + CUBIC[1]) * pressure_pa + CUBIC[2]) * pressure_pa + CUBIC[3]


@step
def kollsman_slope_mppa(pressure_pa: float, sea_level_pa: float) -> float:
    """dh/dp_sl of (13): metres that the indicated altitude gains for each pascal of sea-level
    pressure.

    (R T0 / (g p_sl)) (p / p_sl)^(R L / g), positive, taken at the measured pressure: in the
    troposphere.
    """
    height_scale_m = R_AIR * T0_K / G0_MPS2
    return (
        height_scale_m
        / sea_level_pa
        * math.pow(pressure_pa / sea_level_pa, -R_AIR * L0_KPM / G0_MPS2)
    )


@step
def kollsman_altitude_m(pressure_pa: float, setting_pa: float) -> float:
    """(13): geopotential altitude for a sea-level pressure `setting_pa`, h_std + dh/dp_sl (p_k -
    p_std).

    First order: 0.9 m short of 500 m for a setting of 1000 hPa. The filter does not use it, as the
    paper says: b takes the place of p_k.
    """
    slope = kollsman_slope_mppa(pressure_pa, P0_PA)
    return pressure_altitude_m(pressure_pa) + slope * (setting_pa - P0_PA)


# Steps


@step
def on_imu(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """Carry position, velocity and attitude on."""
    if sample[0].instance != 0:
        return tally(state, IMU, IGNORED)
    verdict = judge_imu(state, sample)
    if verdict != USED:
        return tally(state, IMU, verdict)
    place(state, IMU, 0, sample[0].time_us)
    attitude_imu(state[0].attitude, sample)
    if not imu_can_be_integrated(state[0].attitude):
        state[0].inertial = 0
        return tally(state, IMU, IGNORED)
    if state[0].time_us >= 0:
        carry(state, params, sample)
        write_estimate(state, params, estimate)
    return tally(state, IMU, GATED if sample[0].time_us < state[0].rest_us else USED)


@step
def on_pressure(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """Spike gate, then the baro residual (15) with its row (16)."""
    s = state[0]
    if sample[0].instance != 0:
        return tally(state, PRESSURE, IGNORED)
    verdict = judge_pressure(state, sample, LOWEST_PA, HIGHEST_PA)
    if verdict != USED:
        return tally(state, PRESSURE, verdict)
    time_us, pressure_pa = sample[0].time_us, sample[0].pressure_pa
    elapsed_s = (time_us - s.last_us[PRESSURE, 0]) * 1e-6 if s.last_us[PRESSURE, 0] >= 0 else 0.0
    place(state, PRESSURE, 0, time_us)
    is_news = pressure_pa != s.pressure_pa
    s.pressure_pa = pressure_pa
    if is_news and not accepts(state, time_us, pressure_pa, params[0].spike_gate_pa):
        jump_m = s.spike_jump_pa * SCALE_HEIGHT_M / pressure_pa
        s.P[BARO_BIAS, BARO_BIAS] += jump_m * jump_m
        return tally(state, PRESSURE, GATED)
    s.h_p_m = baro_altitude_m(pressure_pa)
    if s.time_us < 0:
        begin(state, time_us, s.h_p_m)
    catch_up(state, params, time_us)
    verdict = correct_baro(state, params, (time_us - s.time_us) * 1e-6, elapsed_s, is_news)
    inject(state, params)
    write_estimate(state, params, estimate)
    return tally(state, PRESSURE, verdict)


@step
def correct_baro(state: Rows, params: Rows, dt_b: float, elapsed_s: float, is_news: bool) -> int:
    """The residual z of (15) with the row H of (16); `dt_b` is the barometer's time less the
    state's.

    GATED is only what repeats an old value and contradicts the state.
    """
    s = state[0]
    h_p, H = s.h_p_m, s.H
    z = h_p - (s.position[2] - s.velocity_n_mps[DOWN] * dt_b - s.b_m - s.s * h_p)
    expected_m = (s.position[2] - s.velocity_n_mps[DOWN] * dt_b - s.b_m) / (1.0 + s.s)
    if not abs(expected_m - s.h_m) <= HELD_M:
        s.h_m = expected_m
    H[POSITION + DOWN], H[VELOCITY + DOWN], H[BARO_BIAS], H[BARO_SCALE] = -1.0, -dt_b, -1.0, -s.h_m
    sd_m = max(params[0].baro_sd_m, noise_pa(state, elapsed_s) * SCALE_HEIGHT_M / s.pressure_pa)
    R = sd_m * sd_m
    S = spread(s.P, H) + R
    beyond = z * z > GATE * GATE * S
    if is_news:
        side = 1 if z > 0.0 else -1
        s.one_sided = (s.one_sided + side if s.one_sided * side > 0 else side) if beyond else 0
        if abs(s.one_sided) >= STEP_SAMPLES:
            s.P[BARO_BIAS, BARO_BIAS] += z * z
            S += z * z
            s.one_sided = 0
        correct(s.dx, s.P, H, s.K, z, inflated(z, S, R, GATE))
        watch_height(state, params, z, S, elapsed_s)
    for i in range(H.size):
        H[i] = 0.0
    return GATED if beyond and not is_news else USED


@step
def on_gnss(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """Height, horizontal position, velocity and course of a fix, against the state at its own time."""
    s, p = state[0], params[0]
    if sample[0].instance != 0:
        return tally(state, GNSS, IGNORED)
    verdict = judge_gnss(state, sample)
    if verdict != USED:
        return tally(state, GNSS, verdict)
    time_us = sample[0].time_us
    elapsed_s = (time_us - s.last_us[GNSS, 0]) * 1e-6 if s.last_us[GNSS, 0] >= 0 else math.inf
    place(state, GNSS, 0, time_us)
    attitude_gnss(state[0].attitude, sample)
    if s.time_us < 0:
        begin(state, time_us, sample[0].altitude_amsl_m)
    catch_up(state, params, time_us)
    age_s = (s.time_us - time_us) * 1e-6
    look_up(s.track_us, s.track, s.time_us, s.position, s.velocity_n_mps, time_us, s.track_at)
    weight = max(1.0, p.gnss_correlation_s / elapsed_s)
    verdict = take_height(state, params, sample, age_s, elapsed_s, weight)
    if sample[0].climb_mps == sample[0].climb_mps:
        correct_climb(
            state,
            sample[0].climb_mps + s.track_at[5],
            p.gnss_velocity_sd_mps * p.gnss_velocity_sd_mps,
        )
    correct_horizontal(state, params, sample, age_s, weight)
    if s.inertial == 1 and p.use_vehicle_attitude == 0:
        correct_yaw(state, sample, elapsed_s)
    inject(state, params)
    write_estimate(state, params, estimate)
    return tally(state, GNSS, verdict)


@step
def take_height(
    state: Rows, params: Rows, sample: Rows, age_s: float, elapsed_s: float, weight: float
) -> int:
    """A fix's height: GATED while it contradicts, until that has lasted; then h and b move to it
    together.

    The first fix does so at once. A contradiction that grew slowly (the barometer drifts) needs ten
    seconds. A receiver that jumped must contradict for as long as it had agreed before, half a
    minute at most; and then it stays in the reported spread for a while that one of the two was
    wrong.
    """
    s, p = state[0], params[0]
    down = POSITION + DOWN
    sd_m = gnss_sd_m(sample, p.gnss_sd_floor_m, p.gnss_sd_unknown_m)
    z = sample[0].altitude_amsl_m - s.track_at[2]
    s.innovation_m = z
    elapsed_s = min(elapsed_s, 1.0)
    gate = DOUBTFUL_GATE if s.contradicted_s > 0.0 else GATE
    if z * z > gate * gate * (s.P[down, down] + sd_m * sd_m):
        if s.contradicted_s <= 0.0:
            s.jumped = 1 if abs(z - s.mean_innovation_m) > GATE * sd_m else 0
        s.contradicted_s += elapsed_s
        if s.gnss_sd_m > 0.0:
            if s.contradicted_s < (
                max(LEAST_DOUBT_S, s.agreed_s) if s.jumped == 1 else LEAST_DOUBT_S
            ):
                return GATED
            s.disputed_m = abs(z)
            if s.jumped == 0 and s.inertial == 1:
                suspend(state, params)
        widen_common(s.P, z * z)
        s.agreed_s, s.contradicted_s, s.mean_innovation_m = 0.0, 0.0, 0.0
        weight = 1.0
    else:
        s.contradicted_s = max(0.0, s.contradicted_s - elapsed_s)
        s.mean_innovation_m += elapsed_s / MEAN_S * (z - s.mean_innovation_m)
        agrees = abs(s.mean_innovation_m) <= sd_m
        s.agreed_s = min(MOST_DOUBT_S, s.agreed_s + elapsed_s) if agrees else 0.0
        s.disputed_m -= elapsed_s / DISPUTE_S * s.disputed_m
    s.gnss_sd_m = sd_m
    correct_height(state, z, age_s, weight * sd_m * sd_m)
    return USED


@step
def on_attitude(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """The vehicle's own attitude, where the settings say so: alignment, then a weak correction of
    all three axes."""
    s = state[0]
    if params[0].use_vehicle_attitude == 0:
        return IGNORED
    if sample[0].instance != 0:
        return tally(state, ATTITUDE, IGNORED)
    verdict = judge_attitude(state, sample)
    if verdict != USED:
        return tally(state, ATTITUDE, verdict)
    elapsed_s = (
        (sample[0].time_us - s.last_us[ATTITUDE, 0]) * 1e-6
        if s.last_us[ATTITUDE, 0] >= 0
        else math.inf
    )
    place(state, ATTITUDE, 0, sample[0].time_us)
    attitude_vehicle(state[0].attitude, sample)
    if s.attitude.vehicle_trusted == 0:
        return tally(state, ATTITUDE, GATED)
    if s.inertial == 1 and abs(sample[0].yaw_rad) <= math.tau:
        if s.yaw_known == 0:
            set_yaw(state, sample[0].yaw_rad, VEHICLE_YAW_SD_RAD)
        correct_attitude(state, sample, max(1.0, VEHICLE_TIME_S / elapsed_s))
        inject(state, params)
        write_estimate(state, params, estimate)
    return tally(state, ATTITUDE, USED)


@step
def correct_attitude(state: Rows, sample: Rows, weight: float) -> None:
    """The rotation from our attitude to the vehicle's, axis by axis; `weight` multiplies its
    variance."""
    s = state[0]
    late_s = (s.time_us - sample[0].time_us) * 1e-6
    rate, theirs = s.rate_b_radps, s.vehicle_quaternion
    set_attitude(theirs, sample[0].roll_rad, sample[0].pitch_rad, sample[0].yaw_rad)
    turn_body(theirs, rate[0] * late_s, rate[1] * late_s, rate[2] * late_s)
    for axis in range(3):
        sd_rad = VEHICLE_YAW_SD_RAD if axis == DOWN else VEHICLE_TILT_SD_RAD
        correct_tilt(
            state, axis, tilt_between(s.quaternion, theirs, axis), weight * sd_rad * sd_rad
        )


@step
def on_status(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A reboot restarts the vehicle's clock: start anew."""
    if sample[0].reboot == 1:
        start(state, params)
        forget(estimate)
    return tally(state, STATUS, USED)


@step
def write_estimate(state: Rows, params: Rows, estimate: Rows) -> None:
    """Height and climb of the state; its spread and that of the receiver's slow error."""
    s, down = state[0], POSITION + DOWN
    if s.time_us < 0:
        forget(estimate)
        return
    slow_var = 0.0
    if s.gnss_sd_m > 0.0:
        slow_var = params[0].gnss_correlated_ratio * s.gnss_sd_m * s.gnss_sd_m
    estimate[0].time_us = s.time_us
    estimate[0].altitude_amsl_m = s.position[2]
    estimate[0].climb_mps = -s.velocity_n_mps[DOWN]
    estimate[0].altitude_sd_m = math.sqrt(s.P[down, down] + slow_var + s.disputed_m * s.disputed_m)
    estimate[0].climb_sd_mps = math.sqrt(s.P[VELOCITY + DOWN, VELOCITY + DOWN])
    estimate[0].baro_offset_m = s.b_m + s.s * s.h_p_m
    estimate[0].innovation_m = s.innovation_m
    estimate[0].baro_scale = -s.s / (1.0 + s.s)


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
    name="baro-gnss-ins",
    summary="error-state GNSS/INS Kalman filter with barometer bias and scale factor",
    citation="Roysdon, Farrell: Technical Note",
    settings=BaroGnssInsSettings,
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
    optional=frozenset({Kind.ATTITUDE}),
)
