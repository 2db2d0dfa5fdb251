"""The smoother on flights with known truth: better than the receiver, and honest about itself."""

import numpy as np
import pytest

from companion.evaluation.smoother import measured_of, smooth
from companion.samples import Kind
from tests.flights import Flight, flight


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
