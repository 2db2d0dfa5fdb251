"""Paper R's page: figures that an independent implementation reached (papers/README.md R), and
those pinned here."""

from pathlib import Path

import numpy as np
import pytest

from companion.kernels.atmosphere import standard_pressure_pa
from sim.studies.page import generators
from sim.studies.papers import PAPERS
from sim.studies.papers.baro_gnss_ins import spikes, states
from sim.studies.papers.page import Match

SEEDS = 4


@pytest.mark.parametrize(("rate_hz", "climb_mps"), [(1, 0.416), (10, 4.16)])
def test_what_5_pa_between_samples_allow(rate_hz: int, climb_mps: float) -> None:
    """.42 m/s at 1 Hz, 4.2 m/s at 10 Hz."""
    pressure = np.array(
        [standard_pressure_pa(height) for height in np.arange(60) * (0.99 * climb_mps) / rate_hz]
    )
    assert spikes.gate_on_last(pressure).all()
    pressure = np.array(
        [standard_pressure_pa(height) for height in np.arange(60) * (1.02 * climb_mps) / rate_hz]
    )
    assert not spikes.gate_on_last(pressure)[1:20].any()


@pytest.mark.parametrize("rate_hz", [1, 10, 20])
def test_gates_on_a_descent_of_ten_metres_a_second(rate_hz: int) -> None:
    """Against the last accepted value 98 % and more are rejected; by the trend under 0.1 %, and no
    spike passes."""
    shares = spikes.Descents.of(rate_hz, SEEDS)
    assert 98.0 < shares.rejected["accepted"].mean < 100.0
    assert shares.rejected["trend"].mean < (0.1 if rate_hz > 1 else 0.4)
    assert shares.passed["trend"].mean == 0.0


def test_the_measured_altitude_in_the_row_drives_the_scale_factor() -> None:
    """Not printed anywhere: 5 m of noise at 10 Hz, ten minutes at 500 m, true s = 0."""
    for generator in generators("R", 2):
        assert states.driven_scale(generator, measured=True) == pytest.approx(-0.90, abs=0.02)
        assert abs(states.driven_scale(generator, measured=False)) < 1e-3


def test_row_of_the_barometer() -> None:
    """The estimator's own: -1, -dt_b, -1 and the held altitude in the place of h_p."""
    row, numeric = states.baro_row(0.02)
    np.testing.assert_allclose(numeric, [-1.0, -0.02, -1.0, -480.0], rtol=1e-4)
    np.testing.assert_allclose(row[:3], numeric[:3], rtol=1e-6)
    assert row[3] == pytest.approx(-480.5, rel=0.01)


def test_level_flight_has_rank_one_and_a_climb_two() -> None:
    assert states.Profile(states.LEVEL_M).rank == 1
    assert states.Profile(states.CLIMB_M).rank == 2


@pytest.mark.long
def test_the_page(tmp_path: Path) -> None:
    page = PAPERS["R"].reproduce(SEEDS, tmp_path, lambda fraction, what: None)
    rows = {row.claim: row for row in page.rows}
    assert (
        rows["the barometer stabilises it: largest error in the outage"].verdict is Match.REPRODUCES
    )
    assert rows["(16) is the derivative of (15)"].verdict is Match.REPRODUCES
    assert rows["at the pressure of 0 m"].verdict is Match.DOES_NOT
    assert "baro-gnss-ins-outage.png" in page.markdown()
