"""`kollsman tune --estimator damping-loop` as a user types it."""

import sys
from pathlib import Path

import pytest

from companion import cli
from companion.settings import load_settings
from tests.paths import DATA

REAL = DATA / "real"


def call(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *arguments: object
) -> tuple[int, str]:
    """Exit code, and what was printed anywhere."""
    monkeypatch.setattr(sys, "argv", ["kollsman", *map(str, arguments)])
    try:
        cli.main()
        code = 0
    except SystemExit as stop:
        code = int(stop.code or 0)
    return code, "".join(capsys.readouterr())


def test_finds_gains_that_can_be_configured(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    short_hop: Path,
    tmp_path: Path,
) -> None:
    gains = tmp_path / "gains.yaml"
    code, out = call(
        capsys,
        monkeypatch,
        "tune",
        short_hop,
        "--estimator",
        "damping-loop",
        "--generations",
        "10",
        "--out",
        gains,
    )
    assert code == 0
    for label in (
        "K1",
        "K2",
        "K3",
        "cost",
        "damping",
        "poles",
        "found",
        "the paper's",
        "slopes of GNSS height",
    ):
        assert label in out
    settings = load_settings(gains)
    assert settings.estimator == "damping-loop"
    assert gains.read_text() in out
    again = call(
        capsys, monkeypatch, "tune", short_hop, "--estimator", "damping-loop", "--generations", 10
    )[1]
    assert gains.read_text() in again  # the same seed


@pytest.mark.parametrize(
    "arguments",
    [
        ("x.tlog", "--estimator", "robust-altimeter"),
        ("no-such.tlog", "--estimator", "damping-loop"),
    ],
)
def test_a_mistake_is_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    code, out = call(capsys, monkeypatch, "tune", *arguments)
    assert code == 1
    assert len(out.strip().splitlines()) == 1


@pytest.mark.skipif(not REAL.exists(), reason="the recorded logs are not here")
def test_a_slow_imu_cannot_serve(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    code, out = call(
        capsys,
        monkeypatch,
        "tune",
        REAL / "bruno_20211202-132614.tlog",
        "--estimator",
        "damping-loop",
    )
    assert code == 1
    assert "slower than 10 Hz" in out
