"""A gate against spikes of a barometer, which predicts the next pressure from the trend of the last
ones.

A fixed threshold between consecutive samples has two faults. Against the last *accepted* value it
latches: once a climb has carried the pressure beyond it, every later sample is rejected too.
Against the last sample it forbids climbs: 5 Pa are 0.4 m, which at 1 Hz is 0.4 m/s. So the
threshold is applied to what the trend (an alpha-beta filter) does not explain, and after some
rejections in a row the gate believes the sensor, along the slope of what it rejected.

The threshold is `gate_pa`, but at least five times the sensor's own noise, which is measured, plus
how far the trend lags behind a vertical acceleration of 5 m/s2: 0.3 Pa at 20 Hz, 1.2 Pa at 10 Hz,
120 Pa at 1 Hz. Some rejections are ten, or a second of them where the sensor is slow, but never
fewer than two.

An estimator puts `spike_fields` into its state and calls `accepts` with pressures that are finite,
in order of time.
"""

import math
from typing import Any

from companion.jit import step
from companion.samples import Rows

ALPHA, BETA = 0.75, 0.5
UNEXPLAINED = 1.63
"""gains of the trend, critically damped; what it does not explain is so many times as noisy as the
sensor"""
FEWEST_REJECTS, MOST_REJECTS, LONGEST_REJECTION_US = 2, 10, 1_000_000
LONGEST_GAP_US = 5_000_000
"""across a longer gap no trend predicts"""
NOISE_FACTOR = 5.0
NOISE_WEIGHT = 1.0 / 64.0
MEAN_OF_SIGMA = 0.8
"""mean absolute value of a normal variable of unit spread"""
MANOEUVRE_MPS2 = 5.0
SCALE_HEIGHT_M = 8000.0
"""pressure falls by p / this a metre"""


def spike_fields() -> tuple[tuple[Any, ...], ...]:
    """The state fields of the gate."""
    return (
        (
            "spike_us",
            "i8",
        ),  # the trend: time of the last accepted sample (-1 none), its filtered pressure and slope
        ("spike_pa", "f8"),
        ("spike_slope_paps", "f8"),
        ("spike_noise_pa", "f8"),  # mean size of what the trend does not explain
        ("spike_count", "i8"),  # samples in the trend, up to 2
        ("spike_rejects", "i8"),  # in a row
        ("spike_first_us", "i8"),  # the first of them
        ("spike_first_pa", "f8"),
        ("spike_jump_pa", "f8"),  # what the gate has just learned to believe; 0 otherwise
    )


@step
def spike_start(state: Rows, gate_pa: float) -> None:
    """Know no trend; a sensor as noisy as `gate_pa` allows."""
    s = state[0]
    s.spike_us, s.spike_first_us = -1, -1
    s.spike_pa, s.spike_first_pa = math.nan, math.nan
    s.spike_slope_paps = 0.0
    s.spike_noise_pa = gate_pa * MEAN_OF_SIGMA / NOISE_FACTOR
    s.spike_jump_pa = 0.0
    s.spike_count, s.spike_rejects = 0, 0


@step
def accepts(state: Rows, time_us: int, pressure_pa: float, gate_pa: float) -> bool:
    """Whether the trend admits this pressure; the trend takes it in, or counts the rejection.

    With the last rejection of a row, ``spike_jump_pa`` says how far the sensor has left its trend.
    """
    s = state[0]
    s.spike_jump_pa = 0.0
    elapsed_s = (time_us - s.spike_us) * 1e-6
    if s.spike_count == 0 or time_us - s.spike_us > LONGEST_GAP_US:
        _follow(state, time_us, pressure_pa, 0.0, 1)
        return True
    if s.spike_count == 1:
        _follow(state, time_us, pressure_pa, (pressure_pa - s.spike_pa) / elapsed_s, 2)
        return True
    predicted_pa = s.spike_pa + s.spike_slope_paps * elapsed_s
    residual_pa = pressure_pa - predicted_pa
    threshold_pa = max(gate_pa, NOISE_FACTOR * s.spike_noise_pa / MEAN_OF_SIGMA)
    threshold_pa += _lag_pa(pressure_pa, elapsed_s)
    if abs(residual_pa) <= threshold_pa:
        s.spike_noise_pa += NOISE_WEIGHT * (abs(residual_pa) - s.spike_noise_pa)
        slope_paps = s.spike_slope_paps + BETA * residual_pa / elapsed_s
        _follow(state, time_us, predicted_pa + ALPHA * residual_pa, slope_paps, 2)
        return True
    if s.spike_rejects == 0:
        s.spike_first_us, s.spike_first_pa = time_us, pressure_pa
    s.spike_rejects += 1
    rejected_us = time_us - s.spike_first_us
    long_enough = s.spike_rejects >= FEWEST_REJECTS and rejected_us >= LONGEST_REJECTION_US
    if s.spike_rejects >= MOST_REJECTS or long_enough:
        s.spike_jump_pa = residual_pa
        s.spike_noise_pa += NOISE_WEIGHT * s.spike_rejects * (threshold_pa - s.spike_noise_pa)
        slope_paps = (pressure_pa - s.spike_first_pa) / (rejected_us * 1e-6)
        _follow(state, time_us, pressure_pa, slope_paps, 2)
    return False


@step
def noise_pa(state: Rows, elapsed_s: float) -> float:
    """White noise of the sensor, as far as no manoeuvre can explain what the trend does not."""
    s = state[0]
    noise: float = s.spike_noise_pa / (MEAN_OF_SIGMA * UNEXPLAINED)
    return max(0.0, noise - _lag_pa(s.spike_pa, elapsed_s))


@step
def _lag_pa(pressure_pa: float, elapsed_s: float) -> float:
    """How far the trend lags behind a vertical acceleration."""
    return MANOEUVRE_MPS2 / BETA * elapsed_s * elapsed_s * pressure_pa / SCALE_HEIGHT_M


@step
def _follow(state: Rows, time_us: int, pressure_pa: float, slope_paps: float, count: int) -> None:
    s = state[0]
    s.spike_us, s.spike_pa, s.spike_slope_paps, s.spike_count = (
        time_us,
        pressure_pa,
        slope_paps,
        count,
    )
    s.spike_rejects = 0
