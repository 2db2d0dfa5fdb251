"""Paper R's filter by other methods: an earth-fixed strapdown, batch least squares, Monte Carlo of
its own model."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from companion.estimators.baro_gnss_ins import METHOD
from companion.estimators.baro_gnss_ins.settings import BaroGnssInsSettings
from companion.estimators.baro_gnss_ins.strapdown import mechanise, set_attitude
from companion.estimators.method import run_log
from companion.kernels.atmosphere import geopotential_m, standard_pressure_pa
from companion.kernels.earth import ECCENTRICITY2, EQUATORIAL_RADIUS_M, ROTATION_RADPS, gravity_mps2
from companion.samples import Kind, SampleLog, sample

Array = NDArray[np.float64]
Signal = Callable[[float], Array]
State = tuple[Array, Array, Array]
"""place, velocity, matrix from body to earth-fixed axes"""

# An independent strapdown: earth-centred earth-fixed, direction cosines, Runge-Kutta.

SPIN = np.array([0.0, 0.0, ROTATION_RADPS])


def earth_fixed(latitude: float, longitude: float, height: float) -> Array:
    n = EQUATORIAL_RADIUS_M / math.sqrt(1.0 - ECCENTRICITY2 * math.sin(latitude) ** 2)
    level = (n + height) * math.cos(latitude)
    z = (n * (1.0 - ECCENTRICITY2) + height) * math.sin(latitude)
    return np.array([level * math.cos(longitude), level * math.sin(longitude), z])


def geodetic(place: Array) -> Array:
    """Latitude, longitude, height by fixed-point iteration."""
    level, longitude, latitude, height = (
        math.hypot(place[0], place[1]),
        math.atan2(place[1], place[0]),
        0.0,
        0.0,
    )
    latitude = math.atan2(place[2], level * (1.0 - ECCENTRICITY2))
    for _ in range(8):
        n = EQUATORIAL_RADIUS_M / math.sqrt(1.0 - ECCENTRICITY2 * math.sin(latitude) ** 2)
        height = level / math.cos(latitude) - n
        latitude = math.atan2(place[2], level * (1.0 - ECCENTRICITY2 * n / (n + height)))
    return np.array([latitude, longitude, height])


def to_earth(latitude: float, longitude: float) -> Array:
    """The matrix from north-east-down to earth-fixed axes."""
    sl, cl, so, co = (
        math.sin(latitude),
        math.cos(latitude),
        math.sin(longitude),
        math.cos(longitude),
    )
    return np.array([[-sl * co, -so, -cl * co], [-sl * so, co, -cl * so], [cl, 0.0, -sl]])


def rates(state: State, force: Array, rate: Array) -> State:
    place, velocity, mat = state
    latitude, longitude, height = geodetic(place)
    gravity = to_earth(latitude, longitude)[:, 2] * gravity_mps2(math.degrees(latitude), height)
    turn = mat.T @ SPIN  # the gyros see the Earth turn too
    x, y, z = rate - turn
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return velocity, mat @ force + gravity - 2.0 * np.cross(SPIN, velocity), mat @ skew


def integrate(start: State, force: Signal, rate: Signal, end_s: float, dt_s: float) -> State:
    """Classic Runge-Kutta; the matrix is made orthogonal again after every step."""
    state = start
    for tick in range(round(end_s / dt_s)):
        t, mid = tick * dt_s, (tick + 0.5) * dt_s
        k1 = rates(state, force(t), rate(t))
        k2 = rates(ahead(state, k1, dt_s / 2), force(mid), rate(mid))
        k3 = rates(ahead(state, k2, dt_s / 2), force(mid), rate(mid))
        k4 = rates(ahead(state, k3, dt_s), force(t + dt_s), rate(t + dt_s))
        for slope, weight in ((k1, 1.0), (k2, 2.0), (k3, 2.0), (k4, 1.0)):
            state = ahead(state, slope, weight * dt_s / 6.0)
        state = (state[0], state[1], Rotation.from_matrix(state[2]).as_matrix())
    return state


def ahead(state: State, slope: State, dt_s: float) -> State:
    place, velocity, mat = (a + dt_s * b for a, b in zip(state, slope, strict=True))
    return place, velocity, mat


def weaving_force(t: float) -> Array:
    return np.array([1.5 + np.sin(0.9 * t), 2.0 * np.cos(0.7 * t), -9.6 - 1.5 * np.sin(0.5 * t)])


def weaving_rate(t: float) -> Array:
    return np.array([0.5 * np.cos(1.1 * t), 0.12 * np.sin(0.8 * t), 0.15 + 0.05 * np.cos(0.3 * t)])


def mean_over(signal: Signal, start_s: float, dt_s: float) -> Array:
    """What an integrating sensor says: the mean by Gauss-Legendre quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    times = start_s + dt_s / 2 * (1.0 + nodes)
    return np.asarray(sum(w * signal(t) for w, t in zip(weights, times, strict=True)) / 2.0)


@pytest.mark.parametrize(
    ("rate_hz", "position_m", "velocity_mps"), [(50, 0.05, 0.01), (200, 0.005, 0.001)]
)
def test_mechanisation_against_an_earth_fixed_one(
    rate_hz: int, position_m: float, velocity_mps: float
) -> None:
    """Twenty seconds of weaving and rolling at 100 m/s: the difference is coning and sculling,
    second order in dt."""
    latitude, longitude, height = math.radians(47.0), math.radians(8.0), 1000.0
    angles, vec_n, end_s = (0.2, 0.1, 1.0), np.array([60.0, 80.0, -3.0]), 20.0
    axes = to_earth(latitude, longitude)
    start = (
        earth_fixed(latitude, longitude, height),
        axes @ vec_n,
        axes @ Rotation.from_euler("ZYX", angles[::-1]).as_matrix(),
    )
    place, velocity, mat = integrate(start, weaving_force, weaving_rate, end_s, 0.02)
    position, speed, quaternion, scratch = (
        np.array([latitude, longitude, height]),
        vec_n.copy(),
        np.empty(4),
        np.empty((4, 3)),
    )
    set_attitude(quaternion, *angles)
    for tick in range(round(end_s * rate_hz)):
        t, dt_s = tick / rate_hz, 1.0 / rate_hz
        mechanise(
            position,
            speed,
            quaternion,
            mean_over(weaving_force, t, dt_s),
            mean_over(weaving_rate, t, dt_s),
            dt_s,
            scratch,
        )
    found = earth_fixed(position[0], position[1], position[2])
    axes = to_earth(position[0], position[1])
    assert np.linalg.norm(found - place) < position_m
    assert np.linalg.norm(axes @ speed - velocity) < velocity_mps
    ours = axes @ Rotation.from_quat([*quaternion[1:], quaternion[0]]).as_matrix()
    assert Rotation.from_matrix(ours.T @ mat).magnitude() < velocity_mps / 10.0


# The linear part: height, climb, b and s without an IMU.


@pytest.mark.parametrize(
    ("scale_sd", "estimate_sds", "spread"),
    [(1e-7, 1e-5, 1e-5), (0.04, 0.25, 0.08)],
    ids=["linear", "with the scale factor, whose row is held for 10 m"],
)
def test_vertical_filter_is_batch_least_squares(
    scale_sd: float, estimate_sds: float, spread: float
) -> None:
    """Every pressure, fix, prior and random acceleration of two minutes at once, each divided by
    its spread."""
    settings = BaroGnssInsSettings(
        baro_walk_m_rts=0.2,
        baro_scale_sd_ratio=scale_sd,
        baro_scale_walk_rts=1e-9 if scale_sd < 1e-6 else 1e-4,
        gnss_correlation_s=0.0,
        coast_noise_mps2_rthz=0.4,
    )
    random, log, n = np.random.default_rng(3), SampleLog(), 120
    s = min(0.02, scale_sd)
    heights = 500.0 + 3.0 * np.arange(n) + 5.0 * np.sin(np.arange(n) / 9.0)
    exact = (heights - 20.0) / (1.0 + s)
    h_p, fixes = exact + 0.7 * random.normal(size=n), heights + 3.0 * random.normal(size=n)
    for i in range(n):
        pressure_pa, time_us = standard_pressure_pa(geopotential_m(h_p[i])), (i + 1) * 1_000_000
        log.append(
            Kind.PRESSURE, sample(Kind.PRESSURE, time_us, pressure_pa=pressure_pa, suspect=0)
        )
        log.append(
            Kind.GNSS,
            sample(Kind.GNSS, time_us, altitude_amsl_m=fixes[i], vertical_sd_m=3.0, fix_type=3),
        )
    state = run_log(METHOD, log, settings)[2][0]

    # Unknowns: (h, climb, b, s) at every second.
    rows: list[Array] = []
    wanted: list[float] = []

    def add(entries: dict[int, float], value: float, sd: float) -> None:
        row = np.zeros(4 * n)
        for index, factor in entries.items():
            row[index] = factor / sd
        rows.append(row)
        wanted.append(value / sd)

    for index, prior, sd in ((0, h_p[0], 1e4), (1, 0.0, 10.0), (2, 0.0, 100.0), (3, 0.0, scale_sd)):
        add({index: 1.0}, prior, sd)
    Q = settings.coast_noise_mps2_rthz**2
    root = np.linalg.cholesky(np.linalg.inv(Q * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]]))).T
    for i in range(n):
        h, climb, b, scale = range(4 * i, 4 * i + 4)
        add({h: -1.0, b: 1.0, scale: exact[i]}, -h_p[i], settings.baro_sd_m)
        add({h: 1.0}, fixes[i], 3.0)
        if i + 1 < n:
            for moved, sped in root:
                add({h + 4: moved, h: -moved, climb + 4: sped, climb: -moved - sped}, 0.0, 1.0)
            add({b + 4: 1.0, b: -1.0}, 0.0, settings.baro_walk_m_rts)
            add({scale + 4: 1.0, scale: -1.0}, 0.0, settings.baro_scale_walk_rts)
    inverse = np.linalg.pinv(np.array(rows))
    solution, spreads = (inverse @ np.array(wanted))[-4:], np.linalg.norm(inverse[-4:], axis=1)
    ours = [
        state["ins"]["position"][2],
        -state["ins"]["velocity_n_mps"][2],
        state["ins"]["b_m"],
        state["ins"]["s"],
    ]
    for i, index in enumerate((2, 5, 15, 16)):
        assert ours[i] == pytest.approx(solution[i], abs=estimate_sds * spreads[i] + 1e-9)
        assert math.sqrt(state["ins"]["P"][index, index]) == pytest.approx(spreads[i], rel=spread)


@pytest.mark.slow
def test_normalised_errors_of_a_matched_model() -> None:
    """White errors as the filter assumes them, random-walking b and s: height, climb and b, s are
    as good as P says."""
    settings = BaroGnssInsSettings(
        baro_walk_m_rts=0.1,
        baro_scale_sd_ratio=0.02,
        baro_scale_walk_rts=1e-5,
        baro_bias_sd_m=30.0,
        gnss_correlation_s=0.0,
        gnss_correlated_ratio=0.0,
        coast_noise_mps2_rthz=0.2,
    )
    squares = []
    for seed in range(150):
        random, log, n = np.random.default_rng([7, seed]), SampleLog(), 300
        climb = np.cumsum(0.2 * random.normal(size=n))
        h = 4000.0 + np.cumsum(climb)
        b = 30.0 * random.normal() + np.cumsum(0.1 * random.normal(size=n))
        s = 0.02 * random.normal() + np.cumsum(1e-5 * random.normal(size=n))
        for i in range(n):
            pressure_pa = standard_pressure_pa(
                geopotential_m((h[i] - b[i]) / (1.0 + s[i]) + random.normal())
            )
            time_us = (i + 1) * 1_000_000
            log.append(
                Kind.PRESSURE, sample(Kind.PRESSURE, time_us, pressure_pa=pressure_pa, suspect=0)
            )
            fix_m = h[i] + 3.0 * random.normal()
            log.append(
                Kind.GNSS,
                sample(Kind.GNSS, time_us, altitude_amsl_m=fix_m, vertical_sd_m=3.0, fix_type=3),
            )
        state = run_log(METHOD, log, settings)[2][0]
        error = np.array(
            [
                h[-1] - state["ins"]["position"][2],
                b[-1] - state["ins"]["b_m"],
                s[-1] - state["ins"]["s"],
            ]
        )
        kept = np.ix_([2, 15, 16], [2, 15, 16])
        sign = np.diag([-1.0, 1.0, 1.0])  # the error state counts downwards
        squares.append(
            error @ np.linalg.solve(sign @ np.asarray(state["ins"]["P"])[kept] @ sign, error)
        )
    # Mean of 150 chi-square variables of three degrees: 3 +- 0.2 (one sigma).
    assert 2.4 < np.mean(squares) < 3.6
