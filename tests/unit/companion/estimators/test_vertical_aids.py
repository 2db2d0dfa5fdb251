"""What the vertical bank makes of a known QNH, of the air's temperature, and of a range finder."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.estimators.method import Filter, run_log
from companion.estimators.vertical_bank import steps as vb
from companion.evaluation.samples import samples_of
from companion.samples import DTYPES, Kind, Rows, Verdict, sample
from companion.settings import CompanionSettings
from sim.flight import Flight as SimulatedFlight
from sim.scenario import load_scenario
from tests.flights import Flight, flight, standard_pressure_pa

Array = NDArray[np.float64]
NAN = math.nan
ROOF_M = 4.0


def fly(made: Flight) -> tuple[Rows, Array]:
    """Estimates after every sample, and the seconds of each."""
    estimates, _, _ = run_log(vb.METHOD, made.log())
    estimates = estimates[np.isfinite(estimates["altitude_amsl_m"])]
    return estimates, made.elapsed_s(estimates["time_us"])


def error_m(made: Flight, estimates: Rows) -> Array:
    return np.asarray(estimates["altitude_amsl_m"] - made.truth_m(estimates["time_us"]), np.float64)


def add(made: Flight, kind: Kind, elapsed_s: Any, **values: Any) -> Flight:
    """The flight with a table of this kind."""
    table = np.zeros(np.size(elapsed_s), DTYPES[kind])
    table["time_us"] = made.start_us + np.round(np.asarray(elapsed_s) * 1e6).astype(np.int64)
    table["arrival_us"] = (
        made.tables[Kind.PRESSURE]["arrival_us"][0] + (table["time_us"] - made.start_us) + 1000
    )
    for name, value in values.items():
        table[name] = value
    made.tables[kind] = table
    return made


def with_air(made: Flight, qnh_pa: float = NAN, air_k: float = NAN, at_s: float = 0.0) -> Flight:
    return add(made, Kind.AIR, [at_s], qnh_pa=qnh_pa, air_temperature_k=air_k)


@pytest.mark.parametrize("at_s", [0.0, 50.0])
def test_qnh_stands_in_for_a_gnss_that_is_not_there(at_s: float) -> None:
    made = flight().drop(Kind.GNSS)
    without, _ = fly(made.copy())
    estimates, elapsed_s = fly(with_air(made, qnh_pa=100_725.0, at_s=at_s))
    late = elapsed_s > at_s + 1.0
    assert np.abs(error_m(made, without)).max() > 40.0, "six hectopascals"
    assert np.abs(error_m(made, estimates))[late].max() < 8.0
    assert 5.0 < estimates["altitude_sd_m"][late].mean() < 15.0 < without["altitude_sd_m"].min()


def test_qnh_and_gnss_agree() -> None:
    made = flight()
    (without, elapsed_s), (estimates, _) = (
        fly(made.copy()),
        fly(with_air(made, qnh_pa=100_725.0, air_k=285.0)),
    )
    late = elapsed_s > 5.0
    apart_m = np.interp(elapsed_s, made.elapsed_s(estimates["time_us"]), error_m(made, estimates))
    assert np.abs(apart_m - error_m(made, without))[late].max() < 1.5


def test_wrong_qnh_does_no_harm_where_there_is_gnss() -> None:
    """A slip of the pen by 30 hPa, 250 m."""
    made = with_air(flight(), qnh_pa=103_725.0)
    estimates, elapsed_s = fly(made)
    assert np.abs(error_m(made, estimates))[elapsed_s > 30.0].max() < 6.0


def test_temperature_tells_how_far_a_barometer_is_off_in_a_climb() -> None:
    warm_k = 30.0

    def made() -> Flight:
        """A column 30 K too warm, in which 240 m are 26 m less to the barometer. No IMU
        contradicts."""
        flown = flight(start_m=0.0, imu_hz=0.0).drop(Kind.GNSS, 20.0)
        pressure = flown.tables[Kind.PRESSURE]
        reads_m = flown.truth_m(pressure["time_us"]) * 288.15 / (288.15 + warm_k)
        noise_pa = np.random.default_rng(3).normal(0.0, 3.0, pressure.size)
        pressure["pressure_pa"] = standard_pressure_pa(reads_m, 101_325.0) + noise_pa
        return flown

    cold, warm = made(), with_air(made(), air_k=288.15 + warm_k)
    worst = [np.abs(error_m(each, fly(each)[0])).max() for each in (cold, warm)]
    assert worst[1] < 0.5 * worst[0]


def test_known_elevation_is_that_of_the_place_where_it_was_told() -> None:
    """A vehicle taxis uphill by 11 m over a kilometre and stands at the runway: GNSS and barometer
    say so, and the elevation of the apron does not keep them from it."""
    made = flight(imu_hz=0.0)
    rises_m = {
        kind: 11.0 * np.clip((made.elapsed_s(made.tables[kind]["time_us"]) - 60.0) / 60.0, 0.0, 1.0)
        for kind in (Kind.GNSS, Kind.PRESSURE)
    }
    fixes, pressure = made.tables[Kind.GNSS], made.tables[Kind.PRESSURE]
    fixes["altitude_amsl_m"] = made.plan.start_m + rises_m[Kind.GNSS]
    pressure["pressure_pa"] = standard_pressure_pa(
        made.plan.start_m + rises_m[Kind.PRESSURE], made.plan.sea_level_pa
    ) + np.random.default_rng(3).normal(0.0, 3.0, pressure.size)
    elapsed_s = made.elapsed_s(fixes["time_us"])
    fixes["ground_speed_mps"] = np.where((elapsed_s > 60.0) & (elapsed_s < 120.0), 16.0, 0.0)
    fixes["latitude_deg"] = 45.0 + 1000.0 * rises_m[Kind.GNSS] / 11.0 / 111_200.0
    fixes["longitude_deg"] = 8.0
    estimates, at_s = fly(add(made, Kind.AIR, [0.0], field_elevation_m=300.0, qnh_pa=NAN))
    stands = at_s > 180.0
    assert np.abs(estimates["altitude_amsl_m"] - 311.0)[stands].max() < 2.0
    assert np.abs(estimates["altitude_amsl_m"] - 300.0)[(at_s > 2.0) & (at_s < 55.0)].max() < 1.5


@pytest.mark.parametrize(
    ("values", "verdict"),
    [
        ({"qnh_pa": 101_300.0}, Verdict.USED),
        ({"air_temperature_k": 290.0}, Verdict.USED),
        ({"qnh_pa": 1013.0}, Verdict.INVALID),
        ({"air_temperature_k": 20.0}, Verdict.INVALID),
        ({}, Verdict.INVALID),
        ({"qnh_pa": 101_300.0, "instance": 1}, Verdict.IGNORED),
    ],
)
def test_verdicts_of_air(values: dict[str, Any], verdict: Verdict) -> None:
    given = {"qnh_pa": NAN, "air_temperature_k": NAN} | values
    running = Filter(vb.METHOD)
    assert running.step(Kind.AIR, sample(Kind.AIR, 1_000_000, **given)) is verdict
    if verdict is Verdict.USED:
        assert running.step(Kind.AIR, sample(Kind.AIR, 1_000_000, **given)) is Verdict.STALE


def hovering(drift_mps: float, *, ranges: bool, roof: bool = False, away_m: float = 0.0) -> Flight:
    """Armed at 10 s; the barometer drifts; a range finder sees 40 m down. All of it over the same
    place, or away."""
    made = flight()
    fixes, status, pressure = (
        made.tables[kind] for kind in (Kind.GNSS, Kind.STATUS, Kind.PRESSURE)
    )
    fixes["latitude_deg"] = 45.0 + np.where(
        made.elapsed_s(fixes["time_us"]) > 30.0, away_m / 111_200.0, 0.0
    )
    fixes["longitude_deg"] = 8.0
    status["armed"] = made.elapsed_s(status["time_us"]) >= 10.0
    pressure["pressure_pa"] -= 11.5 * drift_mps * made.elapsed_s(pressure["time_us"])
    if ranges:
        elapsed_s = np.arange(0.0, 259.0, 0.1)
        height_m = made.truth_m(made.start_us + elapsed_s * 1e6) - made.plan.start_m + 0.1
        height_m = height_m - np.where(roof & (elapsed_s > 240.0), ROOF_M, 0.0)
        noise_m = np.random.default_rng(5).normal(0.0, 0.03, elapsed_s.size)
        seen = (height_m < 40.0) & (height_m > 0.3)
        add(made, Kind.RANGE, elapsed_s[seen], distance_m=(height_m + noise_m)[seen], downward=1)
    return made


def late_takeoff_error_m(made: Flight) -> float:
    estimates, elapsed_s = fly(made)
    above_m = estimates["height_above_takeoff_m"] - (
        made.truth_m(estimates["time_us"]) - made.plan.start_m
    )
    return float(np.abs(above_m[elapsed_s > 250.0]).mean())


def test_range_finder_takes_the_drift_out_of_the_height_above_takeoff() -> None:
    assert late_takeoff_error_m(hovering(0.01, ranges=False)) > 1.0
    assert late_takeoff_error_m(hovering(0.01, ranges=True)) < 0.3


def test_roof_below_is_not_the_ground() -> None:
    assert late_takeoff_error_m(hovering(0.01, ranges=True, roof=True)) < 0.5


def test_second_range_finder_that_hangs_higher_is_no_step_of_the_ground() -> None:
    made = hovering(0.01, ranges=True)
    first = made.tables[Kind.RANGE]
    second = first.copy()
    second["instance"], second["distance_m"] = 1, first["distance_m"] + 0.8
    made.tables[Kind.RANGE] = np.sort(
        np.concatenate([first, second]), order=["time_us", "instance"]
    )
    assert late_takeoff_error_m(made) < 0.3


def test_ground_elsewhere_tells_nothing() -> None:
    apart_m = abs(
        late_takeoff_error_m(hovering(0.01, ranges=True, away_m=2000.0))
        - late_takeoff_error_m(hovering(0.01, ranges=False, away_m=2000.0))
    )
    assert apart_m < 0.2


@pytest.mark.parametrize(
    ("values", "verdict"),
    [
        ({"distance_m": 5.0, "downward": 0}, Verdict.IGNORED),
        ({"distance_m": NAN, "downward": 1}, Verdict.INVALID),
        ({"distance_m": -1.0, "downward": 1}, Verdict.INVALID),
        ({"distance_m": 5.0, "downward": 1}, Verdict.IGNORED),  # before take-off, with no attitude
    ],
)
def test_verdicts_of_ranges(values: dict[str, Any], verdict: Verdict) -> None:
    assert Filter(vb.METHOD).step(Kind.RANGE, sample(Kind.RANGE, 1_000_000, **values)) is verdict


def test_what_the_configuration_knows_of_the_air_reaches_the_estimator(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    SimulatedFlight(load_scenario("short-hop"), tlog=path, seed=1).run()
    settings = CompanionSettings().with_assignments(["air.qnh_hpa=1005", "air.temperature_c=25"])
    (row,) = samples_of(path, settings).tables.air
    assert (row["qnh_pa"], row["air_temperature_k"]) == (100_500.0, 298.15)
    assert samples_of(path).tables.air.size == 0
