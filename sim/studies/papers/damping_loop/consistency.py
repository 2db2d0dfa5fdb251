"""Paper K's Kalman filter (11)-(16), (15) as printed and corrected: does P tell the error?

The states are climb, height and the barometer's bias b. (15) as printed drives the height with the
noise of b, and b with nothing; corrected, that noise stands in the row of b, as (12) has it.
"""

import math
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from companion.samples import Kind
from sim.studies.page import Spread, spread
from sim.studies.papers.damping_loop import mountain_road as road
from sim.studies.papers.damping_loop.mountain_road import Drive
from sim.studies.papers.damping_loop.simulation import flight_of

Array = NDArray[np.float64]
BETA = 1.0 / road.BARO_TIME_S
"""of (12), 1/s"""
EXPECTED, LOWEST, HIGHEST = 2.0, 1.0, 4.0
"""Normalised error squared of the two errors that an optimal filter has on average, and what counts
as optimal here: a reported variance that is right within a factor of two."""


class Input(Enum):
    """The matrix B of (15)."""

    PRINTED = "as printed"
    CORRECTED = "the noise of b in the row of b"

    @property
    def matrix(self) -> Array:
        """Columns: acceleration, noise of b."""
        B = np.zeros((3, 2))
        B[0, 0] = 1.0
        B[1 if self is Input.PRINTED else 2, 1] = math.sqrt(2.0 * BETA) * road.BARO_WANDER_M
        return B


def stationary_bias_sd_m(b_input: Input) -> float:
    """Spread of b that the model comes to: the process of (12) has sigma."""
    return float(np.linalg.norm(b_input.matrix[2])) / math.sqrt(2.0 * BETA)


def normalised_errors(drives: list[Drive], b_input: Input) -> Spread:
    """Error squared of (climb, height) over P, mean over a drive after the first minute.

    All drives have the same sample times, so P and gain are those of every drive.
    """
    courses = [flight_of(driven).course for driven in drives]
    times_us, kinds = courses[0]["time_us"], courses[0]["kind"]
    assert all(np.array_equal(course["time_us"], times_us) for course in courses)
    values = np.stack([course["value"] for course in courses])
    at_s = times_us * 1e-6 - road.START_S
    truth = np.stack([
        np.interp(at_s, drives[0].time_s, part)
        for part in (drives[0].climb_mps, drives[0].altitude_m)
    ])  # fmt: skip
    B = b_input.matrix
    noise = road.FORCE_SD**2 / road.IMU_HZ + road.FORCE_BIAS**2
    Q = B @ np.diag([noise, 1.0]) @ B.T
    x = np.zeros((3, len(drives)))
    x[1] = road.START_M
    P, H = np.diag([1.0, 4.0, road.BARO_WANDER_M**2]), np.array([0.0, 1.0, 1.0])
    force, total, count = np.zeros(len(drives)), np.zeros(len(drives)), 0
    for k, dt in enumerate(np.diff(at_s, prepend=at_s[0]).tolist()):
        F = np.array([[1.0, 0.0, 0.0], [dt, 1.0, 0.0], [0.0, 0.0, 1.0 - BETA * dt]])
        x = F @ x
        x[0] += dt * force
        P = F @ P @ F.T + Q * dt
        if kinds[k] == Kind.IMU:
            force = values[:, k]
        elif kinds[k] == Kind.PRESSURE:
            K = P @ H / (H @ P @ H + road.BARO_SD_M**2)
            x = x + np.outer(K, values[:, k] - H @ x)
            P = P - np.outer(K, H @ P)
            if at_s[k] > road.SETTLE_S:
                error = x[:2] - truth[:, k : k + 1]
                total += np.sum(error * np.linalg.solve(P[:2, :2], error), axis=0)
                count += 1
    return spread(total / count)
