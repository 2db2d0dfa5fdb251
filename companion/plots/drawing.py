"""Pictures in the one style, drawn by Matplotlib: settings of every figure, panels of a flight."""

import io
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from companion import whole_file
from companion.errors import ConfigError
from companion.evaluation.metrics import Array
from companion.plots import style
from companion.plots.panels import Band, Panel, panels
from companion.plots.ranges import limits

WIDTH_IN, PANEL_IN = 8.0, 2.7
DPI = 200
"""of pictures; two pixels for each of a screen of 100 dpi"""
COLOURS = 48
"""of a small picture"""
GAP_S = 3.0
"""a line is broken where nothing came for so long, and for five times as long as usual"""
SETTINGS: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#777777",
    "axes.grid": True,
    "grid.color": style.GRID,
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.xmargin": 0.01,
    "axes.formatter.useoffset": False,
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
}
"""Matplotlib's parameters of every figure"""


@contextmanager
def figure(
    rows: int, columns: int = 1, panel_in: float = PANEL_IN, dpi: int = DPI, **kwargs: Any
) -> Iterator[tuple[Any, Any]]:
    """A figure of `rows` x `columns` panels in the one style: (figure, flat array of axes).

    `panel_in` is the height of a panel in inches; `kwargs` go to ``Figure.subplots``. Raises
    `ConfigError` without Matplotlib.
    """
    try:
        import matplotlib as mpl
        from matplotlib.figure import Figure
    except ImportError:
        raise ConfigError("pictures need matplotlib: pip install 'kollsman[report]'") from None
    with mpl.rc_context(SETTINGS):
        canvas = Figure(figsize=(WIDTH_IN, rows * panel_in + 0.2), dpi=dpi, layout="constrained")
        yield canvas, canvas.subplots(rows, columns, squeeze=False, **kwargs).ravel()


def small_png(canvas: Any, colours: int = COLOURS) -> bytes:
    """A figure as a PNG of few colours, a third of the size; no time stamp is in it."""
    from PIL import Image

    drawn, packed = io.BytesIO(), io.BytesIO()
    canvas.savefig(drawn, format="png", metadata={"Software": None})
    with Image.open(drawn) as image:
        few = image.convert("RGB").quantize(colours, kmeans=2, dither=Image.Dither.NONE)
        few.save(packed, format="png", optimize=True)
    return packed.getvalue()


def write_png(canvas: Any, path: Path, colours: int = COLOURS) -> None:
    """Write a figure as a small PNG. Raises `ConfigError`."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        whole_file.write(path, small_png(canvas, colours))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from None


MOST_BESIDE = 5
"""entries of a legend beside the title of its panel"""


def legend_outside(axes: Any, **kwargs: Any) -> None:
    """A legend above the panel, where no data is: to the right of the title, or below it where it
    is long."""
    labels = axes.get_legend_handles_labels()[1]
    if labels:
        if len(labels) > MOST_BESIDE:
            axes.set_title(axes.get_title(loc="left"), loc="left", pad=15.0)
        options: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "ncols": 9}
        options |= {
            "borderaxespad": 0.1,
            "fontsize": 6.5,
            "handlelength": 1.9,
            "columnspacing": 1.0,
        }
        axes.legend(**(options | kwargs))


def tell_clipped(axes: Any, values: Sequence[Array], unit: str = "m") -> None:
    """Write into the panel how far its lines go, where the axis leaves some of them out."""
    low, high = axes.get_ylim()
    known = [each[np.isfinite(each)] for each in values]
    ends = [(float(each.min()), float(each.max())) for each in known if each.size]
    if not ends:
        return
    lowest, highest = min(end[0] for end in ends), max(end[1] for end in ends)
    told = [f"{each:.0f} {unit}" for each in (lowest, highest) if not low <= each <= high]
    if told:
        text = f"axis clipped; values reach {' and '.join(told)}"
        place = {"transform": axes.transAxes, "ha": "right", "va": "bottom", "zorder": 9}
        box = {"facecolor": style.PAPER, "alpha": 0.85, "edgecolor": "none", "pad": 1.5}
        axes.text(0.995, 0.02, text, fontsize=7, color=style.WARNING, bbox=box, **place)


def draw_flight(path: Path, title: str, findings: Sequence[Mapping[str, str]], curves: Any) -> None:
    """The panels of the flight report as one PNG.

    Parameters
    ----------
    findings : sentences of the verdict.
    curves : a `companion.replay.curves.Curves`.
    """
    tables: Mapping[str, Mapping[str, Array]] = curves.tables
    shown = [
        panel
        for panel in panels(curves.reference)
        if any(np.isfinite(_column(tables, line.table, line.column)).any() for line in panel.lines)
    ]
    lines = [line for each in findings for line in textwrap.wrap(each["text"], 110)]
    heights = [1.6 if panel.tall else 1.0 for panel in shown]
    with figure(max(len(shown), 1), panel_in=1.9, sharex=True, height_ratios=heights or [1.0]) as (
        canvas,
        axes,
    ):
        canvas.suptitle("\n".join([title, *lines]), x=0.01, ha="left", fontsize=9)
        for panel, panel_axes in zip(shown, axes, strict=False):
            _draw_panel(panel_axes, panel, tables)
            if panel.shades:
                _shade(panel_axes, curves)
        axes[-1].set_xlabel("time after the start (min)")
        write_png(canvas, path, 96)


def _draw_panel(axes: Any, panel: Panel, tables: Mapping[str, Mapping[str, Array]]) -> None:
    for band in panel.bands:
        t, low, high = _ends(tables, band)
        label = {"label": band.label} if t.size else {}
        axes.fill_between(t, low, high, color=band.colour, alpha=0.15, linewidth=0, **label)
    for edge in panel.edges:
        t, *ends = _ends(tables, edge)
        for end, label in zip(ends, ({"label": edge.label} if t.size else {}, {}), strict=True):
            axes.plot(t, end, color=edge.colour, linewidth=0.8, linestyle="--", **label)
    drawn = []
    for line in panel.lines:
        values = _column(tables, line.table, line.column)
        if np.isfinite(values).any():
            minutes, values = unbroken(tables[line.table]["t"] / 60.0, values, GAP_S / 60.0)
            marks = {"marker": "o", "markersize": 2.5, "linestyle": ""} if line.markers else {}
            axes.plot(minutes, values, **(line.style.matplotlib() | marks))
            drawn.append(values)
    clip = limits(panel, tables)
    bottom, top = axes.get_ylim() if clip is None else clip
    half = max(0.5 * (top - bottom) * (1.0 if clip is None else 1.08), panel.at_least)
    middle = 0.5 * (bottom + top)
    axes.set_ylim(
        middle - half if panel.lowest is None else panel.lowest,
        middle + half if panel.highest is None else panel.highest,
    )
    tell_clipped(axes, drawn, panel.unit)
    axes.set_title(f"{panel.title} ({panel.unit})" if panel.unit else panel.title)
    legend_outside(axes)


def _shade(axes: Any, curves: Any) -> None:
    """Flight modes and exclusions behind the lines."""
    colours: dict[str, str] = {}
    for span in curves.spans.get("flight mode", []):
        shade = style.MODE_SHADES[len(colours) % len(style.MODE_SHADES)]
        colour = colours.setdefault(span.name, shade)
        axes.axvspan(span.from_s / 60.0, span.to_s / 60.0, color=colour, zorder=0, linewidth=0)
    for span in curves.spans.get("excluded", []):
        begin, end = span.from_s / 60.0, span.to_s / 60.0
        axes.axvspan(begin, end, color=style.FAULT_SHADE, zorder=0.5, linewidth=0)


def unbroken(times: Array, values: Array, longest: float) -> tuple[Array, Array]:
    """A line with a break where nothing came for `longest`, and for five times as long as usual."""
    steps = np.diff(times)
    usual = float(np.median(steps)) if steps.size else 0.0
    gaps = np.flatnonzero(steps > max(longest, 5.0 * usual)) + 1
    return np.insert(times, gaps, np.nan), np.insert(values, gaps, np.nan)


def _column(tables: Mapping[str, Mapping[str, Array]], table: str, column: str) -> Array:
    return tables.get(table, {}).get(column, np.zeros(0))


def _ends(tables: Mapping[str, Mapping[str, Array]], band: Band) -> tuple[Array, Array, Array]:
    """Time in minutes, and both ends of a band; empty where it is not known."""
    half = band.times * _column(tables, band.table, band.half)
    if not half.size:
        return half, half, half
    middle = tables[band.table][band.middle] if band.middle else np.zeros(half.size)
    return tables[band.table]["t"] / 60.0, middle - half, middle + half
