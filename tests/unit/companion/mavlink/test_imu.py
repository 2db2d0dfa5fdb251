"""Which IMU message is used, in which unit: priority, scales, and gravity as the judge."""

import math

import pytest

from companion.mavlink import convert
from companion.mavlink.codec import Message, mavlink
from companion.mavlink.convert import CONVERTERS, Reading
from companion.mavlink.imu import MILLI_G, MILLI_MPS2, SOURCE_TIMEOUT_US, GravityCheck, ImuSelector
from companion.samples import Kind
from tests import vehicle

G = 9.80665
HIGHRES, SCALED, SCALED2, RAW = 105, 26, 116, 27
ARDUPILOT, PX4, GENERIC = 3, 12, 0
SECOND_US = 1_000_000


def scaled(
    boot_s: float, force_mg: int = 1000, kind: type = mavlink.MAVLink_scaled_imu_message
) -> Message:
    return kind(round(boot_s * 1e3), 0, 0, -force_mg, 0, 0, 0, 0, 0, 0)


def select(
    selector: ImuSelector, message: Message, boot_s: float, autopilot: int = ARDUPILOT
) -> list[Kind]:
    """The kinds that are left of a message."""
    message_id, time_us = type(message).id, round(boot_s * SECOND_US)
    readings = (
        selector.raw_imu(message, autopilot)
        if message_id == RAW
        else CONVERTERS[message_id](message)
    )
    return [
        reading.kind
        for reading in readings
        if reading.kind is not Kind.IMU or selector.accepts(message_id, reading, time_us)
    ]


def force_mps2(readings: tuple[Reading, ...]) -> float:
    return math.hypot(*readings[0].values[0])


class TestPriority:
    def test_the_best_of_three_is_used(self) -> None:
        selector = ImuSelector()
        assert select(selector, vehicle.raw_imu(1.0), 1.0) == [Kind.IMU]
        assert select(selector, scaled(1.1), 1.1) == [Kind.IMU]
        assert select(selector, vehicle.raw_imu(1.2), 1.2) == []
        assert select(selector, vehicle.highres_imu(1.3), 1.3) == [Kind.IMU, Kind.PRESSURE]
        assert select(selector, scaled(1.4), 1.4) == []
        assert select(selector, vehicle.raw_imu(1.5), 1.5) == []

    def test_a_better_one_that_fell_silent_makes_way(self) -> None:
        selector = ImuSelector()
        select(selector, vehicle.highres_imu(1.0), 1.0)
        silent_s = 1.0 + SOURCE_TIMEOUT_US * 1e-6
        assert select(selector, scaled(silent_s - 0.01), silent_s - 0.01) == []
        assert select(selector, scaled(silent_s), silent_s) == [Kind.IMU]

    def test_a_better_one_without_accelerations_replaces_nothing(self) -> None:
        selector = ImuSelector()
        barometer_only = vehicle.highres_imu(1.0, fields_updated=0x200)
        assert select(selector, barometer_only, 1.0) == [Kind.PRESSURE]
        assert select(selector, scaled(1.1), 1.1) == [Kind.IMU]

    def test_a_better_one_that_gravity_refutes_replaces_nothing(self) -> None:
        """HIGHRES_IMU in mG by mistake: 1000 m/s2."""
        selector = ImuSelector()
        assert select(selector, vehicle.highres_imu(1.0, zacc=-1000.0), 1.0) == [Kind.PRESSURE]
        assert select(selector, scaled(1.1), 1.1) == [Kind.IMU]

    def test_other_instances_are_sensors_of_their_own(self) -> None:
        selector = ImuSelector()
        select(selector, vehicle.highres_imu(1.0), 1.0)
        second = scaled(1.1, kind=mavlink.MAVLink_scaled_imu2_message)
        assert select(selector, second, 1.1) == [Kind.IMU]
        assert select(selector, vehicle.raw_imu(1.2), 1.2) == []

    def test_a_second_highres_imu_does_not_replace_the_first_scaled_one(self) -> None:
        selector = ImuSelector()
        select(selector, vehicle.highres_imu(1.0, id=1), 1.0)
        assert select(selector, scaled(1.1), 1.1) == [Kind.IMU]


class TestScale:
    @pytest.mark.parametrize(("autopilot", "scale"), [(ARDUPILOT, MILLI_G), (PX4, MILLI_MPS2)])
    def test_known_autopilots(self, autopilot: int, scale: float) -> None:
        for counts in (1, 1000, 9807, -32768):
            readings = ImuSelector().raw_imu(vehicle.raw_imu(1, zacc=counts), autopilot)
            assert force_mps2(readings) == pytest.approx(abs(counts) * scale)

    @pytest.mark.parametrize("counts", [1000, 9807])
    def test_a_generic_one_has_the_scale_that_fits(self, counts: int) -> None:
        selector = ImuSelector()
        assert force_mps2(
            selector.raw_imu(vehicle.raw_imu(1, zacc=-counts), GENERIC)
        ) == pytest.approx(G, rel=1e-3)
        doubled = force_mps2(selector.raw_imu(vehicle.raw_imu(2, zacc=-2 * counts), GENERIC))
        assert doubled == pytest.approx(2 * G, rel=1e-3)

    @pytest.mark.parametrize("first", [0, 3000, 32767])
    def test_a_first_message_that_fits_neither_decides_nothing(self, first: int) -> None:
        selector = ImuSelector()
        selector.raw_imu(vehicle.raw_imu(1, zacc=first), GENERIC)
        assert force_mps2(
            selector.raw_imu(vehicle.raw_imu(2, zacc=-9807), GENERIC)
        ) == pytest.approx(G, rel=1e-3)

    def test_rates_are_in_mrad_whatever_the_accelerations_are(self) -> None:
        (reading,) = ImuSelector().raw_imu(vehicle.raw_imu(1, zacc=-9807, xgyro=1500), GENERIC)
        assert reading.values[1] == pytest.approx((1.5, 0, 0))


class TestGravity:
    @pytest.mark.parametrize(
        ("force_g", "accepted"),
        [(0.79, False), (0.81, True), (1.0, True), (1.24, True), (1.26, False)],
    )
    def test_bounds(self, force_g: float, accepted: bool) -> None:
        assert GravityCheck().accepts(0, force_g * G) is accepted

    def test_manoeuvres_pass_since_the_median_counts(self) -> None:
        check = GravityCheck()
        verdicts = []
        for tick in range(200):
            force_g = 3.0 if tick % 100 in range(40, 70) else 1.0  # three seconds of 3 g in ten
            verdicts.append(check.accepts(tick * 100_000, force_g * G))
        assert all(verdicts)

    @pytest.mark.parametrize(
        ("force_g", "accepted"),
        [(0.19, False), (0.4, True), (1.6, True), (7.9, True), (8.1, False)],
    )
    def test_what_lasts_once_gravity_is_known_need_only_be_bearable(
        self, force_g: float, accepted: bool
    ) -> None:
        check = GravityCheck()
        for tick in range(60):
            assert check.accepts(tick * 100_000, G)
        verdicts = [check.accepts(6_000_000 + tick * 100_000, force_g * G) for tick in range(300)]
        assert verdicts[-1] is accepted
        assert all(verdicts) is accepted

    def test_a_single_sample_of_gravity_proves_nothing(self) -> None:
        check = GravityCheck()
        assert check.accepts(0, G)
        assert not [check.accepts(tick * 100_000, 2.0 * G) for tick in range(1, 100)][-1]

    def test_a_broken_one_is_out_after_five_seconds_and_back_after_five(self) -> None:
        check = GravityCheck()
        for tick in range(100):
            assert check.accepts(tick * 100_000, G)
        broken = [check.accepts(10_000_000 + tick * 100_000, 0.1) for tick in range(100)]
        assert broken.index(False) == pytest.approx(50, abs=2)
        healed = [check.accepts(20_000_000 + tick * 100_000, G) for tick in range(100)]
        assert healed.index(True) == pytest.approx(50, abs=2)

    def test_nan_is_refused_and_leaves_no_trace(self) -> None:
        check = GravityCheck()
        for tick in range(100):
            assert not check.accepts(tick * 100_000, math.nan)
            assert not check.accepts(tick * 100_000 + 1, math.inf)
        assert check.accepts(10_000_000, G)
        for tick in range(100):
            assert check.accepts(10_100_000 + 2 * tick * 100_000, G)
            assert not check.accepts(10_200_000 + 2 * tick * 100_000, math.nan)

    def test_a_restarted_clock_starts_anew(self) -> None:
        check = GravityCheck()
        for tick in range(100):
            check.accepts(1_000_000_000 + tick * 100_000, 5 * G)
        assert check.accepts(5_000_000, G)

    def test_mm_per_s2_called_mg_never_reach_an_estimator(self) -> None:
        selector = ImuSelector()
        for tick in range(300):
            boot_s = tick * 0.02
            assert select(selector, vehicle.raw_imu(boot_s, zacc=-9807), boot_s, ARDUPILOT) == []


def test_raw_imu_has_no_converter_of_its_own() -> None:
    """Its scale needs memory."""
    assert RAW not in CONVERTERS
    assert convert.raw_imu(vehicle.raw_imu(1.0), MILLI_G)[0].instance == 0
