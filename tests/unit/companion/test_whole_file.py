"""A file that appears whole or not at all."""

import os
import stat
from pathlib import Path

import pytest

from companion import whole_file
from companion.whole_file import replacing


def write_half(path: Path) -> None:
    with replacing(path) as partial:
        partial.write_bytes(b"half")
        Path("/dev/full").write_bytes(b"rest")


def test_an_error_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "kept.json"
    whole_file.write(path, b"before")
    with pytest.raises(OSError, match="No space"):
        write_half(path)
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "kept.json"
    whole_file.write(path, b"before")
    (tmp_path / "kept.json.partial").symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left"):
        whole_file.write(path, b"after")
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_secret_is_never_readable_by_others(tmp_path: Path) -> None:
    path = tmp_path / "key"
    with replacing(path) as partial:
        whole_file.write(partial, b"1", mode=0o600)
        assert stat.S_IMODE(partial.stat().st_mode) == 0o600
    whole_file.write(path, b"2", mode=0o600, is_synced=True)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_a_pipe_stays_a_pipe(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        whole_file.write(path, b"line\n")
        assert os.read(reader, 100) == b"line\n"
    finally:
        os.close(reader)
    assert stat.S_ISFIFO(path.stat().st_mode)
