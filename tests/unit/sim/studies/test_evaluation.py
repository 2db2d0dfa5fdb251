"""The evaluation's goal table: judged by its limits, and made from whatever sections have run."""

import math
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.settings import CompanionSettings
from sim.cli import app
from sim.studies.goals import SECTIONS, Context, Section
from sim.studies.goals.flight_jobs import ABLATIONS, PREFIX
from sim.studies.goals.goals import GOALS, Measured
from sim.studies.goals.section import Index, SectionPage, read_rows, summary
from tests.paths import ROOT

PAGES = ROOT / "docs" / "evaluation"
LARGEST_FIGURE_BYTES = 100_000


def quiet(fraction: float, what: str) -> None:
    assert 0.0 <= fraction <= 1.0, what


@pytest.mark.parametrize(
    ("row", "verdict", "limits"),
    [
        (Measured("nees", "x", 1.0, at_most=1.4, at_least=0.7), "met", "0.7 to 1.4"),
        (Measured("nees", "x", 0.5, at_most=1.4, at_least=0.7), "**missed by 0.2**", "0.7 to 1.4"),
        (Measured("qnh", "x", 0.3, at_most=0.1, unit="m"), "**missed by 0.2 m**", "<= 0.1 m"),
        (Measured("qnh", "x", math.nan, at_most=0.1, unit="m"), "**missed**", "<= 0.1 m"),
        (Measured("qnh", "x"), "not run", ""),
        (
            Measured("gnss-ramp", "x", 60.0, at_least=70.0, unit="%"),
            "**missed by 10 %**",
            ">= 70 %",
        ),
    ],
)
def test_a_row_is_judged_by_its_limits(row: Measured, verdict: str, limits: str) -> None:
    assert (row.verdict, row.limits) == (verdict, limits)


@pytest.fixture
def section(monkeypatch: pytest.MonkeyPatch) -> Section:
    """The only section there is; nothing is measured."""
    made = Section("bound", "A title", 3)
    monkeypatch.setattr("sim.studies.goals.SECTIONS", {"bound": made})
    monkeypatch.setattr("sim.studies.goals.section.SECTIONS", {"bound": made})
    monkeypatch.setattr("sim.studies.goals.cli.SECTIONS", {"bound": made})
    return made


@pytest.mark.usefixtures("section")
class TestIndex:
    def page(self, out: Path) -> SectionPage:
        page = SectionPage("bound", Context(3, 1, None, out, quiet))
        page.text("How.")
        page.measured(
            Measured("bound", "S1", 1.02, at_most=1.10, shown="1.02 [1.00, 1.04]"),
            Measured("bound", "S2", math.nan, at_most=1.10),
        )
        return page

    def test_rows_survive_the_file(self, tmp_path: Path) -> None:
        page = self.page(tmp_path)
        path = page.write()
        assert "| S1 | 1.02 [1.00, 1.04] | <= 1.1 | met |" in path.read_text(encoding="utf-8")
        first, second = read_rows(path.with_suffix(".json"))
        assert first == page.rows[0]
        assert math.isnan(second.value or 0.0)

    def test_what_has_not_run_is_said(self, tmp_path: Path) -> None:
        empty = Index(tmp_path).write().read_text(encoding="utf-8")
        assert "- A title: not run" in empty
        self.page(tmp_path).write()
        index = Index(tmp_path)
        text = index.write().read_text(encoding="utf-8")
        assert "[A title](bound.md): 1 met, 1 missed" in text
        assert text.count("not run") == len(GOALS) - 1 + 1  # and in the summary
        assert summary(index.rows) == f"1 met, 1 missed, {len(GOALS) - 1} not run"

    def test_a_goal_must_exist(self, tmp_path: Path) -> None:
        with pytest.raises(ValueError, match="no goal 'speed'"):
            self.page(tmp_path).measured(Measured("speed", "x"))

    def test_a_broken_result_is_one_line(self, tmp_path: Path) -> None:
        (tmp_path / "bound.json").write_text("{}", encoding="utf-8")
        result = CliRunner().invoke(app, ["evaluate", "--out", str(tmp_path), "no-such"])
        assert result.exit_code == 2
        assert "no section 'no-such'" in result.stderr
        with pytest.raises(Exception, match="evaluate that section again"):
            Index(tmp_path)


def test_every_section_has_a_goal_and_a_module() -> None:
    """But for the picture of the states, which judges nothing."""
    assert {goal.section for goal in GOALS.values()} == set(SECTIONS) - {"states"}
    for section in SECTIONS.values():
        assert ROOT.joinpath(*section.module.split(".")).with_suffix(".py").exists()


MEASURED_SEEDS: dict[str, int] = {}
"""Pages that were measured with fewer seeds than their section's own."""


@pytest.mark.parametrize("key", [key for key in SECTIONS if (PAGES / f"{key}.md").exists()])
def test_a_page_in_the_repository_is_whole_and_small(key: str) -> None:
    text = (PAGES / f"{key}.md").read_text(encoding="utf-8")
    seeds = MEASURED_SEEDS.get(key, SECTIONS[key].seeds)
    assert f"evaluate {key} --seeds {seeds} " in text
    for row in read_rows(PAGES / f"{key}.json"):
        assert row.verdict in text
    figures = {PAGES / name for name in re.findall(r"\]\(([^)]+\.png)\)", text)}
    assert figures == set(PAGES.glob(f"{key}-*.png"))
    assert all(figure.stat().st_size < LARGEST_FIGURE_BYTES for figure in figures)


@pytest.mark.parametrize("name", list(ABLATIONS))
def test_every_ablation_is_a_setting_of_the_bank(name: str) -> None:
    """One with a key of an earlier bank failed every flight that it was tried on."""
    CompanionSettings().with_assignments([f"{PREFIX}{each}" for each in ABLATIONS[name]])
