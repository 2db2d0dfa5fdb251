"""The setting of the altimeter: every estimator that uses the barometer, without any GNSS."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.estimators import ESTIMATORS, Filter
from companion.samples import Kind, Rows, Verdict, sample
from tests.flights import Flight, flight

QNH_PA = 100_725.0
"""of the flights of tests/flights.py"""
NAMES = sorted(ESTIMATORS)
PAPERS = sorted(set(NAMES) - {"vertical-bank"})


def air(time_us: int, **values: float) -> Rows:
    return sample(Kind.AIR, time_us, **values)


def fly(
    name: str, made: Flight, settings: Rows, at_s: float = 0.0, **options: Any
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Elapsed time, altitude error and spread after each pressure; the AIR row comes first at
    `at_s`."""
    method = ESTIMATORS[name]
    running = Filter(method, method.settings(**options))
    tables = made.tables
    events = [
        (int(row["arrival_us"]), kind, tables[kind][i : i + 1])
        for kind in (Kind.IMU, Kind.ATTITUDE, Kind.PRESSURE, Kind.GNSS)
        if kind in tables
        for i, row in enumerate(tables[kind])
    ]
    out, given = [], False
    for _, kind, row in sorted(events, key=lambda event: event[0]):
        time_us = int(row["time_us"][0])
        if kind is Kind.PRESSURE and not given and made.elapsed_s(time_us) >= at_s:
            settings["time_us"] = time_us
            running.step(Kind.AIR, settings)
            given = True
        running.step(kind, row)
        if kind is Kind.PRESSURE:
            value = running.estimate[0]
            truth_m = float(made.truth_m(value["time_us"]))
            out.append(
                (
                    float(made.elapsed_s(time_us)),
                    float(value["altitude_amsl_m"]) - truth_m,
                    float(value["altitude_sd_m"]),
                )
            )
    table = np.array(out)
    return table[:, 0], table[:, 1], table[:, 2]


@pytest.fixture(scope="module")
def silent() -> Flight:
    """A flight without GNSS, 5 Hz of barometer."""
    return flight(duration_s=120.0, gnss_hz=0.0, pressure_hz=5.0, imu_hz=20.0)


@pytest.mark.parametrize("name", PAPERS)
def test_without_gnss_a_qnh_gives_an_altitude_with_an_honest_spread(
    name: str, silent: Flight
) -> None:
    """The air is the standard's above a sea level of 1007.25 hPa: the altitude is right, the spread
    small enough to be sent (below 30 m)."""
    elapsed_s, error_m, sd_m = fly(name, silent, air(0, qnh_pa=QNH_PA))
    late = elapsed_s > 20.0
    assert np.isfinite(error_m[late]).all()
    assert (np.abs(error_m[late]) < 3.0 * sd_m[late]).all()
    assert np.abs(error_m[late]).max() < 8.0
    assert sd_m[late].max() < 30.0


@pytest.mark.parametrize("name", PAPERS)
def test_a_wrong_setting_is_corrected_live(name: str, silent: Flight) -> None:
    """From the start 8 hPa too high (66 m); nobody sets it right: the error stays. A field
    elevation at rest is as good as a QNH."""
    elapsed_s, error_m, _ = fly(name, silent, air(0, qnh_pa=QNH_PA + 800.0))
    assert error_m[elapsed_s > 60.0].mean() == pytest.approx(66.0, abs=6.0)
    elapsed_s, error_m, _ = fly(name, silent, air(0, field_elevation_m=silent.plan.start_m))
    assert np.abs(error_m[elapsed_s > 20.0]).max() < 8.0


@pytest.mark.parametrize("name", PAPERS)
def test_a_setting_that_comes_in_flight_is_taken(name: str, silent: Flight) -> None:
    elapsed_s, error_m, sd_m = fly(name, silent, air(0, qnh_pa=QNH_PA), at_s=30.0)
    late = elapsed_s > 45.0
    assert np.abs(error_m[late]).max() < 12.0
    assert (np.abs(error_m[late]) < 3.0 * sd_m[late]).all()


@pytest.mark.parametrize("name", PAPERS)
def test_bad_settings_are_refused(name: str) -> None:
    running = Filter(ESTIMATORS[name])
    for values in ({"qnh_pa": 20_000.0}, {"field_elevation_m": 1e9}, {"qnh_pa": math.nan}):
        assert running.step(Kind.AIR, air(1_000_000, **values)) in (
            Verdict.INVALID,
            Verdict.IGNORED,
        )
    assert running.step(Kind.AIR, air(1_000_000, qnh_pa=QNH_PA)) is Verdict.USED
    assert running.step(Kind.AIR, air(1_000_000, qnh_pa=QNH_PA)) is Verdict.STALE


def test_ibi_alone_works_without_gnss_and_without_a_setting(silent: Flight) -> None:
    """The paper's first scheme: the standard atmosphere is the datum, and the spread says so."""
    elapsed_s, error_m, sd_m = fly(
        "robust-altimeter", silent, air(0, air_temperature_k=288.0), publish="ibi"
    )
    late = elapsed_s > 20.0
    assert np.isfinite(error_m[late]).all()
    assert (np.abs(error_m[late]) < 2.0 * sd_m[late]).all()
    assert sd_m[late].min() > 80.0


def test_the_barometer_moves_nothing_while_gnss_serves() -> None:
    """``barometer: gnss_unreliable``: a drift of the barometer reaches neither height nor climb
    while there is GNSS, and b follows it, so that the height goes on from GNSS in an outage."""
    made = flight(duration_s=150.0, pressure_hz=5.0, imu_hz=20.0, gnss_hz=5.0)
    made.change(Kind.PRESSURE, "pressure_pa", lambda p: p - 600.0, start_s=60.0)
    made.drop(Kind.GNSS, 120.0)
    errors = {}
    for mode in ("always", "gnss_unreliable"):
        elapsed_s, error_m, _ = fly(
            "baro-gnss-ins", made, air(0, air_temperature_k=288.0), barometer=mode
        )
        errors[mode] = error_m[(elapsed_s > 60.0) & (elapsed_s < 64.0)]
        assert np.abs(error_m[elapsed_s > 125.0]).max() < 15.0
    assert np.abs(errors["gnss_unreliable"]).max() < 3.0
