"""The compiled loops of a replay in blocks (`companion.replay.blocks`): the steps that the pipeline
takes for each message live, over the messages of a block.

`take_in` makes samples of readings, an estimator's `run` follows, and `follow` does what comes
after a sample: the independent check, health, what is to be sent. Both stop before a message that
needs more than these steps, such as a restart of the vehicle, something to log, or a text to the
pilot; the pipeline takes that one.
"""

import math
from typing import NamedTuple

import numpy as np

from companion.health_steps import LOST, OF_HOST, alive, lose, silence
from companion.intake.clock_steps import note_unix
from companion.intake.row_steps import DOUBTED
from companion.intake.simulation import is_met
from companion.jit import step
from companion.mavlink.altitude_steps import (
    ALTITUDE,
    DEBUG_SLOT,
    OF_OURS,
    OF_VEHICLE,
    own_height,
    qnh_hpa,
    takes,
    vehicle_altitude,
)
from companion.reading_steps import (
    ASSESSED,
    CHANGED,
    DUE,
    LEFT_OUT,
    REPLACED,
    RESTARTS,
    TELLS,
    USED,
    Following,
    Intaking,
    follow_sample,
    react,
    take_reading,
)
from companion.samples import Rows, Tables

PLAIN, PYTHON, SYSTEM_TIME, OWN_HEIGHT, ALTITUDE_HEARD, TRUTH = range(6)
RECORDED_HEIGHT, RECORDED_TRUTH = 6, 7
"""what an item is, beside its readings; PYTHON is for the pipeline"""
OUT_OF_TIME, NO_SAMPLE = -2, -1
"""places of a reading without a sample: one that was dropped, and one that only moved the clock"""
NO_CLOCK, CLOCK_JUMPED, OF_REPLACED = range(3)
"""places of the counters of readings without a sample"""

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
TELLING = np.dtype(
    [
        ("sends", "i8"),  # whether messages are made
        ("debug", "i8"),  # whether the DEBUG family is among them,
        ("texts", "i8"),  # and STATUSTEXT
        ("source", "i8"),  # of the height in ALTITUDE: told last
        ("excluded", "i8"),  # sensor: told last
        ("count", "i8"),  # of the messages that are due
        ("spacing_us", "i8"),  # of the texts of a kind
    ],
    align=True,
)
"""What is sent."""
OUR_HEIGHT, OWN_HEIGHT_DUE, DEBUG_DUE = range(3)
MESSAGE = np.dtype(
    [
        ("of_item", "i8"),
        ("what", "i8"),
        ("now_us", "i8"),
        ("health", "i8"),
        ("sample", "i8"),  # how many samples there were
        ("qnh_hpa", "f8"),
        ("heights", ALTITUDE),
    ],
    align=True,
)
"""A message that is due; `heights` of an ALTITUDE, the health and what follows of the DEBUG family.
"""


class Telling(NamedTuple):
    """What is sent, and what is due."""

    state: Rows
    """TELLING"""
    waiting_us: Rows
    """int64, when the last text of each kind was sent of which another waits"""
    messages: Rows
    """MESSAGE, a row for each message that may become due"""


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
    items: Rows, readings: Rows, tables: Tables, s: Intaking, outputs: Rows, output_params: Rows,
    told: Rows, counts: Rows, start: int, stop: int,
) -> tuple[int, int]:  # fmt: skip
    """Make samples of the readings of ``items[start:stop]``: rows of `tables`, in its order.

    Parameters
    ----------
    told : TELLING, with the state and parameters of the outputs for the slots of DEBUG.
    counts : int64, shape (3,), gets the readings without a sample.

    Returns
    -------
    stop : the item that the pipeline has to take, or `stop`.
    count : of samples in the order.
    """
    count, doubted = 0, s.row_params[0].equal_heights == DOUBTED
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
            became = take_reading(readings[r : r + 1], tables, s, item.arrival_us, True)
            if became >= TELLS:
                return f, count
            if became == LEFT_OUT:
                counts[NO_CLOCK if s.clock[0].now_us < 0 else CLOCK_JUMPED] += 1
                reading.place = OUT_OF_TIME
                continue
            if became == REPLACED:
                counts[OF_REPLACED] += 1
                reading.place = NO_SAMPLE
            else:
                reading.place = count
                tables.order[count].kind, tables.order[count].row = reading.kind, reading.row
                count += 1
            if told[0].debug and takes(outputs, output_params, DEBUG_SLOT, reading.now_us):
                reading.debug = 1 + count
    return stop, count


@step
def follow(
    items: Rows, readings: Rows, tables: Tables, estimates: Rows, verdicts: Rows, healths: Rows,
    s: Following, t: Telling, start: int, stop: int,
) -> tuple[int, int]:  # fmt: skip
    """What comes after the samples of ``items[start:stop]``.

    Parameters
    ----------
    estimates : of ESTIMATE, after each sample; the first is that before the first sample.
    healths : int64, gets the health before what a sample does to it.

    Returns
    -------
    stop : the item that the pipeline has to take, or `stop`.
    published : how many ALTITUDE of ours were due.
    """
    latest, published, told = 0, 0, t.state[0]
    told.count = 0
    for f in range(start, stop):
        item = items[f]
        if item.is_vehicle:
            alive(s.health, s.health_params, item.arrival_us)
        if item.what == OWN_HEIGHT:
            if not _own_height(items[f : f + 1], f, s, t, latest):
                return f, published
        elif item.what == ALTITUDE_HEARD:
            vehicle_altitude(s.outputs, item.now_us)
        for r in range(item.first, item.first + item.count):
            reading, at, used = readings[r : r + 1], readings[r].place, False
            if at == OUT_OF_TIME:
                continue
            if at >= 0:
                latest, used = at + 1, verdicts[at] == USED
                follow_sample(reading, tables, estimates[latest : latest + 1], verdicts[at], s)
                healths[at] = s.health[0].health
            estimate = estimates[latest : latest + 1]
            found = react(reading, estimate, s, used)
            if found & RESTARTS or not _tell(reading, estimate, f, s, t, found, latest):
                return f, published
            published += 1 if found & DUE else 0
        if not item.is_frame:
            continue
        if _is_text_due(t, item.arrival_us) or not _is_heard(s, item.arrival_us):
            return f, published
    return stop, published


@step
def _is_heard(s: Following, host_us: int) -> bool:
    """Lose a height that is old on the host's clock; False when that is the pipeline's to tell."""
    lost = silence(s.health, s.health_params, host_us)
    if not lost:
        return True
    is_told = s.health[0].reason == OF_HOST and s.health[0].detail == 1
    if s.health[0].health != LOST or (lost == 1 and not is_told):
        return False
    lose(s.health, s.health_params, lost, host_us)
    return True


@step
def _own_height(item: Rows, f: int, s: Following, t: Telling, latest: int) -> bool:
    """Follow the vehicle's own height; False when the pipeline has to tell that it is sent now."""
    o, told = s.outputs, t.state[0]
    o[0].own_us, o[0].own_amsl_m = item[0].a_us, item[0].altitude_m
    o[0].own_home_m = item[0].above_home_m
    now_us, health = item[0].now_us, s.health[0].health
    is_due = own_height(o, s.output_params, s.monotonic, now_us, health, s.heights)
    if is_due and told.sends:
        if told.source != OF_VEHICLE:
            return False
        _add(t, f, OWN_HEIGHT_DUE, s, now_us, latest)
    return True


@step
def _tell(
    reading: Rows, estimate: Rows, f: int, s: Following, t: Telling, found: int, latest: int
) -> bool:
    """Note what is to be sent after a reading; False when there is a text to tell."""
    told, now_us = t.state[0], reading[0].now_us
    if not told.sends:
        return True
    if told.texts and found & CHANGED:
        return False
    if told.texts and found & ASSESSED and estimate[0].faulty != told.excluded:
        return False
    if found & DUE and told.source != OF_OURS:
        return False
    if found & DUE:
        _add(t, f, OUR_HEIGHT, s, now_us, latest)
    if reading[0].debug:
        _add(t, f, DEBUG_DUE, s, now_us, latest)
        qnh = qnh_hpa(s.outputs, s.monotonic, estimate, now_us)
        t.messages[told.count - 1].qnh_hpa = qnh
    return True


@step
def _add(t: Telling, f: int, what: int, s: Following, now_us: int, latest: int) -> None:
    """Note a message that is due: an ALTITUDE with the newest heights, or the DEBUG family."""
    message = t.messages[t.state[0].count]
    t.state[0].count += 1
    message.of_item, message.what, message.now_us = f, what, now_us
    message.health, message.sample = s.health[0].health, latest
    message.heights = s.heights[0]


@step
def _is_text_due(t: Telling, host_us: int) -> bool:
    """Whether one of the texts that wait may be sent (`companion.mavlink.texts`)."""
    for k in range(t.waiting_us.shape[0]):
        if not 0 <= host_us - t.waiting_us[k] < t.state[0].spacing_us:
            return True
    return False
