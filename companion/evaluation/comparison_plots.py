"""A comparison as pictures: altitudes against the reference over time, and the Stanford diagram."""

import math
from pathlib import Path

import numpy as np

from companion.errors import ConfigError
from companion.evaluation.compare import Comparison
from companion.evaluation.integrity import plot_stanford
from companion.evaluation.metrics import truth_at
from companion.evaluation.samples import BOOT_US


def plot(comparison: Comparison, path: Path, title: str) -> None:
    """Errors over time of every series, against what the comparison used."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(10, 5), layout="constrained")
    for each in comparison.series:
        error = each.altitude_m - truth_at(each.times_us, comparison.truth_us, comparison.truth_m)
        raw = math.isnan(each.cost_us)
        axes.plot(
            each.times_us % BOOT_US / 60e6,
            error,
            linewidth=0.7 if raw else 1.0,
            alpha=0.6 if raw else 1.0,
            label=each.label,
        )
    axes.axhline(0, color="black", linewidth=0.8)
    axes.set(
        xlabel="time since boot (min)", ylabel=f"altitude - {comparison.reference} (m)", title=title
    )
    limit = np.nanmax(
        [
            5.0,
            *(
                2.0 * result.p95_m
                for result in comparison.results
                if not result.label.startswith("raw b")
            ),
        ]
    )
    axes.set_ylim(-min(limit, 60.0), min(limit, 60.0))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, ncols=2)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def plot_protection(comparison: Comparison, path: Path, title: str, alert_limit_m: float) -> None:
    """Stanford diagram of the first series with a protection level. Raises `ConfigError` when there
    is none, or no truth."""
    if comparison.reference != "truth":
        raise ConfigError("--stanford: needs truth, and the log has none")
    for each in comparison.series:
        if each.level_m is not None:
            late, error_m = comparison.errors_of(each)
            plot_stanford(
                path, f"{title}, {each.label}", error_m, each.level_m[late], alert_limit_m
            )
            return
    raise ConfigError("--stanford: no estimator of this comparison has a protection level")
