"""The pages of keys and the examples follow the code."""

from pathlib import Path

import pytest

from companion import cli
from companion.config.fields import keys
from companion.settings import CompanionSettings, load_settings
from sim.faults import FAULTS
from sim.scenario_keys import page
from sim.sensors.barometer import PRESETS as BAROMETERS
from sim.sensors.gnss import PRESETS as RECEIVERS
from sim.sensors.imu import PRESETS as IMUS
from tests.paths import ROOT

CONFIG = ROOT / "config"


def test_every_key_says_what_it_means() -> None:
    silent = [key for key, _, _, _, meaning in keys(CompanionSettings) if not meaning]
    assert not silent


def test_every_key_of_a_scenario_says_what_it_means() -> None:
    rows = [line.split(" | ") for line in page().splitlines() if line.startswith("| `")]
    assert len(rows) > 200
    assert [cells[0] for cells in rows if not cells[-1].strip(" |")] == []


def test_every_description_names_its_quantity_first() -> None:
    """A description can be read alone: it does not begin in the middle of a sentence."""
    fragments = {
        "and",
        "how",
        "it",
        "its",
        "less",
        "more",
        "of",
        "such",
        "that",
        "this",
        "...",
    }
    of_the_service = [(key, meaning) for key, _, _, _, meaning in keys(CompanionSettings)]
    rows = [line.split(" | ") for line in page().splitlines() if line.startswith("| `")]
    of_scenarios = [(cells[0], cells[-1].strip(" |")) for cells in rows]
    for key, meaning in of_the_service + of_scenarios:
        assert meaning.split()[0].lower() not in fragments, f"{key}: {meaning}"
        assert meaning.count("...") == 0, f"{key}: {meaning}"


def test_what_is_per_kelvin_is_no_kelvin() -> None:
    units = {
        cells[0][3:-1]: cells[2]
        for line in page().splitlines()
        if len(cells := line.split(" | ")) > 4
    }
    for name, unit in (
        ("thermal_pa_per_k", "Pa/K"),
        ("acceleration_pa_per_g", "Pa/g"),
        ("lag_s", "s"),
    ):
        assert units[f"sensors.barometer.{name}"] == unit
    assert units["weather.gradient.hpa_per_100km"] == "hPa/100 km"


def test_page_is_what_the_command_prints() -> None:
    page = (CONFIG / "README.md").read_text(encoding="utf-8")
    assert cli._keys_table() in page, "run `make config-page`"


def test_the_scenarios_page_is_what_the_command_prints() -> None:
    assert (CONFIG / "scenarios" / "README.md").read_text(encoding="utf-8") == page(), (
        "run `make config-page`"
    )


def test_the_scenarios_page_has_every_leg_fault_and_preset() -> None:
    text = page()
    for name in (*FAULTS, *BAROMETERS, *RECEIVERS, *IMUS):
        assert f"`{name}`" in text
    for line in (
        "| `weather.pressure[].sea_level_hpa` | **required** | hPa | from 850 to 1100 |",
        "### `take_off`",
    ):
        assert line in text


@pytest.mark.parametrize("path", sorted(CONFIG.glob("*.yaml")), ids=lambda path: path.name)
def test_examples_are_valid(path: Path) -> None:
    load_settings(path)
