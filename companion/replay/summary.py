"""What a session was, as plain data: the objects of the report schema.

The schema is described in ``docs/report-schema.md``; `companion.replay.schema` has its top.

Without a simulator's truth nothing is called an error: heights are held against the smoother of
barometer and GNSS, and the keys are the same with ``reference.kind`` "smoother".
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.evaluation.integrity import coverage
from companion.evaluation.metrics import Array, errors, truth_at
from companion.evaluation.smoother import Smoothed, smooth
from companion.mavlink.codec import FrameReject
from companion.replay.availability import at_rest, availability
from companion.replay.findings import (
    Height,
    Steady,
    before_origin,
    exclusions,
    own_altitude,
    parting,
    suspicions,
    utc,
)
from companion.replay.record import Recording
from companion.replay.sessions import Session
from companion.replay.verdict import verdict
from companion.samples import Kind, Rows, Verdict

SETTLE_S = 60.0
SOURCES = {
    "estimate": "Kollsman",
    "published": "Kollsman, not LOST",
    "autopilot": "autopilot's own",
    "gnss": "raw GNSS",
    "baro": "raw barometer",
}


@dataclass(frozen=True)
class Reference:
    """What heights are held against."""

    kind: str
    """truth, smoother or none"""
    time_us: Array
    altitude_m: Array
    sd_m: float = math.nan
    """median of what it knows of itself; NaN for truth"""
    smoothed: Smoothed | None = None
    """the reference of kind smoother; with truth where it was asked for"""

    def at(self, time_us: Array) -> Array:
        """Its altitude at other times; NaN where it has none."""
        if self.kind == "smoother" and self.smoothed is not None:
            return self.smoothed.at(time_us)
        return truth_at(time_us, self.time_us, self.altitude_m)


def reference_of(recording: Recording, *, smoothing: bool = False) -> Reference:
    """Truth where the log has it (with the smoother's altitude beside it if `smoothing`), else the
    smoother, else nothing."""
    times_us, altitudes_m = recording.track("truth")
    if times_us.size > 1:
        beside = smooth(recording.measured()) if smoothing else None
        return Reference("truth", times_us, altitudes_m, smoothed=beside)
    smoothed = smooth(recording.measured())
    if smoothed is None:
        return Reference("none", np.zeros(0), np.zeros(0))
    sd_m = float(np.median(smoothed.sd_m))
    return Reference("smoother", smoothed.time_us, smoothed.altitude_m, sd_m, smoothed)


def summarise(
    session: Session[Recording],
    number: int,
    estimator: str,
    settle_s: float = SETTLE_S,
    reference: Reference | None = None,
    unreadable: float = 0.0,
) -> dict[str, Any]:
    """One object of ``sessions``: JSON-ready, unknown is None. `unreadable` is the share of the
    file that could not be read."""
    recording = session.seen
    reference = reference or reference_of(recording)
    ticks = recording.ticks()
    first_us = int(ticks["time_us"][0]) if ticks.size else 0
    last_us = int(ticks["time_us"][-1]) if ticks.size else 0
    settle_s = min(settle_s, 0.5 * (last_us - first_us) * 1e-6)  # a short session has half of it
    start_us = first_us + settle_s * 1e6
    steady = _steady(recording, reference)
    height = steady(first_us, last_us)
    found: dict[str, Any] = {
        "session": number,
        "vehicle": "/".join(map(str, session.vehicle)) if session.vehicle else None,
        "autopilot": session.autopilot,
        "start_utc": utc(session.first_us),
        "start_vehicle_utc": _vehicle_utc(recording, first_us),
        "start_boot_s": first_us * 1e-6,
        "duration_s": (last_us - first_us) * 1e-6,
        "after_reboot": session.rebooted,
        "estimator": estimator,
        "settle_s": settle_s,
        "health": _health(session, ticks),
        "at_rest": _moved(recording, start_us) if height is np.zeros_like else None,
        "unreadable": unreadable,
        "notes": session.notes,
        "samples": _samples(session),
        "left_out": {cause: n for cause, n in session.left_out.items() if n},
        "suspect": recording.suspected(),
        "altitude": _altitude(recording, ticks, start_us),
        "exclusions": exclusions(recording, ticks),
        "suspicions": suspicions(recording),
        "parting": parting(recording, steady),
        "gnss": _gnss(recording, height or reference.at, start_us),
        "barometer": _barometer(recording, height or reference.at)
        | {"compared_with": "gnss" if height is None else "height"},
        "own_altitude": own_altitude(recording),
        "reference": {"kind": reference.kind, "sd_m": reference.sd_m},
        "sources": _sources(recording, reference, start_us) | _smoothed(reference, start_us),
    }
    found |= verdict(found)
    return found


def _steady(recording: Recording, reference: Reference) -> Steady:
    """The true height between two times, but for a constant: the truth, or that of a vehicle at
    rest."""

    def steady(from_us: float, to_us: float) -> Height | None:
        if reference.kind == "truth":
            return reference.at
        return np.zeros_like if at_rest(recording, from_us, to_us) else None

    return steady


def _health(session: Session[Recording], ticks: Rows) -> dict[str, Any]:
    shares = session.seen.health_shares()
    found = {"at_end": session.health, "reason": session.reason, "share": shares}
    return found | availability(session.seen, ticks)


def _moved(recording: Recording, start_us: float) -> dict[str, Any]:
    """Range of our altitude and of the autopilot's, from the settling time on."""
    found: dict[str, Any] = {}
    for name in ("published", "autopilot"):
        times_us, altitude_m = recording.track(name)
        late = times_us >= start_us
        if name == "autopilot":
            late[: before_origin(recording)] = False
        found[name] = float(np.ptp(altitude_m[late])) if late.any() else None
    return found


def _vehicle_utc(recording: Recording, first_us: int) -> str | None:
    offset_us = recording.unix_offset_us
    return None if offset_us is None else utc(first_us + offset_us)


def _samples(session: Session[Recording]) -> dict[str, dict[str, int]]:
    return {
        kind.name.lower(): {v.name.lower(): counts[v] for v in Verdict if counts[v]}
        for kind, counts in session.samples.items()
        if sum(counts.values())
    }


def _altitude(recording: Recording, ticks: Rows, start_us: float) -> dict[str, Any]:
    estimate = ticks["estimate"]
    known = np.flatnonzero(np.isfinite(np.asarray(estimate["altitude_amsl_m"])))
    found: dict[str, Any] = {"estimates": known.size, "published": recording.published_count}
    if not known.size:
        return found
    late = known[np.asarray(ticks["time_us"])[known] >= start_us]
    settled, last = late if late.size else known, estimate[known[-1]]
    altitude_m, climb_mps = (
        np.asarray(estimate[name])[known] for name in ("altitude_amsl_m", "climb_mps")
    )
    return found | {
        "first_m": altitude_m[0],
        "last_m": altitude_m[-1],
        "min_m": altitude_m.min(),
        "max_m": altitude_m.max(),
        "median_sd_m": _median(np.asarray(estimate["altitude_sd_m"])[settled]),
        "median_level_m": _median(np.asarray(estimate["protection_level_m"])[settled]),
        "max_climb_mps": _extreme(climb_mps, np.nanmax),
        "max_sink_mps": _extreme(climb_mps, np.nanmin),
        "above_takeoff_last_m": last["height_above_takeoff_m"],
        "qnh_hpa": last["qnh_pa"] * 0.01,
        "qnh_sd_hpa": last["qnh_sd_pa"] * 0.01,
        "baro_offset_m": last["baro_offset_m"],
    }


def _gnss(recording: Recording, height: Height, start_us: float) -> dict[str, Any]:
    rows = recording.rows
    fixes = rows[(np.asarray(rows["kind"]) == Kind.GNSS) & (np.asarray(rows["instance"]) == 0)]
    if not fixes.size:
        return {"fixes": 0}
    with_fix = np.asarray(fixes["fix_type"]) >= 3
    found: dict[str, Any] = {
        "fixes": int(fixes.size),
        "share_3d": float(with_fix.mean()),
        "first_3d_s": _first_fix_s(recording, fixes, with_fix),
        "median_sd_m": _median(np.asarray(fixes["gnss_sd_m"])[with_fix]),
        "median_satellites": _median(np.asarray(fixes["satellites"])[with_fix]),
    }
    times_us, altitude_m = recording.track("gnss")
    late = times_us >= start_us
    differences = errors(altitude_m[late], height(times_us[late]))
    return found | {"wander_m": differences.unbiased_rmse_m if differences else math.nan}


def _first_fix_s(recording: Recording, fixes: Rows, with_fix: Any) -> float:
    """Time of the first 3D fix after the first height; NaN without one."""
    ticks = recording.ticks()
    if not with_fix.any() or not ticks.size:
        return math.nan
    first_us = int(fixes["time_us"][int(np.argmax(with_fix))])
    return (first_us - int(ticks["time_us"][0])) * 1e-6


def _barometer(recording: Recording, height: Height) -> dict[str, Any]:
    """How the barometer's offset to the reference moved: over the session, and in an hour."""
    times_us, height_m = recording.track("baro")
    offset_m = height_m - height(times_us)
    known = np.isfinite(offset_m)
    if known.sum() < 10:
        return {"drift_m": None, "drift_m_per_h": None, "range_m": None}
    offset_m, time_s = offset_m[known], times_us[known] * 1e-6
    span_s = time_s[-1] - time_s[0]
    part = max(1, offset_m.size // 20)
    drift_m = float(np.median(offset_m[-part:]) - np.median(offset_m[:part]))
    per_hour = drift_m / span_s * 3600.0 if span_s >= 300.0 else math.nan
    lows, highs = np.percentile(offset_m, [2.5, 97.5])
    return {"drift_m": drift_m, "drift_m_per_h": per_hour, "range_m": float(highs - lows)}


def _sources(recording: Recording, reference: Reference, start_us: float) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, label in SOURCES.items():
        times_us, altitude_m = recording.track(name)
        late = times_us >= start_us
        if name == "autopilot":
            late[: before_origin(recording)] = False
        differences = errors(altitude_m[late], reference.at(times_us[late]))
        if differences is not None:
            found[name] = {"label": label, **differences.as_dict()}
    if "estimate" in found:
        rows = recording.ticks()["estimate"]
        names = ("altitude_amsl_m", "time_us", "altitude_sd_m")
        known = np.isfinite(np.asarray(rows["altitude_amsl_m"]))
        known &= np.asarray(rows["time_us"]) >= start_us
        altitude_m, times_us, sd_m = (np.asarray(rows[name])[known] for name in names)
        error_m = altitude_m - reference.at(times_us.astype(np.float64))
        if reference.kind == "truth":
            covered = coverage(error_m, sd_m)
            found["estimate"] |= {"nees": covered.nees, "coverage_2": covered.within_2}
    return found


def _smoothed(truth: Reference, start_us: float) -> dict[str, Any]:
    """The smoothed altitude against the truth; empty where one of them is missing."""
    smoothed = truth.smoothed
    if smoothed is None or truth.kind != "truth":
        return {}
    late = smoothed.time_us >= start_us
    time_us, altitude_m, sd_m = (
        each[late] for each in (smoothed.time_us, smoothed.altitude_m, smoothed.sd_m)
    )
    true_m = truth.at(time_us)
    found = errors(altitude_m, true_m)
    if found is None:
        return {}
    covered = coverage(altitude_m - true_m, sd_m)
    spread = {"nees": covered.nees, "coverage_2": covered.within_2}
    return {"smoothed": {"label": "smoothed", **found.as_dict(), **spread}}


def damage(counters: Any) -> dict[str, int]:
    """What the reader left out, by cause."""
    return {str(cause): n for cause, n in counters.items() if n and isinstance(cause, FrameReject)}


def _median(values: Any) -> float:
    values = np.asarray(values, np.float64)
    values = values[np.isfinite(values)]
    return float(np.median(values)) if values.size else math.nan


def _extreme(values: Array, choose: Any) -> float:
    return float(choose(values)) if np.isfinite(values).any() else math.nan
