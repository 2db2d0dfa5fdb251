"""The baro-inertial Kalman filter against batch least squares, and its variances against its
errors."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.stats import chi2

from companion.estimators.baro_inertial.baro_ins_kf import (
    advance,
    init,
    spread_out,
    start_at,
)
from companion.estimators.baro_inertial.settings import BaroInsKfSettings
from companion.kernels.kalman import correct
from companion.samples import Rows

Array = NDArray[np.float64]

IMU_S, EVERY = 0.02, 5
BARO_S = IMU_S * EVERY
SETTINGS = BaroInsKfSettings(
    baro_bias_sd_m=0.8,
    baro_bias_time_s=30.0,
    baro_sd_m=0.4,
    acceleration_noise_mps2_rthz=0.05,
    accelerometer_bias_sd_mps2=0.15,
    accelerometer_bias_time_s=50.0,
)


def model() -> tuple[Array, Array]:
    """Transition and noise of (climb, altitude, barometer bias, accelerometer bias) over a
    barometer interval.

    From the differential equation, by Van Loan's matrix exponential.
    """
    F = np.zeros((4, 4))
    F[0, 3], F[1, 0] = -1.0, 1.0
    F[2, 2], F[3, 3] = -1.0 / SETTINGS.baro_bias_time_s, -1.0 / SETTINGS.accelerometer_bias_time_s
    noise = np.diag(
        [
            SETTINGS.acceleration_noise_mps2_rthz**2,
            0.0,
            2.0 * SETTINGS.baro_bias_sd_m**2 / SETTINGS.baro_bias_time_s,
            2.0 * SETTINGS.accelerometer_bias_sd_mps2**2 / SETTINGS.accelerometer_bias_time_s,
        ]
    )
    block = expm(np.block([[-F, noise], [np.zeros((4, 4)), F.T]]) * BARO_S)
    transition = block[4:, 4:].T
    return transition, transition @ block[:4, 4:]


def started(first_m: float) -> tuple[Rows, Rows]:
    params = SETTINGS.params()
    state = init(params)
    start_at(state, params, 0, first_m, 0.0)
    return state, params


def step(state: Rows, params: Rows, index: int, forces: Array, height_m: float) -> float:
    """Five IMU samples and one barometer height, by the filter's own steps; the normalised
    innovation squared."""
    for place, force in enumerate(forces):
        state["inputs"]["acceleration_mps2"] = force
        advance(state, params, round((index * EVERY + place + 1) * IMU_S * 1e6))
    spread_out(state, params, BARO_S)
    s = state[0]
    innovation = height_m - s["x"][1] - s["x"][2]
    variance = correct(s["x"], s["P"], s["H"], s["K"], innovation, SETTINGS.baro_sd_m**2)
    return float(innovation * innovation / variance)


def drawn(random: np.random.Generator, count: int) -> tuple[Array, Array, Array]:
    """Truth (count + 1, 4), accelerometer (count, EVERY) and barometer (count,) of the filter's own
    model."""
    transition, noise = model()
    root = np.linalg.cholesky(noise + 1e-15 * np.eye(4))
    state, _ = started(0.0)
    truth = np.empty((count + 1, 4))
    truth[0] = np.linalg.cholesky(np.asarray(state["P"][0]) + 1e-12 * np.eye(4)) @ random.normal(
        size=4
    )
    moves = 0.5 * np.sin(0.3 * IMU_S * np.arange(count * EVERY)).reshape(count, EVERY)
    for k in range(count):
        climb, height = 0.0, 0.0
        for move in moves[k]:
            height += IMU_S * (climb + 0.5 * IMU_S * move)
            climb += IMU_S * move
        truth[k + 1] = (
            transition @ truth[k] + root @ random.normal(size=4) + [climb, height, 0.0, 0.0]
        )
    heights = truth[1:, 1] + truth[1:, 2] + random.normal(0.0, SETTINGS.baro_sd_m, count)
    return truth, moves, heights


def test_against_batch_least_squares() -> None:
    """All states of 8 s at once: start, process and measurements as weighted residuals."""
    count = 80
    _, forces, heights = drawn(np.random.default_rng(1), count)
    state, params = started(0.0)
    prior = np.asarray(state["P"][0]).copy()
    transition, noise = model()
    rows: list[Array] = []
    values: list[Array] = []

    def residual(blocks: dict[int, Any], value: Any, covariance: Array) -> None:
        weight = np.linalg.inv(np.linalg.cholesky(covariance))
        row = np.zeros((covariance.shape[0], 4 * (count + 1)))
        for place, block in blocks.items():
            row[:, 4 * place : 4 * place + 4] = block
        rows.append(weight @ row)
        values.append(weight @ np.atleast_1d(value))

    residual({0: np.eye(4)}, np.zeros(4), prior + 1e-12 * np.eye(4))
    for k in range(count):
        climb, height = 0.0, 0.0
        for force in forces[k]:
            height += IMU_S * (climb + 0.5 * IMU_S * force)
            climb += IMU_S * force
        residual({k: -transition, k + 1: np.eye(4)}, np.array([climb, height, 0.0, 0.0]), noise)
        measurement = np.array([[0.0, 1.0, 1.0, 0.0]])
        residual({k + 1: measurement}, heights[k], np.array([[SETTINGS.baro_sd_m**2]]))
        step(state, params, k, forces[k], heights[k])
    A, b = np.vstack(rows), np.concatenate(values)
    Q, R = np.linalg.qr(A)
    solved = np.linalg.solve(R, Q.T @ b)[-4:]
    root = np.linalg.inv(R)[-4:]
    covariance = root @ root.T
    np.testing.assert_allclose(state["x"][0], solved, atol=2e-3)
    np.testing.assert_allclose(np.asarray(state["P"][0]), covariance, rtol=2e-3, atol=1e-6)


def test_variances_are_those_of_the_errors() -> None:
    """NEES of the 4 states at 30 s, and NIS of every barometer sample, both two-sided at 99.9 %."""
    count, runs = 300, 40
    nees: list[float] = []
    nis: list[float] = []
    for random in (np.random.default_rng(seed) for seed in np.random.SeedSequence(2).spawn(runs)):
        truth, forces, heights = drawn(random, count)
        state, params = started(0.0)
        nis += [step(state, params, k, forces[k], heights[k]) for k in range(count)]
        error = np.asarray(state["x"][0]) - truth[-1]
        nees.append(error @ np.linalg.solve(np.asarray(state["P"][0]), error))
    low, high = chi2.ppf([0.0005, 0.9995], 4 * runs) / runs
    assert low < np.mean(nees) < high
    low, high = chi2.ppf([0.0005, 0.9995], len(nis)) / len(nis)
    assert low < np.mean(nis) < high
