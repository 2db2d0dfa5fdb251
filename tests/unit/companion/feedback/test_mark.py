"""The mark on disk: there before the write that it tells of, and never the reason of a crash."""

from pathlib import Path

import pytest

from companion.feedback import Mark, MarkFile

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
