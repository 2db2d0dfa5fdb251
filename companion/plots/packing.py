"""Curves as compact text for a page: whole numbers of a resolution, differences, deflate, base64.

The page unpacks them with the browser's own DecompressionStream (``charts.js``).
"""

import base64
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

UNKNOWN = -(2**31)
"""stands for NaN"""
RESOLUTIONS = {
    "_m": 0.01, "_mps": 0.01, "_hpa": 0.005, "_percent": 0.01, "_m_per_h": 0.1, "t": 0.001,
    "satellites": 1.0, "fix": 1.0, "baro": 1.0, "gnss": 1.0, "imu": 1.0, "attitude": 1.0,
    "frames": 1.0,
}  # fmt: skip
"""column, or its ending -> smallest step that is kept, in its unit"""
DEFAULT_RESOLUTION = 0.001


def resolution(column: str) -> float:
    """The smallest step that is kept of a column."""
    exact = RESOLUTIONS.get(column)
    if exact is not None:
        return exact
    endings = [ending for ending in RESOLUTIONS if ending[0] == "_" and column.endswith(ending)]
    return RESOLUTIONS[max(endings, key=len)] if endings else DEFAULT_RESOLUTION


def pack(tables: Mapping[str, Mapping[str, NDArray[Any]]]) -> dict[str, Any]:
    """``columns`` (table, column, count, resolution each) and ``data``, base64 of the deflated
    differences, their four bytes apart. Columns without a known value are left out.

    Differences 0, -1, 1, -2 ... are 0, 1, 2, 3 ...: the upper bytes of small ones are 0, which
    halves the text.
    """
    columns, parts = [], []
    for table, found in tables.items():
        for column, values in found.items():
            if np.isfinite(values).any():
                step = resolution(column)
                columns.append([table, column, int(values.size), step])
                parts.append(_differences(values, step))
    numbers = np.concatenate(parts) if parts else np.zeros(0, np.uint32)
    planes = numbers.astype("<u4").view(np.uint8).reshape(-1, 4).T.tobytes()
    return {"columns": columns, "data": base64.b64encode(zlib.compress(planes, 9)).decode()}


def unpack(packed: Mapping[str, Any]) -> dict[str, dict[str, NDArray[np.float64]]]:
    """The tables of `pack`, to their resolution."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(packed["data"])), np.uint8)
    numbers = np.ascontiguousarray(planes.reshape(4, -1).T).view("<u4").ravel()
    tables: dict[str, dict[str, NDArray[np.float64]]] = {}
    at = 0
    for table, column, count, step in packed["columns"]:
        folded = numbers[at : at + count]
        differences = (folded >> 1) ^ -(folded & 1)
        whole = np.cumsum(differences, dtype=np.uint32).view(np.int32)
        values = np.where(whole == UNKNOWN, np.nan, whole * step)
        tables.setdefault(table, {})[column] = values
        at += count
    return tables


def _differences(values: NDArray[Any], step: float) -> NDArray[np.uint32]:
    """Of neighbours, modulo 2^32, the sign in the lowest bit; the first stands as it is."""
    known = np.isfinite(values)
    whole = np.clip(np.rint(np.where(known, values, 0.0) / step), UNKNOWN + 1, -UNKNOWN - 1)
    numbers = np.where(known, whole, UNKNOWN).astype(np.int32).view(np.uint32)
    differences = np.diff(numbers, prepend=np.uint32(0)).view(np.int32)
    return ((differences << 1) ^ (differences >> 31)).view(np.uint32)
