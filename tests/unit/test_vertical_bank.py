"""The vertical bank on synthetic flights: accuracy, honesty, and what each part is for."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.estimators import vertical_bank as vb
from companion.estimators.method import Filter, run_log
from companion.samples import Kind, Rows, Verdict, sample
from tests.flights import Flight, flight

Array = NDArray[np.float64]


def fly(made: Flight, settings: vb.VerticalBankSettings | None = None) -> tuple[Rows, Array, Array]:
    """Estimates after every sample, their errors, and the seconds of each."""
    estimates, _, _ = run_log(vb.METHOD, made.log(), settings)
    known = np.isfinite(estimates["altitude_amsl_m"])
    estimates = estimates[known]
    return (
        estimates,
        estimates["altitude_amsl_m"] - made.truth_m(estimates["time_us"]),
        made.elapsed_s(estimates["time_us"]),
    )


def rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_follows_a_flight_and_knows_how_well() -> None:
    estimates, error, elapsed_s = fly(flight())
    late = elapsed_s > 60.0
    assert rms(error[late]) < 1.5
    assert 0.02 < np.mean((error[late] / estimates["altitude_sd_m"][late]) ** 2) < 1.4
    sums = estimates["drift_probabilities"].sum(axis=1)
    np.testing.assert_allclose(sums, 1.0, atol=1e-9)


@pytest.mark.parametrize("hectopascals", [-12.0, 12.0])
def test_sea_level_pressure_is_not_trusted(hectopascals: float) -> None:
    made = flight(duration_s=160.0)
    scaled = made.copy().change(Kind.PRESSURE, "pressure_pa", lambda p: p * (1.0 + hectopascals / 1013.25))
    one, _, elapsed_s = fly(made)
    other, _, _ = fly(scaled)
    apart = np.abs(one["altitude_amsl_m"] - other["altitude_amsl_m"])[elapsed_s > 60.0]
    assert apart.max() < 0.1


def test_without_imu_and_with_a_slow_one() -> None:
    made = flight()
    whole = rms(fly(made)[1][2000:])
    for imu_hz in (0.0, 4.0):
        estimates, error, elapsed_s = fly(flight(imu_hz=imu_hz))
        assert rms(error[elapsed_s > 60.0]) < whole + 0.5
        assert np.isfinite(estimates["climb_mps"]).all()


def test_slow_imu_is_ignored_and_said_so() -> None:
    filter_ = Filter(vb.METHOD)
    for k in range(40):
        row = sample(
            Kind.IMU, 250_000 * (k + 1), specific_force_b_mps2=(0.0, 0.0, -9.81), angular_rate_b_radps=(0, 0, 0)
        )
        assert filter_.step(Kind.IMU, row) is Verdict.IGNORED


def test_nothing_is_known_before_a_height() -> None:
    filter_ = Filter(vb.METHOD)
    row = sample(Kind.IMU, 1_000_000, specific_force_b_mps2=(0.0, 0.0, -9.81), angular_rate_b_radps=(0, 0, 0))
    filter_.step(Kind.IMU, row)
    assert not filter_.is_valid
    filter_.step(Kind.PRESSURE, sample(Kind.PRESSURE, 1_100_000, pressure_pa=95_000.0))
    assert filter_.estimate["altitude_sd_m"][0] > 100.0


def test_vertical_velocity_helps() -> None:
    made = flight(gnss_sd_m=6.0)
    with_climb = made.copy()
    climb = np.gradient(made.truth_m(made.tables[Kind.GNSS]["time_us"]), 0.2)
    with_climb.tables[Kind.GNSS]["climb_mps"] = climb
    without_sd = fly(made)[0]["altitude_sd_m"][-1]
    assert fly(with_climb)[0]["altitude_sd_m"][-1] < without_sd


def test_late_fixes_meet_their_own_time() -> None:
    """A fix that is 0.4 s old in a 4 m/s climb: uncompensated that is 1.6 m."""
    prompt, late = flight(duration_s=90.0, gnss_age_s=0.05), flight(duration_s=90.0, gnss_age_s=0.4)
    climbing = 60.0
    one, two = fly(prompt), fly(late)
    apart = np.mean(one[1][one[2] > climbing]) - np.mean(two[1][two[2] > climbing])
    assert abs(apart) < 0.15


def test_lasting_baro_step_is_learned() -> None:
    made = flight().change(Kind.PRESSURE, "pressure_pa", lambda p: p - 170.0, 120.0)  # 15 m
    _, error, elapsed_s = fly(made)
    assert np.abs(error[elapsed_s > 60.0]).max() < 3.0


def test_step_costs_little_and_checkpoint_is_small() -> None:
    assert vb.STATE.itemsize < 64 * 1024
