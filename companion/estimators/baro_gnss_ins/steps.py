"""Steps of the estimator `companion.estimators.baro_gnss_ins`, whose docstring has paper, letters
and departures."""

import math

from companion.estimators.baro_gnss_ins.barometer import (
    BAROMETER,
    barometer_start,
    correct_baro,
    correct_offset,
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
from companion.estimators.baro_gnss_ins.fixes import FIXES, fixes_start, fuse_height, resume_fixes
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
    AIR,
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
    score,
    state_dtype,
    tally,
)
from companion.estimators.method import Method
from companion.estimators.outage import (
    GAP_S,
    OUTAGE,
    extrapolated_m2,
    growth_m2,
    moved_m2,
    note_difference,
    outage_start,
)
from companion.estimators.setting import (
    SETTING,
    admit_setting,
    note_air,
    setting_start,
)
from companion.jit import step
from companion.kernels.atmosphere import baro_altitude_m
from companion.kernels.attitude import (
    attitude_gnss,
    attitude_imu,
    attitude_vehicle,
    imu_can_be_integrated,
)
from companion.kernels.gnss import gnss_sd_m
from companion.samples import Kind, Rows, Tables, readable, rows

LOWEST_PA, HIGHEST_PA = 1_000.0, 120_000.0
FRESH_US = 2_000_000
VEHICLE_TILT_SD_RAD, VEHICLE_YAW_SD_RAD = 0.03, 0.1
VEHICLE_TIME_S = 5.0
"""Correlation time of the errors of the autopilot's attitude."""

STATE = state_dtype(
    ("setting", SETTING),
    ("outage", OUTAGE),
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
    setting_start(s.setting)
    outage_start(s.outage)
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
    verdict = correct_baro(s.ins, s.baro, params, dt_b, elapsed_s, is_news, gnss_serves(state))
    if s.setting.is_new == 1:
        correct_offset(s.ins, s.baro, s.setting, time_us)
    inject(s.ins, params)
    write_estimate(state, params, estimate)
    return tally(state, PRESSURE, verdict)


@step
def on_gnss(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """Height, horizontal position, velocity and course of a fix, against the state at its own
    time."""
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
    baro_m = baro_at_m(state, time_us)
    if elapsed_s > GAP_S and s.fixes.gnss_sd_m > 0.0:
        resume_fixes(s.ins, s.fixes, moved_m2(s.outage, time_us, baro_m))
    sd_m, down = gnss_sd_m(sample, p.gnss_sd_floor_m, p.gnss_sd_unknown_m), POSITION + DOWN
    S = s.ins.P[down, down] + sd_m * sd_m
    score(state, sample[0].altitude_amsl_m - s.ins.track.at[2], S)
    verdict = fuse_height(s.ins, s.fixes, params, sample, age_s, elapsed_s, weight)
    if verdict == USED and not math.isnan(baro_m):
        note_difference(
            s.outage,
            time_us,
            sample[0].altitude_amsl_m,
            baro_m,
            sample[0].ground_speed_mps,
            s.fixes.gnss_sd_m,
        )
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
def baro_at_m(state: Rows, time_us: int) -> float:
    """The barometer's height at a time near the newest pressure; NaN when that is far."""
    s = state[0]
    if abs(s.last_us[PRESSURE, 0] - time_us) > FRESH_US:
        return math.nan
    apart_s = (s.last_us[PRESSURE, 0] - time_us) * 1e-6
    return float(s.baro.h_p_m + s.ins.velocity_n_mps[DOWN] * apart_s)


@step
def gnss_serves(state: Rows) -> bool:
    """Whether the newest fix is fresh and its height was accepted."""
    s = state[0]
    fresh = s.now_us - s.last_us[GNSS, 0] < FRESH_US and s.last_us[GNSS, 0] >= 0
    return fresh and s.fixes.gnss_sd_m > 0.0 and s.fixes.contradicted_s <= 0.0


@step
def on_air(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A setting of the altimeter waits for the next pressure. A temperature alone is IGNORED."""
    s = state[0]
    verdict = admit_setting(state, sample, False)
    if verdict != USED:
        return verdict
    note_air(s.setting, sample, not math.isnan(s.baro.h_p_m))
    return verdict


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
    moved = growth_m2(s.outage, ins.time_us, s.baro.h_p_m)
    moved += extrapolated_m2(s.outage, s.baro.h_p_m)
    estimate[0].time_us = ins.time_us
    estimate[0].altitude_amsl_m = ins.position[2]
    estimate[0].climb_mps = -ins.velocity_n_mps[DOWN]
    estimate[0].altitude_sd_m = math.sqrt(
        ins.P[down, down] + slow_var + fixes.disputed_m * fixes.disputed_m + moved
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
        elif kind == AIR:
            verdicts[i] = on_air(state, params, tables.air[row : row + 1], estimate)
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
        Kind.AIR: on_air,
        Kind.STATUS: on_status,
    },
    run=run,
    datum_invariant=False,
    follows_baro_step=True,
    tunable=(
        "baro_sd_m",
        "baro_walk_m_rts",
        "baro_scale_walk_rts",
        "gnss_sd_floor_m",
        "accel_noise_mps2_rthz",
        "accel_walk_mps2_rts",
        "coast_noise_mps2_rthz",
    ),
    optional=frozenset({Kind.ATTITUDE}),
)
