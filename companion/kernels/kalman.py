"""Kalman filtering of small states, one scalar measurement at a time: pure, compiled, explicit
loops.

Arrays live inside an estimator's state and are changed in place: ``x`` (n,), ``P`` (n, n), the
measurement row ``H`` (n,) and the gain ``K`` (n,), which is written so that it can be looked at.
Uncorrelated measurements of one instant are taken in one after the other, which gives the same
result as all at once.
"""

from typing import Any

from numpy.typing import NDArray

from companion.jit import step

Array = NDArray[Any]


@step
def spread(P: Array, H: Array) -> float:
    """H P H', the variance of H x."""
    total = 0.0
    for i in range(H.size):
        for j in range(H.size):
            total += H[i] * P[i, j] * H[j]
    return total


@step
def correct(x: Array, P: Array, H: Array, K: Array, innovation: float, R: float) -> float:
    """Take in z = H x + v, Var v = R, given the innovation z - H x (or a nonlinear one); the
    innovation's variance S.

    K = P H' / S, x += K innovation, P -= K S K': equal to Joseph's form for this gain, and
    symmetric bit for bit.
    """
    S = R
    for i in range(x.size):
        K[i] = 0.0
        for j in range(x.size):
            K[i] += P[i, j] * H[j]
        S += H[i] * K[i]
    for i in range(x.size):
        K[i] /= S
        x[i] += K[i] * innovation
    for i in range(x.size):
        for j in range(i, x.size):
            P[i, j] -= K[i] * S * K[j]
            P[j, i] = P[i, j]
    return S


@step
def inflated(innovation: float, S: float, R: float, gate: float) -> float:
    """The measurement variance with which an innovation beyond `gate` sigma lies just at `gate`
    sigma, else R.

    Softer than a hard gate: an outlier counts little, and a filter that is wrong still hears of it.
    """
    return R + max(0.0, innovation * innovation / (gate * gate) - S)
