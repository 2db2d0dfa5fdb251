"""Paper R, sections II to V: pressure, density, cubic (12) and Kollsman correction."""

import numpy as np
from numpy.typing import NDArray

from companion.estimators.baro_gnss_ins.altimetry import (
    INCH_OF_MERCURY_PA,
    cubic_altitude_m,
    kollsman_altitude_m,
    kollsman_slope_mppa,
)
from companion.kernels.atmosphere import geopotential_m, pressure_altitude_m, standard_pressure_pa
from companion.plots.style import BARO
from sim.studies.papers.page import Page, Row, compare, holds, near

Array = NDArray[np.float64]
P0_PA, P_3KM_PA = 101_325.0, 70_108.526
SECOND_US = 1_000_000


def standard_pressures_pa(heights_m: Array) -> Array:
    """Pressure of the standard atmosphere at geopotential heights."""
    return np.array([standard_pressure_pa(height) for height in heights_m.tolist()])


def pressures_pa(geometric_m: Array) -> Array:
    """Pressure at which a barometer reads these (geometric) heights."""
    return np.array(
        [standard_pressure_pa(geopotential_m(height)) for height in geometric_m.tolist()]
    )


def altitude_rows() -> list[Row]:
    density = P0_PA / (287.05 * 288.15)
    at_1km = standard_pressure_pa(1000.0)
    linear_m = (at_1km - P0_PA) / (density * 9.81)
    return [
        compare(
            "59 °F in kelvin",
            288.15,
            5.0 / 9.0 * (59.0 - 32.0) + 273.15,
            0.005,
            unit="K",
            where="(10)",
        ),
        compare(
            "pascals in an inch of mercury",
            3385.0,
            INCH_OF_MERCURY_PA,
            0.5,
            unit="Pa",
            where="(11)",
        ),
        holds(
            "29.92 inches are 101 325 Pa",
            near(3385.0 * 29.92, P0_PA, 10.0),
            3385.0 * 29.92,
            printed=P0_PA,
            unit="Pa",
            where="(11), (13)",
            note="with the printed factor; 3.8 m of altitude",
        ),
        compare(
            "height above ground at 1000 m",
            1000.0,
            linear_m,
            10.0,
            unit="m",
            where="(8)",
            note="the sign is wrong, (p_ground - p) is meant",
        ),
        compare(
            "the same with the other sign",
            1000.0,
            -linear_m,
            10.0,
            unit="m",
            where="(8)",
            note="density falls with height",
        ),
        compare("density at sea level", 1.225, density, 5e-4, unit="kg/m³", where="(9)"),
    ]


def cubic_rows() -> list[Row]:
    rows = [
        compare(
            f"at the pressure of {height:.0f} m",
            height,
            cubic_altitude_m(standard_pressure_pa(height)),
            within=10.0,
            unit="m",
            where="(12)",
        )
        for height in (-1000.0, 0.0, 1000.0, 3000.0, 5000.0, 8000.0, 11_000.0, 15_000.0, 18_288.0)
    ]
    cubic = (cubic_altitude_m(P0_PA + 1.0) - cubic_altitude_m(P0_PA - 1.0)) / 2.0
    closed = (pressure_altitude_m(P0_PA + 1.0) - pressure_altitude_m(P0_PA - 1.0)) / 2.0
    note = (
        f"{100 * (cubic / closed - 1):.0f} % too steep: a climb of 5 m/s shows as "
        f"{5 * cubic / closed:.1f}"
    )
    return [
        *rows,
        compare("dh/dp at sea level", closed, cubic, 0.001, unit="m/Pa", where="(12)", note=note),
    ]


def kollsman_rows() -> list[Row]:
    measured_pa = standard_pressure_pa(500.0) * 100_000.0 / P0_PA
    at_3km_pa = standard_pressure_pa(3000.0) * 100_000.0 / P0_PA
    high_m = pressure_altitude_m(at_3km_pa)
    with_sea_level_slope = high_m + kollsman_slope_mppa(P0_PA, P0_PA) * (100_000.0 - P0_PA)
    return [
        holds(
            "no correction on a standard day",
            near(kollsman_altitude_m(measured_pa, P0_PA), pressure_altitude_m(measured_pa), 0.0),
            0.0,
            printed=0.0,
            unit="m",
            where="(13)",
        ),
        Row(
            "dh/dp_sl at sea level",
            None,
            kollsman_slope_mppa(P0_PA, P0_PA),
            unit="m/Pa",
            where="(13)",
            note="positive: more pressure at sea level, more altitude for the same pressure",
        ),
        Row(
            "dh/dp_sl at 3 km",
            None,
            kollsman_slope_mppa(P_3KM_PA, P0_PA),
            unit="m/Pa",
            where="(13)",
        ),
        compare(
            "500 m, sea level at 1000 hPa",
            500.0,
            kollsman_altitude_m(measured_pa, 100_000.0),
            1.0,
            unit="m",
            where="(13)",
            reading="the derivative taken at the measured pressure",
            note=f"uncorrected {pressure_altitude_m(measured_pa):.2f}; the rest is second order",
        ),
        compare(
            '3000 m, "gradient of altitude with pressure at sea level"',
            3000.0,
            with_sea_level_slope,
            1.0,
            unit="m",
            where="after (13)",
            note=f"with the local derivative {kollsman_altitude_m(at_3km_pa, 100_000.0):.1f}",
        ),
    ]


def draw_cubic(page: Page) -> None:
    heights_m = np.linspace(-1000.0, 18_288.0, 400)
    pressure = standard_pressures_pa(heights_m)
    error_m = np.array([cubic_altitude_m(value) for value in pressure.tolist()]) - heights_m
    with page.figure(
        "cubic", "Error of the cubic (12) over its range: altitude and rate of climb.", columns=2
    ) as axes:
        axes[0].plot(heights_m / 1000.0, error_m, color=BARO)
        axes[0].set(title="altitude error (m)", xlabel="height (km)")
        axes[1].plot(heights_m / 1000.0, 100.0 * np.gradient(error_m, heights_m), color=BARO)
        axes[1].set(title="error of a rate of climb (%)", xlabel="height (km)")
