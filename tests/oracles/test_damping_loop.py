"""The damping loop against SciPy: its differential equation, its feedback, and an exhaustive search
of its gains."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lsim, place_poles

from companion.estimators.baro_inertial import genetic, tuning
from companion.estimators.baro_inertial.damping_loop import (
    DampingLoopSettings,
    advance,
    feed_back,
    init,
)
from companion.estimators.baro_inertial.genetic import Gains
from companion.estimators.baro_inertial.loop_gains import BARO_ALONE, matched_gains, poles
from tests.flights import flight

Array = NDArray[np.float64]

PAPER = (3.0, 0.6452, 0.8710)


def matrix(gains: Gains) -> Array:
    """Of (6) without 2 w_s^2, for (h, v, a_c)."""
    return np.array([[-gains[0], 1.0, 0.0], [-gains[1], 0.0, -1.0], [gains[2], 0.0, 0.0]])


def feed(gains: Gains, time_s: Array, baro_m: Array, force_mps2: Array, every: int) -> Array:
    """The compiled loop: acceleration at each instant, the barometer at each `every`-th; h and v,
    shape (n, 2)."""
    params = DampingLoopSettings().params()
    params["poles"], params["baro_alone_poles"] = poles(*gains), poles(*BARO_ALONE)
    state = init(params)
    state["running"], state["x_us"], state["corrected_us"] = 1, 0, 0
    state["h"], state["v"], state["inputs"]["acceleration_mps2"] = baro_m[0], 0.0, 0.0
    found = np.empty((time_s.size, 2))
    for k in range(time_s.size):
        time_us = round(time_s[k] * 1e6)
        state["inputs"]["acceleration_mps2"] = force_mps2[k]
        advance(state, time_us)
        if k > 0 and k % every == 0:
            elapsed_s = (time_us - int(state["corrected_us"][0])) * 1e-6
            feed_back(state, params, float(state["h"][0] - baro_m[k]), elapsed_s)
            state["corrected_us"] = time_us
        found[k] = state["h"][0], state["v"][0]
    return found


def course(time_s: Array) -> tuple[Array, Array]:
    """Barometer height and accelerometer of a vehicle that goes up and down; both are a little
    wrong."""
    baro_m = 100.0 + 20.0 * np.sin(0.1 * time_s) + 0.5 * np.sin(0.7 * time_s)
    return baro_m, -0.2 * np.sin(0.1 * time_s) + 0.05


@pytest.mark.parametrize("gains", [PAPER, (1.2, 1.0, 0.1), (0.5, 0.1, 0.01)])
def test_fast_sensors_give_the_differential_equation(gains: Gains) -> None:
    """Error proportional to the interval, and small at 100 Hz."""
    worst = []
    for interval_s in (0.02, 0.01):
        time_s = np.arange(0.0, 40.0, interval_s)
        baro_m, force = course(time_s)
        system = (
            matrix(gains),
            np.array([[gains[0], 0.0], [gains[1], 1.0], [-gains[2], 0.0]]),
            np.eye(3),
            np.zeros((3, 2)),
        )
        _, expected, _ = lsim(
            system, np.stack([baro_m, force], axis=1), time_s, X0=[baro_m[0], 0.0, 0.0]
        )
        found = feed(gains, time_s, baro_m, force, every=1)
        worst.append(float(np.abs(found - expected[:, :2]).max()))
    assert worst[1] < 0.04
    assert worst[1] < 0.6 * worst[0]


@pytest.mark.parametrize("interval_s", [0.02, 0.3, 1.0, 5.0])
@pytest.mark.parametrize("gains", [PAPER, (1.2, 1.0, 0.1), (0.5, 0.06, 0.002)])
def test_feedback_is_pole_placement(gains: Gains, interval_s: float) -> None:
    """The only gains of a position measurement with the poles of expm(A T)."""
    fly = np.array([[1.0, interval_s, interval_s**2 / 2], [0.0, 1.0, interval_s], [0.0, 0.0, 1.0]])
    wanted = np.linalg.eigvals(expm(matrix(gains) * interval_s))
    placed = place_poles(fly.T, (np.array([[1.0, 0.0, 0.0]]) @ fly).T, wanted).gain_matrix.ravel()
    np.testing.assert_allclose(
        matched_gains(*poles(*gains), interval_s), placed, rtol=1e-6, atol=1e-9
    )


@pytest.mark.parametrize("interval_s", [0.001, 0.02, 0.394, 0.5, 1.0, 3.0, 10.0])
def test_error_dies_out_at_every_rate(interval_s: float) -> None:
    """From 1 ms to 10 s, IMU and barometer at the same rate, over the time that the slow poles
    need."""
    count = round(200.0 / interval_s) + 2
    time_s = np.linspace(0.0, interval_s * min(count, 30_000), min(count, 30_000) + 1)
    baro_m = np.full(time_s.size, 50.0)
    baro_m[0] = 0.0
    found = feed(PAPER, time_s, baro_m, np.zeros(time_s.size), every=1)
    assert np.abs(found[:, 0] - 50.0).max() < 85.0
    expected = 80.0 * np.exp(-0.0595 * time_s[-1])
    assert abs(found[-1, 0] - 50.0) < expected + 1e-6


@pytest.mark.parametrize("baro_s", [0.1, 1.0, 2.0])
def test_slow_barometer_does_not_lag_behind_a_climb(baro_s: float) -> None:
    """A barometer that is held between samples would drag the altitude by half an interval of
    climb."""
    time_s: Array = np.arange(0.0, 120.0, 0.02)
    climb = 10.0 * np.clip((time_s - 10.0) / 5.0, 0.0, 1.0)
    altitude = np.concatenate([[0.0], np.cumsum(0.5 * (climb[1:] + climb[:-1]) * 0.02)])
    force = np.concatenate([[0.0], np.diff(climb) / 0.02])
    found = feed(PAPER, time_s, altitude, force, every=round(baro_s / 0.02))
    assert np.abs(found[:, 0] - altitude).max() < 0.05


def test_genetic_search_against_all_strings() -> None:
    """Within 5 % of the least cost of all 32768 strings from any seed, and often the least
    itself."""
    trial = tuning.Flight(flight(duration_s=40.0, imu_hz=15.0, pressure_hz=5.0, gnss_hz=2.0).log())
    costs = np.array(
        [trial.cost(genetic.decode(string)) for string in range(2**genetic.STRING_BITS)]
    )
    found = [
        genetic.search(lambda string: float(costs[string]), np.random.default_rng(seed)).cost
        / costs.min()
        for seed in range(30)
    ]
    assert max(found) < 1.05
    assert np.mean(np.array(found) < 1.0 + 1e-12) > 0.1
    assert min(found) >= 1.0
