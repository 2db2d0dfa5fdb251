"""One vertical channel: eight states, their propagation between measurements, and what each sensor
sees of them.

===========  ========  ============================================================================================
`HEIGHT`     h         geometric height above mean sea level, m
`CLIMB`      v         m/s
`ACCEL`      a         bias of the specific force along up, m/s2: the accelerometer's and that of a tilted attitude
`OFFSET`     o         slow error of the barometer height at the present height, m: pressure level and temperature
`RATE`       r         drift of o, m/s: a Gauss-Markov process, as weather has a rate that lasts for minutes
`FAST`       e         fast error of the barometer height, m: Gauss-Markov, gusts and sensor wander
`SCALE`      s         d(o)/d(h): a column warmer by 1 % makes a barometer read 1 % too little
`GNSS_BIAS`  g         slow error of the GNSS height, m: Gauss-Markov
===========  ========  ============================================================================================

Between measurements, with u the measured upward acceleration,

    h' = v      v' = u - a + white      o' = r + s v + white      r' = -r / tau_r + white      (e, g like r)

The atmosphere's scale enters in local form: o is the offset where the vehicle is, and s tells only
how it changes with height. The offset of an affine atmosphere, o = o_0 + s h, has the same
derivative, but in it o_0 and s are correlated by the height flown at, and a wrong s moves the
datum. For a constant lapse rate the standard atmosphere's error is exactly affine
(`shared/papers/README.md`).

The transition is a product of elementary ones, x_i += c x_j, so that the covariance follows by
`shear`, F P F' without a matrix product.

A measurement of an instant `late_s` ago sees the height of then: with the inertial displacement
known,

    h(t - T) = h - T v - T^2 a / 2 + T V - (S(t) - S(t - T))

where V and S are u integrated once and twice. The last two terms are a number, the others a row H.
"""

import math

from companion.jit import step
from companion.kernels.kalman import Array

HEIGHT, CLIMB, ACCEL, OFFSET, RATE, FAST, SCALE, GNSS_BIAS = range(8)
SIZE = 8
TRUSTED_CLIMB_M2PS2 = 4.0
"""Variance below which a climb may move the offset through the scale: while the climb is still
being found, corrections take back the displacement but not what it did to the offset (a product of
errors, which no covariance shows)."""
UNKNOWN_M2 = 1e8
"""variance of a height that nothing is known about"""


@step
def shear(P: Array, i: int, j: int, c: float) -> None:
    """Covariance after x_i += c x_j."""
    for k in range(SIZE):
        P[i, k] += c * P[j, k]
    for k in range(SIZE):
        P[k, i] += c * P[k, j]


@step
def shrink(P: Array, i: int, keep: float) -> None:
    """Covariance after x_i *= keep."""
    for k in range(SIZE):
        P[i, k] *= keep
        P[k, i] *= keep


@step
def decay(
    keep: Array, dt_s: float, rate_time_s: float, fast_time_s: float, gnss_time_s: float
) -> None:
    """Fill `keep` (8,) with what is left of each state after `dt_s`: 1 but for the Gauss-Markov
    ones."""
    for i in range(SIZE):
        keep[i] = 1.0
    keep[RATE] = math.exp(-dt_s / rate_time_s)
    keep[FAST] = math.exp(-dt_s / fast_time_s)
    keep[GNSS_BIAS] = math.exp(-dt_s / gnss_time_s)


@step
def propagate(
    x: Array,
    P: Array,
    keep: Array,
    steady: Array,
    walk: Array,
    dt_s: float,
    dv: float,
    dh: float,
    psd: float,
) -> float:
    """Over `dt_s`, in which u integrates to `dv` once and to `dh` twice; the displacement h(t + dt)
    - h(t).

    `keep`, `steady` and `walk` (8,): what is left of a state, its stationary variance, and the
    growth of its variance in a second; `psd` is the spectral density of the acceleration's noise,
    m2/s3.
    """
    half = 0.5 * dt_s * dt_s
    moved = x[CLIMB] * dt_s + dh - x[ACCEL] * half
    shear(P, OFFSET, RATE, dt_s)
    felt = moved if P[CLIMB, CLIMB] < TRUSTED_CLIMB_M2PS2 else 0.0
    shear(P, OFFSET, SCALE, felt)
    shear(P, OFFSET, CLIMB, x[SCALE] * dt_s)
    shear(P, OFFSET, ACCEL, -x[SCALE] * half)
    shear(P, HEIGHT, CLIMB, dt_s)
    shear(P, HEIGHT, ACCEL, -half)
    shear(P, CLIMB, ACCEL, -dt_s)
    x[OFFSET] += x[RATE] * dt_s + x[SCALE] * felt
    x[HEIGHT] += moved
    x[CLIMB] += dv - x[ACCEL] * dt_s
    for i in range(SIZE):
        if keep[i] < 1.0:
            shrink(P, i, keep[i])
            x[i] *= keep[i]
            P[i, i] += steady[i] * (1.0 - keep[i] * keep[i])
        else:
            P[i, i] += walk[i] * dt_s
    P[CLIMB, CLIMB] += psd * dt_s
    P[HEIGHT, HEIGHT] += psd * dt_s * dt_s * dt_s / 3.0
    P[HEIGHT, CLIMB] += psd * half
    P[CLIMB, HEIGHT] += psd * half
    return moved


@step
def sees_nothing(H: Array) -> None:
    """A row of zeros."""
    for i in range(SIZE):
        H[i] = 0.0


@step
def sees_height(H: Array, late_s: float) -> None:
    """The row of the height `late_s` ago."""
    sees_nothing(H)
    H[HEIGHT] = 1.0
    H[CLIMB] = -late_s
    H[ACCEL] = -0.5 * late_s * late_s


@step
def sees_climb(H: Array, late_s: float) -> None:
    """The row of the climb `late_s` ago."""
    sees_nothing(H)
    H[CLIMB] = 1.0
    H[ACCEL] = late_s


@step
def dot(H: Array, x: Array) -> float:
    """H x."""
    total = 0.0
    for i in range(SIZE):
        total += H[i] * x[i]
    return total


@step
def gather(P: Array, H: Array, K: Array) -> float:
    """P H' into `K`, and H P H': what is needed to look at an innovation before it is taken in."""
    total = 0.0
    for i in range(SIZE):
        K[i] = 0.0
        for j in range(SIZE):
            K[i] += P[i, j] * H[j]
        total += H[i] * K[i]
    return total


@step
def absorb(x: Array, P: Array, K: Array, innovation: float, S: float) -> None:
    """Take in an innovation of variance S; `K` holds P H' as `gather` left it, and the gain
    afterwards."""
    for i in range(SIZE):
        K[i] /= S
        x[i] += K[i] * innovation
    for i in range(SIZE):
        gained = K[i] * S
        for j in range(i, SIZE):
            P[i, j] -= gained * K[j]
            P[j, i] = P[i, j]


@step
def begin(x: Array, P: Array) -> None:
    """Height unknown, everything else exactly zero."""
    for i in range(SIZE):
        x[i] = 0.0
        for j in range(SIZE):
            P[i, j] = 0.0
    P[HEIGHT, HEIGHT] = UNKNOWN_M2


@step
def forget_height(P: Array) -> None:
    """Height unknown again; what is known of the other states stays."""
    for i in range(SIZE):
        P[HEIGHT, i] = 0.0
        P[i, HEIGHT] = 0.0
    P[HEIGHT, HEIGHT] = UNKNOWN_M2


@step
def expect_baro(x: Array, P: Array, baro_m: float, offset_var: float, scale_var: float) -> None:
    """Prior of a barometer's error where it reads `baro_m`: o = o_0 + s h with o_0 and s
    independent of each other."""
    for i in (OFFSET, SCALE):
        x[i] = 0.0
        for j in range(SIZE):
            P[i, j] = 0.0
            P[j, i] = 0.0
    P[OFFSET, OFFSET] = offset_var + scale_var * baro_m * baro_m
    P[OFFSET, SCALE] = scale_var * baro_m
    P[SCALE, OFFSET] = scale_var * baro_m
    P[SCALE, SCALE] = scale_var


@step
def duplicate(x: Array, P: Array, from_x: Array, from_P: Array) -> None:
    """x, P become those of another channel."""
    for i in range(SIZE):
        x[i] = from_x[i]
        for j in range(SIZE):
            P[i, j] = from_P[i, j]
