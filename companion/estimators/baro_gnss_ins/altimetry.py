"""The altimetry of paper R: pressure altitude (12) and the Kollsman correction (11), (13).

The filter itself uses the closed-form standard atmosphere and estimates the barometer's bias; these
functions serve the paper's page.
"""

import math

from companion.jit import step
from companion.kernels.atmosphere import (
    G0_MPS2,
    L0_KPM,
    P0_PA,
    R_AIR,
    T0_K,
    pressure_altitude_m,
)

CUBIC = (-2.1558e-11, 5.0154e-6, -4.8540e-1, 1.9866e4)
"""Coefficients of (12), highest power first."""
INCH_OF_MERCURY_PA = 3386.389
"""(11) prints 3385."""


@step
def cubic_altitude_m(pressure_pa: float) -> float:
    """Barometric altitude by the third-order fit (12), as printed.

    Not used: wrong by -251.6 m at 1013.25 hPa, by -1216 m at -1 km, by -1653 m at 18.3 km, and 60 %
    too steep at sea level. The closed form is `companion.kernels.atmosphere.pressure_altitude_m`.
    """
    return ((CUBIC[0] * pressure_pa + CUBIC[1]) * pressure_pa + CUBIC[2]) * pressure_pa + CUBIC[3]


@step
def kollsman_slope_mppa(pressure_pa: float, sea_level_pa: float) -> float:
    """dh/dp_sl of (13): metres that the indicated altitude gains for each pascal of sea-level
    pressure.

    (R T0 / (g p_sl)) (p / p_sl)^(R L / g), positive, taken at the measured pressure: in the
    troposphere.
    """
    height_scale_m = R_AIR * T0_K / G0_MPS2
    return (
        height_scale_m
        / sea_level_pa
        * math.pow(pressure_pa / sea_level_pa, -R_AIR * L0_KPM / G0_MPS2)
    )


@step
def kollsman_altitude_m(pressure_pa: float, setting_pa: float) -> float:
    """(13): geopotential altitude for a sea-level pressure `setting_pa`, h_std + dh/dp_sl (p_k -
    p_std).

    First order: 0.9 m short of 500 m for a setting of 1000 hPa. The filter does not use it, as the
    paper says: b takes the place of p_k.
    """
    slope = kollsman_slope_mppa(pressure_pa, P0_PA)
    return pressure_altitude_m(pressure_pa) + slope * (setting_pa - P0_PA)
