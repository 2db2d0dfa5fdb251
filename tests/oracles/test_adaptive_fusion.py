"""Paper H's filter against other roads to the same numbers, and its variance against random
numbers."""

import math

import numpy as np
import pytest

from companion.estimators.adaptive_fusion import (
    adaptive_factor,
    fused_sd_m,
    gain,
)
from sim.studies.papers.adaptive_fusion import simulation as paper

R_B, R_GPS = paper.R_B, paper.R_GPS


def test_estimate_is_weighted_least_squares_of_the_two_heights() -> None:
    """min (h - h_B)^2 / (S R_B) + (h - h_GPS)^2 / R_GPS by a solver for linear least squares."""
    generator = np.random.default_rng(1)
    for baro, gps in generator.normal(1000.0, 40.0, (50, 2)).tolist():
        S = adaptive_factor(gps - baro, R_B, R_GPS)
        weights = 1.0 / np.sqrt([S * R_B, R_GPS])
        expected = np.linalg.lstsq(weights[:, None], weights * [baro, gps], rcond=None)[0][0]
        assert baro + gain(S, R_B, R_GPS) * (gps - baro) == pytest.approx(expected, rel=1e-12)


def test_factor_is_the_most_likely_one() -> None:
    """S maximises the likelihood of the residual, N(0, S R_B + R_GPS), over S >= 1."""
    candidates = np.linspace(1.0, 200.0, 199_001)
    variances = candidates * R_B + R_GPS
    for delta in (0.0, 5.0, 14.0, 16.0, -30.0, 90.0):
        likelihood = -0.5 * np.log(variances) - 0.5 * delta**2 / variances
        assert adaptive_factor(delta, R_B, R_GPS) == pytest.approx(
            candidates[np.argmax(likelihood)], abs=1e-3
        )


@pytest.mark.parametrize("bias_m", [60.0, 80.0, 120.0])
def test_mean_square_error_when_the_barometer_is_wrong(bias_m: float) -> None:
    """R_GPS + 3 R_GPS^2 / b^2 to second order in the noise: above GPS alone, while P is below."""
    mean_square_m2, _ = fused(adaptive=True, bias_m=bias_m)
    fourth_order_m2 = 15 * R_GPS**2 * (R_B + R_GPS) / bias_m**4
    assert mean_square_m2 == pytest.approx(
        R_GPS + 3 * R_GPS**2 / bias_m**2, abs=4.0 + fourth_order_m2
    )
    assert mean_square_m2 > R_GPS


@pytest.mark.parametrize(
    ("adaptive", "bias_m"), [(True, 40.0), (True, 80.0), (False, 40.0), (False, 80.0)]
)
def test_spread_is_the_error_to_expect(adaptive: bool, bias_m: float) -> None:
    """Where the barometer is wrong, the mean square error is the mean of the variance that is
    reported."""
    mean_square_m2, predicted_m2 = fused(adaptive, bias_m)
    assert mean_square_m2 / predicted_m2 == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize(("adaptive", "ratio"), [(True, 0.63), (False, 0.50)])
def test_spread_is_cautious_where_nothing_is_wrong(adaptive: bool, ratio: float) -> None:
    """One residual does not tell noise from a fault, so the spread allows for a fault: up to 1.4
    times."""
    mean_square_m2, predicted_m2 = fused(adaptive, 0.0)
    assert mean_square_m2 / predicted_m2 == pytest.approx(ratio, abs=0.03)


def fused(adaptive: bool, bias_m: float) -> tuple[float, float]:
    """Mean square error and mean reported variance over 40000 pairs, m2."""
    squares = predicted = 0.0
    pairs = np.random.default_rng(3).standard_normal((40_000, 2))
    for noise_b, noise_gps in pairs.tolist():
        baro, gps = bias_m + 9.0 * noise_b, 13.0 * noise_gps
        delta = gps - baro
        S = adaptive_factor(delta, R_B, R_GPS) if adaptive else 1.0
        K = gain(S, R_B, R_GPS)
        squares += (baro + K * delta) ** 2
        predicted += fused_sd_m(delta, S, K, R_B, R_GPS) ** 2
    return squares / len(pairs), predicted / len(pairs)


@pytest.fixture(scope="module")
def tallies() -> tuple[paper.Tally, paper.Tally, paper.Tally]:
    """The paper's three cases over 100 seeds (a second)."""
    made = paper.Tally(), paper.Tally(), paper.Tally()
    for runs in paper.monte_carlo(100):
        for tally, run in zip(made, runs, strict=True):
            tally.add(run)
    return made


class TestReproduction:
    """The acceptance figures of papers/README.md, section H; tolerances are three standard errors
    of both means."""

    def test_heights_need_another_gas_constant(self) -> None:
        assert float(paper.height_m(23.0)) == pytest.approx(10894.252293896347, abs=1e-6)
        assert float(paper.height_m(99.85)) == pytest.approx(123.46886627612994, abs=1e-6)
        assert float(paper.height_m(23.0, gas_constant=287.0)) == pytest.approx(
            10892.60966280354, abs=1e-6
        )
        assert float(paper.height_m(99.85, gas_constant=287.0)) == pytest.approx(
            123.44738973975896, abs=1e-6
        )

    def test_drift_by_the_pressure(self) -> None:
        biases = {
            400: -40.3406,
            600: -48.4540,
            800: -56.3038,
            1000: -63.9258,
            1300: -74.9878,
            1500: -82.1437,
        }
        for iteration, bias_m in biases.items():
            assert paper.DRIFT.bias_m[iteration - 1] == pytest.approx(bias_m, abs=1e-3)

    def test_drift_by_the_iteration_is_twenty_times_larger(self) -> None:
        biases_m = np.abs(paper.LITERAL.bias_m[[i - 1 for i in paper.TABLE_1]])
        assert biases_m[0] == pytest.approx(378, abs=1)
        assert biases_m[-1] == pytest.approx(1309, abs=3)

    def test_errors_without_drift(self, tallies: tuple[paper.Tally, ...]) -> None:
        nominal = tallies[0]
        assert nominal.rms("adaptive_m").mean == pytest.approx(9.62, abs=0.09)
        assert nominal.rms("fixed_m").mean == pytest.approx(7.40, abs=0.06)
        assert np.mean(nominal.fired) == pytest.approx(0.317, abs=0.006)
        assert np.mean(nominal.negative) == pytest.approx(0.59, abs=0.006)

    def test_errors_under_drift(self, tallies: tuple[paper.Tally, ...]) -> None:
        drift = tallies[1]
        assert drift.rms("adaptive_m").mean == pytest.approx(14.27, abs=0.11)
        assert drift.rms("gnss_m").mean == pytest.approx(12.98, abs=0.10)
        assert drift.rms("fixed_m").mean == pytest.approx(39.38, abs=0.08)
        assert drift.rms("baro_m").mean == pytest.approx(57.92, abs=0.09)

    def test_table_1_only_with_k_as_the_pressure(self, tallies: tuple[paper.Tally, ...]) -> None:
        """Each printed P is within the spread of ours under that reading, and 20 spreads away under
        the literal one."""
        _, drift, literal = tallies
        for iteration, printed in paper.TABLE_1.items():
            low, high = np.quantile(drift.variance_m2[iteration], [0.01, 0.99])
            assert low < printed < high
            assert 168.7 < np.mean(literal.variance_m2[iteration]) < 169.0
            assert printed < min(literal.variance_m2[iteration]) - 1.0

    def test_table_1_as_a_whole(self) -> None:
        """The six residuals that the printed P need are a plausible draw: chi-squared with 6
        degrees of freedom."""
        needed = np.array(
            [R_GPS / math.sqrt(R_GPS - printed) for printed in paper.TABLE_1.values()]
        )
        biases = np.abs(paper.DRIFT.bias_m[[i - 1 for i in paper.TABLE_1]])
        assert 1.2 < float(np.sum((needed - biases) ** 2 / (R_B + R_GPS))) < 14.4
