"""The setting of the altimeter: every estimator that uses the barometer, without any GNSS."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.estimators import ESTIMATORS, Filter
from companion.estimators.air_data_gnss.error import ERROR, error_start, refer_to
from companion.estimators.air_data_gnss.settings import AirDataGnssSettings
from companion.estimators.setting import (
    SETTING,
    indicated_m,
    indicated_sd_m,
    note_air,
    note_level,
    setting_start,
)
from companion.kernels.atmosphere import (
    G0_MPS2,
    L0_KPM,
    R_AIR,
    T0_K,
    geopotential_m,
    pressure_altitude_m,
    qnh_pa,
)
from companion.samples import Kind, Rows, Verdict, rows, sample
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


@pytest.mark.parametrize("field_m", [0.0, 300.0])
def test_a_field_at_sea_level_is_a_field(field_m: float) -> None:
    """The temperature of a field at exactly 0 m is used as that of any other; where the field is
    unknown it is not."""
    setting = rows(SETTING)
    setting_start(setting[0])
    told = {"qnh_pa": QNH_PA, "air_temperature_k": 300.0}
    note_air(setting[0], air(1_000_000, **told), True)
    assert math.isnan(setting[0]["air_k"])
    setting_start(setting[0])
    note_air(setting[0], air(1_000_000, field_elevation_m=field_m), False)
    note_level(setting[0], field_m)
    note_air(setting[0], air(2_000_000, **told), True)  # in flight: for the same field
    assert setting[0]["field_m"] == field_m
    assert setting[0]["air_k"] == 300.0


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


FIELD_M, ABOVE_M, WARMER_K = 300.0, 1000.0, 15.0


def warm_pressure_pa(height_m: float) -> float:
    """Of a column with the standard lapse rate, WARMER_K above the standard (geopotential)."""
    ratio = 1.0 + L0_KPM * height_m / (T0_K + WARMER_K)
    return 101_000.0 * float(ratio ** (-G0_MPS2 / (R_AIR * L0_KPM)))


def set_at_field(**values: float) -> Rows:
    """An AIR sample of the field's QNH."""
    return air(
        1_000_000, qnh_pa=qnh_pa(warm_pressure_pa(geopotential_m(FIELD_M)), FIELD_M), **values
    )


@pytest.mark.parametrize(
    ("air_k", "error_m"), [(math.nan, -49.6), (T0_K + WARMER_K + L0_KPM * FIELD_M, 0.0)]
)
def test_the_temperature_of_the_field_scales_the_column(air_k: float, error_m: float) -> None:
    """15 K warmer than standard: 1000 m of air are 950 m of the standard's."""
    record = np.zeros(1, SETTING).view(np.recarray)[0]
    setting_start(record)
    note_air(record, set_at_field(air_temperature_k=air_k), False)
    note_level(record, pressure_altitude_m(warm_pressure_pa(geopotential_m(FIELD_M))))
    assert record.field_m == pytest.approx(FIELD_M, abs=1e-6)
    top_m = FIELD_M + ABOVE_M
    level_m = pressure_altitude_m(warm_pressure_pa(geopotential_m(top_m)))
    indicated = indicated_m(record, level_m)
    assert indicated - top_m == pytest.approx(error_m, abs=0.5)
    assert abs(indicated - top_m) < 2.0 * indicated_sd_m(record, indicated, 1_000_000)


def test_a_temperature_whose_height_is_unknown_is_not_used() -> None:
    """In flight and without the elevation of the field."""
    record = np.zeros(1, SETTING).view(np.recarray)[0]
    setting_start(record)
    note_air(record, set_at_field(air_temperature_k=303.0), True)
    assert math.isnan(record.air_k)
    note_air(record, set_at_field(air_temperature_k=303.0, field_elevation_m=FIELD_M), True)
    assert record.air_k == 303.0
    note_air(record, air(2_000_000, qnh_pa=QNH_PA, air_temperature_k=301.0), True)
    assert (record.field_m, record.air_k) == (FIELD_M, 301.0), "the field stays known"


def test_adaptive_fusion_takes_p0_and_t0_of_31_live() -> None:
    """h^B is T_0/T_grad (1 - (p/p_0)^(T_grad R/g)) with what is set; a change in flight moves h^B
    and the held residual by the same amount; the altitude stays between barometer and GNSS."""
    running = Filter(ESTIMATORS["adaptive-fusion"])
    top_m = FIELD_M + ABOVE_M
    warm_k = T0_K + WARMER_K + L0_KPM * FIELD_M

    def pressure(at_s: float, height_m: float) -> None:
        value = warm_pressure_pa(geopotential_m(height_m))
        running.step(Kind.PRESSURE, sample(Kind.PRESSURE, round(at_s * 1e6), pressure_pa=value))

    running.step(Kind.AIR, set_at_field(air_temperature_k=warm_k))
    pressure(1.0, FIELD_M)
    pressure(2.0, top_m)
    state = running.state[0]
    assert state["baro_m"] == pytest.approx(top_m, abs=0.5)
    fix = sample(Kind.GNSS, 2_000_000, altitude_amsl_m=top_m + 8.0, fix_type=3, vertical_sd_m=9.0)
    running.step(Kind.GNSS, fix)
    assert state["delta_m"] == pytest.approx(8.0, abs=0.5)
    assert running.estimate[0]["altitude_amsl_m"] == pytest.approx(top_m + 4.0, abs=0.5)
    before_m = float(state["baro_m"])
    running.step(
        Kind.AIR, air(2_100_000, qnh_pa=101_000.0, field_elevation_m=0.0, air_temperature_k=303.15)
    )
    moved_m = float(state["baro_m"]) - before_m
    assert moved_m == pytest.approx(0.0, abs=1.0), "the same column, told at sea level"
    assert state["delta_m"] == pytest.approx(8.0 - moved_m, abs=0.5)


def test_air_data_gnss_takes_the_field_as_h0_live() -> None:
    """The scale factor counts from the field once that is told, and the known error stays the same
    function of height."""
    running = Filter(ESTIMATORS["air-data-gnss"])
    level_pa = warm_pressure_pa(geopotential_m(FIELD_M))

    def pressure(at_s: float) -> None:
        row = sample(Kind.PRESSURE, round(at_s * 1e6), pressure_pa=level_pa)
        running.step(Kind.PRESSURE, row)

    for at_s in (1.0, 1.2):
        pressure(at_s)
    error = running.state[0]["error"]
    assert (error["H_0"], error["T_0"]) == (0.0, T0_K)
    running.step(Kind.AIR, air(1_300_000, field_elevation_m=FIELD_M, air_temperature_k=300.0))
    pressure(1.4)
    assert error["H_0"] == FIELD_M
    assert error["T_0"] == pytest.approx(T0_K + L0_KPM * FIELD_M)
    assert running.estimate[0]["altitude_amsl_m"] == pytest.approx(FIELD_M, abs=2.0)


def test_another_reference_height_is_the_same_error() -> None:
    error = np.zeros(1, ERROR).view(np.recarray)[0]
    params = AirDataGnssSettings().params()
    error_start(error, params)
    error.x[0], error.x[1] = -0.03, 12.0
    error.P[0, 1] = error.P[1, 0] = 0.4
    heights = np.array([0.0, 500.0, 3000.0])
    rows = np.stack([heights, np.ones(3)], axis=1)
    before, spread_before = rows @ error.x, np.einsum("ij,jk,ik->i", rows, error.P, rows)
    refer_to(error, params, 500.0)
    rows[:, 0] -= 500.0
    np.testing.assert_allclose(rows @ error.x, before)
    np.testing.assert_allclose(np.einsum("ij,jk,ik->i", rows, error.P, rows), spread_before)


@pytest.mark.parametrize("name", ["damping-loop", "baro-ins-kf"])
def test_the_baro_inertial_filters_take_the_air_temperature_of_the_start(name: str) -> None:
    """s of (2) from an AIR sample before the start; later ones are IGNORED."""
    running = Filter(ESTIMATORS[name])
    field_k = T0_K + WARMER_K + L0_KPM * FIELD_M
    field_pa = warm_pressure_pa(geopotential_m(FIELD_M))
    assert running.step(Kind.AIR, air(900_000, air_temperature_k=field_k)) is Verdict.USED
    running.step(Kind.AIR, set_at_field())
    running.step(Kind.PRESSURE, sample(Kind.PRESSURE, 1_000_000, pressure_pa=field_pa))
    level_m = pressure_altitude_m(field_pa)
    inputs = running.state[0]["inputs"]
    assert inputs["scale"] == pytest.approx(field_k / (T0_K + L0_KPM * level_m) - 1.0)
    assert running.step(Kind.AIR, air(1_100_000, air_temperature_k=250.0)) is Verdict.IGNORED
    assert inputs["start_air_k"] == field_k
