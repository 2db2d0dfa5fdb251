"""Paper W's filter against other methods: brute force, batch least squares, the Riccati equation,
consistency."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.linalg import solve_discrete_are

from companion.estimators.air_data_gnss import METHOD
from companion.estimators.air_data_gnss.error import LINEAR, scale_variance
from companion.estimators.air_data_gnss.settings import AirDataGnssSettings
from companion.estimators.method import Filter
from companion.kernels.atmosphere import L0_KPM, T0_K, geopotential_m, standard_pressure_pa
from companion.kernels.kalman import correct
from companion.samples import Kind, sample
from sim.studies.papers.air_data_gnss import simulation as paper

Array = NDArray[np.float64]
DT_US = 200_000


def prior(seed: int) -> tuple[float, float, float, float, float, float, float]:
    """a, b, P^a, P^b, z, h, R of a z-update."""
    rng = np.random.default_rng(seed)
    a, b, z = rng.normal(size=3) * (0.03, 20.0, 60.0)
    P_a, P_b, h, R = np.exp(rng.uniform((-9.0, 3.0, 4.0, 3.0), (-5.0, 7.0, 8.0, 8.5)))
    return float(a), float(b), float(P_a), float(P_b), float(z), float(h), float(R)


def corrected(seed: int) -> tuple[Array, Array]:
    a, b, P_a, P_b, z, h, R = prior(seed)
    x, P = np.array([a, b]), np.diag([P_a, P_b])
    correct(x, P, np.array([h, 1.0]), np.empty(2), z - h * a - b, R)
    return x, P


@pytest.mark.parametrize("seed", range(6))
def test_z_update_is_the_mixture_over_hypotheses_of_a(seed: int) -> None:
    """(23), (27)-(31) by their definition: a bank of Kalman filters for b, one for each of 4001
    values of a."""
    a, b, P_a, P_b, z, h, R = prior(seed)
    bank = a + math.sqrt(P_a) * np.linspace(-9.0, 9.0, 4001)
    logs = -0.5 * ((z - h * bank - b) ** 2 / (P_b + R) + (bank - a) ** 2 / P_a)
    alpha = np.exp(logs - logs.max())
    alpha /= alpha.sum()
    K = P_b / (P_b + R)
    conditional = b + K * (z - h * bank - b)
    mean = np.array([alpha @ bank, alpha @ conditional])
    variance = np.array(
        [alpha @ (bank - mean[0]) ** 2, (1.0 - K) * P_b + alpha @ (conditional - mean[1]) ** 2]
    )
    x, P = corrected(seed)
    np.testing.assert_allclose(x, mean, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(np.diag(P), variance, rtol=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_z_update_is_bayes_rule_on_a_grid(seed: int) -> None:
    """Prior times likelihood, integrated over both unknowns: also the correlation that the paper
    drops."""
    a, b, P_a, P_b, z, h, R = prior(seed)
    axis = np.linspace(-7.0, 7.0, 701)
    grid_a, grid_b = np.meshgrid(
        a + math.sqrt(P_a) * axis, b + math.sqrt(P_b) * axis, indexing="ij"
    )
    logs = -0.5 * (
        (grid_a - a) ** 2 / P_a + (grid_b - b) ** 2 / P_b + (z - h * grid_a - grid_b) ** 2 / R
    )
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    mean = np.array([(weight * grid_a).sum(), (weight * grid_b).sum()])
    deviation = np.array([grid_a - mean[0], grid_b - mean[1]])
    covariance = np.einsum("ijk,ljk,jk->il", deviation, deviation, weight)
    x, P = corrected(seed)
    np.testing.assert_allclose(x, mean, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(P, covariance, rtol=1e-3)


@pytest.mark.parametrize("seed", range(6))
def test_printed_z_update_is_the_marginals_of_the_joint_one(seed: int) -> None:
    a, b, P_a, P_b, z, h, R = prior(seed)
    x, P = corrected(seed)
    printed = paper.printed_update(a, b, P_a, P_b, z, h, R)
    np.testing.assert_allclose([*x, P[0, 0], P[1, 1]], printed, rtol=1e-9)


def test_bias_and_scale_factor_are_those_of_batch_least_squares() -> None:
    """All a_k and b_k of 80 cycles at once: prior, walks, temperatures, fixes. Only the last must
    agree, and does."""
    cycles, every = 80, 5
    settings = AirDataGnssSettings(
        preset="paper",
        covariance="joint",
        regressor="gnss",
        scale_walk_per_second=2e-6,
        bias_walk_m2ps=5.0,
    )
    running, rng = Filter(METHOD, settings), np.random.default_rng(11)
    rows: list[tuple[Array, float, float]] = []

    def equation(coefficients: dict[int, float], value: float, variance: float) -> None:
        row = np.zeros(2 * cycles)
        row[list(coefficients)] = list(coefficients.values())
        rows.append((row, value, variance))

    equation({0: 1.0}, 0.0, settings.scale_sd**2)
    equation({1: 1.0}, 0.0, settings.bias_sd_m**2)
    for k in range(cycles):
        height_m = 400.0 + 5.0 * k
        baro_m = 1.04 * height_m - 30.0 + 5.0 * rng.normal()
        air_k = T0_K / 1.04 + L0_KPM * height_m + rng.normal()
        if k > 0:
            equation({2 * k: 1.0, 2 * k - 2: -1.0}, 0.0, settings.scale_walk_per_second * 0.2)
            equation({2 * k + 1: 1.0, 2 * k - 1: -1.0}, 0.0, settings.bias_walk_m2ps * 0.2)
        predicted_m, variance_m2 = predicted(running, baro_m)
        lam = -(air_k - L0_KPM * predicted_m - T0_K) / T0_K
        equation(
            {2 * k: 1.0},
            lam,
            scale_variance(settings.temperature_sd_k**2, variance_m2, predicted_m, T0_K),
        )
        time_us = 1_000_000 + k * DT_US
        running.step(Kind.AIR, sample(Kind.AIR, time_us, air_temperature_k=air_k))
        if k % every == 0:
            fix_m = height_m + 70.0 * rng.normal()
            equation({2 * k: fix_m, 2 * k + 1: 1.0}, baro_m - fix_m, 25.0 + 4900.0)
            running.step(Kind.GNSS, sample(Kind.GNSS, time_us, fix_type=3, altitude_amsl_m=fix_m))
        pressure_pa = standard_pressure_pa(geopotential_m(baro_m))
        running.step(Kind.PRESSURE, sample(Kind.PRESSURE, time_us, pressure_pa=pressure_pa))
    weight = np.array([1.0 / variance for _, _, variance in rows])
    A, y = np.array([row for row, _, _ in rows]), np.array([value for _, value, _ in rows])
    covariance = np.linalg.inv(A.T @ (weight[:, None] * A))
    solution = covariance @ (A.T @ (weight * y))
    np.testing.assert_allclose(running.state["error"]["x"][0], solution[-2:], rtol=1e-6)
    np.testing.assert_allclose(running.state["error"]["P"][0], covariance[-2:, -2:], rtol=1e-6)


def predicted(running: Filter, baro_m: float) -> tuple[float, float]:
    """Height before the next cycle, and its variance: what lambda is formed with."""
    if running.state["motion"]["time_us"][0] < 0:
        return baro_m, 100.0
    height, climb = running.state["motion"]["x"][0]
    P = running.state["motion"]["P"][0]
    return height + 0.2 * climb, P[0, 0] + 0.4 * P[0, 1] + 0.04 * P[1, 1]


@pytest.mark.parametrize("values", [{"preset": "paper", "correction": "carried"}, {}])
def test_alpha_beta_filter_settles_at_the_riccati_equation(values: dict[str, Any]) -> None:
    settings = AirDataGnssSettings(**values)
    running = Filter(METHOD, settings)
    for k in range(400):
        pressure = sample(Kind.PRESSURE, 1_000_000 + k * DT_US, pressure_pa=95_000.0)
        running.step(Kind.PRESSURE, pressure)
    F = np.array([[1.0, 0.2], [0.0, 1.0 - 0.2 / 100.0]])
    Q, H = np.diag([0.0, settings.climb_walk_m2ps3 * 0.2]), np.array([[1.0, 0.0]])
    before = solve_discrete_are(F.T, H.T, Q, np.array([[settings.baro_variance_m2]]))
    K = before @ H.T / (H @ before @ H.T + settings.baro_variance_m2)
    np.testing.assert_allclose(
        running.state["motion"]["P"][0], (np.eye(2) - K @ H) @ before, rtol=1e-9
    )
    np.testing.assert_allclose(running.state["motion"]["K"][0], K[:, 0], rtol=1e-9)


def test_law_of_temperature_is_the_derivative_of_the_exact_one() -> None:
    """(6) corrected is T_0/T_0' - 1 to first order."""
    from companion.estimators.air_data_gnss.error import EXACT, scale_of_temperature

    for warmer_k in (-1e-3, 1e-3):
        air_k = T0_K + warmer_k + L0_KPM * 1600.0
        exact = scale_of_temperature(EXACT, air_k, T0_K, 1600.0)
        assert scale_of_temperature(LINEAR, air_k, T0_K, 1600.0) == pytest.approx(exact, rel=1e-5)
        assert exact == pytest.approx(-warmer_k / T0_K, rel=1e-5)


def test_joint_covariance_is_consistent_on_its_own_model() -> None:
    """Two-sided: the mean of the normalised errors squared, chi-squared with 2 degrees of freedom
    each."""
    seeds = 250
    low, high = stats.chi2.ppf((0.005, 0.995), 2 * seeds) / seeds
    assert low < paper.normalised_errors("joint", seeds).mean() < high


def test_marginal_covariance_of_the_paper_is_not() -> None:
    """By design: after each fix it forgets the correlation of a and b. Pinned; 2 would be
    consistent."""
    assert paper.normalised_errors("marginal", 250).mean() == pytest.approx(12.5, abs=2.5)
