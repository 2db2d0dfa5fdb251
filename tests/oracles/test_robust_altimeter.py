"""Paper C's filters against other methods: batch least squares, a filter written in matrices, and
open loop."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import linalg, stats

from companion.estimators.method import Filter
from companion.estimators.robust_altimeter import METHOD
from companion.estimators.robust_altimeter import altimeters as pair
from companion.estimators.robust_altimeter import error_model as paper
from companion.estimators.robust_altimeter.settings import RobustAltimeterSettings
from companion.samples import Rows

Array = NDArray[np.float64]

T_D = 0.5
ALPHA, BETA_G, BETA = 0.001, 0.005, 0.01
SIGMA_A, SIGMA_G, SIGMA_UB = 0.6, 2e-5, 0.2
P_0 = np.diag([9.0, 0.0025, 1e-6, 1e-6, 1.0])
R = 10.0
H = np.array([[1.0, 0.0, 0.0, 0.0, -1.0]])


def phi() -> Array:
    """(11) as it is printed."""
    coupling = 2 * 9.81 * T_D / (6_378_150.0 + 1000.0)
    return np.array(
        [
            [1, T_D, 0, 0, 0],
            [coupling, 1, T_D, T_D, 0],
            [0, 0, 1 - ALPHA * T_D, 0, 0],
            [0, 0, 0, 1 - BETA_G * T_D, 0],
            [0, 0, 0, 0, 1 - BETA * T_D],
        ]
    )


def noise() -> tuple[Array, Array]:
    """G (12) and Q."""
    return np.vstack([np.zeros((2, 3)), T_D * np.eye(3)]), np.diag(
        [SIGMA_A**2, SIGMA_G**2, SIGMA_UB**2]
    )


def params() -> Rows:
    row = RobustAltimeterSettings(preset="paper").params()
    row["sigma_a"][0, 1] = SIGMA_A
    return row


def ours(Z: Array, robust: bool) -> tuple[Array, Array]:
    """Estimates after each measurement, and the last covariance."""
    x, P, K, p = np.zeros(5), P_0.copy(), np.zeros(5), params()
    estimates = []
    for i, value in enumerate(Z):
        if i > 0:
            paper.extrapolate(x, P, T_D, ALPHA, SIGMA_A, p)
        paper.take_in(x, P, H[0], K, float(value), R, robust)
        estimates.append(x.copy())
    return np.array(estimates), P


def measurements(count: int) -> Array:
    rng = np.random.default_rng(5)
    return (
        0.3 * np.arange(count)
        + 20.0 * (np.arange(count) > count // 2)
        + 3.0 * rng.standard_normal(count)
    )


def test_optimal_filter_is_batch_least_squares() -> None:
    """The last state that minimises the weighted squares of start, system noise and measurement
    noise together."""
    count, F, (G, Q) = 40, phi(), noise()
    Z = measurements(count)
    # unknowns: the first state, then the three noises of each interval; everything is linear in
    # them
    unknowns = 5 + 3 * (count - 1)
    states = [np.hstack([np.eye(5), np.zeros((5, unknowns - 5))])]
    for i in range(1, count):
        state = F @ states[-1]
        state[:, 5 + 3 * (i - 1) : 8 + 3 * (i - 1)] += G
        states.append(state)
    prior = linalg.block_diag(
        linalg.inv(linalg.sqrtm(P_0)), *[linalg.inv(linalg.sqrtm(Q))] * (count - 1)
    )
    A = np.vstack([prior, *(H @ state / math.sqrt(R) for state in states)])
    b = np.concatenate([np.zeros(unknowns), Z / math.sqrt(R)])
    solution, *_ = linalg.lstsq(A, b)
    covariance = states[-1] @ linalg.inv(A.T @ A) @ states[-1].T
    estimates, P = ours(Z, robust=False)
    np.testing.assert_allclose(estimates[-1], states[-1] @ solution, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(P, covariance, rtol=1e-6, atol=1e-10)


@pytest.mark.parametrize("robust", [False, True])
def test_filters_are_those_written_in_matrices(robust: bool) -> None:
    """(22)-(32) with numpy's matrices and scipy's normal distribution."""
    F, (G, Q) = phi(), noise()
    Z = measurements(300)
    x, P, expected = np.zeros(5), P_0.copy(), []
    for i, value in enumerate(Z):
        if i > 0:
            x, P = F @ x, F @ P @ F.T + G @ Q @ G.T
        S = (H @ P @ H.T)[0, 0] + R
        K = (P @ H.T)[:, 0] / S
        innovation = value - (H @ x)[0]
        normalised = stats.norm(innovation / math.sqrt(S))
        probability = normalised.cdf(3) - normalised.cdf(-3) if robust else 1.0
        x = x + probability * K * innovation
        P = (np.eye(5) - np.outer(K, H)) @ P
        expected.append(x)
    estimates, last = ours(Z, robust)
    np.testing.assert_allclose(estimates, expected, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(last, P, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("k", [paper.IBI, paper.IIG])
def test_closed_loop_is_the_open_loop_filter(k: int) -> None:
    """Feeding the errors back changes the mechanisation, not the estimate: its height is H_I -
    Delta H of open loop.

    The accelerometer is wrong by 0.05 m/s2; open loop, its height runs away while the estimate
    stays.
    """
    result = Filter(METHOD, RobustAltimeterSettings(preset="paper", gain="optimal"))
    p, s = result.params, result.state[0]["pair"]
    p["sigma_a"][0, 1] = SIGMA_A
    s["inertial"], s["sigma_gps_m"], s["ins_us"] = 1, 2.23, 0
    pair.extrapolate_errors(s, p, 0)
    pair.begin(s, p, k, 0.0)
    start = np.array(s["P"][k])
    variance = pair.height_variance(s, p, k)
    x, P, K = np.zeros(5), start, np.zeros(5)
    height_m, climb_mps, rng = 0.0, 0.0, np.random.default_rng(3)
    apart_m, open_m = [], []
    for i in range(1, 400):
        measured_m = float(rng.normal(0.0, 1.0))
        # open loop: Euler as (3), (4) have it
        height_m, climb_mps = height_m + T_D * climb_mps, climb_mps + T_D * 0.05
        paper.extrapolate(x, P, T_D, ALPHA, SIGMA_A, p)
        paper.take_in(x, P, p["rows_H"][0, k], K, height_m - measured_m, variance, False)
        # closed loop: the estimator's own
        now_us = round(i * T_D * 1e6)
        pair.advance(s, now_us, 0.05)
        T = pair.extrapolate_errors(s, p, now_us)
        pair.gather(s, p, k, float(s["height_m"][k]) - measured_m)
        pair.correct_errors(s, p, now_us, T, False)
        apart_m.append(abs(float(s["height_m"][k]) - (height_m - x[0])))
        open_m.append(abs(height_m))
    assert open_m[-1] > 900.0
    assert max(apart_m) < 0.5, "half a step of the mechanisation, and gravity's gradient"
    assert np.mean(apart_m) < 0.1
    np.testing.assert_allclose(s["P"][k], P, rtol=1e-9, atol=1e-15)


def test_optimal_filter_is_consistent_on_its_own_model() -> None:
    """NEES of the five states and NIS of every measurement, both two-sided at 99.9 %; (2)-(7) drive
    the truth.

    The robust filter is not quite, by its design: (26) takes a measurement's full weight from P
    whatever prob(1/i) is. Without faults that costs it 4 % of NEES here; with them neither P nor
    the spread of (19) says anything.
    """
    count, flights, F, (G, Q) = 120, 150, phi(), noise()
    rng, p = np.random.default_rng(12), params()
    nees: dict[bool, list[float]] = {False: [], True: []}
    nis: list[float] = []
    for _ in range(flights):
        truth = rng.multivariate_normal(np.zeros(5), P_0)
        states = {robust: (np.zeros(5), P_0.copy()) for robust in nees}
        for i in range(count):
            if i > 0:
                truth = F @ truth + G @ rng.multivariate_normal(np.zeros(3), Q)
            value = float((H @ truth)[0] + rng.normal(0.0, math.sqrt(R)))
            for robust, (x, P) in states.items():
                if i > 0:
                    paper.extrapolate(x, P, T_D, ALPHA, SIGMA_A, p)
                if not robust:
                    nis.append(paper.innovation(x, H[0], value) ** 2 / ((H @ P @ H.T)[0, 0] + R))
                paper.take_in(x, P, H[0], np.zeros(5), value, R, robust)
        for robust, (x, P) in states.items():
            nees[robust].append(float((truth - x) @ np.linalg.solve(P, truth - x)))
    low, high = stats.chi2.ppf([0.0005, 0.9995], 5 * flights) / flights
    assert low < np.mean(nees[False]) < high
    low, high = stats.chi2.ppf([0.0005, 0.9995], len(nis)) / len(nis)
    assert low < np.mean(nis) < high
    assert np.mean(nees[True]) > np.mean(nees[False])
