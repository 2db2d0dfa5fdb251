"""The inertial mechanisation and its error model: rotations, rest, and the transition against
numeric derivatives."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from companion.estimators.baro_gnss_ins.strapdown import (
    ERRORS,
    FORCE_BIAS,
    POSITION,
    RATE_BIAS,
    TILT,
    VELOCITY,
    mat_from_quaternion,
    mechanise,
    move,
    set_attitude,
    tilt_between,
    transition,
    turn_body,
    turn_frame,
    wrapped,
    yaw_rad,
)
from companion.kernels.earth import ROTATION_RADPS, gravity_mps2, meridian_radius_m, normal_radius_m

Array = NDArray[np.float64]


def rotation(quaternion: Array) -> Rotation:
    return Rotation.from_quat([*quaternion[1:], quaternion[0]])


def attitude(roll: float, pitch: float, yaw: float) -> Array:
    quaternion = np.empty(4)
    set_attitude(quaternion, roll, pitch, yaw)
    return quaternion


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.4, -0.3, 2.5), (-2.0, 1.2, -3.0)])
def test_attitude_is_yaw_pitch_roll(angles: tuple[float, float, float]) -> None:
    quaternion, mat = attitude(*angles), np.empty((4, 3))
    expected = Rotation.from_euler("ZYX", angles[::-1]).as_matrix()
    mat_from_quaternion(quaternion, mat)
    np.testing.assert_allclose(mat[:3], expected, atol=1e-14)
    assert yaw_rad(quaternion) == pytest.approx(angles[2], abs=1e-12)


@pytest.mark.parametrize("size", [1e-9, 1e-5, 1e-4, 0.3, 2.0])
def test_turns_are_exact_in_body_and_in_frame(size: float) -> None:
    vector = size * np.array([0.6, -0.5, 0.62])
    start = attitude(0.3, 0.2, 1.0)
    in_body, in_frame = start.copy(), start.copy()
    turn_body(in_body, *vector)
    turn_frame(in_frame, *vector)
    turn = Rotation.from_rotvec(vector)
    assert (rotation(start) * turn * rotation(in_body).inv()).magnitude() < 1e-14
    assert (turn * rotation(start) * rotation(in_frame).inv()).magnitude() < 1e-14
    assert np.linalg.norm(in_body) == pytest.approx(1.0, abs=1e-14)


def test_a_million_turns_keep_the_length() -> None:
    quaternion = attitude(0.1, 0.2, 0.3)
    for _ in range(20_000):
        turn_body(quaternion, 0.02, -0.01, 0.03)
    assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-14)


def test_tilt_between_is_the_small_rotation() -> None:
    ours = attitude(0.5, -0.4, 2.0)
    theirs = ours.copy()
    turn_frame(theirs, 1e-4, -2e-4, 3e-4)
    found = [tilt_between(ours, theirs, axis) for axis in range(3)]
    np.testing.assert_allclose(found, [1e-4, -2e-4, 3e-4], atol=1e-11)
    np.testing.assert_allclose(
        [tilt_between(ours, -theirs, axis) for axis in range(3)], found, atol=1e-15
    )


def test_move_crosses_the_date_line_and_stops_before_the_pole() -> None:
    position = np.array([0.0, math.pi - 1e-7, 100.0])
    move(position, 0.0, 10.0, -5.0)
    assert position[1] == pytest.approx(-math.pi - 1e-7 + 10.0 / 6378237.0, abs=1e-12)
    assert position[2] == 105.0
    position = np.array([math.radians(89.89), 0.0, 0.0])
    move(position, 1e5, 0.0, 0.0)
    assert position[0] < math.radians(89.95)
    assert wrapped(3.0 * math.pi + 0.1) == pytest.approx(-math.pi + 0.1)


def test_an_imu_at_rest_stays_where_it_is() -> None:
    """Specific force is gravity's support and the gyros see the Earth turn: nothing moves in ten
    minutes."""
    latitude, height = math.radians(47.0), 500.0
    position, velocity = np.array([latitude, 0.14, height]), np.zeros(3)
    quaternion, mat = attitude(0.1, -0.2, 1.0), np.empty((4, 3))
    to_body = rotation(quaternion).inv()
    gravity = gravity_mps2(47.0, height)
    force = to_body.apply([0.0, 0.0, -gravity])
    rate = to_body.apply(
        [ROTATION_RADPS * math.cos(latitude), 0.0, -ROTATION_RADPS * math.sin(latitude)]
    )
    for _ in range(6000):
        mechanise(position, velocity, quaternion, force, rate, 0.1, mat)
    assert abs(position[2] - height) < 1e-3
    assert np.abs(velocity).max() < 1e-4
    np.testing.assert_allclose(mat[3], [0.0, 0.0, -gravity], atol=1e-5)


def _errors(truth: tuple[Array, ...], estimate: tuple[Array, ...]) -> Array:
    """True minus estimated, in the order of the error state (first nine)."""
    (p, v, q), (p0, v0, q0) = truth, estimate
    north = (p[0] - p0[0]) * (meridian_radius_m(p0[0]) + p0[2])
    east = (p[1] - p0[1]) * (normal_radius_m(p0[0]) + p0[2]) * math.cos(p0[0])
    tilt = [tilt_between(q0, q, axis) for axis in range(3)]
    return np.array([north, east, p0[2] - p[2], *(v - v0), *tilt])


def _carry(
    start: tuple[Array, ...], error: Array, force: Array, rate: Array, dt_s: float
) -> tuple[Array, ...]:
    """The mechanisation from a start that is off by `error` (15,)."""
    position, velocity, quaternion = (part.copy() for part in start)
    move(position, *error[POSITION:VELOCITY])
    velocity += error[VELOCITY:TILT]
    turn_frame(quaternion, *error[TILT:FORCE_BIAS])
    mechanise(
        position,
        velocity,
        quaternion,
        force - error[FORCE_BIAS:RATE_BIAS],
        rate - error[RATE_BIAS:],
        dt_s,
        np.empty((4, 3)),
    )
    return position, velocity, quaternion


@pytest.mark.parametrize("dt_s", [0.02, 0.1])
@pytest.mark.parametrize("seed", range(3))
def test_transition_is_the_numeric_jacobian_of_the_mechanisation(dt_s: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    start = (
        np.array([math.radians(random.uniform(-60, 60)), 1.0, 3000.0]),
        random.uniform(-60.0, 60.0, 3),
        attitude(random.uniform(-1, 1), random.uniform(-0.5, 0.5), random.uniform(-3, 3)),
    )
    force, rate = random.uniform(-12.0, 12.0, 3), random.uniform(-0.5, 0.5, 3)
    step = np.array([100.0] * 3 + [1.0] * 3 + [1e-3] * 3 + [1.0] * 3 + [1e-2] * 3)
    base = _carry(start, np.zeros(ERRORS), force, rate, dt_s)
    numeric = np.zeros((ERRORS, ERRORS))
    for column in range(ERRORS):
        error = np.zeros(ERRORS)
        error[column] = step[column]
        ahead, behind = (_carry(start, sign * error, force, rate, dt_s) for sign in (1.0, -1.0))
        numeric[:9, column] = (_errors(ahead, base) - _errors(behind, base)) / (2.0 * step[column])
    numeric[9:, 9:] = np.eye(6)
    mat, phi = np.empty((4, 3)), np.eye(ERRORS)
    position, velocity, quaternion = (part.copy() for part in start)
    mechanise(position, velocity, quaternion, force, rate, dt_s, mat)
    transition(phi, mat, dt_s)
    # What the model leaves out: Coriolis and transport rate on the errors (3e-4 1/s), and for the
    # gyro bias the turn within half an interval, of second order in the rotation.
    np.testing.assert_allclose(phi[:9, :9], numeric[:9, :9], atol=3e-4 * dt_s)
    np.testing.assert_allclose(
        phi[:9, FORCE_BIAS:RATE_BIAS], numeric[:9, FORCE_BIAS:RATE_BIAS], atol=1e-5 * dt_s
    )
    turned = 0.5 * float(np.linalg.norm(rate)) * dt_s
    np.testing.assert_allclose(
        phi[TILT:9, RATE_BIAS:], numeric[TILT:9, RATE_BIAS:], atol=turned * dt_s
    )
    np.testing.assert_allclose(
        phi[:TILT, RATE_BIAS:], numeric[:TILT, RATE_BIAS:], atol=12.0 * dt_s**2 * (turned + 1e-3)
    )


def test_unaided_vertical_channel_diverges_at_the_rate_of_gravity_s_gradient() -> None:
    """An error of height grows as cosh(t sqrt(2 g / R)): tenfold in 28 minutes, whatever the
    step."""
    mat, rows = np.zeros((4, 3)), np.zeros((ERRORS, 1))
    mat[:3] = np.eye(3)
    mat[3, 2] = -9.8
    rows[2] = 1.0
    for _ in range(17_000):
        transition(rows, mat, 0.1)
    assert rows[2, 0] == pytest.approx(math.cosh(1700.0 * math.sqrt(2 * 9.8 / 6.37e6)), rel=2e-3)
