"""A barometer height: placed, supposed, fused."""

import math

from companion.estimators.judging import (
    GATED,
    IGNORED,
    PRESSURE,
    USED,
    judge_pressure,
    place,
    tally,
)
from companion.estimators.vertical_bank.aids import fuse_qnh, fuse_temperature
from companion.estimators.vertical_bank.attribution import BAROMETER, fault_probability, is_named
from companion.estimators.vertical_bank.baro_terms.lag import (
    lag_climb_mps,
    slope_mps,
    smooth_of_slope,
)
from companion.estimators.vertical_bank.baro_terms.timing import JITTER_S, timing_m2
from companion.estimators.vertical_bank.barometer import (
    has_moved,
    noise_m2,
    note_height,
    note_run,
    repeat_probability,
    rests,
    sees_barometer,
)
from companion.estimators.vertical_bank.beginning import expect_atmosphere
from companion.estimators.vertical_bank.channel import CLIMB, HEIGHT, OFFSET
from companion.estimators.vertical_bank.cycle import DATUM_SIGMA, conclude, is_blind, predict
from companion.estimators.vertical_bank.hypotheses import (
    SURPRISE_SIGMA,
    doubt_repeat,
    keep_unseen,
    on_baro_surprise,
    trust_again,
)
from companion.estimators.vertical_bank.mixture import (
    EXPLAINED,
    SOFT,
    N,
    expected,
    expected_variance,
    fuse_doubtful,
    leaps,
    mean,
    surprises,
)
from companion.estimators.vertical_bank.redundancy import (
    BAROMETERS,
    NOT_IN_USE,
    TAKES_OVER,
    choose,
    follow,
    offset_m,
)
from companion.jit import step
from companion.kernels.atmosphere import baro_altitude_m
from companion.samples import Rows

LOWEST_PA, HIGHEST_PA = 1_000.0, 120_000.0
SILENT_US = 2_000_000
STUCK_DOUBT = 1e-4
"""A barometer is stuck when its repeats alone are as improbable by chance: one that other sensors
contradict already may repeat a value, too."""
BARO_INTERVAL_S = 0.1
"""Barometer heights that come faster share the log-likelihood of one in this time."""


@step
def on_pressure(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A barometer height: place, predict, suppose, fuse, let hypotheses change, publish."""
    s, instance, time_us = state[0], sample[0].instance, sample[0].time_us
    verdict = judge_pressure(state, sample, LOWEST_PA, HIGHEST_PA)
    if verdict != USED:
        return tally(state, PRESSURE, verdict)
    role = choose(s.spares, BAROMETERS, instance, time_us)
    silent_us = time_us - s.baro.heard_us
    place(state, PRESSURE, instance, time_us)
    predict(state, params, time_us)
    late_s = (s.bank.now_us - time_us) * 1e-6
    read_m = baro_altitude_m(sample[0].pressure_pa)
    if role == NOT_IN_USE:
        if s.baro.seen == 1:
            sees_barometer(
                s.bank.H, s.baro, lag_climb_mps(s.bank.slope_mps, mean(s.bank, CLIMB)), late_s
            )
            innovation_m = read_m - expected(s.bank, s.bank.H)
            follow(s.spares, BAROMETERS, instance, time_us, innovation_m)
        return tally(state, PRESSURE, IGNORED)
    if role == TAKES_OVER:
        s.baro.pressure_pa = math.nan
    height_m = read_m - offset_m(s.spares, BAROMETERS, instance)
    s.baro.heard_us = time_us
    is_repeat = sample[0].pressure_pa == s.baro.pressure_pa and silent_us <= SILENT_US
    if is_repeat:
        s.baro.run += 1
        hear_repeat(state, params)
    else:
        if s.baro.stuck == 0 and s.baro.doubt < 1.0:
            trust_again(s.bank, s.baro.doubt)
        note_run(s.baro, mean(s.bank, CLIMB))
        hear_height(state, params, time_us, sample[0].pressure_pa, height_m, silent_us)
    if not is_repeat or rests(s.baro, time_us, s.bank.path_m, mean(s.bank, CLIMB)):
        fuse_height(state, params, silent_us * 1e-6, late_s)
    conclude(state, params, estimate)
    return tally(state, PRESSURE, GATED if is_named(s.named, BAROMETER) else USED)


@step
def fuse_height(state: Rows, params: Rows, elapsed_s: float, late_s: float) -> None:
    """The newest height, `late_s` old and `elapsed_s` after the one before: suppose what would
    explain it, fuse."""
    s, p = state[0], params[0]
    noise = noise_m2(s.baro, p)
    R = noise + timing_m2(p.timing_sd_s, s.bank.climb_mps, elapsed_s)
    alone = noise + timing_m2(p.timing_sd_s, s.bank.climb_mps, JITTER_S)
    sees_barometer(s.bank.H, s.baro, lag_climb_mps(s.bank.slope_mps, mean(s.bank, CLIMB)), late_s)
    watched = p.integrity == 1 and s.gnss.seen == 1
    leapt = leaps(s.bank, s.baro.height_m, alone)
    if leapt:
        s.baro.smooth_m = smooth_of_slope(s.bank.slope_mps, s.baro.height_m)
    if watched and (leapt or surprises(s.bank, s.baro.height_m, R, SURPRISE_SIGMA)):
        blind = is_blind(state, elapsed_s)
        on_baro_surprise(s.bank, p, blind, elapsed_s, s.baro.height_m, R)
    temper = p.tempering_ratio * min(1.0, elapsed_s / BARO_INTERVAL_S)
    kind = EXPLAINED if watched else SOFT
    fuse_doubtful(s.bank, s.baro.height_m, R, alone, temper, kind)
    if watched:
        keep_unseen(s.bank, p)


@step
def hear_height(
    state: Rows, params: Rows, time_us: int, pressure_pa: float, height_m: float, silent_us: int
) -> None:
    """A new value of the barometer in use: its stream, its prior if it is the first, its datum if
    it was silent."""
    s, p = state[0], params[0]
    first = s.baro.seen == 0
    if not first:
        s.bank.slope_mps = slope_mps(s.baro.smooth_m, s.baro.height_m)
    note_height(s.baro, time_us, pressure_pa, height_m, s.bank.path_m)
    if first:
        s.baro.seen = 1
        known = s.gnss.seen == 1
        expect_atmosphere(s.bank, p, mean(s.bank, HEIGHT) if known else height_m)
        fuse_qnh(s.aids, s.bank, mean(s.bank, HEIGHT) if known else height_m)
        fuse_temperature(s.aids, s.bank, p, pressure_pa)
    elif silent_us > SILENT_US:
        sees_barometer(
            s.bank.H,
            s.baro,
            lag_climb_mps(s.bank.slope_mps, mean(s.bank, CLIMB)),
            (s.bank.now_us - time_us) * 1e-6,
        )
        innovation_m = height_m - expected(s.bank, s.bank.H)
        S = noise_m2(s.baro, p) + expected_variance(s.bank, s.bank.H)
        if innovation_m * innovation_m > DATUM_SIGMA * DATUM_SIGMA * S:
            for i in range(N):
                s.bank.P[i, OFFSET, OFFSET] += innovation_m * innovation_m


@step
def hear_repeat(state: Rows, params: Rows) -> None:
    """The same value again, which is improbable once the vehicle has moved."""
    s, p = state[0], params[0]
    if p.integrity == 0 or not has_moved(s.baro, s.bank.path_m, mean(s.bank, CLIMB)):
        return
    on_baro_surprise(s.bank, p, True, BARO_INTERVAL_S, math.nan, 0.0)
    probability = repeat_probability(s.baro)
    s.baro.doubt *= probability
    doubt_repeat(s.bank, probability)
    named = fault_probability(s.bank, BAROMETER) > p.attribution_probability
    if named and s.baro.doubt < STUCK_DOUBT:
        s.baro.stuck = 1
