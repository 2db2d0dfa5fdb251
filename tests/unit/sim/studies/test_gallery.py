"""The gallery's page: every scenario has its section and its figure, and a section says what
happened."""

from concurrent.futures import Executor, Future
from pathlib import Path

import pytest

from companion.config import validate
from sim.scenario import Scenario, scenario_paths
from sim.studies.campaign import Job
from sim.studies.gallery import PAGE, build, section
from tests.paths import ROOT

GALLERY = ROOT / "docs" / "gallery"


class Here(Executor):
    """Runs a job when it is submitted."""

    def submit(self, function, /, *arguments, **named):  # type: ignore[no-untyped-def]
        future: Future[object] = Future()
        future.set_result(function(*arguments, **named))
        return future


PNG = b"\x89PNG\r\n"


@pytest.mark.parametrize("name", scenario_paths())
def test_every_scenario_is_in_the_gallery(name: str) -> None:
    page = (GALLERY / f"{PAGE}.md").read_text(encoding="utf-8")
    assert f"\n## {name}\n" in page, "run `kollsman-sim gallery`"
    assert f"({name}-flight.png)" in page
    assert (GALLERY / f"{name}-flight.png").read_bytes().startswith(PNG)


def test_the_gallery_has_nothing_else_and_is_small() -> None:
    figures = {path.name for path in GALLERY.glob("*.png")}
    assert figures == {f"{name}-flight.png" for name in scenario_paths()}
    assert sum(path.stat().st_size for path in GALLERY.iterdir()) < 2.5e6


@pytest.mark.long
def test_a_section_draws_and_judges_and_repeats(tmp_path: Path) -> None:
    values = {
        "name": "stuck", "summary": "Of a test.", "about": "Freezes.",
        "profile": [{"leg": "wait", "duration_s": 75}],
        "faults": [
            {"fault": "freeze", "start_s": 70}, {"fault": "outage", "start_s": 72, "duration_s": 2},
        ],
    }  # fmt: skip
    job = Job(validate(values, Scenario, "a test"), 3, ("adaptive-fusion",))
    first, second = section(job, tmp_path / "a"), section(job, tmp_path / "b")
    assert first == second
    figures = [(tmp_path / folder / "stuck-flight.png").read_bytes() for folder in "ab"]
    assert figures[0] == figures[1]
    assert "## stuck\n\nOf a test. (c172p, 1 min)\n\nFreezes.\n\nExpected of " in first.markdown
    assert "| adaptive-fusion |" in first.markdown
    assert "| freeze | barometer | 70 | end |" in first.markdown
    assert "| outage | gnss | 72 | 74 |" in first.markdown
    assert first.contents.startswith("| [stuck](#stuck) | Of a test. | ")


@pytest.mark.long
def test_a_renewed_section_leaves_the_others(tmp_path: Path) -> None:
    before = (GALLERY / f"{PAGE}.md").read_text(encoding="utf-8")
    (tmp_path / f"{PAGE}.md").write_text(before, encoding="utf-8")
    build([], Here(), tmp_path)
    assert (tmp_path / f"{PAGE}.md").read_text(encoding="utf-8") == before
    values = {
        "name": "calm",
        "summary": "Of a test.",
        "profile": [{"leg": "wait", "duration_s": 70}],
    }
    build([Job(validate(values, Scenario, "a test"), 3, ("adaptive-fusion",))], Here(), tmp_path)
    after = (tmp_path / f"{PAGE}.md").read_text(encoding="utf-8")
    (line,) = [
        line for line in after.splitlines() if line.startswith("| [calm](#calm) | Of a test.")
    ]
    section_of_calm = after[after.index("\n## calm\n") : after.index("\n## calm-circuit\n")]
    assert after.replace(f"{line}\n", "").replace(section_of_calm, "") == before
