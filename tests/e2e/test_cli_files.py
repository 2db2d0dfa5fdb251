"""`kollsman check` of what is no configuration file: one line within two seconds. Output that
cannot be written: one line too."""

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from companion.errors import ConfigError
from companion.locations import assignments, config_path
from companion.settings import load_settings
from tests.paths import ROOT

LIMIT_S = 2.0


def refused(path: Path | str) -> str:
    started = time.monotonic()
    with pytest.raises(ConfigError) as error:
        load_settings(Path(path))
    assert time.monotonic() - started < LIMIT_S
    assert "\n" not in str(error.value)
    return str(error.value)


def test_endless_file() -> None:
    assert "longer than" in refused("/dev/zero")


def test_huge_file(tmp_path: Path) -> None:
    path = tmp_path / "huge.yaml"
    with path.open("wb") as file:
        file.truncate(3_000_000_000)
    assert "longer than" in refused(path)


@pytest.mark.parametrize("line", ["a: &a [x,x,x]\n", "- - - ", "key0: {a: 1}\n", "? "])
def test_long_yaml_is_read_in_time(tmp_path: Path, line: str) -> None:
    path = tmp_path / "long.yaml"
    path.write_text((line * 200_000)[:199_000])
    refused(path)


def test_repeated_anchors(tmp_path: Path) -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 30)]
    path = tmp_path / "bomb.yaml"
    path.write_text("\n".join(lines) + "\nestimator: *a29\n")
    refused(path)


def test_pipe_without_a_writer(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    assert "did not end" in refused(path)


def test_pipe_of_a_slow_writer_is_read(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)

    def write() -> None:
        with path.open("w") as pipe:
            pipe.write("publish: ")
            pipe.flush()
            time.sleep(0.1)
            pipe.write("{altitude_hz: 4}\n")

    writer = threading.Thread(target=write)
    writer.start()
    assert load_settings(path).publish.altitude_hz == 4
    writer.join()


def test_pipe_that_does_not_end(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    end = os.open(path, os.O_RDWR)
    os.write(end, b"publish:")
    assert "did not end" in refused(path)
    os.close(end)


def test_full_disk_behind_a_listing() -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "companion.cli", "check", "--keys"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            check=False,
        )
    assert done.returncode == 1
    assert done.stderr.startswith("kollsman: the output cannot be written: No space")
    assert done.stderr.count("\n") == 1


def test_places_of_the_configuration(tmp_path: Path) -> None:
    assert config_path({"KOLLSMAN_CONFIG": "/nowhere.yaml"}) == Path("/nowhere.yaml")
    assert config_path({"XDG_CONFIG_HOME": str(tmp_path)}) is None
    (tmp_path / "kollsman").mkdir()
    own = tmp_path / "kollsman" / "companion.yaml"
    own.write_text("")
    assert config_path({"XDG_CONFIG_HOME": str(tmp_path)}) == own


def test_variables_are_assignments() -> None:
    variables = {
        "KOLLSMAN_PUBLISH__ALTITUDE_HZ": "5",
        "KOLLSMAN_ESTIMATORS__VERTICAL_BANK__OFFSET_SD_M": "4",
        "KOLLSMAN_CACHE": "/tmp",
        "HOME": "/root",
    }
    assert assignments(variables) == [
        "estimators.vertical-bank.offset_sd_m=4",
        "publish.altitude_hz=5",
    ]
    settings = load_settings().with_assignments(assignments(variables))
    assert settings.publish.altitude_hz == 5
