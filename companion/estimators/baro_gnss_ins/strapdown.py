"""Strapdown inertial navigation in the local north-east-down frame, and how its errors grow.

Mechanisation (Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
Systems", 2nd ed., section 5.4) of position (latitude and longitude in rad, height in m), velocity
``vec_n`` and attitude (the quaternion of ``mat_nb``: w, x, y, z). An IMU sample is taken as the
mean over the interval that it ends. Attitude turns by the exact rotation of that mean rate;
specific force is resolved at the middle of the interval; position takes the mean of the old and the
new velocity. Coning and sculling inside an interval are left out: at 50 Hz they are far below the
noise of the sensors that send RAW_IMU.

Errors are true minus estimated, fifteen of them in this order, and mat_nb(true) = (I + [tilt x])
mat_nb(estimated):

    position NED (m), velocity NED (m/s), tilt NED (rad), accelerometer bias (m/s2), gyro bias
    (rad/s)

    d position = velocity
    d velocity = -[f_n x] tilt - mat_nb force_bias + 2 g / R position_down
    d tilt     = -mat_nb rate_bias

Left out, each under 2e-4 of what it multiplies in a second: Coriolis and transport rate acting on
the errors.
"""

import math
from typing import Any

from numpy.typing import NDArray

from companion.jit import step
from companion.kernels.earth import ROTATION_RADPS, gravity_mps2, meridian_radius_m, normal_radius_m

Array = NDArray[Any]

POSITION, VELOCITY, TILT, FORCE_BIAS, RATE_BIAS = 0, 3, 6, 9, 12
"""where each block of the error state begins"""
ERRORS = 15

GRAVITY_GRADIENT_PER_S2 = 3.08e-6
"""2 g / R: gravity grows downwards, which makes an unaided vertical channel unstable (e-fold in 570
s)"""
HIGHEST_LATITUDE_RAD = math.radians(89.9)
"""north and east have no meaning nearer to a pole"""


@step
def mechanise(
    position: Array,
    velocity: Array,
    quaternion: Array,
    force_b: Array,
    rate_b: Array,
    dt_s: float,
    mat: Array,
) -> None:
    """Carry position (3,), velocity (3,) and quaternion (4,) on by one IMU interval, in place.

    `force_b`, `rate_b` are the corrected specific force (m/s2) and angular rate (rad/s), shape
    (3,). `mat`, shape (4, 3), receives mat_nb at the middle of the interval and, in its last row,
    the specific force in NED.
    """
    latitude, height = position[0], position[2]
    north, east, down = velocity[0], velocity[1], velocity[2]
    r_north = meridian_radius_m(latitude) + height
    r_east = normal_radius_m(latitude) + height
    spin_n, spin_d = ROTATION_RADPS * math.cos(latitude), -ROTATION_RADPS * math.sin(latitude)
    over_n, over_e, over_d = east / r_east, -north / r_north, -east * math.tan(latitude) / r_east

    half = 0.5 * dt_s
    for part in range(2):
        turn_body(quaternion, rate_b[0] * half, rate_b[1] * half, rate_b[2] * half)
        turn_frame(quaternion, -(spin_n + over_n) * half, -over_e * half, -(spin_d + over_d) * half)
        if part == 0:
            mat_from_quaternion(quaternion, mat)
    for i in range(3):
        mat[3, i] = mat[i, 0] * force_b[0] + mat[i, 1] * force_b[1] + mat[i, 2] * force_b[2]

    cor_n, cor_e, cor_d = 2.0 * spin_n + over_n, over_e, 2.0 * spin_d + over_d
    gravity = gravity_mps2(math.degrees(latitude), height)
    velocity[0] = north + dt_s * (mat[3, 0] - (cor_e * down - cor_d * east))
    velocity[1] = east + dt_s * (mat[3, 1] - (cor_d * north - cor_n * down))
    velocity[2] = down + dt_s * (mat[3, 2] - (cor_n * east - cor_e * north) + gravity)
    move(
        position,
        half * (north + velocity[0]),
        half * (east + velocity[1]),
        half * (down + velocity[2]),
    )


@step
def move(position: Array, north_m: float, east_m: float, down_m: float) -> None:
    """Displace a position, in place; the longitude stays within half a turn."""
    latitude, height = position[0], position[2]
    r_north = meridian_radius_m(latitude) + height
    r_east = (normal_radius_m(latitude) + height) * math.cos(latitude)
    position[0] = max(
        -HIGHEST_LATITUDE_RAD, min(HIGHEST_LATITUDE_RAD, latitude + north_m / r_north)
    )
    position[1] = wrapped(position[1] + east_m / r_east)
    position[2] = height - down_m


@step
def wrapped(angle_rad: float) -> float:
    """The same angle within half a turn."""
    return angle_rad - math.tau * math.floor((angle_rad + math.pi) / math.tau)


@step
def turn_body(quaternion: Array, x: float, y: float, z: float) -> None:
    """Turn the body by the rotation vector (x, y, z) in its own axes, in place."""
    w, x, y, z = _rotation(x, y, z)
    qw, qx, qy, qz = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    _set(
        quaternion,
        qw * w - qx * x - qy * y - qz * z,
        qw * x + qx * w + qy * z - qz * y,
        qw * y - qx * z + qy * w + qz * x,
        qw * z + qx * y - qy * x + qz * w,
    )


@step
def turn_frame(quaternion: Array, north: float, east: float, down: float) -> None:
    """Turn the body by a rotation vector in north-east-down axes, in place: what a tilt error
    corrects."""
    w, x, y, z = _rotation(north, east, down)
    qw, qx, qy, qz = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    _set(
        quaternion,
        w * qw - x * qx - y * qy - z * qz,
        w * qx + x * qw + y * qz - z * qy,
        w * qy - x * qz + y * qw + z * qx,
        w * qz + x * qy - y * qx + z * qw,
    )


@step
def _rotation(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Quaternion of a rotation vector (rad)."""
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-8:  # next terms: angle^4 / 384 and angle^4 / 3840, below the last digit
        return (
            1.0 - angle2 / 8.0,
            x * (0.5 - angle2 / 48.0),
            y * (0.5 - angle2 / 48.0),
            z * (0.5 - angle2 / 48.0),
        )
    angle = math.sqrt(angle2)
    sinc = math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), sinc * x, sinc * y, sinc * z


@step
def _set(quaternion: Array, w: float, x: float, y: float, z: float) -> None:
    """Store at unit length: one Newton step of 1/sqrt, exact for what rounding leaves."""
    scale = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)
    quaternion[0], quaternion[1], quaternion[2], quaternion[3] = (
        scale * w,
        scale * x,
        scale * y,
        scale * z,
    )


@step
def set_attitude(quaternion: Array, roll_rad: float, pitch_rad: float, yaw_rad: float) -> None:
    """The quaternion of three Euler angles, turned in the order yaw, pitch, roll."""
    cr, sr = math.cos(0.5 * roll_rad), math.sin(0.5 * roll_rad)
    cp, sp = math.cos(0.5 * pitch_rad), math.sin(0.5 * pitch_rad)
    cy, sy = math.cos(0.5 * yaw_rad), math.sin(0.5 * yaw_rad)
    quaternion[0] = cr * cp * cy + sr * sp * sy
    quaternion[1] = sr * cp * cy - cr * sp * sy
    quaternion[2] = cr * sp * cy + sr * cp * sy
    quaternion[3] = cr * cp * sy - sr * sp * cy


@step
def yaw_rad(quaternion: Array) -> float:
    """Heading of the nose, from north towards east."""
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


@step
def tilt_between(ours: Array, theirs: Array, axis: int) -> float:
    """Component (0, 1, 2: north, east, down) of the rotation vector from `ours` to `theirs`; first
    order in it."""
    w = theirs[0] * ours[0] + theirs[1] * ours[1] + theirs[2] * ours[2] + theirs[3] * ours[3]
    i, j, k = 1 + axis, 1 + (axis + 1) % 3, 1 + (axis + 2) % 3
    part: float = (
        theirs[i] * ours[0] - theirs[0] * ours[i] - theirs[j] * ours[k] + theirs[k] * ours[j]
    )
    return 2.0 * part if w >= 0.0 else -2.0 * part


@step
def mat_from_quaternion(quaternion: Array, mat: Array) -> None:
    """Write mat_nb into the first three rows of `mat`."""
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    mat[0, 0], mat[0, 1], mat[0, 2] = (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
    )
    mat[1, 0], mat[1, 1], mat[1, 2] = (
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
    )
    mat[2, 0], mat[2, 1], mat[2, 2] = (
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )


@step
def transition(rows: Array, mat: Array, dt_s: float) -> None:
    """Replace `rows` by Phi `rows`, in place, where Phi carries the error state over one interval
    of `mechanise`.

    `rows` has at least fifteen rows, of any length; `mat` is what `mechanise` left. Each step of
    the chain takes what the mechanisation takes: position the mean of the two velocities, velocity
    the tilt of the middle. Applied to the identity it gives Phi; applied to P, to the transpose of
    that, and added to, the covariance.
    """
    half = 0.5 * dt_s
    for i in range(3):
        _add(rows, POSITION + i, half, VELOCITY + i)
        for j in range(3):
            _add(rows, TILT + i, -half * mat[i, j], RATE_BIAS + j)
    for i in range(3):
        for j in range(3):
            _add(rows, VELOCITY + i, -dt_s * mat[i, j], FORCE_BIAS + j)
        after, before = (i + 1) % 3, (i + 2) % 3
        _add(rows, VELOCITY + i, dt_s * mat[3, before], TILT + after)
        _add(rows, VELOCITY + i, -dt_s * mat[3, after], TILT + before)
    _add(rows, VELOCITY + 2, dt_s * GRAVITY_GRADIENT_PER_S2, POSITION + 2)
    for i in range(3):
        _add(rows, POSITION + i, half, VELOCITY + i)
        for j in range(3):
            _add(rows, TILT + i, -half * mat[i, j], RATE_BIAS + j)


@step
def coast(rows: Array, dt_s: float) -> None:
    """Replace `rows` by Phi `rows`, in place, for motion at constant velocity without an IMU."""
    for i in range(3):
        _add(rows, POSITION + i, dt_s, VELOCITY + i)


@step
def _add(rows: Array, target: int, factor: float, source: int) -> None:
    for k in range(rows.shape[1]):
        rows[target, k] += factor * rows[source, k]
