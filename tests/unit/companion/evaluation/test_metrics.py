"""Errors against truth: known ones, and nothing where truth has a gap."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.evaluation.metrics import errors, truth_at

SECOND_US = 1e6


def test_known_errors() -> None:
    found = errors([1.0, 2.0, 3.0, 8.0], [0.0, 0.0, 0.0, 10.0])
    assert found is not None
    assert found.count == 4
    assert found.rmse_m == pytest.approx(math.sqrt((1 + 4 + 9 + 4) / 4))
    assert found.bias_m == pytest.approx(1.0)
    assert found.max_m == 3.0
    assert found.unbiased_rmse_m == pytest.approx(math.sqrt((0 + 1 + 4 + 9) / 4))
    assert found.p95_m == pytest.approx(2.85)
    assert found.as_dict()["count"] == 4


def test_a_constant_error_is_all_bias() -> None:
    found = errors(np.full(50, 7.0), np.full(50, 4.5))
    assert found is not None
    assert (found.rmse_m, found.bias_m, found.max_m, found.p95_m) == (2.5, 2.5, 2.5, 2.5)
    assert found.unbiased_rmse_m == 0.0


def test_unknown_pairs_are_left_out() -> None:
    found = errors([1.0, math.nan, 3.0, math.inf], [1.0, 2.0, math.nan, 1.0])
    assert found is not None
    assert (found.count, found.max_m) == (1, 0.0)
    assert errors([math.nan], [1.0]) is None
    assert errors([], []) is None


@given(st.lists(st.floats(-1e4, 1e4).map(lambda value: round(value, 6)), min_size=1, max_size=50))
def test_identities(values: list[float]) -> None:
    found = errors(values, np.zeros(len(values)))
    assert found is not None
    assert found.rmse_m**2 == pytest.approx(
        found.bias_m**2 + found.unbiased_rmse_m**2, abs=1e-6, rel=1e-9
    )
    assert abs(found.bias_m) <= found.rmse_m * (1 + 1e-12) <= found.max_m * (1 + 1e-9)
    assert found.p95_m <= found.max_m


def test_truth_between_its_samples() -> None:
    truth_us = np.linspace(0.0, 9.0, 10, dtype=np.float64) * SECOND_US
    truth_m = np.linspace(0.0, 45.0, 10, dtype=np.float64)
    times_us = np.array([0.0, 0.5, 3.25, 9.0]) * SECOND_US
    np.testing.assert_allclose(truth_at(times_us, truth_us, truth_m), [0.0, 2.5, 16.25, 45.0])


def test_no_truth_outside_and_inside_gaps() -> None:
    truth_us = np.array([0.0, 1.0, 2.0, 10.0, 11.0]) * SECOND_US
    truth_m = np.array([0.0, 1.0, 2.0, 10.0, 11.0])
    times_us = np.array([-0.1, 1.5, 2.5, 6.0, 9.9, 10.5, 11.1]) * SECOND_US
    found = truth_at(times_us, truth_us, truth_m)
    np.testing.assert_allclose(found, [math.nan, 1.5, math.nan, math.nan, math.nan, 10.5, math.nan])


def test_truth_that_came_out_of_order() -> None:
    truth_us = np.array([2.0, 0.0, 1.0]) * SECOND_US
    found = truth_at(np.array([0.5, 1.5]) * SECOND_US, truth_us, np.array([20.0, 0.0, 10.0]))
    np.testing.assert_allclose(found, [5.0, 15.0])


@pytest.mark.parametrize("count", [0, 1])
def test_too_little_truth_is_none(count: int) -> None:
    found = truth_at(np.array([0.0, 1.0]), np.zeros(count), np.zeros(count))
    assert np.isnan(found).all()
