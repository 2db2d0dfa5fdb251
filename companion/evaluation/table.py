"""The table of a comparison, for a terminal."""

import math

from rich.console import Console
from rich.table import Table

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
    table = Table(f"{what} to {found.reference} (m, m/s)", box=None, pad_edge=False)
    for column in COLUMNS:
        table.add_column(column, justify="right")
    for result in found.results:
        values = (getattr(result, name) for name in COLUMNS.values())
        table.add_row(
            result.label, *("" if math.isnan(value) else f"{value:.2f}" for value in values)
        )
    Console(width=140).print(table)
