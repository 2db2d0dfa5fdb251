"""What the modules of the command line share: options, and the configuration that they resolve
to."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.errors import ConfigError

if TYPE_CHECKING:
    from companion.settings import CompanionSettings

EstimatorOption = Annotated[
    str | None,
    typer.Option(help="Estimator; replaces the one of the configuration.", metavar="NAME"),
]
ConfigOption = Annotated[
    Path | None,
    typer.Option(
        help="A companion.yaml; every key is optional. Default: KOLLSMAN_CONFIG, "
        "~/.config/kollsman/companion.yaml, /etc/kollsman/companion.yaml.",
        metavar="FILE",
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Set a key of the configuration for this run; repeatable.",
        metavar="SECTION.KEY=VALUE",
    ),
]


def resolve_settings(
    config: Path | None, estimator: str | None, changes: list[str] | None = None
) -> "CompanionSettings":
    """The configuration of a command.

    Later ones replace earlier ones: defaults, the file, variables ``KOLLSMAN_SECTION__KEY``, option
    ``--estimator``, options ``--set``. Raises `ConfigError`.
    """
    from companion import locations
    from companion.estimators import ESTIMATORS
    from companion.settings import load_settings

    if estimator is not None and estimator not in ESTIMATORS:
        raise ConfigError(
            f"no estimator is called {estimator!r}; there are: {', '.join(ESTIMATORS)}"
        )
    settings = load_settings(config or locations.config_path())
    try:
        settings = settings.with_assignments(locations.assignments())
    except ConfigError as error:
        named = str(error).replace("--set", "environment variable KOLLSMAN_...:")
        raise ConfigError(named) from None
    if estimator is not None:
        settings = settings.with_changes(estimator=estimator)
    return settings.with_assignments(changes or [])


def say_if_compiling(*estimators: str) -> None:
    """Announce that the start will take long, where it will."""
    from companion.estimators import ESTIMATORS
    from companion.jit import is_warm

    if not all(is_warm(ESTIMATORS[name].run) for name in estimators or ESTIMATORS):
        print(
            "compiling the estimators (first run after an installation, about half a minute)...",
            file=sys.stderr,
        )
