"""Steps of the estimator `companion.estimators.air_data_gnss`, whose docstring has paper, letters
and departures."""

import math

from companion.estimators.air_data_gnss.error import (
    ERROR,
    compensate,
    error_start,
    lambda_update,
    note_outage,
    predict_error,
    refer_to,
    z_correct,
    z_innovation,
)
from companion.estimators.air_data_gnss.motion import (
    MOTION,
    P_H0_M2,
    correct_motion,
    motion_start,
    predict_motion,
    restart_motion,
)
from companion.estimators.air_data_gnss.settings import AirDataGnssSettings
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
    score,
    state_dtype,
    tally,
)
from companion.estimators.method import Method
from companion.estimators.outage import OUTAGE, extrapolated_m2, growth_m2, outage_start
from companion.estimators.setting import (
    SETTING,
    has_setting,
    indicated_m,
    indicated_sd_m,
    note_air,
    note_level,
    setting_start,
    waits_for_level,
)
from companion.jit import step
from companion.kernels.atmosphere import baro_altitude_m, pressure_altitude_m
from companion.kernels.gnss import gnss_sd_m
from companion.kernels.kalman import spread
from companion.kernels.ring import at, clear, push, ring_fields
from companion.samples import Kind, Rows, Tables, readable, rows

LOWEST_PA, HIGHEST_PA = 1_000.0, 120_000.0
SILENCE_US = 3_000_000
AIR_REACH_US = 10_000_000
"""Longest age of a temperature that still belongs to the height of the next pressure."""
RING_SIZE = 128  # the delay horizon of a second and more, at 100 Hz
CORRELATED_SHARE = 0.5
"""Share of the variance of a GNSS height that does not average out: ionosphere, orbits,
multipath."""

STATE = state_dtype(
    ("setting", SETTING),
    ("outage", OUTAGE),
    ("error", ERROR),
    ("motion", MOTION),
    ("gnss_alone", "i8"),
    *ring_fields("baro", RING_SIZE),  # h^B of the last second or so
    ("baro_m", "f8"),  # the newest of them
    ("temperature_k", "f8"),  # waits for the next pressure
    ("temperature_us", "i8"),  # of the newest one, -1 none
    ("fix_us", "i8"),  # a fix that waits for the next pressure, -1 none
    ("fix_m", "f8"),
    ("fix_var_m2", "f8"),  # R^GPS of the last fix
    ("slow_var_m2", "f8"),  # the part of the reported variance that does not average out
    ("since_us", "i8"),  # the first fix: how long the barometer has been awaited
)


def init(params: Rows) -> Rows:
    """A fresh state: nothing known."""
    state = rows(STATE)
    start(state, params)
    return readable(state)


@step
def start(state: Rows, params: Rows) -> None:
    """Forget everything but the counters."""
    s = state[0]
    reset(state)
    clear(s.baro_us, s.baro_values)
    setting_start(s.setting)
    outage_start(s.outage)
    error_start(s.error, params)
    motion_start(s.motion)
    s.fix_us, s.since_us, s.temperature_us = -1, -1, -1
    s.gnss_alone = 0
    s.baro_m, s.temperature_k = math.nan, math.nan
    s.fix_m, s.fix_var_m2, s.slow_var_m2 = math.nan, math.nan, 0.0


@step
def baro_at(state: Rows, time_us: int) -> float:
    """h^B at an instant, carried on with the climb when that is newer than the newest; NaN when
    there is none near."""
    s = state[0]
    baro = at(s.baro_us, s.baro_values, time_us, SILENCE_US)
    newer_s = max(0.0, (time_us - s.last_us[PRESSURE, 0]) * 1e-6)
    return baro + (1.0 + s.error.x[0]) * s.motion.x[1] * newer_s


@step
def z_update(state: Rows, params: Rows, time_us: int, fix_m: float, R_GPS: float) -> int:
    """A height of variance R_GPS against the barometer at its own time; STALE when none is near."""
    s = state[0]
    baro = baro_at(state, time_us)
    if math.isnan(baro):
        return STALE
    innovation = z_innovation(s.error, s.motion, params, s.baro_m - baro, baro, fix_m)
    score(state, innovation, spread(s.error.P, s.error.H) + params[0].R_B + R_GPS)
    return z_correct(s.error, s.motion, params, time_us, innovation, R_GPS)


@step
def fuse_waiting_fix(state: Rows, params: Rows) -> None:
    """The z-update of the fix that waited for the barometer."""
    s = state[0]
    if s.fix_us >= 0:
        z_update(state, params, s.fix_us, s.fix_m, s.fix_var_m2)
        s.fix_us = -1


@step
def fuse_setting(state: Rows, params: Rows, pressure_pa: float) -> None:
    """The z-update of a new setting of the altimeter, as one fix at the indicated altitude, where
    it tells more than is known. The field of the setting becomes H_0, with T_0 there. The elevation
    of a vehicle at rest tells more: what b is beside it is the slow error of the fixes before,
    which P does not know."""
    s = state[0]
    if s.setting.is_new == 0:
        return
    s.setting.is_new = 0
    at_rest = waits_for_level(s.setting)
    level_m = pressure_altitude_m(pressure_pa)
    note_level(s.setting, level_m)
    refer_to(s.error, params, s.setting.field_m)
    altitude_m = indicated_m(s.setting, level_m)
    sd_m = indicated_sd_m(s.setting, altitude_m, s.now_us)
    s.error.H[0], s.error.H[1] = s.motion.x[0] - s.error.H_0, 1.0
    if at_rest:
        s.error.P[1, 1] += (s.motion.x[0] - altitude_m) ** 2
    if sd_m * sd_m < spread(s.error.P, s.error.H):
        z_update(state, params, s.last_us[PRESSURE, 0], altitude_m, sd_m * sd_m)


@step
def fuse_temperature(state: Rows, params: Rows, die_temperature_k: float, time_us: int) -> None:
    """The lambda-update with the temperature that waits, else with that of the die where it is
    allowed to stand in."""
    s, p = state[0], params[0]
    air_is_near = s.temperature_us >= 0 and time_us - s.temperature_us <= AIR_REACH_US
    if air_is_near and not math.isnan(s.temperature_k):
        lambda_update(s.error, s.motion, params, s.temperature_k, p.R_T, time_us)
    elif not air_is_near and p.use_die == 1 and not math.isnan(die_temperature_k):
        lambda_update(
            s.error, s.motion, params, die_temperature_k - p.die_offset_k, p.R_die, time_us
        )
    s.temperature_k = math.nan


@step
def predict(state: Rows, params: Rows, time_us: int) -> None:
    """Bring height and errors to the time of a barometer height (17), (18), (33)."""
    s = state[0]
    if s.motion.time_us < 0 or time_us - s.motion.time_us > SILENCE_US:
        restart_motion(
            s.motion, compensate(s.baro_m, s.error.x[0], s.error.x[1], s.error.H_0), P_H0_M2
        )
        s.gnss_alone = 0
    elif time_us > s.motion.time_us:
        predict_motion(s.motion, params, (time_us - s.motion.time_us) * 1e-6)
    s.motion.time_us = max(s.motion.time_us, time_us)
    predict_error(s.error, params, time_us)


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
    fuse_temperature(state, params, sample[0].die_temperature_k, time_us)
    if s.gnss_alone == 1:  # the barometer is back: what GNSS told meanwhile is a fix
        z_update(state, params, time_us, s.motion.x[0], s.motion.P[0, 0])
        s.gnss_alone = 0
    fuse_setting(state, params, sample[0].pressure_pa)
    fuse_waiting_fix(state, params)
    a, b = s.error.x[0], s.error.x[1]
    h_c = compensate(s.baro_m, a, b, s.error.H_0)
    R_h = p.R_B / ((1.0 + a) * (1.0 + a))
    if p.carried == 0:
        s.error.H[0], s.error.H[1] = h_c - s.error.H_0, 1.0
        R_h += spread(s.error.P, s.error.H) / ((1.0 + a) * (1.0 + a))
    verdict = correct_motion(s.motion, s.error, params, h_c, R_h, time_us)
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
    fuse_waiting_fix(state, params)
    sd_m = gnss_sd_m(sample, p.gnss_sd_floor_m, p.gnss_sd_unknown_m)
    s.slow_var_m2 = CORRELATED_SHARE * sd_m * sd_m
    s.fix_var_m2 = sd_m * sd_m if math.isnan(p.R_GPS) else p.R_GPS
    if s.since_us < 0:
        s.since_us = time_us
    note_outage(s.error, s.outage, params, sample, baro_at(state, time_us), sd_m)
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
    innovation = z_innovation(s.error, s.motion, params, s.baro_m - baro, baro, s.fix_m)
    S = spread(s.error.P, s.error.H) + p.R_B + s.fix_var_m2
    return GATED if innovation * innovation > p.gnss_gate * p.gnss_gate * S else USED


@step
def follow_gnss(state: Rows, params: Rows, time_us: int, fix_m: float) -> int:
    """No barometer: the alpha-beta filter takes GNSS heights."""
    s = state[0]
    s.gnss_alone = 1
    if s.motion.time_us < 0 or time_us - s.motion.time_us > SILENCE_US:
        restart_motion(s.motion, fix_m, s.fix_var_m2)
        s.motion.time_us = time_us
        return USED
    late_s = max(0.0, (s.motion.time_us - time_us) * 1e-6)
    if time_us > s.motion.time_us:
        predict_motion(s.motion, params, (time_us - s.motion.time_us) * 1e-6)
        s.motion.time_us = time_us
    return correct_motion(
        s.motion, s.error, params, fix_m + s.motion.x[1] * late_s, s.fix_var_m2, time_us
    )


@step
def on_air(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A temperature of the air waits for the next pressure, whose height it belongs to; so does a
    setting of the altimeter."""
    s = state[0]
    instance, T = sample[0].instance, sample[0].air_temperature_k
    sets, warms = has_setting(sample), LOWEST_AIR_K <= T <= HIGHEST_AIR_K
    if instance != 0 or (params[0].use_air == 0 and not sets):
        return tally(state, AIR, IGNORED)
    if not sets and not warms:
        return tally(state, AIR, INVALID)
    if is_stale(state, AIR, instance, sample[0].time_us):
        return tally(state, AIR, STALE)
    place(state, AIR, instance, sample[0].time_us)
    if sets:
        note_air(s.setting, sample, not math.isnan(s.baro_m))
    if warms and params[0].use_air == 1:
        s.temperature_k = T
        s.temperature_us = sample[0].time_us
    return tally(state, AIR, USED)


@step
def write_estimate(state: Rows, params: Rows, estimate: Rows) -> None:
    """Height and climb as filtered, and the error to expect of them (see Departures)."""
    s, p = state[0], params[0]
    if s.motion.time_us < 0:
        return
    variance = s.motion.P[0, 0] + s.slow_var_m2
    if s.gnss_alone == 0:
        s.error.H[0], s.error.H[1] = s.motion.x[0] - s.error.H_0, 1.0
        variance = (
            spread(s.error.P_settled, s.error.H)
            + growth_m2(s.outage, s.motion.time_us, s.baro_m)
            + extrapolated_m2(s.outage, s.baro_m)
            + min(p.R_B, s.motion.P[0, 0])
            + s.slow_var_m2
        )
    estimate[0].time_us = s.motion.time_us
    estimate[0].altitude_amsl_m = s.motion.x[0]
    estimate[0].climb_mps = s.motion.x[1]
    estimate[0].altitude_sd_m = math.sqrt(variance)
    estimate[0].climb_sd_mps = math.sqrt(s.motion.P[1, 1])
    estimate[0].baro_offset_m = (
        math.nan
        if s.gnss_alone == 1
        else compensate(s.baro_m, s.error.x[0], s.error.x[1], s.error.H_0) - s.baro_m
    )
    estimate[0].innovation_m = s.error.innovation_m
    estimate[0].baro_scale = s.error.x[0]


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
    tunable=(
        "scale_walk_per_second",
        "bias_walk_m2ps",
        "baro_variance_m2",
        "gnss_sd_floor_m",
        "temperature_sd_k",
    ),
)
