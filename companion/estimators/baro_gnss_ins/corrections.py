"""The measurements of `companion.estimators.baro_gnss_ins.filter`, as scalars against its seventeen
errors. Letters as there."""

import math

from companion.estimators.baro_gnss_ins.filter import (
    BLIND_S,
    DOWN,
    EAST,
    FASTEST_MPS,
    GATE,
    NORTH,
    SLOWEST_COURSE_MPS,
    UNKNOWN_CLIMB_MPS,
    N,
    course_sd_rad,
    forget_error,
    set_yaw,
    suspend,
)
from companion.estimators.baro_gnss_ins.strapdown import (
    POSITION,
    TILT,
    VELOCITY,
    move,
    wrapped,
    yaw_rad,
)
from companion.estimators.baro_gnss_ins.track import clear
from companion.jit import step
from companion.kernels.earth import meridian_radius_m, normal_radius_m
from companion.kernels.kalman import correct, inflated, spread
from companion.samples import Record, Rows

SLIP_S = 5.0
"""horizontal velocities that contradict for longer mean a wrong attitude"""
SINK_S, WORST_SINK = 3.0, 10.0
"""heights that contradict for longer mean a wrong acceleration; those far beyond the gate count up
to this much more"""
KNOWN_YAW_SD_RAD = 1.0
"""a yaw that has become more uncertain than this is unknown"""
COURSE_TIME_S = 10.0
"""time for which the angle between nose and course stays the same"""
YAWLESS_SD_MPS = 2.0
"""horizontal velocity means little to a filter that does not know in which direction it
accelerates"""
LOST_SDS = 5.0


@step
def _take(ins: Record, z: float, R: float) -> None:
    """One scalar measurement with the row in H, which is cleared; `z` is its innovation against the
    state before dx."""
    for i in range(N):
        z -= ins.H[i] * ins.dx[i]
    correct(ins.dx, ins.P, ins.H, ins.K, z, R)
    for i in range(N):
        ins.H[i] = 0.0


@step
def correct_horizontal(
    ins: Record, params: Rows, sample: Rows, age_s: float, weight: float
) -> None:
    """Latitude, longitude and velocity of a fix against the track at its time (``track_at``).

    `age_s` is how much older the fix is than the state; `weight` >= 1 multiplies the variance of a
    position, as many fixes share one error.
    """
    p = params[0]
    latitude, longitude = (
        math.radians(sample[0].latitude_deg),
        math.radians(sample[0].longitude_deg),
    )
    if abs(latitude) < 1.55 and abs(longitude) <= math.tau:
        sd_m = (
            1.5 * p.gnss_sd_floor_m
            if not sample[0].horizontal_sd_m > 0.0
            else sample[0].horizontal_sd_m
        )
        sd_m = max(p.gnss_sd_floor_m, sd_m)
        height = ins.position[2]
        north_m = (latitude - ins.track.at[0]) * (meridian_radius_m(latitude) + height)
        across_m = (normal_radius_m(latitude) + height) * math.cos(latitude)
        east_m = wrapped(longitude - ins.track.at[1]) * across_m
        far_m = LOST_SDS * math.sqrt(ins.P[NORTH, NORTH] + ins.P[EAST, EAST] + weight * sd_m * sd_m)
        if ins.located == 0 or math.hypot(north_m, east_m) > far_m:
            move(ins.position, north_m, east_m, 0.0)
            clear(ins.track)
            forget_error(ins, NORTH, sd_m * sd_m)
            forget_error(ins, EAST, sd_m * sd_m)
            ins.located = 1
        else:
            for axis in range(2):
                ins.H[POSITION + axis], ins.H[VELOCITY + axis] = 1.0, -age_s
                _take(ins, north_m if axis == NORTH else east_m, weight * sd_m * sd_m)
    speed, course = sample[0].ground_speed_mps, sample[0].course_rad
    if speed < FASTEST_MPS and abs(course) < math.inf:
        _correct_velocity(
            ins, params, sample[0].time_us, speed * math.cos(course), speed * math.sin(course)
        )


@step
def _correct_velocity(
    ins: Record, params: Rows, time_us: int, north_mps: float, east_mps: float
) -> None:
    elapsed_s = (time_us - ins.velocity_us) * 1e-6
    known = ins.velocity_us >= 0 and elapsed_s < BLIND_S
    ins.velocity_us = time_us
    if (
        ins.inertial == 1 and not known
    ):  # what was integrated without GNSS has lost attitude and climb: align anew
        ins.inertial, ins.velocity_n_mps[DOWN] = 0, 0.0
        forget_error(ins, VELOCITY + DOWN, UNKNOWN_CLIMB_MPS * UNKNOWN_CLIMB_MPS)
    R = params[0].gnss_velocity_sd_mps * params[0].gnss_velocity_sd_mps
    if ins.inertial == 1 and ins.yaw_known == 0:
        R += YAWLESS_SD_MPS * YAWLESS_SD_MPS
    slips = False
    for axis in range(2):
        value = north_mps if axis == NORTH else east_mps
        if not known:
            ins.velocity_n_mps[axis] = value
            forget_error(ins, VELOCITY + axis, R)
            continue
        z = value - ins.track.at[3 + axis]
        ins.H[VELOCITY + axis] = 1.0
        S = spread(ins.P, ins.H) + R
        slips = slips or z * z > GATE * GATE * S
        _take(ins, z, inflated(z, S, R, GATE))
    ins.slip_s = ins.slip_s + min(elapsed_s, 1.0) if slips else 0.0
    if ins.inertial == 1 and ins.slip_s > SLIP_S:
        suspend(ins, params)


@step
def correct_height(ins: Record, z: float, age_s: float, R: float) -> None:
    """A height that is `z` above that of the state at its own time."""
    ins.H[POSITION + DOWN], ins.H[VELOCITY + DOWN] = -1.0, age_s
    _take(ins, z, R)


@step
def correct_climb(ins: Record, z: float, R: float) -> None:
    """A climb that is `z` above that of the state."""
    ins.H[VELOCITY + DOWN] = -1.0
    _take(ins, z, R)


@step
def watch_height(ins: Record, params: Rows, z: float, S: float, elapsed_s: float) -> None:
    """Suspend the IMU when the barometer stays beyond the gate on one side: b takes a step, but not
    a runaway."""
    beyond = z * z / (GATE * GATE * S)
    elapsed_s = min(elapsed_s, 1.0)
    if beyond > 1.0:
        ins.sink_s += math.copysign(elapsed_s * min(beyond, WORST_SINK), z)
    else:
        ins.sink_s -= math.copysign(min(elapsed_s, abs(ins.sink_s)), ins.sink_s)
    if ins.inertial == 1 and abs(ins.sink_s) > SINK_S:
        suspend(ins, params)


@step
def correct_yaw(ins: Record, sample: Rows, elapsed_s: float) -> None:
    """The course of a fix as a weak measurement of yaw; without it the gyro's bias would turn the
    nose for ever."""
    if (
        not sample[0].ground_speed_mps > SLOWEST_COURSE_MPS
        or not abs(sample[0].course_rad) < math.inf
    ):
        return
    sd_rad = course_sd_rad(sample[0].ground_speed_mps)
    if ins.P[TILT + DOWN, TILT + DOWN] > KNOWN_YAW_SD_RAD * KNOWN_YAW_SD_RAD:
        ins.yaw_known = 0
    if ins.yaw_known == 0:
        set_yaw(ins, sample[0].course_rad, sd_rad)
        return
    z = wrapped(sample[0].course_rad - yaw_rad(ins.quaternion))
    R = sd_rad * sd_rad
    if z * z <= GATE * GATE * (ins.P[TILT + DOWN, TILT + DOWN] + R):  # else it flies sideways
        ins.H[TILT + DOWN] = 1.0
        _take(ins, z, R * max(1.0, COURSE_TIME_S / elapsed_s))


@step
def correct_tilt(ins: Record, axis: int, z: float, R: float) -> None:
    """A rotation `z` about a north-east-down axis that the attitude lacks."""
    ins.H[TILT + axis] = 1.0
    _take(ins, z, R)
