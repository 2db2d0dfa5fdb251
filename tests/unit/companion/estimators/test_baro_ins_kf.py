"""Baro-inertial Kalman filter: what its states are for, and what it does when sensors fail."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.estimators.baro_inertial.baro_ins_kf import METHOD
from companion.estimators.baro_inertial.settings import BaroInsKfSettings
from companion.estimators.method import Filter, run_log
from companion.samples import Kind, Rows, SampleLog, Verdict, sample
from tests.flights import Flight, flight


def altitudes(log: SampleLog, **settings: Any) -> Rows:
    return run_log(METHOD, log, BaroInsKfSettings(**settings))[0]


def errors_m(made: Flight, estimates: Rows, start_s: float = 60.0) -> NDArray[np.float64]:
    late = (made.elapsed_s(estimates["time_us"]) > start_s) & np.isfinite(
        estimates["altitude_amsl_m"]
    )
    return np.asarray(estimates["altitude_amsl_m"][late] - made.truth_m(estimates["time_us"][late]))


def covariance(state: Rows) -> NDArray[np.float64]:
    return np.asarray(state["P"][0])


def test_flight_with_everything() -> None:
    made = flight()
    estimates, verdicts, state = run_log(METHOD, made.log())
    error = errors_m(made, estimates)
    assert np.sqrt(np.mean(error**2)) < 2.0
    assert np.std(error) < 0.8
    assert set(verdicts) <= {int(Verdict.USED), int(Verdict.IGNORED)}
    np.testing.assert_array_equal(covariance(state), covariance(state).T)
    assert np.linalg.eigvalsh(covariance(state)).min() > 0.0


def test_bias_of_the_accelerometer_needs_its_state() -> None:
    """20 mg: with the state it is found, without it climb is off for ever."""
    made = flight(force_bias_mps2=0.0, duration_s=160.0)
    made.tables[Kind.IMU]["specific_force_b_mps2"][:, 2] -= 0.2
    late = slice(-500, None)
    with_state, _, state = run_log(METHOD, made.log(), BaroInsKfSettings())
    without = altitudes(made.log(), accelerometer_bias_state=False)
    assert state["x"][0][3] == pytest.approx(0.2, abs=0.05)
    assert abs(np.mean(with_state["climb_mps"][late])) < 0.06  # level flight
    assert np.mean(without["climb_mps"][late]) > 0.15


def test_without_the_bias_state_it_has_three() -> None:
    """As in (14): nothing of the fourth is ever other than zero."""
    state = run_log(
        METHOD, flight(duration_s=30.0).log(), BaroInsKfSettings(accelerometer_bias_state=False)
    )[2]
    assert state["x"][0][3] == 0.0
    assert not covariance(state)[3].any()


@pytest.mark.parametrize(
    ("changes", "within_m"),
    [
        ({"imu_hz": 0.0}, 4.0),
        ({"imu_hz": 4.0, "pressure_hz": 1.0}, 5.0),
        ({"pressure_hz": 1.0}, 3.0),
        ({"gnss_hz": 1.0, "attitude_hz": 0.0}, 3.0),
        ({"pressure_hz": 0.0}, 6.0),
    ],
)
def test_flight_with_less(changes: dict[str, Any], within_m: float) -> None:
    made = flight(**({"duration_s": 110.0} | changes))
    error = errors_m(made, altitudes(made.log()), 30.0)
    assert error.size > 50
    assert np.abs(error).max() < within_m


@pytest.mark.parametrize("offset_pa", [-1200.0, -60.0, 300.0])
def test_barometer_step_for_a_minute(offset_pa: float) -> None:
    made = flight()
    stepped = made.copy().change(
        Kind.PRESSURE, "pressure_pa", lambda value: value + offset_pa, 100.0, 160.0
    )
    plain, faulty = altitudes(made.log()), altitudes(stepped.log())
    after = made.elapsed_s(plain["time_us"]) > 220.0
    assert np.abs(faulty["altitude_amsl_m"] - plain["altitude_amsl_m"])[after].max() < 1.0


def test_gap_of_all_sensors() -> None:
    made = flight()
    for kind in (Kind.IMU, Kind.PRESSURE, Kind.GNSS, Kind.ATTITUDE):
        made.drop(kind, 80.0, 140.0)
    assert np.abs(errors_m(made, altitudes(made.log()), 150.0)).max() < 3.0


def test_what_is_no_measurement_leaves_no_trace_and_a_reboot_none_of_the_past() -> None:
    running = Filter(METHOD)
    log = flight(duration_s=20.0).log()
    for kind, row in zip(log.tables.order["kind"], log.tables.order["row"], strict=True):
        running.step(Kind(kind), log[Kind(kind)][row : row + 1])

    def without_counters() -> bytes:
        copy = running.state.copy()
        copy["verdicts"] = 0
        return copy.tobytes() + running.estimate.tobytes()

    before = without_counters()
    last_us = int(log[Kind.IMU]["time_us"][-1])
    for kind in (Kind.IMU, Kind.PRESSURE, Kind.GNSS, Kind.ATTITUDE):
        assert running.step(kind, sample(kind, last_us + 100)) is Verdict.INVALID
        assert without_counters() == before
    running.step(Kind.STATUS, sample(Kind.STATUS, 1000, reboot=1))
    fresh = METHOD.init(running.params)
    assert not running.is_valid
    running.state["verdicts"] = 0
    assert running.state.tobytes() == fresh.tobytes()
