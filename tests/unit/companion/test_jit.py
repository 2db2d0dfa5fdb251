"""Compiled code: never stale, wherever the package lies and whoever runs it, and bit for bit the
uncompiled result."""

import ctypes
import importlib
import os
import pkgutil
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import companion
from companion.estimators import ESTIMATORS, run_log
from companion.jit import KEPT_CACHES, cache_directory, module_directory, source_hash
from tests.flights import Plan, flight

PACKAGE = Path(companion.__file__).parent
ROOT = PACKAGE.parent
HELPER = """
from companion.jit import step

@step
def helper(x: float) -> float:
    return x * {factor}
"""
CALLER = """
from companion.helper import helper
from companion.jit import step

@step
def caller(x: float) -> float:
    return helper(x) + 1.0
"""
SCRIPT = "from companion.caller import caller; print(caller(10.0))"


@pytest.fixture
def copy() -> Iterator[Path]:
    """A folder with a copy of the package and two small compiled modules in it."""
    folder = Path(tempfile.mkdtemp(prefix="kollsman-test-"))
    shutil.copytree(PACKAGE, folder / "companion", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "companion" / "helper.py").write_text(HELPER.format(factor="2.0"))
    (folder / "companion" / "caller.py").write_text(CALLER)
    yield folder
    for path in folder.iterdir():
        path.chmod(0o755)
    shutil.rmtree(folder)


def _give_up_power() -> None:
    """Even root then needs permission to read and to write; it is nothing to anybody else."""
    if os.geteuid() == 0:
        for capability in (1, 2):  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH
            assert ctypes.CDLL(None).prctl(24, capability, 0, 0, 0) == 0  # PR_CAPBSET_DROP


def run(folder: Path, environment: dict[str, str], *, powerless: bool = False) -> str:
    """What the script prints when run beside the package with nothing but this environment."""
    known = {"PATH": os.environ["PATH"], "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", SCRIPT],
        env=known | environment,
        cwd="/",
        preexec_fn=_give_up_power if powerless else None,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def everything(folder: Path) -> list[tuple[str, int]]:
    return sorted((str(path), path.stat().st_mtime_ns) for path in folder.rglob("*"))


def test_an_edited_helper_changes_its_caller(copy: Path) -> None:
    """Numba alone looks only at the caller's own file."""
    cache = copy / "cache"
    helper = copy / "companion" / "helper.py"
    assert run(copy, {"KOLLSMAN_CACHE": str(cache)}) == "21.0"
    helper.write_text(HELPER.format(factor="3.0"))
    assert run(copy, {"KOLLSMAN_CACHE": str(cache)}) == "31.0"
    helper.write_text(HELPER.format(factor="2.0"))
    before = everything(cache)
    assert run(copy, {"KOLLSMAN_CACHE": str(cache)}) == "21.0"
    assert everything(cache) == before, "compiled again although it was there"
    assert len(list(cache.iterdir())) == 4, "two versions of two modules"


def test_only_caches_of_ours_are_ever_deleted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A user may point the cache at a folder with other things in it."""
    precious = {"photos", "letters", "music", "films", "books", "deadbeef"}
    for name in precious:
        (tmp_path / name).mkdir()
    for number in range(6):
        (tmp_path / f"companion.made_up-{number:016x}").mkdir()
        (tmp_path / f"companion.other-{number:016x}").mkdir()
        (tmp_path / f"companion.recent-{number:016x}").mkdir()
    for path in tmp_path.iterdir():
        if "recent" not in path.name:
            os.utime(path, (0, 0))
    monkeypatch.setattr("companion.jit._CACHE", tmp_path)
    for module in ("companion.made_up", "companion.recent"):
        assert module_directory(PACKAGE / "kernels" / "ring.py", module).is_dir()
    left = {path.name for path in tmp_path.iterdir()}
    assert precious < left
    assert len(left) == len(precious) + 6 + KEPT_CACHES + 6 + 1


@pytest.mark.parametrize(
    "environment",
    [
        {"HOME": "{folder}/read-only"},
        {"KOLLSMAN_CACHE": "{folder}/closed", "XDG_CACHE_HOME": "/proc/none"},
        pytest.param({"HOME": "{folder}/read-only/at/all"}, marks=pytest.mark.slow),
        pytest.param({"HOME": "/dev/null"}, marks=pytest.mark.slow),
        pytest.param(
            {"XDG_CACHE_HOME": "{folder}/read-only", "HOME": "/dev/null"}, marks=pytest.mark.slow
        ),
    ],
    ids=["HOME read-only", "all of them bad", "no such HOME", "HOME is a device", "XDG read-only"],
)
def test_import_works_from_a_read_only_package_without_a_home(
    copy: Path, environment: dict[str, str]
) -> None:
    for name, mode in (("read-only", 0o555), ("closed", 0o000), ("companion", 0o555)):
        (copy / name).mkdir(exist_ok=True)
        (copy / name).chmod(mode)
    before = everything(copy / "companion")
    known = {name: value.format(folder=copy) for name, value in environment.items()}
    assert run(copy, known, powerless=True) == "21.0"
    assert everything(copy / "companion") == before
    (copy / "closed").chmod(0o755)
    assert list((copy / "closed").iterdir()) == list((copy / "read-only").iterdir()) == []


def test_a_user_without_a_name_has_no_home(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container started with some number as its user."""

    def no_home() -> Path:
        raise RuntimeError("could not determine home directory")

    monkeypatch.setattr(Path, "home", no_home)
    for name in ("KOLLSMAN_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    assert cache_directory().is_dir()


@pytest.mark.parametrize(
    ("name", "below"),
    [("KOLLSMAN_CACHE", "."), ("XDG_CACHE_HOME", "kollsman"), ("HOME", ".cache/kollsman")],
)
def test_the_cache_is_where_it_was_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, below: str
) -> None:
    for other in ("KOLLSMAN_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(other, raising=False)
    monkeypatch.setenv(name, str(tmp_path))
    assert cache_directory() == tmp_path / below


def test_the_hash_is_of_what_compiles() -> None:
    compiled = [
        path
        for path in PACKAGE.rglob("*.py")
        if "from companion.jit import step" in path.read_text("utf-8")
    ]
    assert {"atmosphere.py", "ring.py", "judging.py", "adaptive_fusion.py"} <= {
        path.name for path in compiled
    }
    assert len(source_hash()) == 16


FLIGHTS = {
    "short": Plan(duration_s=6.0, imu_hz=20.0, pressure_hz=5.0, gnss_hz=2.0, attitude_hz=5.0),
    "long": Plan(duration_s=60.0, imu_hz=25.0, pressure_hz=5.0, gnss_hz=2.0, attitude_hz=5.0),
}
"""Uncompiled steps take a thousand times as long."""
UNCOMPILED = """
import sys
import numpy as np
from companion.estimators import ESTIMATORS, run_log
from companion.samples import COMPILED
from tests.flights import flight
from tests.unit.companion.test_jit import FLIGHTS
assert not COMPILED
log = flight(FLIGHTS[sys.argv[2]]).log()
results = {}
for name, method in ESTIMATORS.items():
    estimates, verdicts, state = run_log(method, log)
    results |= {f"{name} estimates": np.frombuffer(np.array(estimates).tobytes(), np.uint8),
                f"{name} verdicts": np.array(verdicts),
                f"{name} state": np.frombuffer(state.tobytes(), np.uint8)}
np.savez(sys.argv[1], **results)
"""


@pytest.mark.parametrize("name", ["short", pytest.param("long", marks=pytest.mark.long)])
def test_compiled_and_uncompiled_agree_bit_for_bit(tmp_path: Path, name: str) -> None:
    """Every estimator over a synthetic flight: its start, or the first climb too."""
    path = tmp_path / "uncompiled.npz"
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", UNCOMPILED, str(path), name],
        env=environment,
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    uncompiled, log = np.load(path), flight(FLIGHTS[name]).log()
    for estimator, method in ESTIMATORS.items():
        estimates, verdicts, state = run_log(method, log)
        assert name == "short" or np.isfinite(estimates["altitude_amsl_m"][-1]), estimator
        assert verdicts.tolist() == uncompiled[f"{estimator} verdicts"].tolist(), estimator
        assert np.array(estimates).tobytes() == uncompiled[f"{estimator} estimates"].tobytes(), (
            estimator
        )
        assert state.tobytes() == uncompiled[f"{estimator} state"].tobytes(), estimator


def test_no_field_of_a_record_has_the_name_of_an_attribute() -> None:
    """Compiled, ``record.size`` is the field; uncompiled, it is NumPy's own attribute."""
    attributes = set(dir(np.record))
    for module in pkgutil.walk_packages(companion.__path__, "companion."):
        for name, value in vars(importlib.import_module(module.name)).items():
            if isinstance(value, np.dtype):
                hidden = attributes.intersection(value.names or ())
                assert not hidden, f"{module.name}.{name}: {hidden}"
