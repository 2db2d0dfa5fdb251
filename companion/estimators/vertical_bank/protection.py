"""Protection level: the height error that is exceeded only at the allowed risk.

A Gauss-Markov error of correlation time tau leaves +-k sigma at the rate 2 k / (sqrt(2 pi) tau)
exp(-k^2 / 2). The level L solves

    sum over hypotheses of w_i min(1, rate((L - |m_i - m|) / s_i) an hour) = risk

with probability w_i, mean m_i and spread s_i of each, and the mean m of all. So a hypothesis that
is more probable than the risk and says another height widens the level as far as that height.

Above the alert limit the height must not be published. A receiver that reports a large spread is
honest, and the spread has its own limit (`health.sd_lost_m`): it raises the alert limit to the
level of its own spread alone, so that only other hypotheses can exceed it.
"""

import math

from companion.estimators.vertical_bank.channel import HEIGHT
from companion.estimators.vertical_bank.mixture import N, gnss_is_wrong, heaviest, mean
from companion.jit import step
from companion.samples import Record

MOST_STEPS, TOLERANCE = 60, 1e-5
"""The search ends when the level moves by a smaller share than this."""
FURTHEST = 2.0
"""The search takes no longer step outwards than to this many times the level, while none was found
that is exceeded less often than allowed."""
SURE_SIGMA = 1.0
"""An error within a sigma of the level is taken to exceed it."""
OWN_RATIO = 1.25
"""Level of the mixture over that of its most probable hypothesis, when only one says its height."""


@step
def risk_beyond(
    bank: Record, crossings_per_h: float, level_m: float, datum_m2: float
) -> tuple[float, float]:
    """Chance that the height leaves the mean +- `level_m` within an hour, and its derivative by
    the level."""
    centre_m, total, slope = mean(bank, HEIGHT), 0.0, 0.0
    for i in range(N):
        if bank.weight[i] == 0.0:
            continue
        sd_m = math.sqrt(bank.P[i, HEIGHT, HEIGHT] + datum_m2)
        k = (level_m - abs(bank.x[i, HEIGHT] - centre_m)) / sd_m
        chance = crossings_per_h * k * math.exp(-0.5 * k * k) if k > SURE_SIGMA else 1.0
        if chance < 1.0:
            slope += bank.weight[i] * chance * (1.0 / k - k) / sd_m
        total += bank.weight[i] * min(1.0, chance)
    return total, slope


@step
def protection_level_m(bank: Record, p: Record, sd_m: float, datum_m2: float) -> float:
    """The level, m, within one part in a hundred thousand, with the variance of the datum in every
    hypothesis.

    Newton's method for the logarithm of the risk, from the level before, between the levels that
    are known to be too small and large enough: among hypotheses far apart the risk has terraces.
    """
    level = bank.protection_m if bank.protection_m > 0.0 else p.risk_sigma * sd_m
    low, high = 0.0, math.inf
    for _ in range(MOST_STEPS):
        before = level
        chance, slope = risk_beyond(bank, p.crossings_per_h, level, datum_m2)
        over = math.log(chance / p.integrity_risk_probability) if chance > 0.0 else -math.inf
        if over > 0.0:
            low = level
        else:
            high = level
        level -= chance / slope * over if slope < 0.0 else math.nan
        if not low < level < min(high, FURTHEST * before):
            level = 0.5 * (low + high) if high < math.inf else FURTHEST * before
        if abs(level - before) <= TOLERANCE * level:
            break
    bank.protection_m = level
    return level


@step
def alert_limit_m(bank: Record, p: Record, datum_m2: float) -> float:
    """Protection level above which the height must not be published: the one of the settings, or
    more while a receiver is heard that reports a larger spread and is trusted."""
    top = heaviest(bank, 0, N)
    if bank.outage == 1 or gnss_is_wrong(top):
        return float(p.alert_limit_m)
    own_m = p.risk_sigma * math.sqrt(bank.P[top, HEIGHT, HEIGHT] + datum_m2)
    return max(p.alert_limit_m, OWN_RATIO * own_m)
