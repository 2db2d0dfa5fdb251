"""The command ``kollsman``. The only module of the companion that prints.

What is heavy (Numba, NumPy, pymavlink) is imported by the commands, so that ``--help`` is instant.
"""

import errno
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from companion import batch_cli, doctor_cli, live_cli, log_cli, tune_cli
from companion.common_cli import (
    Commands,
    QuietOption,
    VerboseOption,
    compile_for,
    resolve_settings,
    set_up_saying,
    version_option,
)
from companion.errors import KollsmanError
from companion.output import (
    Output,
    discard_standard_output,
    open_standard_descriptors,
)

OUTPUT_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EBADF}
"""What writing to standard output fails with: a full disk, a terminal that hung up."""

app = typer.Typer(
    name="kollsman",
    cls=Commands,
    help="Estimate the true altitude of a MAVLink vehicle from barometer, GNSS and inertial "
    "sensors.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

KEY_EXAMPLES = """\b
Examples:
  kollsman key ~/.config/kollsman/signing.key
  kollsman run /dev/ttyAMA0:921600 --set signing.key_file=~/.config/kollsman/signing.key
"""


@app.callback()
def _options(
    *,
    verbose: VerboseOption = 0,
    quiet: QuietOption = False,
    version: Annotated[bool, version_option("kollsman")] = False,
) -> None:
    set_up_saying(verbose, quiet=quiet)


app.command(epilog=live_cli.RUN_EXAMPLES)(live_cli.run)
app.command(epilog=doctor_cli.DOCTOR_EXAMPLES)(doctor_cli.doctor)


app.command(epilog=log_cli.REPLAY_EXAMPLES)(log_cli.replay)
app.command(epilog=log_cli.COMPARE_EXAMPLES)(log_cli.compare)
app.command(epilog=batch_cli.BATCH_EXAMPLES)(batch_cli.batch)


app.command(epilog=tune_cli.TUNE_EXAMPLES)(tune_cli.tune)
app.command(epilog=tune_cli.IDENTIFY_EXAMPLES)(tune_cli.identify)


@app.command()
def check(
    config: Annotated[
        Path | None, typer.Argument(help="A companion.yaml; without one, the defaults.")
    ] = None,
    *,
    keys: Annotated[
        bool, typer.Option("--keys", help="List every key as a Markdown table instead.")
    ] = False,
) -> None:
    """Validate a configuration file and print the resolved configuration."""
    if keys:
        print(_keys_table(), end="")
        return
    from companion.config import dump

    print(dump(resolve_settings(config, None)), end="")


def _keys_table() -> str:
    from companion.config.fields import keys as every_key
    from companion.settings import CompanionSettings

    lines = ["| key | default | unit | allowed | meaning |", "|---|---|---|---|---|"]
    lines += [f"| `{key}` | {' | '.join(cells)} |" for key, *cells in every_key(CompanionSettings)]
    return "\n".join(lines) + "\n"


@app.command()
def links() -> None:
    """List the forms of a LINK."""
    from companion.links import help_text

    print(help_text())


@app.command()
def estimators() -> None:
    """List the estimators."""
    from companion.estimators import ESTIMATORS

    for name, method in ESTIMATORS.items():
        uses = ", ".join(kind.name.lower() for kind in sorted(method.uses) if kind.name != "STATUS")
        print(f"{name:18s}{method.summary} ({uses}; {method.citation})")


@app.command(name="warm-up")
def warm_up_command(
    everything: Annotated[
        bool,
        typer.Option(
            "--all",
            help="Every estimator and the loops over whole logs, as compare and batch use them.",
        ),
    ] = False,
) -> None:
    """Compile everything now, so that the next start is quick (container images do this when
    built)."""
    from companion.settings import load_settings
    from companion.terminal import starting
    from companion.warmup import warm_up_everything

    started_s = time.perf_counter()
    if everything:
        warm_up_everything()
    else:
        with starting(Output(2)) as shown:
            settings = load_settings()
            compile_for(settings, [settings.estimator], shown)
    print(f"compiled in {time.perf_counter() - started_s:.1f} s")


@app.command(epilog=KEY_EXAMPLES)
def key(
    path: Annotated[Path, typer.Argument(help="The file to make.", metavar="FILE")],
) -> None:
    """Make a file with a new key for MAVLink 2 signing; only its owner can read it.

    The file holds a passphrase. Give the same one to the vehicle with a ground station:
    QGroundControl (Application Settings, Telemetry, MAVLink 2 signing), Mission Planner (Setup,
    Advanced, MAVLink signing) or MAVProxy (signing setup PASSPHRASE). Then set signing.key_file:
    every message of Kollsman is signed, and messages that are unsigned, signed with another key, or
    repeated are refused.
    """
    from companion.key_file import make_key

    make_key(path)
    print(f"wrote {path}; run: kollsman run LINK --set signing.key_file={path.absolute()}")


def _tell(problem: str) -> None:
    """One line on stderr, where there is one."""
    with suppress(OSError, ValueError):
        print(f"kollsman: {problem}", file=sys.stderr, flush=True)


def main() -> None:
    """Entry point: an error that the user can act on is one line on stderr and exit code 1; wrong
    usage is 2."""
    open_standard_descriptors()
    try:
        try:
            app()
        finally:
            sys.stdout.flush()
    except KollsmanError as error:
        _tell(str(error))
        sys.exit(1)
    except BrokenPipeError:  # the reader of our output, such as `head`, has gone
        discard_standard_output()
        sys.exit(1)
    except OSError as error:
        if error.errno not in OUTPUT_ERRORS:
            raise
        _tell(f"the output cannot be written: {error.strerror}")
        discard_standard_output()
        sys.exit(1)


if __name__ == "__main__":
    main()
