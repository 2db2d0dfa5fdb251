"""Scalar corrections of small filters against the textbook in matrices."""

import numpy as np
import pytest

from companion.kernels.kalman import correct, inflated, spread


def _filter(
    seed: int, n: int = 4
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.random.Generator]:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n))
    return rng.normal(size=n), root @ root.T + 0.1 * np.eye(n), rng.normal(size=n), rng


@pytest.mark.parametrize("seed", range(5))
def test_correct_is_the_joseph_form(seed: int) -> None:
    x, P, H, _ = _filter(seed)
    z, R = 1.7, 0.3
    S = H @ P @ H + R
    gain = P @ H / S
    residual = np.eye(4) - np.outer(gain, H)
    expected_x, expected_P = (
        x + gain * (z - H @ x),
        residual @ P @ residual.T + R * np.outer(gain, gain),
    )
    K = np.empty(4)
    assert spread(P, H) + R == pytest.approx(S, rel=1e-12)
    assert correct(x, P, H, K, z - H @ x, R) == pytest.approx(S, rel=1e-12)
    np.testing.assert_allclose(K, gain, rtol=1e-12)
    np.testing.assert_allclose(x, expected_x, rtol=1e-12)
    np.testing.assert_allclose(P, expected_P, rtol=1e-9, atol=1e-12)
    assert (P == P.T).all()


def test_measurements_one_after_the_other_equal_all_at_once() -> None:
    x, P, _, rng = _filter(7)
    rows, z, R = rng.normal(size=(3, 4)), rng.normal(size=3), np.array([0.2, 1.0, 5.0])
    information = np.linalg.inv(P) + rows.T @ np.diag(1 / R) @ rows
    expected_P = np.linalg.inv(information)
    expected_x = x + expected_P @ rows.T @ ((z - rows @ x) / R)
    for H, value, variance in zip(rows, z, R, strict=True):
        correct(x, P, H, np.empty(4), value - H @ x, variance)
    np.testing.assert_allclose(x, expected_x, rtol=1e-9)
    np.testing.assert_allclose(P, expected_P, rtol=1e-8, atol=1e-12)


def test_inflation_puts_an_outlier_at_the_gate_and_leaves_the_rest_alone() -> None:
    S, R = 5.0, 4.0
    assert inflated(3.0 * S**0.5 * 0.999, S, R, 3.0) == R
    larger = inflated(100.0, S, R, 3.0)
    assert 100.0**2 / (S - R + larger) == pytest.approx(9.0)
    assert inflated(1e6, S, R, np.inf) == R
