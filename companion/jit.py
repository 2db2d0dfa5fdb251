"""The only file that imports Numba: `step` compiles a function, with a cache keyed by content.

Numba's own cache depends only on the file of the function itself, so callers of an edited helper
would keep code of the old one. Here each module that compiles has a cache folder of its own,
named after a hash of that module, of every compiled module it imports, of the Numba version and of
the processor: an edit of one estimator recompiles that estimator alone. Where the cache folder
cannot be written and holds nothing, a temporary one is used.
"""

import atexit
import hashlib
import logging
import os
import platform
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import llvmlite.binding  # a part of Numba that does not read its configuration

logger = logging.getLogger("kollsman.jit")

KEPT_CACHES = 4
"""number of versions of one module that stay in the cache, besides those of the last day"""
A_DAY_S = 86_400
MARK = b"from companion.jit import step"
_IMPORT = re.compile(rb"^ *from ([\w.]+) import ([^(\n]+|\([^)]*\))", re.MULTILINE)
_PACKAGES = ("companion", "sim", "tests")
_OURS = re.compile(r"([a-z_.]+)-[0-9a-f]{16}")

Function = TypeVar("Function", bound=Callable[..., Any])


@cache
def module_hash(path: Path) -> str:
    """Hash of everything that a module's compiled code depends on.

    Compiled modules take names only from each other and from `samples` (tests/test_architecture.py
    holds this).
    """
    digest = hashlib.sha256(_environment())
    for each in sorted(_closure(path)):
        digest.update(each.name.encode() + each.read_bytes())
    return digest.hexdigest()[:16]


def source_hash() -> str:
    """Hash of all compiled code of the companion: the estimators' numbers cannot change while it
    stays the same."""
    digest = hashlib.sha256(_environment())
    package = Path(__file__).parent
    for path in sorted(package.rglob("*.py")):
        if _compiles(path):
            digest.update(str(path.relative_to(package)).encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _environment() -> bytes:
    cpu = os.environ.get("NUMBA_CPU_NAME") or llvmlite.binding.get_host_cpu_name()
    return f"{version('numba')} {platform.machine()} {cpu}".encode()


def _compiles(path: Path) -> bool:
    return MARK in path.read_bytes() or path.name == "samples.py"


def _closure(path: Path) -> set[Path]:
    """`path` and the compiled modules that it imports, directly or through each other."""
    found, waiting = {path}, [path]
    while waiting:
        for imported in _imports(waiting.pop()) - found:
            found.add(imported)
            waiting.append(imported)
    return found


@cache
def _imports(path: Path) -> frozenset[Path]:
    """Files of the compiled modules that a file imports from."""
    found, roots = set(), dict.fromkeys(_PACKAGES, _ROOT)
    top = path
    while (top.parent / "__init__.py").is_file():
        top = top.parent
    roots.setdefault(top.stem, top.parent)  # an estimator of another package
    for module, names in _IMPORT.findall(path.read_bytes()):
        parts = module.decode().split(".")
        if parts[0] not in roots:
            continue
        place = roots[parts[0]].joinpath(*parts)
        submodules = (place / f"{name}.py" for name in re.findall(r"\w+", names.decode()))
        found |= {
            file
            for file in (place.with_suffix(".py"), *submodules)
            if file.is_file() and _compiles(file)
        }
    return frozenset(found)


def cache_directory() -> Path:
    """Where compiled code is kept: ``$KOLLSMAN_CACHE``, else the user's cache folder, else a
    temporary folder."""
    chosen = os.environ.get("KOLLSMAN_CACHE")
    candidates = [Path(chosen)] if chosen else []
    try:
        user_cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        candidates.append(Path(user_cache) / "kollsman")
    except RuntimeError:  # no home directory, as in some containers
        pass
    for directory in candidates:
        try:
            if (
                directory.is_dir()
                and any(directory.iterdir())
                and not os.access(directory, os.W_OK)
            ):
                return _temporary(directory)  # Numba uses no cache that it cannot write
            directory.mkdir(parents=True, exist_ok=True)
            if os.access(directory, os.W_OK):
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


@cache
def module_directory(path: Path, module: str) -> Path:
    """The cache folder of one module; older versions of the same module are deleted, but for the
    newest few."""
    directory = _CACHE / f"{module}-{module_hash(path)}"
    try:
        if not directory.is_dir():
            directory.mkdir(parents=True, exist_ok=True)
            _delete_old(directory, module)
    except OSError as error:
        logger.info("%s: %s", directory, error.strerror)
    return directory


def _delete_old(keep: Path, module: str) -> None:
    """Every edit of a module and every upgrade makes a new folder. Folders of others stay."""
    ours = ((_OURS.fullmatch(path.name), path) for path in keep.parent.iterdir() if path != keep)
    others = [path for name, path in ours if name and name[1] == module and path.is_dir()]
    recent_s = time.time() - A_DAY_S
    for path in sorted(others, key=lambda path: path.stat().st_mtime, reverse=True)[
        KEPT_CACHES - 1 :
    ]:
        if path.stat().st_mtime < recent_s:
            shutil.rmtree(path, ignore_errors=True)


def is_warm(function: Callable[..., Any]) -> bool:
    """Whether the module of a `step` has compiled code in the cache."""
    return any(_directory_of(function).rglob("*.nbi"))


def _directory_of(function: Callable[..., Any]) -> Path:
    code = getattr(function, "py_func", function).__code__
    return module_directory(Path(code.co_filename).resolve(), function.__module__)


_ROOT = Path(__file__).resolve().parents[1]
_CACHE = cache_directory()
os.environ["NUMBA_CACHE_DIR"] = str(_CACHE)

import numba  # noqa: E402  (reads NUMBA_CACHE_DIR when imported)
import numpy as np  # noqa: E402
from numba import types  # noqa: E402
from numba.core import event  # noqa: E402
from numba.core.caching import UserProvidedCacheLocator  # noqa: E402
from numba.core.options import DefaultOptions  # noqa: E402
from numba.extending import intrinsic  # noqa: E402
from numba.np.arrayobj import make_array, populate_array  # noqa: E402

_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy"}
if hasattr(DefaultOptions, "_nrt"):
    _OPTIONS["_nrt"] = False
    """Numba's own switch for code that allocates nothing: without it every array that a step passes
    on is counted atomically, which takes three quarters of the time of a scalar filter."""


class CacheLocator(UserProvidedCacheLocator):  # type: ignore[misc]
    """Places compiled code by module and content, not by path: another checkout of the same source
    finds it."""

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        return Path(py_file).stem


numba.config.CACHE_LOCATOR_CLASSES = f"{__name__}.CacheLocator,UserProvidedCacheLocator"


class _Compilations(event.Listener):  # type: ignore[misc]
    """Counts the functions that are compiled, not those that the cache has."""

    def __init__(self) -> None:
        self.count = 0

    def on_start(self, event: Any) -> None:
        self.count += 1

    def on_end(self, event: Any) -> None:
        """It was counted when it began."""


_COMPILATIONS = _Compilations()
event.register("numba:compile", _COMPILATIONS)


def compiled_functions() -> int:
    """How many functions this process has compiled, or begun to."""
    return _COMPILATIONS.count


def step(function: Function) -> Function:
    """Compile `function` (cached, IEEE division as NumPy has it); unchanged under
    NUMBA_DISABLE_JIT.

    It may look into arrays and take slices of them, but not make new ones: what it needs is in its
    arguments.
    """
    numba.config.CACHE_DIR = str(
        _directory_of(function)
    )  # read when the decorator finds a function's cache
    compiled: Any = numba.njit(**_OPTIONS)(function)
    if hasattr(compiled, "get_call_template"):
        _typed_once(compiled)
    return compiled  # type: ignore[no-any-return]


def _typed_once(compiled: Any) -> None:
    """Let callers that pass different constants share one compilation.

    Numba types a constant argument as itself, so that a helper called with the numbers of seven
    states is compiled seven times.
    """
    template = compiled.get_call_template
    compiled.get_call_template = lambda args, kws: template(
        tuple(map(types.unliteral, args)),
        {name: types.unliteral(kind) for name, kind in kws.items()},
    )


class Parts:
    """Arrays that a step takes as one argument: to look at an array that is passed takes longer
    than most steps, to look at this one takes as long for thirty as for one.

    A step finds an array in `argument` with `viewed`. The arrays live as long as this object, and
    must not be replaced by others meanwhile.
    """

    def __init__(self, arrays: Sequence[Any]) -> None:
        if not all(array.flags.c_contiguous and array.flags.writeable for array in arrays):
            raise ValueError("a part must be a contiguous array that can be written to")
        self._arrays = list(arrays)
        self.argument: Any = self._arrays
        if not numba.config.DISABLE_JIT:
            self.argument = np.array([array.ctypes.data for array in arrays], np.int64)


def viewed(parts: Any, at: int, dtype: Any, count: int) -> Any:
    """Inside a step: the first `count` elements of the array number `at` of `Parts`, whose dtype
    must be `dtype`."""
    return parts[at][:count]


def _viewed(_: Any, parts: Any, at: Any, dtype: Any, count: Any) -> Any:
    """The same compiled: an array of the address."""
    found = types.Array(dtype.dtype, 1, "C")

    def made(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        addresses = make_array(signature.args[0])(context, builder, values[0])
        address = builder.load(builder.gep(addresses.data, [values[1]]))
        kind = context.get_data_type(found.dtype)
        size = context.get_constant(types.intp, context.get_abi_sizeof(kind))
        array = make_array(found)(context, builder)
        data = builder.inttoptr(address, kind.as_pointer())
        populate_array(array, data, [values[3]], [size], size, None)
        return array._getvalue()

    return found(parts, types.intp, dtype, types.intp), made


if not numba.config.DISABLE_JIT:
    viewed = intrinsic(_viewed)
