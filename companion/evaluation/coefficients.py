"""Error coefficients of a barometer from flights: static port, thrust and temperature.

Generalised least squares of the pressure error y = (reference - barometer height) * weight of the
air, in pascals, on nodes of a regular grid:

    y = c_0 + s h + l v + lift + sum_a k_a q_a + c_t throttle + c_T (T - 25 degC) + noise

s (column), l (lag), the lift-off error and, without an airspeed, two terms of the wind have priors
and are not reported. The reference is GNSS; while the vehicle rests on the ground its height is one
number, so a rest is one GNSS mean. The noise has a full covariance: weather and fast error of the
barometer, slow and white error of the receiver. Which of the `WEATHERS`, how large the fast error
and how much of the receiver's reported accuracy count is chosen by restricted maximum likelihood.
Sessions add up their information about the coefficients.

A coefficient is shown by the flights when its standard deviation is within a tenth of it, or small
enough to matter nowhere. Breaks when something else goes with the same quantity: an error of lift
is counted as static port where the vehicle is never much faster than it lifts off.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from companion.evaluation.metrics import Array
from companion.evaluation.smoother import FAST_S, GNSS_SLOW_S, SLOW_SHARE, WHITE_SHARE

PORTS = ("forward", "backward", "right", "left")
"""the static-port coefficients, in the order of `Flight.heads_pa`"""
SHARED = (*PORTS, "thrust", "thermal")
PRIOR_SD = (2.0, 2.0, 2.0, 2.0, 1000.0, 50.0)
"""of the coefficients, far beyond any real one"""
SMALL_SD = (0.015, 0.015, 0.015, 0.015, 8.0, 0.15)
"""a standard deviation that matters nowhere: 1.5 % of dynamic pressure, 8 Pa, 0.15 Pa/K"""
RELATIVE_SD = 0.1
SEEN_SIGMA = 3.0
CONSTANT_PA, COLUMN_SD, LAG_SD_S, LIFT_SD_M, WIND_SD_MPS = 2e4, 0.05, 0.5, 8.0, 3.0
"""priors of what is not reported"""
LIFT_MPS, MUCH_FASTER_MPS = 28.0, 40.0
WEATHERS = ((0.001, 0.02, 2e-5), (0.01, 0.1, 2e-4), (0.05, 0.3, 6e-4))
"""(sd of the drift rate in m/s, walk of the offset in m per square root of a second, walk of the
scale per square root of a second)"""
DRIFT_S = 1800.0
FAST_SD_M = (0.4, 1.2)
BARO_WHITE_M, WHITE_S, JITTER_S = 0.7, 0.5, 0.3
"""noise of a mean of the barometer's heights over `WHITE_S`, and of its stamps"""
LEAST_GNSS_SD_M = 1.0
CLAIM_SHARES = (0.3, 0.6, 1.0)
"""how much of the receiver's reported accuracy its errors have"""
COLUMN_JITTER_S = 0.5
"""how well throttle, airspeed and barometer, of messages without stamps, are placed in time"""
OUTLIER_SIGMA = 5.0
LEAST_NODES = 30
REFERENCE_K = 298.15
LEAST_SPANS = {"port": 100.0, "thrust": 0.2, "thermal": 3.0}
"""least spread of dynamic pressure (Pa), throttle (share) and temperature (K) to speak of"""


@dataclass(frozen=True)
class Flight:
    """One session on a grid of nodes, shape (n,) each; NaN unknown."""

    time_s: Array
    baro_m: Array
    gnss_m: Array
    gnss_sd_m: Array
    weight_pa_per_m: Array
    """of the air: what a metre of height is in pascals"""
    climb_mps: Array
    heads_pa: Array
    """dynamic pressure along each of `PORTS`, shape (4, n); NaN where the log does not tell"""
    velocity_mps: Array
    """north and east times density, for the terms of the wind, shape (2, n); 0 with an airspeed"""
    throttle: Array
    die_k: Array
    rests: list[tuple[int, int]]
    """[first, end) nodes of each rest on the ground"""


@dataclass(frozen=True)
class Coefficient:
    """What the flights say about one coefficient."""

    name: str
    value: float
    sd: float
    refused: str = ""
    """why the flights do not show it; empty when they do"""

    @property
    def is_seen(self) -> bool:
        """Whether it differs from zero."""
        return not self.refused and abs(self.value) > SEEN_SIGMA * self.sd


@dataclass
class _Information:
    """Sum over sessions of what they say about `SHARED`."""

    matrix: Array = field(default_factory=lambda: np.diag(1.0 / np.square(PRIOR_SD)))
    vector: Array = field(default_factory=lambda: np.zeros(len(SHARED)))


def coefficients(flights: Sequence[Flight]) -> list[Coefficient]:
    """The coefficients `SHARED` from the sessions of one vehicle."""
    total = _Information()
    for flight in flights:
        _add(total, flight)
    covariance = np.linalg.inv(total.matrix)
    values, spread = covariance @ total.vector, np.sqrt(np.diag(covariance))
    found = []
    for i, name in enumerate(SHARED):
        value, sd = float(values[i]), float(spread[i])
        shown = sd <= max(RELATIVE_SD * abs(value), SMALL_SD[i])
        found.append(Coefficient(name, value, sd, "" if shown else _reason(i, sd, flights)))
    return found


def _reason(index: int, sd: float, flights: Sequence[Flight]) -> str:
    """Why a coefficient is not shown."""
    name = SHARED[index]
    series = [_column(flight, index) for flight in flights]
    spans = [float(np.nanmax(each) - np.nanmin(each)) for each in series if np.isfinite(each).any()]
    kind, missing, unit, text = {
        "thrust": (
            "thrust",
            "no throttle in the log",
            100.0,
            "the throttle moves by {:.0f} % only",
        ),
        "thermal": (
            "thermal",
            "no temperature of the barometer in the log",
            1.0,
            "the barometer's temperature moves by {:.1f} K only",
        ),
    }.get(name, ("port", "", 1.0, f"too little flight {name}: dynamic pressure of {{:.0f}} Pa"))
    if not spans:
        return missing or f"no airspeed and no GNSS speed {name} in the log"
    if max(spans) < LEAST_SPANS[kind]:
        return text.format(unit * max(spans))
    size = {"thrust": f"{sd:.0f} Pa", "thermal": f"{sd:.1f} Pa/K"}.get(name, f"{sd:.2f}")
    return (
        f"known to +-{size} only: it cannot be told from weather, GNSS errors and the other terms"
    )


def _column(flight: Flight, index: int) -> Array:
    """The regressor of a coefficient."""
    if index < len(PORTS):
        return flight.heads_pa[index]
    return flight.throttle if SHARED[index] == "thrust" else flight.die_k - REFERENCE_K


def _add(total: _Information, flight: Flight) -> None:
    """Add what one session says."""
    y = (flight.gnss_m - flight.baro_m) * flight.weight_pa_per_m
    for first, end in flight.rests:
        gnss_m = np.nanmean(flight.gnss_m[first:end]) if end > first else math.nan
        y[first:end] = (gnss_m - flight.baro_m[first:end]) * flight.weight_pa_per_m[first:end]
    own, prior_sd = _nuisance(flight)
    shared = np.stack([np.nan_to_num(_column(flight, i)) for i in range(len(SHARED))], axis=1)
    X = np.concatenate([shared, own], axis=1)
    known = np.isfinite(y) & np.isfinite(X).all(axis=1)
    precision = np.concatenate([np.zeros(len(SHARED)), 1.0 / np.square(prior_sd)])
    late_pa = JITTER_S * flight.climb_mps * flight.weight_pa_per_m
    for _ in range(2):
        if known.sum() < LEAST_NODES:
            return
        A, b, residual, variance = _best_fit(flight, X, y, known, precision, np.square(late_pa))
        known[np.flatnonzero(known)[np.square(residual) > OUTLIER_SIGMA**2 * variance]] = False
        changes = np.gradient(X, flight.time_s, axis=0) @ np.linalg.solve(A, b)
        late_pa = COLUMN_JITTER_S * changes
    n = len(SHARED)
    gain = np.linalg.solve(A[n:, n:], A[n:, :n]).T
    total.matrix += A[:n, :n] - gain @ A[n:, :n]
    total.vector += b[:n] - gain @ b[n:]


def _nuisance(flight: Flight) -> tuple[Array, Array]:
    """Regressors that are not reported, and their priors."""
    weight = flight.weight_pa_per_m
    columns = [
        (np.ones(weight.size), CONSTANT_PA),
        (np.nan_to_num(flight.baro_m - np.nanmean(flight.baro_m)) * weight, COLUMN_SD),
        (np.nan_to_num(flight.climb_mps) * weight, LAG_SD_S),
        (flight.velocity_mps[0], WIND_SD_MPS),
        (flight.velocity_mps[1], WIND_SD_MPS),
    ]
    head_pa = np.nan_to_num(flight.heads_pa).sum(axis=0)
    if np.max(head_pa, initial=0.0) > 0.6125 * MUCH_FASTER_MPS**2:
        lifted = np.minimum(1.0, head_pa / (0.6125 * LIFT_MPS**2))
        columns.append((lifted * weight, LIFT_SD_M))
    return np.stack([np.nan_to_num(each) for each, _ in columns], axis=1), np.array(
        [sd for _, sd in columns]
    )


def _best_fit(
    flight: Flight,
    X: Array,
    y: Array,
    known: NDArray[np.bool_],
    precision: Array,
    late_pa2: Array,
) -> tuple[Array, Array, Array, Array]:
    """Information matrix and vector, residuals and their variances, under the most likely noise."""
    best = -math.inf
    for V in _covariances(flight):
        part = V[np.ix_(known, known)] + np.diag(late_pa2[known])
        root = np.linalg.cholesky(part)
        white = np.linalg.solve(root, np.column_stack([X[known], y[known]]))
        A = white[:, :-1].T @ white[:, :-1] + np.diag(precision + 1e-12)
        b = white[:, :-1].T @ white[:, -1]
        mean = np.linalg.solve(A, b)
        value = -0.5 * float(white[:, -1] @ white[:, -1] - b @ mean)
        value -= float(np.log(np.diag(root)).sum()) + 0.5 * float(np.linalg.slogdet(A)[1])
        if value > best:
            best = value
            chosen = A, b, y[known] - X[known] @ mean, np.diag(part).copy()
    return chosen


def _covariances(flight: Flight) -> Iterator[Array]:
    """Candidates of the covariance of y."""
    time_s = flight.time_s - flight.time_s[0]
    apart_s = np.abs(time_s[:, None] - time_s[None, :])
    weight = flight.weight_pa_per_m[:, None] * flight.weight_pa_per_m[None, :]
    fast = np.exp(-apart_s / FAST_S)
    gnss = _receiver(flight, apart_s)
    white_m2 = BARO_WHITE_M**2 * WHITE_S / float(np.median(np.diff(time_s)))
    for drift_sd_mps, offset_walk, scale_walk in WEATHERS:
        weather = _weather(time_s, drift_sd_mps, offset_walk)
        height_m = np.nan_to_num(flight.baro_m - np.nanmean(flight.baro_m))
        since_s = np.minimum(time_s[:, None], time_s[None, :])
        weather += scale_walk**2 * since_s * height_m[:, None] * height_m[None, :]
        for fast_sd_m in FAST_SD_M:
            barometer = weather + fast_sd_m**2 * fast + np.diag(np.full(time_s.size, white_m2))
            for share in CLAIM_SHARES:
                yield weight * (barometer + share**2 * gnss)


def _receiver(flight: Flight, apart_s: Array) -> Array:
    """Covariance of the GNSS height at its reported accuracy; one mean over each rest."""
    sd = np.maximum(np.nan_to_num(flight.gnss_sd_m, nan=LEAST_GNSS_SD_M), LEAST_GNSS_SD_M)
    slow_m2 = (SLOW_SHARE * float(np.median(sd))) ** 2
    step_s = float(np.median(np.diff(flight.time_s)))
    cov = slow_m2 * np.exp(-apart_s / GNSS_SLOW_S) + np.diag((WHITE_SHARE * sd) ** 2 / step_s)
    for first, end in flight.rests:
        cov[first:end] = cov[first:end].mean(axis=0)
        cov[:, first:end] = cov[:, first:end].mean(axis=1, keepdims=True)
    return np.asarray(cov)


def _weather(time_s: Array, drift_sd_mps: float, walk: float) -> Array:
    """Covariance of the barometer's slow error: integrated Gauss-Markov drift and a random walk."""
    t, u = time_s[:, None], time_s[None, :]
    early, tau = np.minimum(t, u), DRIFT_S
    drift = (
        2.0 * early / tau - 1.0 + np.exp(-t / tau) + np.exp(-u / tau) - np.exp(-np.abs(t - u) / tau)
    )
    return np.asarray((drift_sd_mps * tau) ** 2 * drift + walk**2 * early)
