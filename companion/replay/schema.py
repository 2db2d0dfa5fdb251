"""The top of the report schema (``docs/report-schema.md``), which replay, compare, batch and the
live state share.

A change of meaning or the removal of a key raises `VERSION`; new keys do not.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from companion import __version__

VERSION = "kollsman-report/1"
SESSION_KEYS = (
    "session", "vehicle", "autopilot", "start_utc", "start_vehicle_utc", "start_boot_s",
    "duration_s", "after_reboot", "estimator", "settle_s", "health", "notes", "samples",
    "left_out", "suspect", "altitude", "exclusions", "suspicions", "parting", "gnss", "barometer",
    "own_altitude", "reference", "sources", "wrong", "score_m", "findings", "reason",
    "verdict", "at_rest", "unreadable",
)  # fmt: skip
"""of a session of replay, batch and the live state"""
ALTITUDE_KEYS = (
    "estimates", "published", "first_m", "last_m", "min_m", "max_m", "median_sd_m",
    "median_level_m", "max_climb_mps", "max_sink_mps", "above_takeoff_last_m", "qnh_hpa",
    "qnh_sd_hpa", "baro_offset_m",
)  # fmt: skip
"""of ``altitude`` in it"""


def document(command: str, log: str, sessions: Sequence[dict[str, Any]], **more: Any) -> Any:
    """The top of the schema around the sessions of one log."""
    head = {"schema": VERSION, "kollsman": __version__, "command": command, "log": log}
    return plain(head | more | {"sessions": list(sessions)})


def plain(value: Any) -> Any:
    """Python numbers, and None for what is not finite, so that the result is JSON."""
    if isinstance(value, dict):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
