"""Integrity of a reported spread and protection level: coverage, exceedances, Stanford diagram.

Errors last, so one error is above its level in many samples. An exceedance therefore begins where
|error| > level, and two that are less than `EXCEEDANCE_APART_S` apart count as one. That time is
the correlation time of the slow GNSS error, over which the allocated rate
(`companion.estimators.vertical_bank.settings.crossing_sigma`) counts one crossing.

The Stanford diagram (Tossaint et al., "The Stanford - ESA integrity diagram", 2007) sets |error|
against level. Above the diagonal the level holds; below it the level is misleading. A level beyond
the alert limit makes the system unavailable; an error beyond it with a level within it is
hazardously misleading.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.evaluation.metrics import Array

EXCEEDANCE_APART_S = 250.0
LONGEST_STEP_S = 2.0
"""longest step of a series that counts as time; a longer gap does not count"""
ALERT_LIMIT_M = 50.0
"""vertical alert limit of an approach with vertical guidance (ICAO Annex 10, APV-I)"""


@dataclass(frozen=True)
class Coverage:
    """Shares of |error| <= 1, 2, 3 standard deviations (a consistent Gaussian: .683, .954, .997),
    and the mean of (error / standard deviation)^2; NaN of an empty series."""

    within_1: float
    within_2: float
    within_3: float
    nees: float


@dataclass(frozen=True)
class Protection:
    """Exceedances of a protection level."""

    hours: float
    exceedances: int
    """number of exceedances (see the module)"""
    exceeded_share: float
    """share of the samples above the level"""
    median_level_m: float

    @property
    def rate_per_h(self) -> float:
        return self.exceedances / self.hours if self.hours > 0.0 else math.nan


@dataclass(frozen=True)
class Regions:
    """Shares of the samples in the regions of a Stanford diagram; they add up to one."""

    available: float
    """|error| <= level <= alert limit"""
    unavailable: float
    """|error| <= level, and the level is beyond the alert limit"""
    misleading: float
    """|error| > level, but both on the same side of the alert limit"""
    hazardous: float
    """|error| > alert limit >= level"""


def coverage(error_m: Array, sd_m: Array) -> Coverage:
    """Coverage of errors by reported standard deviations, shape (n,) each; pairs with a NaN are
    left out."""
    normal = np.abs(error_m / sd_m)
    normal = normal[np.isfinite(normal)]
    if not normal.size:
        return Coverage(math.nan, math.nan, math.nan, math.nan)
    one, two, three = (float(np.mean(normal <= k)) for k in (1.0, 2.0, 3.0))
    return Coverage(one, two, three, float(np.mean(normal**2)))


def protection(times_s: Array, error_m: Array, level_m: Array) -> Protection | None:
    """Exceedances of a series in order of time, shape (n,) each. Samples with a NaN are left out;
    None if none is left."""
    known = np.isfinite(error_m) & np.isfinite(level_m)
    if not known.any():
        return None
    times_s, error_m, level_m = times_s[known], error_m[known], level_m[known]
    steps_s = np.diff(times_s)
    above = np.abs(error_m) > level_m
    return Protection(
        hours=float(np.sum(steps_s[steps_s <= LONGEST_STEP_S])) / 3600.0,
        exceedances=count_exceedances(times_s[above]),
        exceeded_share=float(np.mean(above)),
        median_level_m=float(np.median(level_m)),
    )


def count_exceedances(times_s: Array, apart_s: float = EXCEEDANCE_APART_S) -> int:
    """Number of groups of instants (in order) that are at least `apart_s` apart."""
    return int(times_s.size and 1 + np.count_nonzero(np.diff(times_s) >= apart_s))


def poisson_interval(count: int, confidence: float = 0.95) -> tuple[float, float]:
    """Exact (Garwood's) confidence interval of the mean of a Poisson variable with the
    outcome `count`."""
    tail = 0.5 * (1.0 - confidence)
    low = _solve(count, lambda mean: 1.0 - _at_most(count - 1, mean) < tail) if count > 0 else 0.0
    return low, _solve(count, lambda mean: _at_most(count, mean) > tail)


def _solve(count: int, is_below: Any) -> float:
    low, high = 0.0, count + 10.0 * math.sqrt(count + 1.0) + 10.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_below(middle) else (low, middle)
    return 0.5 * (low + high)


def _at_most(count: int, mean: float) -> float:
    """P(N <= count) of a Poisson variable."""
    if mean <= 0.0:
        return 1.0
    return math.fsum(
        math.exp(k * math.log(mean) - mean - math.lgamma(k + 1.0)) for k in range(count + 1)
    )


def regions(error_m: Array, level_m: Array, alert_limit_m: float = ALERT_LIMIT_M) -> Regions:
    """Regions of a series, shape (n,) each; samples with a NaN are left out."""
    known = np.isfinite(error_m) & np.isfinite(level_m)
    size, level = np.abs(error_m[known]), level_m[known]
    if not size.size:
        return Regions(math.nan, math.nan, math.nan, math.nan)
    covered, within = size <= level, level <= alert_limit_m
    hazardous = within & (size > alert_limit_m)
    shares = (covered & within, covered & ~within, ~covered & ~hazardous, hazardous)
    return Regions(*(float(np.mean(share)) for share in shares))
