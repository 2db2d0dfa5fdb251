"""How wrong the height may be: the spread with what nobody is blamed for, and the protection level."""

import math

from companion.estimators.vertical_bank.channel import HEIGHT
from companion.estimators.vertical_bank.exclusion import (
    BAROMETER,
    GNSS_HEIGHT,
    is_blamed,
    oldest_copy,
)
from companion.estimators.vertical_bank.mixture import (
    BANK,
    CHANNELS,
    NO_BARO,
    NO_GNSS,
    STIFF,
    TAKEOFF,
)
from companion.jit import step
from companion.samples import Rows


@step
def spread_m(state: Rows) -> float:
    """Spread of the bank's height, with what nobody is blamed for. Call it combined."""
    s = state[0]
    return math.sqrt(s.cov[HEIGHT, HEIGHT] + s.excess_m * s.excess_m)


@step
def protection_level_m(state: Rows, params: Rows) -> float:
    """Height error that is exceeded at the integrity risk of the settings. Call it combined.

    Without a fault it is `protection_sigma` of the spread; with one that nobody has seen, what the
    copy without that sensor says, with `fault_sigma` of its own spread: NaN where a fault is rarer
    than the risk allowed.
    """
    s, p = state[0], params[0]
    level_m = p.protection_sigma * spread_m(state)
    if math.isnan(p.fault_sigma):
        return level_m
    oldest = oldest_copy(state)
    for i in range(BANK, CHANNELS):
        without_gnss = i >= NO_GNSS
        if i in (STIFF, TAKEOFF) or (i == NO_BARO and is_blamed(state, GNSS_HEIGHT)):
            continue
        if without_gnss and (
            i != NO_GNSS + oldest or s.seeded_us[oldest] < 0 or is_blamed(state, BAROMETER)
        ):
            continue
        apart_m = abs(s.average[HEIGHT] - s.x[i, HEIGHT])
        level_m = max(level_m, apart_m + p.fault_sigma * math.sqrt(s.P[i, HEIGHT, HEIGHT]))
    return level_m
