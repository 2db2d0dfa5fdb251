"""When a session had an altitude, and whether its vehicle stood still."""

from typing import Any

import numpy as np

from companion.evaluation.metrics import Array
from companion.health import Health
from companion.kernels.atmosphere import baro_altitude_array
from companion.replay.findings import medians, unix_offset_us, utc
from companion.replay.record import Recording
from companion.samples import Kind, Rows

GAP_S = 3.0
"""no height for longer than this is no altitude either"""
STILL_M = 2.0
"""change of the barometer in `findings.NODE_S` that a vehicle at rest does not exceed: warming,
weather, and wind over the static port"""
STILL_RANGE_M = 10.0
"""range of the barometer that a vehicle at rest does not exceed in an hour"""
SLOW_MPS = 1.5
"""speed that a receiver at rest does not exceed for 95 % of the time"""


def availability(recording: Recording, ticks: Rows) -> dict[str, Any]:
    """``at_last_height``: health at the last height; ``first_s``: when the altitude was first not
    LOST, None if never; ``lost``: the times without an altitude after that."""
    if not ticks.size:
        return {"at_last_height": Health.LOST.name, "first_s": None, "lost": []}
    has_altitude = np.asarray(ticks["health"]) != Health.LOST
    t = (np.asarray(ticks["now_us"]) - int(ticks["now_us"][0])) * 1e-6
    last = Health(int(ticks["health"][-1])).name
    if not has_altitude.any():
        return {"at_last_height": last, "first_s": None, "lost": []}
    places = np.flatnonzero(has_altitude)
    ends = places if has_altitude[-1] else np.append(places, t.size - 1)
    before, after = ends[:-1], ends[1:]
    gone = (after > before + 1) | (t[after] - t[before] > GAP_S)
    offset_us = unix_offset_us(recording)
    lost = []
    for start, end in zip(before[gone].tolist(), after[gone].tolist(), strict=True):
        start_us = int(ticks["now_us"][start])
        lost.append(
            {
                "from_s": float(t[start]),
                "from_utc": None if offset_us is None else utc(start_us + offset_us),
                "duration_s": float(t[end] - t[start]),
                "silent": end == start + 1,
            }
        )
    return {"at_last_height": last, "first_s": float(t[places[0]]), "lost": lost}


def at_rest(recording: Recording, from_us: float, to_us: float) -> bool:
    """Whether the vehicle stood still: its height is constant, whatever the sensors say.

    It was disarmed all the time, the receiver shows no speed, and the barometer moves no faster
    than warming and weather move it.
    """
    states = [(us, on) for us, on in recording.armed if us <= to_us]
    before = [on for us, on in states if us <= from_us] or [on for _, on in states[:1]]
    if not before or before[-1] or any(on for us, on in states if us > from_us):
        return False
    fixes, pressure = recording.of(Kind.GNSS), recording.of(Kind.PRESSURE)
    speeds = _within(fixes, from_us, to_us)["ground_speed_mps"]
    speeds = np.asarray(speeds)[np.isfinite(speeds)]
    if speeds.size and np.percentile(speeds, 95.0) > SLOW_MPS:
        return False
    pressure = _within(pressure, from_us, to_us)
    if pressure.size < 2:
        return False
    heights_m = baro_altitude_array(pressure["pressure_pa"])
    (nodes_m,) = medians(np.asarray(pressure["time_us"], np.float64), heights_m)[1:]
    return bool(np.ptp(nodes_m) <= STILL_RANGE_M and _largest_step(nodes_m) <= STILL_M)


def _within(rows: Rows, from_us: float, to_us: float) -> Rows:
    times_us = np.asarray(rows["time_us"])
    chosen: Rows = rows[(times_us >= from_us) & (times_us <= to_us)]
    return chosen


def _largest_step(values: Array) -> float:
    return float(np.abs(np.diff(values)).max(initial=0.0))
