"""Which of the two integrated altimeters is published, their fusion (19), (21), and its spread."""

import math
from typing import Any

from numpy.typing import NDArray

from companion.estimators.outage import growth_m2
from companion.estimators.robust_altimeter.altimeters import lost
from companion.estimators.robust_altimeter.error_model import IBI, IBIG, IIG, RECOMMENDED, share
from companion.estimators.robust_altimeter.isolation import (
    CORRELATED_SHARE,
    TRUST_IBI,
    TRUST_IIG,
    expected_apart_m,
)
from companion.jit import step
from companion.samples import Record, Rows

COLUMN_ERROR = 0.035
"""Relative error of a height gained when the air's temperature is off by 10 K of 288."""


@step
def ibi_weight(pair: Record, params: Rows) -> float:
    """Share of IBI in what is published: that of (19), or all, or nothing; NaN when there is
    nothing to publish."""
    publish = params[0].publish
    if publish == RECOMMENDED:
        publish = (
            IBI
            if pair.isolation.trust == TRUST_IBI
            else IIG
            if pair.isolation.trust == TRUST_IIG
            else IBIG
        )
    has_ibi, has_iig = not lost(pair, IBI), not lost(pair, IIG)
    if publish == IBIG and has_ibi and has_iig:
        return share(pair.P[IBI], pair.P[IIG])
    if publish != IIG and has_ibi:
        return 1.0
    if publish != IBI and has_iig:
        return 0.0
    return math.nan


@step
def spread_m(
    pair: Record, params: Rows, outage: Record, ibi: float, now_us: int, datum_sd_m: float
) -> float:
    """Error to expect: P, what GNSS and the datum have in common for minutes, the datum's age, what
    the barometer's error has moved by since the last fix, and the disagreement.

    Where the two altimeters are further apart than these explain, one of them is wrong, and nobody
    knows which. `datum_sd_m` is the spread of a datum without GNSS, NaN once there was a fix.
    """
    if not math.isnan(datum_sd_m):  # IBI alone, on a datum that GNSS has not given
        return math.sqrt(pair.P[IBI, 0, 0] + datum_sd_m * datum_sd_m)
    p = params[0]
    iig, shared = 1.0 - ibi, CORRELATED_SHARE * pair.sigma_gps_m * pair.sigma_gps_m
    drift_m2ps2 = p.pressure_drift_mps * p.pressure_drift_mps + outage.seen_m2ps2
    weather = min(pair.datum.age_s, p.reference_s) ** 2 * drift_m2ps2
    weather += growth_m2(outage, now_us, math.nan)
    variance, apart2 = shared, 0.0
    if ibi > 0.0:
        column = COLUMN_ERROR * (pair.height_m[IBI] - pair.datum.at_m)
        variance += ibi * ibi * (pair.P[IBI, 0, 0] + weather + column * column)
    if iig > 0.0:
        variance += iig * iig * pair.P[IIG, 0, 0]
    if pair.runs[IBI] == 1 and pair.runs[IIG] == 1:
        apart = pair.height_m[IBI] - pair.height_m[IIG]
        apart2 = max(0.0, apart * apart - expected_apart_m(pair) * expected_apart_m(pair))
    return math.sqrt(variance + max(ibi * ibi, iig * iig) * apart2)


@step
def fuse(ibi: float, values: NDArray[Any]) -> float:
    """A quantity of the two altimeters by the weight of the first; the one that counts nothing may
    be NaN."""
    if ibi == 1.0:
        return values[IBI]
    if ibi == 0.0:
        return values[IIG]
    return ibi * values[IBI] + (1.0 - ibi) * values[IIG]
