"""The smoother on flights with known truth: better than the receiver, and honest about itself."""

import numpy as np
import pytest

from companion.evaluation import smoother
from companion.evaluation.metrics import truth_at
from companion.evaluation.smoother import measured_of, smooth
from companion.samples import Kind
from sim.studies.real.gnss_errors import GaussMarkovError
from sim.studies.real.matrix import recording
from sim.studies.real.recording import Plan
from tests.flights import Flight, flight
from tests.paths import DATA


def found_of(made: Flight) -> tuple[float, float, float]:
    """RMSE of the smoother and of raw GNSS (m), and the mean squared error over the variance."""
    measured = measured_of(made.log())
    smoothed = smooth(measured)
    assert smoothed is not None
    error_m = smoothed.altitude_m - made.truth_m(smoothed.time_us)
    raw_m = measured.gnss_m - made.truth_m(measured.gnss_us)
    nees = float(np.mean((error_m / smoothed.sd_m) ** 2))
    return float(np.sqrt(np.mean(error_m**2))), float(np.sqrt(np.mean(raw_m**2))), nees


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_is_better_than_the_receiver_and_honest(seed: int) -> None:
    rmse_m, raw_m, nees = found_of(flight(seed=seed, imu_hz=0.0))
    assert rmse_m < 0.95 * raw_m
    assert nees < 2.0


def test_spikes_of_the_receiver_are_left_out() -> None:
    made = flight(imu_hz=0.0)
    calm_m, _, _ = found_of(made.copy())
    table = made.tables[Kind.GNSS]
    table["altitude_amsl_m"][::40] += 300.0
    rmse_m, raw_m, _ = found_of(made)
    assert raw_m > 40.0
    assert rmse_m < calm_m + 1.0


def test_needs_both_sensors() -> None:
    assert smooth(measured_of(flight(gnss_hz=0.0, imu_hz=0.0).log())) is None
    assert smooth(measured_of(flight(pressure_hz=0.0, imu_hz=0.0).log())) is None


def test_a_gap_without_measurements_has_no_altitude() -> None:
    made = flight(imu_hz=0.0)
    for kind in (Kind.PRESSURE, Kind.GNSS):
        made.drop(kind, 100.0, 200.0)
    smoothed = smooth(measured_of(made.log()))
    assert smoothed is not None
    inside = np.abs(made.elapsed_s(smoothed.time_us) - 150.0) < 40.0
    assert np.isnan(smoothed.altitude_m[inside]).all()


def test_a_receiver_that_reports_too_good_an_accuracy_is_found_out() -> None:
    """The spread follows what the receiver shows, not what it reports."""
    made = flight(imu_hz=0.0)
    rmse_m, _, _ = found_of(made.copy())
    made.tables[Kind.GNSS]["vertical_sd_m"] *= 0.2
    told_m, _, nees = found_of(made)
    assert told_m < rmse_m + 1.0
    assert nees < 3.0


def test_the_steps_of_a_long_session_are_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory is bounded, and the altitude is the same."""
    made = flight(imu_hz=0.0)
    fine = smooth(measured_of(made.log()))
    monkeypatch.setattr(smoother, "MOST_NODES", 150)
    coarse = smooth(measured_of(made.log()))
    assert fine is not None
    assert coarse is not None
    assert coarse.time_us.size <= 151
    assert np.nanmax(np.abs(fine.altitude_m - coarse.at(fine.time_us))) < 5.0


SHARED = DATA / "truth"


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.exists(), reason="the real flights are not here")
@pytest.mark.parametrize("name", ["g1000_KCKN", "flight_1936026"])
def test_real_flights_are_smoothed_well_and_honestly(name: str) -> None:
    """The goal of real flights: 0.60 of the error of raw GNSS, and a spread that tells it."""
    found = []
    for seed in range(1, 5):
        log = recording(SHARED / f"{name}.csv").samples(
            Plan(0, False, 0.0, seed), GaussMarkovError()
        )
        smoothed = smooth(measured_of(log))
        assert smoothed is not None
        truth_us, truth_m = (np.asarray(log.truth[k]) for k in ("time_us", "altitude_amsl_m"))
        error_m = smoothed.altitude_m - truth_at(smoothed.time_us, truth_us, truth_m)
        gnss = log[Kind.GNSS]
        raw_m = gnss["altitude_amsl_m"] - truth_at(gnss["time_us"], truth_us, truth_m)
        ratio = np.sqrt(np.nanmean(error_m**2) / np.nanmean(np.asarray(raw_m) ** 2))
        found.append((ratio, np.nanmean((error_m / smoothed.sd_m) ** 2)))
    ratio, nees = np.mean(found, axis=0)
    assert ratio < 0.65
    assert 0.4 < nees < 1.4
