"""A column of air in hydrostatic balance with layers, inversions and humidity, which JSBSim's own
cannot represent.

The temperature is the standard atmosphere's plus an offset plus a profile, linear between nodes;
the pressure follows from d(ln p) = -g0 dH / (R Tv), integrated in closed form from node to node,
with H the geopotential height and Tv the virtual temperature of moist air. Without profile and
humidity it equals JSBSim's column (within 0.01 Pa up to 12 km, tested).

Nothing here comes from the companion: the simulator must not share the estimator's model of the
air.
"""

import bisect
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.constants import G0_MPS2, ZERO_CELSIUS_K

GAS_CONSTANT = 8314.32 / 28.9645
"""J/kg/K, from JSBSim's gas constant and molar mass: a tenth of a pascal less at 5 km than with
287.05287"""
_EARTH_RADIUS_M = 6_356_766.0
_SEA_LEVEL_K = 288.15
_LAPSE_K_PER_M = 0.0065
_TROPOPAUSE_M = 11_000.0
_TROPOPAUSE_K = _SEA_LEVEL_K - _LAPSE_K_PER_M * _TROPOPAUSE_M
STANDARD_PA = 101_325.0
_TROPOPAUSE_PA = STANDARD_PA * (_TROPOPAUSE_K / _SEA_LEVEL_K) ** (
    G0_MPS2 / GAS_CONSTANT / _LAPSE_K_PER_M
)
_STRATOSPHERE_M = 20_000.0
_BOTTOM_M, _STEP_M = -500.0, 100.0
_FLAT_K = 1e-6
_ROUNDS, _SETTLED = 6, 5e-6
"""Iterations, and largest relative change (0.01 Pa) at the last, of the pressure that dilutes the
vapour; each iteration leaves a fiftieth of the change before."""

Array = NDArray[np.float64]


class Air(NamedTuple):
    """The air at one height."""

    pressure_pa: float
    temperature_k: float
    density_kgpm3: float


def geopotential_m(altitude_m: float) -> float:
    """Geopotential altitude of a geometric altitude, m."""
    return _EARTH_RADIUS_M * altitude_m / (_EARTH_RADIUS_M + altitude_m)


def pressure_altitude_m(pressure_pa: float) -> float:
    """The geopotential height at which the standard atmosphere has this pressure, up to 20 km."""
    if pressure_pa > _TROPOPAUSE_PA:
        ratio = math.pow(pressure_pa / STANDARD_PA, GAS_CONSTANT * _LAPSE_K_PER_M / G0_MPS2)
        return _SEA_LEVEL_K / _LAPSE_K_PER_M * (1.0 - ratio)
    return _TROPOPAUSE_M + GAS_CONSTANT * _TROPOPAUSE_K / G0_MPS2 * math.log(
        _TROPOPAUSE_PA / pressure_pa
    )


def standard_k(altitude_m: float) -> float:
    """Temperature of the standard atmosphere at a geometric altitude."""
    return _SEA_LEVEL_K - _LAPSE_K_PER_M * min(geopotential_m(altitude_m), _TROPOPAUSE_M)


def saturation_pa(temperature_k: Array) -> Array:
    """Vapour pressure over water [Alduchov and Eskridge 1996, eq. 21]."""
    celsius = temperature_k - ZERO_CELSIUS_K
    found: Array = 610.94 * np.exp(17.625 * celsius / (np.maximum(celsius, -100.0) + 243.04))
    return found


class Column:
    """`solve` for an offset of the whole column, then ask for the air `at` a height.

    Parameters
    ----------
    profile
        (altitude, temperature offset), rising: linear in between, constant outside.
    relative_humidity
        Of the troposphere, 0 to 1; above it the air is dry.
    """

    def __init__(
        self, profile: Sequence[tuple[float, float]] = (), relative_humidity: float = 0.0
    ) -> None:
        self._humidity = relative_humidity
        kinks = [geopotential_m(altitude) for altitude, _ in profile]
        nodes = np.union1d(np.arange(_BOTTOM_M, _STRATOSPHERE_M + 1.0, _STEP_M), kinks)
        self._standard_k: Array = _SEA_LEVEL_K - _LAPSE_K_PER_M * np.minimum(nodes, _TROPOPAUSE_M)
        self._profile_k: Array = (
            np.interp(nodes, kinks, [offset for _, offset in profile])
            if profile
            else np.zeros(nodes.size)
        )
        self._nodes: list[float] = nodes.tolist()
        self._weights: Array = -G0_MPS2 / GAS_CONSTANT * np.diff(nodes)
        self._sea_level = self._nodes.index(0.0)
        self._below: Array = np.where(nodes < _TROPOPAUSE_M, 1.0, 0.0)
        self._log_ratios: Array = self._integrate(self._standard_k)
        self.solve(0.0)

    def solve(self, offset_k: float, relative_humidity: float | None = None) -> None:
        """Integrate the column anew, `offset_k` warmer throughout; the humidity stays what it was
        unless given."""
        if relative_humidity is not None:
            self._humidity = relative_humidity
        temperature: Array = self._standard_k + self._profile_k + offset_k
        virtual = temperature
        if self._humidity:
            vapour = self._humidity * self._below * saturation_pa(temperature) / STANDARD_PA
            for _ in range(
                _ROUNDS
            ):  # the vapour's share needs the pressure: that of the last solution is a good start
                virtual = temperature / (1.0 - 0.378 * vapour * np.exp(-self._log_ratios))
                before, self._log_ratios = self._log_ratios, self._integrate(virtual)
                if float(np.abs(self._log_ratios - before).max()) < _SETTLED:
                    break
        else:
            self._log_ratios = self._integrate(virtual)
        self._temperature: list[float] = temperature.tolist()
        self._virtual: list[float] = virtual.tolist()
        self._log_ratio: list[float] = self._log_ratios.tolist()

    def _integrate(self, virtual_k: Array) -> Array:
        """ln(p / p at sea level) at the nodes.

        The mean of 1 / Tv over a step is atanh(x) / x / mean Tv with x half the step's relative
        change; the series is good to 1e-10 for the 15 K of a sharp inversion.
        """
        mean = 0.5 * (virtual_k[:-1] + virtual_k[1:])
        square = (0.5 * np.diff(virtual_k) / mean) ** 2
        sums = np.zeros(virtual_k.size)
        np.cumsum(self._weights / mean * (1.0 + square / 3.0 + square**2 / 5.0), out=sums[1:])
        sums -= sums[self._sea_level]
        return sums

    def at(self, altitude_m: float, sea_level_pa: float) -> Air:
        """The air at a geometric altitude above mean sea level."""
        height = _EARTH_RADIUS_M * altitude_m / (_EARTH_RADIUS_M + altitude_m)
        nodes = self._nodes
        cell = min(max(bisect.bisect_right(nodes, height) - 1, 0), len(nodes) - 2)
        above_m, step_m = height - nodes[cell], nodes[cell + 1] - nodes[cell]
        low, high = self._virtual[cell], self._virtual[cell + 1]
        slope = (high - low) / step_m
        virtual = low + slope * above_m
        if -_FLAT_K < high - low < _FLAT_K:
            log_ratio = -G0_MPS2 * above_m / (GAS_CONSTANT * low)
        else:
            log_ratio = -G0_MPS2 / (GAS_CONSTANT * slope) * math.log(virtual / low)
        pressure = sea_level_pa * math.exp(self._log_ratio[cell] + log_ratio)
        share = above_m / step_m
        temperature = (1.0 - share) * self._temperature[cell] + share * self._temperature[cell + 1]
        return Air(pressure, temperature, pressure / (GAS_CONSTANT * virtual))
