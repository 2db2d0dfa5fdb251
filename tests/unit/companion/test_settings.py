"""companion.yaml as a whole: the resolved configuration, the estimators' sections, options over
files."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import BaseModel

from companion.config import dump
from companion.config.fields import unit_of
from companion.errors import ConfigError
from companion.estimators import DEFAULT_ESTIMATOR, ESTIMATORS
from companion.settings import CompanionSettings, load_settings


def write(folder: Path, text: str) -> Path:
    path = folder / "companion.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def leaves(model: BaseModel, prefix: str = "") -> list[tuple[str, Any]]:
    """(dotted key, field) of every value."""
    found: list[tuple[str, Any]] = []
    for name, info in type(model).model_fields.items():
        value = getattr(model, name)
        key = f"{prefix}{info.alias or name}"
        found += leaves(value, f"{key}.") if isinstance(value, BaseModel) else [(key, info)]
    return found


def test_no_file_and_an_empty_file_are_the_defaults(tmp_path: Path) -> None:
    assert load_settings() == CompanionSettings()
    assert load_settings(write(tmp_path, "")) == CompanionSettings()
    assert CompanionSettings().estimator == DEFAULT_ESTIMATOR


def test_the_resolved_configuration_reads_back_as_itself(tmp_path: Path) -> None:
    text = (
        "estimator: adaptive-fusion\nvehicle: {system_id: 7}\npublish: {altitude: always, "
        "altitude_hz: 25}\n"
    )
    settings = load_settings(write(tmp_path, text))
    assert settings.vehicle.system_id == 7
    assert load_settings(write(tmp_path, dump(settings))) == settings
    assert yaml.safe_load(dump(settings))["publish"]["altitude_hz"] == 25


def test_the_resolved_configuration_shows_every_key() -> None:
    resolved = yaml.safe_load(dump(CompanionSettings()))
    for key, _ in leaves(CompanionSettings()):
        node = resolved
        for part in key.split("."):
            assert part in node, key
            node = node[part]


@pytest.mark.parametrize("name", ESTIMATORS)
def test_every_estimator_has_a_section_and_its_parameters(tmp_path: Path, name: str) -> None:
    settings = load_settings(write(tmp_path, f"estimator: {name}\nestimators:\n  {name}: {{}}\n"))
    section = settings.section(name)
    assert type(section) is ESTIMATORS[name].settings
    assert section == ESTIMATORS[name].settings()
    assert section.params().size == 1  # type: ignore[attr-defined]


def test_a_mistake_in_an_estimators_section_is_placed(tmp_path: Path) -> None:
    path = write(tmp_path, "estimators:\n  adaptive-fusion:\n    baro_variance_m2: -1\n")
    with pytest.raises(ConfigError) as failure:
        load_settings(path)
    said = (
        "estimators.adaptive-fusion.baro_variance_m2: -1 is out of range; give a number above "
        "0, at most 1e+06 (m2)"
    )
    assert str(failure.value) == f"{path}:3: {said}"


@pytest.mark.parametrize("value", ["-4", "0", "much"])
def test_a_claimed_variance_or_a_positive_one(tmp_path: Path, value: str) -> None:
    path = write(tmp_path, f"estimators:\n  adaptive-fusion:\n    gnss_variance_m2: {value}\n")
    with pytest.raises(
        ConfigError,
        match=r"gnss_variance_m2: .* is neither a number above 0, .* nor 'claimed' \(m2\)",
    ):
        load_settings(path)


def test_an_unknown_estimator_names_those_there_are(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r":1: estimator: 'kalman': .*adaptive-fusion"):
        load_settings(write(tmp_path, "estimator: kalman\n"))


def test_options_win_over_the_file_and_none_leaves_it(tmp_path: Path) -> None:
    path = write(tmp_path, "identity: {component_id: 42}\npublish: {debug: no}\n")
    settings = load_settings(path, estimator=None, identity={"component_id": 77})
    assert settings.identity.component_id == 77
    assert settings.publish.debug is False
    assert settings.estimator == DEFAULT_ESTIMATOR


def test_a_bad_option_is_one_line_too() -> None:
    with pytest.raises(
        ConfigError, match=r"^options: identity\.component_id: 300 is out of range.* from 1 to 255$"
    ):
        CompanionSettings().with_changes(identity={"component_id": 300})


def test_every_number_has_a_range() -> None:
    """A value without bounds is a value that nobody thought about."""
    for key, info in leaves(CompanionSettings()):
        if info.annotation in (int, float, int | None, float | None):
            assert any(hasattr(item, "ge") or hasattr(item, "gt") for item in info.metadata), key


def test_every_quantity_names_its_unit() -> None:
    """The suffix of a key is its unit; what has none is a share, or a number that a paper gives
    without one."""
    shares = {"ratio", "factor", "probability", "gain", "rate", "second"}
    papers = {"scale_sd", "k1", "k2", "k3"}
    for key, info in leaves(CompanionSettings()):
        if info.annotation is float and not unit_of(key):
            assert key.rsplit("_", 1)[-1] in shares or key.rsplit(".", 1)[-1] in papers, key


class TestAssignments:
    def test_a_value_of_any_section_is_replaced(self) -> None:
        changed = CompanionSettings().with_assignments(
            [
                "estimators.vertical-bank.rate_sd_mps=[0, 0, 0]",
                "publish.altitude=always",
                "estimator=vertical-bank",
            ]
        )
        assert changed.section("vertical-bank").model_dump()["rate_sd_mps"] == (0.0, 0.0, 0.0)
        assert (changed.publish.altitude, changed.estimator) == ("always", "vertical-bank")
        assert CompanionSettings().with_assignments([]) == CompanionSettings()

    @pytest.mark.parametrize(
        ("text", "said"),
        [
            ("publish.altitude", "give SECTION.KEY=VALUE"),
            ("publsh.altitude=always", "no such section"),
            ("estimator.x.y=1", "no such section"),
            ("publish.altitude_hz=500", "publish.altitude_hz: 500 is out of range"),
            ("publish.altitud=1", "unknown key; did you mean `altitude`"),
            ("publish.altitude=[", "neither a number, a text nor a list"),
        ],
    )
    def test_a_mistake_is_one_line(self, text: str, said: str) -> None:
        with pytest.raises(ConfigError, match=re.escape(said)) as failure:
            CompanionSettings().with_assignments([text])
        assert "\n" not in str(failure.value)
