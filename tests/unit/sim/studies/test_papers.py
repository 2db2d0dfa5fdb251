"""The pages of the reproduced papers: verdicts follow from numbers, same seeds give the same
bytes."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.plots.style import FUSED
from sim.cli import app
from sim.studies.page import SEED_ROOT, Figure, Spread, generators, spread
from sim.studies.papers import PAPERS, Paper
from sim.studies.papers.luck import draw_again
from sim.studies.papers.page import (
    Check,
    Match,
    Page,
    Row,
    at_most,
    below,
    both,
    compare,
    holds,
    summary,
)
from tests.paths import ROOT

PAGES = ROOT / "docs" / "papers"
LARGEST_FIGURE_BYTES = 100_000


def quiet(fraction: float, what: str) -> None:
    assert 0.0 <= fraction <= 1.0, what


class TestVerdicts:
    def test_a_number_reproduces_within_its_tolerance_only(self) -> None:
        assert compare("x", 10.0, Spread(10.4, 1.0), 0.5).verdict is Match.REPRODUCES
        assert compare("x", 10.0, 10.6, 0.5).verdict is Match.DOES_NOT
        assert compare("x", 10.0, float("nan"), 0.5).verdict is Match.DOES_NOT

    def test_a_reading_qualifies_it(self) -> None:
        row = compare("x", 10.0, 10.0, 0.5, reading="k in kPa", note="and more")
        assert (row.verdict, row.notes) == (Match.ONLY_UNDER, "k in kPa; and more")
        assert compare("x", 10.0, 11.0, 0.5, reading="k in kPa").verdict is Match.DOES_NOT

    def test_a_claim_in_words(self) -> None:
        assert holds("better", below(1.0, 2.0), "yes").verdict is Match.REPRODUCES
        assert holds("better", below(2.0, 1.0), "no").verdict is Match.DOES_NOT
        assert (
            holds("both", both(below(1.0, 2.0), at_most(3.0, 3.0)), "").verdict is Match.REPRODUCES
        )
        assert holds("both", both(below(1.0, 2.0), at_most(4.0, 3.0)), "").verdict is Match.DOES_NOT


def test_spread_is_mean_and_sample_deviation() -> None:
    values = [1.0, 2.0, 4.0]
    assert spread(values) == Spread(pytest.approx(7 / 3), pytest.approx(np.std(values, ddof=1)))  # type: ignore[arg-type]
    assert spread(5.0) == Spread(5.0, 0.0)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (Spread(14.2687, 0.2513), "14.27 ± 0.25"),
        (Spread(377.9, 12.0), "378 ± 12"),
        (Spread(168.97812, 0.000591), "168.97812 ± 0.00059"),
        (Spread(54.756, 0.0), "54.756"),
        (Spread(float("nan"), 1.0), "nan"),
    ],
)
def test_a_spread_shows_two_digits_of_its_deviation(value: Spread, text: str) -> None:
    assert str(value) == text


def test_the_first_generators_do_not_depend_on_how_many_are_asked_for() -> None:
    few, many = generators("H", 3), generators("H", 10)
    assert [g.random() for g in few] == [g.random() for g in many[:3]]
    assert generators("W", 1)[0].random() != generators("H", 1)[0].random()


class TestPage:
    def test_tables_and_figures_in_reading_order(self, tmp_path: Path) -> None:
        page = Page("H", 5, tmp_path)
        page.text("First.")
        page.table("A table", [compare("x", 1.0, 1.0, 0.1, unit="m"), Row("y | z", printed="yes")])
        with page.figure("lines", "Two lines.", rows=2) as axes:
            axes[1].plot([0, 1], [1, 0], color=FUSED)
        page.grid("Ours", ["a", "b"], [["n", 1.5]])
        text = page.write().read_text(encoding="utf-8")
        order = [
            "never edited by hand",
            "First.",
            "### A table",
            "y \\| z",
            "lines.png",
            "### Ours",
        ]
        assert [text.index(part) for part in order] == sorted(text.index(part) for part in order)
        assert (tmp_path / "adaptive-fusion-lines.png").read_bytes().startswith(b"\x89PNG")
        assert summary(page.counts) == "1 reproduce, 1 not comparable"

    def test_every_column_of_ours_needs_a_value(self, tmp_path: Path) -> None:
        page = Page("H", 5, tmp_path)
        page.table("T", [Row("x", ours=(1.0, 2.0, 3.0))], ours=("a", "b"))
        with pytest.raises(ValueError, match="3 values for 2 columns"):
            page.markdown()


DRAWN = "HK"
"""pages whose figures are compared as well"""


@pytest.mark.parametrize(
    "key", [key if key == "C" else pytest.param(key, marks=pytest.mark.long) for key in PAPERS]
)
def test_a_page_rebuilds_byte_for_byte_and_no_verdict_is_a_constant(
    key: str, tmp_path: Path
) -> None:
    """Text and figures of a second run are those of the first; a row with a wrong number fails."""
    folders = tmp_path / "one", tmp_path / "two"
    one, two = (
        PAPERS[key].reproduce(2, folder if key in DRAWN else None, quiet) for folder in folders
    )
    assert one.markdown() == two.markdown()
    figures = [part.file for part in one.blocks if isinstance(part, Figure)]
    assert len(figures) > 2
    if key in DRAWN:
        for name in figures:
            assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes(), name
    checked = [row for row in one.rows if row.check is not None]
    assert len(checked) > 12
    for row in checked:
        assert_fails_with_a_wrong_number(row)
    for row in one.rows:
        assert row.check is not None or row.verdict is Match.NOT_COMPARABLE, row.claim


def assert_fails_with_a_wrong_number(row: Row) -> None:
    """NaN in the place of any number of the check, and a number that is far off in some place."""
    assert row.check is not None
    places = range(len(row.check.numbers))
    for place in places:
        fed = replace(row, check=row.check.fed(math.nan, place))
        assert fed.verdict is Match.DOES_NOT, f"{row.claim}: number {place}"
    far = [
        replace(row, check=row.check.fed(sign * 1e12, place)).verdict
        for place in places
        for sign in (-1, 1)
    ]
    assert Match.DOES_NOT in far, row.claim


def test_the_walk_finds_a_constant_verdict() -> None:
    """A check that ignores a number, and one that cannot fail, are found."""
    for check in (Check(lambda a, b: a < 1.0, (0.0, 5.0)), Check(lambda a: True, (0.0,))):
        with pytest.raises(AssertionError):
            assert_fails_with_a_wrong_number(holds("x", check, 0.0))


class TestLuck:
    def test_the_page_says_which_verdicts_other_roots_change(self, tmp_path: Path) -> None:
        page, other = Page("H", 5, tmp_path), Page("H", 5, None)
        other.root = 7
        for each, second in ((page, 2.0), (other, 3.0)):
            each.table("A", [compare("first", 1.0, 1.0, 0.1), compare("second", 2.0, second, 0.1)])
        page.others = [other]
        text = page.markdown()
        assert page.lucky == ["second (A): reproduces, **does not** with root 7"]
        assert "--check-root 7 --seeds 5 --out docs/papers" in text
        assert "With the seed roots 7, which draw other random numbers, these verdicts" in text
        other.blocks = page.blocks
        assert "every verdict is the same" in page.markdown()

    @pytest.mark.long
    def test_draws_other_numbers_and_writes_nothing(self, tmp_path: Path) -> None:
        page = PAPERS["H"].reproduce(2, tmp_path, quiet)
        files = set(tmp_path.iterdir())
        draw_again(PAPERS["H"], page, [1], quiet)
        assert (SEED_ROOT.get(), set(tmp_path.iterdir())) == (0, files)
        assert [other.root for other in page.others] == [1]
        assert [str(row.ours) for row in page.others[0].rows] != [
            str(row.ours) for row in page.rows
        ]
        with pytest.raises(ValueError, match="is that of the page itself"):
            draw_again(PAPERS["H"], page, [0], quiet)


def test_another_root_draws_other_numbers() -> None:
    usual = generators("H", 1)[0].random()
    token = SEED_ROOT.set(7)
    try:
        assert generators("H", 1)[0].random() != usual
    finally:
        SEED_ROOT.reset(token)
    assert generators("H", 1)[0].random() == usual


def test_only_the_page_knows_verdicts() -> None:
    """A paper's module gives numbers; `Row.verdict` is what follows from them."""
    for path in (ROOT / "sim" / "studies" / "papers").rglob("*.py"):
        if path.name != "page.py":
            assert "Match." not in path.read_text(encoding="utf-8"), path.name


class TestCommand:
    @pytest.mark.long
    def test_writes_the_page_and_says_where(self, tmp_path: Path) -> None:
        result = CliRunner().invoke(app, ["reproduce", "h", "--seeds", "2", "--out", str(tmp_path)])
        assert result.exit_code == 0, result.output
        assert result.stdout.startswith(f"H  {tmp_path / 'adaptive-fusion.md'}  2 seeds: ")

    def test_a_root_that_would_repeat_the_page_is_wrong_usage(self, tmp_path: Path) -> None:
        arguments = ["reproduce", "H", "--check-root", "0", "--out", str(tmp_path)]
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 2
        assert "--check-root 0 is the page's own seed root" in result.stderr

    def test_an_unknown_key_is_wrong_usage(self, tmp_path: Path) -> None:
        result = CliRunner().invoke(app, ["reproduce", "Z", "--out", str(tmp_path)])
        assert result.exit_code == 2
        assert "paper 'Z' is unknown" in result.stderr
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("paper", PAPERS.values(), ids=PAPERS)
def test_the_page_in_the_repository_is_whole_and_small(paper: Paper) -> None:
    text = (PAGES / f"{paper.slug}.md").read_text(encoding="utf-8")
    roots = "--check-root 1 --check-root 2"
    assert f"reproduce {paper.key} {roots} --seeds {paper.seeds} --out docs/papers" in text
    figures = re.findall(r"\]\(([^)]+\.png)\)", text)
    assert figures
    assert {PAGES / figure for figure in figures} == set(PAGES.glob(f"{paper.slug}-*.png"))
    for figure in figures:
        assert (PAGES / figure).stat().st_size < LARGEST_FIGURE_BYTES, figure
