"""The weather that a ground barometer measures.

The offset of the vehicle's barometer moves as the QNH that a station at rest measures. The
station's own error is constant: it is in the first value, which is fused as any QNH, and not in the
changes after it. While values come, the drift rate of each kind of weather is that of what is left
beside the measured change (`measured_rate_sd_mps`), and each change tells which kind of weather it
is: the likelihood of its rate, tempered as any, moves the probabilities. So the protection level
shrinks in calm weather because storms become improbable, and grows when the station sees one.

After `OLD_US` without a value the weather is unknown again: every rate gets back the spread of its
kind of weather, and the change over the gap is not applied, as GNSS may have shown it meanwhile.
"""

import math

from companion.estimators.vertical_bank.channel import OFFSET, RATE, replace
from companion.estimators.vertical_bank.mixture import N, baro_is_wrong, normalise, rate_sd_mps
from companion.jit import step
from companion.kernels.atmosphere import baro_altitude_m
from companion.samples import Record

OLD_US = 90_000_000
"""Age at which a measured QNH is old; values come once a minute."""
MEASURED_SD_M = 0.2
"""standard deviation of a measured QNH's noise: the median of ten seconds of 2 to 10 Pa"""


@step
def follow_weather(bank: Record, p: Record, qnh_pa: float, time_us: int) -> bool:
    """Take a measured QNH; whether the station's constant error has been fused before."""
    before_pa, before_us = bank.measured_qnh_pa, bank.measured_us
    bank.measured_qnh_pa, bank.measured_us = qnh_pa, time_us
    if before_us < 0:
        for i in range(N):
            if bank.weight[i] > 0.0 and not baro_is_wrong(i):
                rate_sd = rate_sd_mps(bank, p, i)
                replace(bank.x[i], bank.P[i], RATE, 0.0, rate_sd * rate_sd)
        return not math.isnan(before_pa)
    change_m = baro_altitude_m(qnh_pa) - baro_altitude_m(before_pa)
    for i in range(N):
        bank.x[i, OFFSET] += change_m
    weigh_weather(bank, p, change_m, max(1.0, (time_us - before_us) * 1e-6))
    return True


@step
def weigh_weather(bank: Record, p: Record, change_m: float, elapsed_s: float) -> None:
    """Probabilities of the kinds of weather, by a measured change: its rate has the spread of the
    kind, and the noise of both values."""
    noise_mps = math.sqrt(2.0) * MEASURED_SD_M / elapsed_s
    rate_mps, best = change_m / elapsed_s, -math.inf
    for i in range(N):
        sd_mps = p.rate_sd_mps[bank.weather[i]]
        S = sd_mps * sd_mps + noise_mps * noise_mps
        bank.log_likelihood[i] = -0.5 * p.tempering_ratio * (math.log(S) + rate_mps * rate_mps / S)
        best = max(best, bank.log_likelihood[i])
    for i in range(N):
        bank.weight[i] *= math.exp(bank.log_likelihood[i] - best)
    normalise(bank)


@step
def age_weather(bank: Record, p: Record) -> None:
    """A measured QNH that is old: the drift is that of the weather again."""
    if bank.measured_us < 0 or bank.now_us - bank.measured_us <= OLD_US:
        return
    bank.measured_us = -1
    for i in range(N):
        if bank.weight[i] > 0.0 and not baro_is_wrong(i):
            rate_sd = rate_sd_mps(bank, p, i)
            bank.P[i, RATE, RATE] += rate_sd * rate_sd
