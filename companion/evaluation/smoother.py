"""The altitude after the fact: a fixed-interval smoother (Rauch, Tung and Striebel 1965) of
barometer and GNSS, with the barometer's error terms.

It is the reference where a log has no truth, and what ``replay --smooth`` gives. It is independent
of the estimators and of the IMU, which hardly helps height (0.07 to 0.6 m/s of climb only).

State at the nodes of a regular grid, and what each is
------------------------------------------------------
=====  ======================================================================================
h, v   altitude above mean sea level and climb; the climb wanders
b, d   offset of the barometer's height and its drift rate, which forgets itself
s      change of the barometer's error with height
k      static-port coefficient: the barometer reads high by k times the dynamic pressure head,
       from the airspeed, or the ground speed where there is none
c      change of the barometer's error with lift-off, in proportion to (V / 28 m/s)^2 up to 1
l      lag of the barometer: it reads what was l seconds ago
g      slow error of the GNSS height
e      fast error of the barometer, 1.2 m over a minute
=====  ======================================================================================

The priors are those that served four flights with precise truth (the project's notes on real
barometers): scale 5 %, k 0 +- 0.15, c 0 +- 8 m, lag 0 +- 1 s, fast error 1.2 m over 60 s. Noise of
the barometer has room for stamps that jitter. Both are given for means over five seconds: what a
real barometer errs within seconds is correlated, and taken as independent at every node it would
decide the coefficients.

A receiver's slow error is as large as it shows: it starts from the reported accuracy, and is
estimated again from the smoothed states `FITS` times. The weather of the session is the calmest of
`WEATHERS` under which that error is no larger than a receiver's can be. Breaks when GNSS lies for
minutes: one receiver and one barometer cannot tell who moved.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.evaluation.metrics import Array
from companion.kernels.arrays import baro_altitude_array, gnss_sd_array
from companion.kernels.rts import backward, forward
from companion.samples import Kind, SampleLog

STEP_S = 0.5
MOST_NODES = 100_000
"""14 hours; the steps of a longer session are longer"""
LONGEST_S = 1e6
"""eleven days; longer spans are clocks that jumped"""
UNKNOWN_GNSS_SD_M = 10.0
LONGEST_GAP_S = 60.0
"""no altitude inside longer gaps between measurements"""
H, V, B, D, S, K, C, L, G, E = range(10)
SIZE = 10
START_SD = {H: 15.0, V: 20.0, B: 300.0, S: 0.05, K: 0.15, C: 8.0, L: 1.0}
"""of the state before the first measurement; h has the receiver's slow error in addition, and d, g
and e have their own"""
CLIMB_PSD_M2PS3 = 10.0
"""spectral density of the vertical acceleration: a light aircraft's manoeuvre, 4.4 m/s2 for 2 s"""
WEATHERS = ((0.003, 1800.0), (0.03, 600.0), (0.25, 600.0))
"""(sd of the drift rate in m/s, its correlation time in s): calm; four times the worst hour of a
year of METARs; what no weather does, but a scripted one of a simulator"""
OFFSET_WALK = 0.02
"""m per square root of a second"""
SCALE_WALK = 2e-5
FAST_SD_M, FAST_S = 1.2, 60.0
LIFT_MPS = 28.0
GNSS_SLOW_S = 250.0
SLOW_SHARE, WHITE_SHARE = 0.8, 0.6
"""of the receiver's reported accuracy: how much of it is slow, how much is new at each node"""
FITS = 2
CREDIBLE_SD_M = 6.6
"""largest slow error of a receiver that reports less: 13 m (95 %), the global average that the GPS
Standard Positioning Service Performance Standard of 2020 allows"""
BARO_WHITE_M, JITTER_S, MEAN_S = 0.7, 0.3, 5.0
"""noise of a mean over `MEAN_S`: white, and for each metre per second of climb"""
PLAIN, RTK = (2.5, 0.6), (0.05, 0.05)
"""least slow error and least white noise (m) of a plain fix, and of an RTK one"""
RTK_FLOAT = 5
"""fix type from which a fix is an RTK one"""
FIRST_FIXES = 9
"""whose median is where the altitude begins"""
GATE = 5.0
"""innovations beyond this many standard deviations lose weight"""
SLOPE_NODES = 5
G0 = 9.80665


@dataclass(frozen=True)
class Measured:
    """What is smoothed: one barometer and one receiver with a fix. Times in microseconds of one
    clock; shape (n,), (m,) and (k,)."""

    baro_us: Array
    baro_m: Array
    """pressure altitude, geometric"""
    gnss_us: Array
    gnss_m: Array
    gnss_sd_m: Array
    """as the receiver reports it"""
    fix_type: Array
    ground_speed_mps: Array
    air_us: Array
    airspeed_mps: Array
    """calibrated; may be empty"""


def measured_of(log: SampleLog) -> Measured:
    """The first barometer, receiver and airspeed of a log."""
    baro, gnss, air = log[Kind.PRESSURE], log[Kind.GNSS], log[Kind.AIRSPEED]
    baro, air = (each[np.asarray(each["instance"]) == 0] for each in (baro, air))
    gnss = gnss[(np.asarray(gnss["instance"]) == 0) & (np.asarray(gnss["fix_type"]) >= 3)]
    return Measured(
        np.asarray(baro["time_us"], np.float64),
        baro_altitude_array(baro["pressure_pa"]),
        np.asarray(gnss["time_us"], np.float64),
        np.asarray(gnss["altitude_amsl_m"]),
        gnss_sd_array(gnss, 0.0, UNKNOWN_GNSS_SD_M),
        np.asarray(gnss["fix_type"], np.float64),
        np.asarray(gnss["ground_speed_mps"]),
        np.asarray(air["time_us"], np.float64),
        np.asarray(air["airspeed_mps"]),
    )


@dataclass(frozen=True)
class Smoothed:
    """Altitude with its standard deviation, and climb, at the nodes, shape (n,) each."""

    time_us: Array
    altitude_m: Array
    climb_mps: Array
    sd_m: Array

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
    step_s: float
    baro_m: Array
    gnss_m: Array
    gnss_sd_m: Array
    least_m: tuple[float, float]
    """least slow error and least white noise of the receiver"""
    speed_mps: Array
    """true airspeed, or the ground speed"""
    slope_mps: Array
    """of the barometer's height"""

    @property
    def first_m(self) -> float:
        """First height of the barometer."""
        return float(self.baro_m[np.isfinite(self.baro_m)][0])

    @property
    def claim_m(self) -> float:
        """What the receiver reports as its accuracy."""
        return float(np.median(self.gnss_sd_m[np.isfinite(self.gnss_m)]))


class _Pass(NamedTuple):
    """Smoothed means (n, s) and covariances (n, s, s)."""

    means: NDArray[Any]
    covariances: NDArray[Any]

    @property
    def slow_sd_m(self) -> float:
        """Root mean square of the receiver's slow error, what is unknown of it included."""
        return float(np.sqrt(np.mean(self.means[:, G] ** 2 + self.covariances[:, G, G])))


def smooth(measured: Measured) -> Smoothed | None:
    """The smoothed altitude; None without both a barometer and a GNSS receiver."""
    nodes = _nodes(measured)
    if nodes is None:
        return None
    means, covariances = _best(nodes)
    altitude_m = means[:, H].copy()
    altitude_m[_in_gap(nodes)] = np.nan
    sd_m = np.sqrt(np.maximum(covariances[:, H, H], 0.0))
    return Smoothed(nodes.time_s * 1e6, altitude_m, means[:, V], sd_m)


def _best(nodes: _Nodes) -> _Pass:
    """The smoother under the calmest weather with a receiver's error that is credible."""
    least_slow_m = nodes.least_m[0]
    credible_m = max(nodes.claim_m, CREDIBLE_SD_M * least_slow_m / PLAIN[0])
    for weather in WEATHERS:
        slow_sd_m = max(SLOW_SHARE * nodes.claim_m, least_slow_m)
        for _ in range(1 + FITS):
            found = _smoothed(nodes, weather, slow_sd_m)
            slow_sd_m = max(found.slow_sd_m, RTK[0])
        if slow_sd_m <= credible_m:
            break
    return found


def _nodes(measured: Measured) -> _Nodes | None:
    baro = np.isfinite(measured.baro_m)
    gnss = np.isfinite(measured.gnss_m)
    if baro.sum() < 2 or gnss.sum() < 2:
        return None
    times_us = np.concatenate([measured.baro_us[baro], measured.gnss_us[gnss]])
    start_s, span_s = times_us.min() * 1e-6, np.ptp(times_us) * 1e-6
    if span_s > LONGEST_S:
        return None
    step_s = max(STEP_S, span_s / MOST_NODES)
    time_s = start_s + step_s * np.arange(int(span_s / step_s) + 1)
    baro_m = _mean(measured.baro_m, measured.baro_us, time_s, step_s)
    known = np.isfinite(baro_m)
    filled_m = np.interp(time_s, time_s[known], baro_m[known])
    sd_m = _mean(measured.gnss_sd_m, measured.gnss_us, time_s, step_s)
    least_m = RTK if np.median(measured.fix_type[gnss]) >= RTK_FLOAT else PLAIN
    return _Nodes(
        time_s,
        step_s,
        baro_m,
        _mean(measured.gnss_m, measured.gnss_us, time_s, step_s),
        np.where(np.isfinite(sd_m), sd_m, UNKNOWN_GNSS_SD_M),
        least_m,
        _speed(measured, time_s, step_s, filled_m),
        _slope(filled_m, step_s),
    )


def _mean(values: Any, time_us: Any, time_s: Array, step_s: float) -> Array:
    """Mean of the values nearest to each node; NaN where there are none."""
    values, count = np.asarray(values, np.float64), time_s.size
    node = np.rint((np.asarray(time_us, np.float64) * 1e-6 - time_s[0]) / step_s).astype(np.int64)
    known = np.isfinite(values) & (node >= 0) & (node < count)
    total = np.bincount(node[known], values[known], count)
    with np.errstate(invalid="ignore"):
        return np.asarray(total / np.bincount(node[known], minlength=count))


def _speed(measured: Measured, time_s: Array, step_s: float, baro_m: Array) -> Array:
    """True airspeed where a calibrated one is known, else the ground speed, else 0."""
    density = np.maximum(0.1, (1.0 - 2.25577e-5 * baro_m)) ** 4.2559  # share of sea level's
    air = _mean(measured.airspeed_mps, measured.air_us, time_s, step_s) / np.sqrt(density)
    ground = _mean(measured.ground_speed_mps, measured.gnss_us, time_s, step_s)
    for speed in (air, ground):
        known = np.isfinite(speed)
        if np.any(speed[known] > 0.0):
            return np.interp(time_s, time_s[known], speed[known])
    return np.zeros(time_s.size)


def _slope(height_m: Array, step_s: float) -> Array:
    """Slope over `SLOPE_NODES`: the barometer's own noise must not be taken for climb."""
    if height_m.size < 2:
        return np.zeros(height_m.size)
    weights = np.full(SLOPE_NODES, 1.0 / SLOPE_NODES)
    padded = np.pad(np.gradient(height_m, step_s), SLOPE_NODES // 2, mode="edge")
    return np.convolve(padded, weights, mode="valid")


def _smoothed(nodes: _Nodes, weather: tuple[float, float], slow_sd_m: float) -> _Pass:
    """Filter forward over the nodes, then smooth backward."""
    count = nodes.time_s.size
    F, Q, x, P = _model(nodes, weather, slow_sd_m)
    h, R = np.zeros((count, 2, SIZE)), np.zeros((count, 2))
    h[:, 0, [H, G]] = 1.0
    h[:, 1, [H, B, E]] = 1.0
    h[:, 1, S] = np.nan_to_num(nodes.baro_m - nodes.first_m)
    h[:, 1, K] = nodes.speed_mps**2 / (2.0 * G0)
    h[:, 1, C] = np.minimum(1.0, (nodes.speed_mps / LIFT_MPS) ** 2)
    h[:, 1, L] = -nodes.slope_mps
    R[:, 0] = np.maximum(WHITE_SHARE * nodes.gnss_sd_m, nodes.least_m[1]) ** 2
    noise_m2 = BARO_WHITE_M**2 + (JITTER_S * nodes.slope_mps) ** 2
    R[:, 1] = noise_m2 * max(1.0, MEAN_S / nodes.step_s)
    z = np.stack([nodes.gnss_m, nodes.baro_m], axis=1)
    means, covariances = np.zeros((count, SIZE)), np.zeros((count, SIZE, SIZE))
    predicted, predicted_p = np.zeros_like(means), np.zeros_like(covariances)
    kept = (means, covariances, predicted, predicted_p)
    forward(F, Q, x, P, h, z, R, GATE, *kept, np.zeros((SIZE, SIZE)))
    backward(F, *kept, np.zeros((2, SIZE, SIZE)), np.zeros((SIZE, SIZE)))
    return _Pass(means, covariances)


def _model(
    nodes: _Nodes, weather: tuple[float, float], slow_sd_m: float
) -> tuple[Array, Array, Array, Array]:
    """Transition and process noise of one step; state and covariance before the first node."""
    step_s = nodes.step_s
    F, Q, x, P = np.eye(SIZE), np.zeros((SIZE, SIZE)), np.zeros(SIZE), np.zeros((SIZE, SIZE))
    for i, sd in START_SD.items():
        P[i, i] = sd**2
    for i, sd, time_s in ((D, *weather), (G, slow_sd_m, GNSS_SLOW_S), (E, FAST_SD_M, FAST_S)):
        F[i, i], P[i, i] = np.exp(-step_s / time_s), sd**2
        Q[i, i] = sd**2 * (1.0 - F[i, i] ** 2)
    P[H, H] += slow_sd_m**2
    F[H, V] = F[B, D] = step_s
    Q[H, H], Q[V, V] = CLIMB_PSD_M2PS3 * step_s**3 / 3.0, CLIMB_PSD_M2PS3 * step_s
    Q[H, V] = Q[V, H] = CLIMB_PSD_M2PS3 * step_s**2 / 2.0
    Q[B, B], Q[S, S] = OFFSET_WALK**2 * step_s, SCALE_WALK**2 * step_s
    x[H] = np.median(nodes.gnss_m[np.isfinite(nodes.gnss_m)][:FIRST_FIXES])
    x[B] = nodes.first_m - x[H]
    return F, Q, x, P


def _in_gap(nodes: _Nodes) -> NDArray[np.bool_]:
    """Whether a node lies in a gap of `LONGEST_GAP_S` without any measurement."""
    known = np.isfinite(nodes.baro_m) | np.isfinite(nodes.gnss_m)
    places = np.flatnonzero(known)
    after = places[np.minimum(np.searchsorted(places, np.arange(known.size)), places.size - 1)]
    before = places[np.maximum(np.searchsorted(places, np.arange(known.size), "right") - 1, 0)]
    return np.asarray((after - before) * nodes.step_s > LONGEST_GAP_S)
