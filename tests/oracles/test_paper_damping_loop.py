"""Paper K's simulation: the RNG-free vectors, and every figure that an independent implementation
reached.

That implementation's drive is not known; what depends on it is pinned with our own value and its
spread.
"""

import numpy as np
import pytest

from sim.studies.page import generators
from sim.studies.papers.damping_loop import mountain_road as road
from sim.studies.papers.damping_loop import simulation as paper
from sim.studies.papers.damping_loop.mountain_road import Drive


@pytest.fixture(scope="module")
def drives() -> list[Drive]:
    return [road.drive(random) for random in generators("K", 13)]


def test_euler_vectors() -> None:
    """vectors.json 004 "h", "v": dt .05, h0 100, v0 2, no 2 w_s^2 h. Its inputs, which it does not
    give, are these:

    found from the six numbers by trying sinusoids, and they meet all of them to the last digits.
    """
    time_s = 0.05 * np.arange(2000)
    baro_m = 100.0 + 20.0 * np.sin(0.1 * time_s) + 0.5 * np.sin(3.0 * time_s)
    force = -0.2 * np.sin(0.1 * time_s) + 0.05
    found = paper.euler(paper.PRINTED_GAINS, (100.0, 2.0, 0.0), baro_m, force, 0.05)[
        [0, 100, 500, 1999]
    ]
    height = [100.0, 109.96427570492538, 111.61894742903604, 89.01662117137539]
    climb = [2.0, 1.823271171433263, -1.6684932474458554, -1.694947967960526]
    np.testing.assert_allclose(found[:, 0], height, rtol=1e-13)
    np.testing.assert_allclose(found[:, 1], climb, rtol=1e-12)


def test_1_is_negative_for_either_sign_of_the_lapse_rate() -> None:
    assert paper.printed_altitude_m(84_500.0, 0.0065) == pytest.approx(-1505.4, abs=0.1)
    assert paper.printed_altitude_m(84_500.0, -0.0065) < 0.0


def test_5_is_circular() -> None:
    """On an exactly standard day it invents -82 or +85 m at 1350 m."""
    assert paper.circular_error_m(1350.0) == pytest.approx(-82.0, abs=0.5)
    assert paper.circular_error_m(1350.0, 1.225) == pytest.approx(85.0, abs=0.5)


def test_stability_of_the_printed_gains() -> None:
    assert paper.euler_limit_s() == pytest.approx(0.394, abs=5e-4)
    assert max(paper.radius(interval_s) for interval_s in np.geomspace(1e-3, 10.0, 60)) < 1.0


def test_compensated_altitude(drives: list[Drive]) -> None:
    """Independent implementation: rms 2.3 m on its drive. Ours is 2.5 with the same kind of error
    (2 K over 600 m)."""
    standard, compensated = paper.barometer_rms_m(drives)
    assert compensated == pytest.approx(2.5, abs=1.0)
    assert standard > 15.0


def test_velocity_errors(drives: list[Drive]) -> None:
    """Independent implementation: printed gains .294, best gains .150, 4-state filter .153 m/s.

    On our road the printed gains have .24 (.25 by forward Euler): not reproduced, pinned. The other
    two hold, and so does what follows from them: only a filter without a state for the
    accelerometer's bias is worse than the loop.
    """
    best = (
        1.9355,
        0.9677,
        0.1935,
    )  # what an exhaustive search finds on the first drive: see the slow test
    printed, loop, euler = (
        paper.errors(drives[1:], way)[0].mean
        for way in (paper.loop(paper.PRINTED_GAINS), paper.loop(best), paper.euler_loop)
    )
    four = paper.errors(drives[1:], paper.kalman_filter(bias_state=True))[0].mean
    three = paper.errors(
        drives[1:], paper.kalman_filter(bias_state=False, noise=paper.best_noise(drives[0]))
    )[0].mean
    assert loop == pytest.approx(0.150, abs=0.015)
    assert four == pytest.approx(0.153, abs=0.01)
    assert printed == pytest.approx(0.24, abs=0.03)
    assert euler == pytest.approx(0.255, abs=0.03)
    assert three > 1.5 * loop
    assert printed > 1.4 * loop


def test_printed_gains_cost_more(drives: list[Drive]) -> None:
    """Independent implementation: 2.6-3.3 times the least. Ours 2.4 +- .6 over 20 drives, on the
    same kind of cost."""
    ratios = paper.printed_over_least(drives[1:6])
    assert ratios.min() > 1.2
    assert np.mean(ratios) == pytest.approx(2.5, abs=0.5)


@pytest.mark.long
def test_exhaustive_search_of_the_first_drive(drives: list[Drive]) -> None:
    tuned = paper.tune(drives[0], 30, lambda share: None)
    assert tuned.ratios.min() == 1.0
    assert tuned.ratios.max() < 1.05
    np.testing.assert_allclose(tuned.best, (1.9355, 0.9677, 0.1935), atol=1e-3)
