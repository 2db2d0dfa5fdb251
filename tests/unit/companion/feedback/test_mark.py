"""The mark on disk: there before the write that it tells of, and never the reason of a crash."""

import logging
from pathlib import Path

import pytest

from companion.feedback import FeedbackSettings, Mark, MarkFile, start_feedback

MARK = Mark(1, "BARO_ALT_OFFSET", 0.0, 3.25, 3.125, 120_000_000, -8.5)


def test_what_was_saved_is_loaded_by_the_next_start(tmp_path: Path) -> None:
    file = MarkFile(["udpin:0.0.0.0:14550"], tmp_path)
    assert file.load() is None
    assert file.save(MARK)
    assert MarkFile(["udpin:0.0.0.0:14550"], tmp_path).load() == MARK
    assert MarkFile(["udpin:0.0.0.0:14551"], tmp_path).load() is None
    assert file.save(None)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", "null", '{"original": "x"}', '{"original": NaN}', "\x00"]
)
def test_a_damaged_file_is_no_mark(tmp_path: Path, text: str) -> None:
    file = MarkFile(["x"], tmp_path)
    assert file.path is not None
    file.path.write_text(text, encoding="utf-8")
    assert file.load() is None


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    assert not MarkFile(["x"], tmp_path / "missing").save(MARK)


def test_a_mark_of_a_version_that_knew_no_spread_is_read(tmp_path: Path) -> None:
    file = MarkFile(["x"], tmp_path)
    assert file.path is not None
    file.path.write_text(
        '{"system_id": 1, "parameter": "BARO_ALT_OFFSET", "original": 0.0, "written": 1.5, '
        '"previous": 1.4, "time_us": 5, "reference_m": -2.0}',
        encoding="utf-8",
    )
    mark = file.load()
    assert mark == Mark(1, "BARO_ALT_OFFSET", 0.0, 1.5, 1.4, 5, -2.0, 0.0)


def test_a_start_without_feedback_tells_what_an_earlier_one_has_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("KOLLSMAN_STATE", str(tmp_path))
    link = "udpin:0.0.0.0:14550"
    assert MarkFile([link]).save(MARK)
    told: list[str] = []
    logger = logging.getLogger("kollsman.feedback")
    monkeypatch.setattr(logger, "warning", lambda text, *values: told.append(text % values))
    assert start_feedback(FeedbackSettings(), link).knob is None
    (line,) = told
    assert "set feedback.mode to restore it" in line
    assert start_feedback(FeedbackSettings(mode="baro-alt-offset"), link).mark == MARK
