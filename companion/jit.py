"""The only file that imports Numba: `step` compiles a function, with a cache that cannot go stale.

Numba's own cache looks only at the file of the function itself, so an edited helper would leave its callers compiled
against the old one. Here the cache folder is named after a hash of every source file of this package, the Numba version
and the processor; where that folder cannot be written and holds nothing, a temporary one is used.
"""

import hashlib
import logging
import os
import platform
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

logger = logging.getLogger("kollsman.jit")

Function = TypeVar("Function", bound=Callable[..., Any])


def source_hash() -> str:
    """Hash of everything that compiled code depends on."""
    import llvmlite.binding  # noqa: PLC0415  (part of numba; only needed for the processor's name)
    import numba  # noqa: PLC0415

    digest = hashlib.sha256()
    package = Path(__file__).parent
    for path in sorted(package.rglob("*.py")):
        digest.update(str(path.relative_to(package)).encode())
        digest.update(path.read_bytes())
    digest.update(f"{numba.__version__} {platform.machine()} {llvmlite.binding.get_host_cpu_name()}".encode())
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
        if directory.is_dir() and any(directory.iterdir()) and not os.access(directory, os.W_OK):
            return directory  # a warm cache on a read-only file system still serves
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(directory, os.W_OK):
            return directory
    logger.info("no writable cache folder; compiling into a temporary one")
    return Path(tempfile.mkdtemp(prefix="kollsman-"))


def is_warm() -> bool:
    """Whether the cache already holds compiled code."""
    return any(_CACHE.rglob("*.nbi"))


_CACHE = cache_directory()
os.environ["NUMBA_CACHE_DIR"] = str(_CACHE)

import numba  # noqa: E402  (reads NUMBA_CACHE_DIR when imported)


def step(function: Function) -> Function:
    """Compile `function` (cached, IEEE division as NumPy has it); unchanged under NUMBA_DISABLE_JIT."""
    compiled: Function = numba.njit(cache=True, error_model="numpy")(function)
    return compiled
