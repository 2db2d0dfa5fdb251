"""What happened in a session, found in its rows: exclusions, and the autopilot's own altitude."""

import math
from collections.abc import Callable
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
SAME_SPAN_S = 5.0
"""marks that are nearer than this belong together"""
NODE_S = 10.0
PARTING_S, LEAST_PARTING_M = 300.0, 20.0
"""GNSS and barometer part if their difference changes by so much within so long: 20 m in five
minutes are 240 m/h, eight times the fastest weather"""
COLUMN_SHARE = 0.12
"""of a change of height: what a column of air that is 35 K off makes of it"""
LEAST_S = 30.0
"""of both altitudes, to tell what the autopilot's follows"""
ORIGIN_M, START_M = 50.0, 20.0
"""The autopilot has no origin yet if its altitude is so far from ours, but so near to the height
above the start."""
FOLLOWS = 2.0
"""The autopilot's altitude follows a sensor if it keeps its distance to it this many times better
than to the other one."""


Height = Callable[[Array], Array]
"""The true height, or one that differs from it by a constant, at times in microseconds."""
Steady = Callable[[float, float], Height | None]
"""the true height between two times; None where it is not known"""


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


def suspicions(recording: Recording) -> list[dict[str, Any]]:
    """When the plausibility check marked a sensor: which, from when to when, and for how long in
    all; ``off_m``: how far the barometer read above GNSS meanwhile."""
    rows, offset_us = recording.rows, unix_offset_us(recording)
    start_us = recording.ticks()["time_us"][0] if recording.ticks().size else 0
    found = []
    for kind, name in ((Kind.PRESSURE, "barometer"), (Kind.GNSS, "gnss")):
        marked = (np.asarray(rows["kind"]) == kind) & (np.asarray(rows["suspect"]) != 0)
        times_us = np.sort(np.asarray(rows["time_us"])[marked])
        if times_us.size:
            steps_s = np.diff(times_us) * 1e-6
            first_us = int(times_us[0])
            found.append(
                {
                    "sensor": name,
                    "from_s": (first_us - start_us) * 1e-6,
                    "from_utc": None if offset_us is None else utc(first_us + offset_us),
                    "duration_s": float(steps_s[steps_s < SAME_SPAN_S].sum()),
                    "off_m": _apart(recording, float(times_us[0]), float(times_us[-1])),
                }
            )
    return found


def _apart(recording: Recording, from_us: float, to_us: float) -> float:
    """Median of barometer minus GNSS between two times; NaN where one of them is missing."""
    (gnss_us, gnss_m), (baro_us, baro_m) = recording.track("gnss"), recording.track("baro")
    apart_m = truth_at(gnss_us, baro_us, baro_m) - gnss_m
    apart_m = apart_m[(gnss_us >= from_us) & (gnss_us <= to_us) & np.isfinite(apart_m)]
    return float(np.median(apart_m)) if apart_m.size else math.nan


def parting(recording: Recording, steady: Steady) -> dict[str, Any]:
    """The first large change of GNSS minus barometer within `PARTING_S` that weather and a column
    of air cannot make: ``off_m``, from when to when, and which ``sensor`` moved if it is known.
    Empty where there is none."""
    (gnss_us, gnss_m), (baro_us, baro_m) = recording.track("gnss"), recording.track("baro")
    pressure_m = truth_at(gnss_us, baro_us, baro_m)
    known = np.isfinite(gnss_m - pressure_m)
    if known.sum() < 30:
        return {}
    us, apart_m, height_m = medians(gnss_us[known], (gnss_m - pressure_m)[known], pressure_m[known])
    large = []
    for lag in range(1, int(PARTING_S / NODE_S) + 1):
        change_m = np.abs(apart_m[lag:] - apart_m[:-lag])
        climbed_m = np.abs(height_m[lag:] - height_m[:-lag])
        excess_m = change_m - COLUMN_SHARE * climbed_m
        excess_m[us[lag:] - us[:-lag] > 2.0 * PARTING_S * 1e6] = 0.0
        where = np.flatnonzero(excess_m >= LEAST_PARTING_M).tolist()
        large += [(float(excess_m[at]), at, at + lag) for at in where]
    if not large:
        return {}
    _, begin, _ = min(large, key=lambda each: (each[2], -each[1]))
    _, begin, end = max(each for each in large if each[1] == begin)
    begin_us, end_us = float(us[begin]), float(us[end])
    offset_us = unix_offset_us(recording)
    start_us = float(recording.ticks()["time_us"][0])
    return {
        "off_m": float(apart_m[end] - apart_m[begin]),
        "from_s": (begin_us - start_us) * 1e-6,
        "to_s": (end_us - start_us) * 1e-6,
        "from_utc": None if offset_us is None else utc(int(begin_us) + offset_us),
        "to_utc": None if offset_us is None else utc(int(end_us) + offset_us),
        "sensor": _moved(recording, steady(begin_us, end_us), begin_us, end_us),
    }


def _moved(
    recording: Recording, height: Height | None, begin_us: float, end_us: float
) -> str | None:
    """The sensor whose error changed more between two instants; None without a known height."""
    if height is None:
        return None
    moved_m = {}
    for source, name in (("gnss", "gnss"), ("baro", "barometer")):
        times_us, heights_m = recording.track(source)
        error_m = heights_m - height(times_us)
        ends = [
            np.nanmedian(error_m[np.abs(times_us - at_us) <= 0.5e6 * NODE_S])
            for at_us in (begin_us, end_us)
        ]
        moved_m[name] = abs(float(ends[1] - ends[0]))
    return max(moved_m, key=lambda name: moved_m[name])


def medians(us: Array, *values: Array) -> list[Array]:
    """Medians over nodes of `NODE_S`: of the times, and of each of `values`."""
    node = ((us - us[0]) / (NODE_S * 1e6)).astype(np.int64)
    counts = np.unique(node, return_counts=True)[1]
    first = np.cumsum(counts) - counts
    low, high, last = first + (counts - 1) // 2, first + counts // 2, first + counts - 1
    found = []
    for each in (us, *values):
        ordered = each[np.lexsort((each, node))]
        middle = 0.5 * (ordered[low] + ordered[high])
        found.append(np.where(np.isnan(ordered[last]), np.nan, middle))
    return found


def own_altitude(recording: Recording) -> dict[str, Any]:
    """The autopilot's own altitude: ``above_m``, how far it was above Kollsman's in the last
    `LAST_S`, and the spread ``above_sd_m`` there; ``follows``: "barometer" or "gnss", None where
    the two cannot be told apart; ``without_origin_s``: how long it told its height above the start
    first. Empty where it sent none."""
    times_us, own_m = recording.track("autopilot")
    if not times_us.size:
        return {}
    without = before_origin(recording)
    found = {"without_origin_s": (times_us[without - 1] - times_us[0]) * 1e-6 if without else 0.0}
    times_us, own_m = times_us[without:], own_m[without:]
    ours_us, ours_m = recording.track("published")
    above_m = own_m - truth_at(times_us, ours_us, ours_m)
    known = np.isfinite(above_m)
    if not known.any():
        unknown = {"above_m": math.nan, "above_sd_m": math.nan, "span_s": 0.0, "follows": None}
        return found | unknown
    last_us = times_us[known][-1]
    late = known & (times_us >= last_us - LAST_S * 1e6)
    span_s = (last_us - times_us[late][0]) * 1e-6
    return found | {
        "above_m": float(np.median(above_m[late])),
        "above_sd_m": float(np.std(above_m[late])),
        "span_s": float(span_s),
        "follows": _follows(recording, times_us, own_m),
    }


def before_origin(recording: Recording) -> int:
    """How many of the autopilot's first altitudes are heights above its start: it does not know how
    high that is before GNSS has given it an origin."""
    times_us, own_m = recording.track("autopilot")
    ours_us, ours_m = recording.track("estimate")
    baro_us, baro_m = recording.track("baro")
    if not times_us.size or not ours_us.size or not baro_us.size:
        return 0
    off_m = own_m - np.interp(times_us, ours_us, ours_m)
    start_m = own_m - (np.interp(times_us, baro_us, baro_m) - baro_m[0])
    without = (np.abs(off_m) > ORIGIN_M) & (np.abs(start_m) < START_M)
    return int(times_us.size if without.all() else np.argmin(without))


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
