"""The compiled rules of the plausibility check (`companion.intake.screening`)."""

import math

import numpy as np

from companion.jit import step
from companion.kernels.atmosphere import baro_altitude_m
from companion.kernels.gnss import HIGHEST_GNSS_M, LOWEST_GNSS_M, gnss_sd_m
from companion.samples import MAX_INSTANCES, Kind, Record, Rows, Suspicion

NONE_US = -(1 << 62)
NONE, PRESSURE, GNSS = -1, int(Kind.PRESSURE), int(Kind.GNSS)
DATUM = int(Suspicion.DATUM)
PAIR_US = 5_000_000
"""largest distance in time of two heights that are compared"""
FROZEN_US = 5_000_000
FASTEST_MPS = 50.0
"""largest difference of heights taken at different instants, for each second"""
GNSS_STEP_US = 60_000_000

BARO = np.dtype(
    [
        ("time_us", "i8"),  # NONE_US: not heard yet
        ("height_m", "f8"),
        ("changed_us", "i8"),  # start of the repetition of this height
        ("judged_us", "i8"),
        ("datum", "i8"),  # Kind of the suspect, NONE
        ("since_us", "i8"),  # start of the (dis)agreement that contradicts the present state
        ("agreed", "i8"),
        ("agreed_baro_m", "f8"),  # at the last agreement on the datum
        ("agreed_gnss_m", "f8"),
        ("level_us", "i8"),  # when they last moved together; NONE_US never
        ("level_baro_m", "f8"),
        ("level_gnss_m", "f8"),
        ("step", "i8"),  # Kind of the suspect, NONE
        ("step_us", "i8"),
    ],
    align=True,
)
SCREEN = np.dtype(
    [
        ("gnss_us", "i8"),  # the last credible fix
        ("gnss_m", "f8"),
        ("gnss_sd_m", "f8"),
        ("baros", BARO, (MAX_INSTANCES,)),
        ("changes", "i8"),  # how often a suspect changed,
        ("changed", "i8"),  # the barometer of the last change,
        ("suspect", "i8"),  # and the suspect since
    ],
    align=True,
)
SCREEN_PARAMS = np.dtype(
    [
        ("datum_limit_m", "f8"),
        ("datum_limit_ratio", "f8"),
        ("datum_time_us", "f8"),
        ("credible_gnss_sd_m", "f8"),
        ("step_limit_m", "f8"),
    ],
    align=True,
)


@step
def forget(c: Rows) -> None:
    """Know nothing, as after a reboot."""
    c[0].gnss_us = NONE_US
    for i in range(MAX_INSTANCES):
        c[0].baros[i].time_us = NONE_US


@step
def baro_m(c: Rows, time_us: int) -> float:
    """The height of the first barometer; NaN when it is older than 5 s."""
    baro = c[0].baros[0]
    if baro.time_us == NONE_US or abs(time_us - baro.time_us) >= PAIR_US:
        return math.nan
    return baro.height_m


@step
def judge_fix(c: Rows, p: Rows, row: Rows) -> None:
    """Note a credible GNSS height, and mark it when it is the suspect."""
    if row[0].instance != 0:
        return
    height_m, sd_m, time_us = row[0].altitude_amsl_m, gnss_sd_m(row, 0.0, 0.0), row[0].time_us
    credible = row[0].fix_type >= 3 and LOWEST_GNSS_M <= height_m <= HIGHEST_GNSS_M
    is_late = c[0].gnss_us != NONE_US and time_us < c[0].gnss_us
    baro = c[0].baros[0]
    if credible and not is_late and sd_m <= p[0].credible_gnss_sd_m:
        c[0].gnss_us, c[0].gnss_m, c[0].gnss_sd_m = time_us, height_m, sd_m
        if baro.time_us != NONE_US and abs(time_us - baro.time_us) < PAIR_US:
            _judge_step(c, p, 0, time_us)
    if baro.time_us != NONE_US and (GNSS in (baro.datum, baro.step)):
        row[0].suspect = DATUM


@step
def judge_pressure(c: Rows, p: Rows, row: Rows) -> None:
    """Judge a pressure, and mark it when it is the suspect."""
    time_us, height_m = row[0].time_us, baro_altitude_m(row[0].pressure_pa)
    if not math.isfinite(height_m) or not 0 <= row[0].instance < MAX_INSTANCES:
        return
    baro = c[0].baros[row[0].instance]
    if baro.time_us == NONE_US:
        baro.changed_us, baro.step_us = time_us, 0
        baro.judged_us = baro.since_us = baro.level_us = NONE_US
        baro.datum = baro.step = NONE
        baro.agreed = 0
    elif time_us < baro.time_us:
        return  # a late copy
    elif height_m != baro.height_m:
        baro.changed_us = time_us
    baro.time_us, baro.height_m = time_us, height_m
    if c[0].gnss_us != NONE_US and abs(time_us - c[0].gnss_us) < PAIR_US:
        _judge_datum(c, p, row[0].instance)
        _judge_step(c, p, row[0].instance, time_us)
    if PRESSURE in (baro.datum, baro.step):
        row[0].suspect = DATUM


@step
def _judge_datum(c: Rows, p: Rows, instance: int) -> None:
    baro, gnss_m = c[0].baros[instance], c[0].gnss_m
    limit_m = p[0].datum_limit_m + p[0].datum_limit_ratio * abs(gnss_m)
    agree = abs(baro.height_m - gnss_m) <= limit_m
    first = baro.judged_us == NONE_US
    if not first and baro.time_us - baro.judged_us > PAIR_US:
        baro.since_us = NONE_US  # nobody could tell meanwhile
    baro.judged_us = baro.time_us
    if not first and agree == (baro.datum == NONE):
        baro.since_us = NONE_US
    else:
        if baro.since_us == NONE_US:
            baro.since_us = baro.time_us
        if first or baro.time_us - baro.since_us >= p[0].datum_time_us:
            baro.since_us = NONE_US
            _blame(c, baro, agree)
            if not (first and agree):
                _note(c, instance, baro.datum)
    if agree:
        baro.agreed, baro.agreed_baro_m, baro.agreed_gnss_m = 1, baro.height_m, gnss_m


@step
def _blame(c: Rows, baro: Record, agree: bool) -> None:
    """The suspect of a datum that cannot be: one of a step, or a barometer that repeats itself, or
    what moved since the agreement."""
    if agree:
        baro.datum = NONE
    elif baro.step != NONE:
        baro.datum = baro.step
    elif baro.time_us - baro.changed_us > FROZEN_US or not baro.agreed:
        baro.datum = PRESSURE
    else:
        baro.datum = _mover(c, baro, baro.agreed_baro_m, baro.agreed_gnss_m)


@step
def _mover(c: Rows, baro: Record, baro_then_m: float, gnss_then_m: float) -> int:
    """The sensor that moved more since then."""
    moved_m = abs(baro.height_m - baro_then_m)
    return GNSS if abs(c[0].gnss_m - gnss_then_m) > moved_m else PRESSURE


@step
def _judge_step(c: Rows, p: Rows, instance: int, now_us: int) -> None:
    baro = c[0].baros[instance]
    if (
        baro.datum != NONE
        or baro.level_us == NONE_US
        or (now_us - baro.level_us > PAIR_US and baro.step == NONE)
    ):
        _level(c, baro, now_us)
        return
    moved_m = c[0].gnss_m - baro.level_gnss_m
    apart_m = abs(moved_m - (baro.height_m - baro.level_baro_m))
    until_us = now_us if baro.step == NONE else baro.step_us
    apart_s = (abs(c[0].gnss_us - baro.time_us) + abs(until_us - baro.level_us)) * 1e-6
    if apart_m <= p[0].step_limit_m + 3.0 * c[0].gnss_sd_m + FASTEST_MPS * apart_s:
        if baro.step != NONE:
            _note(c, instance, NONE)
        _level(c, baro, now_us)
    elif baro.step == NONE:
        baro.step = _mover(c, baro, baro.level_baro_m, baro.level_gnss_m)
        baro.step_us = now_us
        _note(c, instance, baro.step)
    elif now_us - baro.step_us >= (
        p[0].datum_time_us if baro.step == PRESSURE else float(GNSS_STEP_US)
    ):
        _level(c, baro, now_us)
        _note(c, instance, NONE)


@step
def _level(c: Rows, baro: Record, now_us: int) -> None:
    """The two move together."""
    baro.level_us, baro.level_baro_m, baro.level_gnss_m = now_us, baro.height_m, c[0].gnss_m
    baro.step = NONE


@step
def _note(c: Rows, instance: int, suspect: int) -> None:
    """A suspect changed; `companion.intake.screening` logs it."""
    c[0].changes += 1
    c[0].changed, c[0].suspect = instance, suspect
