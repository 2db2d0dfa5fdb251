"""Ranges of vertical axes: room for what matters, and the worst may leave the axis."""

from collections.abc import Mapping, Sequence

import numpy as np

from companion.evaluation.metrics import Array
from companion.plots.panels import Band, Panel

TIMES = 3.0
"""a line may be this many times larger than the middle one before the axis is clipped"""
BAND_TIMES = 1.3
"""the axis is at least this many times as wide as the bands usually are"""
SHARE = 0.01
"""of each line's values at either end that may leave the axis"""


def error_range(
    errors: Sequence[Array], at_least_m: float, head_room: float = 0.35
) -> tuple[float, float]:
    """Room for 98 % of each line's errors, up to `TIMES` the middle line's or `at_least_m`.

    Parameters
    ----------
    errors : one array a line, m; NaN is unknown.
    head_room : share of the range that is added above, for a legend.
    """
    ends = [np.quantile(each, (SHARE, 1.0 - SHARE)) for each in map(_known, errors) if each.size]
    if not ends:
        return -1.0, 1.0
    spans = sorted(max(-low, high) for low, high in ends)
    limit = max(at_least_m, TIMES * spans[len(spans) // 2])
    low = max(-limit, min(-1.0, *(low for low, _ in ends)))
    high = min(limit, max(1.0, *(high for _, high in ends)))
    return low - 0.1 * (high - low), high + head_room * (high - low)


def limits(panel: Panel, tables: Mapping[str, Mapping[str, Array]]) -> tuple[float, float] | None:
    """The range that a panel's axis is clipped to; None where it shows everything."""
    if not panel.robust:
        return None
    lines = [
        _known(tables[line.table][line.column])
        for line in panel.lines
        if line.column in tables.get(line.table, {})
    ]
    lines = [each for each in lines if each.size]
    if not lines:
        return None
    centre = float(np.median([np.median(each) for each in lines]))
    ends = [np.quantile(each, (SHARE, 1.0 - SHARE)) - centre for each in lines]
    spans = sorted(max(-low, high) for low, high in ends)
    reach = max(panel.at_least, TIMES * spans[len(spans) // 2])
    lowest = min(float(each.min()) for each in lines) - centre
    highest = max(float(each.max()) for each in lines) - centre
    band = BAND_TIMES * max((_half(each, tables) for each in panel.bands), default=0.0)
    low, high = max(-reach, lowest), min(reach, highest)
    return centre + min(low, -band), centre + max(high, band)


def _half(band: Band, tables: Mapping[str, Mapping[str, Array]]) -> float:
    """Half of the median width of a band."""
    known = _known(tables.get(band.table, {}).get(band.half, np.zeros(0)))
    return band.times * float(np.median(known)) if known.size else 0.0


def _known(values: Array) -> Array:
    return values[np.isfinite(values)]
