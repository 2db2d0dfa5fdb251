"""A file that appears whole or not at all: a reader, a crash or a full disk never leaves half of
one."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path to write to, which takes the place of `path` when the block ends; an exception removes
    it and leaves `path` as it was. A pipe or a device is written to directly."""
    if path.exists() and not path.is_file():
        yield path
        return
    partial = path.with_name(path.name + ".partial")
    try:
        yield partial
        partial.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise


def write(path: Path, content: bytes, mode: int = 0o666, is_synced: bool = False) -> None:
    """Write `content` to `path`, with the permissions `mode` (less the umask); `is_synced` waits
    until the disk has it. Raises `OSError`."""
    with replacing(path) as partial:
        descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, mode)
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            if is_synced:
                os.fsync(descriptor)
