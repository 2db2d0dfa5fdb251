"""What a session's pictures show: curves over time, spans of states, and the track over ground.

Times are seconds after the first height of the session. Unknown values are NaN.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from companion.evaluation.metrics import Array
from companion.health import EXCLUDED_NAMES, Health
from companion.kernels.arrays import baro_altitude_array
from companion.replay.record import Recording
from companion.replay.sessions import Session
from companion.replay.summary import Reference
from companion.samples import FaultySensor, Kind, Rows, Verdict

BOUND_SD = 3.0
"""the innovation of a GNSS height is drawn with this many standard deviations around it"""
M_PER_DEG = 111_195.0
"""of latitude, on a sphere of 6371 km"""
GAP_S = 3.0
"""a state that was not told anew for this long has ended"""
RATES = {Kind.PRESSURE: "baro", Kind.GNSS: "gnss", Kind.IMU: "imu", Kind.ATTITUDE: "attitude"}

Columns = dict[str, Array]
"""name -> values, of the same length each; "t" is the time in seconds, increasing"""


@dataclass(frozen=True)
class Span:
    """A state that lasted."""

    from_s: float
    to_s: float
    name: str
    level: str = ""
    """"good", "warning" or "bad"; empty for what is neither"""


@dataclass(frozen=True)
class Curves:
    """Everything that is drawn of one session."""

    duration_s: float
    tables: dict[str, Columns]
    """"estimate", "baro", "gnss", "autopilot", "reference", "rates", "link", "radio", "track\""""
    spans: dict[str, list[Span]]
    """row of the time line -> its states in order of time"""
    texts: list[tuple[float, str]] = field(default_factory=list)
    """(time, what the vehicle said)"""
    reference: str = "none"
    """"truth", "smoother" or "none\""""


def curves_of(session: Session[Recording], reference: Reference) -> Curves:
    """The curves of a session, as it was replayed."""
    recording = session.seen
    ticks = recording.ticks()
    if not ticks.size:
        return Curves(0.0, {}, {})
    times_us = np.asarray(ticks["time_us"])
    start_us = int(times_us.min())
    duration_s = float(times_us.max() - start_us) * 1e-6
    found = {
        "estimate": _estimate(ticks, reference),
        "baro": _baro(recording, reference),
        "gnss": _gnss(recording, reference),
        "autopilot": _autopilot(recording, reference),
        "reference": _reference(reference),
        "rates": _rates(recording),
        "track": _track(recording, reference),
    }
    tables = {name: _since(columns, start_us, duration_s) for name, columns in found.items()}
    offset_us = float(np.median(_floats(ticks["arrival_us"]) - _floats(ticks["time_us"])))
    for name, columns in (("link", _link(session)), ("radio", _radio(session))):
        on_vehicle = columns | {"us": columns["us"] - offset_us}
        tables[name] = _since(on_vehicle, start_us, duration_s)
    return Curves(
        duration_s,
        {name: columns for name, columns in tables.items() if columns["t"].size},
        _spans(recording, ticks, start_us, duration_s),
        [((time_us - start_us) * 1e-6, text) for time_us, text in recording.events.texts],
        reference.kind,
    )


def _since(columns: Columns, start_us: int, duration_s: float) -> Columns:
    """With "us" replaced by "t", in order of time, and nothing from outside the session."""
    t = (np.asarray(columns["us"], np.float64) - start_us) * 1e-6
    order = np.argsort(t, kind="stable")
    order = order[(t[order] >= -1.0) & (t[order] <= duration_s + 1.0)]
    others = {name: values[order] for name, values in columns.items() if name != "us"}
    return {"t": t[order]} | others


def _estimate(ticks: Rows, reference: Reference) -> Columns:
    estimate, us = ticks["estimate"], _floats(ticks["time_us"])
    altitude_m = _floats(estimate["altitude_amsl_m"])
    weather, faults = estimate["drift_probabilities"], estimate["fault_probabilities"]
    return {
        "us": us,
        "altitude_m": altitude_m,
        "difference_m": altitude_m - reference.at(us),
        "sd_m": _floats(estimate["altitude_sd_m"]),
        "level_m": _floats(estimate["protection_level_m"]),
        "takeoff_m": _floats(estimate["height_above_takeoff_m"]),
        "climb_mps": _floats(estimate["climb_mps"]),
        "qnh_hpa": _floats(estimate["qnh_pa"]) * 0.01,
        "qnh_sd_hpa": _floats(estimate["qnh_sd_pa"]) * 0.01,
        "baro_offset_m": _floats(estimate["baro_offset_m"]),
        "gnss_offset_m": _floats(estimate["gnss_offset_m"]),
        "drift_m_per_h": _floats(estimate["baro_rate_mps"]) * 3600.0,
        "scale_percent": _floats(estimate["baro_scale"]) * 100.0,
    } | {
        name: _floats(values[:, place])
        for values, names in (
            (weather, ("calm", "fair", "stormy")),
            (faults, ("baro_fault", "gnss_fault", "imu_fault")),
        )
        for place, name in enumerate(names)
    }


def _baro(recording: Recording, reference: Reference) -> Columns:
    rows = recording.of(Kind.PRESSURE)
    us, height_m = _floats(rows["time_us"]), baro_altitude_array(rows["pressure_pa"])
    difference_m = height_m - reference.at(us)
    known = np.isfinite(difference_m)
    typical_m = float(np.median(difference_m[known])) if known.any() else math.nan
    return {"us": us, "altitude_m": height_m, "wander_m": difference_m - typical_m}


def _gnss(recording: Recording, reference: Reference) -> Columns:
    rows = recording.rows
    rows = rows[(np.asarray(rows["kind"]) == Kind.GNSS) & (np.asarray(rows["instance"]) == 0)]
    us, fix = _floats(rows["time_us"]), _floats(rows["fix_type"])
    altitude_m = np.where(fix >= 3, _floats(rows["gnss_altitude_m"]), np.nan)
    sd_m, satellites = _floats(rows["gnss_sd_m"]), _floats(rows["satellites"])
    estimate = rows["estimate"]
    judged = np.isin(np.asarray(rows["verdict"]), (Verdict.USED, Verdict.GATED))
    innovation_m = np.where(judged, _floats(estimate["innovation_m"]), np.nan)
    bound_m = BOUND_SD * np.hypot(sd_m, _floats(estimate["altitude_sd_m"]))
    return {
        "us": us,
        "altitude_m": altitude_m,
        "difference_m": altitude_m - reference.at(us),
        "sd_m": np.where(fix >= 3, sd_m, np.nan),
        "fix": fix,
        "satellites": np.where(satellites >= 0, satellites, np.nan),
        "innovation_m": innovation_m,
        "bound_m": np.where(np.isfinite(innovation_m), bound_m, np.nan),
        "refused_m": np.where(np.asarray(rows["verdict"]) == Verdict.GATED, innovation_m, np.nan),
    }


def _autopilot(recording: Recording, reference: Reference) -> Columns:
    rows = recording.heights(truth=False)
    us, altitude_m = _floats(rows["time_us"]), _floats(rows["altitude_amsl_m"])
    return {
        "us": us,
        "altitude_m": altitude_m,
        "difference_m": altitude_m - reference.at(us),
        "climb_mps": _floats(rows["climb_mps"]),
    }


def _reference(reference: Reference) -> Columns:
    return {"us": reference.time_us, "altitude_m": reference.altitude_m}


def _rates(recording: Recording) -> Columns:
    """Samples a second of each kind, at the middle of each second of the vehicle's clock."""
    kinds = [kind for kind in RATES if any(key[0] is kind for key in recording.rates)]
    seconds = sorted({second for kind, second in recording.rates if kind in kinds})
    if not seconds:
        return {"us": np.zeros(0)}
    grid = range(seconds[0], min(seconds[-1] + 1, seconds[0] + 10 * 86_400))
    us = np.array([second * 1e6 + 5e5 for second in grid])
    counts = {
        RATES[kind]: np.array([float(recording.rates[kind, second]) for second in grid])
        for kind in kinds
    }
    return {"us": us} | counts


def _link(session: Session[Recording]) -> Columns:
    """Frames that arrived and the share that is lost, each second of the log's clock."""
    counts = session.link.of(session.vehicle)
    if len(counts) < 3:
        return {"us": np.zeros(0)}
    seconds, frames, lost = (np.array(each, np.float64) for each in zip(*counts, strict=True))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = 100.0 * lost / (frames + lost)
    return {
        "us": seconds * 1e6 + 5e5,
        "frames": frames,
        "lost_percent": share,
    }


def _radio(session: Session[Recording]) -> Columns:
    """What the telemetry radio reported, on the log's clock; NaN where it did not know."""
    names = ("rssi", "remote_rssi", "noise", "remote_noise")
    found = [
        (time_us, *(getattr(radio, n) for n in names)) for time_us, radio in session.link.radio
    ]
    values = np.array(found, np.float64).reshape(-1, 1 + len(names))
    return dict(zip(("us", *names), values.T, strict=True))


def _track(recording: Recording, reference: Reference) -> Columns:
    """Place in metres from the first fix, and the size of our altitude's error or difference."""
    rows = recording.of(Kind.GNSS)
    latitude, longitude = _floats(rows["latitude_deg"]), _floats(rows["longitude_deg"])
    known = np.isfinite(latitude) & np.isfinite(longitude) & ((latitude != 0) | (longitude != 0))
    rows, latitude, longitude = rows[known], latitude[known], longitude[known]
    if not rows.size:
        return {"us": np.zeros(0)}
    us = _floats(rows["time_us"])
    estimate_m = _floats(rows["estimate"]["altitude_amsl_m"])
    turned = (longitude - longitude[0] + 180.0) % 360.0 - 180.0
    return {
        "us": us,
        "east_m": turned * M_PER_DEG * math.cos(math.radians(float(latitude[0]))),
        "north_m": (latitude - latitude[0]) * M_PER_DEG,
        "error_m": np.abs(estimate_m - reference.at(us)),
    }


# The time line


def _spans(
    recording: Recording, ticks: Rows, start_us: int, duration_s: float
) -> dict[str, list[Span]]:
    rows = recording.rows
    modes = [((us - start_us) * 1e-6, mode) for us, mode in recording.events.modes]
    armed = [((us - start_us) * 1e-6, "armed" if on else "") for us, on in recording.armed]
    found = {
        "flight mode": _changes(modes, duration_s),
        "armed": _changes(armed, duration_s),
        "health": _runs(ticks, start_us, "health", _HEALTH),
        "excluded": _runs(ticks, start_us, "faulty", _EXCLUDED),
        "barometer": _runs(_first(rows, Kind.PRESSURE), start_us, "verdict", _VERDICTS),
        "GNSS": _runs(_first(rows, Kind.GNSS), start_us, "verdict", _VERDICTS),
    }
    return {name: spans for name, spans in found.items() if spans}


_HEALTH = {
    int(Health.OK): ("OK", "good"),
    int(Health.DEGRADED): ("DEGRADED", "warning"),
    int(Health.LOST): ("LOST", "bad"),
}
_EXCLUDED = {int(sensor): (name, "bad") for sensor, name in EXCLUDED_NAMES.items()} | {
    int(FaultySensor.NONE): ("", "")
}
_VERDICTS = {
    int(Verdict.USED): ("used", "good"),
    int(Verdict.GATED): ("rejected by the gate", "bad"),
    int(Verdict.STALE): ("stale", "warning"),
    int(Verdict.INVALID): ("invalid", "bad"),
    int(Verdict.IGNORED): ("not used by this estimator", ""),
}


def _first(rows: Rows, kind: Kind) -> Rows:
    return rows[(np.asarray(rows["kind"]) == kind) & (np.asarray(rows["instance"]) == 0)]


def _runs(rows: Rows, start_us: int, name: str, names: dict[int, tuple[str, str]]) -> list[Span]:
    """Spans of equal values of a column; those with an empty name are left out."""
    if not rows.size:
        return []
    values = np.asarray(rows["estimate"][name] if name == "faulty" else rows[name])
    t = (_floats(rows["time_us"]) - start_us) * 1e-6
    edges = np.flatnonzero((np.diff(values) != 0) | (np.diff(t) > GAP_S)) + 1
    starts, ends = [0, *edges.tolist()], [*edges.tolist(), values.size]
    found = []
    for start, end in zip(starts, ends, strict=True):
        label, level = names[int(values[start])]
        follows = end < values.size and t[end] - t[end - 1] <= GAP_S
        if label:
            until_s = t[end] if follows else t[end - 1]
            found.append(Span(float(t[start]), float(until_s), label, level))
    return found


def _changes(changes: Sequence[tuple[float, str]], duration_s: float) -> list[Span]:
    """Spans between the instants at which a name changes."""
    ends = [*(time_s for time_s, _ in changes), duration_s][1:]
    return [
        Span(max(0.0, start_s), min(end_s, duration_s), name)
        for (start_s, name), end_s in zip(changes, ends, strict=True)
        if name and min(end_s, duration_s) > max(0.0, start_s)
    ]


def _floats(values: Any) -> Array:
    return np.asarray(values, np.float64)
