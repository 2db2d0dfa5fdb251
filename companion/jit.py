"""The only file that imports Numba: `step` compiles a function, with a cache that cannot go stale.

Numba's own cache looks only at the file of the function itself, so an edited helper would leave its callers compiled
against the old one. Here the cache folder is named after a hash of every module that compiles, the Numba version and
the processor; where that folder cannot be written and holds nothing, a temporary one is used.
"""

import atexit
import hashlib
import logging
import os
import platform
import re
import shutil
import tempfile
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import llvmlite.binding  # a part of Numba that does not read its configuration

logger = logging.getLogger("kollsman.jit")

KEPT_CACHES = 4
MARK = b"from companion.jit import step"
_OURS = re.compile("[0-9a-f]{16}")

Function = TypeVar("Function", bound=Callable[..., Any])


def source_hash() -> str:
    """Hash of everything that compiled code depends on: the modules that compile, the records, Numba, the processor.

    Compiled modules take names only from each other and from `samples` (tests/test_architecture.py holds this).
    """
    digest = hashlib.sha256()
    package = Path(__file__).parent
    for path in sorted(package.rglob("*.py")):
        source = path.read_bytes()
        if MARK in source or path.name == "samples.py":
            digest.update(str(path.relative_to(package)).encode())
            digest.update(source)
    cpu = os.environ.get("NUMBA_CPU_NAME") or llvmlite.binding.get_host_cpu_name()
    digest.update(f"{version('numba')} {platform.machine()} {cpu}".encode())
    return digest.hexdigest()[:16]


def cache_directory() -> Path:
    """Where compiled code is kept: ``$KOLLSMAN_CACHE``, else the user's cache folder, else a temporary folder."""
    chosen = os.environ.get("KOLLSMAN_CACHE")
    candidates = [Path(chosen)] if chosen else []
    try:
        user_cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        candidates.append(Path(user_cache) / "kollsman")
    except RuntimeError:  # no home directory, as in some containers
        pass
    name = source_hash()
    for candidate in candidates:
        directory = candidate / name
        try:
            if directory.is_dir() and any(directory.iterdir()) and not os.access(directory, os.W_OK):
                return _temporary(directory)  # Numba uses no cache that it cannot write
            directory.mkdir(parents=True, exist_ok=True)
            if os.access(directory, os.W_OK):
                _forget_old(candidate, keep=directory)
                return directory
        except OSError:  # a home of somebody else's, a file in the way
            continue
    logger.info("no writable cache folder; compiling into a temporary one")
    return _temporary()


def _temporary(warm: Path | None = None) -> Path:
    """A folder for this process, with a copy of the warm cache in it."""
    directory = Path(tempfile.mkdtemp(prefix="kollsman-"))
    atexit.register(shutil.rmtree, directory, ignore_errors=True)
    if warm:
        shutil.copytree(warm, directory, dirs_exist_ok=True)
    return directory


def _forget_old(folder: Path, keep: Path) -> None:
    """Leave the newest few caches: every edit of the source and every upgrade makes a new one. Others' folders stay."""
    others = (path for path in folder.iterdir() if _OURS.fullmatch(path.name) and path.is_dir() and path != keep)
    for path in sorted(others, key=lambda path: path.stat().st_mtime, reverse=True)[KEPT_CACHES:]:
        shutil.rmtree(path, ignore_errors=True)


def is_warm() -> bool:
    """Whether the cache already holds compiled code."""
    return any(_CACHE.rglob("*.nbi"))


_CACHE = cache_directory()
os.environ["NUMBA_CACHE_DIR"] = str(_CACHE)

import numba  # noqa: E402  (reads NUMBA_CACHE_DIR when imported)
from numba import types  # noqa: E402
from numba.core.options import DefaultOptions  # noqa: E402

_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy"}
if hasattr(DefaultOptions, "_nrt"):
    _OPTIONS["_nrt"] = False
    """Numba's own switch for code that allocates nothing: without it every array that a step passes on is counted
    atomically, which takes three quarters of the time of a scalar filter."""


def step(function: Function) -> Function:
    """Compile `function` (cached, IEEE division as NumPy has it); unchanged under NUMBA_DISABLE_JIT.

    It may look into arrays and take slices of them, but not make new ones: what it needs is in its arguments.
    """
    compiled: Any = numba.njit(**_OPTIONS)(function)
    if hasattr(compiled, "get_call_template"):
        _typed_once(compiled)
    return compiled  # type: ignore[no-any-return]


def _typed_once(compiled: Any) -> None:
    """Let callers that pass different constants share one compilation.

    Numba types a constant argument as itself, so that a helper called with the numbers of seven states is compiled
    seven times.
    """
    template = compiled.get_call_template
    compiled.get_call_template = lambda args, kws: template(
        tuple(map(types.unliteral, args)), {name: types.unliteral(kind) for name, kind in kws.items()}
    )
