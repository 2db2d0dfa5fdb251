"""What the README tells to type exists: commands, and the options named with them."""

import re

import pytest
import typer

from companion.cli import app
from sim.cli import app as sim_app
from tests.paths import ROOT

LINES = [
    line.split("#")[0].strip()
    for line in (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    if re.match(r" {4}kollsman(-sim)? [a-z]", line)
]


@pytest.mark.parametrize("line", LINES)
def test_a_command_of_the_readme_exists(line: str) -> None:
    program, rest = line.split(maxsplit=1)
    command = typer.main.get_command(sim_app if program == "kollsman-sim" else app)
    known = getattr(command, "commands", {})
    names = re.findall(r"^[a-z-]+|(?<=\| )[a-z-]+(?= |$)(?! ?\.)", rest.split("[")[0])
    for name in names:
        options = {option for each in known[name].params for option in each.opts}
        for option in re.findall(r"--[a-z-]+", rest):
            assert option in options, f"{name} has no {option}"


def test_every_column_of_rows_and_fleet_is_documented() -> None:
    from companion.replay.batch import FLEET_COLUMNS
    from companion.replay.schema import SESSION_KEYS
    from companion.replay.table import ESTIMATE_COLUMNS

    page = (ROOT / "docs" / "report-schema.md").read_text(encoding="utf-8")
    rows = (ROOT / "companion" / "replay" / "table.py").read_text(encoding="utf-8")
    named = {
        *ESTIMATE_COLUMNS,
        *FLEET_COLUMNS,
        *SESSION_KEYS,
        *re.findall(r'^ +"(\w+)":', rows, re.M),
    }
    assert [name for name in sorted(named) if f"`{name}`" not in page] == []
