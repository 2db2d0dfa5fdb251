"""The standard atmosphere against its published tables, and what must hold for every height."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from companion.kernels.atmosphere import (
    LAYER_H_M,
    LAYER_P_PA,
    P0_PA,
    baro_altitude_array,
    baro_altitude_m,
    geometric_m,
    geopotential_m,
    pressure_altitude_m,
    qnh_pa,
    standard_pressure_pa,
)

TABLE = [
    # US Standard Atmosphere 1976, Table I, and ICAO Doc 7488: geopotential height in m, pressure in
    # Pa
    (-1000, 113929.0),
    (0, 101325.0),
    (500, 95460.8),
    (1000, 89874.6),
    (2000, 79495.2),
    (3000, 70108.5),
    (5000, 54019.9),
    (8000, 35599.8),
    (10_000, 26436.3),
    (11_000, 22632.0),
    (15_000, 12044.6),
    (20_000, 5474.9),
    (25_000, 2511.0),
    (32_000, 868.02),
]
HEIGHTS_M = st.floats(-1000.0, 31_000.0)


@pytest.mark.parametrize(("height_m", "pressure_pa"), TABLE)
def test_published_values(height_m: float, pressure_pa: float) -> None:
    assert standard_pressure_pa(float(height_m)) == pytest.approx(pressure_pa, rel=3e-5)
    assert pressure_altitude_m(pressure_pa) == pytest.approx(height_m, abs=0.3)


@pytest.mark.parametrize(
    ("geometric", "geopotential"),
    [
        (0.0, 0.0),
        (1000.0, 999.843),
        (5000.0, 4996.070),
        (11_019.1, 11_000.0),
        (20_063.1, 20_000.0),
        (-500.0, -500.039),
    ],
)
def test_geopotential_height(geometric: float, geopotential: float) -> None:
    assert geopotential_m(geometric) == pytest.approx(geopotential, abs=0.06)
    assert geometric_m(geopotential) == pytest.approx(geometric, abs=0.06)


@given(HEIGHTS_M)
def test_pressure_and_height_are_inverse(height_m: float) -> None:
    assert pressure_altitude_m(standard_pressure_pa(height_m)) == pytest.approx(height_m, abs=1e-6)


@given(st.floats(900.0, 115_000.0))
def test_height_and_pressure_are_inverse(pressure_pa: float) -> None:
    assert standard_pressure_pa(pressure_altitude_m(pressure_pa)) == pytest.approx(
        pressure_pa, rel=1e-11
    )


@given(st.floats(-2000.0, 60_000.0))
def test_geometric_and_geopotential_are_inverse(height_m: float) -> None:
    assert geometric_m(geopotential_m(height_m)) == pytest.approx(height_m, abs=1e-7)


@given(HEIGHTS_M, HEIGHTS_M)
def test_higher_is_thinner(low_m: float, high_m: float) -> None:
    assume(low_m + 1e-3 < high_m)
    assert standard_pressure_pa(low_m) > standard_pressure_pa(high_m)


@pytest.mark.parametrize("layer", [1, 2, 3])
def test_layers_join(layer: int) -> None:
    base_m = LAYER_H_M[layer]
    below, at = standard_pressure_pa(base_m - 1e-6), standard_pressure_pa(base_m)
    assert below == pytest.approx(at, rel=1e-9)
    assert at == pytest.approx(LAYER_P_PA[layer], rel=1e-12)


@given(HEIGHTS_M)
def test_the_column_is_in_hydrostatic_equilibrium(height_m: float) -> None:
    """dp/dH = -g0 p / (R T), with the temperature of the standard at that height."""
    assume(min(abs(height_m - base_m) for base_m in LAYER_H_M[1:]) > 2.0)
    step_m = 1.0
    slope = (standard_pressure_pa(height_m + step_m) - standard_pressure_pa(height_m - step_m)) / (
        2 * step_m
    )
    temperature_k = float(
        np.interp(
            height_m, [-5000, 0, 11_000, 20_000, 32_000], [320.65, 288.15, 216.65, 216.65, 228.65]
        )
    )
    expected = -9.80665 * standard_pressure_pa(height_m) / (287.05287 * temperature_k)
    assert slope == pytest.approx(expected, rel=1e-6)


@given(st.floats(-300.0, 11_000.0), st.floats(94_000.0, 105_500.0))
def test_an_altimeter_set_to_qnh_indicates_the_altitude(
    altitude_m: float, setting_pa: float
) -> None:
    """The pressure at which an altimeter so set indicates the altitude gives back the setting."""
    pressure_pa = standard_pressure_pa(geopotential_m(altitude_m) + pressure_altitude_m(setting_pa))
    assert qnh_pa(pressure_pa, altitude_m) == pytest.approx(setting_pa, rel=1e-10)


@given(HEIGHTS_M)
def test_in_standard_air_qnh_is_standard(altitude_m: float) -> None:
    pressure_pa = standard_pressure_pa(geopotential_m(altitude_m))
    assert qnh_pa(pressure_pa, altitude_m) == pytest.approx(P0_PA, rel=1e-9)
    assert baro_altitude_m(pressure_pa) == pytest.approx(altitude_m, abs=1e-6)


def test_on_the_ground_qnh_is_the_pressure_reduced_to_the_sea() -> None:
    """At sea level it is the pressure itself; 27.3 ft a hectopascal near the ground."""
    assert qnh_pa(99_800.0, 0.0) == pytest.approx(99_800.0)
    slope_m_per_hpa = pressure_altitude_m(P0_PA - 100.0) - pressure_altitude_m(P0_PA)
    assert slope_m_per_hpa / 0.3048 == pytest.approx(27.3, abs=0.1)


@pytest.mark.parametrize("pressure_pa", [0.0, -1.0, math.nan, -math.inf])
def test_what_is_no_pressure_has_no_height(pressure_pa: float) -> None:
    assert math.isnan(pressure_altitude_m(pressure_pa))
    assert math.isnan(baro_altitude_m(pressure_pa))


def test_arrays_of_any_shape() -> None:
    pressures = np.array([[101_325.0, 90_000.0, 0.0], [50_000.0, 22_632.0, math.nan]])
    heights = baro_altitude_array(pressures)
    assert heights.shape == (2, 3)
    assert heights[0, 1] == baro_altitude_m(90_000.0)
    assert np.isnan(heights[:, 2]).all()
    assert baro_altitude_array([]).shape == (0,)
