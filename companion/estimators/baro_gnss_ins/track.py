"""A short history of position and velocity, so that a late fix meets the state of its own time.

`companion.kernels.ring` does this for a scalar; a filter whose state is corrected in between must
also move its past, or it would see the same error again in every fix that is under way. A track is
two arrays inside an estimator's state: instants (-1 is empty) with one place more, which holds the
slot of the next entry, and rows of six values: latitude and longitude (rad), height (m), velocity
north, east and down (m/s).
"""

from typing import Any

from numpy.typing import NDArray

from companion.estimators.baro_gnss_ins.strapdown import move
from companion.jit import step

Array = NDArray[Any]

SIZE = 64
SPACING_US = 18_000
"""between entries, so that a second fits whatever the rate of the IMU (50 Hz keeps every sample)"""


def track_fields() -> tuple[tuple[Any, ...], ...]:
    """The state fields of a track."""
    return (
        ("track_us", "i8", (SIZE + 1,)),
        ("track", "f8", (SIZE, 6)),
        ("track_at", "f8", (6,)),  # the state at the time of the newest fix
    )


@step
def clear(times_us: Array, track: Array) -> None:
    """Empty the track."""
    for index in range(SIZE):
        times_us[index] = -1
        for i in range(6):
            track[index, i] = 0.0
    times_us[SIZE] = 0


@step
def push(times_us: Array, track: Array, time_us: int, position: Array, velocity: Array) -> None:
    """Add the state at an instant, in place of the oldest, unless the newest is hardly older."""
    slot = times_us[SIZE]
    newest_us = times_us[(slot + SIZE - 1) % SIZE]
    if newest_us >= 0 and time_us - newest_us < SPACING_US:
        return
    times_us[slot] = time_us
    for i in range(3):
        track[slot, i] = position[i]
        track[slot, 3 + i] = velocity[i]
    times_us[SIZE] = (slot + 1) % SIZE


@step
def look_up(
    times_us: Array,
    track: Array,
    now_us: int,
    position: Array,
    velocity: Array,
    time_us: int,
    result: Array,
) -> None:
    """Write position and velocity at `time_us` into `result` (6,), given those of `now_us`.

    Between entries linear; before the oldest and after now, carried on at constant velocity.
    """
    _fill(result, position, velocity)
    after_us, index = now_us, (times_us[SIZE] + SIZE - 1) % SIZE
    for _ in range(SIZE):
        if time_us >= after_us or times_us[index] < 0:
            break
        before_us = times_us[index]
        if before_us <= time_us:
            weight = (time_us - before_us) / (after_us - before_us)
            for i in range(6):
                result[i] = track[index, i] + weight * (result[i] - track[index, i])
            return
        _fill(result, track[index, :3], track[index, 3:])
        after_us, index = before_us, (index + SIZE - 1) % SIZE
    ahead_s = (time_us - after_us) * 1e-6
    move(result, result[3] * ahead_s, result[4] * ahead_s, result[5] * ahead_s)


@step
def shift(times_us: Array, track: Array, now_us: int, moved: Array, sped: Array) -> None:
    """Move the past as the present was corrected: by `moved` (m, NED), at a speed that was wrong by
    `sped` (m/s)."""
    for index in range(SIZE):
        if times_us[index] < 0:
            continue
        age_s = (now_us - times_us[index]) * 1e-6
        entry = track[index]
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
