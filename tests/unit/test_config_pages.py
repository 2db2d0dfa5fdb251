"""The configuration's page and example follow the code."""

from pathlib import Path

import pytest

from companion import cli
from companion.config import keys
from companion.settings import CompanionSettings, load_settings

CONFIG = Path(__file__).parents[2] / "config"


def test_every_key_says_what_it_means() -> None:
    silent = [key for key, _, _, _, meaning in keys(CompanionSettings) if not meaning]
    assert not silent


def test_page_is_what_the_command_prints() -> None:
    page = (CONFIG / "README.md").read_text(encoding="utf-8")
    assert cli._keys_table() in page, "run `make config-page`"


@pytest.mark.parametrize("path", sorted(CONFIG.glob("*.yaml")), ids=lambda path: path.name)
def test_examples_are_valid(path: Path) -> None:
    load_settings(path)
