"""Noise parameters by maximum likelihood, against flights whose noise is known."""

import math
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from companion import cli
from companion.config import Settings
from companion.errors import ConfigError, LogFormatError
from companion.estimators import ESTIMATORS
from companion.evaluation import noise_search, tuning
from companion.settings import CompanionSettings, load_settings
from tests import logfiles


def test_finds_the_noise_that_the_logs_have(tmp_path: Path) -> None:
    logs = []
    for seed in (1, 2):
        path, _ = logfiles.write(
            "tlog", tmp_path, seed=seed, pressure_sd_pa=12.0, imu_hz=20.0, duration_s=150.0
        )
        logs.append(path.rename(tmp_path / f"{seed}.tlog"))
    keys = ("baro_sd_m", "unknown_acceleration_mps2_rthz")
    method = ESTIMATORS["baro-ins-kf"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(
            ESTIMATORS,
            "baro-ins-kf",
            type(method)(**{**vars(method), "tunable": keys}),
        )
        found = tuning.tune(logs, "baro-ins-kf")
    (change,) = found.changes
    metres = 12.0 / (1.2 * 9.81)  # at 300 m the air weighs 1.19 kg/m3
    assert change.key == "baro_sd_m"
    assert change.after == pytest.approx(metres, rel=0.1)
    assert list(found.kept) == ["unknown_acceleration_mps2_rthz"]  # there is an IMU throughout
    assert found.held_out[1] > found.held_out[0]
    (tmp_path / "tuned.yaml").write_text(found.snippet())
    settings = load_settings(tmp_path / "tuned.yaml")
    assert settings.section("baro-ins-kf").model_dump()["baro_sd_m"] == pytest.approx(
        change.after, rel=1e-3
    )


class Keys(Settings):
    one: float = 1.0
    other: float = 1.0
    third: float = 1.0


class Parabola:
    """A likelihood of two keys that only matter in the sum of their logarithms, and of a third."""

    keys = ("one", "other", "third")

    def __init__(self) -> None:
        self.section = Keys()

    def of(self, values: Mapping[str, float], part: object) -> tuple[float, float]:
        one, other, third = (
            math.log(values.get(key, getattr(self.section, key))) for key in self.keys
        )
        return -50.0 * (one + other - 1.0) ** 2 - 80.0 * (third + 1.0) ** 2, 1000.0


def test_of_two_keys_that_can_be_traded_one_is_moved() -> None:
    """Expected Result: the third is found with its spread, and one of the two keeps its value."""
    found = noise_search.observable(Parabola(), [object()])  # type: ignore[arg-type, list-item]
    assert found.values["third"] == pytest.approx(math.exp(-1.0), rel=0.05)  # forward differences
    assert found.factor_sd["third"] == pytest.approx(math.exp(1.0 / math.sqrt(160.0)), rel=0.05)
    assert len(found.values) == 2
    (kept,) = found.kept.items()
    assert kept[0] in ("one", "other")


def test_what_cannot_be_tuned_is_refused_with_a_reason(tmp_path: Path) -> None:
    path, _ = logfiles.write("tlog", tmp_path, duration_s=70.0, gnss_hz=1.0, imu_hz=0.0)
    with pytest.raises(ConfigError, match="no noise parameters"):
        tuning.tune([path], "robust-altimeter")
    with pytest.raises(LogFormatError, match="fewer than 100 innovations"):
        tuning.tune([path], "adaptive-fusion", CompanionSettings())


def test_the_older_form_says_the_new_one(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["kollsman", "tune", "damping-loop", "x.tlog"])
    with pytest.raises(SystemExit):
        cli.main()
    assert "--estimator damping-loop" in capsys.readouterr().err
