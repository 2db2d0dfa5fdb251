"""Steps of the estimator `companion.estimators.robust_altimeter`, whose docstring has paper,
letters and departures."""

import math

from companion.estimators.judging import (
    AIR,
    ATTITUDE,
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
from companion.estimators.outage import GAP_S, OUTAGE, note_difference, outage_start
from companion.estimators.robust_altimeter.altimeters import (
    FRESH_US,
    PAIR,
    advance,
    altimeters_start,
    begin,
    correct_errors,
    extrapolate_errors,
    gather,
    lost,
    switch,
)
from companion.estimators.robust_altimeter.error_model import IBI, IIG
from companion.estimators.robust_altimeter.isolation import (
    TRUST_IBI,
    TRUST_IIG,
    forget_datum,
)
from companion.estimators.robust_altimeter.publication import fuse, ibi_weight, spread_m
from companion.estimators.robust_altimeter.settings import RobustAltimeterSettings
from companion.estimators.setting import (
    SETTING,
    admit_setting,
    indicated_m,
    indicated_sd_m,
    is_set,
    note_air,
    note_level,
    setting_start,
    waits_for_level,
)
from companion.jit import step
from companion.kernels.atmosphere import baro_altitude_m, pressure_altitude_m
from companion.kernels.attitude import (
    ATTITUDE_STATE,
    attitude_gnss,
    attitude_imu,
    attitude_start,
    attitude_vehicle,
    imu_can_be_integrated,
    up_acceleration_mps2,
)
from companion.kernels.gnss import gnss_sd_m
from companion.kernels.ring import at
from companion.samples import FaultySensor, Kind, Rows, Tables, readable, rows

LOWEST_PA, HIGHEST_PA = 1_000.0, 120_000.0
IMU_TIMEOUT_US = 500_000
GNSS_WAIT_US = 5_000_000
"""Wait for a first fix before another datum is taken."""

BAROMETER, RECEIVER = int(FaultySensor.BAROMETER), int(FaultySensor.GNSS)

STATE = state_dtype(
    ("attitude", ATTITUDE_STATE),
    ("pair", PAIR),
    ("setting", SETTING),
    ("outage", OUTAGE),
    ("level_m", "f8"),  # newest pressure altitude, geopotential
    ("first_us", "i8"),  # of the first pressure, -1 none
    ("baro_m", "f8"),  # newest barometer height
    ("innovation_m", "f8"),  # newest GNSS height less the predicted one
)


def init(params: Rows) -> Rows:
    """A fresh state: nothing known."""
    state = rows(STATE)
    start(state)
    return readable(state)


@step
def start(state: Rows) -> None:
    """Forget everything but the counters."""
    s = state[0]
    reset(state)
    attitude_start(s.attitude)
    altimeters_start(s.pair)
    setting_start(s.setting)
    outage_start(s.outage)
    s.level_m, s.first_us = math.nan, -1
    s.baro_m = math.nan
    s.innovation_m = math.nan


@step
def listen(state: Rows, params: Rows, time_us: int) -> float:
    """Before a height is taken in: mechanise without an IMU if it is silent; the iteration that
    begins, or 0."""
    s = state[0]
    if s.pair.inertial == 1 and s.now_us - s.attitude.time_us > IMU_TIMEOUT_US:
        switch(s.pair, params, 0)
    if s.pair.inertial == 0:
        advance(s.pair, time_us, 0.0)
    return extrapolate_errors(s.pair, params, s.now_us)


@step
def answer(state: Rows, params: Rows, T: float, estimate: Rows) -> None:
    """After a sample: end the iteration, if one began, and publish."""
    s = state[0]
    if T > 0.0:
        heard_us = min(s.last_us[PRESSURE, 0], s.last_us[GNSS, 0])
        aligns = heard_us > max(0, s.now_us - FRESH_US)
        correct_errors(s.pair, params, s.now_us, T, aligns)
    write_estimate(state, params, estimate)


@step
def on_imu(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """Mechanise both altimeters with the upward specific force."""
    s = state[0]
    if sample[0].instance != 0:
        return tally(state, IMU, IGNORED)
    verdict = judge_imu(state, sample)
    if verdict != USED:
        return tally(state, IMU, verdict)
    place(state, IMU, 0, sample[0].time_us)
    attitude_imu(s.attitude, sample)
    up = up_acceleration_mps2(s.attitude, sample)
    if math.isnan(up):
        switch(s.pair, params, 0)
        return tally(state, IMU, USED if imu_can_be_integrated(s.attitude) else IGNORED)
    if s.pair.inertial == 0:
        advance(s.pair, sample[0].time_us, 0.0)
        switch(s.pair, params, 1)
    else:
        advance(s.pair, sample[0].time_us, 0.5 * (s.pair.up_mps2 + up))
    s.pair.up_mps2 = up
    answer(state, params, extrapolate_errors(s.pair, params, s.now_us), estimate)
    return tally(state, IMU, USED)


@step
def on_pressure(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """Z of IBI: mechanised less barometer height (10), (7)."""
    s = state[0]
    if sample[0].instance != 0:
        return tally(state, PRESSURE, IGNORED)
    verdict = judge_pressure(state, sample, LOWEST_PA, HIGHEST_PA)
    if verdict != USED:
        return tally(state, PRESSURE, verdict)
    time_us = sample[0].time_us
    place(state, PRESSURE, 0, time_us)
    T = listen(state, params, time_us)
    s.baro_m = baro_altitude_m(sample[0].pressure_pa)
    since_s = (time_us - s.pair.ins_us) * 1e-6
    s.level_m = pressure_altitude_m(sample[0].pressure_pa)
    if s.first_us < 0:
        s.first_us = time_us
    note_level(s.setting, s.level_m)
    if math.isnan(s.pair.datum.offset_m):
        find_datum(state, params, time_us, since_s)
    if not math.isnan(s.pair.datum.offset_m):
        altitude_m = s.baro_m - s.pair.datum.offset_m
        if lost(s.pair, IBI):
            begin(s.pair, params, IBI, altitude_m)
        else:
            Z = s.pair.height_m[IBI] + since_s * s.pair.climb_mps[IBI] - altitude_m
            verdict = gather(s.pair, params, IBI, Z)
    answer(state, params, T, estimate)
    return tally(state, PRESSURE, verdict)


@step
def find_datum(state: Rows, params: Rows, time_us: int, since_s: float) -> None:
    """The first datum of the barometer: IIG's height, else the setting of the altimeter; the
    standard atmosphere when IBI alone is to be published, as in the paper's first scheme."""
    s = state[0]
    datum = s.pair.datum
    if not lost(s.pair, IIG) and time_us - s.last_us[GNSS, 0] < FRESH_US:
        datum.at_m = s.pair.height_m[IIG] + since_s * s.pair.climb_mps[IIG]
    elif s.last_us[GNSS, 0] >= 0 or time_us - s.first_us < GNSS_WAIT_US:
        return
    elif is_set(s.setting) or params[0].publish == IBI:
        datum.at_m = indicated_m(s.setting, s.level_m)
    else:
        return
    datum.offset_m = s.baro_m - datum.at_m


@step
def on_air(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """The setting of the altimeter: the datum of IBI until there is GNSS, and while the vehicle
    rests on a field of known elevation. A temperature alone is IGNORED."""
    s = state[0]
    verdict = admit_setting(state, sample, False)
    if verdict != USED:
        return verdict
    changed = note_air(s.setting, sample, not math.isnan(s.level_m))
    counts = s.last_us[GNSS, 0] < 0 or waits_for_level(s.setting)
    if changed and counts and not math.isnan(s.level_m):
        note_level(s.setting, s.level_m)
        moved_m = indicated_m(s.setting, s.level_m) - (s.baro_m - s.pair.datum.offset_m)
        if not math.isnan(moved_m):
            s.pair.datum.offset_m -= moved_m
            s.pair.datum.at_m += moved_m
            s.pair.height_m[IBI] += moved_m
            write_estimate(state, params, estimate)
    return verdict


@step
def on_gnss(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """Z of IIG: height mechanised at the fix's own time less GNSS height (10), (14)."""
    s, p = state[0], params[0]
    if sample[0].instance != 0:
        return tally(state, GNSS, IGNORED)
    verdict = judge_gnss(state, sample)
    if verdict != USED:
        return tally(state, GNSS, verdict)
    time_us, before_us = sample[0].time_us, s.last_us[GNSS, 0]
    is_back = p.robust == 1 and before_us >= 0 and time_us - before_us > GAP_S * 1e6
    place(state, GNSS, 0, time_us)
    attitude_gnss(s.attitude, sample)
    T = listen(state, params, time_us)
    s.pair.sigma_gps_m = gnss_sd_m(sample, p.sigma_GPS, p.sigma_GPS_unknown)
    if is_back:
        forget_datum(s.pair)
    if is_back or lost(s.pair, IIG):
        begin(s.pair, params, IIG, sample[0].altitude_amsl_m)
    else:
        height_m = at(s.pair.iig_us, s.pair.iig_values, time_us, FRESH_US)
        if math.isnan(height_m):
            height_m = (
                s.pair.height_m[IIG] + (time_us - s.pair.ins_us) * 1e-6 * s.pair.climb_mps[IIG]
            )
        s.innovation_m = sample[0].altitude_amsl_m - height_m
        verdict = gather(s.pair, params, IIG, -s.innovation_m)
    if verdict == USED and not math.isnan(s.baro_m):
        note_difference(
            s.outage,
            time_us,
            sample[0].altitude_amsl_m,
            s.baro_m,
            sample[0].ground_speed_mps,
            s.pair.sigma_gps_m,
        )
    answer(state, params, T, estimate)
    return tally(state, GNSS, verdict)


@step
def on_attitude(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """The autopilot's roll and pitch, if they may be used."""
    if sample[0].instance != 0 or params[0].use_attitude == 0:
        return tally(state, ATTITUDE, IGNORED)
    verdict = judge_attitude(state, sample)
    if verdict == USED:
        place(state, ATTITUDE, 0, sample[0].time_us)
        attitude_vehicle(state[0].attitude, sample)
    return tally(state, ATTITUDE, verdict)


@step
def on_status(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A reboot restarts the vehicle's clock: start anew."""
    if sample[0].reboot == 1:
        start(state)
        forget(estimate)
    return tally(state, STATUS, USED)


@step
def write_estimate(state: Rows, params: Rows, estimate: Rows) -> None:
    """The published altimeter (19), (21)."""
    s = state[0]
    ibi = ibi_weight(s.pair, params)
    if math.isnan(ibi):
        return
    datum_sd_m = math.nan
    if s.last_us[GNSS, 0] < 0:
        datum_sd_m = indicated_sd_m(s.setting, s.pair.height_m[IBI], s.now_us)
    estimate[0].time_us = s.pair.ins_us
    estimate[0].altitude_amsl_m = fuse(ibi, s.pair.height_m)
    estimate[0].climb_mps = fuse(ibi, s.pair.climb_mps)
    estimate[0].altitude_sd_m = spread_m(s.pair, params, s.outage, ibi, s.now_us, datum_sd_m)
    estimate[0].climb_sd_mps = math.sqrt(
        ibi * s.pair.P[IBI, 1, 1] + (1.0 - ibi) * s.pair.P[IIG, 1, 1]
    )
    estimate[0].baro_offset_m = estimate[0].altitude_amsl_m - s.baro_m
    estimate[0].innovation_m = s.innovation_m
    estimate[0].faulty = (
        BAROMETER
        if s.pair.isolation.trust == TRUST_IIG
        else RECEIVER
        if s.pair.isolation.trust == TRUST_IBI
        else 0
    )
    estimate[0].faulty_since_us = (
        s.pair.isolation.trust_us if s.pair.isolation.trust in (TRUST_IBI, TRUST_IIG) else 0
    )


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
    name="robust-altimeter",
    summary="two inertial altimeters, by barometer and by GNSS, with a probability for every "
    "measurement",
    citation="Mañero Contreras, Hajiyev 2019",
    settings=RobustAltimeterSettings,
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
    datum_invariant=True,
    follows_baro_step=True,
)
