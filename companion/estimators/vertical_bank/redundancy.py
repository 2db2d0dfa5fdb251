"""Second barometers and receivers: each with its own offset from the primary, tracked while that is
believed.

A spare follows what the bank expects the primary to read, with an offset that is the mean of the
last half minute. It takes over when the primary is blamed or silent, less its offset; it must be
near what is expected then, as a fault of the air (or of the sky) is common to all. What is near
counts as USED, what is not as GATED.

A second receiver is a witness too: when both agree and the bank is elsewhere, it is the bank that
has drifted.

Errors: a spare shares the weather and the ionosphere with the primary, so it makes the height no
better while both are well: it is not fused then.
"""

import math
from typing import Any

from companion.jit import step
from companion.samples import MAX_INSTANCES, Rows

SETTLED = 50
"""samples until the offset of a spare is known"""
OFFSET_TIME_S = 30.0
WITNESS_US = 2_000_000
SILENT_US = 2_000_000
FAR_SIGMA = 5.0
FORGOTTEN_US = 60_000_000
"""a spare that has been far for so long, or silent, begins anew"""

BARO, RECEIVER = 0, 1
KINDS = (1, 2)
"""of samples: PRESSURE, GNSS"""


def spare_fields() -> tuple[tuple[Any, ...], ...]:
    """The state fields of this component: barometers, then receivers, by instance."""
    return (
        ("spare_offset_m", "f8", (2, MAX_INSTANCES)),
        ("spare_count", "i8", (2, MAX_INSTANCES)),
        ("spare_us", "i8", (2, MAX_INSTANCES)),
        ("spare_away_m", "f8", (2, MAX_INSTANCES)),  # newest reading less offset and expectation
    )


@step
def spares_start(state: Rows) -> None:
    """No spares heard."""
    s = state[0]
    for kind in range(2):
        for instance in range(MAX_INSTANCES):
            s.spare_offset_m[kind, instance] = math.nan
            s.spare_count[kind, instance] = 0
            s.spare_us[kind, instance] = -1
            s.spare_away_m[kind, instance] = math.nan


@step
def compare_spare(state: Rows, kind: int, instance: int, innovation_m: float) -> float:
    """Note a spare's reading against what the primary is expected to read; how far it is away but
    for its offset."""
    s = state[0]
    if (
        s.spare_count[kind, instance] == 0
        or s.filter_us - s.spare_us[kind, instance] > FORGOTTEN_US
    ):
        s.spare_count[kind, instance] = 0
        s.spare_offset_m[kind, instance] = innovation_m
    away_m = innovation_m - s.spare_offset_m[kind, instance]
    s.spare_away_m[kind, instance] = away_m
    return away_m


@step
def follow_spare(state: Rows, kind: int, instance: int, time_us: int) -> None:
    """Move the offset of a spare with its newest reading."""
    s = state[0]
    elapsed_s = max(0.0, (time_us - s.spare_us[kind, instance]) * 1e-6)
    s.spare_count[kind, instance] += 1
    weight = max(1.0 / s.spare_count[kind, instance], min(1.0, elapsed_s / OFFSET_TIME_S))
    if s.spare_us[kind, instance] < 0:
        weight = 1.0
    s.spare_offset_m[kind, instance] += weight * s.spare_away_m[kind, instance]
    s.spare_us[kind, instance] = time_us


@step
def is_settled(state: Rows, kind: int, instance: int) -> bool:
    """Whether the offset of a spare is known."""
    return state[0].spare_count[kind, instance] >= SETTLED


@step
def a_witness_agrees(state: Rows, kind: int, away_m: float, limit_m: float) -> bool:
    """Whether a spare is as far from what is expected as the primary is."""
    s = state[0]
    for instance in range(1, MAX_INSTANCES):
        fresh = s.filter_us - s.last_us[KINDS[kind], instance] <= WITNESS_US
        settled = is_settled(state, kind, instance)
        if settled and fresh and abs(s.spare_away_m[kind, instance] - away_m) <= limit_m:
            return True
    return False
