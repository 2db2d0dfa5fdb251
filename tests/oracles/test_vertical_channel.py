"""The vertical channel against a textbook Kalman filter with whole matrices, and against batch
least squares."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.estimators.vertical_bank import channel as vc

Array = NDArray[np.float64]
RELAXING = {vc.RATE: (600.0, 0.04), vc.FAST: (60.0, 0.25), vc.GNSS_BIAS: (250.0, 9.0)}
"""state -> correlation time (s) and stationary variance"""
PSD = 0.05**2


def transition(dt_s: float) -> Array:
    """F of the module's docstring, written down as a matrix."""
    F = np.eye(vc.SIZE)
    F[vc.HEIGHT, vc.CLIMB], F[vc.HEIGHT, vc.ACCEL] = dt_s, -0.5 * dt_s**2
    F[vc.CLIMB, vc.ACCEL] = -dt_s
    F[vc.OFFSET, vc.RATE] = dt_s
    for i, (time_s, _) in RELAXING.items():
        F[i, i] = math.exp(-dt_s / time_s)
    return F


def noise(dt_s: float) -> Array:
    Q = np.zeros((vc.SIZE, vc.SIZE))
    for i, (time_s, steady) in RELAXING.items():
        Q[i, i] = steady * (1.0 - math.exp(-2.0 * dt_s / time_s))
    Q[:2, :2] += PSD * np.array([[dt_s**3 / 3, dt_s**2 / 2], [dt_s**2 / 2, dt_s]])
    return Q


def whole(P: Array) -> Array:
    """The symmetric matrix whose upper triangle P holds."""
    return np.triu(P) + np.triu(P, 1).T


def propagate(x: Array, P: Array, dt_s: float, up: float) -> float:
    """The steps of the channel in their order."""
    moved = vc.move(x, P, dt_s, up * dt_s, 0.5 * up * dt_s**2, PSD)
    for i, (time_s, steady) in RELAXING.items():
        vc.relax(x, P, i, math.exp(-dt_s / time_s), steady)
    return moved


def prior(seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    x = rng.normal(size=vc.SIZE) * SPREADS
    root = rng.normal(size=(vc.SIZE, vc.SIZE)) * SPREADS
    P = root.T @ root
    return x, 0.5 * (P + P.T)


SPREADS = np.array([3.0, 0.5, 0.1, 3.0, 0.05, 0.3, 0.02, 0.1, 3.0, 0.5, 2.0, 0.3, 3.0])


@pytest.mark.parametrize("seed", range(5))
def test_propagation_is_that_of_whole_matrices(seed: int) -> None:
    x, P = prior(seed)
    dt_s, up = 0.2, 1.5
    F, displacement = transition(dt_s), x[vc.CLIMB] * dt_s + 0.5 * (up - x[vc.ACCEL]) * dt_s**2
    expected, expected_P = F @ x, F @ P @ F.T + noise(dt_s)
    expected[vc.HEIGHT] += 0.5 * up * dt_s**2
    expected[vc.CLIMB] += up * dt_s
    moved = propagate(x, P, dt_s, up)
    assert moved == pytest.approx(displacement, rel=1e-12)
    np.testing.assert_allclose(x, expected, rtol=1e-12)
    np.testing.assert_allclose(whole(P), expected_P, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_the_offset_follows_the_scale_over_a_known_climb(seed: int) -> None:
    x, P = prior(seed)
    F = np.eye(vc.SIZE)
    F[vc.OFFSET, vc.SCALE] = 40.0
    expected, expected_P = F @ x, F @ P @ F.T
    vc.carry(x, P, vc.OFFSET, vc.SCALE, 40.0)
    np.testing.assert_allclose(x, expected, rtol=1e-12)
    np.testing.assert_allclose(whole(P), expected_P, rtol=1e-9, atol=1e-12)


def test_a_copy_of_a_state_has_its_covariances() -> None:
    x, P = prior(1)
    F = np.eye(vc.SIZE)
    F[vc.TAKEOFF] = np.eye(vc.SIZE)[vc.HEIGHT]
    expected, expected_P = F @ x, F @ P @ F.T
    vc.clone(x, P, vc.TAKEOFF, vc.HEIGHT)
    np.testing.assert_allclose(x, expected)
    np.testing.assert_allclose(whole(P), expected_P)


@pytest.mark.parametrize("seed", range(5))
def test_correction_is_the_textbook_one(seed: int) -> None:
    x, P = prior(seed)
    H, K = np.zeros(vc.SIZE), np.zeros(vc.SIZE)
    vc.sees_height(H, 0.15)
    H[vc.GNSS_BIAS] = 1.0
    S = float(H @ P @ H) + 4.0
    gain = P @ H / S
    joseph = np.eye(vc.SIZE) - np.outer(gain, H)
    expected_P = joseph @ P @ joseph.T + 4.0 * np.outer(gain, gain)
    expected = x + gain * 2.5
    assert vc.gather(P, H, K) + 4.0 == pytest.approx(S, rel=1e-12)
    vc.absorb(x, P, K, 2.5, S)
    np.testing.assert_allclose(x, expected, rtol=1e-12)
    np.testing.assert_allclose(whole(P), expected_P, rtol=1e-8, atol=1e-10)


def test_late_height_is_that_of_its_own_time() -> None:
    """A known parabola, a biased accelerometer: the row and the integrals find the height of 0.3 s
    ago."""
    late_s, up, bias, climb = 0.3, 2.0, 0.4, 5.0  # true acceleration 1.6
    x = np.zeros(vc.SIZE)
    x[vc.HEIGHT], x[vc.CLIMB], x[vc.ACCEL] = 100.0, climb, bias
    H = np.zeros(vc.SIZE)
    vc.sees_height(H, late_s)
    V, S, S_then = (
        up * 2.0,
        0.5 * up * 2.0**2,
        0.5 * up * 1.7**2,
    )  # integrated since two seconds ago
    back = late_s * V - (S - S_then)
    truth = 100.0 - climb * late_s + 0.5 * (up - bias) * late_s**2
    assert vc.dot(H, x) + back == pytest.approx(truth, abs=1e-12)
    vc.sees_climb(H, late_s)
    assert vc.dot(H, x) - up * late_s == pytest.approx(climb - (up - bias) * late_s, abs=1e-12)


def test_filter_is_batch_least_squares() -> None:
    """Forty seconds of barometer and GNSS: the last estimate is the minimum of the whole cost."""
    rng = np.random.default_rng(3)
    n, dt_s, R_baro, R_gnss = 40, 1.0, 0.16, 9.0
    x0 = np.zeros(vc.SIZE)
    P0 = np.diag([1e4, 1.0, 0.04, 1e4, 0.04, 0.25, 0.0, 0.01, 25.0, 0.0, 9.0, 0.0, 0.0])
    F, Q = transition(dt_s), noise(dt_s)
    up, baro, gnss = rng.normal(size=n), 300 + rng.normal(size=n), 320 + rng.normal(size=n)
    u = np.zeros((n, vc.SIZE))
    u[:, vc.HEIGHT], u[:, vc.CLIMB] = 0.5 * up * dt_s**2, up * dt_s
    rows = {
        0: np.eye(vc.SIZE)[[vc.HEIGHT, vc.OFFSET, vc.FAST, vc.LIFT]].sum(0),
        1: np.eye(vc.SIZE)[[vc.HEIGHT, vc.GNSS_BIAS]].sum(0),
    }
    rows[0][vc.PORT] = 60.0

    x, P, H, K = x0.copy(), P0.copy(), np.zeros(vc.SIZE), np.zeros(vc.SIZE)
    for k in range(n):
        propagate(x, P, dt_s, up[k])
        for row, z, R in ((0, baro[k], R_baro), (1, gnss[k], R_gnss)):
            H[:] = rows[row]
            innovation = z - vc.dot(H, x)
            vc.absorb(x, P, K, innovation, vc.gather(P, H, K) + R)

    # the same as one linear Gaussian problem: mean and covariance of the whole trajectory, then
    # condition on all z
    means, cov = [x0], P0
    blocks = {(0, 0): P0}
    for k in range(n):
        means.append(F @ means[-1] + u[k])
        cov = F @ cov @ F.T + Q
        blocks[k + 1, k + 1] = cov
    for i in range(n + 1):
        for j in range(i + 1, n + 1):
            blocks[i, j] = blocks[i, j - 1] @ F.T
    A = np.zeros((2 * n, vc.SIZE * (n + 1)))
    for k in range(n):
        A[2 * k, vc.SIZE * (k + 1) : vc.SIZE * (k + 2)] = rows[0]
        A[2 * k + 1, vc.SIZE * (k + 1) : vc.SIZE * (k + 2)] = rows[1]
    joint = np.block(
        [[blocks[i, j] if i <= j else blocks[j, i].T for j in range(n + 1)] for i in range(n + 1)]
    )
    mean, z = np.concatenate(means), np.column_stack([baro, gnss]).ravel()
    S = A @ joint @ A.T + np.diag(np.tile([R_baro, R_gnss], n))
    gain = np.linalg.solve(S, A @ joint).T
    posterior = (mean + gain @ (z - A @ mean))[-vc.SIZE :]
    posterior_P = (joint - gain @ A @ joint)[-vc.SIZE :, -vc.SIZE :]
    np.testing.assert_allclose(x, posterior, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(whole(P), posterior_P, rtol=1e-6, atol=1e-7)


def test_offset_prior_is_affine_in_height() -> None:
    """Flown down to sea level without a measurement, what is left is the spread at sea level."""
    x, P = np.zeros(vc.SIZE), np.zeros((vc.SIZE, vc.SIZE))
    vc.expect_baro(x, P, 3000.0, 100.0**2, 0.05**2)
    assert math.sqrt(P[vc.OFFSET, vc.OFFSET]) == pytest.approx(math.hypot(100.0, 150.0))
    vc.carry(x, P, vc.OFFSET, vc.SCALE, -3000.0)
    assert math.sqrt(P[vc.OFFSET, vc.OFFSET]) == pytest.approx(100.0, rel=1e-9)
