"""Admission of a sample, shared by every estimator: its place in time, its verdict, the counters.

The state of every estimator begins with the fields of `state_dtype`; these steps are the only ones
that write them.
"""

import math
from typing import Any

import numpy as np

from companion.jit import step
from companion.kernels.gnss import HIGHEST_GNSS_M, LOWEST_GNSS_M, gnss_sd_m
from companion.samples import MAX_INSTANCES, Kind, Rows, Verdict

DELAY_HORIZON_US = 1_000_000
"""A sample this much older than the newest one can no longer be placed in time, and is STALE."""

OUTLIER_LOG = -11.0
"""Least log-likelihood of a single height: one in a hundred is anywhere within 600 m."""
HIGHEST_GNSS_SD_M = 50.0
"""A fix that is worse than this says nothing about height."""
LOWEST_DIE_K, HIGHEST_DIE_K = 200.0, 380.0
"""What a pressure sensor's own thermometer can read: no part is rated beyond -40..+85 degC."""
LOWEST_AIR_K, HIGHEST_AIR_K = 180.0, 335.0
"""Beyond what air has ever been below 50 km."""
HIGHEST_FORCE_MPS2, HIGHEST_RATE_RADPS = 200.0, 40.0
"""What an inertial sensor can read: 16 g parts clip at 157 m/s2, 2000 deg/s parts at 35 rad/s."""

USED, GATED, STALE, INVALID, IGNORED = (int(verdict) for verdict in Verdict)
IMU, PRESSURE, GNSS, ATTITUDE, RANGE, AIR, STATUS, HOME, AIRSPEED = (int(kind) for kind in Kind)


def state_dtype(*fields: tuple[Any, ...]) -> np.dtype[Any]:
    """A state's dtype: what every estimator needs to place samples in time and to count them, then
    its own fields."""
    common = [
        ("now_us", "i8"),  # time of the newest sample
        (
            "last_us",
            "i8",
            (len(Kind), MAX_INSTANCES),
        ),  # time of the newest sample of each kind and instance
        ("verdicts", "i8", (len(Kind), len(Verdict))),  # counters
        ("log_likelihood", "f8"),  # of the innovations since the start
        ("innovations", "f8"),  # their number, each with the weight that it counts with
    ]
    return np.dtype(common + list(fields), align=True)


@step
def reset(state: Rows) -> None:
    """Forget every instant: the vehicle's clock starts anew. Counters of verdicts stay."""
    state[0].now_us = -1
    state[0].log_likelihood, state[0].innovations = 0.0, 0.0
    for kind in range(state[0].last_us.shape[0]):
        for instance in range(state[0].last_us.shape[1]):
            state[0].last_us[kind, instance] = -1


@step
def forget(estimate: Rows) -> None:
    """Know nothing any more."""
    estimate[0].altitude_amsl_m = math.nan
    estimate[0].climb_mps = math.nan
    estimate[0].altitude_sd_m = math.nan
    estimate[0].climb_sd_mps = math.nan
    estimate[0].baro_offset_m = math.nan
    estimate[0].innovation_m = math.nan
    estimate[0].height_above_takeoff_m = math.nan
    estimate[0].baro_rate_mps = math.nan
    estimate[0].baro_scale = math.nan
    estimate[0].gnss_offset_m = math.nan
    estimate[0].qnh_pa = math.nan
    estimate[0].qnh_sd_pa = math.nan
    estimate[0].protection_level_m = math.nan
    for i in range(estimate[0].drift_probabilities.size):
        estimate[0].drift_probabilities[i] = math.nan
    for i in range(estimate[0].fault_probabilities.size):
        estimate[0].fault_probabilities[i] = math.nan
    estimate[0].faulty = 0
    estimate[0].faulty_since_us = 0


@step
def tally(state: Rows, kind: int, verdict: int) -> int:
    """Count a verdict, and return it."""
    state[0].verdicts[kind, verdict] += 1
    return verdict


@step
def is_stale(state: Rows, kind: int, instance: int, time_us: int) -> bool:
    """Whether a sample is not newer than the last of its kind and instance, or beyond the delay
    horizon."""
    return (
        time_us <= state[0].last_us[kind, instance] or time_us < state[0].now_us - DELAY_HORIZON_US
    )


@step
def score(state: Rows, innovation: float, S: float) -> None:
    """Count an innovation whose variance the estimator says is S: what `kollsman tune` maximises.

    An outlier counts no more than it would under a hundredth of a uniform density over 600 m.
    """
    value = -0.5 * (math.log(math.tau * S) + innovation * innovation / S)
    state[0].log_likelihood += max(OUTLIER_LOG, value)
    state[0].innovations += 1.0


@step
def place(state: Rows, kind: int, instance: int, time_us: int) -> None:
    """Record that a sample of this time has been taken in."""
    state[0].last_us[kind, instance] = time_us
    state[0].now_us = max(state[0].now_us, time_us)


@step
def judge_pressure(state: Rows, sample: Rows, lowest_pa: float, highest_pa: float) -> int:
    """USED for a pressure that an estimator may take in, else STALE or INVALID. NaN fails the
    range."""
    if not 0 <= sample[0].instance < MAX_INSTANCES:
        return INVALID
    if not lowest_pa <= sample[0].pressure_pa <= highest_pa or sample[0].suspect != 0:
        return INVALID
    if sample[0].die_temperature_k < LOWEST_DIE_K or sample[0].die_temperature_k > HIGHEST_DIE_K:
        return INVALID  # -135 degC comes with a garbage pressure; an unknown temperature passes
    return STALE if is_stale(state, PRESSURE, sample[0].instance, sample[0].time_us) else USED


@step
def judge_gnss(state: Rows, sample: Rows) -> int:
    """USED for a plausible 3D fix, else STALE or INVALID.

    A fix type of 3 alone is no proof: one slid by 700 m on the ground while its reported accuracy
    admitted kilometres.
    """
    if (
        not 0 <= sample[0].instance < MAX_INSTANCES
        or sample[0].fix_type < 3
        or sample[0].suspect != 0
    ):
        return INVALID
    if not LOWEST_GNSS_M <= sample[0].altitude_amsl_m <= HIGHEST_GNSS_M:
        return INVALID
    if gnss_sd_m(sample, 0.0, 0.0) > HIGHEST_GNSS_SD_M:
        return INVALID
    return STALE if is_stale(state, GNSS, sample[0].instance, sample[0].time_us) else USED


@step
def judge_imu(state: Rows, sample: Rows) -> int:
    """USED for finite forces and rates within what a sensor can read, else STALE or INVALID. NaN
    fails the range."""
    if not 0 <= sample[0].instance < MAX_INSTANCES:
        return INVALID
    for axis in range(3):
        if not -HIGHEST_FORCE_MPS2 <= sample[0].specific_force_b_mps2[axis] <= HIGHEST_FORCE_MPS2:
            return INVALID
        if not -HIGHEST_RATE_RADPS <= sample[0].angular_rate_b_radps[axis] <= HIGHEST_RATE_RADPS:
            return INVALID
    return STALE if is_stale(state, IMU, sample[0].instance, sample[0].time_us) else USED


@step
def judge_attitude(state: Rows, sample: Rows) -> int:
    """USED for a roll within half a turn and a pitch within a quarter, else STALE or INVALID. NaN
    fails the range."""
    if not 0 <= sample[0].instance < MAX_INSTANCES:
        return INVALID
    if not -3.1416 <= sample[0].roll_rad <= 3.1416 or not -1.5708 <= sample[0].pitch_rad <= 1.5708:
        return INVALID
    return STALE if is_stale(state, ATTITUDE, sample[0].instance, sample[0].time_us) else USED


@step
def ignore(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """The step of a kind that the estimator does not use: no effect, not counted (the caller
    knows)."""
    return IGNORED
