"""Protection level: the height error that is exceeded only at the allowed risk.

A Gauss-Markov error of correlation time tau leaves +-k sigma at the rate 2 k / (sqrt(2 pi) tau)
exp(-k^2 / 2). The level L solves

    sum over hypotheses of w_i min(1, rate((L - |m_i - m|) / s_i) an hour) = risk

with probability w_i, mean m_i and spread s_i of each, and the mean m of all. So a hypothesis that
is more probable than the risk and says another height widens the level as far as that height.
"""

import math

from companion.estimators.vertical_bank.channel import HEIGHT
from companion.estimators.vertical_bank.mixture import N, mean
from companion.jit import step
from companion.samples import Record

HALVINGS, DOUBLINGS = 14, 40
START_SIGMA = 4.0
SURE_SIGMA = 1.0
"""An error within a sigma of the level is taken to exceed it."""


@step
def risk_beyond(bank: Record, crossings_per_h: float, centre_m: float, level_m: float) -> float:
    """Chance that the height leaves `centre_m` +- `level_m` within an hour."""
    total = 0.0
    for i in range(N):
        if bank.weight[i] == 0.0:
            continue
        away_m = abs(bank.x[i, HEIGHT] - centre_m)
        k = (level_m - away_m) / math.sqrt(bank.P[i, HEIGHT, HEIGHT])
        rate = 1.0
        if k > SURE_SIGMA:
            rate = min(1.0, crossings_per_h * k * math.exp(-0.5 * k * k))
        total += bank.weight[i] * rate
    return total


@step
def protection_level_m(bank: Record, crossings_per_h: float, risk: float, sd_m: float) -> float:
    """The level, m, within one part in ten thousand."""
    centre_m = mean(bank, HEIGHT)
    high = START_SIGMA * sd_m
    for _ in range(DOUBLINGS):
        if risk_beyond(bank, crossings_per_h, centre_m, high) <= risk:
            break
        high *= 1.5
    low = 0.0 if high <= START_SIGMA * sd_m else high / 1.5
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if risk_beyond(bank, crossings_per_h, centre_m, middle) > risk:
            low = middle
        else:
            high = middle
    return high
