"""How hypotheses change into weather: by the chain of the weathers, and by the end of a fault."""

import math

from companion.estimators.vertical_bank.channel import CLIMB, HEIGHT, RATE, SIZE, duplicate
from companion.estimators.vertical_bank.hypotheses import LONGEST_ONSET_S
from companion.estimators.vertical_bank.mixture import (
    BA,
    GN,
    MO,
    RE,
    N,
    baro_is_wrong,
    imu_is_wrong,
    normalise,
    rate_sd_mps,
)
from companion.jit import step
from companion.samples import Record

SWITCH_US = 1_000_000
KNOWN_AGAIN_M = 10.0
"""The offset of a barometer that was wrong is known again when the height is."""


@step
def switch(bank: Record, p: Record, is_stuck: int) -> None:
    """Every second: the weather may change its kind, and faults of seconds end: each weather
    channel restarts from the moments of all that may have become it."""
    elapsed_s = (bank.now_us - bank.switched_us) * 1e-6
    if elapsed_s < SWITCH_US * 1e-6:
        return
    bank.switched_us = bank.now_us
    elapsed_s = min(elapsed_s, LONGEST_ONSET_S)
    change = 1.0 - math.exp(-elapsed_s / p.switching_s)
    for j in range(GN):
        mix_into(bank, p, j, change, elapsed_s, is_stuck)
    for i in range(GN, N):
        bank.weight[i] *= 1.0 - ending(bank, p, i, elapsed_s, is_stuck)
    for j in range(GN):
        duplicate(bank.x[j], bank.P[j], bank.mixed_x[j], bank.mixed_P[j])
    for j in range(GN):
        bank.weight[j] = bank.log_likelihood[j]
    normalise(bank)


@step
def ending(bank: Record, p: Record, i: int, elapsed_s: float, is_stuck: int) -> float:
    """Probability that hypothesis i, no weather, has become weather within `elapsed_s`."""
    if imu_is_wrong(i):
        time_s = p.manoeuvre_time_s if bank.blind == 1 else p.imu_fault_time_s
        return 1.0 - math.exp(-elapsed_s / time_s)
    if BA <= i < MO:
        unknown = bank.P[i, HEIGHT, HEIGHT] > KNOWN_AGAIN_M * KNOWN_AGAIN_M
        is_free = bank.blind == 1 and unknown
        return 0.0 if is_stuck == 1 or is_free else 1.0 - math.exp(-elapsed_s / p.baro_fault_time_s)
    if i >= RE:
        return 1.0 - math.exp(-elapsed_s / p.baro_fault_time_s)
    return 0.0


@step
def share_of(
    bank: Record, p: Record, i: int, j: int, change: float, elapsed_s: float, stuck: int
) -> float:
    """Probability that hypothesis i holds and has become weather j."""
    if i < GN:
        return ((1.0 - change if i == j else 0.0) + change * p.weather_prior[j]) * bank.weight[i]
    return ending(bank, p, i, elapsed_s, stuck) * p.weather_prior[j] * bank.weight[i]


@step
def mix_into(
    bank: Record, p: Record, j: int, change: float, elapsed_s: float, is_stuck: int
) -> None:
    """Moments of weather j after `elapsed_s`, into `mixed_x` and `mixed_P`; its probability into
    `log_likelihood`. What comes out of a fault of the barometer has the drift rate of weather j."""
    total = 0.0
    mixed, cov = bank.mixed_x[j], bank.mixed_P[j]
    for k in range(SIZE):
        mixed[k] = 0.0
        for m in range(SIZE):
            cov[k, m] = 0.0
    for i in range(N):
        if bank.weight[i] == 0.0:
            continue
        share = share_of(bank, p, i, j, change, elapsed_s, is_stuck)
        total += share
        for k in range(SIZE):
            mixed[k] += share * (0.0 if k == RATE and baro_is_wrong(i) else bank.x[i, k])
    bank.log_likelihood[j] = total
    if total <= 0.0:
        return
    for k in range(SIZE):
        mixed[k] /= total
    for i in range(N):
        if bank.weight[i] == 0.0:
            continue
        share = share_of(bank, p, i, j, change, elapsed_s, is_stuck) / total
        if share > 0.0:
            add_moment(bank, p, i, j, share)


@step
def add_moment(bank: Record, p: Record, i: int, j: int, share: float) -> None:
    """Add hypothesis i to the covariance of weather j."""
    x, P, mixed, cov = bank.x[i], bank.P[i], bank.mixed_x[j], bank.mixed_P[j]
    from_fault = baro_is_wrong(i)
    for k in range(SIZE):
        for m in range(k, SIZE):
            if from_fault and RATE in (k, m):
                continue
            cov[k, m] += share * (P[k, m] + (x[k] - mixed[k]) * (x[m] - mixed[m]))
    if from_fault and bank.outage == 1:  # its climb rested on the IMU alone
        cov[CLIMB, CLIMB] += share * p.manoeuvre_mps**2
    if from_fault:
        cov[RATE, RATE] += share * (rate_sd_mps(bank, p, j) ** 2 + mixed[RATE] ** 2)
