"""Where the commands `kollsman` and `kollsman-sim` begin.

The names of our packages, `companion` and `sim`, are common. When another package of that name is
found first, the commands say so in one line instead of failing inside it.
"""

import importlib
import importlib.util
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
OURS = {"companion": "estimators/vertical_bank", "sim": "airframes.py"}
"""What is in our packages only: an editable installation has them elsewhere than this file."""


def companion() -> None:
    """The command ``kollsman``."""
    _begin("companion")


def sim() -> None:
    """The command ``kollsman-sim``."""
    _begin("sim")


def _begin(package: str) -> None:
    if package == "sim":
        _refuse_other("companion", "kollsman-sim")
    _refuse_other(package, "kollsman" if package == "companion" else "kollsman-sim")
    importlib.import_module(f"{package}.cli").main()


def _refuse_other(package: str, command: str) -> None:
    """End with one line when `package` is not ours."""
    found = importlib.util.find_spec(package)
    places = [Path(place).resolve() for place in (found and found.submodule_search_locations) or ()]
    if any((place / OURS[package]).exists() for place in places):
        return
    where = places[0] if places else found.origin if found else "nowhere"
    sys.exit(
        f"{command}: another package called {package!r}, at {where}, hides ours in {HERE}: install "
        "Kollsman in an environment of its own (pipx install kollsman), or unset PYTHONPATH"
    )
