"""The compiled smoother against weighted least squares over all states at once."""

import math

import numpy as np

from companion.kernels.rts import backward, forward


def test_smoothed_states_are_the_least_squares_solution() -> None:
    rng = np.random.default_rng(5)
    n, s = 12, 3
    F = np.eye(s) + 0.2 * rng.normal(size=(s, s))
    Q = np.diag([0.3, 0.2, 0.1]) + 0.02
    x0, P0 = rng.normal(size=s), np.diag([4.0, 2.0, 1.0])
    h, R = rng.normal(size=(n, 2, s)), rng.uniform(0.2, 1.0, (n, 2))
    z = rng.normal(size=(n, 2))
    z[3, 0] = z[7, 1] = math.nan

    means, covariances = np.zeros((n, s)), np.zeros((n, s, s))
    before, before_p = np.zeros_like(means), np.zeros_like(covariances)
    kept = (means, covariances, before, before_p)
    forward(F, Q, x0.copy(), P0.copy(), h, z, R, 1e9, *kept, np.zeros((s, s)))
    backward(F, *kept, np.zeros((2, s, s)), np.zeros((s, s)))

    information, vector = np.zeros((n * s, n * s)), np.zeros(n * s)

    def add(row: np.ndarray, value: np.ndarray, covariance: np.ndarray) -> None:
        weight = np.linalg.inv(covariance)
        information[:] += row.T @ weight @ row
        vector[:] += row.T @ weight @ value

    place = np.eye(n * s).reshape(n, s, n * s)
    add(place[0], x0, P0)
    for i in range(n):
        if i:
            add(place[i] - F @ place[i - 1], np.zeros(s), Q)
        for k in range(2):
            if not math.isnan(z[i, k]):
                row = (h[i, k] @ place[i])[None, :]
                add(row, np.array([z[i, k]]), np.array([[R[i, k]]]))
    expected = np.linalg.solve(information, vector).reshape(n, s)
    spread = np.linalg.inv(information)
    np.testing.assert_allclose(means, expected, rtol=1e-8, atol=1e-9)
    for i in range(n):
        block = spread[i * s : (i + 1) * s, i * s : (i + 1) * s]
        np.testing.assert_allclose(covariances[i], block, rtol=1e-7, atol=1e-9)


def test_a_measurement_far_beyond_the_gate_changes_little() -> None:
    F, Q = np.eye(1), np.eye(1) * 1e-6
    z = np.array([[0.1], [500.0], [-0.1]])
    h, R = np.ones((3, 1, 1)), np.ones((3, 1))
    means, covariances = np.zeros((3, 1)), np.zeros((3, 1, 1))
    kept = (means, covariances, np.zeros((3, 1)), np.zeros((3, 1, 1)))
    forward(F, Q, np.zeros(1), np.eye(1), h, z, R, 5.0, *kept, np.zeros((1, 1)))
    assert np.abs(means).max() < 0.2
