"""Which of two integrated altimeters is at fault, and the datum that the healthy ones share
(`integrated_altimeters`).

An altimeter is in doubt when prob(1/i), averaged over a few seconds, is below 0.5, and until the
two agree again. When they part after one has jumped it is that one, when they part fast it is the
barometer; when they part slowly, weather or temperature have moved the barometer's datum. The paper
recommends IBIG while nothing is in doubt, the healthy one of two, and IBIG again when both are in
doubt.
"""

import math
from typing import Any

from companion.estimators.robust_altimeter.error_model import IBI, IIG
from companion.jit import step
from companion.samples import Rows

DOUBT_S = 60.0
"""An altimeter that still disagrees after this time is believed: the difference is a new datum."""
APART_SIGMAS = 3.0
"""How far apart two altimeters do not agree."""
APART_S, DRIFT_SIGMAS, FAST_SIGMAS = 10.0, 2.0, 6.0
"""Parted for so long and so far without an alarm they have drifted; further, it is too fast for
weather."""
JUMP_NORMAL = 0.9
"""The altimeter whose prob(1/i) was below this when the two parted is the one that moved; weather
does not jump."""
YOUNG_S = 20.0
"""A datum of this age is no evidence yet."""
SETTLE_S = 5.0
"""For so long a new datum is a plain mean."""
CORRELATED_SHARE = 0.5
"""Of the variance of a GNSS height: what changes too slowly to average out."""
NOBODY = -1
TRUST_IBIG, TRUST_IBI, TRUST_IIG, TRUST_NEITHER = 0, 1, 2, 3
"""Neither is both doubts added: then the fused one again, as the paper has it."""

ISOLATION_FIELDS: tuple[tuple[Any, ...], ...] = (
    ("doubt_s", "f8", (2,)),  # for how long the altimeter stays in doubt
    ("apart_s", "f8"),  # for how long the altimeters have been apart
    ("suspect", "i8"),  # which of them had jumped then
    ("trust", "i8"),  # TRUST_IBIG ...
    ("trust_us", "i8"),  # since when
    ("reference_m", "f8"),  # barometer less altitude
    ("reference_age_s", "f8"),
    ("reference_at_m", "f8"),  # height at which it was found
)
"""The state fields of this component; it also reads the altimeters' own."""


@step
def isolation_start(state: Rows) -> None:
    """No doubt, no datum."""
    s = state[0]
    s.apart_s = 0.0
    s.suspect = NOBODY
    s.trust = TRUST_IBIG
    s.trust_us = -1
    s.reference_m = math.nan
    s.reference_age_s = 0.0
    s.reference_at_m = math.nan


@step
def expected_apart_m(state: Rows) -> float:
    """Spread of the difference of the two altimeters while both are healthy."""
    s = state[0]
    return math.sqrt(
        s.P[IBI, 0, 0] + s.P[IIG, 0, 0] + CORRELATED_SHARE * s.sigma_gps_m * s.sigma_gps_m
    )


@step
def isolate(state: Rows, T: float) -> None:
    """Which altimeter to trust, as the paper's conclusions recommend."""
    s = state[0]
    sigmas = 0.0
    if s.runs[IBI] == 1 and s.runs[IIG] == 1:
        sigmas = abs(s.height_m[IBI] - s.height_m[IIG]) / expected_apart_m(state)
    apart = sigmas > APART_SIGMAS
    for k in range(2):
        doubted = s.doubt_s[k] > 0.0
        if s.normal[k] < 0.5:
            s.doubt_s[k] = DOUBT_S
        else:
            s.doubt_s[k] = max(0.0, s.doubt_s[k] - T) if apart else 0.0
        if doubted and apart and s.doubt_s[k] == 0.0:
            s.reference_age_s = 0.0  # it stays apart: a new datum
    part(state, T, sigmas)
    before = s.trust
    s.trust = (TRUST_IIG if s.doubt_s[IBI] > 0.0 else 0) + (
        TRUST_IBI if s.doubt_s[IIG] > 0.0 else 0
    )
    if s.trust != before:
        s.trust_us = s.now_us


@step
def part(state: Rows, T: float, sigmas: float) -> None:
    """Two altimeters that part without an alarm: a fault if one had jumped or it goes fast, else
    weather.

    Weather, and a datum that is too young to be evidence, is followed at once.
    """
    s = state[0]
    alarmed = s.doubt_s[IBI] > 0.0 or s.doubt_s[IIG] > 0.0
    if s.apart_s == 0.0:
        jumped = IIG if s.normal[IIG] < s.normal[IBI] else IBI
        s.suspect = jumped if s.normal[jumped] < JUMP_NORMAL else NOBODY
    s.apart_s = (
        s.apart_s + T if sigmas > DRIFT_SIGMAS and not alarmed and s.reference_age_s > 0.0 else 0.0
    )
    if s.apart_s >= APART_S:
        if s.suspect == NOBODY and sigmas > FAST_SIGMAS:
            s.suspect = IBI
        if s.reference_age_s > YOUNG_S and s.suspect != NOBODY:
            s.doubt_s[s.suspect] = DOUBT_S
        else:
            s.reference_age_s = 0.0
        s.apart_s = 0.0


@step
def align_datum(state: Rows, params: Rows, T: float) -> None:
    """Bring the datum of the barometer, and IBI with it, nearer to that of IIG.

    Once it is known, a difference beyond one sigma counts the less the larger it is: it may be a
    fault.
    """
    s, p = state[0], params[0]
    apart = s.height_m[IBI] - s.height_m[IIG]
    gain = T / (T + min(s.reference_age_s, p.reference_s))
    if s.reference_age_s > SETTLE_S:
        gain *= min(1.0, (expected_apart_m(state) / apart) ** 2) if apart != 0.0 else 1.0
    s.reference_age_s += T
    s.reference_m += gain * apart
    s.height_m[IBI] -= gain * apart
    s.reference_at_m += gain * (s.height_m[IIG] - s.reference_at_m)
