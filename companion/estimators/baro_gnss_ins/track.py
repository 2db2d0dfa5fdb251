"""A short history of position and velocity, so that a late fix meets the state of its own time.

`companion.kernels.ring` does this for a scalar; a filter whose state is corrected in between must
also move its past, or it would see the same error again in every fix that is under way. An entry is
six values: latitude and longitude (rad), height (m), velocity north, east and down (m/s).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.estimators.baro_gnss_ins.strapdown import move
from companion.jit import step
from companion.samples import Record

Array = NDArray[Any]

SIZE = 64
SPACING_US = 18_000
"""Least time between entries: a second fits whatever the rate of the IMU (50 Hz keeps every
sample)."""


TRACK = np.dtype(
    [
        ("times_us", "i8", (SIZE,)),  # -1 is empty
        ("entries", "f8", (SIZE, 6)),
        ("next", "i8"),  # slot of the next entry
        ("at", "f8", (6,)),  # the state at the time of the newest fix
    ],
    align=True,
)
"""The record of this component."""


@step
def clear(track: Record) -> None:
    """Empty the track."""
    for index in range(SIZE):
        track.times_us[index] = -1
        for i in range(6):
            track.entries[index, i] = 0.0
    track.next = 0


@step
def push(track: Record, time_us: int, position: Array, velocity: Array) -> None:
    """Add the state at an instant, in place of the oldest, unless the newest is hardly older."""
    slot = track.next
    newest_us = track.times_us[(slot + SIZE - 1) % SIZE]
    if newest_us >= 0 and time_us - newest_us < SPACING_US:
        return
    track.times_us[slot] = time_us
    for i in range(3):
        track.entries[slot, i] = position[i]
        track.entries[slot, 3 + i] = velocity[i]
    track.next = (slot + 1) % SIZE


@step
def look_up(track: Record, now_us: int, position: Array, velocity: Array, time_us: int) -> None:
    """Write position and velocity at `time_us` into ``at``, given those of `now_us`.

    Between entries linear; before the oldest and after now, carried on at constant velocity.
    """
    result, times_us, entries = track.at, track.times_us, track.entries
    _fill(result, position, velocity)
    after_us, index = now_us, (track.next + SIZE - 1) % SIZE
    for _ in range(SIZE):
        if time_us >= after_us or times_us[index] < 0:
            break
        before_us = times_us[index]
        if before_us <= time_us:
            weight = (time_us - before_us) / (after_us - before_us)
            for i in range(6):
                result[i] = entries[index, i] + weight * (result[i] - entries[index, i])
            return
        _fill(result, entries[index, :3], entries[index, 3:])
        after_us, index = before_us, (index + SIZE - 1) % SIZE
    ahead_s = (time_us - after_us) * 1e-6
    move(result, result[3] * ahead_s, result[4] * ahead_s, result[5] * ahead_s)


@step
def shift(track: Record, now_us: int, moved: Array, sped: Array) -> None:
    """Move the past as the present was corrected: by `moved` (m, NED), at a speed that was wrong by
    `sped` (m/s)."""
    for index in range(SIZE):
        if track.times_us[index] < 0:
            continue
        age_s = (now_us - track.times_us[index]) * 1e-6
        entry = track.entries[index]
        move(
            entry,
            moved[0] - age_s * sped[0],
            moved[1] - age_s * sped[1],
            moved[2] - age_s * sped[2],
        )
        for i in range(3):
            entry[3 + i] += sped[i]


@step
def _fill(result: Array, position: Array, velocity: Array) -> None:
    for i in range(3):
        result[i] = position[i]
        result[3 + i] = velocity[i]
