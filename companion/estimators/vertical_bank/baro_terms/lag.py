"""Lag: the barometer shows the height of T seconds ago, so it errs by -T times the climb.

The climb is a known regressor: the slope of the smoothed barometer height before the newest one,
whose own noise must not be in it. The product of two estimated states would feed the errors of both
into each other. Prior: 0 +- `lag_sd_s` (1 s; .5-1.2 found of avionics, .1 of a MEMS part). Off:
`lag_sd_s` 0.
"""

import math

from companion.jit import step

SMOOTHING_S = 2.0
QUIET_MPS = 0.5
SHOWN_RATIO = 2.0


@step
def smoothed(smooth_m: float, baro_m: float, dt_s: float) -> float:
    """The smoothed barometer height after `dt_s`."""
    return smooth_m + (1.0 - math.exp(-dt_s / SMOOTHING_S)) * (baro_m - smooth_m)


@step
def slope_mps(smooth_m: float, baro_m: float) -> float:
    """Slope of the smoothed barometer height, m/s."""
    return (baro_m - smooth_m) / SMOOTHING_S


@step
def smooth_of_slope(slope: float, baro_m: float) -> float:
    """The smoothed barometer height that has this slope: what follows a leap, which is none."""
    return baro_m - SMOOTHING_S * slope


@step
def lag_climb_mps(slope: float, climb_mps: float) -> float:
    """The climb that the lag is seen by: the slope, within twice the estimated climb. A slope that
    the estimate does not share is a jump of the barometer, and one within its noise is none."""
    shown = SHOWN_RATIO * abs(climb_mps) + QUIET_MPS
    return max(-shown, min(shown, slope)) if abs(slope) > QUIET_MPS else 0.0
