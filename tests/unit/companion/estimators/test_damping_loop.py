"""Damping loop: poles, exact feedback, compensation of the barometer, and what it does when sensors
fail."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.config import validate
from companion.errors import ConfigError
from companion.estimators.baro_inertial.damping_loop import METHOD, DampingLoopSettings
from companion.estimators.baro_inertial.inputs import calibrated_m
from companion.estimators.baro_inertial.loop_gains import (
    BARO_ALONE,
    TWO_WS2,
    is_stable,
    matched_gains,
    poles,
)
from companion.estimators.method import Filter, run_log
from companion.kernels.atmosphere import baro_altitude_m, geometric_m, pressure_altitude_m
from companion.samples import Kind, Rows, SampleLog, Verdict, sample
from tests.flights import Flight, flight

PAPER = (3.0, 0.6452, 0.8710)
GAINS = [
    PAPER,
    BARO_ALONE,
    (1.0, 0.3, 0.02),
    (3.0, 0.1, 0.01),
    (0.5, 0.05, 0.001),
    (1.16, 1.0, 0.097),
]
INTERVALS_S = [0.001, 0.0025, 0.01, 0.02, 0.1, 0.394, 0.5, 1.0, 3.0, 10.0]


def as_complex(found: tuple[float, float, float]) -> list[complex]:
    real, mean, split = found
    half = complex(split) ** 0.5
    return sorted(
        [complex(real), mean + half, mean - half], key=lambda pole: (pole.real, pole.imag)
    )


def transition(gains: tuple[float, float, float], interval_s: float) -> NDArray[np.float64]:
    """Of the error over one barometer interval: exact flight, then feedback."""
    alpha, beta, gamma = matched_gains(*poles(*gains), interval_s)
    fly = np.array([[1.0, interval_s, interval_s**2 / 2], [0.0, 1.0, interval_s], [0.0, 0.0, 1.0]])
    return np.asarray((np.eye(3) - np.outer([alpha, beta, gamma], [1.0, 0.0, 0.0])) @ fly)


def without_counters(state: Rows) -> bytes:
    copy = state.copy()
    copy["verdicts"] = 0
    return copy.tobytes()


def altitudes(log: SampleLog, **settings: Any) -> Rows:
    return run_log(METHOD, log, DampingLoopSettings(**settings))[0]


def errors_m(made: Flight, estimates: Rows, start_s: float = 60.0) -> NDArray[np.float64]:
    late = (made.elapsed_s(estimates["time_us"]) > start_s) & np.isfinite(
        estimates["altitude_amsl_m"]
    )
    return np.asarray(estimates["altitude_amsl_m"][late] - made.truth_m(estimates["time_us"][late]))


@pytest.fixture(scope="module")
def plain() -> Rows:
    """Estimates of the flight that nothing is wrong with."""
    return altitudes(flight().log())


# The loop


def test_poles_of_the_papers_gains() -> None:
    """vectors.json 004 "poles", which include 2 w_s^2."""
    found = as_complex(poles(PAPER[0], PAPER[1] - TWO_WS2, PAPER[2]))
    expected = [-2.8809887196016524, -0.05950564019917388 - 0.5466130660017132j]
    np.testing.assert_allclose(found[:2], expected, rtol=1e-12)
    assert -found[1].real / abs(found[1]) == pytest.approx(0.108, abs=5e-4)


@pytest.mark.parametrize("gains", GAINS)
def test_poles_are_the_roots_of_the_characteristic_polynomial(
    gains: tuple[float, float, float],
) -> None:
    coefficients = np.poly(np.array(as_complex(poles(*gains))))
    np.testing.assert_allclose(coefficients, [1.0, *gains], rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("interval_s", INTERVALS_S)
@pytest.mark.parametrize("gains", GAINS)
def test_feedback_has_the_loops_own_poles_at_every_rate(
    gains: tuple[float, float, float], interval_s: float
) -> None:
    """So it is stable wherever the continuous loop is: from 1 ms to 10 s."""
    continuous = np.poly(np.exp(np.array(as_complex(poles(*gains))) * interval_s))
    np.testing.assert_allclose(np.poly(transition(gains, interval_s)), continuous, atol=1e-12)


@pytest.mark.parametrize("gains", GAINS)
def test_feedback_of_a_fast_barometer_is_the_papers(gains: tuple[float, float, float]) -> None:
    discrete = np.array(matched_gains(*poles(*gains), 1e-4)) / 1e-4
    np.testing.assert_allclose(discrete, gains, rtol=4e-4, atol=1e-12)


def test_a_step_of_euler_is_unstable_from_394_ms() -> None:
    """README: -2 Re p / |p|^2 of the slow poles; the exact feedback at that rate is not."""
    slow = as_complex(poles(*PAPER))[1]
    assert -2.0 * slow.real / abs(slow) ** 2 == pytest.approx(0.394, abs=5e-4)
    assert np.abs(np.linalg.eigvals(transition(PAPER, 0.394))).max() < 0.98


def test_stability_by_routh() -> None:
    assert is_stable(*PAPER)
    for gains in [(1.0, 0.5, 0.5), (0.0, 1.0, 0.0), (3.0, 0.0, 0.0), (1.0, 1.0, -0.1)]:
        assert not is_stable(*gains)
    with pytest.raises(ConfigError, match="unstable"):
        validate({"k1": 1.0, "k2": 0.5, "k3": 0.5}, DampingLoopSettings, source="test")


def test_constant_error_of_the_accelerometer_is_taken_by_the_compensator() -> None:
    """a_c ends at the bias, and altitude and climb are not touched by it."""
    made = flight(force_bias_mps2=0.0, gnss_hz=5.0, duration_s=200.0)
    made.tables[Kind.IMU]["specific_force_b_mps2"][:, 2] -= 0.2
    estimates, _, state = run_log(METHOD, made.log())
    assert state["a_c"][0] == pytest.approx(0.2, abs=0.05)
    late = made.elapsed_s(estimates["time_us"]) > 180.0
    assert np.abs(estimates["climb_mps"][late] + 3.0).max() < 0.15


# Compensation for the atmosphere


def test_pressure_altitude_of_1() -> None:
    """README: (1) with the right signs is +1505.4 m at 84.5 kPa."""
    assert pressure_altitude_m(84_500.0) == pytest.approx(1505.4, abs=0.1)


@pytest.mark.parametrize("warmer_k", [-25.0, 0.0, 15.0])
def test_compensation_is_the_hypsometric_formula(warmer_k: float) -> None:
    """(2) from the start equals the integral of dp = -rho g dH in a column of constant lapse
    rate."""
    start_m, start_pa, lapse, gravity, gas = 1350.0, 85_000.0, 0.0065, 9.80665, 287.05287
    level_m = pressure_altitude_m(start_pa)
    temperature_k = 288.15 - lapse * level_m + warmer_k
    scale = temperature_k / (288.15 - lapse * level_m) - 1.0
    for pressure_pa in (99_000.0, 85_000.0, 60_000.0, 30_000.0):
        expected = start_m + temperature_k / lapse * (
            1.0 - (pressure_pa / start_pa) ** (gas * lapse / gravity)
        )
        found = calibrated_m(pressure_altitude_m(pressure_pa), level_m, start_m, scale)
        assert found == pytest.approx(geometric_m(expected), abs=1e-6)


def test_start_is_the_median_of_the_first_fixes() -> None:
    """One wild fix among them does not matter; later fixes do not move the altitude at all."""
    made = flight(duration_s=60.0)
    wild = made.copy().change(Kind.GNSS, "altitude_amsl_m", lambda value: value + 300.0, 0.9, 1.1)
    later = made.copy().change(Kind.GNSS, "altitude_amsl_m", lambda value: value + 30.0, 30.0)
    plain = altitudes(made.log())["altitude_amsl_m"][-1]
    assert altitudes(wild.log())["altitude_amsl_m"][-1] == pytest.approx(plain, abs=1.0)
    assert altitudes(later.log())["altitude_amsl_m"][-1] == pytest.approx(
        plain, abs=1e-4
    )  # through gravity


def test_start_can_be_given() -> None:
    made = flight(duration_s=30.0, gnss_hz=0.0, pressure_sd_pa=0.0)
    assert not np.isfinite(altitudes(made.log())["altitude_amsl_m"]).any()
    given = altitudes(made.log(), start_altitude_m=300.0)
    assert np.abs(errors_m(made, given, 0.0)).max() < 0.5


def test_poor_fixes_do_not_start() -> None:
    made = flight(duration_s=20.0).change(
        Kind.GNSS, "vertical_sd_m", lambda value: 25.0 + 0.0 * value
    )
    assert not np.isfinite(altitudes(made.log())["altitude_amsl_m"]).any()


def test_temperature_of_the_start_scales_the_climb() -> None:
    """28 K above standard at 300 m: each standard metre is a tenth longer."""
    made = flight(duration_s=140.0)
    top = made.elapsed_s(altitudes(made.log())["time_us"]) > 120.0
    plain, warm = altitudes(made.log()), altitudes(made.log(), start_temperature_k=1.1 * 286.0)
    climbed = np.median(plain["altitude_amsl_m"][top]) - 300.0
    gained = np.median(warm["altitude_amsl_m"][top] - plain["altitude_amsl_m"][top])
    assert gained == pytest.approx(0.1 * climbed, rel=0.05)
    die = altitudes(
        made.log(), start_temperature_k="die", die_excess_k=20.0
    )  # 303 K less 20 K: 3 K below standard
    assert np.median(die["altitude_amsl_m"][top] - plain["altitude_amsl_m"][top]) == pytest.approx(
        -2.5, abs=0.7
    )


# Flights


def test_flight_with_everything() -> None:
    made = flight()
    estimates, verdicts, state = run_log(METHOD, made.log())
    error = errors_m(made, estimates)
    assert np.sqrt(np.mean(error**2)) < 2.0  # the start's, and 6 hPa off does not matter
    assert np.std(error) < 0.8
    rows = np.isfinite(estimates["altitude_sd_m"])
    assert 0.8 < np.median(estimates["altitude_sd_m"][rows]) < 3.0
    used = state["verdicts"][0][:, Verdict.USED].sum()
    assert used >= 0.99 * state["verdicts"][0].sum()
    assert set(verdicts) <= {int(Verdict.USED), int(Verdict.IGNORED)}


@pytest.mark.parametrize(
    ("changes", "within_m"),
    [
        ({"imu_hz": 0.0}, 4.0),
        ({"imu_hz": 2.0}, 4.0),
        ({"imu_hz": 12.0}, 3.0),
        ({"imu_hz": 200.0, "duration_s": 60.0}, 3.0),
        ({"pressure_hz": 1.0}, 3.0),
        ({"pressure_hz": 1.0, "imu_hz": 1.0}, 5.0),
        ({"gnss_hz": 1.0}, 3.0),
        ({"attitude_hz": 0.0}, 3.0),
        ({"pressure_hz": 0.0}, 6.0),
    ],
)
def test_flight_with_less(changes: dict[str, Any], within_m: float) -> None:
    made = flight(**({"duration_s": 110.0} | changes))
    error = errors_m(made, altitudes(made.log()), 30.0)
    assert error.size > 50
    assert np.abs(error).max() < within_m


def test_slow_imu_is_ignored_and_said_so() -> None:
    state = run_log(METHOD, flight(imu_hz=4.0, duration_s=60.0).log())[2]
    assert state["verdicts"][0][Kind.IMU, Verdict.IGNORED] == 240
    assert state["verdicts"][0][Kind.PRESSURE, Verdict.USED] == 1200


@pytest.mark.parametrize("offset_pa", [-1200.0, -60.0, 300.0])
def test_barometer_step_for_a_minute(plain: Rows, offset_pa: float) -> None:
    """The step is in the altitude while it lasts, and gone within seconds after."""
    made = flight()
    stepped = made.copy().change(
        Kind.PRESSURE, "pressure_pa", lambda value: value + offset_pa, 100.0, 160.0
    )
    faulty = altitudes(stepped.log())
    during = made.elapsed_s(plain["time_us"]) > 155.0
    during &= made.elapsed_s(plain["time_us"]) < 160.0
    difference = faulty["altitude_amsl_m"] - plain["altitude_amsl_m"]
    expected = -offset_pa * 0.091  # at 550 m
    assert np.median(difference[during]) == pytest.approx(expected, rel=0.1, abs=0.3)
    after = made.elapsed_s(plain["time_us"]) > 220.0
    assert np.abs(difference[after]).max() < 1.0
    spread = faulty["altitude_sd_m"][during]
    assert np.median(spread) > 0.6 * abs(expected)  # GNSS shows it


def test_spikes_do_no_harm(plain: Rows) -> None:
    made = flight()
    spiked = made.copy()
    random = np.random.default_rng(3)
    chosen = random.random(spiked.tables[Kind.PRESSURE].size) < 0.02
    spiked.tables[Kind.PRESSURE]["pressure_pa"][chosen] += 900.0
    estimates, _, state = run_log(METHOD, spiked.log())
    assert np.abs(estimates["altitude_amsl_m"] - plain["altitude_amsl_m"])[300:].max() < 1.0
    assert state["verdicts"][0][Kind.PRESSURE, Verdict.GATED] > 0.95 * chosen[60:].sum()


def test_gap_of_all_sensors() -> None:
    made = flight()
    for kind in (Kind.IMU, Kind.PRESSURE, Kind.GNSS, Kind.ATTITUDE):
        made.drop(kind, 80.0, 140.0)
    assert np.abs(errors_m(made, altitudes(made.log()), 150.0)).max() < 3.0


def test_without_the_barometer_it_is_gnss() -> None:
    made = flight().drop(Kind.PRESSURE, 100.0, 170.0)
    estimates = altitudes(made.log())
    silent = (made.elapsed_s(estimates["time_us"]) > 106.0) & (
        made.elapsed_s(estimates["time_us"]) < 170.0
    )
    error = estimates["altitude_amsl_m"][silent] - made.truth_m(estimates["time_us"][silent])
    assert 0.3 < np.std(error) < 2.0
    assert np.abs(errors_m(made, estimates, 175.0)).max() < 3.0


def test_spread_grows_without_gnss() -> None:
    made = flight().drop(Kind.GNSS, 30.0)
    spread = altitudes(made.log(), pressure_drift_mps=0.1)["altitude_sd_m"]
    assert spread[-1] == pytest.approx(math.hypot(spread[3000], 0.1 * 230.0), rel=0.25)


def test_what_is_no_measurement_leaves_no_trace() -> None:
    running = Filter(METHOD)
    log = flight(duration_s=20.0).log()
    for kind, row in zip(log.tables.order["kind"], log.tables.order["row"], strict=True):
        running.step(Kind(kind), log[Kind(kind)][row : row + 1])
    last_us = int(log[Kind.IMU]["time_us"][-1])
    level = {"specific_force_b_mps2": (0.0, 0.0, -9.8), "angular_rate_b_radps": (0.0, 0.0, 0.0)}
    bad = [
        (Kind.PRESSURE, sample(Kind.PRESSURE, last_us + 100), Verdict.INVALID),
        (Kind.PRESSURE, sample(Kind.PRESSURE, last_us + 100, pressure_pa=1.0), Verdict.INVALID),
        (
            Kind.PRESSURE,
            sample(Kind.PRESSURE, last_us - 9_000_000, pressure_pa=97_000.0),
            Verdict.STALE,
        ),
        (Kind.IMU, sample(Kind.IMU, last_us + 100), Verdict.INVALID),
        (
            Kind.IMU,
            sample(Kind.IMU, last_us + 100, **level | {"specific_force_b_mps2": 1e4}),
            Verdict.INVALID,
        ),
        (Kind.IMU, sample(Kind.IMU, last_us, **level), Verdict.STALE),
        (Kind.GNSS, sample(Kind.GNSS, last_us + 100), Verdict.INVALID),
        (Kind.ATTITUDE, sample(Kind.ATTITUDE, last_us + 100), Verdict.INVALID),
    ]
    before, estimate = without_counters(running.state), running.estimate.tobytes()
    for kind, row, verdict in bad:
        assert running.step(kind, row) is verdict
        assert without_counters(running.state) == before
        assert running.estimate.tobytes() == estimate


def test_reboot_starts_anew() -> None:
    running = Filter(METHOD)
    log = flight(duration_s=20.0).log()
    for kind, row in zip(log.tables.order["kind"], log.tables.order["row"], strict=True):
        running.step(Kind(kind), log[Kind(kind)][row : row + 1])
    assert running.is_valid
    running.step(Kind.STATUS, sample(Kind.STATUS, 1000, reboot=1))
    assert not running.is_valid
    assert without_counters(running.state) == without_counters(METHOD.init(running.params))


def test_baro_offset_is_what_the_weather_does() -> None:
    """Altitude less standard-atmosphere height: here 6 hPa, 50 m low pressure."""
    made = flight(duration_s=20.0)
    last = altitudes(made.log())[-1]
    pressure = made.tables[Kind.PRESSURE]["pressure_pa"][-1]
    assert last["altitude_amsl_m"] - last["baro_offset_m"] == pytest.approx(
        baro_altitude_m(pressure), abs=0.01
    )
