"""Help, version, verbosity and completion of both commands."""

import logging
from collections.abc import Iterator

import pytest
import typer
from typer.testing import CliRunner

from companion import __version__
from companion.cli import app as kollsman
from companion.common_cli import LIBRARIES
from sim.cli import app as kollsman_sim

APPS = {"kollsman": kollsman, "kollsman-sim": kollsman_sim}


@pytest.fixture
def levels() -> Iterator[None]:
    """Puts the levels and handlers of logging back."""
    root = logging.getLogger()
    before = {name: logging.getLogger(name).level for name in LIBRARIES}
    level, handlers = root.level, root.handlers.copy()
    yield
    root.setLevel(level)
    root.handlers = handlers
    for name, each in before.items():
        logging.getLogger(name).setLevel(each)


def run(app: typer.Typer, *arguments: str, **environment: str) -> str:
    result = CliRunner().invoke(app, list(arguments), env={"COLUMNS": "80", **environment})
    assert result.exit_code == 0, result.output
    return str(result.output)


@pytest.mark.parametrize("name", APPS)
@pytest.mark.parametrize("columns", ["60", "80"])
def test_help_cuts_no_description(name: str, columns: str) -> None:
    app = APPS[name]
    text = " ".join(run(app, "--help", COLUMNS=columns).split())
    assert "..." not in text.replace("[ARGS]...", "")
    for command in typer.main.get_command(app).commands.values():  # type: ignore[attr-defined]
        sentence = " ".join(command.help.split("\n\n")[0].split())
        assert sentence.split(". ")[0].rstrip(".") in text


@pytest.mark.parametrize("name", APPS)
def test_both_commands_tell_their_version(name: str) -> None:
    assert run(APPS[name], "--version") == f"{name} {__version__}\n"


@pytest.mark.parametrize("name", APPS)
def test_shells_complete_commands(name: str) -> None:
    variable = f"_{name.upper().replace('-', '_')}_COMPLETE"
    for shell in ("bash", "zsh", "fish"):
        assert name in run(APPS[name], **{variable: f"source_{shell}"})
    words = {"COMP_WORDS": f"{name} l", "COMP_CWORD": "1"}
    found = run(APPS[name], **{variable: "complete_bash"}, **words).split()
    assert found == {"kollsman": ["links"], "kollsman-sim": ["list", "limits"]}[name]


@pytest.mark.usefixtures("levels")
@pytest.mark.parametrize(
    ("arguments", "root", "library"),
    [
        (["links"], logging.INFO, logging.WARNING),
        (["-q", "links"], logging.WARNING, logging.WARNING),
        (["links", "-q"], logging.WARNING, logging.WARNING),
        (["-v", "links"], logging.DEBUG, logging.WARNING),
        (["links", "-vv"], logging.DEBUG, logging.NOTSET),
        (["links", "--verbose", "-v"], logging.DEBUG, logging.NOTSET),
    ],
)
def test_how_much_is_said(arguments: list[str], root: int, library: int) -> None:
    run(kollsman, *arguments)
    assert logging.getLogger().level == root
    assert logging.getLogger("numba").level == library
