"""The commands that learn from logs: tune and identify. Part of the command ``kollsman``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from companion import whole_file
from companion.common_cli import (
    ConfigOption,
    EstimatorOption,
    SetOption,
    compile_first,
    resolve_settings,
)
from companion.errors import ConfigError
from companion.log_cli import LogsArgument, bar, refuse_outputs

if TYPE_CHECKING:
    from companion.evaluation.identify import Identified
    from companion.settings import CompanionSettings

TUNE_EXAMPLES = """\b
Examples:
  kollsman tune *.tlog --estimator vertical-bank --out tuned.yaml
  kollsman replay flight.tlog --config tuned.yaml
  kollsman tune flight.tlog --estimator damping-loop        (its paper's genetic search)
"""
IDENTIFY_EXAMPLES = """\b
Examples:
  kollsman identify flight1.BIN flight2.BIN
  kollsman identify *.tlog --out baro.param
"""
SCIPY = "needs SciPy: pip install 'kollsman[tune]'"


def tune(
    logs: LogsArgument,
    *,
    estimator: EstimatorOption = None,
    config: ConfigOption = None,
    changes: SetOption = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Of the genetic search of damping-loop.", metavar="N")
    ] = 0,
    generations: Annotated[
        int,
        typer.Option(min=1, max=10_000, help="Of the genetic search of damping-loop.", metavar="N"),
    ] = 60,
    out: Annotated[
        Path | None, typer.Option(help="Write the configuration there.", metavar="TUNED.yaml")
    ] = None,
) -> None:
    """Find an estimator's noise parameters: those under which its innovations are most likely.

    Judged on logs left out of the search; refused where the logs do not show them.
    """
    refuse_outputs(logs, out)
    for log in logs:
        _refuse_name(log)
    settings = resolve_settings(config, estimator, changes)
    compile_first(settings, settings.estimator)
    found = _tuned(logs, settings, seed, generations)
    print(found.table())
    print(f"\n{found.snippet()}", end="")
    if out:
        _write(out, found.snippet())


def _refuse_name(log: Path) -> None:
    """The name of an estimator where a log belongs is an older form of the command."""
    from companion.estimators import ESTIMATORS

    if str(log) in ESTIMATORS and not log.exists():
        raise ConfigError(f"{log} is an estimator: kollsman tune LOG... --estimator {log}")


def _tuned(logs: list[Path], settings: "CompanionSettings", seed: int, generations: int) -> Any:
    from companion.estimators import ESTIMATORS

    name = settings.estimator
    search = ESTIMATORS[name].tune
    if search is not None:
        if len(logs) > 1:
            raise ConfigError(f"the search of {name} takes one log")
        from companion.evaluation.samples import samples_of

        with bar(logs[0].name, 2.0) as advance:
            samples = samples_of(logs[0], settings, advance)
            return search(
                samples, settings.section(name), seed, generations, lambda done: advance(1 + done)
            )
    try:
        import scipy.optimize  # noqa: F401
    except ImportError:
        raise ConfigError(f"kollsman tune {SCIPY}") from None
    from companion.evaluation.tuning import tune as search_noise

    with bar(name, 1.0) as advance:
        return search_noise(logs, name, settings, advance)


def identify(
    logs: LogsArgument,
    *,
    config: ConfigOption = None,
    changes: SetOption = None,
    out: Annotated[
        Path | None, typer.Option(help="Write ArduPilot's parameters there.", metavar="OUT.param")
    ] = None,
) -> None:
    """Find errors of a vehicle's barometer that go with speed, throttle and temperature.

    Prints them as the parameters that the autopilot has for them; a coefficient that the flights do
    not show is refused with the reason. Logs must be of one vehicle, flown without these parameters
    set.
    """
    refuse_outputs(logs, out)
    settings = resolve_settings(config, None, changes)
    from companion.evaluation.identify import identify as find
    from companion.evaluation.identify import parameters

    with bar("identify", 1.0) as advance:
        found = find(logs, settings, advance)
    _show(found)
    lines = parameters(found)
    for autopilot in dict.fromkeys(line.autopilot for line in lines):
        print(f"\n{autopilot}:")
        for line in lines:
            if line.autopilot == autopilot:
                remark = f"   ({line.remark})" if line.remark else ""
                print(f"  {line.parameter:18s} {line.value:g}{remark}")
    if not lines:
        raise ConfigError("no error that a parameter could correct was seen; the reasons are above")
    if out:
        ours = [line for line in lines if line.autopilot == "ArduPilot"]
        _write(out, "".join(f"{line.parameter},{line.value:g}\n" for line in ours))


def _show(found: "Identified") -> None:
    from companion.evaluation.identify import UNITS

    print(f"from {found.sessions} session{'s' if found.sessions > 1 else ''}")
    for each in found.coefficients:
        name, unit = UNITS[each.name]
        if each.refused:
            said = f"refused: {each.refused}"
        else:
            seen = "" if each.is_seen else "; no error seen: leave the parameter at 0"
            said = f"{each.value:.3g} +- {each.sd:.2g} {unit}{seen}"
        print(f"  {name:24s} {said}")


def _write(path: Path, text: str) -> None:
    try:
        whole_file.write(path, text.encode("utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from None
    print(f"\nwrote {path}")
