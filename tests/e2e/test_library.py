"""Kollsman as a library, an estimator from another package, and a package that hides ours."""

import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

import companion
import companion.api
from companion.errors import ConfigError
from companion.samples import Kind
from tests import logfiles
from tests.paths import ROOT

EXAMPLE = re.findall(
    r"```python\n(\"\"\"mean_offset.*?)```",
    (ROOT / "docs/estimators.md").read_text(encoding="utf-8"),
    re.DOTALL,
)[0]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return logfiles.write("tlog", tmp_path, imu_hz=0.0, duration_s=100.0)[0]


def python(*arguments: object, path: Path) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=path if path.is_dir() else ROOT,
        env=os.environ | {"PYTHONPATH": f"{path}{os.pathsep}{ROOT}"},
        check=False,
    )


def test_a_log_as_arrays(log: Path) -> None:
    (flight,) = companion.read_log(log)
    found = companion.run_estimator(flight, "adaptive-fusion", baro_variance_m2=100.0)
    assert flight.vehicle == (7, 1)
    assert found.altitude_m.shape == found.sd_m.shape == flight.table(Kind.PRESSURE).shape
    late = found.time_us > found.time_us[0] + 20_000_000
    truth_m = np.interp(found.time_us, flight.truth["time_us"], flight.truth["altitude_amsl_m"])
    assert np.abs(found.altitude_m - truth_m)[late].max() < 8.0
    assert "adaptive-fusion" in companion.estimator_names()
    with pytest.raises(ConfigError, match="no estimator"):
        companion.run_estimator(flight, "none")
    with pytest.raises(ConfigError):
        companion.run_estimator(flight, "adaptive-fusion", no_such_key=1)


@pytest.mark.parametrize(
    "text",
    [
        re.findall(
            r"```python\n(import companion\n.*?)```",
            (ROOT / "docs/estimators.md").read_text(encoding="utf-8"),
            re.DOTALL,
        )[0],
        textwrap.dedent((companion.api.__doc__ or "").split("::\n")[1].split("Everything")[0]),
    ],
    ids=["docs/estimators.md", "companion/api.py"],
)
def test_the_examples_of_the_library_run_as_written(
    text: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Word for word, beside a log of the name that they read."""
    path, _ = logfiles.write("bin", tmp_path, imu_hz=0.0, duration_s=40.0)
    path.rename(tmp_path / "flight.BIN")
    monkeypatch.chdir(tmp_path)
    exec(compile(text, "example", "exec"), {})
    assert capsys.readouterr().out.startswith("(7, 1) [")


def test_the_example_of_the_docs_is_an_estimator_by_its_entry_point(
    log: Path, tmp_path: Path
) -> None:
    assert len([line for line in EXAMPLE.splitlines() if line]) <= 50
    (tmp_path / "mean_offset.py").write_text(EXAMPLE)
    (tmp_path / "broken.py").write_text("raise RuntimeError('no such sensor')\n")
    meta = tmp_path / "mean_offset-1.0.dist-info"
    meta.mkdir()
    (meta / "METADATA").write_text("Metadata-Version: 2.1\nName: mean-offset\nVersion: 1.0\n")
    (meta / "entry_points.txt").write_text(
        "[kollsman.estimators]\nmean-offset = mean_offset:METHOD\nbroken = broken:METHOD\n"
    )
    done = python(
        *("-m", "companion.cli", "compare", log, "--json", "--settle", "20"),
        *("--estimator", "mean-offset"),
        path=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)["sessions"][0]["results"][0]
    assert result["label"] == "mean-offset"
    assert result["rmse_m"] < 5.0
    done_wrong = python(
        *("-m", "companion.cli", "compare", log, "--estimator", "mean-offset"),
        *("--expect", "max<0.001", "--junit", tmp_path / "out.xml"),
        path=tmp_path,
    )
    assert done_wrong.returncode == 3
    assert "mean-offset: max<0.001 NOT met" in done_wrong.stderr
    assert 'failures="1"' in (tmp_path / "out.xml").read_text()
    assert "broken:METHOD cannot be loaded: no such sensor" in done.stderr


def test_another_package_of_our_name_is_told_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "companion").mkdir()
    (tmp_path / "companion" / "__init__.py").write_text("")
    for command in ("companion", "sim"):
        done = python("-c", f"import kollsman; kollsman.{command}()", path=tmp_path)
        assert done.returncode == 1
        assert done.stderr.count("\n") == 1
        assert f"another package called 'companion', at {tmp_path}" in done.stderr
    done = python(
        "-c",
        "import sys; sys.argv = ['kollsman', '--version']; import kollsman; kollsman.companion()",
        path=tmp_path / "nowhere",
    )
    assert done.stdout.startswith("kollsman ")


@pytest.mark.parametrize("package", ["companion", "sim"])
def test_an_editable_installation_has_the_start_of_the_commands_elsewhere(
    package: str, tmp_path: Path
) -> None:
    """`pip install -e` copies kollsman.py into the environment and leaves the packages here."""
    shutil.copy(ROOT / "kollsman.py", tmp_path)
    code = f"import kollsman; kollsman._refuse_other({package!r}, 'kollsman')"
    done = subprocess.run(
        [sys.executable, "-c", code],
        check=False,
        env=os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stderr) == (0, "")
