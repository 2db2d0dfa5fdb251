"""Lag: the barometer shows the height of T seconds ago, so it errs by -T times the climb.

The climb is the slope of the smoothed barometer height, a known regressor: the product of two
estimated states would feed the errors of both into each other. Prior: 0 +- `lag_sd_s` (1 s; .5-1.2
found of avionics, .1 of a MEMS part). Off: `lag_sd_s` 0.
"""

from companion.jit import step

SMOOTHING_S = 2.0


@step
def smoothed(smooth_m: float, baro_m: float, dt_s: float) -> float:
    """The smoothed barometer height after `dt_s`."""
    return smooth_m + (1.0 - 2.718281828459045 ** (-dt_s / SMOOTHING_S)) * (baro_m - smooth_m)


@step
def slope_mps(smooth_m: float, baro_m: float) -> float:
    """Its slope, m/s."""
    return (baro_m - smooth_m) / SMOOTHING_S
