"""Outages are honest: the spread of an altitude that only the barometer carries on."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.estimators import DEFAULT_ESTIMATOR, ESTIMATORS, run_log
from companion.estimators.outage import (
    JUMP_M,
    OUTAGE,
    extrapolated_m2,
    growth_m2,
    note_difference,
    outage_start,
)
from companion.samples import Kind, readable, rows
from tests.flights import flight

CORRECTED = ["adaptive-fusion", "air-data-gnss", "baro-gnss-ins", "robust-altimeter"]
"""estimators whose height follows the fixes"""
NAMES = [name for name in ESTIMATORS if name != DEFAULT_ESTIMATOR]
"""all that have the growth of `companion.estimators.outage`; the bank's own tests have its"""
START_S, END_S = 150.0, 400.0
DRIFTS_MPS = (-0.05, 0.0, 0.01, 0.05, 0.1)
Array = NDArray[np.float64]


@cache
def fly(name: str, drift_mps: float) -> tuple[Array, Array, Array]:
    """Seconds, errors and spreads of a flight whose barometer drifts, without GNSS for 250 s; it
    climbs and sinks by 260 m."""
    made = flight(duration_s=440.0, imu_hz=25.0, pressure_hz=5.0, gnss_hz=2.0)
    pressure = made.tables[Kind.PRESSURE]
    pressure["pressure_pa"] -= 11.6 * drift_mps * made.elapsed_s(pressure["time_us"])
    made.drop(Kind.GNSS, START_S, END_S)
    estimates, _, _ = run_log(ESTIMATORS[name], made.log())
    estimates = estimates[np.isfinite(estimates["altitude_amsl_m"])]
    error_m = estimates["altitude_amsl_m"] - made.truth_m(estimates["time_us"])
    return made.elapsed_s(estimates["time_us"]), error_m, estimates["altitude_sd_m"]


@pytest.mark.parametrize("name", NAMES)
def test_the_spread_of_an_outage_is_that_of_its_errors(name: str) -> None:
    """From calm air to .1 m/s, which is beyond any weather: then the altitude is 25 m wrong at the
    end. A drift that the fixes before have shown widens the spread."""
    nees = []
    for drift_mps in DRIFTS_MPS:
        elapsed_s, error_m, sd_m = fly(name, drift_mps)
        during = (elapsed_s > START_S) & (elapsed_s < END_S)
        ratio = np.abs(error_m[during] / sd_m[during])
        assert ratio.max() < 3.0
        nees.append(np.mean(ratio**2))
        assert np.abs(error_m[during]).max() > 200.0 * abs(drift_mps)
    assert np.mean(nees) < 1.5


@pytest.mark.parametrize("name", CORRECTED)
def test_after_an_outage_the_first_fixes_decide(name: str) -> None:
    """What fixes agreed on before the gap is no evidence after it."""
    elapsed_s, error_m, _ = fly(name, 0.1)
    assert np.abs(error_m[elapsed_s > END_S + 10.0]).max() < 7.0


@pytest.mark.parametrize("name", NAMES)
def test_in_calm_air_the_spread_stays_small(name: str) -> None:
    """A minute without GNSS: still good to 15 m at two sigma."""
    elapsed_s, _, sd_m = fly(name, 0.0)
    assert sd_m[(elapsed_s > START_S) & (elapsed_s < START_S + 60.0)].max() < 7.5


def test_growth() -> None:
    """Nothing before a fix and at it; then weather, column and static port, each by its figure."""
    record = readable(rows(OUTAGE))[0]
    outage_start(record)
    assert growth_m2(record, 5_000_000, 100.0) == 0.0
    note_difference(record, 0, 300.0, 290.0, 0.0, 3.0)
    assert growth_m2(record, 0, 290.0) == 0.0
    hour_us, weather_m2 = 3600 * 1_000_000, 31.0**2 + JUMP_M**2
    assert growth_m2(record, hour_us, 290.0) == pytest.approx(weather_m2, rel=1e-4)
    assert growth_m2(record, 1, 1290.0) == pytest.approx(35.0**2, rel=1e-6)
    assert growth_m2(record, hour_us, np.nan) == pytest.approx(weather_m2, rel=1e-4)
    note_difference(record, 1_000_000, 300.0, 290.0, 60.0, 3.0)
    port_m = np.sqrt(growth_m2(record, 1_000_000 + hour_us, 290.0) - weather_m2 - 21.6**2)
    assert port_m == pytest.approx(0.04 * 60.0**2 / 2.0 / 9.80665, rel=1e-3)


def test_a_scale_factor_is_known_where_fixes_showed_it() -> None:
    """A take-off run of 60 m/s beside a climb of 400 m: its static port looks like 9 % of scale."""
    record = readable(rows(OUTAGE))[0]
    outage_start(record)
    assert extrapolated_m2(record, 1000.0) == 0.0
    for k in range(101):
        note_difference(record, k * 1_000_000, 4.0 * k, 4.0 * k, min(60.0, 3.0 * k), 3.0)
    assert extrapolated_m2(record, 200.0) == extrapolated_m2(record, np.nan) == 0.0
    scale = np.hypot(3.0, 0.2 * 60.0**2 / 2.0 / 9.80665) / 400.0
    assert np.sqrt(extrapolated_m2(record, 1400.0)) == pytest.approx(1000.0 * scale)
    assert np.sqrt(extrapolated_m2(record, -100.0)) == pytest.approx(100.0 * scale)
