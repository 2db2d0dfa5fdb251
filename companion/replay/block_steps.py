"""The compiled loops of a replay in blocks (`companion.replay.blocks`): the steps that the pipeline
takes for each message live, over the messages of a block.

`take_in` makes samples of readings, an estimator's `run` follows, and `follow` does what comes
after a sample: the independent check, health, ALTITUDE. Both stop before a message that needs more
than these steps, such as a restart of the vehicle or something to log; the pipeline takes that
one.
"""

import math
from typing import NamedTuple

import numpy as np

from companion import at_rest
from companion.agreement import follow_fix, follow_pressure
from companion.checker import ELLIPSOID, asks_restart, objection
from companion.health_steps import LOST, OF_HOST, alive, assess, heard, is_due, lose, silence
from companion.intake.clock_steps import DOUBT, REBOOT, note_unix, place
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
from companion.intake.row_steps import DOUBTED, LARGEST_DOUBT_M, RIGHT, UNSETTLED, air_time
from companion.intake.screen_steps import baro_m, judge_fix, judge_pressure
from companion.intake.simulation import is_met, note_fix
from companion.jit import step
from companion.known_air import is_due as is_air_due
from companion.mavlink import altitude_steps
from companion.mavlink.altitude_steps import altitude, own_height, vehicle_altitude
from companion.mavlink.imu_steps import accepts, replaces_pressure
from companion.samples import MAX_INSTANCES, Kind, Rows, Tables, Verdict

PLAIN, PYTHON, SYSTEM_TIME, OWN_HEIGHT, ALTITUDE_HEARD, TRUTH = range(6)
RECORDED_HEIGHT, RECORDED_TRUTH = 6, 7
"""what an item is, beside its readings; PYTHON is for the pipeline"""
LEFT_OUT, NO_SAMPLE = -2, -1
"""places of a reading without a sample: one that was dropped, and one that only moved the clock"""
NO_CLOCK, CLOCK_JUMPED, REPLACED = range(3)
IMU, PRESSURE, GNSS = int(Kind.IMU), int(Kind.PRESSURE), int(Kind.GNSS)
ATTITUDE, RANGE, AIR = int(Kind.ATTITUDE), int(Kind.RANGE), int(Kind.AIR)
STATUS, HOME, AIRSPEED = int(Kind.STATUS), int(Kind.HOME), int(Kind.AIRSPEED)
USED, STALE = int(Verdict.USED), int(Verdict.STALE)

ITEM = np.dtype(
    [
        ("arrival_us", "i8"),
        ("is_frame", "i8"),
        ("is_vehicle", "i8"),  # a frame of it
        ("what", "i8"),
        ("first", "i8"),  # of its readings
        ("count", "i8"),
        ("now_us", "i8"),  # the vehicle's clock before its readings
        ("a_us", "i8"),  # SYSTEM_TIME: UNIX time; a height: its time
        ("b_us", "i8"),  # SYSTEM_TIME: boot time
        ("altitude_m", "f8"),  # of a height
        ("above_home_m", "f8"),  # OWN_HEIGHT
        ("climb_mps", "f8"),  # of a height
    ],
    align=True,
)
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
        ("place", "i8"),  # of its sample in the order, LEFT_OUT, NO_SAMPLE
        ("time_us", "i8"),  # of its sample
        ("number", "i8"),  # of its sensor among its kind
        ("now_us", "i8"),  # the vehicle's clock after it
        ("unix_us", "i8"),
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
    counts: Rows


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


@step
def enter(
    items: Rows, readings: Rows, used: Rows, places: Rows, stamps_us: Rows, instances: Rows,
    above_m: Rows, kind: int, origin: int, source: int, rank: int, is_highres: int, row: int,
) -> None:  # fmt: skip
    """Enter readings of one kind and message behind those that their items have already.

    Parameters
    ----------
    items : with `first` right.
    used : int64, how many readings of each item are entered; kept up to date.
    places, stamps_us, instances : int64, shape (n,), of the readings: of their items, and so on.
    above_m : shape (n,), or (0,) where nothing is known of the geoid.
    rank : of the message among those of the primary IMU.
    row : of the first reading in the table of its kind.
    """
    for i in range(places.shape[0]):
        f = places[i]
        reading = readings[items[f].first + used[f]]
        used[f] += 1
        reading.kind, reading.row, reading.origin = kind, row + i, origin
        reading.stamp_us, reading.source, reading.instance = stamps_us[i], source, instances[i]
        reading.rank = rank if instances[i] == 0 else -1
        reading.is_highres = is_highres
        reading.above_m = above_m[i] if above_m.shape[0] else math.nan


@step
def copy_words(target: Rows, column: int, source: Rows, places: Rows) -> None:
    """Copy the rows at `places` of `source`, int64 of shape (n, words), into those of `target` from
    `column` on."""
    for i in range(places.shape[0]):
        for k in range(source.shape[1]):
            target[i, column + k] = source[places[i], k]


@step
def take_in(
    items: Rows, readings: Rows, tables: Tables, s: Intaking, start: int, stop: int, count: int
) -> tuple[int, int]:
    """Make samples of the readings of ``items[start:stop]``: rows of `tables`, in its order.

    Returns
    -------
    stop : the item that the pipeline has to take, or `stop`.
    count : of samples in the order.
    """
    changes, wrong = s.screen[0].changes, s.clock[0].wrong_units
    doubted = s.row_params[0].equal_heights == DOUBTED
    for f in range(start, stop):
        item = items[f]
        if item.what == PYTHON:
            return f, count
        if item.what == SYSTEM_TIME:
            note_unix(s.clock, item.a_us, item.b_us)
        item.now_us = s.clock[0].now_us
        if item.what == TRUTH:
            item.a_us = item.now_us
        is_truth = item.what in (TRUTH, RECORDED_TRUTH)
        if is_truth and doubted and is_met(s.simulation, item.altitude_m):
            return f, count
        for r in range(item.first, item.first + item.count):
            reading = readings[r]
            effect, time_us = place(
                s.clock, s.clock_params, reading.origin, reading.stamp_us, reading.source,
                item.arrival_us,
            )  # fmt: skip
            if effect == REBOOT or s.clock[0].wrong_units != wrong:
                return f, count
            reading.now_us, reading.unix_us = s.clock[0].now_us, s.clock[0].unix_us
            if effect == DOUBT or not 0 <= reading.instance < MAX_INSTANCES:
                s.counts[NO_CLOCK if s.clock[0].now_us < 0 else CLOCK_JUMPED] += 1
                reading.place = LEFT_OUT
                continue
            if _is_replaced(readings[r : r + 1], tables, s):
                s.counts[REPLACED] += 1
                reading.place = NO_SAMPLE
            elif _fill(readings[r : r + 1], tables, s, time_us):
                return f, count
            else:
                reading.place = count
                tables.order[count].kind, tables.order[count].row = reading.kind, reading.row
                count += 1
            reading.doubt_m = s.receivers[0][0].doubt_m
        if s.screen[0].changes != changes:
            return f, count
    return stop, count


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
def _fill(reading: Rows, tables: Tables, s: Intaking, time_us: int) -> bool:
    """Complete the row of a reading at `time_us`; True when that needs the pipeline."""
    kind, row = reading[0].kind, reading[0].row
    reading[0].time_us, reading[0].number = time_us, reading[0].instance
    if kind == IMU:
        tables.imu[row].time_us = time_us
    elif kind == PRESSURE:
        pressure = tables.pressure[row : row + 1]
        pressure[0].time_us = time_us
        if number(s.primaries[0], pressure, pressure_works(pressure)):
            return True
        reading[0].number = pressure[0].instance
        judge_pressure(s.screen, s.screen_params, pressure)
        if not math.isnan(s.known_air[0].elevation_m):
            at_rest.follow_pressure(s.at_rest, pressure)
        return is_air_due(s.known_air, s.at_rest, reading[0].now_us)
    elif kind == GNSS:
        fix = tables.gnss[row : row + 1]
        fix[0].time_us = time_us - s.row_params[0].latency_us
        if _check_fix(fix, s, reading[0].above_m):
            return True
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
    return False


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
def follow(
    items: Rows, readings: Rows, tables: Tables, estimates: Rows, verdicts: Rows, healths: Rows,
    s: Following, start: int, stop: int, latest: int,
) -> tuple[int, int]:  # fmt: skip
    """What comes after the samples of ``items[start:stop]``.

    Parameters
    ----------
    estimates : of ESTIMATE, after each sample; the first is that before the first sample.
    healths : int64, gets the health before what a sample does to it.
    latest : how many samples there were before `start`.

    Returns
    -------
    stop : the item that the pipeline has to take, or `stop`.
    published : how many ALTITUDE of ours were due.
    """
    published = 0
    for f in range(start, stop):
        item = items[f]
        if item.is_vehicle:
            alive(s.health, s.health_params, item.arrival_us)
        if item.what == OWN_HEIGHT:
            s.outputs[0].own_us, s.outputs[0].own_amsl_m = item.a_us, item.altitude_m
            s.outputs[0].own_home_m = item.above_home_m
            own_height(s.outputs, s.output_params, item.now_us, s.health[0].health)
        elif item.what == ALTITUDE_HEARD:
            vehicle_altitude(s.outputs, item.now_us)
        for r in range(item.first, item.first + item.count):
            at, used = readings[r].place, False
            if at == LEFT_OUT:
                continue
            if at >= 0:
                latest = at + 1
                estimate = estimates[latest : latest + 1]
                _sample(readings[r : r + 1], tables, estimate, verdicts[at], s)
                healths[at], used = s.health[0].health, verdicts[at] == USED
            due = _react(readings[r : r + 1], estimates[latest : latest + 1], s, used)
            if due < 0:
                return f, published
            published += due
        lost = silence(s.health, s.health_params, item.arrival_us) if item.is_frame else 0
        if lost and s.health[0].health != LOST:
            return f, published
        if lost == 1 and (s.health[0].reason != OF_HOST or s.health[0].detail != 1):
            return f, published
        if lost:
            lose(s.health, s.health_params, lost, item.arrival_us)
    return stop, published


@step
def _sample(reading: Rows, tables: Tables, estimate: Rows, verdict: int, s: Following) -> None:
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
def _react(reading: Rows, estimate: Rows, s: Following, used: bool) -> int:
    """What is due now that the clock has moved: 1 when ALTITUDE is, 0, -1 when the pipeline has to
    restart the estimator."""
    now_us, h = reading[0].now_us, s.health
    if used or is_due(h, now_us):
        altitude_m, doubt_m = estimate[0].altitude_amsl_m, reading[0].doubt_m
        code, apart_m = ELLIPSOID, doubt_m
        if not doubt_m > LARGEST_DOUBT_M:
            code, apart_m = objection(s.agreement, now_us, altitude_m), abs(s.agreement[0].gap_m)
        assess(h, s.health_params, now_us, estimate, code, apart_m)
        if asks_restart(s.checker, s.agreement, now_us, h[0].has_altitude == 1):
            return -1
    if not used:
        return 0
    is_due_now = altitude(
        s.outputs, s.output_params, s.monotonic, s.leap, now_us, h[0].health, estimate, s.heights
    )
    return 1 if is_due_now else 0
