"""How the mixture begins: at the start, with the first fix, and after a long silence.

Every time the first credible readings decide: what is unknown has the variance of something
unknown, and no time constant.
"""

import math

from companion.estimators.vertical_bank.channel import (
    ACCEL,
    CLIMB,
    FAST,
    GNSS_BIAS,
    GNSS_RATE,
    HEIGHT,
    LAG,
    LIFT,
    PORT,
    RATE,
    UNKNOWN_M2,
    begin,
    duplicate,
    expect_baro,
    replace,
)
from companion.estimators.vertical_bank.mixture import GN, N, heaviest, rate_sd_mps
from companion.jit import step
from companion.samples import Record


@step
def bank_start(bank: Record, p: Record) -> None:
    """Nothing known: three kinds of weather, no fault."""
    bank.now_us, bank.switched_us, bank.searched_us = -1, -1, -1
    bank.slow_m2, bank.slow_time_s = 0.0, p.gnss_time_s
    bank.path_m, bank.level_m, bank.climb_mps = 0.0, math.nan, 0.0
    for k in range(bank.H.size):
        bank.H[k], bank.K[k] = 0.0, 0.0
    for i in range(N):
        begin(bank.x[i], bank.P[i])
        bank.weight[i], bank.log_likelihood[i], bank.weather[i], bank.jumped[i] = 0.0, 0.0, 0, 0
    for j in range(GN):
        begin(bank.mixed_x[j], bank.mixed_P[j])
        P = bank.P[j]
        bank.weather[j], bank.weight[j] = j, p.weather_prior[j]
        P[CLIMB, CLIMB] = p.start_climb_mps * p.start_climb_mps
        P[ACCEL, ACCEL] = p.accel_bias_sd_mps2 * p.accel_bias_sd_mps2
        P[RATE, RATE] = p.rate_sd_mps[j] * p.rate_sd_mps[j]
        P[FAST, FAST] = p.fast_sd_m * p.fast_sd_m
        P[PORT, PORT] = p.port_sd_ratio * p.port_sd_ratio
        P[LIFT, LIFT] = p.lift_sd_m * p.lift_sd_m
        P[LAG, LAG] = p.lag_sd_s * p.lag_sd_s
    bank.outage, bank.blind, bank.unseen, bank.slope_mps = 1, 1, 0.0, 0.0
    bank.evidence, bank.heard, bank.protection_m = 0.0, 0.0, 0.0
    bank.measured_qnh_pa, bank.measured_us = math.nan, -1
    bank.fast_m2 = p.fast_sd_m * p.fast_sd_m
    normalise_priors(bank, p)


@step
def normalise_priors(bank: Record, p: Record) -> None:
    """The weather's prior, and no fault."""
    total = p.weather_prior[0] + p.weather_prior[1] + p.weather_prior[2]
    for i in range(N):
        bank.weight[i] = p.weather_prior[i] / total if i < GN else 0.0


@step
def expect_atmosphere(bank: Record, p: Record, height_m: float) -> None:
    """Prior of the barometer's error at a height, the true one if there is one: on a day 8 % too
    warm, the barometer's own reading in its place makes the scale learned from the first innovation
    8 % too small."""
    bank.level_m = height_m
    offset_var, scale_var = p.offset_sd_m * p.offset_sd_m, p.scale_sd_ratio * p.scale_sd_ratio
    for i in range(N):
        expect_baro(bank.x[i], bank.P[i], height_m, offset_var, scale_var)


@step
def forget_height(bank: Record) -> None:
    """Height unknown again; what is known of the other states stays."""
    for i in range(N):
        replace(bank.x[i], bank.P[i], HEIGHT, bank.x[i, HEIGHT], UNKNOWN_M2)


@step
def resume(bank: Record, p: Record) -> None:
    """After a silence of both sensors: height and climb unknown, the barometer's error as it was
    last known, with the weather since then; no fault."""
    top = heaviest(bank, 0, GN)
    for j in range(GN):
        if bank.weight[j] == 0.0:
            duplicate(bank.x[j], bank.P[j], bank.x[top], bank.P[top])
        rate_m2 = rate_sd_mps(bank, p, j) ** 2
        replace(bank.x[j], bank.P[j], HEIGHT, bank.x[j, HEIGHT], UNKNOWN_M2)
        replace(bank.x[j], bank.P[j], CLIMB, 0.0, p.start_climb_mps * p.start_climb_mps)
        replace(bank.x[j], bank.P[j], RATE, 0.0, rate_m2)
        replace(bank.x[j], bank.P[j], GNSS_BIAS, 0.0, bank.slow_m2)
        replace(bank.x[j], bank.P[j], GNSS_RATE, 0.0, 0.0)
    normalise_priors(bank, p)
