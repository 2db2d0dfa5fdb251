"""Isolation of faults between two integrated altimeters, and the datum that the healthy ones share
(`companion.estimators.robust_altimeter.altimeters`).

An altimeter is in doubt when prob(1/i), averaged over a few seconds, is below 0.5, and until the
two agree again. When they part after one has jumped it is that one, when they part fast it is the
barometer; when they part slowly, weather or temperature have moved the barometer's datum. The paper
recommends IBIG while nothing is in doubt, the healthy one of two, and IBIG again when both are in
doubt.
"""

import math

import numpy as np

from companion.estimators.robust_altimeter.error_model import IBI, IIG
from companion.jit import step
from companion.samples import Record, Rows

DOUBT_S = 60.0
"""An altimeter that still disagrees after this time is used again: the difference is a new
datum."""
APART_SIGMAS = 3.0
"""How far apart two altimeters do not agree."""
APART_S, DRIFT_SIGMAS, FAST_SIGMAS = 10.0, 2.0, 6.0
"""Parted for so long and so far without an alarm they have drifted; further, it is too fast for
weather."""
JUMP_NORMAL = 0.9
"""The altimeter whose prob(1/i) was below this when the two parted is the one that moved; weather
does not jump."""
YOUNG_S = 20.0
"""A datum younger than this is not used for isolation."""
SETTLE_S = 5.0
"""For so long a new datum is a plain mean."""
CORRELATED_SHARE = 0.5
"""Share of the variance of a GNSS height that changes too slowly to average out."""
NOBODY = -1
TRUST_IBIG, TRUST_IBI, TRUST_IIG, TRUST_NEITHER = 0, 1, 2, 3
"""Neither is both doubts added: then the fused one again, as the paper has it."""

ISOLATION = np.dtype(
    [
        ("doubt_s", "f8", (2,)),  # for how long the altimeter stays in doubt
        ("apart_s", "f8"),  # for how long the altimeters have been apart
        ("suspect", "i8"),  # which of them had jumped then
        ("trust", "i8"),  # TRUST_IBIG ...
        ("trust_us", "i8"),  # since when
    ],
    align=True,
)
"""The record of the fault isolation."""

DATUM = np.dtype(
    [
        ("offset_m", "f8"),  # barometer less altitude, NaN unknown
        ("age_s", "f8"),
        ("at_m", "f8"),  # height at which it was found
    ],
    align=True,
)
"""The record of the barometer's datum."""


@step
def isolation_start(pair: Record) -> None:
    """No doubt, no datum."""
    pair.isolation.apart_s = 0.0
    pair.isolation.suspect = NOBODY
    pair.isolation.trust = TRUST_IBIG
    pair.isolation.trust_us = -1
    pair.datum.offset_m = math.nan
    pair.datum.age_s = 0.0
    pair.datum.at_m = math.nan


@step
def forget_datum(pair: Record) -> None:
    """The first fix after a gap: what was seen before it, the datum and every doubt, is no evidence
    any more. The next fixes give a new datum."""
    pair.datum.age_s = 0.0
    pair.isolation.apart_s, pair.isolation.suspect = 0.0, NOBODY
    pair.isolation.doubt_s[IBI], pair.isolation.doubt_s[IIG] = 0.0, 0.0


@step
def expected_apart_m(pair: Record) -> float:
    """Spread of the difference of the two altimeters while both are healthy."""
    return math.sqrt(
        pair.P[IBI, 0, 0]
        + pair.P[IIG, 0, 0]
        + CORRELATED_SHARE * pair.sigma_gps_m * pair.sigma_gps_m
    )


@step
def isolate(pair: Record, now_us: int, T: float) -> None:
    """Which altimeter to trust, as the paper's conclusions recommend."""
    sigmas = 0.0
    if pair.runs[IBI] == 1 and pair.runs[IIG] == 1:
        sigmas = abs(pair.height_m[IBI] - pair.height_m[IIG]) / expected_apart_m(pair)
    apart = sigmas > APART_SIGMAS
    for k in range(2):
        doubted = pair.isolation.doubt_s[k] > 0.0
        if pair.normal[k] < 0.5:
            pair.isolation.doubt_s[k] = DOUBT_S
        else:
            pair.isolation.doubt_s[k] = max(0.0, pair.isolation.doubt_s[k] - T) if apart else 0.0
        if doubted and apart and pair.isolation.doubt_s[k] == 0.0:
            pair.datum.age_s = 0.0  # it stays apart: a new datum
    part(pair, T, sigmas)
    before = pair.isolation.trust
    pair.isolation.trust = (TRUST_IIG if pair.isolation.doubt_s[IBI] > 0.0 else 0) + (
        TRUST_IBI if pair.isolation.doubt_s[IIG] > 0.0 else 0
    )
    if pair.isolation.trust != before:
        pair.isolation.trust_us = now_us


@step
def part(pair: Record, T: float, sigmas: float) -> None:
    """Two altimeters that part without an alarm: a fault if one had jumped or it goes fast, else
    weather.

    Weather, and a datum that is too young for isolation, is followed at once.
    """
    alarmed = pair.isolation.doubt_s[IBI] > 0.0 or pair.isolation.doubt_s[IIG] > 0.0
    if pair.isolation.apart_s == 0.0:
        jumped = IIG if pair.normal[IIG] < pair.normal[IBI] else IBI
        pair.isolation.suspect = jumped if pair.normal[jumped] < JUMP_NORMAL else NOBODY
    pair.isolation.apart_s = (
        pair.isolation.apart_s + T
        if sigmas > DRIFT_SIGMAS and not alarmed and pair.datum.age_s > 0.0
        else 0.0
    )
    if pair.isolation.apart_s >= APART_S:
        if pair.isolation.suspect == NOBODY and sigmas > FAST_SIGMAS:
            pair.isolation.suspect = IBI
        if pair.datum.age_s > YOUNG_S and pair.isolation.suspect != NOBODY:
            pair.isolation.doubt_s[pair.isolation.suspect] = DOUBT_S
        else:
            pair.datum.age_s = 0.0
        pair.isolation.apart_s = 0.0


@step
def align_datum(pair: Record, params: Rows, T: float) -> None:
    """Bring the datum of the barometer, and IBI with it, nearer to that of IIG.

    Once it is known, a difference beyond one sigma counts the less the larger it is: it may be a
    fault.
    """
    p = params[0]
    apart = pair.height_m[IBI] - pair.height_m[IIG]
    gain = T / (T + min(pair.datum.age_s, p.reference_s))
    if pair.datum.age_s > SETTLE_S:
        gain *= min(1.0, (expected_apart_m(pair) / apart) ** 2) if apart != 0.0 else 1.0
    pair.datum.age_s += T
    pair.datum.offset_m += gain * apart
    pair.height_m[IBI] -= gain * apart
    pair.datum.at_m += gain * (pair.height_m[IIG] - pair.datum.at_m)
