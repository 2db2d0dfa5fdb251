"""Each sensor's errors have the statistics of its parameters, and a random stream of its own.

Bounds are five standard deviations of the estimated statistic, from the number of independent
samples.
"""

import math
from itertools import islice

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.aircraft_state import Motion, Truth
from sim.sensors import GaussMarkov, normals
from sim.sensors.barometer import Barometer, BarometerConfig
from sim.sensors.gnss import GnssConfig, GnssReceiver
from sim.sensors.imu import Imu, ImuConfig

Series = NDArray[np.float64]
STILL = Motion((0.0, 0.0, -9.80665), (0.0, 0.0, 0.0))
TRUTH = Truth(
    0,
    47.0,
    8.0,
    500.0,
    30.0,
    20.0,
    -1.0,
    0.0,
    0.0,
    0.0,
    0.0,
    0.0,
    0.0,
    95_000.0,
    285.0,
    40.0,
    False,
)


def barometer_errors(config: BarometerConfig, count: int, seed: int = 1) -> Series:
    barometer = Barometer(config, seed)
    period = barometer.period_us
    return np.array(
        [
            barometer.measure(i * period, 95_000.0, 280.0).pressure_pa - 95_000.0
            for i in range(count)
        ]
    )


def gnss_heights(config: GnssConfig, count: int, seed: int = 1) -> Series:
    receiver = GnssReceiver(config, seed)
    heights = []
    for i in range(count):
        receiver.measure(TRUTH._replace(time_us=i * receiver.period_us))
        fix = receiver.deliver(10**15)
        assert fix is not None
        heights.append(fix.altitude_amsl_m - TRUTH.altitude_amsl_m)
    return np.array(heights)


def test_normals_are_standard_normal_and_independent_by_name() -> None:
    count = 200_000
    first = np.array(list(islice(normals(7, "barometer", "white"), count)))
    second = np.array(list(islice(normals(7, "gnss", "white"), count)))
    bound = 5.0 / math.sqrt(count)
    assert abs(first.mean()) < bound
    assert abs(first.std() - 1.0) < bound  # sd of an sd: 1 / sqrt(2 n)
    assert abs(np.corrcoef(first, second)[0, 1]) < bound
    assert (
        abs(np.mean(np.abs(first) < 1.0) - 0.682689) < bound
    )  # a normal shape, not only a normal variance


def test_normals_repeat_for_a_seed_and_not_for_another() -> None:
    def draw(seed: int) -> list[float]:
        return list(islice(normals(seed, "imu"), 10_000))

    assert draw(1) == draw(1)
    assert draw(1) != draw(2)


def test_gauss_markov_has_its_variance_and_time_constant() -> None:
    sd, tau_s, dt_s, count = 4.0, 5.0, 0.1, 200_000
    process = GaussMarkov(sd, tau_s, dt_s, normals(3, "test"))
    values = np.array([process.step() for _ in range(count)])
    independent = count * dt_s / (2.0 * tau_s)
    assert values.mean() == pytest.approx(0.0, abs=5.0 * sd / math.sqrt(independent))
    assert values.var() == pytest.approx(sd**2, rel=5.0 * math.sqrt(2.0 / independent))
    for lag_s in (1.0, 5.0, 10.0):
        lag = round(lag_s / dt_s)
        correlation = np.mean(values[lag:] * values[:-lag]) / sd**2
        assert correlation == pytest.approx(
            math.exp(-lag_s / tau_s), abs=5.0 / math.sqrt(independent)
        )


def test_barometer_white_noise() -> None:
    config = BarometerConfig(white_sd_pa=2.4, wander_sd_pa=0.0, bias_sd_pa=0.0)
    errors = barometer_errors(config, 100_000)
    assert errors.std() == pytest.approx(2.4, rel=5.0 / math.sqrt(2 * errors.size))
    neighbours = np.corrcoef(errors[1:], errors[:-1])[0, 1]
    assert abs(neighbours) < 5.0 / math.sqrt(errors.size)


def test_barometer_wander_is_slow() -> None:
    config = BarometerConfig(white_sd_pa=0.0, wander_sd_pa=5.0, wander_time_s=10.0, bias_sd_pa=0.0)
    errors = barometer_errors(config, 100_000)
    independent = errors.size / 20.0 / (2.0 * 10.0)
    assert errors.var() == pytest.approx(25.0, rel=5.0 * math.sqrt(2.0 / independent))
    steps = np.diff(errors).var()  # 2 sd^2 (1 - exp(-dt / tau)), and increments are independent
    assert steps == pytest.approx(
        50.0 * (1.0 - math.exp(-0.05 / 10.0)), rel=5.0 * math.sqrt(2.0 / errors.size)
    )


def test_barometer_bias_differs_from_flight_to_flight() -> None:
    biases = np.array(
        [Barometer(BarometerConfig(bias_sd_pa=50.0), seed).bias_pa for seed in range(400)]
    )
    assert biases.std() == pytest.approx(50.0, rel=5.0 / math.sqrt(2 * biases.size))
    assert Barometer(BarometerConfig(bias_pa=-300.0, bias_sd_pa=0.0), 1).bias_pa == -300.0


@pytest.mark.parametrize("rate_hz", [10, 20, 50])
def test_barometer_lags_by_its_time_constant(rate_hz: int) -> None:
    quiet = {"white_sd_pa": 0.0, "wander_sd_pa": 0.0, "bias_sd_pa": 0.0}
    barometer = Barometer(
        BarometerConfig.model_validate({**quiet, "lag_s": 0.4, "rate_hz": rate_hz}), 1
    )
    barometer.measure(0, 95_000.0, 280.0)
    for i in range(1, round(0.4 * rate_hz) + 1):
        reading = barometer.measure(i * barometer.period_us, 96_000.0, 280.0)
    assert reading.pressure_pa == pytest.approx(
        95_000.0 + 1000.0 * (1.0 - math.exp(-1.0)), abs=1e-6
    )


def test_barometer_die_warms_up() -> None:
    barometer = Barometer(BarometerConfig(warming_k=20.0, warming_time_s=100.0), 1)
    assert barometer.measure(0, 95_000.0, 280.0).die_temperature_k == 280.0
    assert barometer.measure(100_000_000, 95_000.0, 280.0).die_temperature_k == pytest.approx(
        280.0 + 12.64, abs=0.01
    )
    assert barometer.measure(10**9, 95_000.0, 270.0).die_temperature_k == pytest.approx(
        290.0, abs=0.01
    )


def test_gnss_height_error_is_what_it_reports() -> None:
    config = GnssConfig(wander_time_s=10.0)
    errors = gnss_heights(config, 50_000)
    independent = errors.size / config.rate_hz / (2.0 * config.wander_time_s)
    assert errors.std() == pytest.approx(math.hypot(3.0, 3.0), rel=5.0 / math.sqrt(2 * independent))
    assert GnssReceiver(config, 1).vertical_sd_m == pytest.approx(4.243, abs=1e-3)


def test_gnss_white_and_wander_are_told_apart_by_their_differences() -> None:
    errors = gnss_heights(GnssConfig(), 50_000)
    steps = np.diff(errors).var()  # 2 white^2 + 2 wander^2 (1 - exp(-dt / tau))
    expected = 2 * 9.0 + 2 * 9.0 * (1.0 - math.exp(-0.2 / 300.0))
    assert steps == pytest.approx(expected, rel=5.0 * math.sqrt(3.0 / errors.size))


def test_gnss_is_late_and_stamps_as_told() -> None:
    for stamp, stamp_us in (("arrival", 310_000), ("measurement", 200_000)):
        receiver = GnssReceiver(GnssConfig.model_validate({"stamp": stamp}), 1)
        receiver.measure(TRUTH._replace(time_us=200_000))
        assert receiver.deliver(300_000) is None
        fix = receiver.deliver(310_000)
        assert fix is not None
        assert (fix.measured_us, fix.stamp_us) == (200_000, stamp_us)
        assert receiver.deliver(400_000) is None


def test_gnss_finds_its_first_fix_in_time_and_keeps_the_undulation() -> None:
    receiver = GnssReceiver(GnssConfig(first_fix_s=8.0, undulation_m=47.6), 1)
    kinds = {}
    for time_us in range(0, 10_000_000, 200_000):
        receiver.measure(TRUTH._replace(time_us=time_us))
        fix = receiver.deliver(time_us + 200_000)
        assert fix is not None
        kinds[time_us] = fix.fix_type
        assert fix.altitude_ellipsoid_m - fix.altitude_amsl_m == pytest.approx(47.6)
    assert {time for time, kind in kinds.items() if kind >= 3} == {
        time for time in kinds if time >= 8_000_000
    }
    assert set(kinds.values()) == {1, 3}


def test_imu_noise_and_bias_walk() -> None:
    count, dt_s = 50_000, 0.02
    imu = Imu(ImuConfig(accel_bias_sd_mps2=0.0, accel_walk_mps2_rts=0.0, gyro_bias_sd_radps=0.0), 1)
    samples = [imu.measure(i * imu.period_us, STILL) for i in range(count)]
    force = np.array([sample.specific_force_b_mps2 for sample in samples])
    bound = 5.0 / math.sqrt(2 * count)
    assert force.std(axis=0) == pytest.approx([0.02 / math.sqrt(dt_s)] * 3, rel=bound)
    assert force.mean(axis=0) == pytest.approx(
        [0.0, 0.0, -9.80665], abs=5 * 0.1414 / math.sqrt(count)
    )
    assert np.abs(np.corrcoef(force.T) - np.eye(3)).max() < 5.0 / math.sqrt(count)

    still = {
        "accel_noise_mps2_rthz": 0.0,
        "gyro_noise_radps_rthz": 0.0,
        "gyro_walk_radps_rts": 1e-4,
    }
    walking = Imu(ImuConfig.model_validate(still), 2)
    rates = np.array(
        [walking.measure(i * 20_000, STILL).angular_rate_b_radps for i in range(count)]
    )
    assert np.diff(rates, axis=0).std(axis=0) == pytest.approx(
        [1e-4 * math.sqrt(dt_s)] * 3, rel=bound
    )


def test_turn_on_biases_have_their_spread() -> None:
    biases = np.array([Imu(ImuConfig(), seed)._accelerometers.bias for seed in range(300)])
    assert biases.std() == pytest.approx(0.1, rel=5.0 / math.sqrt(2 * biases.size))


def test_one_process_of_a_sensor_leaves_its_others_untouched() -> None:
    """The white noise of a barometer is the same with and without wander."""
    quiet = BarometerConfig(wander_sd_pa=0.0, bias_sd_pa=0.0)
    full = BarometerConfig(wander_sd_pa=5.0, bias_sd_pa=0.0)
    difference = barometer_errors(full, 1000) - barometer_errors(quiet, 1000)
    assert (
        np.diff(difference).std() < 0.1
    )  # the wander alone: 5 sqrt(2 * 0.05 / 300) = 0.09 Pa a step
