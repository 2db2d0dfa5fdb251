"""One colour and line style for each source, the same on every page.

Two lines that are compared differ by at least `LEAST_DIFFERENCE` in colour (CIEDE2000), for normal
sight, deuteranopia and protanopia; ``tests/unit/companion/plots/test_style.py`` computes it. The
dash pattern tells the lines apart in print without colour. Our altitude is the thickest line and is
drawn above the others; raw GNSS is thin and lies below.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

LEAST_DIFFERENCE = 15.0
"""smallest CIEDE2000 difference of two lines in one panel"""

TRUTH, FUSED, INERTIAL = "#1a1a1a", "#004bf0", "#b40078"
BARO, GNSS, OTHER, BOUND = "#a52d00", "#00965a", "#69b400", "#999999"
"""Colours by role. FUSED is our result (in papers: the proposal), OTHER what it is compared with,
INERTIAL the autopilot's own altitude or an inertial result, BOUND a limit."""
ROLES = (TRUTH, FUSED, INERTIAL, BARO, GNSS, OTHER, BOUND)

INK, FAINT, PAPER, GRID = "#1a1a1a", "#5f6368", "#ffffff", "#e4e4e4"
"""text, secondary text, background, grid lines"""
FAULT_SHADE, GOOD, WARNING, BAD = "#f3e3df", "#00794b", "#8a5a00", "#a52d00"
"""time in which a fault acts; states in text, each with a contrast of at least 4.5 on `PAPER`"""
MODE_SHADES = ("#eef2fb", "#fbf6e6", "#eaf6ef", "#f7ecf5", "#f0f0f0", "#e8f4f8")
"""backgrounds of flight modes, in the order in which they first appear; a label names each"""
ERROR_SCALE = "viridis"
"""Matplotlib's name of the colour map for sizes and counts; its lightness rises evenly"""
ERROR_COLOURS = ("#440154", "#3b528b", "#21918c", "#5ec962", "#fde725")
"""five points of `ERROR_SCALE`, for pages without Matplotlib"""

_ESTIMATORS = ("#273b00", "#894e62", "#62b19d", "#c4b127", "#767600", "#00b1ff")
"""of the published systems, by their place in the table of estimators"""


@dataclass(frozen=True)
class LineStyle:
    """How one source is drawn."""

    label: str
    colour: str
    width: float
    """points in Matplotlib, CSS pixels on a page"""
    dash: tuple[float, ...] = ()
    """lengths drawn and left out, in `width` units; empty is a solid line"""
    order: int = 2
    """lines with a higher number are drawn above"""

    def matplotlib(self) -> dict[str, Any]:
        """Keyword arguments of ``Axes.plot``."""
        pattern: Any = (0, self.dash) if self.dash else "-"
        return {
            "color": self.colour,
            "linewidth": self.width,
            "linestyle": pattern,
            "label": self.label,
            "zorder": self.order,
        }

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready, for a page."""
        return asdict(self)


SOURCES: Mapping[str, LineStyle] = {
    "gnss": LineStyle("raw GNSS", GNSS, 0.8, (), 1),
    "baro": LineStyle("raw barometer", BARO, 1.1, (6, 1.5, 1.5, 1.5), 2),
    "autopilot": LineStyle("autopilot's own", INERTIAL, 1.3, (5, 2), 3),
    "smoother": LineStyle("smoother", TRUTH, 1.2, (1.5, 1.5), 4),
    "truth": LineStyle("truth", TRUTH, 1.2, (), 4),
    "estimate": LineStyle("Kollsman", FUSED, 2.2, (), 5),
    "published": LineStyle("Kollsman, as sent", FUSED, 2.2, (), 5),
}
"""name of a source in the report schema -> its line; below first"""


def estimator_style(name: str) -> LineStyle:
    """The line of an estimator where several are compared. Raises `KeyError` if unknown."""
    from companion.estimators import DEFAULT_ESTIMATOR, ESTIMATORS

    if name == DEFAULT_ESTIMATOR:
        return LineStyle(name, FUSED, 1.8, (), 5)
    others = [each for each in ESTIMATORS if each != DEFAULT_ESTIMATOR]
    if name not in others:
        raise KeyError(name)
    place = others.index(name)
    dashes: tuple[tuple[float, ...], ...] = ((), (5, 2), (6, 1.5, 1.5, 1.5))
    return LineStyle(
        name, _ESTIMATORS[place % len(_ESTIMATORS)], 1.0, dashes[place % len(dashes)], 2
    )


def style_of(label: str) -> LineStyle:
    """The line of a series that is named by its label: a source's, or an estimator's name.

    Raises `KeyError` for an unknown label.
    """
    for style in SOURCES.values():
        if style.label == label:
            return style
    return estimator_style(label)
