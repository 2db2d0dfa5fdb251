"""The compiled reading of a plain message (`companion.mavlink.plain`): the bytes of a frame -> the
values of a sample."""

import math

import numpy as np

from companion.intake.clock_steps import LARGEST_STAMP_US
from companion.jit import step
from companion.mavlink.record_scan import CHECKSUM, V2, V2_HEADER
from companion.samples import Record, Rows

UNSIGNED, SIGNED, FLOAT = range(3)
MOST_FIELDS = 6
IDS = 256
"""ids of plain messages are below this"""

FIELD = np.dtype([("at", "i8"), ("width", "i8"), ("form", "i8")], align=True)
"""Where a field is in the payload; a width of 0 is none."""
PLAN = np.dtype(
    [
        ("message_id", "i8"),
        ("crc_extra", "i8"),
        ("kind", "i8"),
        ("counts_from", "i8"),
        ("instance", "i8"),
        ("rank", "i8"),  # of an IMU message; -1 none
        ("stamp", FIELD),
        ("stamp_us", "i8"),  # its unit
        ("zero", FIELD),  # a field that must be 0 or not finite
        ("count", "i8"),
        ("fields", FIELD, (MOST_FIELDS,)),
        ("scales", "f8", (MOST_FIELDS,)),
        ("offsets", "f8", (MOST_FIELDS,)),
    ],
    align=True,
)
"""How a message becomes a sample: each value is a field times its scale plus its offset."""


@step
def find(
    data: Rows, system_id: int, component_id: int, places: Rows, plans: Rows, crc_table: Rows
) -> int:
    """The place of the plan of `data`, when that is one whole MAVLink 2 frame of this sender,
    unsigned, undamaged and of a plain message; -1 otherwise.

    Parameters
    ----------
    data : uint8, shape (n,).
    places : int64, shape (IDS,): the place of a message's plan, by its id; -1 for none.
    crc_table : int64, shape (256,): the table of the checksum (CRC-16/MCRF4XX).
    """
    size = data.shape[0]
    if size < V2_HEADER + CHECKSUM or data[0] != V2 or data[2] != 0:
        return -1
    body = V2_HEADER + int(data[1])
    if body + CHECKSUM != size or data[8] != 0 or data[9] != 0:
        return -1
    if int(data[5]) != system_id or int(data[6]) != component_id:
        return -1
    place = int(places[int(data[7])])
    if place < 0:
        return -1
    crc = 0xFFFF
    for i in range(1, body):
        crc = int(crc_table[(crc ^ int(data[i])) & 0xFF]) ^ crc >> 8
    crc = int(crc_table[(crc ^ plans[place].crc_extra) & 0xFF]) ^ crc >> 8
    return place if crc == int(data[body]) | int(data[body + 1]) << 8 else -1


@step
def stamp_of(data: Rows, plan: Rows) -> int:
    """The time stamp, us; a stamp that is too large to be one is the largest."""
    stamp = _integer(data, plan[0].stamp)
    if not 0 <= stamp < LARGEST_STAMP_US:
        return LARGEST_STAMP_US
    return int(min(stamp * plan[0].stamp_us, LARGEST_STAMP_US))


@step
def is_plain(data: Rows, plan: Rows, bits: Rows, floats: Rows) -> bool:
    """Whether the message holds no second sample; `bits` (uint32) and `floats` (float32), shape
    (1,), are the same memory."""
    if plan[0].zero.width == 0:
        return True
    value = _number(data, plan[0].zero, bits, floats)
    return value == 0.0 or not math.isfinite(value)


@step
def read(data: Rows, plan: Rows, bits: Rows, floats: Rows, values: Rows) -> None:
    """Write the values of the sample, float64; what is not finite is NaN."""
    for k in range(plan[0].count):
        value = _number(data, plan[0].fields[k], bits, floats) * plan[0].scales[k]
        if plan[0].offsets[k] != 0.0:  # which keeps a negative zero
            value += plan[0].offsets[k]
        values[k] = value if math.isfinite(value) else math.nan


@step
def _number(data: Rows, field: Record, bits: Rows, floats: Rows) -> float:
    if field.form != FLOAT:
        return float(_integer(data, field))
    bits[0] = _integer(data, field)
    return float(floats[0])


@step
def _integer(data: Rows, field: Record) -> int:
    """An integer, little-endian; zeros at the end of a payload are not sent. Negative where it does
    not fit into 63 bits."""
    value, end = 0, data.shape[0] - CHECKSUM
    for i in range(field.width):
        at = V2_HEADER + field.at + i
        if at < end:
            value |= int(data[at]) << 8 * i
    if field.form == SIGNED and value >> (8 * field.width - 1) & 1:
        value -= 1 << 8 * field.width
    return value
