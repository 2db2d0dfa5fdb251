"""A comparison is drawn in the one style, and says where its axes are clipped."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from companion.estimators import DEFAULT_ESTIMATOR
from companion.evaluation.compare import Comparison, Series
from companion.evaluation.samples import BOOT_US
from companion.plots.comparison import Minutes, draw_comparison, line, plot, plot_protection
from companion.plots.drawing import figure
from companion.plots.stanford import draw_stanford
from companion.plots.style import BARO, FUSED, TRUTH

TIMES_US = np.arange(0.0, 600.0, 0.5) * 1e6
TRUTH_M = 100.0 + 0.1 * TIMES_US * 1e-6


def comparison(reference: str = "truth") -> Comparison:
    unknown = np.full(TIMES_US.size, np.nan)
    ours = TRUTH_M + np.sin(TIMES_US / 30e6)
    baro = TRUTH_M + 40.0
    baro[500] += 2000.0
    series = [
        Series(DEFAULT_ESTIMATOR, TIMES_US, ours, unknown, unknown, level_m=np.full(1200, 12.0)),
        Series("raw barometer", TIMES_US, baro, unknown, unknown),
    ]
    return Comparison(reference, series, [], TIMES_US, TRUTH_M, 60e6)


def test_every_line_has_the_colour_of_its_source() -> None:
    with figure(3) as (_, axes):
        draw_comparison(axes, comparison(), [(2.0, 3.0)])
        colours = [[each.get_color() for each in panel.get_lines()] for panel in axes]
        assert colours == [[BARO, TRUTH, FUSED], [BARO], [FUSED]]
        told = [text.get_text() for text in axes[1].texts]
        assert told == ["axis clipped; values reach 2040 m"]
        legend = axes[1].get_legend().get_bbox_to_anchor().transformed(axes[1].transAxes.inverted())
        assert legend.y0 == pytest.approx(1.0)  # above the panel, where no data is


@pytest.mark.parametrize("reference", ["truth", "smoother"])
def test_the_picture_has_two_pixels_for_each_of_a_screen(tmp_path: Path, reference: str) -> None:
    path = tmp_path / "comparison.png"
    plot(comparison(reference), path, "flight")
    with Image.open(path) as image:
        assert image.size[0] == 1600


def test_a_log_without_any_reference_is_drawn(tmp_path: Path) -> None:
    found = comparison()
    nothing = Comparison("nothing", found.series, [], np.zeros(0), np.zeros(0))
    plot(nothing, tmp_path / "nothing.png", "flight")


def test_boots_follow_each_other_and_gaps_stay_open() -> None:
    two = np.concatenate([TIMES_US, TIMES_US + BOOT_US])
    minutes = Minutes([two])(two)
    assert minutes[1200] == pytest.approx(minutes[1199], abs=0.01)
    assert np.diff(minutes).min() >= 0.0
    drawn, values = line(np.array([0.0, 0.01, 1.0]), np.array([1.0, 2.0, 3.0]))
    assert np.isnan(drawn).sum() == np.isnan(values).sum() == 1


def test_the_stanford_diagram_is_filled_by_its_data(tmp_path: Path) -> None:
    errors_m, levels_m = 3.0 * np.sin(TIMES_US), np.full(TIMES_US.size, 12.0)
    with figure(1) as (canvas, axes):
        draw_stanford(axes[0], errors_m, levels_m)
        assert axes[0].get_xlim()[1] == pytest.approx(3.24, rel=0.01)
        assert axes[0].get_ylim()[1] == pytest.approx(12.96, rel=0.01)
        assert [each.get_ylabel() for each in canvas.axes] == ["protection level (m)", "samples"]
        label = axes[0].get_xlabel()
        assert "available 100 %" in label
        assert "alert limit 50 m, beyond the axes" in label
    plot_protection(comparison(), tmp_path / "stanford.png", "flight", 50.0)
    assert (tmp_path / "stanford.png").read_bytes().startswith(b"\x89PNG")
