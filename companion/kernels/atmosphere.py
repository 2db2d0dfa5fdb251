"""The standard atmosphere, both ways, and what corrects it.

ICAO Doc 7488 / US Standard Atmosphere 1976: a column of layers with constant lapse rate in
geopotential height H,

    T(H) = T_b + L_b (H - H_b)
    p(H) = p_b (T(H) / T_b)^(-g0 / (R L_b))          L_b != 0
    p(H) = p_b exp(-g0 (H - H_b) / (R T_b))          L_b == 0

from -5 km to 47 km. Geometric height z and geopotential height H relate by H = r z / (r + z).

Compiled functions take and return floats; the ``_array`` variants take any array-like.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from companion.jit import step

G0_MPS2 = 9.80665
R_AIR = 287.05287
"""Specific gas constant of dry air, J/(kg K)."""
P0_PA = 101325.0
T0_K = 288.15
L0_KPM = -0.0065
"""Lapse rate of the troposphere, K/m."""
EARTH_RADIUS_M = 6356766.0
"""The standard's effective radius, which makes gravity fall with the square of height."""

LAYER_H_M = (0.0, 11000.0, 20000.0, 32000.0)
LAYER_L_KPM = (L0_KPM, 0.0, 0.001, 0.0028)


def _layer_bases() -> tuple[tuple[float, ...], tuple[float, ...]]:
    temperatures, pressures = [T0_K], [P0_PA]
    for below, above, lapse in zip(LAYER_H_M[:-1], LAYER_H_M[1:], LAYER_L_KPM[:-1], strict=True):
        t, p, thickness = temperatures[-1], pressures[-1], above - below
        if lapse == 0.0:
            pressures.append(p * math.exp(-G0_MPS2 * thickness / (R_AIR * t)))
        else:
            pressures.append(p * math.pow((t + lapse * thickness) / t, -G0_MPS2 / (R_AIR * lapse)))
        temperatures.append(t + lapse * thickness)
    return tuple(temperatures), tuple(pressures)


LAYER_T_K, LAYER_P_PA = _layer_bases()


@step
def pressure_altitude_m(pressure_pa: float) -> float:
    """Geopotential height at which the standard atmosphere has this pressure; NaN unless it is
    positive."""
    if not pressure_pa > 0.0:
        return math.nan
    layer = 0
    while layer < 3 and pressure_pa < LAYER_P_PA[layer + 1]:
        layer += 1
    t, lapse = LAYER_T_K[layer], LAYER_L_KPM[layer]
    ratio = pressure_pa / LAYER_P_PA[layer]
    if lapse == 0.0:
        return LAYER_H_M[layer] - R_AIR * t / G0_MPS2 * math.log(ratio)
    return LAYER_H_M[layer] + t / lapse * (math.pow(ratio, -R_AIR * lapse / G0_MPS2) - 1.0)


@step
def _layer_at(pressure_altitude: float) -> int:
    layer = 0
    while layer < 3 and pressure_altitude >= LAYER_H_M[layer + 1]:
        layer += 1
    return layer


@step
def standard_pressure_pa(pressure_altitude: float) -> float:
    """Pressure of the standard atmosphere at a geopotential height in metres: the inverse of
    `pressure_altitude_m`."""
    layer = _layer_at(pressure_altitude)
    t, lapse = LAYER_T_K[layer], LAYER_L_KPM[layer]
    above = pressure_altitude - LAYER_H_M[layer]
    if lapse == 0.0:
        return LAYER_P_PA[layer] * math.exp(-G0_MPS2 * above / (R_AIR * t))
    return LAYER_P_PA[layer] * math.pow((t + lapse * above) / t, -G0_MPS2 / (R_AIR * lapse))


@step
def standard_temperature_k(pressure_altitude: float) -> float:
    """Temperature of the standard atmosphere at a geopotential height in metres."""
    layer = _layer_at(pressure_altitude)
    return LAYER_T_K[layer] + LAYER_L_KPM[layer] * (pressure_altitude - LAYER_H_M[layer])


@step
def geometric_m(geopotential: float) -> float:
    """Geometric height z = r H / (r - H) of a geopotential height: 19 m more at 11 km."""
    return EARTH_RADIUS_M * geopotential / (EARTH_RADIUS_M - geopotential)


@step
def geopotential_m(geometric: float) -> float:
    """Geopotential height H = r z / (r + z) of a geometric height."""
    return EARTH_RADIUS_M * geometric / (EARTH_RADIUS_M + geometric)


@step
def baro_altitude_m(pressure_pa: float) -> float:
    """Geometric height that the standard atmosphere gives a pressure: what a raw barometer says
    about altitude."""
    return geometric_m(pressure_altitude_m(pressure_pa))


@step
def qnh_pa(pressure_pa: float, altitude_amsl_m: float) -> float:
    """Altimeter setting with which an altimeter at `pressure_pa` indicates `altitude_amsl_m`.

    An altimeter's setting window shifts its scale: indicated = H_p(p) - H_p(QNH).
    """
    return standard_pressure_pa(pressure_altitude_m(pressure_pa) - geopotential_m(altitude_amsl_m))


def baro_altitude_array(pressure_pa: ArrayLike) -> NDArray[np.float64]:
    """`baro_altitude_m` of every pressure in an array of any shape."""
    pressures = np.asarray(pressure_pa, dtype=np.float64)
    return np.array([baro_altitude_m(p) for p in pressures.ravel()]).reshape(pressures.shape)
