"""Timing: stamps jitter, so a height errs by the jitter times the climb.

It is noise of the barometer height and of the GNSS height. The climb is one that the barometer's
slope shows too, or the error of an IMU would hide itself. A jitter lasts for a second, so the climb
is the largest of late, and heights that come faster share the information of that second.
Prior: `timing_sd_s` (.3 s; streams of real logs jitter by .3-1 s). Off: `timing_sd_s` 0.
"""

import math

from companion.jit import step

MEMORY_S, JITTER_S, SHORTEST_S = 3.0, 1.0, 0.01
SHOWN_RATIO, QUIET_MPS = 2.0, 0.5


@step
def largest_climb_mps(before_mps: float, climb_mps: float, slope_mps: float, dt_s: float) -> float:
    """The largest climb of late, which a slope that lags must show by half."""
    shown_mps = min(abs(climb_mps), SHOWN_RATIO * abs(slope_mps) + QUIET_MPS)
    return max(shown_mps, before_mps * math.exp(-dt_s / MEMORY_S))


@step
def timing_m2(timing_sd_s: float, climb_mps: float, interval_s: float) -> float:
    """Variance by the jitter of time stamps, as white noise of heights this far apart."""
    return (timing_sd_s * climb_mps) ** 2 * max(1.0, JITTER_S / max(interval_s, SHORTEST_S))
