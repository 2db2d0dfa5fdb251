"""Rules of the vertical bank over random manoeuvres, IMU rates and faults.

Each example flies the synthetic flight of `tests.flights` with one fault, and checks what must hold
whatever the mixture makes of it.
"""

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.estimators.method import run_log
from companion.estimators.vertical_bank import METHOD
from companion.samples import Kind
from tests.flights import Flight, flight

Array = NDArray[Any]
LOST_LEVEL_M = 50.0
FEW = settings(
    max_examples=4, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck)
)
MANY = settings(
    max_examples=60, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck)
)
IMU_HZ = st.sampled_from([0.0, 2.0, 10.0, 25.0])
SEEDS = st.integers(1, 1000)


def told(made: Flight) -> tuple[Array, Array, Array]:
    """Seconds and errors of the estimates that would be published, and the named sensor."""
    estimates, _, _ = run_log(METHOD, made.log())
    known = np.isfinite(estimates["altitude_amsl_m"])
    known &= estimates["protection_level_m"] < LOST_LEVEL_M
    rows = estimates[known]
    error_m = rows["altitude_amsl_m"] - made.truth_m(rows["time_us"])
    return made.elapsed_s(rows["time_us"]), error_m, rows["faulty"]


def check_gnss_step(imu_hz: float, seed: int, step_m: float) -> None:
    made = flight(imu_hz=imu_hz, seed=seed)
    made.change(Kind.GNSS, "altitude_amsl_m", lambda h: h + step_m, 120.0, 200.0)
    elapsed_s, error_m, _ = told(made)
    assert np.abs(error_m[elapsed_s > 60.0]).max() < 15.0
    assert np.mean(elapsed_s > 205.0) > 0.1, "published again after the step"


def check_gap(imu_hz: float, seed: int, gap_s: float) -> None:
    made = flight(imu_hz=imu_hz, seed=seed)
    for kind in list(made.tables):
        made.drop(kind, 100.0, 100.0 + gap_s)
    elapsed_s, error_m, _ = told(made)
    assert elapsed_s[elapsed_s > 100.0 + gap_s][0] < 105.0 + gap_s
    assert np.abs(error_m[elapsed_s > 60.0]).max() < 20.0


def check_healthy(imu_hz: float, seed: int) -> None:
    elapsed_s, error_m, faulty = told(flight(imu_hz=imu_hz, seed=seed))
    late = elapsed_s > 60.0
    assert not faulty[late].any()
    assert np.abs(error_m[late]).max() < 8.0


@FEW
@given(IMU_HZ, SEEDS, st.sampled_from([-200.0, -30.0, 30.0, 500.0]))
def test_a_step_that_no_vehicle_can_fly_is_not_followed(
    imu_hz: float, seed: int, step_m: float
) -> None:
    check_gnss_step(imu_hz, seed, step_m)


@FEW
@given(IMU_HZ, SEEDS, st.floats(3.0, 120.0))
def test_after_a_gap_the_first_credible_readings_decide(
    imu_hz: float, seed: int, gap_s: float
) -> None:
    check_gap(imu_hz, seed, gap_s)


@FEW
@given(IMU_HZ, SEEDS)
def test_a_healthy_flight_excludes_nobody(imu_hz: float, seed: int) -> None:
    check_healthy(imu_hz, seed)


@pytest.mark.long
@MANY
@given(IMU_HZ, SEEDS, st.floats(30.0, 600.0), st.booleans(), st.floats(3.0, 120.0))
def test_the_same_over_many(
    imu_hz: float, seed: int, step_m: float, is_down: bool, gap_s: float
) -> None:
    check_healthy(imu_hz, seed)
    check_gnss_step(imu_hz, seed, -step_m if is_down else step_m)
    check_gap(imu_hz, seed, gap_s)
