"""The table of a comparison, for a terminal."""

import math

from companion import tables
from companion.evaluation.compare import Comparison

COLUMNS = {
    "RMSE": "rmse_m",
    "95 %": "p95_m",
    "max": "max_m",
    "bias": "bias_m",
    "no bias": "unbiased_rmse_m",
    "take-off": "takeoff_rmse_m",
    "climb": "climb_rmse_mps",
    "NEES": "nees",
    "sd": "median_sd_m",
    "in 2 sd": "coverage_2",
    "level": "median_level_m",
    "above": "exceeded_share",
    "to baro": "baro_residual_m",
    "us": "cost_us",
}
"""column -> field of `companion.evaluation.compare.Result`"""


def show(found: Comparison) -> None:
    """Print the table."""
    what = "error" if found.reference == "truth" else "difference"
    labels = {f"{what} to {found.reference} (m, m/s)": [each.label for each in found.results]}
    numbers = {
        head: [_cell(getattr(each, name)) for each in found.results]
        for head, name in COLUMNS.items()
    }
    tables.show(labels, numbers)


def _cell(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.2f}"
