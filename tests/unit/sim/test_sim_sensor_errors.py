"""Sensor errors against their parameters: Allan deviations, spectra, and the physics of each
disturbance.

Allan deviations are the overlapping ones (IEEE Std 952-1997, annex C): white noise N gives N /
sqrt(tau), a random walk K gives K sqrt(tau / 3).
"""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.config import validate
from companion.errors import ConfigError
from sim.aircraft_state import Flow, Motion, Truth
from sim.constants import G0_MPS2
from sim.flight import Flight
from sim.scenario import Scenario
from sim.sensors import SensorConfig
from sim.sensors.barometer import Barometer, BarometerConfig
from sim.sensors.gnss import Fix, GnssConfig, GnssReceiver
from sim.sensors.imu import Imu, ImuConfig

Series = NDArray[np.float64]
STILL = Motion((0.0, 0.0, -G0_MPS2), (0.0, 0.0, 0.0))
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
QUIET_BAROMETER: dict[str, Any] = {
    "white_sd_pa": 0.0,
    "wander_sd_pa": 0.0,
    "bias_sd_pa": 0.0,
    "lag_s": 0.0,
}
QUIET_IMU: dict[str, Any] = {
    f"{kind}_{name}": 0.0
    for kind, unit in (("accel", "mps2"), ("gyro", "radps"))
    for name in (f"noise_{unit}_rthz", f"bias_sd_{unit}", f"walk_{unit}_rts")
}
QUIET_GNSS: dict[str, Any] = {
    f"{axis}_{kind}_sd_m": 0.0 for axis in ("height", "horizontal") for kind in ("white", "wander")
} | {"velocity_sd_mps": 0.0}


def allan_deviation(values: Series, dt_s: float, tau_s: float) -> float:
    """Of a rate (each value the mean over its interval), overlapping."""
    count = round(tau_s / dt_s)
    sums = np.concatenate([[0.0], np.cumsum(values)])
    means = (sums[count:] - sums[:-count]) / count
    return float(np.sqrt(0.5 * np.mean((means[count:] - means[:-count]) ** 2)))


def imu_series(
    config: ImuConfig, count: int, seed: int = 1, motion: Motion = STILL
) -> tuple[Series, Series]:
    imu = Imu(config, seed)
    samples = [imu.measure((i + 1) * imu.period_us, motion) for i in range(count)]
    force = np.array([sample.specific_force_b_mps2 for sample in samples])
    return force, np.array([sample.angular_rate_b_radps for sample in samples])


def pressures(
    config: BarometerConfig, count: int, seed: int = 1, flow: Flow | None = None
) -> Series:
    barometer = Barometer(config, seed)
    period = barometer.period_us
    return np.array(
        [barometer.measure(i * period, 95_000.0, 280.0, flow).pressure_pa for i in range(count)]
    )


def fixes(
    config: GnssConfig, count: int, seed: int = 1, altitude_m: float = 500.0, ground_m: float = 0.0
) -> list[Fix]:
    receiver = GnssReceiver(config, seed, ground_m)
    found = []
    for i in range(count):
        receiver.measure(TRUTH._replace(time_us=i * receiver.period_us, altitude_amsl_m=altitude_m))
        fix = receiver.deliver(10**15)
        assert fix is not None
        found.append(fix)
    return found


# Inertial sensors


@pytest.mark.parametrize("preset", ["", "ICM-20602", "tactical"])
def test_the_imu_s_allan_deviation_is_its_noise_and_walk(preset: str) -> None:
    config = ImuConfig(preset=preset, warming_k=0.0)
    dt_s, count = 1.0 / config.rate_hz, 180_000  # an hour
    force, rate = imu_series(config, count)
    for series, noise, walk in (
        (force, config.accel_noise_mps2_rthz, config.accel_walk_mps2_rts),
        (rate, config.gyro_noise_radps_rthz, config.gyro_walk_radps_rts),
    ):
        for tau_s in (0.1, 1.0, 10.0, 100.0):
            expected = math.sqrt(noise**2 / tau_s + walk**2 * tau_s / 3.0)
            spread = 5.0 / math.sqrt(2.0 * count * dt_s / tau_s)
            for axis in range(3):
                assert allan_deviation(series[:, axis], dt_s, tau_s) == pytest.approx(
                    expected, rel=spread
                )


def test_a_walking_bias_has_the_slope_of_a_random_walk() -> None:
    config = ImuConfig.model_validate({**QUIET_IMU, "gyro_walk_radps_rts": 1e-3})
    _, rate = imu_series(config, 100_000)
    for tau_s in (2.0, 20.0):
        deviation = allan_deviation(rate[:, 0], 0.02, tau_s)
        assert deviation == pytest.approx(
            1e-3 * math.sqrt(tau_s / 3.0), rel=5.0 / math.sqrt(2.0 * 2000.0 / tau_s)
        )


@pytest.mark.parametrize("averaged", [True, False])
def test_vibration_appears_at_its_alias(averaged: bool) -> None:
    """83 Hz sampled at 50 Hz is 17 Hz; the mean over an interval leaves sinc(83 / 50) of it."""
    hertz, size = 83.0, 20.0
    config = ImuConfig.model_validate(
        {**QUIET_IMU, "vibration_mps2": size, "vibration_hz": hertz, "averaged": averaged}
    )
    force, rate = imu_series(config, 5000)
    spectrum = np.abs(np.fft.rfft(force[:, 0])) * 2.0 / len(force)
    frequencies = np.fft.rfftfreq(len(force), 0.02)
    line = int(np.argmax(spectrum))
    assert frequencies[line] == pytest.approx(17.0, abs=0.02)
    expected = size * abs(np.sinc(hertz / 50.0)) if averaged else size
    assert spectrum[line] == pytest.approx(expected, rel=0.01)
    assert not rate.any()
    assert abs(float(np.mean(force[:, 0] * force[:, 1]))) / force[:, 0].var() == pytest.approx(
        0.5, abs=0.02
    )  # a third of a turn apart


def test_a_vibration_that_wanders_is_a_broad_line() -> None:
    config = ImuConfig.model_validate(
        {
            **QUIET_IMU,
            "vibration_mps2": 20.0,
            "vibration_hz": 83.0,
            "averaged": False,
            "vibration_spread_hz": 1.0,
        }
    )
    force, _ = imu_series(config, 50_000)
    power = np.abs(np.fft.rfft(force[:, 1])) ** 2
    frequencies = np.fft.rfftfreq(len(force), 0.02)
    centre = float((power * frequencies)[1:].sum() / power[1:].sum())
    width = math.sqrt(float((power * (frequencies - centre) ** 2)[1:].sum() / power[1:].sum()))
    assert centre == pytest.approx(17.0, abs=0.3)
    assert width == pytest.approx(1.0, rel=0.3)
    assert force[:, 1].std() == pytest.approx(20.0 / math.sqrt(2.0), rel=0.02)


def test_scale_and_misalignment_turn_and_stretch() -> None:
    quiet = {**QUIET_IMU, "scale_sd": 0.01, "misalignment_sd_rad": 0.02}
    scales, angles = [], []
    for seed in range(150):
        imu = Imu(ImuConfig.model_validate(quiet), seed)
        columns = [
            imu.measure(
                20_000,
                Motion((float(axis == 0), float(axis == 1), float(axis == 2)), (0.0, 0.0, 0.0)),
            )
            for axis in range(3)
        ]
        matrix = np.array([column.specific_force_b_mps2 for column in columns]).T - np.eye(3)
        scales += list(np.diag(matrix))
        angles += list(matrix[~np.eye(3, dtype=bool)])
    assert np.std(scales) == pytest.approx(0.01, rel=5.0 / math.sqrt(2 * len(scales)))
    assert np.std(angles) == pytest.approx(0.02, rel=5.0 / math.sqrt(2 * len(angles)))


def test_a_thermal_bias_dies_out_as_the_die_warms_up() -> None:
    warming = {
        **QUIET_IMU,
        "accel_thermal_sd_mps2_per_k": 0.01,
        "warming_k": 20.0,
        "warming_time_s": 100.0,
    }
    imu = Imu(ImuConfig.model_validate(warming), 3)
    cold, warmer, warm = (imu.measure(time_us, STILL) for time_us in (0, 100_000_000, 10**10))
    assert cold.die_temperature_cdegc == 2000
    assert warm.die_temperature_cdegc == 4000
    bias = np.array(cold.specific_force_b_mps2) - np.array(STILL.specific_force_b_mps2)
    assert np.abs(bias).max() > 0.05
    later = np.array(warmer.specific_force_b_mps2) - np.array(STILL.specific_force_b_mps2)
    assert later == pytest.approx(bias * math.exp(-1.0))
    assert warm.specific_force_b_mps2 == pytest.approx(STILL.specific_force_b_mps2)


def test_what_is_out_of_range_is_clipped_and_biased() -> None:
    config = ImuConfig.model_validate(
        {**QUIET_IMU, "accel_range_mps2": 30.0, "gyro_range_radps": 2.0}
    )
    force, rate = imu_series(config, 5, motion=Motion((40.0, -50.0, -9.8), (3.0, 0.5, -2.5)))
    assert force[0].tolist() == [30.0, -30.0, -9.8]
    assert rate[0].tolist() == [2.0, 0.5, -2.0]
    shaken = {
        **QUIET_IMU,
        "vibration_mps2": 30.0,
        "vibration_hz": 83.0,
        "averaged": False,
        "accel_range_mps2": 30.0,
    }
    force, _ = imu_series(ImuConfig.model_validate(shaken), 50_000)
    assert force[:, 2].mean() > -G0_MPS2 + 1.0  # one-sided clipping shifts the mean: height drifts


# Barometer


@pytest.mark.parametrize("preset", ["MS5611", "BMP388", "DPS310"])
def test_a_barometer_preset_has_its_noise(preset: str) -> None:
    config = BarometerConfig(preset=preset, wander_sd_pa=0.0, warming_k=0.0)
    values = pressures(config, 50_000)
    expected = math.hypot(config.white_sd_pa, config.quantum_pa / math.sqrt(12.0))
    assert values.std() == pytest.approx(expected, rel=0.03)
    assert allan_deviation(values, 0.05, 5.0) == pytest.approx(config.white_sd_pa / 10.0, rel=0.1)
    steps = values / config.quantum_pa
    assert np.abs(steps - np.round(steps)).max() < 1e-4


def test_presets_differ_from_unit_to_unit_in_their_thermal_drift() -> None:
    slopes = np.array(
        [Barometer(BarometerConfig(preset="BMP388"), seed).thermal_pa_per_k for seed in range(400)]
    )
    assert slopes.std() == pytest.approx(0.75, rel=5.0 / math.sqrt(2 * slopes.size))
    config = BarometerConfig.model_validate(
        {**QUIET_BAROMETER, "thermal_pa_per_k": -2.0, "warming_k": 20.0}
    )
    values = pressures(config, 40_000)
    assert values[0] - 95_000.0 == pytest.approx(-2.0 * (280.0 - 298.15))
    assert values[-1] - values[0] == pytest.approx(-40.0, abs=0.1)  # 3.3 m in half an hour


def test_the_static_port_s_error_is_that_of_the_rule() -> None:
    """0.068 of the dynamic pressure is the 30 ft at 100 kt that 14 CFR 23.1325(e) allows."""
    config = BarometerConfig.model_validate({**QUIET_BAROMETER, "static_port": 0.068})
    knots = 1852.0 / 3600.0
    flow = Flow(0.5 * 1.225 * (100.0 * knots) ** 2, 0.0, 1000.0, 1.0)
    low_pa = 95_000.0 - pressures(config, 1, flow=flow)[0]
    assert low_pa / (1.225 * G0_MPS2) == pytest.approx(30.0 * 0.3048, rel=0.02)


def test_sideslip_sucks_on_both_sides_and_the_ground_presses() -> None:
    config = BarometerConfig.model_validate(
        {**QUIET_BAROMETER, "sideslip": 0.5, "ground_effect": 0.1, "ground_effect_height_m": 5.0}
    )
    barometer = Barometer(config, 1)
    slip = math.radians(10.0)
    aloft = [barometer.port_error_pa(Flow(1000.0, angle, 1e6, 1.0)) for angle in (-slip, 0.0, slip)]
    assert aloft == pytest.approx([-500.0 * math.sin(slip) ** 2, 0.0, -500.0 * math.sin(slip) ** 2])
    ground = [
        barometer.port_error_pa(Flow(1000.0, 0.0, height, 1.0)) for height in (0.0, 5.0, 50.0)
    ]
    assert ground == pytest.approx([100.0, 100.0 / math.e, 0.0], abs=0.01)
    assert barometer.port_error_pa(Flow(0.0, slip, 0.0, 1.0)) == 0.0


def test_acceleration_bends_the_membrane() -> None:
    config = BarometerConfig.model_validate({**QUIET_BAROMETER, "acceleration_pa_per_g": 12.0})
    assert pressures(config, 1, flow=Flow(0.0, 0.0, 0.0, 3.0))[0] == pytest.approx(95_024.0)
    assert pressures(config, 1, flow=Flow(0.0, 0.0, 0.0, 1.0))[0] == pytest.approx(95_000.0)


def test_a_flight_feels_the_static_port() -> None:
    base = {
        "name": "test", "summary": "of a test",
        "profile": [{"leg": "wait", "duration_s": 2}, {"leg": "take_off", "height_m": 60}],
    }  # fmt: skip
    sound, crooked = (
        Flight(
            validate(
                {**base, "sensors": {"barometer": {**QUIET_BAROMETER, **more}}}, Scenario, "a test"
            )
        )
        for more in ({}, {"static_port": 0.1})
    )
    for flight in (sound, crooked):
        flight.run()
    right, wrong = sound.vehicle.state.pressure, crooked.vehicle.state.pressure
    assert right is not None
    assert wrong is not None
    flow = crooked.aircraft.flow()
    airspeed_mps = crooked.aircraft.truth().airspeed_mps
    assert flow.dynamic_pressure_pa == pytest.approx(0.5 * 1.225 * airspeed_mps**2, rel=0.01)
    assert flow.height_m == pytest.approx(60.0, abs=2.0)
    assert right.pressure_pa - wrong.pressure_pa == pytest.approx(
        0.1 * flow.dynamic_pressure_pa, rel=0.01
    )


# Receiver


@pytest.mark.parametrize("preset", ["u-blox M8", "F9P RTK", "cheap"])
def test_a_receiver_s_height_is_worse_than_its_position_and_has_its_spectrum(preset: str) -> None:
    config = GnssConfig(preset=preset, first_fix_s=0.0, multipath_sd_m=0.0)
    found = fixes(config, 100_000)
    up = np.array([fix.altitude_amsl_m - 500.0 for fix in found])
    north = np.array([(fix.latitude_deg - 47.0) * 111_319.49 for fix in found])
    independent = len(found) / config.rate_hz / (2.0 * config.wander_time_s)
    assert up.std() == pytest.approx(
        math.hypot(config.height_white_sd_m, config.height_wander_sd_m),
        rel=5.0 / math.sqrt(2.0 * independent),
    )
    assert up.std() > 1.3 * north.std()
    # Height differences tell white noise and wander apart, by the structure function of both.
    for lag_s in (0.2, 1.0, 10.0):
        lag = round(lag_s * config.rate_hz)
        expected = 2.0 * config.height_white_sd_m**2
        expected += (
            2.0 * config.height_wander_sd_m**2 * (1.0 - math.exp(-lag_s / config.wander_time_s))
        )
        assert np.mean((up[lag:] - up[:-lag]) ** 2) == pytest.approx(expected, rel=0.1)


def test_real_receivers_wander_as_the_cheap_one_does() -> None:
    """data/real: 7-59 m peak to peak in 2-10 minutes, 0.03-0.2 m over a second, with a reported
    accuracy near 1 m."""
    config = GnssConfig(preset="cheap", first_fix_s=0.0)
    ranges, seconds = [], []
    for seed in range(40):
        found = fixes(config, 5 * 360, seed)
        up = np.array([fix.altitude_amsl_m for fix in found])
        ranges.append(np.ptp(up))
        seconds.append(np.diff(up[::5]).std() / math.sqrt(2.0))
        assert {fix.vertical_sd_m for fix in found} == {1.2}
    assert 7.0 < np.median(ranges) < 59.0
    assert 0.03 < np.median(seconds) < 1.0


def test_what_accuracy_a_receiver_admits() -> None:
    honest = GnssReceiver(GnssConfig(), 1).vertical_sd_m
    assert (
        GnssReceiver(GnssConfig(accuracy="optimistic", optimism=0.25), 1).vertical_sd_m
        == honest / 4
    )
    stuck = GnssReceiver(GnssConfig(accuracy="stuck", stuck_accuracy_m=0.9), 1)
    assert (stuck.vertical_sd_m, stuck.horizontal_sd_m) == (0.9, 0.9)


def test_jittered_fixes_come_late_by_a_half_normal_and_in_order() -> None:
    config = GnssConfig(rate_hz=10, latency_s=0.1, latency_jitter_s=0.05, first_fix_s=0.0)
    found = fixes(config, 20_000)
    late_s = np.array([(fix.stamp_us - fix.measured_us) * 1e-6 for fix in found])
    assert late_s.min() >= 0.1
    assert (late_s - 0.1).mean() == pytest.approx(0.05 * math.sqrt(2.0 / math.pi), rel=0.05)
    assert (np.diff([fix.stamp_us for fix in found]) > 0).all()
    receiver = GnssReceiver(config, 1)
    receiver.measure(TRUTH._replace(time_us=0))
    assert receiver.deliver(found[0].stamp_us - 1) is None
    assert receiver.deliver(found[0].stamp_us) == found[0]._replace(
        altitude_amsl_m=found[0].altitude_amsl_m
    )


def test_multipath_fades_with_height_and_is_not_admitted() -> None:
    config = GnssConfig.model_validate(
        {
            **QUIET_GNSS,
            "multipath_sd_m": 5.0,
            "multipath_height_m": 30.0,
            "multipath_time_s": 5.0,
            "first_fix_s": 0.0,
        }
    )
    spreads = []
    for height_m in (0.0, 30.0, 300.0):
        found = fixes(config, 50_000, altitude_m=400.0 + height_m, ground_m=400.0)
        spreads.append(np.std([fix.altitude_amsl_m for fix in found]))
        assert found[0].vertical_sd_m == 0.0
    assert spreads[0] == pytest.approx(5.0, rel=0.12)
    assert spreads[1] == pytest.approx(5.0 / math.e, rel=0.12)
    assert spreads[2] < 0.01


# Presets, and what they leave alone


@pytest.mark.parametrize("kind", [BarometerConfig, GnssConfig, ImuConfig])
def test_a_preset_is_a_line_that_a_scenario_may_change(kind: type[SensorConfig]) -> None:
    for name, values in kind.PRESETS.items():
        chosen = kind.model_validate({"preset": name})
        assert {key: getattr(chosen, key) for key in values} == values
        key = next(key for key, value in values.items() if isinstance(value, float))
        assert getattr(kind.model_validate({"preset": name, key: 0.125}), key) == 0.125
        assert kind.model_validate(chosen.model_dump()) == chosen
    with pytest.raises(ConfigError, match=r"preset: 'BMP' ?: is no preset; there are \S+"):
        validate({"preset": "BMP"}, kind, "a test")


def test_new_errors_leave_the_old_samples_alone() -> None:
    """The white noise of a sensor is the same with and without each other error."""
    plain = pressures(BarometerConfig(), 500)
    drifting = pressures(BarometerConfig(thermal_pa_per_k=0.0, quantum_pa=0.001), 500)
    assert np.abs(plain - drifting).max() < 0.001
    force, _ = imu_series(ImuConfig(), 500)
    turned, _ = imu_series(ImuConfig(misalignment_sd_rad=0.01), 500)
    offset = turned - force
    assert np.abs(offset - offset[0]).max() < 1e-12
    first = fixes(GnssConfig(), 200)
    late = fixes(GnssConfig(latency_jitter_s=0.1), 200)
    assert [fix.altitude_amsl_m for fix in first] == [fix.altitude_amsl_m for fix in late]


class TestRealBarometers:
    """Errors that real flights show: port, lift, drift, stamps."""

    def quiet(self, **changes: Any) -> Barometer:
        return Barometer(BarometerConfig(**(QUIET_BAROMETER | changes)), seed=1, usual_hz=20)

    def read(self, barometer: Barometer, pressures_pa: Series, flow: Flow | None = None) -> Series:
        step_us = barometer.period_us
        readings = [
            barometer.measure(k * step_us, float(p), 285.0, flow).pressure_pa
            for k, p in enumerate(pressures_pa)
        ]
        return np.array(readings)

    def test_lift_raises_the_pressure_once_the_wing_carries(self) -> None:
        barometer = self.quiet(lift_pa=120.0)
        errors = [
            barometer.port_error_pa(Flow(q_pa, 0.0, 300.0, 1.0))
            for q_pa in (0.0, 240.0, 480.0, 2000.0)
        ]
        assert errors == [0.0, 60.0, 120.0, 120.0]

    def test_port_and_ground_effect_differ_between_devices(self) -> None:
        config = BarometerConfig(static_port=0.13, static_port_sd=0.03, ground_effect_sd=0.05)
        devices = [Barometer(config, seed) for seed in range(300)]
        ports = np.array([each.static_port for each in devices])
        grounds = np.array([each.ground_effect for each in devices])
        assert ports.mean() == pytest.approx(0.13, abs=0.006)
        assert ports.std() == pytest.approx(0.03, rel=0.15)
        assert grounds.std() == pytest.approx(0.05, rel=0.15)
        assert (grounds > 0).any()
        assert (grounds < 0).any()

    def test_drift_rate_and_walk_have_their_spread(self) -> None:
        """Rate .024 Pa/s over 1800 s: after a minute 1.44 Pa; walk .24 Pa/sqrt(s): 1.86 Pa."""
        constant = np.full(20 * 60 + 1, 95_000.0)
        ends = []
        for seed in range(200):
            config = BarometerConfig(
                **(QUIET_BAROMETER | {"drift_sd_pa_per_s": 0.024, "walk_pa_rts": 0.24})
            )
            error = self.read(Barometer(config, seed, 20), constant) - 95_000.0
            ends.append(error[-1])
        assert np.std(ends) == pytest.approx(
            math.hypot(0.024 * 60.0, 0.24 * math.sqrt(60.0)), rel=0.15
        )

    def test_late_stamps_err_in_proportion_to_the_climb(self) -> None:
        """A reading is 0 to 0.3 s old: at -60 Pa/s it is 9 Pa too high on average, sd 5.2 Pa."""
        climb: Series = 95_000.0 - 60.0 * np.arange(4000, dtype=np.float64) / 20.0
        error = self.read(self.quiet(stamp_jitter_s=0.3), climb)[20:] - climb[20:]
        assert error.mean() == pytest.approx(9.0, rel=0.05)
        assert error.std() == pytest.approx(60.0 * 0.3 / math.sqrt(12.0), rel=0.05)
        level = self.read(self.quiet(stamp_jitter_s=0.3), np.full(100, 95_000.0))
        assert np.all(level == 95_000.0)

    @pytest.mark.parametrize("preset", ["real light aircraft", "real small UAV"])
    def test_presets_measure(self, preset: str) -> None:
        barometer = Barometer(BarometerConfig(preset=preset), 3)
        read = self.read(barometer, np.full(2000, 95_000.0), Flow(1200.0, 0.0, 300.0, 1.0))
        assert np.all(np.abs(read - 95_000.0) < 700.0)


def test_a_receiver_falls_to_a_lower_fix_type_and_back() -> None:
    changes = [{"time_s": 100, "fix": 5}, {"time_s": 200, "fix": 3}, {"time_s": 300, "fix": 6}]
    config = validate({"preset": "F9P RTK", "rate_hz": 5, "fix_changes": changes}, GnssConfig, "x")
    heights: dict[int, list[float]] = {}
    for seed in range(40):
        receiver = GnssReceiver(config, seed)
        for k in range(400 * 5):
            receiver.measure(TRUTH._replace(time_us=k * 200_000))
            fix = receiver.deliver(k * 200_000 + 199_000)
            if fix is not None and k > 130:
                heights.setdefault(fix.fix_type, []).append(fix.altitude_amsl_m - 500.0)
                assert fix.vertical_sd_m == pytest.approx(
                    {6: 0.0158, 5: 0.304, 3: 4.203}[fix.fix_type], rel=0.01
                )
    assert set(heights) == {3, 5, 6}
    assert np.std(heights[6]) == pytest.approx(0.016, rel=0.3)
    assert np.std(heights[5]) == pytest.approx(0.3, rel=0.35)
    assert np.std(heights[3]) == pytest.approx(4.2, rel=0.35)
