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

HALVINGS, DOUBLINGS, FIXED_POINTS = 14, 40, 5
START_SIGMA = 4.0
SURE_SIGMA = 1.0
"""An error within a sigma of the level is taken to exceed it."""
OWN_RATIO = 1.25
"""Level of the mixture over that of its most probable hypothesis, when only one says its height."""


@step
def crossing_risk(crossings_per_h: float, margin_m: float, sd_m: float) -> float:
    """Chance that an error of this spread exceeds `margin_m` within an hour."""
    k = margin_m / sd_m
    if k <= SURE_SIGMA:
        return 1.0
    return min(1.0, crossings_per_h * k * math.exp(-0.5 * k * k))


@step
def risk_beyond(bank: Record, crossings_per_h: float, level_m: float, datum_m2: float) -> float:
    """Chance that the height leaves the mean +- `level_m` within an hour."""
    centre_m, total = mean(bank, HEIGHT), 0.0
    for i in range(N):
        if bank.weight[i] == 0.0:
            continue
        margin_m = level_m - abs(bank.x[i, HEIGHT] - centre_m)
        sd_m = math.sqrt(bank.P[i, HEIGHT, HEIGHT] + datum_m2)
        total += bank.weight[i] * crossing_risk(crossings_per_h, margin_m, sd_m)
    return total


@step
def protection_level_m(
    bank: Record, crossings_per_h: float, risk: float, sd_m: float, datum_m2: float
) -> float:
    """The level, m, within one part in ten thousand, with the variance of the datum in every
    hypothesis."""
    high = START_SIGMA * sd_m
    for _ in range(DOUBLINGS):
        if risk_beyond(bank, crossings_per_h, high, datum_m2) <= risk:
            break
        high *= 1.5
    low = 0.0 if high <= START_SIGMA * sd_m else high / 1.5
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if risk_beyond(bank, crossings_per_h, middle, datum_m2) > risk:
            low = middle
        else:
            high = middle
    return high


@step
def alert_limit_m(
    bank: Record, crossings_per_h: float, risk: float, limit_m: float, datum_m2: float
) -> float:
    """Protection level above which the height must not be published: `limit_m`, or more while a
    receiver is heard that reports a larger spread and is trusted."""
    top = heaviest(bank, 0, N)
    if bank.outage == 1 or gnss_is_wrong(top):
        return limit_m
    k = START_SIGMA
    for _ in range(FIXED_POINTS):  # crossings_per_h k exp(-k^2 / 2) = risk
        k = math.sqrt(2.0 * math.log(crossings_per_h * k / risk))
    return max(limit_m, OWN_RATIO * k * math.sqrt(bank.P[top, HEIGHT, HEIGHT] + datum_m2))
