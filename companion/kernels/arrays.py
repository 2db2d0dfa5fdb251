"""Compiled functions of one value, over arrays."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from companion.jit import step
from companion.kernels.atmosphere import baro_altitude_m
from companion.kernels.gnss import gnss_sd_m
from companion.samples import Rows


def baro_altitude_array(pressure_pa: ArrayLike) -> NDArray[np.float64]:
    """`baro_altitude_m` of every pressure in an array of any shape."""
    pressures = np.ascontiguousarray(pressure_pa, dtype=np.float64)
    heights = np.empty(pressures.size)
    _baro_altitudes(pressures.ravel(), heights)
    return heights.reshape(pressures.shape)


def gnss_sd_array(fixes: Rows, floor_m: float, unknown_m: float) -> NDArray[np.float64]:
    """`gnss_sd_m` of every GNSS row."""
    spreads = np.empty(fixes.size)
    _gnss_sds(fixes, floor_m, unknown_m, spreads)
    return spreads


@step
def _baro_altitudes(pressures_pa: NDArray[Any], heights_m: NDArray[Any]) -> None:
    for i in range(pressures_pa.size):
        heights_m[i] = baro_altitude_m(pressures_pa[i])


@step
def _gnss_sds(fixes: Rows, floor_m: float, unknown_m: float, spreads_m: NDArray[Any]) -> None:
    for i in range(fixes.size):
        spreads_m[i] = gnss_sd_m(fixes[i : i + 1], floor_m, unknown_m)
