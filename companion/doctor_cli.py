"""The command ``kollsman doctor``."""

import json
from contextlib import ExitStack
from typing import Annotated

import typer

from companion.common_cli import ConfigOption, LinkArgument, compile_for, resolve_settings
from companion.output import Output

DOCTOR_EXAMPLES = """\b
Examples:
  kollsman doctor /dev/ttyAMA0:57600
  kollsman doctor udpin:0.0.0.0:14550 --seconds 30
  kollsman doctor /dev/ttyAMA0:57600 --config companion.yaml
"""


def doctor(
    link: LinkArgument,
    *,
    config: ConfigOption = None,
    seconds: Annotated[
        float, typer.Option(min=1, max=3600, help="Time to listen, s.", metavar="S")
    ] = 15.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Listen to a vehicle, and report what is heard, what is missing and which parameter to set.

    Exit code 1 when something is wrong.
    """
    from companion.terminal import starting

    with starting(Output(2)) as shown:
        settings = resolve_settings(config, None)
        compile_for(settings, [settings.estimator], shown)

    from companion import doctor as examining
    from companion.clock import SystemClock
    from companion.links import open_link
    from companion.reference_link import open_reference

    clock, output = SystemClock(), Output()
    opened = open_link(link, clock)
    with ExitStack() as stack:
        stack.callback(opened.close)
        station = open_reference(settings.air, stack, clock)
        case, findings = examining.examine(opened, settings, clock, seconds, station)
    if as_json:
        listed = [
            {"grade": each.grade.name.lower(), "what": each.what, "cure": each.cure}
            for each in findings
        ]
        heard = [line.strip() for line in examining.report(case, [])]
        output.line(json.dumps({"findings": listed, "heard": heard}, ensure_ascii=False))
    else:
        for line in examining.report(case, findings):
            output.line(line)
    if any(each.grade is examining.Grade.WRONG for each in findings):
        raise typer.Exit(1)
