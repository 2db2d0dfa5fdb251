"""The Stanford diagram: error against protection level, with the shares of its regions."""

from typing import Any

import numpy as np

from companion.evaluation.integrity import ALERT_LIMIT_M, regions
from companion.evaluation.metrics import Array
from companion.plots import style

BINS = 90
ROOM = 1.08
"""the axes reach a little beyond the largest error and level"""


def draw_stanford(
    axes: Any, error_m: Array, level_m: Array, alert_limit_m: float = ALERT_LIMIT_M
) -> None:
    """The diagram on Matplotlib `axes`: numbers of samples by colour, on a logarithmic scale.

    Parameters
    ----------
    error_m, level_m : shape (n,) each, m; pairs with a NaN are left out.
    alert_limit_m : drawn where the axes reach it, which follow the data; told where they do not.
    """
    from matplotlib.colors import LogNorm

    known = np.isfinite(error_m) & np.isfinite(level_m)
    size, level = np.abs(error_m[known]), level_m[known]
    if not size.size:
        axes.text(0.5, 0.5, "no errors and levels known", transform=axes.transAxes, ha="center")
        return
    right, top = ROOM * max(float(size.max()), 0.1), ROOM * float(level.max())
    *_, image = axes.hist2d(
        size, level, bins=BINS, range=((0.0, right), (0.0, top)), norm=LogNorm(),
        cmap=style.ERROR_SCALE, rasterized=True,
    )  # fmt: skip
    axes.figure.colorbar(image, ax=axes, label="samples", pad=0.02)
    both = min(right, top)
    axes.plot([0.0, both], [0.0, both], color=style.INK, linewidth=1.0)
    axes.axhline(alert_limit_m, color=style.BAD, linewidth=1.0)
    axes.axvline(alert_limit_m, color=style.BAD, linewidth=1.0)
    found = regions(error_m, level_m, alert_limit_m)
    beyond = "" if alert_limit_m <= max(right, top) else ", beyond the axes"
    shares = (
        ("available", found.available),
        ("unavailable", found.unavailable),
        ("misleading", found.misleading),
        ("hazardously misleading", found.hazardous),
    )
    told = [f"{name} {100 * share:.3g} %" for name, share in shares]
    limit = f"alert limit {alert_limit_m:g} m{beyond}"
    lines = ("|altitude error| (m)", ", ".join(told[:2]), ", ".join(told[2:]), limit)
    axes.set(
        xlabel="\n".join(lines),
        ylabel="protection level (m)",
        xlim=(0.0, right),
        ylim=(0.0, top),
    )
