"""The vertical channel against a textbook Kalman filter with whole matrices, and against batch
least squares."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.estimators.vertical_bank import channel as vc

Array = NDArray[np.float64]
TIMES_S = (600.0, 60.0, 250.0)
STEADY = np.array([0.0, 0.0, 0.0, 0.0, 0.04, 0.25, 0.0, 9.0])
WALK = np.array([0.0, 0.0, 4e-6, 2.5e-3, 0.0, 0.0, 2.5e-7, 0.0])
PSD = 0.05**2


def transition(dt_s: float, scale: float, moved: float) -> Array:
    """F of the module's docstring, linearised, written down as a matrix."""
    F = np.eye(vc.SIZE)
    F[vc.HEIGHT, vc.CLIMB], F[vc.HEIGHT, vc.ACCEL] = dt_s, -0.5 * dt_s**2
    F[vc.CLIMB, vc.ACCEL] = -dt_s
    F[vc.OFFSET, vc.RATE], F[vc.OFFSET, vc.SCALE] = dt_s, moved
    F[vc.OFFSET, vc.CLIMB], F[vc.OFFSET, vc.ACCEL] = scale * dt_s, -0.5 * scale * dt_s**2
    for i, time_s in zip((vc.RATE, vc.FAST, vc.GNSS_BIAS), TIMES_S, strict=True):
        F[i, i] = math.exp(-dt_s / time_s)
    return F


def noise(dt_s: float) -> Array:
    Q = np.diag(WALK * dt_s + STEADY * (1.0 - np.diag(transition(dt_s, 0.0, 0.0)) ** 2))
    Q[:2, :2] += PSD * np.array([[dt_s**3 / 3, dt_s**2 / 2], [dt_s**2 / 2, dt_s]])
    return Q


def prior(seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    x = np.array([500.0, 3.0, 0.1, -20.0, 0.05, 0.2, 0.02, 1.0])
    root = rng.normal(size=(vc.SIZE, vc.SIZE)) * np.array(
        [3.0, 0.5, 0.1, 3.0, 0.05, 0.3, 0.02, 2.0]
    )
    return x, root.T @ root


@pytest.mark.parametrize("seed", range(5))
def test_propagation_is_that_of_whole_matrices(seed: int) -> None:
    x, P = prior(seed)
    keep = np.zeros(vc.SIZE)
    dt_s, up = 0.2, 1.5
    F, before = transition(dt_s, x[vc.SCALE], 0.0), x.copy()
    displacement = x[vc.CLIMB] * dt_s + 0.5 * (up - x[vc.ACCEL]) * dt_s**2
    F = transition(dt_s, x[vc.SCALE], displacement)
    expected_P = F @ P @ F.T + noise(dt_s)
    expected = before.copy()
    expected[vc.HEIGHT] += displacement
    expected[vc.CLIMB] += (up - before[vc.ACCEL]) * dt_s
    expected[vc.OFFSET] += before[vc.RATE] * dt_s + before[vc.SCALE] * displacement
    for i, time_s in zip((vc.RATE, vc.FAST, vc.GNSS_BIAS), TIMES_S, strict=True):
        expected[i] *= math.exp(-dt_s / time_s)
    P[:] = np.where(np.isclose(P, P.T), 0.5 * (P + P.T), P)
    P[vc.CLIMB, :] *= 0.5
    P[:, vc.CLIMB] *= 0.5
    expected_P = F @ P @ F.T + noise(dt_s)
    vc.decay(keep, dt_s, *TIMES_S)
    moved = vc.propagate(x, P, keep, STEADY, WALK, dt_s, up * dt_s, 0.5 * up * dt_s**2, PSD)
    assert moved == pytest.approx(displacement, rel=1e-12)
    np.testing.assert_allclose(x, expected, rtol=1e-12)
    np.testing.assert_allclose(P, expected_P, rtol=1e-9, atol=1e-12)
    assert np.array_equal(P, P.T)


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
    np.testing.assert_allclose(P, expected_P, rtol=1e-8, atol=1e-10)


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
    """Forty seconds of barometer and GNSS: the last estimate is the minimum of the whole cost (no
    scale: linear)."""
    rng = np.random.default_rng(3)
    n, dt_s, R_baro, R_gnss = 40, 1.0, 0.16, 9.0
    steady, walk = STEADY.copy(), WALK.copy()
    walk[vc.SCALE] = 0.0
    x0, P0 = np.zeros(vc.SIZE), np.diag([1e4, 1.0, 0.04, 1e4, 0.04, 0.25, 0.0, 9.0])
    F = transition(dt_s, 0.0, 0.0)
    Q = np.diag(walk * dt_s + steady * (1.0 - np.diag(F) ** 2))
    Q[:2, :2] += PSD * np.array([[dt_s**3 / 3, dt_s**2 / 2], [dt_s**2 / 2, dt_s]])
    up, baro, gnss = rng.normal(size=n), 300 + rng.normal(size=n), 320 + rng.normal(size=n)
    u = np.zeros((n, vc.SIZE))
    u[:, vc.HEIGHT], u[:, vc.CLIMB] = 0.5 * up * dt_s**2, up * dt_s
    rows = {
        0: np.eye(vc.SIZE)[[vc.HEIGHT, vc.OFFSET, vc.FAST]].sum(0),
        1: np.eye(vc.SIZE)[[0, vc.GNSS_BIAS]].sum(0),
    }

    x, P, keep, H, K = x0.copy(), P0.copy(), np.zeros(vc.SIZE), np.zeros(vc.SIZE), np.zeros(vc.SIZE)
    vc.decay(keep, dt_s, *TIMES_S)
    for k in range(n):
        vc.propagate(x, P, keep, steady, walk, dt_s, u[k, vc.CLIMB], u[k, vc.HEIGHT], PSD)
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
    whole = np.block(
        [[blocks[i, j] if i <= j else blocks[j, i].T for j in range(n + 1)] for i in range(n + 1)]
    )
    mean, z = np.concatenate(means), np.column_stack([baro, gnss]).ravel()
    S = A @ whole @ A.T + np.diag(np.tile([R_baro, R_gnss], n))
    gain = np.linalg.solve(S, A @ whole).T
    posterior = (mean + gain @ (z - A @ mean))[-vc.SIZE :]
    posterior_P = (whole - gain @ A @ whole)[-vc.SIZE :, -vc.SIZE :]
    np.testing.assert_allclose(x, posterior, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(P, posterior_P, rtol=1e-6, atol=1e-7)


def test_offset_prior_is_affine_in_height() -> None:
    """Flown down to sea level without a measurement, what is left is the spread at sea level."""
    x, P, keep = np.zeros(vc.SIZE), np.zeros((vc.SIZE, vc.SIZE)), np.zeros(vc.SIZE)
    vc.expect_baro(x, P, 3000.0, 100.0**2, 0.05**2)
    assert math.sqrt(P[vc.OFFSET, vc.OFFSET]) == pytest.approx(math.hypot(100.0, 150.0))
    x[vc.CLIMB] = -3000.0
    vc.decay(keep, 1.0, *TIMES_S)
    vc.propagate(x, P, keep, np.zeros(vc.SIZE), np.zeros(vc.SIZE), 1.0, 0.0, 0.0, 0.0)
    assert math.sqrt(P[vc.OFFSET, vc.OFFSET]) == pytest.approx(100.0, rel=1e-9)
