"""Gains of the third-order damping loop (6): stability, poles, and their exact discrete form.

Letters as in `companion.estimators.baro_inertial.damping_loop`.
"""

import math

from companion.jit import step
from companion.kernels.atmosphere import G0_MPS2

TWO_WS2 = 2.0 * G0_MPS2 / 6_371_000.0
"""2 w_s^2, 1/s2."""
BARO_ALONE = (2.0, 1.0, 0.0)
"""Gains without an IMU: critical damping at 1 rad/s."""


@step
def is_stable(K1: float, K2: float, K3: float) -> bool:
    """Whether (6) is stable, by Routh; K3 = 0 leaves a pole at 0, which is let pass."""
    return K1 > 0.0 and K3 >= 0.0 and K1 * (K2 - TWO_WS2) > K3


@step
def poles(K1: float, K2: float, K3: float) -> tuple[float, float, float]:
    """Poles of a stable loop (6), 2 w_s^2 left out: a real one p, and a pair m +- sqrt(d), as (p,
    m, d).

    p lies between -K1 and 0, where the characteristic polynomial changes its sign: bisection to the
    last bit.
    """
    low, high = -K1, 0.0
    for _ in range(200):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        if ((middle + K1) * middle + K2) * middle + K3 < 0.0:
            low = middle
        else:
            high = middle
    mean = -0.5 * (K1 + high)
    return high, mean, mean * mean - (K2 + high * (K1 + high))


@step
def matched_gains(p: float, m: float, d: float, T: float) -> tuple[float, float, float]:
    """alpha, beta / T, gamma / T^2 whose error transition over T has the eigenvalues exp(pole T).

    Of (I - L C) Phi, Phi = [[1, T, T^2/2], [0, 1, T], [0, 0, 1]], the characteristic polynomial f
    has f(0) = alpha - 1, f(1) = gamma, f'(1) = beta + 3/2 gamma. With u = 1 - exp(pole T), of a
    real pole and of a pair, and none of it a difference of nearly equal numbers:
    """
    real = -math.expm1(p * T)
    if d < 0.0:
        decay, half = math.exp(m * T), math.sin(0.5 * T * math.sqrt(-d))
        short = -math.expm1(m * T)
        both, product = (
            2.0 * (short + 2.0 * decay * half * half),
            short * short + 4.0 * decay * half * half,
        )
    else:
        first, second = -math.expm1((m + math.sqrt(d)) * T), -math.expm1((m - math.sqrt(d)) * T)
        both, product = first + second, first * second
    gamma = real * product
    beta = real * both + product - 1.5 * gamma
    return -math.expm1((p + 2.0 * m) * T), beta / T, gamma / (T * T)
