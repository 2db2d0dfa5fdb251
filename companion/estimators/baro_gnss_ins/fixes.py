"""The GNSS height as a measurement of the GNSS/INS filter: fault detection and re-acquisition."""

import math

import numpy as np

from companion.estimators.baro_gnss_ins.corrections import correct_height
from companion.estimators.baro_gnss_ins.filter import DOWN, GATE, suspend, widen_common
from companion.estimators.baro_gnss_ins.strapdown import POSITION
from companion.estimators.judging import GATED, USED
from companion.jit import step
from companion.kernels.gnss import gnss_sd_m
from companion.samples import Record, Rows

LEAST_DOUBT_S, MOST_DOUBT_S = 10.0, 90.0
DOUBTFUL_GATE = 2.0
"""Gate of fixes that follow a contradiction, in sigma."""
MEAN_S = 5.0
"""Time constant of the mean innovation of GNSS heights; while it is beyond one sigma, they do not
agree."""
DISPUTE_S = 30.0
"""Time constant with which a resolved contradiction leaves the reported spread."""

FIXES = np.dtype(
    [
        ("gnss_sd_m", "f8"),  # reported by the last fix that was used, NaN none
        ("agreed_s", "f8"),  # for how long fixes have agreed, and contradicted since
        ("contradicted_s", "f8"),
        ("innovation_m", "f8"),  # of the last fix, and its mean over those used
        ("mean_innovation_m", "f8"),
        ("jumped", "i8"),  # 1 when the present contradiction began between two fixes
        ("disputed_m", "f8"),  # how far h moved when it was refuted; decays
    ],
    align=True,
)
"""The record of this component."""


@step
def fixes_start(fixes: Record) -> None:
    """Nothing known."""
    fixes.gnss_sd_m, fixes.innovation_m = math.nan, math.nan
    fixes.mean_innovation_m, fixes.disputed_m, fixes.jumped = 0.0, 0.0, 0
    fixes.agreed_s, fixes.contradicted_s = 0.0, 0.0


@step
def resume_fixes(ins: Record, fixes: Record, moved_m2: float) -> None:
    """The first fix after a gap, in which height and b have moved together by this variance. What
    fixes agreed on or contradicted before it is no evidence any more."""
    widen_common(ins.P, moved_m2)
    fixes.agreed_s, fixes.contradicted_s, fixes.mean_innovation_m = 0.0, 0.0, 0.0


@step
def fuse_height(
    ins: Record,
    fixes: Record,
    params: Rows,
    sample: Rows,
    age_s: float,
    elapsed_s: float,
    weight: float,
) -> int:
    """A fix's height: GATED while it contradicts, until that has lasted; then h and b move to it
    together.

    The first fix does so at once. A contradiction that grew slowly (the barometer drifts) needs ten
    seconds. A receiver that jumped must contradict for as long as it had agreed before, half a
    minute at most; and then it stays in the reported spread for a while that one of the two was
    wrong.
    """
    p = params[0]
    down = POSITION + DOWN
    sd_m = gnss_sd_m(sample, p.gnss_sd_floor_m, p.gnss_sd_unknown_m)
    z = sample[0].altitude_amsl_m - ins.track.at[2]
    fixes.innovation_m = z
    elapsed_s = min(elapsed_s, 1.0)
    gate = DOUBTFUL_GATE if fixes.contradicted_s > 0.0 else GATE
    if z * z > gate * gate * (ins.P[down, down] + sd_m * sd_m):
        if fixes.contradicted_s <= 0.0:
            fixes.jumped = 1 if abs(z - fixes.mean_innovation_m) > GATE * sd_m else 0
        fixes.contradicted_s += elapsed_s
        if fixes.gnss_sd_m > 0.0:
            if fixes.contradicted_s < (
                max(LEAST_DOUBT_S, fixes.agreed_s) if fixes.jumped == 1 else LEAST_DOUBT_S
            ):
                return GATED
            fixes.disputed_m = abs(z)
            if fixes.jumped == 0 and ins.inertial == 1:
                suspend(ins, params)
        widen_common(ins.P, z * z)
        fixes.agreed_s, fixes.contradicted_s, fixes.mean_innovation_m = 0.0, 0.0, 0.0
        weight = 1.0
    else:
        fixes.contradicted_s = max(0.0, fixes.contradicted_s - elapsed_s)
        fixes.mean_innovation_m += elapsed_s / MEAN_S * (z - fixes.mean_innovation_m)
        agrees = abs(fixes.mean_innovation_m) <= sd_m
        fixes.agreed_s = min(MOST_DOUBT_S, fixes.agreed_s + elapsed_s) if agrees else 0.0
        fixes.disputed_m -= elapsed_s / DISPUTE_S * fixes.disputed_m
    fixes.gnss_sd_m = sd_m
    correct_height(ins, z, age_s, weight * sd_m * sd_m)
    return USED
