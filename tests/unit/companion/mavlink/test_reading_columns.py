"""Readings in columns are those of one message at a time, bit for bit."""

import struct
from typing import Any

import numpy as np
import pytest

from companion.mavlink import convert, reading_columns
from companion.mavlink.codec import mavlink
from companion.mavlink.columns import wire_dtype
from companion.mavlink.imu import MILLI_G
from companion.samples import DTYPES, rows

KINDS = {message_id: [make] for message_id, make in convert.CONVERTERS.items()}
KINDS[mavlink.MAVLINK_MSG_ID_RAW_IMU] = [lambda m, x=None: convert.raw_imu(m, MILLI_G)]
for table in convert.THERMOMETERS.values():
    for message_id, make in table.items():
        KINDS[message_id] = [*KINDS.get(message_id, []), make]


def payloads(dtype: np.dtype[Any], count: int) -> np.ndarray[Any, Any]:
    """Bytes of every sort: random, zeros, ones, and plausible floats."""
    generator = np.random.default_rng(1)
    data = generator.integers(0, 256, (count, dtype.itemsize), dtype=np.uint8)
    data[0], data[1] = 0, 255
    found = data.view(dtype)[:, 0].copy()
    for name in dtype.names or ():
        field = dtype[name]
        if field.base.kind == "f":
            found[name][2 : count // 2] = generator.normal(0.0, 500.0, found[name].shape)[
                2 : count // 2
            ]
        elif field.shape == ():
            found[name][2::3] = generator.choice([0, 1, 3, 25, 65535, 9999, 255], count)[
                2::3
            ].astype(field)
    return found


@pytest.mark.parametrize("message_id", sorted(KINDS), ids=lambda i: mavlink.mavlink_map[i].msgname)
def test_columns_are_the_single_messages(message_id: int) -> None:
    dtype = wire_dtype(message_id)
    assert dtype is not None
    table = payloads(dtype, 300)
    columns = [
        each for make in KINDS[message_id] for each in reading_columns.readings_of(make, table)
    ]
    merged: list[list[bytes]] = [[] for _ in range(table.size)]
    for each in columns:
        for i, place in enumerate(each.places.tolist()):
            row = each.samples[i : i + 1]
            merged[place].append(
                struct.pack("<q", int(each.stamp_us[i])) + each.base.name.encode() + row.tobytes()
            )
    for i, expected in enumerate(merged):
        record = table[i]
        message = type("Message", (), {name: record[name].tolist() for name in dtype.names or ()})
        readings = [each for make in KINDS[message_id] for each in make(message)]
        found = []
        for reading in readings:
            row = rows(DTYPES[reading.kind])
            unsaid = DTYPES[reading.kind].names or ()
            row["instance"] = reading.instance
            for name, value in zip(unsaid[3:], reading.values, strict=False):
                row[name] = value
            stamp_us = min(reading.stamp_us, reading_columns.LARGEST_STAMP_US)
            found.append(struct.pack("<q", stamp_us) + reading.base.name.encode() + row.tobytes())
        assert found == expected, f"message {i}"
