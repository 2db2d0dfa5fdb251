"""The compiled steps of a plain message on the live path (`companion.live`), before the estimator's
step and after it.

They are those of `companion.pipeline` for the same message, in one call each.
"""

import math

import numpy as np

from companion.agreement import AGREEMENT, follow_pressure
from companion.checker import CHECKER, ELLIPSOID, asks_restart, objection
from companion.health_steps import (
    HEALTH,
    HEALTH_PARAMS,
    alive,
    assess,
    heard,
    is_due,
    silence,
)
from companion.intake.clock_steps import CLOCK, CLOCK_PARAMS, DOUBT, is_near, place
from companion.intake.receiver_steps import PRIMARY, RECEIVER, number, pressure_works
from companion.intake.row_steps import LARGEST_DOUBT_M
from companion.intake.screen_steps import SCREEN, SCREEN_PARAMS, judge_pressure
from companion.jit import step, viewed
from companion.known_air import KNOWN
from companion.mavlink import altitude_steps
from companion.mavlink.altitude_steps import ALTITUDE, OUTPUT_PARAMS, OUTPUTS, altitude
from companion.mavlink.continuity import LEAP, MONOTONIC
from companion.mavlink.imu_steps import CHOICE, accepts, replaces_pressure
from companion.mavlink.plain_steps import IDS, MOST_FIELDS, PLAN, find, is_plain, read, stamp_of
from companion.samples import DTYPES, ESTIMATE, Kind, Rows, Verdict

LONGEST = 280
"""bytes of the longest frame"""
MOST_PLANS = 8
HEAD = 3
"""fields of a sample before its values, each of 8 bytes"""
IMU, PRESSURE, ATTITUDE = int(Kind.IMU), int(Kind.PRESSURE), int(Kind.ATTITUDE)
PRESSURE_ROW, ATTITUDE_ROW = DTYPES[Kind.PRESSURE], DTYPES[Kind.ATTITUDE]
USED, STALE = int(Verdict.USED), int(Verdict.STALE)
U1, U4, I8, F4, F8 = (np.dtype(name) for name in ("u1", "u4", "i8", "f4", "f8"))

(AT_DATA, AT_PLACES, AT_PLANS, AT_CRC, AT_BITS, AT_FLOATS, AT_VALUES, AT_CLOCK, AT_CLOCK_PARAMS,
 AT_CHOICE, AT_PRIMARY, AT_SCREEN, AT_SCREEN_PARAMS, AT_RECEIVER, AT_AGREEMENT, AT_CHECKER,
 AT_HEALTH, AT_HEALTH_PARAMS, AT_OUTPUTS, AT_OUTPUT_PARAMS, AT_MONOTONIC, AT_LEAP, AT_HEIGHTS,
 AT_ESTIMATE, AT_PRESSURE, AT_ATTITUDE, AT_IMU_VALUES, AT_PRESSURE_VALUES, AT_ATTITUDE_VALUES,
 AT_IMU_HEAD, AT_PRESSURE_HEAD, AT_ATTITUDE_HEAD, AT_AIR, PARTS) = range(34)  # fmt: skip
"""places of the arrays in `companion.jit.Parts`"""

NOT_TAKEN = -1
"""the message is left to the pipeline, and nothing was changed"""
SAMPLE, LEFT_OUT, REPLACED, UNUSED = 0, 1, 2, 3
"""what became of a message: a sample, one out of time, one that a better message replaces, one of
an IMU that nobody reads; less than `TELLS`, which is added where something is to be logged"""
TELLS, OF_PRIMARY, OF_AIR, OF_KIND = 4, 8, 16, 5
"""`OF_PRIMARY` is added where another sensor is the primary one, `OF_AIR` where the user gives
values of the air; the kind is in the bits from `OF_KIND` on"""

ASSESSED, CHANGED, RESTARTS, DUE, SILENT, OF_FAULTY = 1, 2, 4, 8, 16, 8
"""what came of a sample: health was assessed, it changed, the estimator has to be restarted, an
ALTITUDE is due, the host's clock says that something is missing; the excluded sensor is in the bits
from `OF_FAULTY` on"""


@step
def take(
    parts: Rows, size: int, system_id: int, component_id: int, host_us: int, wants_imu: bool
) -> int:
    """Take the first `size` bytes of the data, which arrived at `host_us`: their sample is in the
    row of its kind then. NOT_TAKEN, or what became of it."""
    data, plans = viewed(parts, AT_DATA, U1, size), viewed(parts, AT_PLANS, PLAN, MOST_PLANS)
    places, crc_table = viewed(parts, AT_PLACES, I8, IDS), viewed(parts, AT_CRC, I8, 256)
    found = find(data, system_id, component_id, places, plans, crc_table)
    if found < 0:
        return NOT_TAKEN
    plan = plans[found : found + 1]
    clock = viewed(parts, AT_CLOCK, CLOCK, 1)
    clock_params = viewed(parts, AT_CLOCK_PARAMS, CLOCK_PARAMS, 1)
    bits, floats = viewed(parts, AT_BITS, U4, 1), viewed(parts, AT_FLOATS, F4, 1)
    base, stamp_us = plan[0].counts_from, stamp_of(data, plan)
    if not is_near(clock, clock_params, base, stamp_us) or not is_plain(data, plan, bits, floats):
        return NOT_TAKEN
    values = viewed(parts, AT_VALUES, F8, MOST_FIELDS)
    read(data, plan, bits, floats, values)
    health = viewed(parts, AT_HEALTH, HEALTH, 1)
    alive(health, viewed(parts, AT_HEALTH_PARAMS, HEALTH_PARAMS, 1), host_us)
    kind, message_id, wrong = plan[0].kind, plan[0].message_id, clock[0].wrong_units
    effect, time_us = place(clock, clock_params, base, stamp_us, message_id, host_us)
    code = kind << OF_KIND | (TELLS if clock[0].wrong_units != wrong else 0)
    if effect == DOUBT:
        return int(code | LEFT_OUT)
    if kind == IMU and not wants_imu:
        return int(code | UNUSED)
    if _is_replaced(plan, values, viewed(parts, AT_CHOICE, CHOICE, 1), clock[0].now_us):
        return int(code | REPLACED)
    return int(code | _fill(parts, plan, values, time_us, host_us))


@step
def _is_replaced(plan: Rows, values: Rows, choice: Rows, now_us: int) -> bool:
    """Whether the same sensor has a better message."""
    instance = plan[0].instance
    if plan[0].kind == IMU:
        sensor = plan[0].message_id * 8 + instance
        x_mps2, y_mps2, z_mps2 = values[0], values[1], values[2]
        return not accepts(choice, sensor, plan[0].rank, x_mps2, y_mps2, z_mps2, now_us)
    return plan[0].kind == PRESSURE and replaces_pressure(choice, False, instance, now_us)


@step
def _fill(parts: Rows, plan: Rows, values: Rows, time_us: int, host_us: int) -> int:
    """Complete the row of a sample; what there is to log."""
    kind, count, tells = plan[0].kind, plan[0].count, 0
    at = 0 if kind == IMU else (1 if kind == PRESSURE else 2)
    head = viewed(parts, AT_IMU_HEAD + at, I8, HEAD)
    head[0], head[1], head[2] = time_us, host_us, plan[0].instance
    row_values = viewed(parts, AT_IMU_VALUES + at, F8, HEAD + count)
    for k in range(count):
        row_values[HEAD + k] = values[k]
    if kind == PRESSURE:
        row = viewed(parts, AT_PRESSURE, PRESSURE_ROW, 1)
        screen = viewed(parts, AT_SCREEN, SCREEN, 1)
        row[0].suspect, changes = 0, screen[0].changes
        if number(viewed(parts, AT_PRIMARY, PRIMARY, 1), row, pressure_works(row)):
            tells = TELLS | OF_PRIMARY
        judge_pressure(screen, viewed(parts, AT_SCREEN_PARAMS, SCREEN_PARAMS, 1), row)
        if screen[0].changes != changes:
            tells |= TELLS
        air = viewed(parts, AT_AIR, KNOWN, 1)
        if air[0].untold == 1 or math.isfinite(air[0].elevation_m):
            tells |= OF_AIR
    return tells


@step
def follow(parts: Rows, kind: int, verdict: int, host_us: int) -> int:
    """What comes after a sample that got this verdict; a negative one where there was none. The
    heights of an ALTITUDE that is due are in its record then."""
    now_us = viewed(parts, AT_CLOCK, CLOCK, 1)[0].now_us
    health = viewed(parts, AT_HEALTH, HEALTH, 1)
    health_params = viewed(parts, AT_HEALTH_PARAMS, HEALTH_PARAMS, 1)
    agreement = viewed(parts, AT_AGREEMENT, AGREEMENT, 1)
    outputs = viewed(parts, AT_OUTPUTS, OUTPUTS, 1)
    monotonic = viewed(parts, AT_MONOTONIC, MONOTONIC, 1)
    estimate = viewed(parts, AT_ESTIMATE, ESTIMATE, 1)
    if kind == PRESSURE and verdict >= 0:
        row = viewed(parts, AT_PRESSURE, PRESSURE_ROW, 1)
        follow_pressure(agreement, row)
        if row[0].instance == 0 or verdict == USED:
            heard(health, health_params, kind, verdict, now_us, host_us)
        if verdict != STALE:
            altitude_steps.follow_pressure(outputs, monotonic, row, verdict)
    elif kind == ATTITUDE and verdict >= 0 and verdict != STALE:
        altitude_steps.follow_attitude(outputs, viewed(parts, AT_ATTITUDE, ATTITUDE_ROW, 1))
    found = _judge(parts, now_us, verdict == USED, agreement, estimate)
    if verdict == USED and not found & RESTARTS:
        output_params = viewed(parts, AT_OUTPUT_PARAMS, OUTPUT_PARAMS, 1)
        leap, heights = viewed(parts, AT_LEAP, LEAP, 1), viewed(parts, AT_HEIGHTS, ALTITUDE, 1)
        worth = health[0].health
        if altitude(outputs, output_params, monotonic, leap, now_us, worth, estimate, heights):
            found |= DUE
    if silence(health, health_params, host_us):
        found |= SILENT
    return int(found | estimate[0].faulty << OF_FAULTY)


@step
def _judge(parts: Rows, now_us: int, used: bool, agreement: Rows, estimate: Rows) -> int:
    """Bring health up to date, when that is due."""
    health = viewed(parts, AT_HEALTH, HEALTH, 1)
    if not used and not is_due(health, now_us):
        return 0
    code, apart_m = ELLIPSOID, viewed(parts, AT_RECEIVER, RECEIVER, 1)[0].doubt_m
    if not apart_m > LARGEST_DOUBT_M:
        code = objection(agreement, now_us, estimate[0].altitude_amsl_m)
        apart_m = abs(agreement[0].gap_m)
    health_params = viewed(parts, AT_HEALTH_PARAMS, HEALTH_PARAMS, 1)
    found = ASSESSED
    if assess(health, health_params, now_us, estimate, code, apart_m):
        found |= CHANGED
    supported = health[0].has_altitude == 1
    if asks_restart(viewed(parts, AT_CHECKER, CHECKER, 1), agreement, now_us, supported):
        found |= RESTARTS
    return found
