"""Vertical axes show what matters; what leaves them is told by the panel."""

import numpy as np
import pytest

from companion.plots.panels import Panel, panels
from companion.plots.ranges import error_range, limits

RANDOM = np.random.default_rng(3)


def difference_panel() -> Panel:
    return next(each for each in panels("truth") if each.name == "difference")


def tables(**errors: np.ndarray) -> dict[str, dict[str, np.ndarray]]:
    return {
        name: {"t": np.arange(values.size), "difference_m": values}
        for name, values in errors.items()
    }


def test_a_spike_of_one_source_does_not_flatten_the_others() -> None:
    ours, gnss = RANDOM.normal(0, 1, 5000), RANDOM.normal(0, 3, 5000)
    gnss[100] = 900.0
    found = limits(difference_panel(), tables(estimate=ours, gnss=gnss))
    assert found is not None
    assert found[1] < 50.0
    assert found[0] < -3.0


def test_calm_curves_are_not_clipped() -> None:
    ours = np.sin(np.arange(2000) / 50.0)
    found = limits(difference_panel(), tables(estimate=ours))
    assert found == pytest.approx((-1.0, 1.0), abs=0.01)


def test_the_band_has_room() -> None:
    found = tables(estimate=np.zeros(100))
    found["estimate"]["sd_m"] = np.full(100, 5.0)
    limit = limits(difference_panel(), found)
    assert limit is not None
    assert limit[0] <= -13.0
    assert limit[1] >= 13.0


def test_nothing_known_has_no_limits() -> None:
    assert limits(difference_panel(), tables(estimate=np.full(10, np.nan))) is None


def test_the_range_of_a_gallery_follows_most_lines() -> None:
    lines = [RANDOM.normal(0, 1, 1000), RANDOM.normal(0, 2, 1000), np.full(1000, 4000.0)]
    low, high = error_range(lines, at_least_m=15.0)
    assert -20.0 < low < 0.0
    assert 15.0 < high < 30.0
