"""The altitude after the fact: a fixed-interval smoother (Rauch, Tung and Striebel 1965) of
barometer and GNSS, with the barometer's error terms.

It is the reference where a log has no truth, and what ``replay --smooth`` gives. It is independent
of the estimators and of the IMU, which hardly helps height (0.07 to 0.6 m/s of climb only).

State at the nodes of a regular grid, and what each is
------------------------------------------------------
=====  ======================================================================================
h, v   altitude above mean sea level and climb; the climb wanders
b, d   offset of the barometer's height and its drift rate, which forgets itself in half an hour
s      change of the barometer's error with height
k      static-port coefficient: the barometer reads high by k times the dynamic pressure head,
       taken from the ground speed
l      lag of the barometer: it reads what was l seconds ago
g      slow error of the GNSS height
e      fast error of the barometer, 1.2 m over a minute
=====  ======================================================================================

The priors are those that served four flights with precise truth (the project's notes on real
barometers): scale 5 %, k 0 +- 0.15, lag 0 +- 0.5 s, drift 0.001 to 0.05 m/s over 1800 s, fast error
1.2 m over 60 s. White noise has room for stamps that jitter: 0.3 s of climb. The drift of the
session, calm to stormy, is the one of `WEATHERS` that makes its innovations most likely. Breaks
when GNSS lies for minutes: one receiver and one barometer cannot tell who moved.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.evaluation.metrics import Array
from companion.kernels.arrays import baro_altitude_array
from companion.kernels.rts import backward, forward
from companion.samples import Kind, SampleLog

STEP_S = 0.5
MOST_NODES = 2_000_000
"""eleven days; longer spans are clocks that jumped"""
UNKNOWN_GNSS_SD_M = 10.0
LONGEST_GAP_S = 60.0
"""no altitude inside longer gaps between measurements"""
H, V, B, D, S, K, L, G, E = range(9)
SIZE = 9
START_SD = (15.0, 20.0, 300.0, 0.0, 0.05, 0.15, 0.5, 0.0, 1.2)
"""of the state before the first measurement; that of d and g depends on the session"""
CLIMB_WALK = 1.0
"""m/s per square root of a second"""
WEATHERS = ((0.001, 0.02, 2e-5), (0.01, 0.1, 2e-4), (0.05, 0.3, 6e-4))
"""(sd of the drift rate in m/s, walk of the offset in m per square root of a second, walk of the
scale per square root of a second); the session's is the one under which its innovations are most
likely"""
DRIFT_S = 1800.0
FAST_SD_M, FAST_S = 1.2, 60.0
GNSS_SLOW_S = 250.0
SLOW_SHARE, WHITE_SHARE = 0.8, 0.6
"""of the receiver's reported accuracy: how much of it is slow, how much is new each second"""
BARO_WHITE_M, JITTER_S = 0.7, 0.3
LEAST_GNSS_SD_M = 1.0
FIRST_FIXES = 9
"""whose median is where the altitude begins"""
GATE = 5.0
"""innovations beyond this many standard deviations lose weight"""
G0 = 9.80665


@dataclass(frozen=True)
class Measured:
    """What is smoothed: one barometer and one receiver with a fix. Times in microseconds of one
    clock; shape (n,) and (m,)."""

    baro_us: Array
    baro_m: Array
    """pressure altitude, geometric"""
    gnss_us: Array
    gnss_m: Array
    gnss_sd_m: Array
    """as the receiver reports it"""
    ground_speed_mps: Array


def measured_of(log: SampleLog) -> Measured:
    """The first barometer and the first receiver of a log."""
    baro, gnss = log[Kind.PRESSURE], log[Kind.GNSS]
    baro = baro[np.asarray(baro["instance"]) == 0]
    gnss = gnss[(np.asarray(gnss["instance"]) == 0) & (np.asarray(gnss["fix_type"]) >= 3)]
    sd, vdop, hdop = (np.asarray(gnss[name]) for name in ("vertical_sd_m", "vdop", "hdop"))
    told_m = np.where(vdop > 0, 2.5 * vdop, np.where(hdop > 0, 5.0 * hdop, UNKNOWN_GNSS_SD_M))
    return Measured(
        np.asarray(baro["time_us"], np.float64),
        baro_altitude_array(baro["pressure_pa"]),
        np.asarray(gnss["time_us"], np.float64),
        np.asarray(gnss["altitude_amsl_m"]),
        np.where(sd > 0, sd, told_m),
        np.asarray(gnss["ground_speed_mps"]),
    )


@dataclass(frozen=True)
class Smoothed:
    """Altitude, climb and their standard deviations at the nodes, shape (n,) each."""

    time_us: Array
    altitude_m: Array
    climb_mps: Array
    sd_m: Array
    climb_sd_mps: Array
    offset_m: Array
    """of the barometer: what it reads too high, without scale, port and lag"""

    def at(self, time_us: Array) -> Array:
        """Altitude at other times, shape of `time_us`; NaN outside the nodes."""
        return np.interp(time_us, self.time_us, self.altitude_m, left=np.nan, right=np.nan)

    def sd_at(self, time_us: Array) -> Array:
        """Standard deviation at other times."""
        return np.interp(time_us, self.time_us, self.sd_m, left=np.nan, right=np.nan)


@dataclass(frozen=True)
class _Nodes:
    """Measurements on the grid; NaN where a node has none."""

    time_s: Array
    baro_m: Array
    baro_count: Array
    gnss_m: Array
    gnss_sd_m: Array
    head_m: Array
    """dynamic pressure head V^2 / 2g"""
    rate_mps: Array
    """change of the barometer's height"""


class _Pass(NamedTuple):
    """A filter over the nodes: means and covariances after and before each update."""

    log_likelihood: float
    F: Array
    means: NDArray[Any]
    covariances: NDArray[Any]
    predicted: NDArray[Any]
    predicted_p: NDArray[Any]


def smooth(measured: Measured) -> Smoothed | None:
    """The smoothed altitude; None without both a barometer and a GNSS receiver."""
    nodes = _nodes(measured)
    if nodes is None:
        return None
    passes = [_forward(nodes, weather) for weather in WEATHERS]
    best = max(passes, key=lambda each: each.log_likelihood)
    means, covariances = best.means, best.covariances
    scratch = np.zeros((2, SIZE, SIZE)), np.zeros((SIZE, SIZE))
    backward(best.F, means, covariances, best.predicted, best.predicted_p, *scratch)
    altitude_m = means[:, H].copy()
    altitude_m[_in_gap(nodes)] = np.nan
    spread = np.sqrt(np.maximum(covariances[:, [H, V], [H, V]], 0.0))
    return Smoothed(
        nodes.time_s * 1e6, altitude_m, means[:, V], spread[:, 0], spread[:, 1], means[:, B]
    )


def _nodes(measured: Measured) -> _Nodes | None:
    baro = np.isfinite(measured.baro_m)
    gnss = np.isfinite(measured.gnss_m)
    if baro.sum() < 2 or gnss.sum() < 2:
        return None
    times_us = np.concatenate([measured.baro_us[baro], measured.gnss_us[gnss]])
    start_s, end_s = times_us.min() * 1e-6, times_us.max() * 1e-6
    count = int((end_s - start_s) / STEP_S) + 1
    if count > MOST_NODES:
        return None
    time_s = start_s + STEP_S * np.arange(count)
    baro_m, baro_count = _mean(measured.baro_m, measured.baro_us, start_s, count)
    gnss_m, _ = _mean(measured.gnss_m, measured.gnss_us, start_s, count)
    gnss_sd_m, _ = _mean(measured.gnss_sd_m, measured.gnss_us, start_s, count)
    speed, _ = _mean(measured.ground_speed_mps, measured.gnss_us, start_s, count)
    known = np.isfinite(speed)
    speed = np.interp(time_s, time_s[known], speed[known]) if known.any() else np.zeros(count)
    known = np.isfinite(baro_m)
    filled_m = np.interp(time_s, time_s[known], baro_m[known])
    rate_mps = np.gradient(filled_m, STEP_S) if count > 1 else np.zeros(count)
    return _Nodes(time_s, baro_m, baro_count, gnss_m, gnss_sd_m, speed**2 / (2 * G0), rate_mps)


def _mean(values: Any, time_us: Any, start_s: float, count: int) -> tuple[Array, Array]:
    """Mean and number of the values nearest to each node; NaN where there are none."""
    values = np.asarray(values, np.float64)
    node = np.rint((np.asarray(time_us, np.float64) * 1e-6 - start_s) / STEP_S).astype(np.int64)
    known = np.isfinite(values) & (node >= 0) & (node < count)
    total = np.bincount(node[known], values[known], count)
    number = np.bincount(node[known], minlength=count).astype(np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        return total / number, number


def _forward(nodes: _Nodes, weather: tuple[float, float, float]) -> _Pass:
    """The Kalman filter over the nodes."""
    count = nodes.time_s.size
    F, Q = _model(weather)
    sd = np.maximum(np.where(np.isfinite(nodes.gnss_sd_m), nodes.gnss_sd_m, 0), LEAST_GNSS_SD_M)
    slow_sd_m = SLOW_SHARE * float(np.median(sd[np.isfinite(nodes.gnss_m)]))
    Q[G, G] = slow_sd_m**2 * (1 - F[G, G] ** 2)
    baro0 = nodes.baro_m[np.isfinite(nodes.baro_m)][0]
    x = np.zeros(SIZE)
    x[H] = np.median(nodes.gnss_m[np.isfinite(nodes.gnss_m)][:FIRST_FIXES])
    x[B] = baro0 - x[H]
    P = np.diag(np.square(START_SD))
    P[D, D], P[G, G] = weather[0] ** 2, slow_sd_m**2
    h, R = np.zeros((count, 2, SIZE)), np.zeros((count, 2))
    h[:, 0, [H, G]] = 1.0
    h[:, 1, [H, B, E]] = 1.0
    h[:, 1, S] = np.nan_to_num(nodes.baro_m - baro0)
    h[:, 1, K], h[:, 1, L] = nodes.head_m, -nodes.rate_mps
    R[:, 0] = (WHITE_SHARE * sd) ** 2
    R[:, 1] = BARO_WHITE_M**2 + (JITTER_S * nodes.rate_mps) ** 2
    z = np.stack([nodes.gnss_m, nodes.baro_m], axis=1)
    means, covariances = np.zeros((count, SIZE)), np.zeros((count, SIZE, SIZE))
    predicted, predicted_p = np.zeros_like(means), np.zeros_like(covariances)
    kept = (means, covariances, predicted, predicted_p)
    log_likelihood = forward(F, Q, x, P, h, z, R, GATE, *kept, np.zeros((SIZE, SIZE)))
    return _Pass(log_likelihood, F, *kept)


def _model(weather: tuple[float, float, float]) -> tuple[Array, Array]:
    """Transition and process noise of one step."""
    drift_sd_mps, offset_walk, scale_walk = weather
    F, Q = np.eye(SIZE), np.zeros((SIZE, SIZE))
    F[H, V] = STEP_S
    F[B, D] = STEP_S
    F[D, D] = np.exp(-STEP_S / DRIFT_S)
    F[G, G] = np.exp(-STEP_S / GNSS_SLOW_S)
    F[E, E] = np.exp(-STEP_S / FAST_S)
    Q[E, E] = FAST_SD_M**2 * (1 - F[E, E] ** 2)
    q = CLIMB_WALK**2
    Q[H, H], Q[V, V] = q * STEP_S**3 / 3, q * STEP_S
    Q[H, V] = Q[V, H] = q * STEP_S**2 / 2
    Q[B, B] = offset_walk**2 * STEP_S
    Q[D, D] = drift_sd_mps**2 * (1 - F[D, D] ** 2)
    Q[S, S] = scale_walk**2 * STEP_S
    return F, Q


def _in_gap(nodes: _Nodes) -> NDArray[np.bool_]:
    """Whether a node lies in a gap of `LONGEST_GAP_S` without any measurement."""
    known = np.isfinite(nodes.baro_m) | np.isfinite(nodes.gnss_m)
    places = np.flatnonzero(known)
    after = places[np.minimum(np.searchsorted(places, np.arange(known.size)), places.size - 1)]
    before = places[np.maximum(np.searchsorted(places, np.arange(known.size), "right") - 1, 0)]
    return np.asarray((after - before) * STEP_S > LONGEST_GAP_S)
