"""A comparison as pictures: the flight, the errors of what the vehicle sends, the errors of the
estimators; and the Stanford diagram.

The gallery and ``kollsman compare --plot`` draw the same panels.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.errors import ConfigError
from companion.estimators import DEFAULT_ESTIMATOR, ESTIMATORS
from companion.evaluation.compare import Comparison, Series
from companion.evaluation.metrics import Array, truth_at
from companion.evaluation.samples import BOOT_US
from companion.plots import style
from companion.plots.drawing import figure, legend_outside, tell_clipped, write_png
from companion.plots.ranges import error_range
from companion.plots.stanford import draw_stanford

PANELS, PANEL_IN = 3, 1.9
GAP_MIN = 5.0 / 60.0
RAW = ("raw GNSS", "raw barometer", "autopilot's own")
LEAST_RAW_M, LEAST_ESTIMATOR_M = 150.0, 15.0
"""an axis is never clipped to less than this"""


def plot(comparison: Comparison, path: Path, title: str) -> None:
    """Write the picture of a comparison. Raises `ConfigError`."""
    with figure(PANELS, panel_in=PANEL_IN, sharex=True) as (canvas, axes):
        canvas.suptitle(title, x=0.01, ha="left", fontsize=10)
        draw_comparison(axes, comparison)
        write_png(canvas, path)


def plot_protection(comparison: Comparison, path: Path, title: str, alert_limit_m: float) -> None:
    """Stanford diagram of the first series with a protection level. Raises `ConfigError` when there
    is none, or no truth."""
    if comparison.reference != "truth":
        raise ConfigError("--stanford: needs truth, and the log has none")
    for each in comparison.series:
        if each.level_m is not None:
            late, error_m = comparison.errors_of(each)
            with figure(1, panel_in=6.0) as (canvas, axes):
                draw_stanford(axes[0], error_m, each.level_m[late], alert_limit_m)
                axes[0].set_title(f"{title}, {each.label}")
                write_png(canvas, path, 128)
            return
    raise ConfigError("--stanford: no estimator of this comparison has a protection level")


def draw_comparison(
    axes: Sequence[Any], found: Comparison, windows_min: Sequence[tuple[float, float]] = ()
) -> None:
    """Draw a comparison on `PANELS` Matplotlib axes that share their time.

    Parameters
    ----------
    windows_min : (begin, end) of the time in which a fault acts, minutes since boot; shaded.
    """
    raw = sorted(
        (each for each in found.series if each.label in RAW),
        key=lambda each: style.style_of(each.label).order,
    )
    estimated = [each for each in found.series if each.label in ESTIMATORS]
    minutes = Minutes([found.truth_us, *(each.times_us for each in found.series)])
    _draw_flight(axes[0], found, raw, minutes)
    what = "error" if found.reference == "truth" else f"difference to the {found.reference}"
    for panel, group, least_m, title in (
        (axes[1], raw, LEAST_RAW_M, f"{what} of what the vehicle sends (m)"),
        (axes[2], estimated, LEAST_ESTIMATOR_M, f"{what} of the estimators (m)"),
    ):
        errors = [_error(each, found) for each in group]
        for each, error_m in zip(group, errors, strict=True):
            options = style.style_of(each.label).matplotlib()
            panel.plot(*line(minutes(each.times_us), error_m), **options)
        panel.set_ylim(*error_range(errors, least_m, head_room=0.1))
        panel.set_title(title)
        tell_clipped(panel, errors)
    axes[2].set_xlabel("time since boot (min)")
    end_min = max((float(minutes(each.times_us).max()) for each in found.series), default=0.0)
    for panel in axes:
        for begin_min, until_min in windows_min:
            panel.axvspan(begin_min, min(until_min, end_min), color=style.FAULT_SHADE, zorder=0)
        legend_outside(panel)


def _draw_flight(panel: Any, found: Comparison, raw: Sequence[Series], minutes: "Minutes") -> None:
    for each in raw:
        options = style.style_of(each.label).matplotlib()
        panel.plot(*line(minutes(each.times_us), each.altitude_m), **options)
    if found.truth_us.size:
        options = style.SOURCES[found.reference].matplotlib()
        panel.plot(*line(minutes(found.truth_us), found.truth_m), **options)
    for each in found.series:
        if each.label == DEFAULT_ESTIMATOR:
            options = style.style_of(each.label).matplotlib() | {"linewidth": 1.3}
            panel.plot(*line(minutes(each.times_us), each.altitude_m), **options)
    known = found.truth_m[np.isfinite(found.truth_m)]
    if known.size:
        panel.set_ylim(*_profile_range(known, raw))
        tell_clipped(panel, [each.altitude_m for each in raw])
    panel.set_title("altitude above mean sea level (m)")


def line(minutes: Array, values: Array) -> tuple[Array, Array]:
    """In order of time, and broken where nothing came for `GAP_MIN`: what is from before a reboot
    but arrives later is left out."""
    if not minutes.size:
        return minutes, values
    forward = minutes >= np.maximum.accumulate(minutes)
    minutes, values = minutes[forward], values[forward]
    gaps = np.flatnonzero(np.diff(minutes) > GAP_MIN) + 1
    return np.insert(minutes, gaps, np.nan), np.insert(values, gaps, np.nan)


class Minutes:
    """Times of a log with several boots (`BOOT_US` apart) as minutes since the first one, without
    the gaps."""

    def __init__(self, times_us: Sequence[Array]) -> None:
        """`times_us`: the times of every series of the log."""
        known = np.concatenate([each[np.isfinite(each)] for each in times_us] or [np.zeros(0)])
        boots, since_us = _boots(known)
        count = int(boots.max()) if boots.size else 0
        ends_us = [float(since_us[boots == boot].max(initial=0.0)) for boot in range(count)]
        self._before_us = np.concatenate([[0.0], np.cumsum(ends_us)])

    def __call__(self, times_us: Array) -> Array:
        boots, since_us = _boots(times_us)
        minutes: Array = (since_us + self._before_us[boots]) / 60e6
        return minutes


def _boots(times_us: Array) -> tuple[NDArray[np.int64], Array]:
    """Number of each time's boot, and the time since then; what was true before a boot is a little
    negative."""
    boots = np.rint(times_us / BOOT_US).astype(np.int64)
    return boots, times_us - boots * float(BOOT_US)


def _error(series: Series, found: Comparison) -> Array:
    return series.altitude_m - truth_at(series.times_us, found.truth_us, found.truth_m)


def _profile_range(truth_m: Array, raw: Sequence[Series]) -> tuple[float, float]:
    """All of the truth, and what the sensors say of it unless that is absurd."""
    low, high = float(truth_m.min()), float(truth_m.max())
    room_m = 0.3 * (high - low) + 20.0
    for each in raw:
        lowest, highest = (float(np.nanpercentile(each.altitude_m, share)) for share in (0.5, 99.5))
        low, high = min(low, max(lowest, low - room_m)), max(high, min(highest, high + room_m))
    return low - 0.05 * (high - low), high + 0.05 * (high - low)
