"""Posterior Cramer-Rao bound of the vertical channel: no estimator's mean square error can be
smaller.

For a model that is linear with Gaussian noise along a given trajectory, the recursion of Tichavsky,
Muravchik and Nehorai (IEEE Trans. Signal Processing 46, 1998, equation 21) is the covariance of the
Kalman filter of the generating model with its priors; the bound of an estimator that also knows the
future is the covariance of the smoother (Rauch, Tung, Striebel 1965). It is a mean over the prior:
it says nothing about one flight. Plain NumPy, and nothing of `companion.estimators`, whose result
it judges.

States, in this order: height and climb; bias of the accelerometer, constant and wandering;
barometer's error at sea level, its drift rate, its change with height, its fast part; slow GNSS
error. With u the measured acceleration,

    h' = v      v' = u - b - d + white      o' = r      b' = r' = s' = 0      d, e, g Gauss-Markov
    baro = h + o + s h + e + white          fix = h + g + white
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

HEIGHT, CLIMB, BIAS, WANDER, OFFSET, RATE, SCALE, FAST, GNSS_BIAS = range(9)
STATES = 9


@dataclass(frozen=True)
class Model:
    """The generating model: standard deviations of its priors and noises, and how long its errors
    last."""

    step_s: float = 0.2
    """interval between barometer samples"""
    height_sd_m: float = 1e4
    climb_sd_mps: float = 30.0
    accel_bias_sd_mps2: float = 0.05
    accel_wander_sd_mps2: float = 0.01
    accel_wander_time_s: float = 100.0
    accel_white_sd_mps2: float = 0.03
    """standard deviation of the mean over a step"""
    offset_sd_m: float = 4.2
    """0.5 hPa"""
    rate_sd_mps: float = 0.0046
    """2 hPa an hour"""
    scale_sd_ratio: float = 0.035
    """10 K"""
    fast_sd_m: float = 0.5
    fast_time_s: float = 60.0
    baro_white_sd_m: float = 0.3
    gnss_slow_sd_m: float = 4.0
    gnss_slow_time_s: float = 120.0
    gnss_white_sd_m: float = 2.0

    @property
    def prior(self) -> Array:
        """Covariance of the first state, shape (9, 9)."""
        return np.diag(
            np.square(
                [
                    self.height_sd_m,
                    self.climb_sd_mps,
                    self.accel_bias_sd_mps2,
                    self.accel_wander_sd_mps2,
                    self.offset_sd_m,
                    self.rate_sd_mps,
                    self.scale_sd_ratio,
                    self.fast_sd_m,
                    self.gnss_slow_sd_m,
                ]
            )
        )

    @property
    def keep(self) -> dict[int, tuple[float, float]]:
        """For each Gauss-Markov state what is left of it after a step, and its stationary standard
        deviation."""
        return {
            WANDER: (np.exp(-self.step_s / self.accel_wander_time_s), self.accel_wander_sd_mps2),
            FAST: (np.exp(-self.step_s / self.fast_time_s), self.fast_sd_m),
            GNSS_BIAS: (np.exp(-self.step_s / self.gnss_slow_time_s), self.gnss_slow_sd_m),
        }

    @property
    def transition(self) -> Array:
        """F of one step, shape (9, 9)."""
        dt, F = self.step_s, np.eye(STATES)
        F[HEIGHT, CLIMB] = F[OFFSET, RATE] = dt
        F[CLIMB, [BIAS, WANDER]] = -dt
        F[HEIGHT, [BIAS, WANDER]] = -0.5 * dt * dt
        for state, (keep, _) in self.keep.items():
            F[state, state] = keep
        return F

    @property
    def process(self) -> Array:
        """Q of one step, shape (9, 9): the acceleration's noise is constant within it."""
        dt, Q = self.step_s, np.zeros((STATES, STATES))
        push = np.array([0.5 * dt * dt, dt]) * self.accel_white_sd_mps2
        Q[:2, :2] = np.outer(push, push)
        for state, (keep, sd) in self.keep.items():
            Q[state, state] = (1.0 - keep * keep) * sd * sd
        return Q

    def rows(self, height_m: Array, scale: Array) -> Array:
        """H of barometer and fix at the true heights and scales (n,): shape (n, 2, 9)."""
        H = np.zeros((height_m.size, 2, STATES))
        H[:, 0, HEIGHT] = 1.0 + scale
        H[:, 0, SCALE] = height_m
        H[:, 0, [OFFSET, FAST]] = 1.0
        H[:, 1, [HEIGHT, GNSS_BIAS]] = 1.0
        return H

    @property
    def noise(self) -> Array:
        """Variances of barometer and fix, shape (2,)."""
        return np.square([self.baro_white_sd_m, self.gnss_white_sd_m])


def bound(
    model: Model, height_m: Array, scale: Array, has_fix: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Variances of height that no filter and no smoother can beat, m2.

    Parameters
    ----------
    height_m, scale
        of each trajectory, shapes (steps, n) and (n,); every step has a barometer sample
    has_fix
        whether a step has a fix, shape (steps,)

    Returns
    -------
    filter_m2, smoother_m2 : shape (steps, n)
    """
    steps, n = height_m.shape
    F, Q = model.transition, model.process
    P = np.broadcast_to(model.prior, (n, STATES, STATES)).copy()
    predicted, corrected = np.empty((2, steps, n, STATES, STATES))
    for k in range(steps):
        if k:
            P = F @ P @ F.T + Q
        predicted[k] = P
        H = model.rows(height_m[k], scale)
        for sensor in range(1 + bool(has_fix[k])):
            P = _corrected(P, H[:, sensor], model.noise[sensor])
        corrected[k] = P
    smoother_m2 = np.empty((steps, n))
    smoother_m2[-1] = P[:, HEIGHT, HEIGHT]
    for k in range(steps - 2, -1, -1):
        gain = np.swapaxes(np.linalg.solve(predicted[k + 1], F @ corrected[k]), 1, 2)
        P = corrected[k] + gain @ (P - predicted[k + 1]) @ np.swapaxes(gain, 1, 2)
        smoother_m2[k] = P[:, HEIGHT, HEIGHT]
    return corrected[:, :, HEIGHT, HEIGHT], smoother_m2


def _corrected(P: Array, H: Array, R: float) -> Array:
    """Joseph's form, for rows H (n, 9): stays symmetric and positive over tens of thousands of
    steps."""
    PH = np.einsum("nij,nj->ni", P, H)
    gain = PH / (np.einsum("ni,ni->n", H, PH) + R)[:, None]
    left = np.eye(STATES) - gain[:, :, None] * H[:, None, :]
    joseph: Array = left @ P @ np.swapaxes(left, 1, 2) + R * gain[:, :, None] * gain[:, None, :]
    return joseph
