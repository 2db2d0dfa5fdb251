"""Errors of an altitude against truth."""

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Errors:
    """Errors of one source: RMS, 95th percentile and maximum of |error|, mean, and RMS without the
    mean."""

    count: int
    rmse_m: float
    p95_m: float
    max_m: float
    bias_m: float
    unbiased_rmse_m: float

    def as_dict(self) -> dict[str, float]:
        return asdict(self)


def errors(values: ArrayLike, truth: ArrayLike) -> Errors | None:
    """Errors of `values` against `truth`, same shape; pairs with a NaN are left out, None when
    nothing is left."""
    error = np.asarray(values, np.float64) - np.asarray(truth, np.float64)
    error = error[np.isfinite(error)]
    if error.size == 0:
        return None
    size, bias = np.abs(error), float(np.mean(error))
    return Errors(
        count=int(error.size),
        rmse_m=float(np.sqrt(np.mean(error**2))),
        p95_m=float(np.percentile(size, 95)),
        max_m=float(np.max(size)),
        bias_m=bias,
        unbiased_rmse_m=float(np.sqrt(np.mean((error - bias) ** 2))),
    )


def truth_at(times_us: Array, truth_us: Array, truth_m: Array) -> Array:
    """Truth at `times_us`, linear between its samples; NaN outside them and inside gaps of more
    than two seconds."""
    if truth_us.size < 2:
        return np.full(times_us.shape, np.nan)
    order = np.argsort(truth_us, kind="stable")
    truth_us, truth_m = truth_us[order], truth_m[order]
    value = np.interp(times_us, truth_us, truth_m, left=np.nan, right=np.nan)
    after = np.clip(np.searchsorted(truth_us, times_us), 1, truth_us.size - 1)
    value[truth_us[after] - truth_us[after - 1] > 2e6] = np.nan
    return value
