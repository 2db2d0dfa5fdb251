"""A gate against spikes of a barometer, which predicts the next pressure from the trend of the last
ones.

A fixed threshold between consecutive samples has two faults. Against the last *accepted* value it
latches: once a climb has carried the pressure beyond it, every later sample is rejected too.
Against the last sample it forbids climbs: 5 Pa are 0.4 m, which at 1 Hz is 0.4 m/s. So the
threshold is applied to what the trend (an alpha-beta filter) does not explain, and after some
rejections in a row the gate accepts the sensor, along the slope of what it rejected.

The threshold is `gate_pa`, but at least five times the sensor's own noise, which is measured, plus
how far the trend lags behind a vertical acceleration of 5 m/s2: 0.3 Pa at 20 Hz, 1.2 Pa at 10 Hz,
120 Pa at 1 Hz. Some rejections are ten, or a second of them where the sensor is slow, but never
fewer than two.

An estimator holds a `SPIKES` record in its state and calls `accepts` with pressures that are
finite, in order of time.
"""

import math

import numpy as np

from companion.jit import step
from companion.samples import Record

ALPHA, BETA = 0.75, 0.5
UNEXPLAINED = 1.63
"""Gains of the trend, critically damped, and the noise of what it does not explain in units of the
sensor's noise."""
FEWEST_REJECTS, MOST_REJECTS, LONGEST_REJECTION_US = 2, 10, 1_000_000
LONGEST_GAP_US = 5_000_000
"""Longest gap across which the trend predicts."""
NOISE_FACTOR = 5.0
NOISE_WEIGHT = 1.0 / 64.0
MEAN_OF_SIGMA = 0.8
"""Mean absolute value of a normal variable of unit spread."""
MANOEUVRE_MPS2 = 5.0
SCALE_HEIGHT_M = 8000.0
"""Scale height of the air: pressure falls by p / 8000 a metre."""


SPIKES = np.dtype(
    [
        ("time_us", "i8"),  # the trend: last accepted sample (-1 none), filtered pressure, slope
        ("pressure_pa", "f8"),
        ("slope_paps", "f8"),
        ("noise_pa", "f8"),  # mean size of what the trend does not explain
        ("count", "i8"),  # samples in the trend, up to 2
        ("rejects", "i8"),  # in a row
        ("first_us", "i8"),  # the first of them
        ("first_pa", "f8"),
        ("jump_pa", "f8"),  # the jump that the gate has just accepted; 0 otherwise
    ],
    align=True,
)
"""The record of this component."""


@step
def spikes_start(spikes: Record, gate_pa: float) -> None:
    """Know no trend; a sensor as noisy as `gate_pa` allows."""
    spikes.time_us, spikes.first_us = -1, -1
    spikes.pressure_pa, spikes.first_pa = math.nan, math.nan
    spikes.slope_paps = 0.0
    spikes.noise_pa = gate_pa * MEAN_OF_SIGMA / NOISE_FACTOR
    spikes.jump_pa = 0.0
    spikes.count, spikes.rejects = 0, 0


@step
def accepts(spikes: Record, time_us: int, pressure_pa: float, gate_pa: float) -> bool:
    """Whether the trend admits this pressure; the trend takes it in, or counts the rejection.

    With the last rejection of a row, ``jump_pa`` says how far the sensor has left its trend.
    """
    spikes.jump_pa = 0.0
    elapsed_s = (time_us - spikes.time_us) * 1e-6
    if spikes.count == 0 or time_us - spikes.time_us > LONGEST_GAP_US:
        _follow(spikes, time_us, pressure_pa, 0.0, 1)
        return True
    if spikes.count == 1:
        _follow(spikes, time_us, pressure_pa, (pressure_pa - spikes.pressure_pa) / elapsed_s, 2)
        return True
    predicted_pa = spikes.pressure_pa + spikes.slope_paps * elapsed_s
    residual_pa = pressure_pa - predicted_pa
    threshold_pa = max(gate_pa, NOISE_FACTOR * spikes.noise_pa / MEAN_OF_SIGMA)
    threshold_pa += _lag_pa(pressure_pa, elapsed_s)
    if abs(residual_pa) <= threshold_pa:
        spikes.noise_pa += NOISE_WEIGHT * (abs(residual_pa) - spikes.noise_pa)
        slope_paps = spikes.slope_paps + BETA * residual_pa / elapsed_s
        _follow(spikes, time_us, predicted_pa + ALPHA * residual_pa, slope_paps, 2)
        return True
    if spikes.rejects == 0:
        spikes.first_us, spikes.first_pa = time_us, pressure_pa
    spikes.rejects += 1
    rejected_us = time_us - spikes.first_us
    long_enough = spikes.rejects >= FEWEST_REJECTS and rejected_us >= LONGEST_REJECTION_US
    if spikes.rejects >= MOST_REJECTS or long_enough:
        spikes.jump_pa = residual_pa
        spikes.noise_pa += NOISE_WEIGHT * spikes.rejects * (threshold_pa - spikes.noise_pa)
        slope_paps = (pressure_pa - spikes.first_pa) / (rejected_us * 1e-6)
        _follow(spikes, time_us, pressure_pa, slope_paps, 2)
    return False


@step
def noise_pa(spikes: Record, elapsed_s: float) -> float:
    """White noise of the sensor, as far as no manoeuvre can explain what the trend does not."""
    noise: float = spikes.noise_pa / (MEAN_OF_SIGMA * UNEXPLAINED)
    return max(0.0, noise - _lag_pa(spikes.pressure_pa, elapsed_s))


@step
def _lag_pa(pressure_pa: float, elapsed_s: float) -> float:
    """How far the trend lags behind a vertical acceleration."""
    return MANOEUVRE_MPS2 / BETA * elapsed_s * elapsed_s * pressure_pa / SCALE_HEIGHT_M


@step
def _follow(
    spikes: Record, time_us: int, pressure_pa: float, slope_paps: float, count: int
) -> None:
    spikes.time_us, spikes.pressure_pa, spikes.slope_paps, spikes.count = (
        time_us,
        pressure_pa,
        slope_paps,
        count,
    )
    spikes.rejects = 0
