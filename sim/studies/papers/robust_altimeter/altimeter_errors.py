"""The simulation of paper C: errors of an inertial vertical channel, found by the altimeters of the
estimator.

True height stays where it is, so that a mechanised height is its own error. The channel of each
altimeter drifts by the paper's error model (3)-(6), both from the same noise; barometer and GPS
heights reach the estimator's own `gather` and `correct_errors`, which feed back what they find.
What is left in ``height_m`` after an iteration is "the error of estimating the error".
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.estimators.robust_altimeter import METHOD
from companion.estimators.robust_altimeter.altimeters import (
    begin,
    correct_errors,
    extrapolate_errors,
    gather,
    height_variance,
)
from companion.estimators.robust_altimeter.error_model import G_MPS2, IBI, IIG, R_0_M, share
from companion.estimators.robust_altimeter.isolation import TRUST_IBI, TRUST_IIG
from companion.estimators.robust_altimeter.settings import RobustAltimeterSettings
from companion.jit import step
from companion.samples import Record, Rows

Array = NDArray[np.float64]

T_D_S = 0.5
ITERATIONS = 600
FIRST_FAULTY, LAST_FAULTY = 200, 400
START_SD = (3.0, 0.05, 1e-3, 1e-3, 1.0)
"""Of (8) at the start: sigma_INS and sigma_B of Table 1; the paper gives no other."""
KNOWN_S = 1e9
NORMAL, BIASED, NOISY = 0, 1, 2
"""Measuring normally, CBM, MNI."""
ALTIMETERS = ("IBI", "IIG", "IBIG", "recommended")


@dataclass(frozen=True)
class Model:
    """What is simulated and assumed. Defaults: Table 1, which gives no sigma_UB, and the optimal
    filter (22)."""

    sigma_a: float = 2e-5
    sigma_ub: float = 0.1
    robust: bool = False
    reacquire_s: float | None = None
    may_doubt_imu: bool = False
    bias_m: float = 20.0
    factor: float = 100.0
    """of the variance of a noisy channel"""
    faults: tuple[int, int] = (NORMAL, NORMAL)
    """of barometer and GPS"""
    shared: bool = False
    """whether the INS's part of both measurements (9 of R) is one draw: one INS, or two"""

    def having(self, **changes: Any) -> "Model":
        return replace(self, **changes)

    def params(self) -> Rows:
        row = RobustAltimeterSettings(
            preset="paper",
            gain="robust" if self.robust else "optimal",
            reacquire_s="never" if self.reacquire_s is None else self.reacquire_s,
        ).params()
        row["sigma_a"][0, 1], row["sigma_UB"], row["may_doubt_imu"] = (
            self.sigma_a,
            self.sigma_ub,
            self.may_doubt_imu,
        )
        row["P_W"], row["P_a"][0, 1], row["P_g"] = (
            START_SD[1] ** 2,
            START_SD[2] ** 2,
            START_SD[3] ** 2,
        )
        return row


@dataclass(frozen=True)
class Result:
    """Of the runs of one model, shape (seeds, iterations) and more."""

    errors_m: Array
    """(seeds, iterations, 4): of estimating the error, in the order of `ALTIMETERS`"""
    probability: Array
    """(seeds, iterations, 2): prob(1/i) of IBI and IIG"""
    variance_m2: Array
    """(iterations, 2): what P says of them, the same in every run that never re-acquires"""

    def mean_m(self, altimeter: int, first: int = 0, last: int | None = None) -> Array:
        """Mean absolute error, one a seed."""
        return np.asarray(np.abs(self.errors_m[:, first:last, altimeter]).mean(axis=1))

    def standard_error_m(self, altimeter: int) -> Array:
        """Standard deviation of the absolute error over the root of the number of iterations, one a
        seed."""
        error = np.abs(self.errors_m[:, :, altimeter])
        return np.asarray(error.std(axis=1) / np.sqrt(error.shape[1]))


def noises(generators: Sequence[np.random.Generator], iterations: int = ITERATIONS) -> Array:
    """Standard normal draws (seeds, iterations + 1, 6): system noises, the two sensors, the INS
    that both share; first the start's."""
    sizes = (iterations + 1, 5), (iterations + 1, 1)
    return np.stack(
        [np.hstack([each.standard_normal(size) for size in sizes]) for each in generators]
    )


def simulate(model: Model, draws: Array) -> Result:
    """Both altimeters on every draw."""
    params = model.params()
    seeds, iterations = draws.shape[0], draws.shape[1] - 1
    errors, probability = np.zeros((seeds, iterations, 4)), np.zeros((seeds, iterations, 2))
    variance, truth = np.zeros((iterations, 2)), np.zeros((2, 5))
    faults = np.array(model.faults)
    for seed in range(seeds):
        state = METHOD.init(params)
        results = errors[seed], probability[seed], variance
        ins_sd = float(params["sigma_INS"][0]) if model.shared else 0.0
        one_run(
            state,
            params,
            draws[seed],
            faults,
            model.bias_m,
            model.factor,
            ins_sd,
            truth,
            *results,
        )
    return Result(errors, probability, variance)


@step
def drift(truth: Array, pair: Record, params: Rows, k: int, draw: Array) -> None:
    """(2)-(6) over T_d; of acceleration and gravity, what the altimeter has found is taken out."""
    p = params[0]
    height, climb = truth[k, 0], truth[k, 1]
    found = pair.x[k, 2] + pair.x[k, 3]
    truth[k, 0] = height + T_D_S * climb
    truth[k, 1] = climb + T_D_S * (
        2.0 * G_MPS2 / (R_0_M + p.H) * height + truth[k, 2] + truth[k, 3] - found
    )
    truth[k, 2] += T_D_S * (p.sigma_a[1] * draw[0] - p.alpha[1] * truth[k, 2])
    truth[k, 3] += T_D_S * (p.sigma_g * draw[1] - p.beta_g * truth[k, 3])
    truth[k, 4] += T_D_S * (p.sigma_UB * draw[2] - p.beta * truth[k, 4])


@step
def set_out(state: Rows, params: Rows, truth: Array, draw: Array) -> None:
    """Both channels at the same erroneous start; the filters know its spread."""
    s = state[0]
    pair = s.pair
    pair.inertial, pair.sigma_gps_m, s.now_us = 1, params[0].sigma_GPS, 0
    pair.datum.age_s = KNOWN_S  # barometer and GPS have one datum
    for k in range(2):
        begin(pair, params, k, 0.0)
        pair.P[k, 0, 0] = START_SD[0] ** 2
        for i in range(5):
            truth[k, i] = START_SD[i] * draw[i]
    extrapolate_errors(pair, params, s.now_us)


@step
def one_run(
    state: Rows,
    params: Rows,
    draws: Array,
    faults: Array,
    bias_m: float,
    factor: float,
    ins_sd: float,
    truth: Array,
    errors: Array,
    probability: Array,
    variance: Array,
) -> None:
    """All iterations of one run; the last three arguments are filled."""
    s, pair = state[0], state[0].pair
    set_out(state, params, truth, draws[0])
    for i in range(errors.shape[0]):
        T = T_D_S
        if i > 0:
            for k in range(2):
                drift(truth, pair, params, k, draws[i])
            s.now_us += int(T_D_S * 1e6)
            T = extrapolate_errors(pair, params, s.now_us)
        for k in range(2):
            pair.height_m[k], pair.climb_mps[k] = truth[k, 0], truth[k, 1]
            sd = np.sqrt(height_variance(pair, params, k))
            own = np.sqrt(sd * sd - ins_sd * ins_sd)
            noise = own * draws[i + 1, 3 + k] + ins_sd * draws[i + 1, 5]
            if FIRST_FAULTY <= i < LAST_FAULTY and faults[k] == NOISY:
                noise *= np.sqrt(factor)
            sensor = noise + (truth[k, 4] if k == IBI else 0.0)
            if FIRST_FAULTY <= i < LAST_FAULTY and faults[k] == BIASED:
                sensor += bias_m
            gather(pair, params, k, pair.height_m[k] - sensor)
        correct_errors(pair, params, s.now_us, T, False)
        for k in range(2):
            truth[k, 0], truth[k, 1] = pair.height_m[k], pair.climb_mps[k]
            errors[i, k], probability[i, k], variance[i, k] = (
                pair.height_m[k],
                pair.prob[k],
                pair.P[k, 0, 0],
            )
        ibi = share(pair.P[IBI], pair.P[IIG])
        errors[i, 2] = ibi * errors[i, IBI] + (1.0 - ibi) * errors[i, IIG]
        trust = pair.isolation.trust
        errors[i, 3] = errors[i, IBI if trust == TRUST_IBI else IIG if trust == TRUST_IIG else 2]


def open_loop_m(sigma_a: float, draws: Array) -> Array:
    """Height error of a channel that nobody corrects (3)-(6), (seeds, iterations)."""
    truth = draws[:, 0, :5] * np.array(START_SD)
    heights = np.zeros((draws.shape[0], draws.shape[1] - 1))
    for i in range(heights.shape[1]):
        height, climb, a, g = (
            truth[:, 0].copy(),
            truth[:, 1].copy(),
            truth[:, 2].copy(),
            truth[:, 3].copy(),
        )
        truth[:, 0] = height + T_D_S * climb
        truth[:, 1] = climb + T_D_S * (2.0 * G_MPS2 / (R_0_M + 1000.0) * height + a + g)
        truth[:, 2] += T_D_S * (sigma_a * draws[:, i, 0] - 0.001 * a)
        truth[:, 3] += T_D_S * (2e-5 * draws[:, i, 1] - 0.005 * g)
        heights[:, i] = truth[:, 0]
    return heights
