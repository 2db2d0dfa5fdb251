"""One vertical channel: thirteen states, their propagation between measurements, and what each
sensor measures of them.

===========  ======  ===========================================================================
`HEIGHT`     h       geometric height above mean sea level, m
`CLIMB`      v       m/s
`ACCEL`      a       bias of the specific force along up, m/s2: accelerometer and tilted attitude
`OFFSET`     o       slow error of the barometer height where the vehicle is, m
`RATE`       r       drift of o, m/s: Gauss-Markov, as weather has a rate that lasts
`FAST`       e       fast error of the barometer height, m: Gauss-Markov, gusts and sensor wander
`SCALE`      s       d(o)/d(height): a column 1 % too warm makes a barometer read 1 % too little
`PORT`       k_q     static port coefficient: barometer height per metre of velocity head
`LIFT`       k_b     error that comes with flying, m at full lift
`LAG`        T       delay of the barometer, s
`GNSS_BIAS`  g       slow error of the GNSS height, m: Gauss-Markov
`GNSS_RATE`  d       rate of g, m/s: only in channels whose receiver is wrong
`TAKEOFF`    h_0     height of the take-off, m: a copy of h made there
===========  ======  ===========================================================================

Between measurements, with u the measured upward acceleration,

    h' = v      v' = u - a + white      o' = r + white      r' = -r / tau_r + white     (e, g alike)

The atmosphere's scale enters by a known regressor: when the smoothed barometer height has moved by
dz, o += s dz. A product of two estimated states would feed the errors of both to the offset.

The transition is a product of elementary ones, x_i += c x_j, so that the covariance follows by
`shear`, F P F' without a matrix product. P is symmetric: its upper triangle is kept, the entries
P[i, j] with i <= j, and what is below has no meaning.

A measurement of an instant `late_s` ago measures the height of then: with the inertial displacement
known,

    h(t - T) = h - T v - T^2 a / 2 + T V - (S(t) - S(t - T))

where V and S are u integrated once and twice. The last two terms are a number, the others a row H.
"""

from companion.jit import step
from companion.kernels.kalman import Array

(
    HEIGHT,
    CLIMB,
    ACCEL,
    OFFSET,
    RATE,
    FAST,
    SCALE,
    PORT,
    LIFT,
    LAG,
    GNSS_BIAS,
    GNSS_RATE,
    TAKEOFF,
) = range(13)
SIZE = 13
UNKNOWN_M2 = 1e8
"""Variance of a height that nothing is known about, m2."""


@step
def shear(P: Array, i: int, j: int, c: float) -> None:
    """Covariance after x_i += c x_j."""
    P[i, i] += c * P[min(i, j), max(i, j)]
    for k in range(SIZE):
        if k != i:
            P[min(i, k), max(i, k)] += c * P[min(j, k), max(j, k)]
    P[i, i] += c * P[min(i, j), max(i, j)]


@step
def shrink(P: Array, i: int, keep: float) -> None:
    """Covariance after x_i *= keep."""
    for k in range(SIZE):
        P[min(i, k), max(i, k)] *= keep
    P[i, i] *= keep


@step
def relax(x: Array, P: Array, i: int, keep: float, steady: float) -> None:
    """A Gauss-Markov state of stationary variance `steady` after a time that leaves `keep` of
    it."""
    shrink(P, i, keep)
    x[i] *= keep
    P[i, i] += steady * (1.0 - keep * keep)


@step
def move(x: Array, P: Array, dt_s: float, dv: float, dh: float, psd: float) -> float:
    """Height, climb and offset over `dt_s`, in which u integrates to `dv` once and to `dh` twice;
    the displacement h(t + dt) - h(t). `psd`: spectral density of the acceleration's noise,
    m2/s3."""
    half = 0.5 * dt_s * dt_s
    moved = x[CLIMB] * dt_s + dh - x[ACCEL] * half
    shear(P, OFFSET, RATE, dt_s)
    shear(P, HEIGHT, CLIMB, dt_s)
    shear(P, HEIGHT, ACCEL, -half)
    shear(P, CLIMB, ACCEL, -dt_s)
    x[OFFSET] += x[RATE] * dt_s
    x[HEIGHT] += moved
    x[CLIMB] += dv - x[ACCEL] * dt_s
    P[CLIMB, CLIMB] += psd * dt_s
    P[HEIGHT, HEIGHT] += psd * dt_s * dt_s * dt_s / 3.0
    P[HEIGHT, CLIMB] += psd * half
    return moved


@step
def carry(x: Array, P: Array, i: int, j: int, c: float) -> None:
    """x_i += c x_j, with its covariance."""
    x[i] += c * x[j]
    shear(P, i, j, c)


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
    """P H' into `K`, and H P H': what is needed to look at an innovation before it is fused."""
    for i in range(SIZE):
        K[i] = 0.0
    for j in range(SIZE):
        if H[j] != 0.0:
            for i in range(SIZE):
                K[i] += H[j] * P[min(i, j), max(i, j)]
    return dot(H, K)


@step
def absorb(x: Array, P: Array, K: Array, innovation: float, S: float) -> None:
    """Fuse an innovation of variance S; `K` holds P H' as `gather` left it."""
    weight = 1.0 / S
    for i in range(SIZE):
        gain = K[i] * weight
        x[i] += gain * innovation
        for j in range(i, SIZE):
            P[i, j] -= gain * K[j]


@step
def begin(x: Array, P: Array) -> None:
    """Height unknown, everything else exactly zero."""
    for i in range(SIZE):
        x[i] = 0.0
        for j in range(SIZE):
            P[i, j] = 0.0
    P[HEIGHT, HEIGHT] = UNKNOWN_M2


@step
def replace(x: Array, P: Array, i: int, value: float, variance: float) -> None:
    """State i is known anew, independent of everything else."""
    for k in range(SIZE):
        P[min(i, k), max(i, k)] = 0.0
    x[i], P[i, i] = value, variance


@step
def expect_baro(x: Array, P: Array, baro_m: float, offset_var: float, scale_var: float) -> None:
    """Prior of a barometer's error where it reads `baro_m`: o = o_0 + s h with o_0 and s
    independent of each other."""
    replace(x, P, SCALE, 0.0, scale_var)
    replace(x, P, OFFSET, 0.0, offset_var + scale_var * baro_m * baro_m)
    P[OFFSET, SCALE] = scale_var * baro_m


@step
def clone(x: Array, P: Array, i: int, j: int) -> None:
    """State i becomes a copy of state j."""
    x[i] = x[j]
    for k in range(SIZE):
        P[min(i, k), max(i, k)] = P[min(j, k), max(j, k)]
    P[i, i] = P[j, j]


@step
def duplicate(x: Array, P: Array, from_x: Array, from_P: Array) -> None:
    """x, P become those of another channel."""
    for i in range(SIZE):
        x[i] = from_x[i]
        for j in range(i, SIZE):
            P[i, j] = from_P[i, j]
