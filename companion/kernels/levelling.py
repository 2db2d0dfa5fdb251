"""Roll and pitch from an IMU and GNSS: the unit vector ``up_b`` in the body frame.

At rest level ``up_b`` is (0, 0, -1). The gyros turn it, d(up)/dt = -w x up. A slow correction pulls
it towards the specific force less the acceleration of the vehicle, f - a, which is the support
against gravity alone. The acceleration a is the slope of the velocity over ground that GNSS shows,
with the nose taken to lie along the track. Velocity and force are smoothed alike, so both belong to
the same instant. The gain is that of a Kalman filter with two states, tilt error and gyro bias,
equal for every axis across ``up_b``.

The attitude is aligned from one second of specific force: at rest (gyro bias from the same second),
or in motion with the same compensation. Before that ``up_b`` is NaN.

`companion.kernels.attitude` decides when the steps of this component are called.
"""

import math

import numpy as np

from companion.jit import step
from companion.kernels.earth import gravity_mps2
from companion.kernels.vectors import Vector, dot, normalise, rotate, turn
from companion.samples import Record, Rows

WINDOW_S = 1.0
REST_SPEED_MPS = 1.0
REST_RATE_RADPS = 0.1
REST_SPREAD_MPS2 = 0.5
REST_RATE_SPREAD_RADPS = 0.05
REST_TILT_SD_RAD = 0.02
REST_BIAS_SD_RADPS = 0.003
MOVING_TILT_SD_RAD = 0.15
BLIND_TILT_SD_RAD = 0.5
"""Tilt spread after an alignment in motion without a GNSS acceleration."""
LONGEST_WAIT_S = 10.0
"""Longest wait for the first GNSS speed: a glider is as quiet as a vehicle at rest, but its gyros
show more than their bias."""
MOVING_BIAS_SD_RADPS = 0.02
"""Zero-rate offset of consumer gyros: about 1 degree a second."""
HIGHEST_BIAS_RADPS = 0.2

GYRO_NOISE_RADPS_RTHZ = 3e-3
"""White noise, quantisation in mrad/s and the scale error of a turn together."""
GYRO_WALK_RADPS_RTS = 1e-4
DISTURBANCE_MPS2 = 0.5
"""Acceleration that GNSS does not show in motion: gusts, sideslip, vibration."""
REST_DISTURBANCE_MPS2 = 0.1
"""Acceleration that GNSS does not show while its speed says that the vehicle stands."""
BLIND_DISTURBANCE_MPS2 = 4.0
"""Acceleration that remains unknown without GNSS speed: a turn at 22 degrees of bank."""
COMPENSATION_ERROR = 0.3
"""Share of the compensated acceleration that is wrong: crab angle, lateness."""
DISTURBANCE_TIME_S = 3.0
"""Correlation time of a disturbance."""
SMOOTHING_S = 1.0
"""Smoothing time of the velocity over ground, of which the acceleration is the slope, and of the
specific force that it explains: some links repeat the speed of one second in five fixes."""
HIGHEST_ACCELERATION_MPS2 = 30.0
"""A GNSS speed that changes faster is not used as an acceleration."""
SHORTEST_FIX_US, LONGEST_FIX_US = 50_000, 2_000_000
LEAST_SUPPORT_MPS2 = 3.0
"""Least specific force that has a usable direction; in a parabola it has none."""
NOSE_UP = 0.95
"""Largest component of ``up_b`` along the nose (72 degrees) at which the nose shows a direction
over ground."""

LEVELLING = np.dtype(
    [
        ("up_b", "f8", (3,)),  # NaN unknown
        ("bias_b_radps", "f8", (3,)),
        ("rate_b_radps", "f8", (3,)),  # newest gyro rate less its bias
        ("mean_rate_b_radps", "f8", (3,)),  # over the newest interval
        ("tilt_var", "f8"),  # rad2
        ("tilt_bias_cov", "f8"),
        ("bias_var", "f8"),
        ("force_b_mps2", "f8", (3,)),  # smoothed, as the velocity is
        ("window_s", "f8"),  # alignment: length so far, sums over it
        ("window_count", "i8"),
        ("waited_s", "f8"),  # for GNSS to show whether the vehicle rests
        ("force_sum", "f8", (3,)),
        ("rate_sum", "f8", (3,)),
        ("force2_sum", "f8"),
        ("rate2_sum", "f8"),
        ("bearing_b", "f8", (3,)),  # direction of the newest sample's support
        ("fix_us", "i8"),  # GNSS: newest fix with a speed, -1 none
        ("speed_mps", "f8"),
        ("course_rad", "f8"),
        ("north_mps", "f8"),  # velocity over ground, smoothed
        ("east_mps", "f8"),
        ("smoothed", "f8"),  # share of the slope that the smoothing has taken up since it began
        ("along_mps2", "f8"),  # acceleration over ground; NaN unknown
        ("across_mps2", "f8"),
        ("gravity_mps2", "f8"),
    ],
    align=True,
)
"""The record of this component."""


@step
def levelling_start(level: Record) -> None:
    """Nothing known."""
    level.fix_us = -1
    level.speed_mps = math.nan
    level.course_rad = math.nan
    level.north_mps, level.east_mps, level.smoothed = math.nan, math.nan, 0.0
    level.along_mps2 = math.nan
    level.across_mps2 = math.nan
    level.gravity_mps2 = gravity_mps2(45.0, 0.0)
    level.bias_var = MOVING_BIAS_SD_RADPS * MOVING_BIAS_SD_RADPS
    level.waited_s = 0.0
    for i in range(3):
        level.bias_b_radps[i] = 0.0
        level.rate_b_radps[i] = 0.0
        level.mean_rate_b_radps[i] = 0.0
    realign(level)


@step
def realign(level: Record) -> None:
    """Forget the attitude and begin the alignment; the gyro bias stays known."""
    level.tilt_var = math.nan
    level.tilt_bias_cov = 0.0
    level.window_s = 0.0
    level.window_count = 0
    level.force2_sum = 0.0
    level.rate2_sum = 0.0
    for i in range(3):
        level.force_b_mps2[i] = math.nan
        level.up_b[i] = math.nan
        level.bearing_b[i] = math.nan
        level.force_sum[i] = 0.0
        level.rate_sum[i] = 0.0


@step
def ground_acceleration(level: Record, fix: Rows) -> None:
    """Take local gravity and the acceleration over ground between this fix and the last."""
    gravity = gravity_mps2(fix[0].latitude_deg, fix[0].altitude_amsl_m)
    if not math.isnan(gravity):
        level.gravity_mps2 = gravity
    speed, course = fix[0].ground_speed_mps, fix[0].course_rad
    if not speed < math.inf or not abs(course) < math.inf:
        level.waited_s = LONGEST_WAIT_S  # this receiver sends no speed: do not wait for one
        return
    between_us = fix[0].time_us - level.fix_us
    between_s = between_us * 1e-6
    north, east = speed * math.cos(course), speed * math.sin(course)
    level.along_mps2, level.across_mps2 = math.nan, math.nan
    if level.fix_us >= 0 and SHORTEST_FIX_US <= between_us <= LONGEST_FIX_US:
        share = 1.0 - math.exp(-between_s / SMOOTHING_S)
        level.smoothed += share * (1.0 - level.smoothed)
        gained_north = share * (north - level.north_mps)
        gained_east = share * (east - level.east_mps)
        level.north_mps += gained_north
        level.east_mps += gained_east
        north_mps2 = gained_north / (between_s * level.smoothed)
        east_mps2 = gained_east / (between_s * level.smoothed)
        if math.hypot(north_mps2, east_mps2) <= HIGHEST_ACCELERATION_MPS2:
            level.along_mps2 = north_mps2 * math.cos(course) + east_mps2 * math.sin(course)
            level.across_mps2 = east_mps2 * math.cos(course) - north_mps2 * math.sin(course)
    else:
        level.north_mps, level.east_mps, level.smoothed = north, east, 0.0
    level.fix_us = fix[0].time_us
    level.speed_mps, level.course_rad = speed, course


@step
def drop_old_acceleration(level: Record, time_us: int) -> None:
    """Forget speed and acceleration over ground when the last fix is too old."""
    if time_us - level.fix_us > LONGEST_FIX_US:
        level.speed_mps, level.along_mps2, level.across_mps2 = math.nan, math.nan, math.nan


@step
def note_rate(level: Record, imu: Rows) -> None:
    """Subtract the gyro bias; the mean over the interval, as some streams sample unevenly."""
    rate, mean_rate = imu[0].angular_rate_b_radps, level.mean_rate_b_radps
    for i in range(3):
        new = rate[i] - level.bias_b_radps[i]
        mean_rate[i] = 0.5 * (level.rate_b_radps[i] + new)
        level.rate_b_radps[i] = new


@step
def level_up(level: Record, imu: Rows, elapsed_s: float) -> None:
    """Turn ``up_b`` with the gyros and correct it with gravity; align while it is unknown."""
    if math.isnan(level.up_b[0]):
        align(level, imu, elapsed_s)
        return
    turn(level.up_b, level.mean_rate_b_radps, elapsed_s)
    correct_tilt(level, imu, elapsed_s)


@step
def align(level: Record, imu: Rows, elapsed_s: float) -> None:
    """Gather a second of specific force and rate; then ``up_b`` is the direction of the force less
    the GNSS acceleration."""
    gather_window(level, imu, elapsed_s)
    if level.window_s < WINDOW_S:
        return
    count = level.window_count
    for i in range(3):
        level.force_sum[i] /= count
        level.rate_sum[i] /= count
    mean_force, mean_rate = level.force_sum, level.rate_sum
    support = math.sqrt(dot(mean_force, mean_force))
    if support < LEAST_SUPPORT_MPS2:
        realign(level)
        return
    quiet = is_quiet(level, support)
    if quiet and math.isnan(level.speed_mps) and level.waited_s < LONGEST_WAIT_S:
        level.waited_s += level.window_s
        realign(level)
        return
    up = level.up_b
    for i in range(3):
        up[i] = mean_force[i] / support
        level.force_b_mps2[i] = mean_force[i]
    tilt_sd = MOVING_TILT_SD_RAD
    if quiet and not level.speed_mps > REST_SPEED_MPS:
        tilt_sd = REST_TILT_SD_RAD
        level.bias_var = REST_BIAS_SD_RADPS * REST_BIAS_SD_RADPS
        for i in range(3):
            level.bias_b_radps[i] = mean_rate[i]
    elif math.isnan(level.along_mps2):
        tilt_sd = BLIND_TILT_SD_RAD
    else:
        # The acceleration's direction in the body needs the attitude that is sought: iterate.
        for _ in range(8):
            support_direction(level, mean_force, up, up)
    level.tilt_var = tilt_sd * tilt_sd
    level.tilt_bias_cov = 0.0


@step
def gather_window(level: Record, imu: Rows, elapsed_s: float) -> None:
    """Add a sample to the sums of the alignment."""
    force, rate = imu[0].specific_force_b_mps2, imu[0].angular_rate_b_radps
    level.window_s += elapsed_s
    level.window_count += 1
    level.force2_sum += dot(force, force)
    level.rate2_sum += dot(rate, rate)
    for i in range(3):
        level.force_sum[i] += force[i]
        level.rate_sum[i] += rate[i]


@step
def is_quiet(level: Record, support: float) -> bool:
    """Whether the second of the alignment shows no motion; ``force_sum`` and ``rate_sum`` hold
    means by now."""
    count, mean_rate = level.window_count, level.rate_sum
    force_var = level.force2_sum / count - support * support
    rate_var = level.rate2_sum / count - dot(mean_rate, mean_rate)
    return (
        dot(mean_rate, mean_rate) < REST_RATE_RADPS * REST_RATE_RADPS
        and abs(support - level.gravity_mps2) < REST_SPREAD_MPS2
        and force_var < REST_SPREAD_MPS2 * REST_SPREAD_MPS2
        and rate_var < REST_RATE_SPREAD_RADPS * REST_RATE_SPREAD_RADPS
    )


@step
def support_direction(level: Record, force: Vector, up: Vector, result: Vector) -> float:
    """Write the direction of the specific force less the acceleration over ground into `result`;
    returns its size, m/s2.

    Forward is the nose's horizontal direction, right is forward x up. Where that is unknown, the
    force is taken as it is.
    """
    along, across = level.along_mps2, level.across_mps2
    flat = math.sqrt(max(0.0, 1.0 - up[0] * up[0]))
    x, y, z = force[0], force[1], force[2]
    if not math.isnan(along) and abs(up[0]) < NOSE_UP:
        forward_x, forward_y, forward_z = flat, -up[0] * up[1] / flat, -up[0] * up[2] / flat
        x -= along * forward_x + across * (forward_y * up[2] - forward_z * up[1])
        y -= along * forward_y + across * (forward_z * up[0] - forward_x * up[2])
        z -= along * forward_z + across * (forward_x * up[1] - forward_y * up[0])
    size = math.sqrt(x * x + y * y + z * z)
    if size >= LEAST_SUPPORT_MPS2:
        result[0], result[1], result[2] = x / size, y / size, z / size
    return size


@step
def correct_tilt(level: Record, imu: Rows, elapsed_s: float) -> None:
    """Two-state Kalman filter, tilt error and gyro bias, equal for every axis across ``up_b``."""
    tilt, cov, bias = level.tilt_var, level.tilt_bias_cov, level.bias_var
    tilt += elapsed_s * (
        2.0 * cov + elapsed_s * bias + GYRO_NOISE_RADPS_RTHZ * GYRO_NOISE_RADPS_RTHZ
    )
    cov += elapsed_s * bias
    bias += elapsed_s * GYRO_WALK_RADPS_RTS * GYRO_WALK_RADPS_RTS
    up, bearing, smooth = level.up_b, level.bearing_b, level.force_b_mps2
    rotate(smooth, level.mean_rate_b_radps, elapsed_s)
    share = 1.0 - math.exp(-elapsed_s / SMOOTHING_S)
    for i in range(3):
        smooth[i] += share * (imu[0].specific_force_b_mps2[i] - smooth[i])
    size = support_direction(level, smooth, up, bearing)
    if size >= LEAST_SUPPORT_MPS2:
        noise = bearing_variance(level, elapsed_s)
        tilt_gain, bias_gain = tilt / (tilt + noise), cov / (tilt + noise)
        bias -= bias_gain * cov
        cov -= tilt_gain * cov
        tilt -= tilt_gain * tilt
        error_x = bearing[1] * up[2] - bearing[2] * up[1]
        error_y = bearing[2] * up[0] - bearing[0] * up[2]
        error_z = bearing[0] * up[1] - bearing[1] * up[0]
        for i, error_i in enumerate((error_x, error_y, error_z)):
            moved = level.bias_b_radps[i] - bias_gain * error_i
            level.bias_b_radps[i] = max(-HIGHEST_BIAS_RADPS, min(HIGHEST_BIAS_RADPS, moved))
            up[i] += tilt_gain * (bearing[i] - up[i])
        normalise(up)
    level.tilt_var, level.tilt_bias_cov, level.bias_var = tilt, cov, bias


@step
def bearing_variance(level: Record, elapsed_s: float) -> float:
    """Variance of the support's direction as a measurement of ``up_b``, rad2."""
    known = not math.isnan(level.along_mps2)
    error = BLIND_DISTURBANCE_MPS2
    if known:
        error = DISTURBANCE_MPS2 if level.speed_mps > REST_SPEED_MPS else REST_DISTURBANCE_MPS2
    shown = math.hypot(level.along_mps2, level.across_mps2) if known else 0.0
    wrong = COMPENSATION_ERROR * shown
    smooth = level.force_b_mps2
    excess = math.sqrt(dot(smooth, smooth)) - math.hypot(level.gravity_mps2, shown)
    noise = (error * error + wrong * wrong + excess * excess) / (
        level.gravity_mps2 * level.gravity_mps2
    )
    # A disturbance lasts: that many samples count as one measurement.
    return float(noise * (2.0 * DISTURBANCE_TIME_S / elapsed_s))
