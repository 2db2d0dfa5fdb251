"""The compiled steps of a reading: those before the estimator's step, and those after it.

The live path takes one message at a time with them (`companion.live_steps`), a replay a block of
a log (`companion.replay.block_steps`). They are the steps of `companion.pipeline`, on its state.
"""

import math
from typing import NamedTuple

import numpy as np

from companion import at_rest
from companion.agreement import follow_fix, follow_pressure
from companion.checker import ELLIPSOID, asks_restart, objection
from companion.health_steps import assess, heard, is_due
from companion.intake.clock_steps import DOUBT, REBOOT, place
from companion.intake.receiver_steps import (
    DOUBTS_MIN,
    LEAST_UNDULATION_M,
    check_height,
    check_unreported,
    doubt,
    fix_works,
    is_height,
    number,
    pressure_works,
)
from companion.intake.row_steps import LARGEST_DOUBT_M, RIGHT, UNSETTLED, air_time
from companion.intake.screen_steps import baro_m, judge_fix, judge_pressure
from companion.intake.simulation import note_fix
from companion.jit import step
from companion.known_air import is_due as is_air_due
from companion.mavlink import altitude_steps
from companion.mavlink.altitude_steps import altitude
from companion.mavlink.imu_steps import accepts, replaces_pressure
from companion.samples import MAX_INSTANCES, Kind, Rows, Tables, Verdict

IMU, PRESSURE, GNSS = int(Kind.IMU), int(Kind.PRESSURE), int(Kind.GNSS)
ATTITUDE, RANGE, AIR = int(Kind.ATTITUDE), int(Kind.RANGE), int(Kind.AIR)
STATUS, HOME, AIRSPEED = int(Kind.STATUS), int(Kind.HOME), int(Kind.AIRSPEED)
USED, STALE = int(Verdict.USED), int(Verdict.STALE)

SAMPLE, LEFT_OUT, REPLACED, UNUSED = 0, 1, 2, 3
"""what became of a reading: a sample, one out of time, one that a better message replaces, one of
an IMU that nobody reads; less than `TELLS`"""
TELLS, OF_PRIMARY, OF_AIR = 4, 8, 16
"""what is added to it where there is more for the pipeline to do: something to log, another sensor
that is the primary one now, something of the air to tell the estimator"""

ASSESSED, CHANGED, RESTARTS, DUE = 1, 2, 4, 8
"""what came of a reading: health was assessed, it changed, the estimator has to be restarted, an
ALTITUDE is due"""

READING = np.dtype(
    [
        ("kind", "i8"),
        ("row", "i8"),  # in the table of its kind
        ("origin", "i8"),
        ("stamp_us", "i8"),
        ("source", "i8"),  # message
        ("instance", "i8"),
        ("rank", "i8"),  # of an IMU message; -1 none
        ("is_highres", "i8"),
        ("place", "i8"),  # of its sample in the order of a block; below 0 without one
        ("time_us", "i8"),  # of its sample
        ("number", "i8"),  # of its sensor among its kind
        ("now_us", "i8"),  # the vehicle's clock after it
        ("unix_us", "i8"),
        ("debug", "i8"),  # 1 + number of samples up to it where the DEBUG family is due, else 0
        ("doubt_m", "f8"),
        ("above_m", "f8"),  # undulation of the geoid, of a fix with equal heights
    ],
    align=True,
)


class Intaking(NamedTuple):
    """State and parameters of the intake."""

    clock: Rows
    clock_params: Rows
    air: Rows
    row_params: Rows
    choice: Rows
    screen: Rows
    screen_params: Rows
    known_air: Rows
    at_rest: Rows
    simulation: Rows
    receivers: tuple[Rows, Rows, Rows, Rows]
    primaries: tuple[Rows, Rows]


class Following(NamedTuple):
    """State and parameters of what follows a sample."""

    agreement: Rows
    checker: Rows
    health: Rows
    health_params: Rows
    outputs: Rows
    output_params: Rows
    monotonic: Rows
    leap: Rows
    heights: Rows
    """an ALTITUDE row, which gets the heights of a message that is due"""


@step
def take_reading(
    reading: Rows, tables: Tables, s: Intaking, arrival_us: int, wants_imu: bool
) -> int:
    """Make a sample of a reading, whose row is in the table of its kind: what became of it."""
    r, wrong, changes = reading[0], s.clock[0].wrong_units, s.screen[0].changes
    effect, time_us = place(
        s.clock, s.clock_params, r.origin, r.stamp_us, r.source, arrival_us
    )  # fmt: skip
    r.now_us, r.unix_us = s.clock[0].now_us, s.clock[0].unix_us
    found = TELLS if effect == REBOOT or s.clock[0].wrong_units != wrong else 0
    if effect == DOUBT or not 0 <= r.instance < MAX_INSTANCES:
        return found | LEFT_OUT
    if r.kind == IMU and not wants_imu:
        return found | UNUSED
    if _is_replaced(reading, tables, s):
        found |= REPLACED
    else:
        found |= _fill(reading, tables, s, time_us)
    r.doubt_m = s.receivers[0][0].doubt_m
    return found | (TELLS if s.screen[0].changes != changes else 0)


@step
def _is_replaced(reading: Rows, tables: Tables, s: Intaking) -> bool:
    """Whether the same sensor has a better message."""
    kind, row, now_us = reading[0].kind, reading[0].row, reading[0].now_us
    if kind == IMU:
        force = tables.imu[row].specific_force_b_mps2
        sensor = reading[0].source * 8 + reading[0].instance
        return not accepts(s.choice, sensor, reading[0].rank, force[0], force[1], force[2], now_us)
    if kind == PRESSURE:
        return replaces_pressure(s.choice, reading[0].is_highres == 1, reading[0].instance, now_us)
    return False


@step
def _fill(reading: Rows, tables: Tables, s: Intaking, time_us: int) -> int:
    """Complete the row of a reading at `time_us`; what there is for the pipeline to do."""
    kind, row, found = reading[0].kind, reading[0].row, SAMPLE
    reading[0].time_us, reading[0].number = time_us, reading[0].instance
    if kind == IMU:
        tables.imu[row].time_us = time_us
    elif kind == PRESSURE:
        pressure = tables.pressure[row : row + 1]
        pressure[0].time_us = time_us
        if number(s.primaries[0], pressure, pressure_works(pressure)):
            found = TELLS | OF_PRIMARY
        reading[0].number = pressure[0].instance
        judge_pressure(s.screen, s.screen_params, pressure)
        if not math.isnan(s.known_air[0].elevation_m):
            at_rest.follow_pressure(s.at_rest, pressure)
        if is_air_due(s.known_air, s.at_rest, reading[0].now_us):
            found |= OF_AIR
    elif kind == GNSS:
        fix = tables.gnss[row : row + 1]
        fix[0].time_us = time_us - s.row_params[0].latency_us
        if _check_fix(fix, s, reading[0].above_m):
            return TELLS
        reading[0].time_us, reading[0].number = fix[0].time_us, fix[0].instance
        judge_fix(s.screen, s.screen_params, fix)
        if not math.isnan(s.known_air[0].elevation_m):
            at_rest.follow_fix(s.at_rest, fix)
    elif kind == ATTITUDE:
        tables.attitude[row].time_us = time_us
    elif kind == RANGE:
        tables.range[row].time_us = time_us
    elif kind == AIR:
        reading[0].time_us = air_time(s.air, time_us)
        tables.air[row].time_us = reading[0].time_us
        tables.air[row].air_temperature_k -= s.row_params[0].air_excess_k
    elif kind == STATUS:
        tables.status[row].time_us = time_us
        at_rest.follow_status(s.at_rest, tables.status[row : row + 1])
    elif kind == HOME:
        tables.home[row].time_us = time_us
    elif kind == AIRSPEED:
        tables.airspeed[row].time_us = time_us
    return found


@step
def _check_fix(fix: Rows, s: Intaking, above_m: float) -> bool:
    """Check a fix, and number its receiver; True when that needs the pipeline. `above_m` is the
    undulation of the geoid there."""
    if is_height(fix):
        receiver, height_m = s.receivers[fix[0].instance], baro_m(s.screen, fix[0].time_us)
        if check_height(receiver, fix, height_m) != 0:
            return True
        meaning = s.row_params[0].equal_heights
        if meaning != RIGHT and fix[0].altitude_amsl_m == fix[0].altitude_ellipsoid_m:
            if meaning == UNSETTLED or receiver[0].doubts == DOUBTS_MIN - 1:
                return True
            if abs(above_m) >= LEAST_UNDULATION_M:
                note_fix(s.simulation, fix[0].altitude_amsl_m, above_m)
                doubt(receiver, fix, above_m)
        check_unreported(receiver, fix, height_m)
    return number(s.primaries[1], fix, fix_works(fix))


@step
def follow_sample(
    reading: Rows, tables: Tables, estimate: Rows, verdict: int, s: Following
) -> None:
    """Follow a sample and its verdict."""
    kind, row = reading[0].kind, reading[0].row
    instance, now_us, o = 0, reading[0].now_us, s.outputs
    if kind == PRESSURE:
        pressure = tables.pressure[row : row + 1]
        instance = pressure[0].instance
        follow_pressure(s.agreement, pressure)
        if verdict != STALE:
            altitude_steps.follow_pressure(o, s.monotonic, pressure, verdict)
        if instance == 0 or verdict == USED:
            heard(s.health, s.health_params, kind, verdict, now_us, pressure[0].arrival_us)
    elif kind == GNSS:
        fix = tables.gnss[row : row + 1]
        instance = fix[0].instance
        follow_fix(s.agreement, fix)
        if instance == 0 or verdict == USED:
            heard(s.health, s.health_params, kind, verdict, now_us, fix[0].arrival_us)
    elif verdict == STALE:
        return
    elif kind == HOME:
        altitude_steps.follow_home(o, tables.home[row : row + 1])
    elif kind == STATUS:
        altitude_steps.follow_status(o, tables.status[row : row + 1], estimate)
    elif kind == RANGE:
        altitude_steps.follow_range(o, tables.range[row : row + 1])
    elif kind == ATTITUDE:
        altitude_steps.follow_attitude(o, tables.attitude[row : row + 1])


@step
def react(reading: Rows, estimate: Rows, s: Following, used: bool) -> int:
    """What is due now that the vehicle's clock has moved; `used` is whether the reading is a sample
    that the estimator used."""
    now_us, h, found = reading[0].now_us, s.health, 0
    if used or is_due(h, now_us):
        altitude_m, doubt_m = estimate[0].altitude_amsl_m, reading[0].doubt_m
        code, apart_m = ELLIPSOID, doubt_m
        if not doubt_m > LARGEST_DOUBT_M:
            code, apart_m = objection(s.agreement, now_us, altitude_m), abs(s.agreement[0].gap_m)
        found = ASSESSED
        if assess(h, s.health_params, now_us, estimate, code, apart_m):
            found |= CHANGED
        if asks_restart(s.checker, s.agreement, now_us, h[0].has_altitude == 1):
            return found | RESTARTS
    if used and altitude(
        s.outputs, s.output_params, s.monotonic, s.leap, now_us, h[0].health, estimate, s.heights
    ):
        found |= DUE
    return found
