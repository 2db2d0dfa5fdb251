"""The vehicle's own estimate: the barometer's shape on one early fix."""

import math

import pytest

from sim.aircraft_state import Truth
from sim.sensors.barometer import Pressure
from sim.sensors.gnss import Fix
from sim.vehicle.flavours import ARDUPILOT
from sim.vehicle.own_estimate import ORIGIN_DELAY_S, EstimateConfig, OwnEstimate
from sim.vehicle.px4 import raised_m
from sim.weather.ramp import Ramp

TRUTH = Truth(
    0, 47.0, 8.0, 500.0, 0.0, 0.0, 0.0, 0.1, 0.05, 3.1, 0.0, 0.0, 0.0, 95_000.0, 285.0, 0.0, True
)


def pressure_pa(altitude_m: float) -> float:
    """ISA, the other way round than the estimate has it."""
    return 101_325.0 * math.pow(1.0 - altitude_m / 44_330.77, 1.0 / 0.190263)


def fix(time_us: int, altitude_m: float, fix_type: int = 3) -> Fix:
    return Fix(
        time_us,
        time_us,
        fix_type,
        47.0,
        8.0,
        altitude_m,
        altitude_m + 47.6,
        30.0,
        0.0,
        0.0,
        2.5,
        4.2,
        0.1,
        14,
        80,
        130,
    )


def climbed(estimate: OwnEstimate, start_m: float, climb_mps: float, duration_s: float) -> int:
    time_us = 0
    for step in range(round(duration_s * 20) + 1):
        time_us = step * 50_000
        altitude_m = start_m + climb_mps * time_us * 1e-6
        estimate.on_pressure(Pressure(time_us, pressure_pa(altitude_m), 290.0))
        if step % 4 == 0:
            estimate.on_fix(
                fix(time_us, 1000.0 if time_us == round(ORIGIN_DELAY_S * 1e6) else 5000.0)
            )
    return time_us


def test_the_origin_is_one_early_fix_and_the_rest_is_barometer() -> None:
    estimate = OwnEstimate(EstimateConfig(), 1, 0.02)
    time_us = climbed(estimate, 300.0, 0.0, ORIGIN_DELAY_S + 20.0)
    position = estimate.position(time_us)
    assert position is not None
    assert position.altitude_amsl_m == pytest.approx(
        1000.0, abs=1e-3
    )  # later fixes at 5000 m change nothing


def test_a_steady_climb_is_followed_without_lag() -> None:
    estimate = OwnEstimate(EstimateConfig(), 1, 0.02)
    time_us = climbed(estimate, 300.0, 5.0, ORIGIN_DELAY_S + 20.0)
    position = estimate.position(time_us + 30_000)
    assert position is not None
    assert position.climb_mps == pytest.approx(5.0, abs=1e-3)
    assert position.altitude_amsl_m == pytest.approx(1000.0 + 5.0 * 20.03, abs=0.01)


def test_a_raised_altitude_is_followed_as_ardupilot_follows_its_offset() -> None:
    """2 % of the difference at 10 Hz: five seconds to 63 %, and whole from a centimetre on."""
    estimate = OwnEstimate(EstimateConfig(), 1, 0.02, ARDUPILOT.raise_time_s)
    start_us = climbed(estimate, 300.0, 0.0, ORIGIN_DELAY_S + 20.0)
    before = estimate.position(start_us)
    assert before is not None
    heights_m = []
    for tick in range(1, 401):
        time_us = start_us + tick * 100_000
        estimate.on_pressure(Pressure(time_us, pressure_pa(300.0), 290.0), 10.0)
        position = estimate.position(time_us)
        assert position is not None
        heights_m.append(position.altitude_amsl_m - before.altitude_amsl_m)
    assert heights_m[1] < 1.0
    smoothing = 5  # samples, half a second
    assert heights_m[49 + smoothing] == pytest.approx(10.0 * (1.0 - 0.98**50), abs=0.5)
    assert heights_m[-1] == pytest.approx(10.0, abs=1e-3)


def test_a_restart_begins_anew() -> None:
    estimate = OwnEstimate(EstimateConfig(), 1, 0.02)
    time_us = climbed(estimate, 300.0, 0.0, ORIGIN_DELAY_S + 20.0)
    estimate.restart()
    assert estimate.position(time_us) is None


def test_a_qnh_raises_the_altitude_by_eight_metres_a_hectopascal() -> None:
    parameters = {"SENS_BARO_QNH": 1014.25}
    assert raised_m(parameters, 101_325.0) == pytest.approx(8.32, abs=0.02)
    assert raised_m({"SENS_BARO_QNH": 1013.25}, 90_000.0) == 0.0


def test_there_is_no_position_before_the_origin_and_no_origin_without_a_fix() -> None:
    estimate = OwnEstimate(EstimateConfig(), 1, 0.02)
    for time_us in range(0, 60_000_000, 1_000_000):
        estimate.on_pressure(Pressure(time_us, 95_000.0, 290.0))
        assert not estimate.on_fix(fix(time_us, 0.0, fix_type=1))
    assert estimate.position(60_000_000) is None


def test_the_position_is_carried_on_between_fixes() -> None:
    estimate = OwnEstimate(EstimateConfig(), 1, 0.02)
    time_us = climbed(estimate, 300.0, 0.0, ORIGIN_DELAY_S)
    position = estimate.position(time_us + 100_000)
    assert position is not None
    assert (position.latitude_deg - 47.0) * 111_319.49 == pytest.approx(30.0 * 0.1, abs=1e-6)


def test_its_attitude_is_wrong_by_as_much_as_it_is_told() -> None:
    exact = OwnEstimate(EstimateConfig(tilt_sd_deg=0.0, heading_sd_deg=0.0), 1, 0.02)
    assert exact.attitude(TRUTH) == pytest.approx((0.1, 0.05, 3.1))
    errors = []
    for seed in range(300):
        roll, _, yaw = OwnEstimate(EstimateConfig(tilt_sd_deg=0.3), seed, 0.02).attitude(TRUTH)
        assert -math.pi <= yaw <= math.pi
        errors.append(math.degrees(roll - 0.1))
    sd = math.sqrt(sum(error**2 for error in errors) / len(errors))
    assert sd == pytest.approx(0.3, rel=5.0 / math.sqrt(600))


def test_a_ramp_is_linear_between_its_points_and_constant_outside() -> None:
    ramp = Ramp([(120.0, 1019.0), (720.0, 1011.0)], 1013.25)
    assert [ramp(t) for t in (0.0, 120.0, 420.0, 720.0, 9e9)] == [
        1019.0,
        1019.0,
        1015.0,
        1011.0,
        1011.0,
    ]
    assert Ramp([], 1013.25)(5.0) == 1013.25
