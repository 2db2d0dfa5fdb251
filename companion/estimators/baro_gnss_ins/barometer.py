"""The barometer as a measurement of the GNSS/INS filter: spike gate, residual (15), row (16)."""

import math

import numpy as np

from companion.estimators.baro_gnss_ins.corrections import watch_height
from companion.estimators.baro_gnss_ins.filter import (
    BARO_BIAS,
    BARO_SCALE,
    DOWN,
    GATE,
    N,
    widen_common,
)
from companion.estimators.baro_gnss_ins.spikes import (
    SCALE_HEIGHT_M,
    SPIKES,
    accepts,
    noise_pa,
    spikes_start,
)
from companion.estimators.baro_gnss_ins.strapdown import POSITION, VELOCITY
from companion.estimators.judging import GATED, USED
from companion.estimators.setting import indicated_m, indicated_sd_m, note_level, waits_for_level
from companion.jit import step
from companion.kernels.atmosphere import geopotential_m
from companion.kernels.kalman import Array, correct, inflated, spread
from companion.samples import Record, Rows

HELD_M = 10.0
"""h_m of (16) is held while the altitude is this near: s is known well enough for that."""
STEP_SAMPLES = 15

BAROMETER = np.dtype(
    [
        ("spikes", SPIKES),
        ("pressure_pa", "f8"),  # the last one, NaN none
        ("h_p_m", "f8"),  # its altitude
        ("h_m", "f8"),  # the altitude in H, held in level flight
        ("one_sided", "i8"),  # innovations beyond the gate in a row, negative on the lower side
    ],
    align=True,
)
"""The record of this component."""


@step
def barometer_start(baro: Record, params: Rows) -> None:
    """Nothing known."""
    spikes_start(baro.spikes, params[0].spike_gate_pa)
    baro.pressure_pa, baro.h_p_m, baro.h_m = math.nan, math.nan, math.nan
    baro.one_sided = 0


@step
def is_spike(ins: Record, baro: Record, params: Rows, time_us: int) -> bool:
    """Whether the gate refuses the newest pressure. A jump that the gate accepts widens b."""
    if accepts(baro.spikes, time_us, baro.pressure_pa, params[0].spike_gate_pa):
        return False
    jump_m = baro.spikes.jump_pa * SCALE_HEIGHT_M / baro.pressure_pa
    ins.P[BARO_BIAS, BARO_BIAS] += jump_m * jump_m
    return True


@step
def correct_baro(
    ins: Record,
    baro: Record,
    params: Rows,
    dt_b: float,
    elapsed_s: float,
    is_news: bool,
    gnss_serves: bool,
) -> int:
    """The residual z of (15) with the row H of (16); `dt_b` is the barometer's time less the
    state's.

    GATED is only what repeats an old value and contradicts the state.
    """
    h_p, H = baro.h_p_m, ins.H
    z = h_p - (ins.position[2] - ins.velocity_n_mps[DOWN] * dt_b - ins.b_m - ins.s * h_p)
    expected_m = (ins.position[2] - ins.velocity_n_mps[DOWN] * dt_b - ins.b_m) / (1.0 + ins.s)
    if not abs(expected_m - baro.h_m) <= HELD_M:
        baro.h_m = expected_m
    H[POSITION + DOWN], H[VELOCITY + DOWN], H[BARO_BIAS], H[BARO_SCALE] = (
        -1.0,
        -dt_b,
        -1.0,
        -baro.h_m,
    )
    sd_m = max(
        params[0].baro_sd_m, noise_pa(baro.spikes, elapsed_s) * SCALE_HEIGHT_M / baro.pressure_pa
    )
    R = sd_m * sd_m
    S = spread(ins.P, H) + R
    beyond = z * z > GATE * GATE * S
    if is_news:
        side = 1 if z > 0.0 else -1
        baro.one_sided = (
            (baro.one_sided + side if baro.one_sided * side > 0 else side) if beyond else 0
        )
        if abs(baro.one_sided) >= STEP_SAMPLES:
            ins.P[BARO_BIAS, BARO_BIAS] += z * z
            S += z * z
            baro.one_sided = 0
        if params[0].calibrates_only == 1 and gnss_serves:
            calibrate(ins, H, z, inflated(z, S, R, GATE))
        else:
            correct(ins.dx, ins.P, H, ins.K, z, inflated(z, S, R, GATE))
        watch_height(ins, params, z, S, elapsed_s)
    for i in range(H.size):
        H[i] = 0.0
    return GATED if beyond and not is_news else USED


@step
def calibrate(ins: Record, H: Array, z: float, R: float) -> None:
    """Correct b and s alone with a residual, and leave all other errors as they are (Schmidt).

    The gain of every other error is 0; P = (I - K H) P (I - K H)' + K R K'.
    """
    S = R
    for i in range(N):
        ins.K[i] = 0.0
        for j in range(N):
            ins.K[i] += ins.P[i, j] * H[j]
        S += H[i] * ins.K[i]
    # With PH = P H' and a gain k that is PH / S for b and s, 0 elsewhere,
    # P - k PH' - PH k' + k S k' changes only the rows and columns of b and s.
    for i in range(N):
        for j in range(i + 1):
            k_i = ins.K[i] / S if i >= BARO_BIAS else 0.0
            k_j = ins.K[j] / S if j >= BARO_BIAS else 0.0
            ins.P[i, j] += -k_i * ins.K[j] - ins.K[i] * k_j + k_i * S * k_j
            ins.P[j, i] = ins.P[i, j]
    for i in range(BARO_BIAS, N):
        ins.dx[i] += ins.K[i] / S * z


@step
def correct_offset(ins: Record, baro: Record, setting: Record, time_us: int) -> None:
    """The indicated altitude less the pressure altitude as one measurement of b + s h_p, where it
    tells more than is known. The elevation of a vehicle at rest does: what height and b are beside
    it is the slow error of the fixes before, which P does not know."""
    setting.is_new = 0
    at_rest = waits_for_level(setting)
    level_m = geopotential_m(baro.h_p_m)
    note_level(setting, level_m)
    altitude_m = indicated_m(setting, level_m)
    sd_m = indicated_sd_m(setting, altitude_m, time_us)
    H = ins.H
    H[BARO_BIAS], H[BARO_SCALE] = 1.0, baro.h_p_m
    known_m = ins.b_m + ins.s * baro.h_p_m + ins.dx[BARO_BIAS] + ins.dx[BARO_SCALE] * baro.h_p_m
    z = altitude_m - baro.h_p_m - known_m
    if at_rest:
        widen_common(ins.P, z * z)
    if sd_m * sd_m < spread(ins.P, H):
        correct(ins.dx, ins.P, H, ins.K, z, sd_m * sd_m)
    H[BARO_BIAS], H[BARO_SCALE] = 0.0, 0.0
