"""Roll and pitch, and what they are for: the vertical acceleration that an inertial vertical
channel integrates.

The attitude is kept as the unit vector ``up`` in the body frame, which is all of it that the
vertical needs: at rest level (0, 0, -1). Two of them run side by side.

Our own
    The gyros turn it, d(up)/dt = -w x up. A slow correction pulls it towards the specific force
    less the acceleration of the vehicle, f - a, which is gravity's support alone. The acceleration
    is what GNSS shows: change of speed along the track and course rate x speed across it, with the
    nose taken to lie along the track. The gain is that of a Kalman filter with two states, tilt
    error and gyro bias, equal for every axis across ``up``. Aligned from one second of specific
    force: at rest (gyro bias from the same second), or in motion with the same compensation.

The vehicle's
    ATTITUDE as the autopilot sends it, turned by the gyros in between. It is believed while it
    agrees with our own: the EKF of one autopilot was 26 degrees wrong while its GNSS was jammed.

An estimator puts `attitude_fields` into its state, calls `attitude_start` when it starts, then
`attitude_imu`, `attitude_gnss` and, if it may, `attitude_vehicle` with judged samples (finite,
newer than the last), and reads `up_acceleration_mps2`. Everything is NaN before alignment and while
the IMU is too slow (`imu_can_be_integrated`).

Errors: an accelerometer bias of 0.1 m/s2 tilts by 0.6 degrees, which no gravity reference can tell.
A nose that is not along the track (wind, a multirotor that flies sideways) and GNSS speed that is
0.2-0.4 s late count as disturbances for as long as the manoeuvre lasts. Eötvös and Coriolis (0.006
m/s2 at 60 m/s) are left out of the vertical.
"""

import math
from typing import Any

from numpy.typing import NDArray

from companion.jit import step
from companion.kernels.earth import gravity_mps2
from companion.samples import Rows

SLOWEST_TO_START_S = 0.105
SLOWEST_TO_GO_ON_S = 0.13
"""IMU intervals, so that one that is sent at exactly 10 Hz can be integrated and does not flicker."""
INTERVALS_TO_TRUST = 8
INTERVAL_WEIGHT = 1.0 / 16.0
LONGEST_INTERVAL_S = 1.0
"""one gap counts as no more than this in the mean interval"""
LONGEST_STEP_S = 0.5
"""gyros say nothing about a longer gap: the alignment begins again"""

WINDOW_S = 1.0
REST_SPEED_MPS = 1.0
REST_RATE_RADPS = 0.1
REST_SPREAD_MPS2 = 0.5
REST_RATE_SPREAD_RADPS = 0.05
REST_TILT_SD_RAD = 0.02
REST_BIAS_SD_RADPS = 0.003
MOVING_TILT_SD_RAD = 0.15
BLIND_TILT_SD_RAD = 0.5
"""in motion, and GNSS tells no acceleration"""
LONGEST_WAIT_S = 10.0
"""for the first GNSS speed: a glider is as quiet as a vehicle at rest, but its gyros do not show
their bias alone"""
MOVING_BIAS_SD_RADPS = 0.02
"""zero-rate offset of consumer gyros: about 1 degree a second"""
HIGHEST_BIAS_RADPS = 0.2

GYRO_NOISE_RADPS_RTHZ = 3e-3
"""white noise, quantisation in mrad/s and the scale error of a turn together"""
GYRO_WALK_RADPS_RTS = 1e-4
DISTURBANCE_MPS2 = 0.5
"""acceleration that GNSS does not show: gusts, sideslip, vibration"""
REST_DISTURBANCE_MPS2 = 0.1
"""the same while GNSS shows that the vehicle stands"""
BLIND_DISTURBANCE_MPS2 = 4.0
"""the same while GNSS shows nothing: a turn at 22 degrees of bank"""
COMPENSATION_ERROR = 0.3
"""share of the compensated acceleration that is wrong: crab angle, lateness"""
DISTURBANCE_TIME_S = 3.0
"""for how long a disturbance stays the same"""
HIGHEST_ACCELERATION_MPS2 = 30.0
"""GNSS speed that changes faster is no acceleration"""
SHORTEST_FIX_US, LONGEST_FIX_US = 50_000, 2_000_000
VIBRATION_TIME_S = 0.2
"""vibration averages out in so long; what is left of the force beyond gravity's is an acceleration"""
LEAST_SUPPORT_MPS2 = 3.0
"""in a parabola the specific force has no direction"""
NOSE_UP = 0.95
"""beyond this share of ``up`` along the nose (72 degrees), the nose shows no direction over ground"""

VEHICLE_TIMEOUT_US = 2_000_000
VEHICLE_LIMIT_RAD = 0.15
VEHICLE_LIMIT_SDS = 3.0
DISTRUST_S, TRUST_S = 3.0, 10.0
"""disagreement for the first makes the vehicle's attitude unbelievable, agreement for the second
believable"""


def attitude_fields() -> tuple[tuple[Any, ...], ...]:
    """The state fields of this component."""
    return (
        ("attitude_us", "i8"),  # time of the newest IMU sample, -1 none
        ("attitude_interval_s", "f8"),  # smoothed
        ("attitude_intervals", "i8"),  # how many are in it, up to INTERVALS_TO_TRUST
        ("attitude_integrable", "i8"),
        ("attitude_up_b", "f8", (3,)),  # our own; NaN unknown
        ("attitude_bias_b_radps", "f8", (3,)),
        ("attitude_rate_b_radps", "f8", (3,)),  # newest gyro rate less its bias
        ("attitude_mean_rate_b_radps", "f8", (3,)),  # over the newest interval
        ("attitude_tilt_var", "f8"),  # rad2
        ("attitude_tilt_bias_cov", "f8"),
        ("attitude_bias_var", "f8"),
        ("attitude_force_b_mps2", "f8", (3,)),  # without vibration
        ("attitude_window_s", "f8"),  # alignment: length so far, sums over it
        ("attitude_window_count", "i8"),
        ("attitude_waited_s", "f8"),  # for GNSS to say whether this is rest
        ("attitude_force_sum", "f8", (3,)),
        ("attitude_rate_sum", "f8", (3,)),
        ("attitude_force2_sum", "f8"),
        ("attitude_rate2_sum", "f8"),
        ("attitude_bearing_b", "f8", (3,)),  # where the support of the newest sample points
        ("attitude_fix_us", "i8"),  # GNSS: newest fix with a speed, -1 none
        ("attitude_speed_mps", "f8"),
        ("attitude_course_rad", "f8"),
        ("attitude_along_mps2", "f8"),  # acceleration over ground; NaN unknown
        ("attitude_across_mps2", "f8"),
        ("attitude_gravity_mps2", "f8"),
        ("attitude_vehicle_us", "i8"),  # newest ATTITUDE, -1 none
        ("attitude_vehicle_up_b", "f8", (3,)),
        ("attitude_vehicle_trusted", "i8"),
        ("attitude_vehicle_doubt_s", "f8"),  # for how long it has contradicted the line above
    )


@step
def attitude_start(state: Rows) -> None:
    """Nothing known; the interval too is measured anew."""
    s = state[0]
    s.attitude_us = -1
    s.attitude_interval_s = math.nan
    s.attitude_intervals = 0
    s.attitude_integrable = 0
    s.attitude_fix_us = -1
    s.attitude_speed_mps = math.nan
    s.attitude_course_rad = math.nan
    s.attitude_along_mps2 = math.nan
    s.attitude_across_mps2 = math.nan
    s.attitude_gravity_mps2 = gravity_mps2(45.0, 0.0)
    s.attitude_vehicle_us = -1
    s.attitude_vehicle_trusted = 1
    s.attitude_vehicle_doubt_s = 0.0
    s.attitude_bias_var = MOVING_BIAS_SD_RADPS * MOVING_BIAS_SD_RADPS
    s.attitude_waited_s = 0.0
    for i in range(3):
        s.attitude_bias_b_radps[i] = 0.0
        s.attitude_rate_b_radps[i] = 0.0
        s.attitude_mean_rate_b_radps[i] = 0.0
        s.attitude_vehicle_up_b[i] = math.nan
    _realign(state)


@step
def imu_can_be_integrated(state: Rows) -> bool:
    """Whether IMU samples come at about 10 Hz or more (with hysteresis); False until eight
    intervals are known."""
    return state[0].attitude_integrable == 1


@step
def up_is_known(state: Rows) -> bool:
    """Whether there is an attitude, ours or the vehicle's."""
    return not math.isnan(state[0].attitude_up_b[0]) or vehicle_serves(state)


@step
def tilt_sd_rad(state: Rows) -> float:
    """Spread of our own attitude's error; the accelerometer bias comes on top."""
    return math.sqrt(state[0].attitude_tilt_var)


@step
def roll_rad(state: Rows) -> float:
    """Roll of the attitude in use; NaN unknown."""
    return math.atan2(-_up_in_use(state, 1), -_up_in_use(state, 2))


@step
def pitch_rad(state: Rows) -> float:
    """Pitch of the attitude in use; NaN unknown."""
    nose = _up_in_use(state, 0)
    return math.nan if math.isnan(nose) else math.asin(max(-1.0, min(1.0, nose)))


@step
def up_acceleration_mps2(state: Rows, sample: Rows) -> float:
    """Upward acceleration: specific force along ``up``, less local gravity. NaN while the attitude
    is unknown.

    Call it after `attitude_imu` with the same sample.
    """
    s, force = state[0], sample[0].specific_force_b_mps2
    if vehicle_serves(state):
        return _dot(force, s.attitude_vehicle_up_b) - s.attitude_gravity_mps2
    return _dot(force, s.attitude_up_b) - s.attitude_gravity_mps2


@step
def attitude_imu(state: Rows, sample: Rows) -> None:
    """Turn both attitudes with the gyros, correct our own with gravity; align while it is unknown."""
    s = state[0]
    time_us = sample[0].time_us
    elapsed_s = (time_us - s.attitude_us) * 1e-6 if s.attitude_us >= 0 else math.nan
    s.attitude_us = time_us
    if time_us - s.attitude_fix_us > LONGEST_FIX_US:
        s.attitude_speed_mps, s.attitude_along_mps2, s.attitude_across_mps2 = (
            math.nan,
            math.nan,
            math.nan,
        )
    _measure_interval(state, elapsed_s)
    rate, mean_rate = sample[0].angular_rate_b_radps, s.attitude_mean_rate_b_radps
    for i in range(3):
        new = rate[i] - s.attitude_bias_b_radps[i]
        mean_rate[i] = 0.5 * (
            s.attitude_rate_b_radps[i] + new
        )  # some streams hold samples at uneven intervals
        s.attitude_rate_b_radps[i] = new
    if not elapsed_s <= LONGEST_STEP_S or s.attitude_integrable == 0:
        _realign(state)
        s.attitude_waited_s = 0.0
        s.attitude_vehicle_us = -1
        s.attitude_vehicle_doubt_s = 0.0
        return
    _turn(s.attitude_vehicle_up_b, mean_rate, elapsed_s)
    if math.isnan(s.attitude_up_b[0]):
        _align(state, sample, elapsed_s)
        return
    _turn(s.attitude_up_b, mean_rate, elapsed_s)
    _correct(state, sample, elapsed_s)


@step
def attitude_gnss(state: Rows, sample: Rows) -> None:
    """Local gravity, and the acceleration over ground between this fix and the last."""
    s = state[0]
    gravity = gravity_mps2(sample[0].latitude_deg, sample[0].altitude_amsl_m)
    if not math.isnan(gravity):
        s.attitude_gravity_mps2 = gravity
    speed, course = sample[0].ground_speed_mps, sample[0].course_rad
    if not speed < math.inf or not abs(course) < math.inf:
        s.attitude_waited_s = (
            LONGEST_WAIT_S  # this receiver will not tell whether the vehicle rests
        )
        return
    between_us = sample[0].time_us - s.attitude_fix_us
    s.attitude_along_mps2, s.attitude_across_mps2 = math.nan, math.nan
    if s.attitude_fix_us >= 0 and SHORTEST_FIX_US <= between_us <= LONGEST_FIX_US:
        turned = course - s.attitude_course_rad
        turned -= math.tau * math.floor((turned + math.pi) / math.tau)
        along = (speed - s.attitude_speed_mps) / (between_us * 1e-6)
        across = 0.5 * (speed + s.attitude_speed_mps) * turned / (between_us * 1e-6)
        if math.hypot(along, across) <= HIGHEST_ACCELERATION_MPS2:
            s.attitude_along_mps2, s.attitude_across_mps2 = along, across
    s.attitude_fix_us = sample[0].time_us
    s.attitude_speed_mps, s.attitude_course_rad = speed, course


@step
def attitude_vehicle(state: Rows, sample: Rows) -> None:
    """Take the autopilot's attitude, brought to the newest IMU sample, and judge it by our own."""
    s = state[0]
    up = s.attitude_vehicle_up_b
    up[0] = math.sin(sample[0].pitch_rad)
    up[1] = -math.cos(sample[0].pitch_rad) * math.sin(sample[0].roll_rad)
    up[2] = -math.cos(sample[0].pitch_rad) * math.cos(sample[0].roll_rad)
    last_us, s.attitude_vehicle_us = s.attitude_vehicle_us, sample[0].time_us
    since_s = (s.attitude_us - sample[0].time_us) * 1e-6
    if s.attitude_us < 0 or abs(since_s) > LONGEST_STEP_S:
        return  # our own stands still while the IMU is silent
    _turn(up, s.attitude_rate_b_radps, since_s)
    if math.isnan(s.attitude_up_b[0]) or last_us < 0:
        return
    limit = VEHICLE_LIMIT_RAD + VEHICLE_LIMIT_SDS * tilt_sd_rad(state)
    agree = _dot(up, s.attitude_up_b) >= math.cos(min(limit, math.pi))
    if agree == (s.attitude_vehicle_trusted == 1):
        s.attitude_vehicle_doubt_s = 0.0
        return
    s.attitude_vehicle_doubt_s += min(1.0, max(0.0, (sample[0].time_us - last_us) * 1e-6))
    if s.attitude_vehicle_doubt_s >= (TRUST_S if agree else DISTRUST_S):
        s.attitude_vehicle_trusted = 1 if agree else 0
        s.attitude_vehicle_doubt_s = 0.0


@step
def vehicle_serves(state: Rows) -> bool:
    """Whether the vehicle's attitude is fresh and agrees with our own."""
    s = state[0]
    fresh = (
        s.attitude_vehicle_us >= 0 and s.attitude_us - s.attitude_vehicle_us <= VEHICLE_TIMEOUT_US
    )
    return fresh and s.attitude_vehicle_trusted == 1


@step
def _up_in_use(state: Rows, axis: int) -> float:
    return (
        state[0].attitude_vehicle_up_b[axis]
        if vehicle_serves(state)
        else state[0].attitude_up_b[axis]
    )


@step
def _measure_interval(state: Rows, elapsed_s: float) -> None:
    """Smooth the interval between IMU stamps and switch ``attitude_integrable``."""
    s = state[0]
    if not elapsed_s > 0.0:
        return
    elapsed_s = min(elapsed_s, LONGEST_INTERVAL_S)
    s.attitude_intervals = min(INTERVALS_TO_TRUST, s.attitude_intervals + 1)
    if s.attitude_intervals == 1:
        s.attitude_interval_s = elapsed_s
    s.attitude_interval_s += max(INTERVAL_WEIGHT, 1.0 / s.attitude_intervals) * (
        elapsed_s - s.attitude_interval_s
    )
    if s.attitude_interval_s > SLOWEST_TO_GO_ON_S:
        s.attitude_integrable = 0
    elif s.attitude_intervals == INTERVALS_TO_TRUST and s.attitude_interval_s <= SLOWEST_TO_START_S:
        s.attitude_integrable = 1


@step
def _realign(state: Rows) -> None:
    """Attitude unknown, alignment from its beginning; the gyro bias stays known."""
    s = state[0]
    s.attitude_tilt_var = math.nan
    s.attitude_tilt_bias_cov = 0.0
    s.attitude_window_s = 0.0
    s.attitude_window_count = 0
    s.attitude_force2_sum = 0.0
    s.attitude_rate2_sum = 0.0
    for i in range(3):
        s.attitude_force_b_mps2[i] = math.nan
        s.attitude_up_b[i] = math.nan
        s.attitude_bearing_b[i] = math.nan
        s.attitude_force_sum[i] = 0.0
        s.attitude_rate_sum[i] = 0.0


@step
def _align(state: Rows, sample: Rows, elapsed_s: float) -> None:
    """Gather a second of specific force and rate; then ``up`` is where the force less GNSS's
    acceleration points."""
    s = state[0]
    force, rate = sample[0].specific_force_b_mps2, sample[0].angular_rate_b_radps
    s.attitude_window_s += elapsed_s
    s.attitude_window_count += 1
    s.attitude_force2_sum += _dot(force, force)
    s.attitude_rate2_sum += _dot(rate, rate)
    for i in range(3):
        s.attitude_force_sum[i] += force[i]
        s.attitude_rate_sum[i] += rate[i]
    if s.attitude_window_s < WINDOW_S:
        return
    count = s.attitude_window_count
    for i in range(3):
        s.attitude_force_sum[i] /= count
        s.attitude_rate_sum[i] /= count
    mean_force, mean_rate = s.attitude_force_sum, s.attitude_rate_sum
    support = math.sqrt(_dot(mean_force, mean_force))
    if support < LEAST_SUPPORT_MPS2:
        _realign(state)
        return
    force_var = s.attitude_force2_sum / count - support * support
    rate_var = s.attitude_rate2_sum / count - _dot(mean_rate, mean_rate)
    quiet = (
        _dot(mean_rate, mean_rate) < REST_RATE_RADPS * REST_RATE_RADPS
        and abs(support - s.attitude_gravity_mps2) < REST_SPREAD_MPS2
        and force_var < REST_SPREAD_MPS2 * REST_SPREAD_MPS2
        and rate_var < REST_RATE_SPREAD_RADPS * REST_RATE_SPREAD_RADPS
    )
    if quiet and math.isnan(s.attitude_speed_mps) and s.attitude_waited_s < LONGEST_WAIT_S:
        s.attitude_waited_s += s.attitude_window_s
        _realign(state)
        return
    up = s.attitude_up_b
    for i in range(3):
        up[i] = mean_force[i] / support
        s.attitude_force_b_mps2[i] = mean_force[i]
    tilt_sd = MOVING_TILT_SD_RAD
    if quiet and not s.attitude_speed_mps > REST_SPEED_MPS:
        tilt_sd = REST_TILT_SD_RAD
        s.attitude_bias_var = REST_BIAS_SD_RADPS * REST_BIAS_SD_RADPS
        for i in range(3):
            s.attitude_bias_b_radps[i] = mean_rate[i]
    elif math.isnan(s.attitude_along_mps2):
        tilt_sd = BLIND_TILT_SD_RAD
    else:
        for _ in range(
            8
        ):  # the acceleration's direction in the body needs the attitude that is sought
            _support(state, mean_force, up, up)
    s.attitude_tilt_var = tilt_sd * tilt_sd
    s.attitude_tilt_bias_cov = 0.0


@step
def _support(state: Rows, force: NDArray[Any], up: NDArray[Any], result: NDArray[Any]) -> float:
    """Direction of the specific force less the acceleration over ground, into `result`; its size is
    returned.

    Forward is the nose's horizontal direction, right is forward x up. Where that is unknown, the
    force as it is.
    """
    s = state[0]
    along, across = s.attitude_along_mps2, s.attitude_across_mps2
    level = math.sqrt(max(0.0, 1.0 - up[0] * up[0]))
    x, y, z = force[0], force[1], force[2]
    if not math.isnan(along) and abs(up[0]) < NOSE_UP:
        forward_x, forward_y, forward_z = level, -up[0] * up[1] / level, -up[0] * up[2] / level
        x -= along * forward_x + across * (forward_y * up[2] - forward_z * up[1])
        y -= along * forward_y + across * (forward_z * up[0] - forward_x * up[2])
        z -= along * forward_z + across * (forward_x * up[1] - forward_y * up[0])
    size = math.sqrt(x * x + y * y + z * z)
    if size >= LEAST_SUPPORT_MPS2:
        result[0], result[1], result[2] = x / size, y / size, z / size
    return size


@step
def _correct(state: Rows, sample: Rows, elapsed_s: float) -> None:
    """Two-state Kalman filter, tilt error and gyro bias, equal for every axis across ``up``."""
    s = state[0]
    tilt, cov, bias = s.attitude_tilt_var, s.attitude_tilt_bias_cov, s.attitude_bias_var
    tilt += elapsed_s * (
        2.0 * cov + elapsed_s * bias + GYRO_NOISE_RADPS_RTHZ * GYRO_NOISE_RADPS_RTHZ
    )
    cov += elapsed_s * bias
    bias += elapsed_s * GYRO_WALK_RADPS_RTS * GYRO_WALK_RADPS_RTS
    up, bearing, smooth = s.attitude_up_b, s.attitude_bearing_b, s.attitude_force_b_mps2
    for i in range(3):
        smooth[i] += min(1.0, elapsed_s / VIBRATION_TIME_S) * (
            sample[0].specific_force_b_mps2[i] - smooth[i]
        )
    size = _support(state, sample[0].specific_force_b_mps2, up, bearing)
    if size >= LEAST_SUPPORT_MPS2:
        known = not math.isnan(s.attitude_along_mps2)
        error = BLIND_DISTURBANCE_MPS2
        if known:
            error = (
                DISTURBANCE_MPS2 if s.attitude_speed_mps > REST_SPEED_MPS else REST_DISTURBANCE_MPS2
            )
        shown = math.hypot(s.attitude_along_mps2, s.attitude_across_mps2) if known else 0.0
        wrong = COMPENSATION_ERROR * shown
        excess = math.sqrt(_dot(smooth, smooth)) - math.hypot(s.attitude_gravity_mps2, shown)
        noise = (error * error + wrong * wrong + excess * excess) / (
            s.attitude_gravity_mps2 * s.attitude_gravity_mps2
        )
        noise *= (
            2.0 * DISTURBANCE_TIME_S / elapsed_s
        )  # equal disturbances for a while: as many fewer measurements
        tilt_gain, bias_gain = tilt / (tilt + noise), cov / (tilt + noise)
        bias -= bias_gain * cov
        cov -= tilt_gain * cov
        tilt -= tilt_gain * tilt
        error_x = bearing[1] * up[2] - bearing[2] * up[1]
        error_y = bearing[2] * up[0] - bearing[0] * up[2]
        error_z = bearing[0] * up[1] - bearing[1] * up[0]
        for i, error_i in enumerate((error_x, error_y, error_z)):
            moved = s.attitude_bias_b_radps[i] - bias_gain * error_i
            s.attitude_bias_b_radps[i] = max(-HIGHEST_BIAS_RADPS, min(HIGHEST_BIAS_RADPS, moved))
            up[i] += tilt_gain * (bearing[i] - up[i])
        _normalise(up)
    s.attitude_tilt_var, s.attitude_tilt_bias_cov, s.attitude_bias_var = tilt, cov, bias


@step
def _turn(up: NDArray[Any], rate: NDArray[Any], elapsed_s: float) -> None:
    """`up` as the body sees it after turning at `rate` (Rodrigues' formula for the angle -rate dt)."""
    x, y, z = -rate[0] * elapsed_s, -rate[1] * elapsed_s, -rate[2] * elapsed_s
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-12:
        cosine, sinc, versine = 1.0 - 0.5 * angle2, 1.0, 0.5
    else:
        angle = math.sqrt(angle2)
        cosine, sinc = math.cos(angle), math.sin(angle) / angle
        versine = (1.0 - cosine) / angle2
    along = versine * (x * up[0] + y * up[1] + z * up[2])
    ux = cosine * up[0] + sinc * (y * up[2] - z * up[1]) + along * x
    uy = cosine * up[1] + sinc * (z * up[0] - x * up[2]) + along * y
    uz = cosine * up[2] + sinc * (x * up[1] - y * up[0]) + along * z
    up[0], up[1], up[2] = ux, uy, uz
    _normalise(up)


@step
def _normalise(vector: NDArray[Any]) -> None:
    size = math.sqrt(_dot(vector, vector))
    for i in range(3):
        vector[i] /= size


@step
def _dot(a: NDArray[Any], b: NDArray[Any]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
