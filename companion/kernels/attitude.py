"""Roll and pitch, and the vertical acceleration that an inertial vertical channel integrates.

The attitude is kept as the unit vector ``up_b`` in the body frame, which is all of it that the
vertical needs. Two attitudes run side by side.

Our own
    Aligned, turned by the gyros and corrected with gravity by `companion.kernels.levelling`.

The vehicle's
    ATTITUDE as the autopilot sends it, turned by the gyros in between. It is used while it agrees
    with our own: the EKF of one autopilot was 26 degrees wrong while its GNSS was jammed.

An estimator holds an `ATTITUDE_STATE` record in its state and passes that record. It calls
`attitude_start` when it starts, then `attitude_imu`, `attitude_gnss` and, if it may,
`attitude_vehicle` with judged samples (finite, newer than the last), and reads
`up_acceleration_mps2`. Everything is NaN before alignment and while the IMU is too slow
(`imu_can_be_integrated`).

Errors: an accelerometer bias of 0.1 m/s2 tilts by 0.6 degrees, which no gravity reference can tell.
A nose that is not along the track (wind, a multirotor that flies sideways) and GNSS speed that is
0.2-0.4 s late count as disturbances for as long as the manoeuvre lasts. Eötvös and Coriolis (0.006
m/s2 at 60 m/s) are left out of the vertical.
"""

import math

import numpy as np

from companion.jit import step
from companion.kernels.levelling import (
    LEVELLING,
    drop_old_acceleration,
    ground_acceleration,
    level_up,
    levelling_start,
    note_rate,
    realign,
)
from companion.kernels.vectors import dot, turn
from companion.samples import Record, Rows

SLOWEST_TO_START_S = 0.105
SLOWEST_TO_GO_ON_S = 0.13
"""IMU intervals with hysteresis, so that an IMU sent at exactly 10 Hz does not switch on and
off."""
INTERVALS_TO_TRUST = 8
INTERVAL_WEIGHT = 1.0 / 16.0
LONGEST_INTERVAL_S = 1.0
"""Longest interval that counts in the mean: one gap counts as no more than this."""
LONGEST_STEP_S = 0.5
"""Longest gap over which gyros are integrated; after a longer one the alignment begins again."""

VEHICLE_TIMEOUT_US = 2_000_000
VEHICLE_LIMIT_RAD = 0.15
VEHICLE_LIMIT_SDS = 3.0
DISTRUST_S, TRUST_S = 3.0, 10.0
"""Time of disagreement after which the vehicle's attitude is excluded, and of agreement after which
it is used again."""

ATTITUDE_STATE = np.dtype(
    [
        ("time_us", "i8"),  # of the newest IMU sample, -1 none
        ("interval_s", "f8"),  # smoothed
        ("intervals", "i8"),  # how many are in it, up to INTERVALS_TO_TRUST
        ("integrable", "i8"),
        ("own", LEVELLING),
        ("vehicle_us", "i8"),  # newest ATTITUDE, -1 none
        ("vehicle_up_b", "f8", (3,)),
        ("vehicle_trusted", "i8"),
        ("vehicle_doubt_s", "f8"),  # for how long it has contradicted the line above
    ],
    align=True,
)
"""The record of this component."""


@step
def attitude_start(attitude: Record) -> None:
    """Nothing known; the interval too is measured anew."""
    attitude.time_us = -1
    attitude.interval_s = math.nan
    attitude.intervals = 0
    attitude.integrable = 0
    attitude.vehicle_us = -1
    attitude.vehicle_trusted = 1
    attitude.vehicle_doubt_s = 0.0
    for i in range(3):
        attitude.vehicle_up_b[i] = math.nan
    levelling_start(attitude.own)


@step
def imu_can_be_integrated(attitude: Record) -> bool:
    """Whether IMU samples come at about 10 Hz or more (with hysteresis); False until eight
    intervals are known."""
    return attitude.integrable == 1


@step
def up_is_known(attitude: Record) -> bool:
    """Whether there is an attitude, ours or the vehicle's."""
    return not math.isnan(attitude.own.up_b[0]) or vehicle_serves(attitude)


@step
def tilt_sd_rad(attitude: Record) -> float:
    """Spread of our own attitude's error; the accelerometer bias comes on top."""
    return math.sqrt(attitude.own.tilt_var)


@step
def roll_rad(attitude: Record) -> float:
    """Roll of the attitude in use; NaN unknown."""
    return math.atan2(-_up_in_use(attitude, 1), -_up_in_use(attitude, 2))


@step
def pitch_rad(attitude: Record) -> float:
    """Pitch of the attitude in use; NaN unknown."""
    nose = _up_in_use(attitude, 0)
    return math.nan if math.isnan(nose) else math.asin(max(-1.0, min(1.0, nose)))


@step
def up_acceleration_mps2(attitude: Record, sample: Rows) -> float:
    """Upward acceleration: specific force along ``up_b``, less local gravity. NaN while the
    attitude is unknown.

    Call it after `attitude_imu` with the same sample.
    """
    force = sample[0].specific_force_b_mps2
    if vehicle_serves(attitude):
        return dot(force, attitude.vehicle_up_b) - attitude.own.gravity_mps2
    return dot(force, attitude.own.up_b) - attitude.own.gravity_mps2


@step
def attitude_imu(attitude: Record, sample: Rows) -> None:
    """Turn both attitudes with the gyros, correct our own with gravity; align while it is
    unknown."""
    time_us = sample[0].time_us
    elapsed_s = (time_us - attitude.time_us) * 1e-6 if attitude.time_us >= 0 else math.nan
    attitude.time_us = time_us
    drop_old_acceleration(attitude.own, time_us)
    _measure_interval(attitude, elapsed_s)
    note_rate(attitude.own, sample)
    if not elapsed_s <= LONGEST_STEP_S or attitude.integrable == 0:
        realign(attitude.own)
        attitude.own.waited_s = 0.0
        attitude.vehicle_us = -1
        attitude.vehicle_doubt_s = 0.0
        return
    turn(attitude.vehicle_up_b, attitude.own.mean_rate_b_radps, elapsed_s)
    level_up(attitude.own, sample, elapsed_s)


@step
def attitude_gnss(attitude: Record, sample: Rows) -> None:
    """Local gravity, and the acceleration over ground between this fix and the last."""
    ground_acceleration(attitude.own, sample)


@step
def attitude_vehicle(attitude: Record, sample: Rows) -> None:
    """Take the autopilot's attitude, brought to the newest IMU sample, and compare it with our
    own."""
    up = attitude.vehicle_up_b
    up[0] = math.sin(sample[0].pitch_rad)
    up[1] = -math.cos(sample[0].pitch_rad) * math.sin(sample[0].roll_rad)
    up[2] = -math.cos(sample[0].pitch_rad) * math.cos(sample[0].roll_rad)
    last_us, attitude.vehicle_us = attitude.vehicle_us, sample[0].time_us
    since_s = (attitude.time_us - sample[0].time_us) * 1e-6
    if attitude.time_us < 0 or abs(since_s) > LONGEST_STEP_S:
        return  # the IMU is silent, so our own attitude is not up to date
    turn(up, attitude.own.rate_b_radps, since_s)
    if math.isnan(attitude.own.up_b[0]) or last_us < 0:
        return
    limit = VEHICLE_LIMIT_RAD + VEHICLE_LIMIT_SDS * tilt_sd_rad(attitude)
    agree = dot(up, attitude.own.up_b) >= math.cos(min(limit, math.pi))
    if agree == (attitude.vehicle_trusted == 1):
        attitude.vehicle_doubt_s = 0.0
        return
    attitude.vehicle_doubt_s += min(1.0, max(0.0, (sample[0].time_us - last_us) * 1e-6))
    if attitude.vehicle_doubt_s >= (TRUST_S if agree else DISTRUST_S):
        attitude.vehicle_trusted = 1 if agree else 0
        attitude.vehicle_doubt_s = 0.0


@step
def vehicle_serves(attitude: Record) -> bool:
    """Whether the vehicle's attitude is fresh and agrees with our own."""
    fresh = (
        attitude.vehicle_us >= 0 and attitude.time_us - attitude.vehicle_us <= VEHICLE_TIMEOUT_US
    )
    return fresh and attitude.vehicle_trusted == 1


@step
def _up_in_use(attitude: Record, axis: int) -> float:
    return attitude.vehicle_up_b[axis] if vehicle_serves(attitude) else attitude.own.up_b[axis]


@step
def _measure_interval(attitude: Record, elapsed_s: float) -> None:
    """Smooth the interval between IMU stamps and switch ``integrable``."""
    if not elapsed_s > 0.0:
        return
    elapsed_s = min(elapsed_s, LONGEST_INTERVAL_S)
    attitude.intervals = min(INTERVALS_TO_TRUST, attitude.intervals + 1)
    if attitude.intervals == 1:
        attitude.interval_s = elapsed_s
    attitude.interval_s += max(INTERVAL_WEIGHT, 1.0 / attitude.intervals) * (
        elapsed_s - attitude.interval_s
    )
    if attitude.interval_s > SLOWEST_TO_GO_ON_S:
        attitude.integrable = 0
    elif attitude.intervals == INTERVALS_TO_TRUST and attitude.interval_s <= SLOWEST_TO_START_S:
        attitude.integrable = 1
