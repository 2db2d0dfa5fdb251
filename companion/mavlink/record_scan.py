"""Compiled scan of a telemetry log's records, and compiled copying of their payloads.

A record is a 64-bit time, big-endian by rule, and one MAVLink frame; of a capture without times, a
frame alone. `scan_records` follows records that are whole, known and undamaged, and stops at the
first that is not; `companion.logs.tlog` and `companion.logs.raw` continue from there, in Python,
once for every damaged place. The rules for a frame are those of `companion.mavlink.framing.scan`; a
test holds the two equal.
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
"""bytes of the time of a record"""
V1, V2 = 0xFE, 0xFD
V1_HEADER, V2_HEADER = 6, 10
CHECKSUM, SIGNATURE, SIGNED = 2, 13, 1
STRIDE = 8
"""bytes that the checksum takes at a time"""


@step
def scan_records(
    data: Rows,
    offset: int,
    limit: int,
    last_time_us: int,
    little: int,
    stamp: int,
    crc_tables: Rows,
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
    stamp : bytes of the time before a frame; 0 in a capture without times, which get time 0.
    crc_tables : int64, shape (STRIDE, 256): what a byte changes in the checksum (CRC-16/MCRF4XX),
        by the number of bytes behind it.
    extras : int64, shape (largest id + 1,): CRC_EXTRA by message id, -1 for unknown ids.
    v1_lengths : int64, shape (largest id + 1, 2): smallest and largest MAVLink 1 payload.
    index : `INDEX` rows to write to, from row `count` on.

    Returns
    -------
    count : of rows of `index` in use.
    offset : of the first record that is not good, or not complete, or begins at or after `limit`.
    """
    while offset < limit and count < index.shape[0]:
        stop = _read_frame(data, offset + stamp, crc_tables, extras, v1_lengths, index, count)
        if stop < 0:
            break
        time_us = 0
        for i in range(stamp):
            time_us = time_us << 8 | int(data[offset + (stamp - 1 - i if little else i)])
        if time_us < 0 or time_us > last_time_us:
            break
        index[count].time_us = time_us
        count += 1
        offset = stop
    return count, offset


@step
def _read_frame(
    data: Rows, at: int, crc_tables: Rows, extras: Rows, v1_lengths: Rows, index: Rows, count: int
) -> int:
    """Write the frame that begins at `at` to row `count`; where it ends, -1 when it is not good or
    not complete."""
    size = data.shape[0]
    if at + 3 > size:
        return -1
    is_v2 = data[at] == V2
    if not is_v2 and data[at] != V1:
        return -1
    header = V2_HEADER if is_v2 else V1_HEADER
    flags = int(data[at + 2]) if is_v2 else 0
    length = int(data[at + 1])
    body = at + header + length
    stop = body + CHECKSUM + (SIGNATURE if flags else 0)
    if flags > SIGNED or stop > size:
        return -1
    message_id = int(data[at + header - 1])
    if is_v2:
        message_id = int(data[at + 7]) | int(data[at + 8]) << 8 | int(data[at + 9]) << 16
    if message_id >= extras.shape[0] or extras[message_id] < 0:
        return -1
    if not is_v2 and not v1_lengths[message_id, 0] <= length <= v1_lengths[message_id, 1]:
        return -1
    crc = _checksum(data, at + 1, body, extras[message_id], crc_tables)
    if crc != int(data[body]) | int(data[body + 1]) << 8:
        return -1
    first = at + (4 if is_v2 else 2)
    row = index[count]
    row.start, row.stop = at, stop
    row.payload, row.length = at + header, length
    row.message_id = message_id
    row.sequence = int(data[first])
    row.system_id = int(data[first + 1])
    row.component_id = int(data[first + 2])
    row.version, row.signed = 2 if is_v2 else 1, flags
    return stop


@step
def _checksum(data: Rows, first: int, stop: int, extra: int, crc_tables: Rows) -> int:
    """CRC-16/MCRF4XX of ``data[first:stop]`` and CRC_EXTRA, by the tables of eight bytes at once
    (slicing-by-8)."""
    crc, i = 0xFFFF, first
    while i + STRIDE <= stop:
        crc = (
            crc_tables[7, (crc ^ int(data[i])) & 0xFF]
            ^ crc_tables[6, (crc >> 8 ^ int(data[i + 1])) & 0xFF]
            ^ crc_tables[5, int(data[i + 2])]
            ^ crc_tables[4, int(data[i + 3])]
            ^ crc_tables[3, int(data[i + 4])]
            ^ crc_tables[2, int(data[i + 5])]
            ^ crc_tables[1, int(data[i + 6])]
            ^ crc_tables[0, int(data[i + 7])]
        )
        i += STRIDE
    while i < stop:
        crc = crc_tables[0, (crc ^ int(data[i])) & 0xFF] ^ crc >> 8
        i += 1
    return int(crc_tables[0, (crc ^ extra) & 0xFF] ^ crc >> 8)


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


@step
def merge_records(
    times_us: Rows, data: Rows, index: Rows, places: Rows, ends: Rows, ours: Rows, records: Rows
) -> None:
    """Write the records of a log's frames, with frames of ours behind some of them.

    Parameters
    ----------
    times_us : int64, shape (n,), of the log's frames.
    data, index : the buffer of these frames, and INDEX rows of shape (n,).
    places : int64, shape (m,), increasing: the frame of the log that each of ours follows.
    ends : int64, shape (m + 1,): where each of ours begins in `ours`, and where the last ends.
    records : uint8, gets a big-endian time and a frame each; as long as all of them.
    """
    at, k = 0, 0
    for i in range(times_us.shape[0]):
        at = _write_record(times_us[i], data, index[i].start, index[i].stop, records, at)
        while k < places.shape[0] and places[k] == i:
            at = _write_record(times_us[i], ours, ends[k], ends[k + 1], records, at)
            k += 1


@step
def _write_record(
    time_us: int, data: Rows, start: int, stop: int, records: Rows, at: int
) -> int:  # fmt: skip
    """Write one record; where the next begins."""
    for k in range(STAMP):
        records[at + k] = time_us >> 8 * (STAMP - 1 - k) & 0xFF
    at += STAMP
    for k in range(stop - start):
        records[at + k] = data[start + k]
    return at + stop - start
