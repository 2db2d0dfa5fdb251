"""The compiled steps of a plain message on the live path (`companion.live`): one call before the
estimator's step, and one after it.

They read the message from its bytes; what follows are the steps of every reading
(`companion.reading_steps`), in which a replay in blocks takes it too.
"""

import numpy as np

from companion.agreement import AGREEMENT
from companion.at_rest import AT_REST
from companion.checker import CHECKER
from companion.health_steps import HEALTH, HEALTH_PARAMS, alive, silence
from companion.intake.clock_steps import CLOCK, CLOCK_PARAMS, is_near
from companion.intake.receiver_steps import PRIMARY, RECEIVER
from companion.intake.row_steps import INTAKE, INTAKE_PARAMS
from companion.intake.screen_steps import SCREEN, SCREEN_PARAMS
from companion.intake.simulation import SIMULATION
from companion.jit import step, viewed
from companion.known_air import KNOWN
from companion.mavlink.altitude_steps import ALTITUDE, OUTPUT_PARAMS, OUTPUTS
from companion.mavlink.continuity import LEAP, MONOTONIC
from companion.mavlink.imu_steps import CHOICE
from companion.mavlink.plain_steps import IDS, MOST_FIELDS, PLAN, find, is_plain, read, stamp_of
from companion.reading_steps import (
    PRESSURE,
    READING,
    USED,
    Following,
    Intaking,
    follow_sample,
    react,
    take_reading,
)
from companion.samples import DTYPES, ESTIMATE, ORDER, Kind, Rows, Tables

LONGEST = 280
"""bytes of the longest frame"""
MOST_PLANS = 8
HEAD = 3
"""fields of a sample before its values, each of 8 bytes"""
U1, U4, I8, F4, F8 = (np.dtype(name) for name in ("u1", "u4", "i8", "f4", "f8"))
(IMU_ROW, PRESSURE_ROW, GNSS_ROW, ATTITUDE_ROW, RANGE_ROW, AIR_ROW, STATUS_ROW, HOME_ROW,
 AIRSPEED_ROW) = (DTYPES[kind] for kind in Kind)  # fmt: skip

(AT_DATA, AT_PLACES, AT_PLANS, AT_CRC, AT_BITS, AT_FLOATS, AT_VALUES, AT_READING, AT_ESTIMATE,
 AT_ORDER) = range(10)  # fmt: skip
AT_ROWS = 10
"""the rows of all kinds, in the order of `Kind`; behind them the same as float64, and as int64"""
AT_NUMBERS = AT_ROWS + len(Kind)
AT_HEADS = AT_NUMBERS + len(Kind)
AT_INTAKING = AT_HEADS + len(Kind)
AT_RECEIVERS, AT_PRIMARIES, AT_FOLLOWING = AT_INTAKING + 10, AT_INTAKING + 14, AT_INTAKING + 16
PARTS = AT_FOLLOWING + 9
"""places of the arrays in `companion.jit.Parts`"""

NOT_TAKEN = -1
"""the message is left to the pipeline, and nothing was changed"""
OF_KIND = 5
"""the kind of a reading is in the bits from here on, above what became of it"""
SILENT, OF_FAULTY = 16, 8
"""added to what came of a sample: the host's clock says that something is missing; the excluded
sensor is in the bits from `OF_FAULTY` on"""


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
    plan, s = plans[found : found + 1], _intaking(parts)
    bits, floats = viewed(parts, AT_BITS, U4, 1), viewed(parts, AT_FLOATS, F4, 1)
    base, stamp_us = plan[0].counts_from, stamp_of(data, plan)
    if not is_near(s.clock, s.clock_params, base, stamp_us):
        return NOT_TAKEN
    if not is_plain(data, plan, bits, floats):
        return NOT_TAKEN
    reading, kind = viewed(parts, AT_READING, READING, 1), plan[0].kind
    reading[0].kind, reading[0].origin, reading[0].stamp_us = kind, base, stamp_us
    reading[0].source, reading[0].rank = plan[0].message_id, plan[0].rank
    reading[0].instance = plan[0].instance
    head = viewed(parts, AT_HEADS + kind, I8, HEAD)
    head[1], head[2] = host_us, plan[0].instance
    values = viewed(parts, AT_VALUES, F8, MOST_FIELDS)
    read(data, plan, bits, floats, values)
    row = viewed(parts, AT_NUMBERS + kind, F8, HEAD + plan[0].count)
    for k in range(plan[0].count):
        row[HEAD + k] = values[k]
    if kind == PRESSURE:
        viewed(parts, AT_ROWS + kind, PRESSURE_ROW, 1)[0].suspect = 0
    alive(
        viewed(parts, AT_FOLLOWING + 2, HEALTH, 1),
        viewed(parts, AT_FOLLOWING + 3, HEALTH_PARAMS, 1),
        host_us,
    )
    became = take_reading(reading, _tables(parts), s, host_us, wants_imu)
    return int(kind << OF_KIND | became)


@step
def follow(parts: Rows, verdict: int, host_us: int) -> int:
    """What comes after the reading that was taken last; its sample got this verdict, a negative one
    where there was none. The heights of an ALTITUDE that is due are in its record then."""
    reading, s = viewed(parts, AT_READING, READING, 1), _following(parts)
    estimate = viewed(parts, AT_ESTIMATE, ESTIMATE, 1)
    if verdict >= 0:
        follow_sample(reading, _tables(parts), estimate, verdict, s)
    found = react(reading, estimate, s, verdict == USED)
    if silence(s.health, s.health_params, host_us):
        found |= SILENT
    return int(found | estimate[0].faulty << OF_FAULTY)


@step
def _tables(parts: Rows) -> Tables:
    """The row of each kind as a table."""
    return Tables(
        viewed(parts, AT_ORDER, ORDER, 1),
        viewed(parts, AT_ROWS, IMU_ROW, 1),
        viewed(parts, AT_ROWS + 1, PRESSURE_ROW, 1),
        viewed(parts, AT_ROWS + 2, GNSS_ROW, 1),
        viewed(parts, AT_ROWS + 3, ATTITUDE_ROW, 1),
        viewed(parts, AT_ROWS + 4, RANGE_ROW, 1),
        viewed(parts, AT_ROWS + 5, AIR_ROW, 1),
        viewed(parts, AT_ROWS + 6, STATUS_ROW, 1),
        viewed(parts, AT_ROWS + 7, HOME_ROW, 1),
        viewed(parts, AT_ROWS + 8, AIRSPEED_ROW, 1),
    )


@step
def _intaking(parts: Rows) -> Intaking:
    receivers = (
        viewed(parts, AT_RECEIVERS, RECEIVER, 1),
        viewed(parts, AT_RECEIVERS + 1, RECEIVER, 1),
        viewed(parts, AT_RECEIVERS + 2, RECEIVER, 1),
        viewed(parts, AT_RECEIVERS + 3, RECEIVER, 1),
    )
    return Intaking(
        viewed(parts, AT_INTAKING, CLOCK, 1),
        viewed(parts, AT_INTAKING + 1, CLOCK_PARAMS, 1),
        viewed(parts, AT_INTAKING + 2, INTAKE, 1),
        viewed(parts, AT_INTAKING + 3, INTAKE_PARAMS, 1),
        viewed(parts, AT_INTAKING + 4, CHOICE, 1),
        viewed(parts, AT_INTAKING + 5, SCREEN, 1),
        viewed(parts, AT_INTAKING + 6, SCREEN_PARAMS, 1),
        viewed(parts, AT_INTAKING + 7, KNOWN, 1),
        viewed(parts, AT_INTAKING + 8, AT_REST, 1),
        viewed(parts, AT_INTAKING + 9, SIMULATION, 1),
        receivers,
        (viewed(parts, AT_PRIMARIES, PRIMARY, 1), viewed(parts, AT_PRIMARIES + 1, PRIMARY, 1)),
    )


@step
def _following(parts: Rows) -> Following:
    return Following(
        viewed(parts, AT_FOLLOWING, AGREEMENT, 1),
        viewed(parts, AT_FOLLOWING + 1, CHECKER, 1),
        viewed(parts, AT_FOLLOWING + 2, HEALTH, 1),
        viewed(parts, AT_FOLLOWING + 3, HEALTH_PARAMS, 1),
        viewed(parts, AT_FOLLOWING + 4, OUTPUTS, 1),
        viewed(parts, AT_FOLLOWING + 5, OUTPUT_PARAMS, 1),
        viewed(parts, AT_FOLLOWING + 6, MONOTONIC, 1),
        viewed(parts, AT_FOLLOWING + 7, LEAP, 1),
        viewed(parts, AT_FOLLOWING + 8, ALTITUDE, 1),
    )
