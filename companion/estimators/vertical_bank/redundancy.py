"""Second barometers and receivers: which instance is in use, and how far the others are from it.

The instance in use is the primary while it has values; another one takes over when the primary is
silent for two seconds, or has had no value two seconds after the first of any. A redundant sensor
has an offset from the expected reading of the instance in use, the mean of the last half minute, so
that a take-over makes no step. A redundant receiver also replaces the one in use while that is
excluded.

A redundant sensor shares the weather and the ionosphere with the one in use, so it does not improve
the height while both are healthy: it is not fused then.
"""

import numpy as np

from companion.jit import step
from companion.samples import MAX_INSTANCES, Record

SETTLED = 50
"""number of samples after which the offset of a redundant sensor is known"""
OFFSET_TIME_S = 30.0
SILENT_US = 2_000_000
FAR_SIGMA = 5.0
FORGOTTEN_US = 60_000_000
"""time for which a redundant sensor was far or silent after which its offset begins anew"""
NOT_IN_USE, IN_USE, TAKES_OVER = 0, 1, 2

BAROMETERS, RECEIVERS = 0, 1

SPARES = np.dtype(
    [
        ("active", "i8", (2,)),  # instance in use, -1 none yet
        ("active_us", "i8", (2,)),  # its newest sample
        ("first_us", "i8", (2,)),  # first sample of any instance
        ("offset_m", "f8", (2, MAX_INSTANCES)),
        ("count", "i8", (2, MAX_INSTANCES)),
        ("time_us", "i8", (2, MAX_INSTANCES)),
    ],
    align=True,
)


@step
def spares_start(spares: Record) -> None:
    """No instance heard."""
    for kind in range(2):
        spares.active[kind], spares.active_us[kind], spares.first_us[kind] = -1, -1, -1
        for instance in range(MAX_INSTANCES):
            spares.offset_m[kind, instance] = 0.0
            spares.count[kind, instance] = 0
            spares.time_us[kind, instance] = -1


@step
def choose(spares: Record, kind: int, instance: int, time_us: int) -> int:
    """Whether a sample is of the instance in use, of one that takes over now, or of a redundant
    one."""
    if spares.first_us[kind] < 0:
        spares.first_us[kind] = time_us
    active = spares.active[kind]
    since_us = spares.active_us[kind] if active >= 0 else spares.first_us[kind]
    if instance == active:
        spares.active_us[kind] = max(time_us, since_us)
        return IN_USE
    if (active < 0 and instance == 0) or time_us - since_us > SILENT_US:
        spares.active[kind], spares.active_us[kind] = instance, time_us
        return TAKES_OVER
    return NOT_IN_USE


@step
def follow(spares: Record, kind: int, instance: int, time_us: int, innovation_m: float) -> float:
    """Update the offset of a redundant sensor with its newest reading; the distance of the two."""
    since_us = time_us - spares.time_us[kind, instance]
    if spares.count[kind, instance] == 0 or since_us > FORGOTTEN_US:
        spares.count[kind, instance] = 0
        spares.offset_m[kind, instance] = innovation_m
    away_m = innovation_m - spares.offset_m[kind, instance]
    spares.count[kind, instance] += 1
    share = max(1.0 / spares.count[kind, instance], min(1.0, since_us * 1e-6 / OFFSET_TIME_S))
    spares.offset_m[kind, instance] += share * away_m
    spares.time_us[kind, instance] = time_us
    return away_m


@step
def is_settled(spares: Record, kind: int, instance: int) -> bool:
    """Whether the offset of a redundant sensor is known."""
    return spares.count[kind, instance] >= SETTLED


@step
def offset_m(spares: Record, kind: int, instance: int) -> float:
    """What an instance reads above what the first one in use would."""
    return spares.offset_m[kind, instance] if is_settled(spares, kind, instance) else 0.0
