"""Presets are three layers, given keys, preset, defaults, for every way of giving them."""

from pathlib import Path
from typing import Any

import pytest

from companion.estimators import ESTIMATORS
from companion.settings import CompanionSettings, load_settings

CASES = [
    (name, preset)
    for name, method in ESTIMATORS.items()
    for preset in getattr(method.settings, "PRESETS", {})
]


def in_yaml(path: Path, name: str, keys: dict[str, Any]) -> CompanionSettings:
    lines = "".join(f"    {key}: {value}\n" for key, value in keys.items())
    path.write_text(f"estimators:\n  {name}:\n{lines}")
    return load_settings(path)


def assigned(settings: CompanionSettings, name: str, keys: dict[str, Any]) -> CompanionSettings:
    return settings.with_assignments([f"estimators.{name}.{k}={v}" for k, v in keys.items()])


def test_there_are_presets() -> None:
    assert {name for name, _ in CASES} == {"air-data-gnss", "robust-altimeter"}


@pytest.mark.parametrize(("name", "preset"), CASES)
def test_every_way_gives_the_same(name: str, preset: str, tmp_path: Path) -> None:
    """A file, --set, the model itself, and a change of something else afterwards."""
    method = ESTIMATORS[name]
    expected = method.settings.model_validate({"preset": preset})
    bare = CompanionSettings()
    ways = [
        in_yaml(tmp_path / "a.yaml", name, {"preset": preset}),
        assigned(bare, name, {"preset": preset}),
        assigned(bare, name, {"preset": preset}).with_changes(estimator=name),
        assigned(bare.with_changes(estimator=name), name, {"preset": preset}),
        assigned(assigned(bare, name, {"preset": preset}), "adaptive-fusion", {"gain": "fixed"}),
    ]
    for way in ways:
        assert way.section(name) == expected
        assert way.section(name).params().tobytes() == expected.params().tobytes()  # type: ignore[attr-defined]
    assert expected.params().tobytes() != method.settings().params().tobytes()  # type: ignore[attr-defined]


@pytest.mark.parametrize(("name", "preset"), CASES)
def test_given_keys_count_more_and_the_way_back_is_open(
    name: str, preset: str, tmp_path: Path
) -> None:
    method = ESTIMATORS[name]
    presets: dict[str, Any] = method.settings.PRESETS[preset]  # type: ignore[attr-defined]
    key, value = next((k, v) for k, v in presets.items() if isinstance(v, float))
    chosen = in_yaml(tmp_path / "a.yaml", name, {"preset": preset, key: value * 0.5})
    assert getattr(chosen.section(name), key) == value * 0.5
    back = assigned(chosen, name, {"preset": "tuned"})
    assert getattr(back.section(name), key) == value * 0.5, "a key that was given stays"
    plain = assigned(
        assigned(CompanionSettings(), name, {"preset": preset}), name, {"preset": "tuned"}
    )
    assert plain.section(name) == method.settings()
