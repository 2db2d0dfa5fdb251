"""The rows of sessions as CSV or Parquet: one for each barometer and GNSS sample.

Unknown is an empty cell (CSV) or null (Parquet).
"""

import csv
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from companion.errors import ConfigError
from companion.evaluation.metrics import Array, truth_at
from companion.evaluation.smoother import Smoothed
from companion.health import Health
from companion.replay.findings import utc
from companion.replay.record import Recording
from companion.replay.sessions import Session
from companion.samples import FaultySensor, Kind, Verdict
from companion.whole_file import replacing

HELD_US = 2_000_000
"""for how long a raw height stands in the rows behind it"""
ESTIMATE_COLUMNS = (
    "altitude_amsl_m", "climb_mps", "altitude_sd_m", "climb_sd_mps", "baro_offset_m",
    "innovation_m", "height_above_takeoff_m", "protection_level_m", "baro_rate_mps",
    "gnss_offset_m",
)  # fmt: skip
Columns = dict[str, Any]
"""column -> values, of the same length each"""


def columns(session: Session[Recording], number: int, smoothed: Smoothed | None = None) -> Columns:
    """The columns of one session, a sequence each, all of the same length."""
    recording = session.seen
    rows = recording.rows
    rows = rows[np.isfinite(np.asarray(rows["estimate"]["altitude_amsl_m"]))]
    estimate, times_us = rows["estimate"], np.asarray(rows["time_us"], np.float64)
    kinds = np.asarray(rows["kind"])
    found: Columns = {
        "session": [number] * rows.size,
        "utc": [utc(each) for each in np.asarray(rows["arrival_us"]).tolist()],
        "time_us": np.asarray(estimate["time_us"]).tolist(),
    }
    found |= {name: np.asarray(estimate[name], np.float64) for name in ESTIMATE_COLUMNS}
    found |= {
        "qnh_hpa": np.asarray(estimate["qnh_pa"]) * 0.01,
        "qnh_sd_hpa": np.asarray(estimate["qnh_sd_pa"]) * 0.01,
        "pressure_altitude_m": _held(times_us, *recording.track("baro")),
        "gnss_altitude_m": _held(times_us, *recording.track("gnss")),
        "gnss_sd_m": np.asarray(rows["gnss_sd_m"]),
        "autopilot_altitude_m": truth_at(times_us, *recording.track("autopilot")),
        "truth_altitude_m": truth_at(times_us, *recording.track("truth")),
    }
    if smoothed is not None:
        found |= {
            "smoothed_altitude_m": smoothed.at(times_us),
            "smoothed_sd_m": smoothed.sd_at(times_us),
        }
    sensors = {int(Kind.PRESSURE): "barometer", int(Kind.GNSS): "gnss"}
    instances = np.asarray(rows["instance"]).tolist()
    faults = np.asarray(estimate["faulty"]).tolist()
    return found | {
        "sensor": [
            f"{sensors[kind]} {instance}"
            for kind, instance in zip(kinds.tolist(), instances, strict=True)
        ],
        "verdict": [Verdict(each).name.lower() for each in np.asarray(rows["verdict"]).tolist()],
        "excluded": [FaultySensor(each).name.lower() if each else "" for each in faults],
        "health": [Health(each).name for each in np.asarray(rows["health"]).tolist()],
    }


def _held(times_us: Array, source_us: Array, values: Array) -> Array:
    """The newest value of a source at each time; NaN when it is older than `HELD_US`."""
    if not source_us.size:
        return np.full(times_us.size, math.nan)
    order = np.argsort(source_us, kind="stable")
    source_us, values = source_us[order], values[order]
    at = np.searchsorted(source_us, times_us, side="right") - 1
    fresh = (at >= 0) & (times_us - source_us[np.maximum(at, 0)] <= HELD_US)
    return np.where(fresh, values[np.maximum(at, 0)], math.nan)


def write(path: Path, tables: Iterable[Columns]) -> None:
    """Write sessions to a .csv or .parquet, whole or not at all. Raises `ConfigError` when the file
    cannot be written, or Parquet needs a package that is not there."""
    try:
        with replacing(path) as partial:
            if path.suffix.lower() == ".parquet":
                _write_parquet(partial, list(tables))
            else:
                _write_csv(partial, tables)
    except ImportError:
        raise ConfigError(f"{path}: Parquet needs pyarrow: pip install 'kollsman[fleet]'") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from None


def _write_csv(path: Path, tables: Iterable[Columns]) -> None:
    with path.open("w", newline="", encoding="ascii") as file:
        writer = csv.writer(file)
        for number, table in enumerate(tables):
            if number == 0:
                writer.writerow(table)
            cells = [list(map(_cell, values)) for values in table.values()]
            writer.writerows(zip(*cells, strict=True))


def _cell(value: Any) -> Any:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.4f}" if math.isfinite(value) else ""
    return value


def _write_parquet(path: Path, tables: list[Columns]) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    parts = [pa.table({name: _arrow(values) for name, values in each.items()}) for each in tables]
    parquet.write_table(pa.concat_tables(parts, promote_options="permissive"), path)


def _arrow(values: Any) -> Any:
    import pyarrow as pa

    if isinstance(values, np.ndarray):
        return pa.array(values, mask=~np.isfinite(values))
    return pa.array(values)
