"""What a receiver claims of its height: split into a white and a slow part, and what a change of
the claim means."""

import math

from companion.estimators.vertical_bank.channel import GNSS_BIAS, shrink
from companion.estimators.vertical_bank.exclusion import follows_gnss
from companion.estimators.vertical_bank.mixture import CHANNELS
from companion.jit import step
from companion.kernels.gnss import gnss_sd_m
from companion.samples import Rows

MUCH_BETTER = 2.0


@step
def white_fix_m2(params: Rows, sample: Rows) -> float:
    """White variance of a fix: a share of the spread claimed."""
    white_m = params[0].gnss_white_ratio * gnss_sd_m(sample, 0.0, params[0].gnss_sd_unknown_m)
    return max(params[0].gnss_white_floor_m, white_m) ** 2


@step
def slow_fix_m2(params: Rows, sample: Rows) -> float:
    """Slow variance of a fix: another share of it."""
    p = params[0]
    return (
        max(p.gnss_slow_floor_m, p.gnss_slow_ratio * gnss_sd_m(sample, 0.0, p.gnss_sd_unknown_m))
        ** 2
    )


@step
def expect_gnss(state: Rows, params: Rows, slow_m2: float) -> None:
    """The slow variance that a receiver claims now goes to every channel; call it before the fix is
    taken.

    A claim that gets worse adds what it is worse by. One that gets better by `MUCH_BETTER` and more
    says that the error has shrunk with it, though not by how much exactly: it is as new as it is
    smaller. One that gets a little better may get worse again; it is believed as slowly as the
    error changes.
    """
    s = state[0]
    before_m2 = s.gnss_slow_m2
    worse_m2 = max(0.0, slow_m2 - before_m2)
    much_better = slow_m2 * MUCH_BETTER * MUCH_BETTER < before_m2
    if worse_m2 > 0.0 or much_better:
        s.gnss_slow_m2 = slow_m2
    else:
        share = min(1.0, (s.filter_us - s.fix_us) * 1e-6 / params[0].gnss_time_s)
        s.gnss_slow_m2 += share * (slow_m2 - before_m2)
    for i in range(CHANNELS):
        s.steady[i, GNSS_BIAS] = s.gnss_slow_m2
        if much_better:
            left = math.sqrt(slow_m2 / before_m2)
            s.x[i, GNSS_BIAS] *= left
            shrink(s.P[i], GNSS_BIAS, left)
            s.P[i, GNSS_BIAS, GNSS_BIAS] += (1.0 - left * left) * slow_m2
        if follows_gnss(i):
            s.P[i, GNSS_BIAS, GNSS_BIAS] += worse_m2
