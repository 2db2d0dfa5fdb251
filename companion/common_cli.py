"""Options that the modules of the command line share, and the configuration that they give."""

import logging
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from companion.errors import ConfigError
from companion.output import Output, set_up_logging

if TYPE_CHECKING:
    from companion.settings import CompanionSettings
    from companion.terminal import Starting

logger = logging.getLogger("kollsman.start")

SAYING = ("-q", "--quiet", "-v", "-vv", "--verbose")
LIBRARIES = ("numba", "asyncio", "matplotlib", "PIL", "distributed")
VerboseOption = Annotated[
    int,
    typer.Option(
        "--verbose",
        "-v",
        count=True,
        show_default=False,
        help="Log in more detail; -vv: the libraries too.",
    ),
]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Show only warnings and errors.")]

LinkArgument = Annotated[
    str,
    typer.Argument(
        help="Where the autopilot is; `kollsman links` lists the forms.", envvar="KOLLSMAN_LINK"
    ),
]
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


def read_speed(text: str) -> float | None:
    """A factor of real time; None is as fast as possible. Raises ValueError."""
    if text == "max":
        return None
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.01 <= value <= 1000.0:
        raise ValueError(f"{text!r} is not valid: give max, or a number from 0.01 to 1000")
    return value


def version_option(program: str) -> Any:
    """The option ``--version`` of a program."""

    def show(wanted: bool) -> None:
        if wanted:
            from companion import __version__

            sys.stdout.write(f"{program} {__version__}\n")
            raise typer.Exit

    return typer.Option("--version", callback=show, is_eager=True, help="Show version and exit.")


class Commands(TyperGroup):
    """The commands of a program: their help is not cut, and the options about how much is said may
    stand before or after a command."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        found = ((name, self.get_command(ctx, name)) for name in self.list_commands(ctx))
        rows = [
            (name, command.get_short_help_str(limit=10_000))
            for name, command in found
            if command is not None and not command.hidden
        ]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        end = args.index("--") if "--" in args else len(args)
        first = sorted(args[:end], key=lambda each: each not in SAYING)  # in order otherwise
        return super().parse_args(ctx, first + args[end:])


def set_up_saying(verbose: int, *, quiet: bool) -> None:
    """Say as much as the options want: ``-q`` warnings and errors, ``-v`` all of ours, ``-vv`` all
    of the libraries' too."""
    level = logging.WARNING if quiet else logging.DEBUG if verbose else logging.INFO
    set_up_logging(level)
    for name in LIBRARIES:
        logging.getLogger(name).setLevel(logging.NOTSET if verbose > 1 else logging.WARNING)


def is_quiet() -> bool:
    """Whether only warnings and errors are wanted."""
    return logging.getLogger().level >= logging.WARNING


def compile_for(
    settings: "CompanionSettings", estimators: Iterable[str], shown: "Starting | None" = None
) -> None:
    """Load the code of `estimators`, and compile what the cache does not have.

    `shown` shows how far it is; without one, log lines tell it.
    """
    from companion.estimators import ESTIMATORS
    from companion.jit import compiled_functions, is_warm
    from companion.warmup import COMPILING, warm_up

    started_s = time.monotonic()
    names = list(estimators)
    is_cold = not all(is_warm(ESTIMATORS[name].run) for name in names)
    if shown is not None:
        shown.compiled = compiled_functions
    elif is_cold:
        logger.info("%s ...", COMPILING)
    for name in names:
        warm_up(settings.with_changes(estimator=name))
    if is_cold and shown is None:
        logger.info("compiled in %.0f s", time.monotonic() - started_s)


def compile_first(settings: "CompanionSettings", *estimators: str) -> None:
    """Compile for a command that is about to take logs, where the cache is empty."""
    from companion.estimators import ESTIMATORS
    from companion.jit import is_warm
    from companion.replay.block_steps import follow
    from companion.warmup import warm_up_blocks

    cold = [name for name in estimators if not is_warm(ESTIMATORS[name].run)]
    if cold or not is_warm(follow):
        from companion.terminal import starting

        with starting(Output(2)) as shown:
            compile_for(settings, cold, shown)
            warm_up_blocks()
