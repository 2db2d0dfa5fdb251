"""The error of an inertial vertical channel, and the optimal and robust filters that find it from a
height.

A. Mañero Contreras, C. Hajiyev, "Robust Kalman Filter-Based Fault-Tolerant Integrated
Baro-Inertial-GPS Altimeter", 2019: its equations, for `robust_altimeter` and for the paper's
simulation. The state of an integrated altimeter is (8)

    x = [Delta H_I, Delta W_z, Delta a_z, Delta g, B]

errors of height, climb, acceleration and gravity, and the barometer's bias; its measurement Z = H_I
- h is the mechanised height less a measured one. An altimeter without a barometer (IIG) carries B
along unobserved, so that (14), which is printed with five elements for the four states of (15), is
right as it stands and one code serves both.

The paper iterates every T_d = 0.5 s, with G Q G' = T_d^2 sigma^2. Another interval T takes T T_d
sigma^2, which is the same noise density. Units are metres, seconds and their quotients.
"""

import math
from typing import Any

from numpy.typing import NDArray

from companion.jit import step
from companion.kernels.kalman import correct, spread
from companion.samples import Rows

Array = NDArray[Any]

IBI, IIG = 0, 1
"""Integrated baro-inertial altimeter, integrated inertial-GPS altimeter."""
IBIG, RECOMMENDED = 2, 3
"""Both fused; whichever the fault isolation recommends."""
STATES = 5
R_0_M = 6_378_150.0
G_MPS2 = 9.81
NORMAL_SIGMAS = 3.0
"""What normal operation means in (32)."""


@step
def transit(v: Array, T: float, alpha: float, params: Rows) -> None:
    """v = phi v (11), in place. `params` has beta_g, beta and the flight altitude H."""
    p = params[0]
    height, climb = v[0], v[1]
    v[0] = height + T * climb
    v[1] = climb + 2.0 * G_MPS2 / (R_0_M + p.H) * T * height + T * (v[2] + v[3])
    v[2] *= 1.0 - alpha * T
    v[3] *= 1.0 - p.beta_g * T
    v[4] *= 1.0 - p.beta * T


@step
def extrapolate(x: Array, P: Array, T: float, alpha: float, sigma_a: float, params: Rows) -> None:
    """Over an interval T, in steps of T_d at most: x = phi x (23), P = phi P phi' + G Q G' (27)."""
    p = params[0]
    steps = max(1, math.ceil(T / p.T_d - 1e-6))
    T /= steps
    for _ in range(steps):
        transit(x, T, alpha, params)
        for column in range(STATES):
            transit(P[:, column], T, alpha, params)
        for row in range(STATES):
            transit(P[row, :], T, alpha, params)
        P[2, 2] += T * p.T_d * sigma_a * sigma_a
        P[3, 3] += T * p.T_d * p.sigma_g * p.sigma_g
        P[4, 4] += T * p.T_d * p.sigma_UB * p.sigma_UB


@step
def normal_probability(normalised: float) -> float:
    """prob(1/i) of (32): of a unit normal distribution about the normalised innovation (29), what
    lies within 3."""
    upper = math.erf((NORMAL_SIGMAS - normalised) / math.sqrt(2.0))
    lower = math.erf((-NORMAL_SIGMAS - normalised) / math.sqrt(2.0))
    return 0.5 * (upper - lower)


@step
def innovation(x: Array, H: Array, Z: float) -> float:
    """Delta = Z - H x (24)."""
    predicted = 0.0
    for i in range(STATES):
        predicted += H[i] * x[i]
    return Z - predicted


@step
def take_in(x: Array, P: Array, H: Array, K: Array, Z: float, R: float, robust: bool) -> float:
    """One measurement: x += prob K Delta (28), with prob = 1 in the optimal filter (22); P by (26)
    in both.

    Returns prob(1/i), also for the optimal filter, which does not use it.
    """
    delta = innovation(x, H, Z)
    probability = normal_probability(delta / math.sqrt(spread(P, H) + R))
    correct(x, P, H, K, probability * delta if robust else delta, R)
    return probability


@step
def share(P_ibi: Array, P_iig: Array) -> float:
    """Weight of the baro-inertial altimeter in (19): Var(IIG) / (Var(IBI) + Var(IIG))."""
    return P_iig[0, 0] / (P_ibi[0, 0] + P_iig[0, 0])
