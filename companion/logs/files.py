"""Opening and reading a log's file, with errors that say what to do."""

from pathlib import Path
from typing import BinaryIO

from companion.errors import LogFormatError


def opened(path: Path) -> BinaryIO:
    """The file, open for reading. Raises `LogFormatError`."""
    try:
        return path.open("rb")
    except FileNotFoundError as error:
        raise LogFormatError(f"{path}: no such file") from error
    except IsADirectoryError as error:
        raise LogFormatError(f"{path}: is a folder; name a log in it") from error
    except OSError as error:
        raise LogFormatError(f"{path}: cannot be read: {error.strerror or error}") from error


def read(file: BinaryIO, path: Path, size: int = -1) -> bytes:
    """The next `size` bytes, or all that are left. Raises `LogFormatError`."""
    try:
        return file.read(size)
    except OSError as error:
        raise LogFormatError(f"{path}: cannot be read: {error.strerror or error}") from error


def contents(path: Path) -> bytes:
    """The whole file. Raises `LogFormatError`, also when it is empty."""
    with opened(path) as file:
        data = read(file, path)
    if not data:
        raise LogFormatError(f"{path}: the file is empty")
    return data
