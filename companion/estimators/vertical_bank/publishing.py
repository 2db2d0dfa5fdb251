"""What the mixture says, as an estimate."""

import math

from companion.estimators.vertical_bank.aids import QNH_PA_PER_M
from companion.estimators.vertical_bank.attribution import (
    BAROMETER,
    fault_probability,
    is_named,
    named_fault,
)
from companion.estimators.vertical_bank.channel import CLIMB, GNSS_BIAS, HEIGHT, OFFSET, RATE, SCALE
from companion.estimators.vertical_bank.mixture import N, mean, variance
from companion.estimators.vertical_bank.protection import alert_limit_m, protection_level_m
from companion.estimators.vertical_bank.takeoff import height_above_takeoff_m
from companion.jit import step
from companion.kernels.atmosphere import qnh_pa
from companion.samples import Rows


@step
def publish(state: Rows, params: Rows, estimate: Rows) -> None:
    """What the mixture says; nothing while nobody has told a height."""
    s, p, e = state[0], params[0], estimate[0]
    if s.baro.seen == 0 and s.gnss.seen == 0:
        return
    bank = s.bank
    e.time_us = bank.now_us
    e.altitude_amsl_m = mean(bank, HEIGHT)
    e.climb_mps = mean(bank, CLIMB)
    e.altitude_sd_m = math.sqrt(variance(bank, HEIGHT) + s.gnss.datum_m2)
    e.climb_sd_mps = math.sqrt(variance(bank, CLIMB))
    e.baro_offset_m = -mean(bank, OFFSET)
    e.baro_rate_mps = mean(bank, RATE)
    e.baro_scale = mean(bank, SCALE)
    e.gnss_offset_m = mean(bank, GNSS_BIAS)
    e.innovation_m = s.gnss.innovation_m
    e.height_above_takeoff_m = height_above_takeoff_m(s.takeoff, bank)
    level_m = protection_level_m(bank, p, e.altitude_sd_m, s.gnss.datum_m2)
    e.protection_level_m = max(level_m, s.gnss.against_m)
    e.alert_limit_m = alert_limit_m(bank, p, s.gnss.datum_m2)
    e.qnh_pa, e.qnh_sd_pa = math.nan, math.nan
    if s.baro.seen == 1 and not is_named(s.named, BAROMETER):
        e.qnh_pa = qnh_pa(s.baro.pressure_pa, e.altitude_amsl_m)
        e.qnh_sd_pa = QNH_PA_PER_M * e.altitude_sd_m
    for j in range(e.drift_probabilities.size):
        e.drift_probabilities[j] = 0.0
    for i in range(N):
        e.drift_probabilities[bank.weather[i]] += bank.weight[i]
    e.faulty = named_fault(s.named)
    e.faulty_since_us = s.named.since_us[e.faulty] if e.faulty > 0 else 0
    for fault in range(1, s.named.since_us.size):
        e.fault_probabilities[fault - 1] = fault_probability(bank, fault)
