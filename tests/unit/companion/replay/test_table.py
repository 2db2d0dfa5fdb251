"""Tables of estimates on the disk."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from companion.errors import ConfigError
from companion.replay.table import write


def tables() -> Iterator[dict[str, Any]]:
    yield {"time_s": [1.0, 2.0], "health": ["OK", "LOST"]}
    raise OSError("No space left on device")


@pytest.mark.parametrize("name", ["flight.csv", "flight.parquet"])
def test_a_table_that_cannot_be_written_whole_is_not_written(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text("of yesterday\n")
    with pytest.raises(ConfigError, match="cannot be written"):
        write(path, tables())
    assert [each.name for each in tmp_path.iterdir()] == [name]
    assert path.read_text() == "of yesterday\n"


def test_a_missing_package_is_told_with_the_name_that_was_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ConfigError, match=r"flight\.parquet: Parquet needs pyarrow"):
        write(tmp_path / "flight.parquet", [{"time_s": [1.0]}])
