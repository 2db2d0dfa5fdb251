"""What the vertical bank makes of a ground barometer: the level without GNSS, and a station that
errs."""

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.estimators.method import run_log
from companion.estimators.vertical_bank import steps as vb
from companion.samples import DTYPES, Kind, Rows
from tests.flights import Flight, flight

Array = NDArray[np.float64]
OUTAGE_S, END_S = 300.0, 900.0
WORST_PA_PER_S = 31.0 * 12.0 / 3600.0
"""the largest change of the sea-level pressure in a year"""


def flown(weather_pa_per_s: float) -> Flight:
    """Ten minutes without GNSS in falling pressure."""
    made = flight(duration_s=END_S, imu_hz=10.0, pressure_hz=4.0, gnss_hz=2.0)
    made.drop(Kind.GNSS, OUTAGE_S)
    table = made.tables[Kind.PRESSURE]
    table["pressure_pa"] *= 1.0 + fallen_pa(made.elapsed_s(table["time_us"]), weather_pa_per_s) / (
        made.plan.sea_level_pa
    )
    return made


def fallen_pa(elapsed_s: Array, pa_per_s: float) -> Array:
    return -pa_per_s * np.clip(elapsed_s - OUTAGE_S, 0.0, None)


def hear_station(
    made: Flight, weather_pa_per_s: float, error_pa: float, drift_pa_per_s: float, until_s: float
) -> Flight:
    """The station's QNH once a minute, with a constant error and one that grows in the outage."""
    elapsed_s = np.arange(10.0, until_s, 60.0)
    table = np.zeros(elapsed_s.size, DTYPES[Kind.AIR])
    for name in ("air_temperature_k", "field_elevation_m"):
        table[name] = np.nan
    table["time_us"] = made.start_us + np.round(elapsed_s * 1e6).astype(np.int64)
    first = made.tables[Kind.PRESSURE]
    table["arrival_us"] = table["time_us"] - first["time_us"][0] + first["arrival_us"][0] + 1000
    weather = fallen_pa(elapsed_s, weather_pa_per_s - drift_pa_per_s)
    table["qnh_pa"], table["qnh_sd_pa"] = made.plan.sea_level_pa + error_pa + weather, 100.0
    made.tables[Kind.AIR] = table
    return made


def errors_and_levels(made: Flight) -> tuple[Array, Array, Rows]:
    """Error and protection level (m) in the outage."""
    estimates, _, _ = run_log(vb.METHOD, made.log())
    late = estimates[made.elapsed_s(estimates["time_us"]) > OUTAGE_S]
    error_m = late["altitude_amsl_m"] - made.truth_m(late["time_us"])
    return np.asarray(error_m, np.float64), np.asarray(late["protection_level_m"]), late


@pytest.mark.parametrize("weather_pa_per_s", [0.0, WORST_PA_PER_S])
@pytest.mark.parametrize("error_pa", [0.0, 150.0])
def test_level_stays_narrow_while_the_weather_is_measured(
    weather_pa_per_s: float, error_pa: float
) -> None:
    """Ten minutes without GNSS and without airspeed: its effect on the static port is most of what
    is left. Expected Result: with the station the level is less than half of that without it,
    and bounds the error, whatever the station's constant error."""
    made = flown(weather_pa_per_s)
    alone = errors_and_levels(made.copy())[1]
    error_m, level_m, _ = errors_and_levels(
        hear_station(made, weather_pa_per_s, error_pa, 0.0, END_S)
    )
    assert level_m.max() < alone[-1] / 2.0
    assert np.all(np.abs(error_m) < level_m)
    assert np.abs(error_m).max() < 6.0


@pytest.mark.parametrize("drift_pa_per_s", [WORST_PA_PER_S, -WORST_PA_PER_S])
def test_level_bounds_the_drift_of_a_station(drift_pa_per_s: float) -> None:
    """A station that drifts as fast as the reference's check lets pass."""
    made = hear_station(flown(0.0), 0.0, 0.0, drift_pa_per_s, END_S)
    error_m, level_m, _ = errors_and_levels(made)
    assert np.all(np.abs(error_m) < level_m)
    assert np.abs(error_m).max() > 3.0


def test_level_widens_again_when_the_station_falls_silent() -> None:
    made = flown(0.0)
    alone = errors_and_levels(made.copy())[1]
    _, level_m, rows = errors_and_levels(hear_station(made, 0.0, 0.0, 0.0, OUTAGE_S + 120.0))
    elapsed_s = made.elapsed_s(rows["time_us"])
    assert level_m[np.searchsorted(elapsed_s, OUTAGE_S + 120.0)] < 25.0
    assert level_m[-1] > 0.5 * alone[-1]
