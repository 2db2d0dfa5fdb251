"""The command ``kollsman-sim limits``; like `sim.cli`, it prints."""

from pathlib import Path
from typing import Annotated

import typer

EXAMPLES = """\b
Examples:
  kollsman-sim limits
  kollsman-sim limits --out docs/evaluation
"""


def limits(
    out: Annotated[Path, typer.Option(help="Folder of the page.", metavar="DIR")] = Path(
        "out/limits"
    ),
) -> None:
    """Run every estimator with sensors missing or wrong: error, spread, ALTITUDE sent, health."""
    from rich.console import Console
    from rich.progress import Progress as Bar

    from sim.studies.limits import measure, write

    console = Console(stderr=True)
    with Bar(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("limits", total=1.0)

        def report(share: float, what: str) -> None:
            bar.update(task, completed=share, description=what)

        print(write(measure(report), out))
