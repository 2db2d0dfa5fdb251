"""Compiled scan of a telemetry log's records, and compiled copying of their payloads.

A record is a 64-bit time, big-endian by rule, and one MAVLink frame. `scan_records` follows records
that are whole, known and undamaged, and stops at the first that is not: what to do there is decided
by `companion.logs.tlog`, in Python, once for every damaged place. The rules for a frame are those
of `companion.mavlink.framing.scan`; a test holds the two equal.
"""

import numpy as np

from companion.jit import step
from companion.samples import Rows

INDEX = np.dtype(
    [
        ("time_us", "i8"),
        ("start", "i4"),  # of the frame in the buffer
        ("stop", "i4"),
        ("payload", "i4"),  # start of the payload in the buffer
        ("length", "i4"),  # of the payload
        ("message_id", "i4"),
        ("system_id", "i4"),
        ("component_id", "i4"),
        ("sequence", "i4"),
        ("version", "i4"),
        ("signed", "i4"),
    ],
    align=True,
)
"""One row a frame."""

STAMP = 8
V1, V2 = 0xFE, 0xFD
V1_HEADER, V2_HEADER = 6, 10
CHECKSUM, SIGNATURE, SIGNED = 2, 13, 1


@step
def scan_records(
    data: Rows,
    offset: int,
    limit: int,
    last_time_us: int,
    little: int,
    crc_table: Rows,
    extras: Rows,
    v1_lengths: Rows,
    index: Rows,
    count: int,
) -> tuple[int, int]:
    """Index the good records that follow each other from `offset` on and begin before `limit`.

    Parameters
    ----------
    data : uint8, shape (n,).
    last_time_us : a record with a later time is not good.
    little : 1 when the times are little-endian.
    crc_table : int64, shape (256,): the table of the checksum (CRC-16/MCRF4XX).
    extras : int64, shape (largest id + 1,): CRC_EXTRA by message id, -1 for unknown ids.
    v1_lengths : int64, shape (largest id + 1, 2): smallest and largest MAVLink 1 payload.
    index : `INDEX` rows to write to, from row `count` on.

    Returns
    -------
    count : of rows of `index` in use.
    offset : of the first record that is not good, or not complete, or begins at or after `limit`.
    """
    size = data.shape[0]
    while offset < limit and count < index.shape[0]:
        at = offset + STAMP
        if at + 3 > size:
            break
        start = int(data[at])
        if start == V2:
            header, flags = V2_HEADER, int(data[at + 2])
        elif start == V1:
            header, flags = V1_HEADER, 0
        else:
            break
        if flags > SIGNED:
            break
        length = int(data[at + 1])
        body = at + header + length
        stop = body + CHECKSUM + (SIGNATURE if flags else 0)
        if stop > size:
            break
        time_us = 0
        for i in range(STAMP):
            time_us = time_us << 8 | int(data[at - 1 - i if little else offset + i])
        if time_us < 0 or time_us > last_time_us:
            break
        if start == V2:
            message_id = int(data[at + 7]) | int(data[at + 8]) << 8 | int(data[at + 9]) << 16
        else:
            message_id = int(data[at + 5])
        if message_id >= extras.shape[0] or extras[message_id] < 0:
            break
        if start == V1 and not v1_lengths[message_id, 0] <= length <= v1_lengths[message_id, 1]:
            break
        crc = 0xFFFF
        for i in range(at + 1, body):
            crc = crc_table[(crc ^ int(data[i])) & 0xFF] ^ crc >> 8
        crc = crc_table[(crc ^ extras[message_id]) & 0xFF] ^ crc >> 8
        if crc != int(data[body]) | int(data[body + 1]) << 8:
            break
        index[count].time_us = time_us
        index[count].start = at
        index[count].stop = stop
        index[count].payload = at + header
        index[count].length = length
        index[count].message_id = message_id
        first = at + (4 if start == V2 else 2)
        index[count].sequence = int(data[first])
        index[count].system_id = int(data[first + 1])
        index[count].component_id = int(data[first + 2])
        index[count].version = 2 if start == V2 else 1
        index[count].signed = flags
        count += 1
        offset = stop
    return count, offset


@step
def gather(data: Rows, starts: Rows, lengths: Rows, table: Rows) -> None:
    """Copy pieces of `data` (uint8, shape (n,)) into the rows of `table` (uint8, shape (rows,
    width)).

    Row i gets ``data[starts[i]:starts[i] + lengths[i]]``: cut at the width, zeros behind it.
    """
    width = table.shape[1]
    for row in range(table.shape[0]):
        used = min(width, int(lengths[row]))
        for i in range(used):
            table[row, i] = data[int(starts[row]) + i]
        for i in range(used, width):
            table[row, i] = 0
