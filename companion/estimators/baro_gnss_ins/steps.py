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
  `altimetry.cubic_altitude_m`, not used.
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
  (`fixes.fuse_height`), never for good.
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

from companion.estimators.baro_gnss_ins.barometer import (
    BAROMETER,
    barometer_start,
    correct_baro,
    is_spike,
)
from companion.estimators.baro_gnss_ins.corrections import (
    correct_climb,
    correct_horizontal,
    correct_tilt,
    correct_yaw,
)
from companion.estimators.baro_gnss_ins.filter import (
    DOWN,
    INS,
    begin,
    carry,
    catch_up,
    inject,
    ins_start,
    set_yaw,
)
from companion.estimators.baro_gnss_ins.fixes import FIXES, fixes_start, fuse_height
from companion.estimators.baro_gnss_ins.settings import BaroGnssInsSettings
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
from companion.kernels.atmosphere import baro_altitude_m
from companion.kernels.attitude import (
    attitude_gnss,
    attitude_imu,
    attitude_vehicle,
    imu_can_be_integrated,
)
from companion.samples import Kind, Rows, Tables, readable, rows

LOWEST_PA, HIGHEST_PA = 1_000.0, 120_000.0
VEHICLE_TILT_SD_RAD, VEHICLE_YAW_SD_RAD = 0.03, 0.1
VEHICLE_TIME_S = 5.0
"""Correlation time of the errors of the autopilot's attitude."""

STATE = state_dtype(
    ("ins", INS),
    ("baro", BAROMETER),
    ("fixes", FIXES),
    ("vehicle_quaternion", "f8", (4,)),
)


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
    ins_start(s.ins, params)
    barometer_start(s.baro, params)
    fixes_start(s.fixes)
    set_attitude(s.vehicle_quaternion, 0.0, 0.0, 0.0)


@step
def on_imu(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """Carry position, velocity and attitude on."""
    s = state[0]
    if sample[0].instance != 0:
        return tally(state, IMU, IGNORED)
    verdict = judge_imu(state, sample)
    if verdict != USED:
        return tally(state, IMU, verdict)
    place(state, IMU, 0, sample[0].time_us)
    attitude_imu(s.ins.attitude, sample)
    if not imu_can_be_integrated(s.ins.attitude):
        s.ins.inertial = 0
        return tally(state, IMU, IGNORED)
    if s.ins.time_us >= 0:
        carry(s.ins, params, sample, s.last_us[PRESSURE, 0])
        write_estimate(state, params, estimate)
    return tally(state, IMU, GATED if sample[0].time_us < s.ins.rest_us else USED)


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
    is_news = pressure_pa != s.baro.pressure_pa
    s.baro.pressure_pa = pressure_pa
    if is_news and is_spike(s.ins, s.baro, params, time_us):
        return tally(state, PRESSURE, GATED)
    s.baro.h_p_m = baro_altitude_m(pressure_pa)
    if s.ins.time_us < 0:
        begin(s.ins, time_us, s.baro.h_p_m)
    catch_up(s.ins, params, time_us)
    dt_b = (time_us - s.ins.time_us) * 1e-6
    verdict = correct_baro(s.ins, s.baro, params, dt_b, elapsed_s, is_news)
    inject(s.ins, params)
    write_estimate(state, params, estimate)
    return tally(state, PRESSURE, verdict)


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
    attitude_gnss(s.ins.attitude, sample)
    if s.ins.time_us < 0:
        begin(s.ins, time_us, sample[0].altitude_amsl_m)
    catch_up(s.ins, params, time_us)
    age_s = (s.ins.time_us - time_us) * 1e-6
    look_up(s.ins.track, s.ins.time_us, s.ins.position, s.ins.velocity_n_mps, time_us)
    weight = max(1.0, p.gnss_correlation_s / elapsed_s)
    verdict = fuse_height(s.ins, s.fixes, params, sample, age_s, elapsed_s, weight)
    if sample[0].climb_mps == sample[0].climb_mps:
        correct_climb(
            s.ins,
            sample[0].climb_mps + s.ins.track.at[5],
            p.gnss_velocity_sd_mps * p.gnss_velocity_sd_mps,
        )
    correct_horizontal(s.ins, params, sample, age_s, weight)
    if s.ins.inertial == 1 and p.use_vehicle_attitude == 0:
        correct_yaw(s.ins, sample, elapsed_s)
    inject(s.ins, params)
    write_estimate(state, params, estimate)
    return tally(state, GNSS, verdict)


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
    attitude_vehicle(s.ins.attitude, sample)
    if s.ins.attitude.vehicle_trusted == 0:
        return tally(state, ATTITUDE, GATED)
    if s.ins.inertial == 1 and abs(sample[0].yaw_rad) <= math.tau:
        if s.ins.yaw_known == 0:
            set_yaw(s.ins, sample[0].yaw_rad, VEHICLE_YAW_SD_RAD)
        correct_attitude(state, sample, max(1.0, VEHICLE_TIME_S / elapsed_s))
        inject(s.ins, params)
        write_estimate(state, params, estimate)
    return tally(state, ATTITUDE, USED)


@step
def correct_attitude(state: Rows, sample: Rows, weight: float) -> None:
    """The rotation from our attitude to the vehicle's, axis by axis; `weight` multiplies its
    variance."""
    s = state[0]
    late_s = (s.ins.time_us - sample[0].time_us) * 1e-6
    rate, theirs = s.ins.rate_b_radps, s.vehicle_quaternion
    set_attitude(theirs, sample[0].roll_rad, sample[0].pitch_rad, sample[0].yaw_rad)
    turn_body(theirs, rate[0] * late_s, rate[1] * late_s, rate[2] * late_s)
    for axis in range(3):
        sd_rad = VEHICLE_YAW_SD_RAD if axis == DOWN else VEHICLE_TILT_SD_RAD
        correct_tilt(
            s.ins, axis, tilt_between(s.ins.quaternion, theirs, axis), weight * sd_rad * sd_rad
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
    ins, fixes = s.ins, s.fixes
    if ins.time_us < 0:
        forget(estimate)
        return
    slow_var = 0.0
    if fixes.gnss_sd_m > 0.0:
        slow_var = params[0].gnss_correlated_ratio * fixes.gnss_sd_m * fixes.gnss_sd_m
    estimate[0].time_us = ins.time_us
    estimate[0].altitude_amsl_m = ins.position[2]
    estimate[0].climb_mps = -ins.velocity_n_mps[DOWN]
    estimate[0].altitude_sd_m = math.sqrt(
        ins.P[down, down] + slow_var + fixes.disputed_m * fixes.disputed_m
    )
    estimate[0].climb_sd_mps = math.sqrt(ins.P[VELOCITY + DOWN, VELOCITY + DOWN])
    estimate[0].baro_offset_m = ins.b_m + ins.s * s.baro.h_p_m
    estimate[0].innovation_m = fixes.innovation_m
    estimate[0].baro_scale = -ins.s / (1.0 + ins.s)


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
