"""What happened in a session, found in its rows: exclusions, and the autopilot's own altitude."""

import math
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any

import numpy as np

from companion.evaluation.metrics import Array, truth_at
from companion.replay.record import Recording
from companion.samples import FaultySensor, Kind, Rows

UNIX_US = 1_000_000_000_000_000
"""A stamp above this is UNIX time (2001 and later)."""
BEFORE_S = 30.0
"""the difference of a sensor before its exclusion is the median of this time"""
STEP_S = 5.0
"""a difference that arises within this time around the onset is a jump"""
LAST_S = 60.0
"""the autopilot's altitude at the end is the median of this time"""
LEAST_S = 30.0
"""of both altitudes, to tell what the autopilot's follows"""
FOLLOWS = 2.0
"""The autopilot's altitude follows a sensor if it keeps its distance to it this many times better
than to the other one."""


def utc(time_us: int) -> str | None:
    """ISO 8601, or None where the log knows no date."""
    if not UNIX_US < time_us < 32_503_680_000_000_000:
        return None
    return datetime.fromtimestamp(time_us * 1e-6, UTC).isoformat(timespec="milliseconds")


def unix_offset_us(recording: Recording) -> int | None:
    """UNIX time minus the vehicle's clock: as the vehicle told, else by the log's stamps; None
    where neither knows the date."""
    if recording.unix_offset_us is not None:
        return recording.unix_offset_us
    ticks = recording.ticks()
    if not ticks.size or ticks["arrival_us"][0] < UNIX_US:
        return None
    return int(np.median(np.asarray(ticks["arrival_us"]) - np.asarray(ticks["time_us"])))


def exclusions(recording: Recording, ticks: Rows) -> list[dict[str, Any]]:
    """When the estimator had excluded a sensor: which, from when (by its own finding of the onset),
    for how long; how far the sensor was off, and how much of that arose at once."""
    faulty = np.asarray(ticks["estimate"]["faulty"])
    times_us = np.asarray(ticks["time_us"])
    since_us = np.asarray(ticks["estimate"]["faulty_since_us"])
    offset_us = unix_offset_us(recording)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], faulty, [0]])))
    found = []
    for start, end in pairwise(edges.tolist()):
        if start < faulty.size and faulty[start]:
            stop = min(end, faulty.size - 1)
            sensor = FaultySensor(int(faulty[start]))
            onset_us = int(since_us[start]) if 0 < since_us[start] <= times_us[start] else None
            at_us = times_us[start] if onset_us is None else onset_us
            found.append(
                {
                    "sensor": sensor.name.lower(),
                    "from_s": (times_us[start] - times_us[0]) * 1e-6,
                    "from_utc": None if offset_us is None else utc(int(at_us) + offset_us),
                    "duration_s": (times_us[stop] - times_us[start]) * 1e-6,
                    **_size(recording, ticks, sensor, (float(at_us), float(times_us[stop]))),
                }
            )
    return found


def _size(
    recording: Recording, ticks: Rows, sensor: FaultySensor, window_us: tuple[float, float]
) -> dict[str, float]:
    """``off_m``: the median difference of the sensor to our altitude in the window, less that
    before; ``step_m``: how much of it arose within `STEP_S` of the onset."""
    source = {FaultySensor.BAROMETER: "baro", FaultySensor.GNSS: "gnss"}.get(sensor)
    if source is None:
        return {"off_m": math.nan, "step_m": math.nan}
    times_us, heights_m = recording.track(source)
    ours_us, ours_m = recording.track("estimate")
    difference_m = heights_m - truth_at(times_us, ours_us, ours_m)
    begin_us, end_us = window_us

    def median(from_us: float, to_us: float) -> float:
        chosen = difference_m[(times_us >= from_us) & (times_us <= to_us)]
        chosen = chosen[np.isfinite(chosen)]
        return float(np.median(chosen)) if chosen.size else math.nan

    before_m = median(begin_us - BEFORE_S * 1e6, begin_us - 1e6)
    at_once_m = median(begin_us, begin_us + STEP_S * 1e6) - before_m
    inside = (times_us >= begin_us) & (times_us <= end_us) & np.isfinite(difference_m)
    if not inside.any():
        return {"off_m": math.nan, "step_m": math.nan}
    off_m = difference_m[inside] - (before_m if math.isfinite(before_m) else 0.0)
    return {"off_m": float(off_m[np.argmax(np.abs(off_m))]), "step_m": at_once_m}


def own_altitude(recording: Recording) -> dict[str, Any]:
    """The autopilot's own altitude: ``above_m``, how far it was above Kollsman's in the last
    `LAST_S`, and the spread ``above_sd_m`` there; ``follows``: "barometer" or "gnss", None where
    the two cannot be told apart. Empty where it sent none."""
    times_us, own_m = recording.track("autopilot")
    ours_us, ours_m = recording.track("published")
    above_m = own_m - truth_at(times_us, ours_us, ours_m)
    known = np.isfinite(above_m)
    if not times_us.size:
        return {}
    if not known.any():
        return {"above_m": math.nan, "above_sd_m": math.nan, "span_s": 0.0, "follows": None}
    last_us = times_us[known][-1]
    late = known & (times_us >= last_us - LAST_S * 1e6)
    span_s = (last_us - times_us[late][0]) * 1e-6
    return {
        "above_m": float(np.median(above_m[late])),
        "above_sd_m": float(np.std(above_m[late])),
        "span_s": float(span_s),
        "follows": _follows(recording, times_us, own_m),
    }


def _follows(recording: Recording, times_us: Array, own_m: Array) -> str | None:
    """Which sensor the autopilot's altitude keeps its distance to."""
    spreads = {}
    for name, kind in (("barometer", Kind.PRESSURE), ("gnss", Kind.GNSS)):
        source_us, heights_m = recording.track("baro" if kind is Kind.PRESSURE else "gnss")
        distance_m = own_m - truth_at(times_us, source_us, heights_m)
        distance_m = distance_m[np.isfinite(distance_m)]
        if distance_m.size < 30 or times_us[-1] - times_us[0] < LEAST_S * 1e6:
            return None
        low, high = np.percentile(distance_m, [5.0, 95.0])
        spreads[name] = float(high - low)
    near, far = sorted(spreads, key=lambda name: spreads[name])
    return near if spreads[far] > FOLLOWS * spreads[near] else None
