"""Coverage, exceedances and the Stanford diagram, against series made by hand and scipy's
distributions."""

import math

import numpy as np
import pytest
from scipy import stats

from companion.evaluation.integrity import (
    EXCEEDANCE_APART_S,
    count_exceedances,
    coverage,
    poisson_interval,
    protection,
    regions,
)

SECONDS = np.arange(3601, dtype=np.float64)


@pytest.mark.parametrize("count", [0, 1, 2, 7, 100, 900])
@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.999])
def test_poisson_interval_is_garwoods(count: int, confidence: float) -> None:
    tail = 0.5 * (1.0 - confidence)
    low = 0.5 * stats.chi2.ppf(tail, 2 * count) if count else 0.0
    high = 0.5 * stats.chi2.ppf(1.0 - tail, 2 * count + 2)
    assert poisson_interval(count, confidence) == pytest.approx((low, high), rel=1e-9, abs=1e-12)


def test_coverage_of_a_gaussian() -> None:
    """Quantiles of the normal distribution in place of random numbers."""
    normal = stats.norm.ppf((np.arange(20_000) + 0.5) / 20_000)
    found = coverage(3.0 * normal, np.full(normal.size, 3.0))
    assert (found.within_1, found.within_2, found.within_3) == pytest.approx(
        (0.6827, 0.9545, 0.9973), abs=2e-4
    )
    assert found.nees == pytest.approx(1.0, abs=1e-3)
    assert coverage(3.0 * normal, np.full(normal.size, 1.5)).nees == pytest.approx(4.0, abs=4e-3)


def test_coverage_leaves_unknown_pairs_out() -> None:
    found = coverage(np.array([0.5, np.nan, 2.5, 9.0]), np.array([1.0, 1.0, 1.0, np.nan]))
    assert (found.within_1, found.within_2, found.within_3) == (0.5, 0.5, 1.0)
    assert math.isnan(coverage(np.zeros(0), np.zeros(0)).nees)


def test_what_is_close_together_is_one_exceedance() -> None:
    assert count_exceedances(np.zeros(0)) == 0
    assert count_exceedances(np.array([5.0])) == 1
    assert count_exceedances(np.array([5.0, 6.0, 7.0, 7.0 + 0.9 * EXCEEDANCE_APART_S])) == 1
    assert (
        count_exceedances(np.array([5.0, 5.0 + EXCEEDANCE_APART_S, 5.0 + 2.0 * EXCEEDANCE_APART_S]))
        == 3
    )


def test_exceedances_of_an_hour() -> None:
    error = np.zeros(SECONDS.size)
    error[[100, 101, 150, 1000, 3000]] = [-12.0, 12.0, 11.0, 12.0, -12.0]
    found = protection(SECONDS, error, np.full(SECONDS.size, 10.0))
    assert found is not None
    assert (found.hours, found.exceedances, found.median_level_m) == (1.0, 3, 10.0)
    assert found.exceeded_share == pytest.approx(5 / 3601)


def test_gaps_are_no_time() -> None:
    times_s = np.concatenate([SECONDS[:601], SECONDS[1800:2401]])
    found = protection(times_s, np.zeros(times_s.size), np.ones(times_s.size))
    assert found is not None
    assert found.hours == pytest.approx(1200 / 3600)
    assert protection(times_s, np.full(times_s.size, np.nan), np.ones(times_s.size)) is None


def test_regions_of_the_stanford_diagram() -> None:
    error = np.array([1.0, -1.0, 20.0, 60.0, 60.0, 55.0, np.nan])
    level = np.array([10.0, 60.0, 10.0, 10.0, 80.0, 52.0, 10.0])
    found = regions(error, level, alert_limit_m=50.0)
    shares = (found.available, found.unavailable, found.misleading, found.hazardous)
    assert shares == pytest.approx((1 / 6, 2 / 6, 2 / 6, 1 / 6))
