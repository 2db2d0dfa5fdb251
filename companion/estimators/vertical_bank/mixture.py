"""The pruned Gaussian mixture: few hypotheses about the weather and about faults, one channel each.

A hypothesis has a mode, which is its place in the table (`W` weather, `GN` GNSS wrong, `BA`
barometer wrong, `MO` IMU wrong or an unseen manoeuvre, `BO` barometer and GNSS wrong, `RE` a sensor
returned), a kind of weather, a channel and a probability. A probability of 0 is an empty slot.
`hypotheses` says how they begin and end; here they are propagated, corrected, and read.

Measurements move the probabilities by their likelihood, tempered: ln w += `tempering_ratio` ln L,
as the errors of real sensors are correlated for longer than the channel knows, and untempered
likelihoods prove nonsense. Means and variances are computed when they are read: there is none that
could be out of date.
"""

import math

import numpy as np

from companion.estimators.vertical_bank.baro_terms.timing import largest_climb_mps
from companion.estimators.vertical_bank.channel import (
    ACCEL,
    CLIMB,
    FAST,
    GNSS_BIAS,
    GNSS_RATE,
    HEIGHT,
    OFFSET,
    RATE,
    SCALE,
    SIZE,
    absorb,
    carry,
    dot,
    gather,
    move,
    relax,
)
from companion.estimators.vertical_bank.inertial import begin_stretch, integrate
from companion.jit import step
from companion.kernels.kalman import Array, inflated
from companion.samples import Record

W, GN, BA, MO, BO, RE, N = 0, 3, 7, 10, 11, 13, 15
"""first slot of each mode, and their number"""
LEAST = 1e-8
"""probability below which a hypothesis is dropped"""
LONGEST_STEP_S, MOST_STEPS = 10.0, 100
PLAY_M = 12.0
"""The offset follows the scale this far behind a height that turns: what goes with small ups and
downs, such as airspeed in a phugoid of 10 m, must not be learned as scale."""
SOFT_SIGMA = 3.0
"""no single barometer height moves a channel by more than this many sigma"""
HARD, SOFT, EXPLAINED = 0, 1, 2
"""how a measurement is fused: as it is, as one that may be an outlier, as one that a hypothesis
which takes it for an outlier leaves alone, since another explains it"""
OUTLIER_LOG, FAR_LOG = -4.6, -5.5
"""Log of the share of barometer heights that are anywhere within 600 m, one in a hundred; log of
that density, in the units of `log_density`."""
LEAST_DENSITY, LEAST_LOG = 1.7e-5, -10.1
"""of any measurement: 0.01 / 600 m; `OUTLIER_LOG` + `FAR_LOG`"""

BANK = np.dtype(
    [
        ("x", "f8", (N, SIZE)),
        ("P", "f8", (N, SIZE, SIZE)),
        ("weight", "f8", (N,)),  # probabilities, which sum to 1
        ("log_likelihood", "f8", (N,)),  # of the newest measurement
        ("evidence", "f8"),  # log-likelihood of all measurements under the mixture, tempered
        ("heard", "f8"),  # sum of their tempering
        ("weather", "i8", (N,)),  # which kind
        ("jumped", "i8", (N,)),  # 1 when the receiver's fault came as a jump
        ("home_m", "f8", (N,)),  # where the barometer is wrong: its offset before, and the variance
        ("home_m2", "f8", (N,)),
        ("H", "f8", (SIZE,)),
        ("K", "f8", (SIZE,)),
        ("mixed_x", "f8", (3, SIZE)),
        ("mixed_P", "f8", (3, SIZE, SIZE)),
        ("now_us", "i8"),  # the instant of all channels, -1 before the first measurement
        ("switched_us", "i8"),  # when hypotheses last changed into each other
        ("searched_us", "i8"),  # when slow faults were last supposed
        ("slow_m2", "f8"),  # stationary variance of g, and its correlation time
        ("slow_time_s", "f8"),
        ("fast_m2", "f8"),  # stationary variance of e
        ("measured_qnh_pa", "f8"),  # newest of a reference barometer, NaN none
        ("measured_us", "i8"),  # its time, -1 when there is none or it is old
        ("level_m", "f8"),  # height up to which the offset follows the scale; NaN none
        ("outage", "i8"),  # 1 when there has been no fix for long
        ("unwatched", "i8"),  # 1 when no fix has been near enough in time to watch the barometer
        ("blind", "i8"),  # 1 when the newest stretch had no acceleration
        ("unseen", "f8"),  # probability that the barometer has gone wrong where nothing shows it
        ("slope_mps", "f8"),  # of the smoothed barometer height
        ("climb_mps", "f8"),  # largest of late that both the mixture and the barometer show
        ("path_m", "f8"),  # displacement since the start, without any correction
        ("protection_m", "f8"),  # newest protection level, 0 none
    ],
    align=True,
)


@step
def gnss_is_wrong(i: int) -> bool:
    """Whether hypothesis i says that the receiver is wrong."""
    return GN <= i < BA or BO <= i < RE


@step
def baro_is_wrong(i: int) -> bool:
    """Whether hypothesis i says that the barometer is wrong."""
    return BA <= i < MO or BO <= i < RE


@step
def is_unseen(bank: Record, i: int) -> bool:
    """Whether hypothesis i is of a fault that nothing shows: the barometer went wrong while GNSS is
    away and the vehicle is blind."""
    return i == MO - 1 and bank.outage == 1 and bank.blind == 1


@step
def imu_is_wrong(i: int) -> bool:
    """Whether hypothesis i says that the IMU is wrong, or a manoeuvre was missed."""
    return MO <= i < BO


@step
def rate_sd_mps(bank: Record, p: Record, i: int) -> float:
    """Standard deviation of the barometer's drift rate in the weather of hypothesis i."""
    if bank.measured_us >= 0:
        return float(p.measured_rate_sd_mps[bank.weather[i]])
    return float(p.rate_sd_mps[bank.weather[i]])


@step
def mean(bank: Record, k: int) -> float:
    """Mean of state k."""
    total = 0.0
    for i in range(N):
        total += bank.weight[i] * bank.x[i, k]
    return total


@step
def variance(bank: Record, k: int) -> float:
    """Variance of state k: within the hypotheses and between them."""
    centre, total = mean(bank, k), 0.0
    for i in range(N):
        if bank.weight[i] > 0.0:
            apart = bank.x[i, k] - centre
            total += bank.weight[i] * (bank.P[i, k, k] + apart * apart)
    return total


@step
def expected(bank: Record, H: Array) -> float:
    """Mean of H x."""
    total = 0.0
    for i in range(N):
        if bank.weight[i] > 0.0:
            total += bank.weight[i] * dot(H, bank.x[i])
    return total


@step
def expected_variance(bank: Record, H: Array) -> float:
    """Variance of H x."""
    centre, total = expected(bank, H), 0.0
    for i in range(N):
        if bank.weight[i] > 0.0:
            apart = dot(H, bank.x[i]) - centre
            total += bank.weight[i] * (gather(bank.P[i], H, bank.K) + apart * apart)
    return total


@step
def heaviest(bank: Record, first: int, end: int) -> int:
    """The most probable hypothesis of slots [first, end)."""
    found = first
    for i in range(first, end):
        if bank.weight[i] > bank.weight[found]:
            found = i
    return found


@step
def heaviest_accuser(bank: Record) -> int:
    """The most probable hypothesis that says that the receiver is wrong."""
    return heavier(bank, heaviest(bank, GN, BA), heaviest(bank, BO, RE))


@step
def heaviest_of_wrong_baro(bank: Record) -> int:
    """The most probable hypothesis that says that the barometer is wrong."""
    return heavier(bank, heaviest(bank, BA, MO), heaviest(bank, BO, RE))


@step
def heavier(bank: Record, one: int, other: int) -> int:
    """The more probable of two hypotheses."""
    return other if bank.weight[other] > bank.weight[one] else one


@step
def heaviest_trusting(bank: Record) -> int:
    """The most probable hypothesis that does not say that the receiver is wrong."""
    found = 0
    for i in range(N):
        if not gnss_is_wrong(i) and bank.weight[i] > bank.weight[found]:
            found = i
    return found


@step
def normalise(bank: Record) -> None:
    """Probabilities sum to 1; what is negligible is dropped."""
    total = 0.0
    for i in range(N):
        total += bank.weight[i]
    kept = 0.0
    for i in range(N):
        bank.weight[i] /= total
        if bank.weight[i] < LEAST:
            bank.weight[i] = 0.0
        kept += bank.weight[i]
    for i in range(N):
        bank.weight[i] /= kept


@step
def advance(bank: Record, imu: Record, p: Record, interval_s: float, to_us: int) -> None:
    """Bring every channel to `to_us`, or to where the inertial integrals stand.

    The integrals belong to that instant: a channel left behind it would meet a late fix with those
    of another time, and be wrong by V times the difference, which grows with the flight.
    """
    to_us = max(to_us, imu.until_us)
    integrate(imu, p, interval_s, to_us)
    total_s = (to_us - bank.now_us) * 1e-6
    if bank.now_us >= 0 and total_s > 0.0:
        climb_mps = mean(bank, CLIMB)
        bank.climb_mps = largest_climb_mps(bank.climb_mps, climb_mps, bank.slope_mps, total_s)
        steps = min(MOST_STEPS, int(total_s / LONGEST_STEP_S) + 1)
        dt = total_s / steps
        for _ in range(steps):
            propagate(bank, imu, p, dt, steps)
    if to_us > bank.now_us:
        begin_stretch(imu)
        bank.now_us = to_us


@step
def propagate(bank: Record, imu: Record, p: Record, dt: float, steps: int) -> None:
    """One of `steps` equal steps of every hypothesis to where the inertial integrals stand."""
    dv = imu.gained_v / steps
    dh = imu.gained_h if steps == 1 else 0.5 * dv * dt
    psd = imu.gained_psd / imu.gained_s
    is_blind = imu.seen_s < 0.5 * imu.gained_s
    bank.blind = 1 if is_blind else 0
    keep_fast, keep_gnss = math.exp(-dt / p.fast_time_s), math.exp(-dt / bank.slow_time_s)
    keep_slide = math.exp(-dt / p.slide_time_s)
    keep_ramp = math.exp(-dt / p.baro_fault_rate_time_s)
    drive_m2 = 2.0 * bank.slow_m2 / bank.slow_time_s * dt
    for i in range(N):
        if bank.weight[i] == 0.0:
            continue
        x, P, kind = bank.x[i], bank.P[i], bank.weather[i]
        if imu_is_wrong(i):
            blind = p.blind_psd_m2ps3 * (p.manoeuvre_ratio if is_blind else 1.0)
            moved = move(x, P, dt, 0.0, 0.0, blind)
        else:
            moved = move(x, P, dt, dv, dh, psd)
        bank.path_m += bank.weight[i] * moved
        rate_sd, walk = rate_sd_mps(bank, p, i), p.offset_walk_m_rts
        if baro_is_wrong(i) and not is_unseen(bank, i):  # that one may have ended
            rate_sd, walk = p.baro_fault_rate_mps, p.baro_fault_walk_m_rts
            relax(x, P, RATE, keep_ramp, rate_sd * rate_sd)
        else:
            relax(x, P, RATE, math.exp(-dt / p.rate_time_s[kind]), rate_sd * rate_sd)
        relax(x, P, FAST, keep_fast, bank.fast_m2 * p.gust_ratio[kind] ** 2)
        if gnss_is_wrong(i):
            carry(x, P, GNSS_BIAS, GNSS_RATE, dt)
            slide_sd = 0.0 if bank.jumped[i] == 1 else p.slide_sd_mps
            relax(x, P, GNSS_RATE, keep_slide, slide_sd * slide_sd)
            P[GNSS_BIAS, GNSS_BIAS] += drive_m2
        else:
            relax(x, P, GNSS_BIAS, keep_gnss, bank.slow_m2)
        P[OFFSET, OFFSET] += walk * walk * dt
        P[ACCEL, ACCEL] += p.accel_bias_walk_mps2_rts * p.accel_bias_walk_mps2_rts * dt
        P[SCALE, SCALE] += p.scale_walk_rts * p.scale_walk_rts * dt


@step
def log_density(innovation: float, S: float) -> float:
    """Log of the probability density of an innovation, but for the constant ln(2 pi) / 2."""
    return -0.5 * (math.log(S) + innovation * innovation / S)


@step
def fuse(bank: Record, z: float, R: float, temper: float, is_soft: int) -> None:
    """Correct every hypothesis by z = H x + white of variance R, and its probability by the
    tempered likelihood."""
    fuse_doubtful(bank, z, R, R, temper, is_soft)


@step
def fuse_doubtful(
    bank: Record, z: float, R: float, alone: float, temper: float, is_soft: int
) -> None:
    """As `fuse`, of a measurement that may be an outlier: one by itself has the variance `alone`,
    less than R where it shares an error with those before it. To be an outlier is an event of its
    own for each and not tempered: three in a row are one in a million, though errors last."""
    best, likelihood = -math.inf, 0.0
    for i in range(N):
        if bank.weight[i] == 0.0:
            continue
        innovation = z - dot(bank.H, bank.x[i])
        known = gather(bank.P[i], bank.H, bank.K)
        S = known + R
        value = log_density(innovation, S)
        likelihood += bank.weight[i] * math.exp(value)
        is_outlier = is_soft > HARD and log_density(innovation, known + alone) < LEAST_LOG
        bank.log_likelihood[i] = OUTLIER_LOG + temper * FAR_LOG if is_outlier else temper * value
        if is_soft > HARD:
            S = known + inflated(innovation, S, R, SOFT_SIGMA)
        if not is_outlier or is_soft < EXPLAINED:
            absorb(bank.x[i], bank.P[i], bank.K, innovation, S)
        best = max(best, bank.log_likelihood[i])
    for i in range(N):
        if bank.weight[i] > 0.0:
            bank.weight[i] *= math.exp(bank.log_likelihood[i] - best)
    bank.evidence += temper * math.log(max(LEAST_DENSITY, likelihood / math.sqrt(math.tau)))
    bank.heard += temper
    normalise(bank)


@step
def climb_the_column(bank: Record) -> None:
    """o += s dh, when the mean height has moved beyond the play. At once: an offset that follows in
    steps of metres is a sawtooth that no noise of the model explains."""
    height_m = mean(bank, HEIGHT)
    if math.isnan(bank.level_m):
        bank.level_m = height_m
    apart_m = height_m - bank.level_m
    if abs(apart_m) <= PLAY_M:
        return
    moved_m = apart_m - math.copysign(PLAY_M, apart_m)
    bank.level_m += moved_m
    for i in range(N):
        if bank.weight[i] > 0.0:
            carry(bank.x[i], bank.P[i], OFFSET, SCALE, moved_m)
            bank.home_m[i] += bank.x[i, SCALE] * moved_m


@step
def surprises(bank: Record, z: float, R: float, sigma: float) -> bool:
    """Whether z = H x + white is beyond `sigma` for the most probable hypothesis."""
    top = heaviest(bank, 0, N)
    innovation = z - dot(bank.H, bank.x[top])
    S = R + gather(bank.P[top], bank.H, bank.K)
    return innovation * innovation > sigma * sigma * S


@step
def leaps(bank: Record, z: float, alone: float) -> bool:
    """Whether the most probable hypothesis takes z = H x + white of variance `alone` for an
    outlier."""
    top = heaviest(bank, 0, N)
    S = alone + gather(bank.P[top], bank.H, bank.K)
    return log_density(z - dot(bank.H, bank.x[top]), S) < LEAST_LOG
