"""Paper H's filter: its equations on fixed numbers, and how the live form behaves around the
paper's single step."""

import math

import numpy as np
import pytest

from companion.estimators.adaptive_fusion import (
    METHOD,
    AdaptiveFusionSettings,
    adaptive_factor,
    fused_sd_m,
    gain,
)
from companion.estimators.method import Filter
from companion.kernels.atmosphere import baro_altitude_m, geopotential_m, standard_pressure_pa
from companion.samples import Kind, Rows, Verdict, sample

R_B, R_GPS = 81.0, 169.0
PAPER = AdaptiveFusionSettings(baro_variance_m2=R_B, gnss_variance_m2=R_GPS)
PAPER_FIXED = AdaptiveFusionSettings(gain="fixed", baro_variance_m2=R_B, gnss_variance_m2=R_GPS)

# papers/vectors.json "000": barometer, GPS, adaptive estimate, K, P, S, non-adaptive estimate
VECTORS = [
    (100.0, 150.0, 146.62, 0.9324, 157.5756, 28.77777777777778, 116.2),
    (100.0, 110.0, 103.24, 0.324, 54.756, 1.0, 103.24),
    (0.0, 15.811388300841896, 5.122889809472775, 0.324, 54.756, 1.0, 5.122889809472775),
    (200.0, 120.0, 122.1125, 0.97359375, 164.53734375, 76.92592592592592, 174.08),
    (1000.0, 1000.0, 1000.0, 0.324, 54.756, 1.0, 1000.0),
    (1000.0, 1020.0, 1011.55, 0.5775, 97.5975, 2.8518518518518516, 1006.48),
]


def pressure(time_us: int, altitude_m: float, **values: float) -> Rows:
    return sample(
        Kind.PRESSURE,
        time_us,
        pressure_pa=standard_pressure_pa(geopotential_m(altitude_m)),
        **values,
    )


def fix(time_us: int, altitude_m: float, **values: float) -> Rows:
    return sample(Kind.GNSS, time_us, **({"altitude_amsl_m": altitude_m, "fix_type": 3} | values))


def altitude_m(running: Filter) -> float:
    return float(running.estimate["altitude_amsl_m"][0])


def sd_m(running: Filter) -> float:
    return float(running.estimate["altitude_sd_m"][0])


class TestEquations:
    @pytest.mark.parametrize(("baro", "gps", "adaptive", "K", "P", "S", "fixed"), VECTORS)
    def test_vectors(
        self, baro: float, gps: float, adaptive: float, K: float, P: float, S: float, fixed: float
    ) -> None:
        delta = gps - baro
        factor = adaptive_factor(delta, R_B, R_GPS)
        assert factor == pytest.approx(S, rel=1e-13)
        assert gain(factor, R_B, R_GPS) == pytest.approx(K, rel=1e-13)
        assert R_GPS * gain(factor, R_B, R_GPS) == pytest.approx(P, rel=1e-13)
        assert baro + gain(factor, R_B, R_GPS) * delta == pytest.approx(adaptive, rel=1e-13)
        assert baro + gain(1.0, R_B, R_GPS) * delta == pytest.approx(fixed, rel=1e-13)

    @pytest.mark.parametrize(("baro", "gps", "adaptive", "K", "P", "S", "fixed"), VECTORS)
    def test_vectors_through_samples(
        self, baro: float, gps: float, adaptive: float, K: float, P: float, S: float, fixed: float
    ) -> None:
        for settings, expected in ((PAPER, adaptive), (PAPER_FIXED, fixed)):
            running = Filter(METHOD, settings)
            assert running.step(Kind.PRESSURE, pressure(1_000_000, baro)) == Verdict.USED
            assert math.isnan(altitude_m(running))
            assert running.step(Kind.GNSS, fix(1_000_000, gps)) == Verdict.USED
            assert altitude_m(running) == pytest.approx(expected, abs=1e-6)
            if settings is PAPER:
                assert running.state["P_m2"][0] == pytest.approx(P, abs=1e-5)

    def test_the_factor_never_falls_below_one(self) -> None:
        """(31) as printed is negative here, and K has a pole where Delta = 0."""
        for delta in np.linspace(-20.0, 20.0, 401).tolist():
            assert adaptive_factor(delta, R_B, R_GPS) >= 1.0
            assert 0.0 < gain(adaptive_factor(delta, R_B, R_GPS), R_B, R_GPS) < 1.0

    def test_gain_rises_with_the_factor(self) -> None:
        gains = [gain(S, R_B, R_GPS) for S in (1.0, 2.0, 5.0, 50.0)]
        assert gains == sorted(gains)

    def test_when_it_fires_the_estimate_is_gnss_pushed_away_from_the_barometer(self) -> None:
        for delta in (-80.0, -16.0, 16.0, 40.0):
            K = gain(adaptive_factor(delta, R_B, R_GPS), R_B, R_GPS)
            assert K * delta == pytest.approx(delta - R_GPS / delta, rel=1e-12)

    def test_limits_of_the_fixed_filter(self) -> None:
        assert R_GPS * gain(1.0, 1e9, R_GPS) == pytest.approx(R_GPS, rel=1e-6)
        assert R_GPS * gain(1.0, 1e-6, R_GPS) == pytest.approx(
            1e-6, rel=1e-6
        )  # P tends to R_B, not below it

    def test_spread_is_never_below_gnss_when_it_fires(self) -> None:
        """The paper's P is; the error is not."""
        for delta in (20.0, 40.0, 80.0):
            S = adaptive_factor(delta, R_B, R_GPS)
            assert fused_sd_m(delta, S, gain(S, R_B, R_GPS), R_B, R_GPS) > math.sqrt(R_GPS)


class TestBetweenFixes:
    def test_the_correction_is_held_and_the_spread_grows_with_the_weather(self) -> None:
        running = Filter(METHOD, AdaptiveFusionSettings())
        running.step(Kind.PRESSURE, pressure(0, 500.0))
        running.step(Kind.GNSS, fix(0, 530.0, vertical_sd_m=2.0))
        offset_m, first_sd_m = altitude_m(running) - 500.0, sd_m(running)
        running.step(Kind.PRESSURE, pressure(600_000_000, 700.0))
        assert altitude_m(running) - 700.0 == pytest.approx(offset_m, abs=1e-9)
        jump_line_m = 12.5 * (1.0 - math.exp(-600.0 / 300.0))
        grown_m = math.hypot(600.0 * 31.0 / 3600.0, jump_line_m, 0.035 * 200.0)  # 200 m of column
        assert sd_m(running) == pytest.approx(math.hypot(first_sd_m, grown_m), rel=1e-9)

    def test_a_late_fix_meets_the_barometer_of_its_own_time(self) -> None:
        """Climbing at 10 m/s, a fix that is 0.2 s old would be 2 m low."""
        running = Filter(METHOD, AdaptiveFusionSettings())
        for tick in range(41):
            running.step(Kind.PRESSURE, pressure(tick * 50_000, 1000.0 + 0.5 * tick))
        running.step(Kind.GNSS, fix(1_800_000, 1018.0, vertical_sd_m=1.0))
        assert altitude_m(running) == pytest.approx(1020.0, abs=1e-6)
        assert running.estimate["time_us"][0] == 2_000_000
        assert running.estimate["climb_mps"][0] == pytest.approx(10.0, abs=1e-3)

    def test_the_estimate_of_the_paper_at_every_fix(self) -> None:
        """With one fix a barometer height, the live form is the paper's: no memory of the fix
        before."""
        generator = np.random.default_rng(5)
        running = Filter(METHOD, PAPER)
        for step in range(200):
            baro, gps = 1000.0 + generator.normal(0, 30), 1000.0 + generator.normal(0, 13)
            running.step(Kind.PRESSURE, pressure(step * 1_000_000, baro))
            running.step(Kind.GNSS, fix(step * 1_000_000, gps))
            K = gain(adaptive_factor(gps - baro, R_B, R_GPS), R_B, R_GPS)
            assert altitude_m(running) == pytest.approx(baro + K * (gps - baro), abs=1e-6)


class TestMissingSensors:
    def test_without_a_barometer_it_is_gnss(self) -> None:
        running = Filter(METHOD, AdaptiveFusionSettings())
        assert not running.is_valid
        running.step(Kind.GNSS, fix(1_000_000, 321.0, vertical_sd_m=3.0))
        assert (altitude_m(running), sd_m(running)) == (321.0, 3.0)
        assert math.isnan(running.estimate["baro_offset_m"][0])

    def test_without_gnss_there_is_no_altitude(self) -> None:
        running = Filter(METHOD, AdaptiveFusionSettings())
        for second in range(60):
            running.step(Kind.PRESSURE, pressure(second * 1_000_000, 100.0))
        assert not running.is_valid

    def test_a_barometer_that_comes_back_has_its_correction(self) -> None:
        running = Filter(METHOD, AdaptiveFusionSettings())
        running.step(Kind.PRESSURE, pressure(0, 500.0))
        running.step(Kind.GNSS, fix(0, 550.0, vertical_sd_m=1.0))
        corrected_m = altitude_m(running)
        for second in range(3, 60):
            running.step(Kind.GNSS, fix(second * 1_000_000, 560.0, vertical_sd_m=1.0))
        assert altitude_m(running) == 560.0
        running.step(Kind.PRESSURE, pressure(60_000_000, 510.0))
        assert altitude_m(running) == pytest.approx(corrected_m + 10.0, abs=1e-9)

    def test_a_restarted_vehicle_starts_anew(self) -> None:
        running = Filter(METHOD, AdaptiveFusionSettings())
        running.step(Kind.PRESSURE, pressure(500_000_000, 500.0))
        running.step(Kind.GNSS, fix(500_000_000, 550.0, vertical_sd_m=1.0))
        running.step(Kind.STATUS, sample(Kind.STATUS, 1_000_000, reboot=1))
        assert not running.is_valid
        assert running.step(Kind.PRESSURE, pressure(2_000_000, 80.0)) == Verdict.USED
        assert not running.is_valid
        assert running.step(Kind.GNSS, fix(2_000_000, 90.0, vertical_sd_m=1.0)) == Verdict.USED
        assert 89.0 < altitude_m(running) < 90.0


def test_the_claimed_accuracy_weighs_a_fix() -> None:
    """Of two receivers that say the same, the better one pulls harder; silence counts as the
    paper's 13 m."""
    altitudes = []
    for values in ({"vertical_sd_m": 2.0}, {}, {"vertical_sd_m": 40.0}):
        running = Filter(METHOD, AdaptiveFusionSettings(gain="fixed"))
        running.step(Kind.PRESSURE, pressure(0, 100.0))
        running.step(Kind.GNSS, fix(0, 110.0, **values))
        altitudes.append(altitude_m(running))
    assert altitudes == sorted(altitudes, reverse=True)
    assert altitudes[1] == pytest.approx(100.0 + 10.0 * R_B / (R_B + R_GPS), abs=1e-6)


def test_the_height_of_a_pressure_is_geometric() -> None:
    assert baro_altitude_m(22632.06) == pytest.approx(11019.07, abs=0.1)
