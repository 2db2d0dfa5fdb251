"""A fix of a receiver: placed, supposed, fused; the first fix, the climb, a second receiver."""

import math

from companion.estimators.judging import GATED, GNSS, IGNORED, USED, judge_gnss, place, tally
from companion.estimators.vertical_bank.aids import fuse_qnh, fuse_temperature, note_place
from companion.estimators.vertical_bank.attribution import (
    EVEN,
    GNSS_HEIGHT,
    fault_probability,
    is_named,
)
from companion.estimators.vertical_bank.baro_terms.timing import timing_m2
from companion.estimators.vertical_bank.barometer import note_speed
from companion.estimators.vertical_bank.beginning import expect_atmosphere, forget_height
from companion.estimators.vertical_bank.channel import (
    CLIMB,
    GNSS_BIAS,
    GNSS_RATE,
    OFFSET,
    dot,
    sees_climb,
    sees_height,
)
from companion.estimators.vertical_bank.cycle import (
    DATUM_SIGMA,
    OUTAGE_S,
    conclude,
    is_blind,
    predict,
)
from companion.estimators.vertical_bank.hypotheses import (
    SURPRISE_SIGMA,
    on_gnss_surprise,
    suppose_after_outage,
)
from companion.estimators.vertical_bank.inertial import (
    forget_manoeuvre,
    is_inertial,
    known_displacement,
    learn_manoeuvre,
)
from companion.estimators.vertical_bank.mixture import (
    LEAST,
    N,
    expected,
    expected_variance,
    fuse,
    gnss_is_wrong,
    heaviest_accuser,
    heaviest_trusting,
    mean,
    normalise,
    surprises,
)
from companion.estimators.vertical_bank.redundancy import (
    FAR_SIGMA,
    NOT_IN_USE,
    RECEIVERS,
    choose,
    follow,
    is_settled,
    offset_m,
)
from companion.estimators.vertical_bank.reported_accuracy import (
    DISCREDIT_LEAST_M,
    DISCREDIT_PROBABILITY,
    PLAIN,
    RTK_FLOAT,
    credited_type,
    datum_m2,
    discredit,
    expect_gnss,
    expected_slow_m2,
    note_fix,
    note_motion,
    note_rest,
    slow_m2,
    slow_time_s,
    stamp_ratio,
    unseen_white_m2,
    white_m2,
)
from companion.estimators.vertical_bank.takeoff import REST_SPEED_MPS, rests
from companion.jit import step
from companion.kernels.attitude import attitude_gnss
from companion.samples import Record, Rows

FIX_INTERVAL_S = 0.2
"""Fixes that come faster share the log-likelihood of one fix in this time."""
FASTEST_CLIMB_MPS = 200.0


@step
def on_gnss(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A fix, which is late and meets the height of its own time: place, predict, suppose, fuse, let
    hypotheses change, publish."""
    s, p, instance, time_us = state[0], params[0], sample[0].instance, sample[0].time_us
    verdict = judge_gnss(state, sample)
    if verdict != USED:
        return tally(state, GNSS, verdict)
    role = choose(s.spares, RECEIVERS, instance, time_us)
    place(state, GNSS, instance, time_us)
    note_place(s.aids, sample[0].latitude_deg, sample[0].longitude_deg)
    if role != NOT_IN_USE:
        attitude_gnss(s.attitude, sample)
        note_speed(s.baro, p, time_us, sample[0].ground_speed_mps, 0)
    predict(state, params, time_us)
    late_s = (s.bank.now_us - time_us) * 1e-6
    fix_m = sample[0].altitude_amsl_m - known_displacement(s.imu, s.bank.now_us, time_us)
    sees_height(s.bank.H, late_s)
    if role == NOT_IN_USE:
        return tally(state, GNSS, on_spare_fix(state, params, sample, estimate, fix_m))
    fix_m -= offset_m(s.spares, RECEIVERS, instance)
    hear_fix(state, params, sample, fix_m, late_s)
    conclude(state, params, estimate)
    return tally(state, GNSS, GATED if is_named(s.named, GNSS_HEIGHT) else USED)


@step
def hear_fix(state: Rows, params: Rows, sample: Rows, fix_m: float, late_s: float) -> None:
    """A fix of the receiver in use, which says the height `fix_m` of now: suppose what would
    explain it, fuse."""
    s, p = state[0], params[0]
    s.bank.H[GNSS_BIAS] = 1.0
    elapsed_s = (s.bank.now_us - s.gnss.used_us) * 1e-6 if s.gnss.seen == 1 else FIX_INTERVAL_S
    note_fix(s.gnss, p, sample, s.bank.path_m)
    fix_type = credited_type(s.gnss, sample, s.bank.now_us)
    R = expect_fix(state, params, sample, fix_type, elapsed_s)
    if s.gnss.seen == 0:
        meet_gnss(state, params, fix_m)
    s.gnss.innovation_m = fix_m - expected(s.bank, s.bank.H)
    watch_manoeuvre(state, params, fix_type, R, elapsed_s)
    if p.integrity == 1 and s.gnss.seen == 1 and s.baro.seen == 1:
        blind = is_blind(state, elapsed_s)
        if elapsed_s > OUTAGE_S:
            suppose_after_outage(s.bank, p, p.outage_fault_probabilities[0 if blind else 1])
        if surprises(s.bank, fix_m, R, SURPRISE_SIGMA):
            error_m = s.gnss.innovation_m
            if discredit(s.gnss, p, fix_type, error_m, DISCREDIT_LEAST_M, s.bank.now_us):
                R = expect_fix(state, params, sample, PLAIN, elapsed_s)
            else:
                on_gnss_surprise(s.bank, p, blind, elapsed_s, fix_type >= RTK_FLOAT)
    s.gnss.seen, s.gnss.used_us = 1, s.bank.now_us
    trusted_m = math.nan
    if fix_type > PLAIN:
        trusted_m = fix_m - dot(s.bank.H, s.bank.x[heaviest_trusting(s.bank)])
    fuse(s.bank, fix_m, R, p.tempering_ratio * min(1.0, elapsed_s / FIX_INTERVAL_S), 0)
    if fix_type > PLAIN:
        doubt_type(state, params, fix_type, trusted_m)
    watch_rest(state, params, sample, fix_type, elapsed_s)
    is_undecided = s.gnss.against_m > 0.0 or slides_unseen(s.bank)
    if s.baro.seen == 1 and (elapsed_s > OUTAGE_S or is_undecided):
        s.bank.H[GNSS_BIAS] = 0.0
        s.gnss.against_m = contradiction_m(s.bank, fix_m, R + s.bank.slow_m2)
    fuse_climb(state, params, sample[0].climb_mps, late_s)


@step
def doubt_type(state: Rows, params: Rows, fix_type: int, trusted_m: float) -> None:
    """Where a fault of a better fix type begins to be probable, but an error that a plain fix may
    have explains as much, the type is discredited: by the size of the fault, or, before the fault
    has a size, by the innovation `trusted_m` of the hypothesis that trusts the receiver. One that
    slides as faults do is no plain fix."""
    s, p = state[0], params[0]
    probability = fault_probability(s.bank, GNSS_HEIGHT)
    wrong, now_us = heaviest_accuser(s.bank), s.bank.now_us
    size_m, rate_mps = s.bank.x[wrong, GNSS_BIAS], s.bank.x[wrong, GNSS_RATE]
    if probability <= DISCREDIT_PROBABILITY or abs(rate_mps) > p.slide_sd_mps:
        return
    if discredit(s.gnss, p, fix_type, size_m, DISCREDIT_LEAST_M, now_us) or (
        probability < EVEN and discredit(s.gnss, p, fix_type, trusted_m, 0.0, now_us)
    ):
        drop_gnss_faults(s.bank)


@step
def drop_gnss_faults(bank: Record) -> None:
    """What spoke for a fault of the receiver is explained otherwise."""
    for i in range(N):
        if gnss_is_wrong(i):
            bank.weight[i] *= LEAST
    normalise(bank)


@step
def expect_fix(state: Rows, params: Rows, sample: Rows, fix_type: int, elapsed_s: float) -> float:
    """Give every hypothesis the slow variance of a fix; its white variance."""
    s, p = state[0], params[0]
    white = white_m2(s.gnss, p, sample, fix_type)
    s.gnss.datum_m2 = datum_m2(sample)
    slow = slow_m2(s.gnss, p, sample, fix_type, white)
    expected_m2 = expected_slow_m2(p, sample, fix_type, white)
    s.bank.slow_time_s = slow_time_s(s.gnss, p, expected_m2, slow)
    expect_gnss(s.bank, p, slow, elapsed_s)
    timing = timing_m2(p.timing_sd_s * stamp_ratio(fix_type), s.bank.climb_mps, elapsed_s)
    return white + unseen_white_m2(s.gnss, p, sample, white) + timing


@step
def watch_rest(state: Rows, params: Rows, sample: Rows, fix_type: int, elapsed_s: float) -> None:
    """What the heights of a vehicle that rests before its take-off show of the receiver. A fault
    shows nothing: counted as usual error, it would let the receiver err by as much aloft."""
    s = state[0]
    is_at_rest = s.takeoff.time_us < 0 and sample[0].ground_speed_mps <= REST_SPEED_MPS
    if not is_at_rest or fault_probability(s.bank, GNSS_HEIGHT) > EVEN:
        note_motion(s.gnss)
    elif rests(s.takeoff, mean(s.bank, CLIMB), sample[0].ground_speed_mps):
        baro_m = s.baro.height_m if s.baro.seen == 1 else 0.0
        note_rest(s.gnss, params[0], sample, fix_type, elapsed_s, baro_m)


@step
def watch_manoeuvre(state: Rows, params: Rows, fix_type: int, R: float, elapsed_s: float) -> None:
    """What a precise fix shows of the motion in a blind stretch before it."""
    s, p = state[0], params[0]
    if fix_type < RTK_FLOAT or not is_blind(state, elapsed_s) or s.gnss.seen == 0:
        forget_manoeuvre(s.imu, p)
        return
    S = R + expected_variance(s.bank, s.bank.H)
    learn_manoeuvre(s.imu, p, elapsed_s, s.gnss.innovation_m * s.gnss.innovation_m / S)


@step
def slides_unseen(bank: Record) -> bool:
    """Whether the receiver is said to slide, and no IMU denies that the vehicle does: a barometer
    whose port is blocked shows the same, for as long."""
    wrong = heaviest_accuser(bank)
    return bank.blind == 1 and bank.weight[wrong] > 0.5 and bank.jumped[wrong] == 0


@step
def contradiction_m(bank: Record, fix_m: float, R: float) -> float:
    """By how much a fix with an error of variance R contradicts the height H x; 0 when it does
    not."""
    away_m = fix_m - expected(bank, bank.H)
    S = R + expected_variance(bank, bank.H)
    return abs(away_m) if away_m * away_m > SURPRISE_SIGMA * SURPRISE_SIGMA * S else 0.0


@step
def meet_gnss(state: Rows, params: Rows, fix_m: float) -> None:
    """The first fix: until now the height rested on the prior of the offset, which would count
    twice."""
    s, p = state[0], params[0]
    far = False
    if s.baro.seen == 1:
        innovation_m = fix_m - expected(s.bank, s.bank.H)
        S = expected_variance(s.bank, s.bank.H)
        far = innovation_m * innovation_m > DATUM_SIGMA * DATUM_SIGMA * S
    forget_height(s.bank)
    if s.baro.seen == 0:
        return
    if far:
        s.aids.known_qnh_pa = math.nan  # of another place, or a slip of the pen
    expect_atmosphere(s.bank, p, fix_m)
    if far:  # the barometer's datum is further off than its prior
        for i in range(N):
            s.bank.P[i, OFFSET, OFFSET] += (s.baro.height_m - fix_m) ** 2
    fuse_qnh(s.aids, s.bank, fix_m)
    fuse_temperature(s.aids, s.bank, p, s.baro.pressure_pa)


@step
def fuse_climb(state: Rows, params: Rows, climb_mps: float, late_s: float) -> None:
    """A GNSS climb, where there is one; what the climb gained since is integrated. It does not move
    probabilities, and is not used while the receiver may be wrong."""
    s, p = state[0], params[0]
    if not -FASTEST_CLIMB_MPS < climb_mps < FASTEST_CLIMB_MPS:
        return
    if fault_probability(s.bank, GNSS_HEIGHT) > 1.0 - p.attribution_probability:
        return
    gained_mps = s.imu.up_mps2 * late_s if is_inertial(s.imu, s.bank.now_us) else 0.0
    sees_climb(s.bank.H, late_s)
    fuse(s.bank, climb_mps + gained_mps, p.gnss_climb_sd_mps * p.gnss_climb_sd_mps, 0.0, 1)


@step
def on_spare_fix(state: Rows, params: Rows, sample: Rows, estimate: Rows, fix_m: float) -> int:
    """A second receiver: it follows the first, and stands in while that is excluded, as one height
    with the slow error of a receiver for each of its correlation times."""
    s, p, instance, time_us = state[0], params[0], sample[0].instance, sample[0].time_us
    if s.gnss.seen == 0:
        return IGNORED
    innovation_m = fix_m - expected(s.bank, s.bank.H)
    if not is_named(s.named, GNSS_HEIGHT):
        follow(s.spares, RECEIVERS, instance, time_us, innovation_m)
        return IGNORED
    if not is_settled(s.spares, RECEIVERS, instance):
        return IGNORED
    fix_type = sample[0].fix_type
    white = white_m2(s.gnss, p, sample, fix_type)
    slow = slow_m2(s.gnss, p, sample, fix_type, white)
    away_m = innovation_m - s.spares.offset_m[RECEIVERS, instance]
    S = white + slow + expected_variance(s.bank, s.bank.H)
    if away_m * away_m > FAR_SIGMA * FAR_SIGMA * S:
        return GATED
    interval_s = max(0.01, (time_us - s.spares.time_us[RECEIVERS, instance]) * 1e-6)
    s.spares.time_us[RECEIVERS, instance] = time_us
    R = (white + slow) * max(1.0, p.gnss_time_s / interval_s)
    fuse(s.bank, fix_m - s.spares.offset_m[RECEIVERS, instance], R, 0.0, 0)
    conclude(state, params, estimate)
    return USED
