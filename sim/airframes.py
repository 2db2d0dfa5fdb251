"""The table of aircraft and the loading of their JSBSim models: the only file that imports JSBSim.

A new aircraft of JSBSim's is one line of `MODELS` and one of `sim.pilot.gains.GAINS`.
"""

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from companion.errors import SimulationError

__all__ = ["MODELS", "Model", "load", "without_listeners"]


@dataclass(frozen=True)
class Model:
    """Properties of an aircraft that JSBSim's files do not give."""

    jsbsim_name: str
    rest_height_m: float
    """height of the centre of gravity above the runway, on the wheels, m"""
    stall_rad: float
    """angle of attack of the greatest lift, rad"""
    engines: int = 1
    """number of engines; an aircraft without an engine cannot take off and starts aloft"""


# Heights at rest: geod-alt-ft less the terrain after a minute on the wheels, brakes on, engines
# idling. Stall angles: where the lift over alpha in the model's file is greatest, flaps in and
# elevator neutral; a test reads it there.
MODELS = {
    "c172p": Model("c172p", rest_height_m=1.3274, stall_rad=0.28),
    "737": Model("737", rest_height_m=1.1247, stall_rad=0.23, engines=2),
    "f16": Model("f16", rest_height_m=1.6602, stall_rad=0.611),
    "sgs126": Model("sgs126", rest_height_m=0.386, stall_rad=0.21, engines=0),
}


def load(name: str) -> "jsbsim.FGFDMExec":  # type: ignore[name-defined]  # noqa: F821
    """JSBSim with one model, silent on stdout and writing no files."""
    # JSBSim reads the variable when it is first used; 0 suppresses its banner.
    os.environ.setdefault("JSBSIM_DEBUG", "0")
    import jsbsim

    fdm = jsbsim.FGFDMExec(None)
    fdm.set_debug_level(0)
    with tempfile.TemporaryDirectory(prefix="kollsman-") as folder:
        source = Path(fdm.get_root_dir()) / "aircraft" / name / f"{name}.xml"
        if without_listeners(source, Path(folder) / name):
            fdm.set_aircraft_path(folder)
        loaded = fdm.load_model(name)
    if not loaded:
        raise SimulationError(f"JSBSim has no model '{name}'")
    fdm.disable_output()  # some models write CSV files into the working directory
    return fdm


def without_listeners(source: Path, folder: Path) -> bool:
    """Whether the model at `source` opens TCP ports (the 737 does); then `folder` gets a copy of it
    without these ports."""
    if not source.is_file():
        return False
    tree = ElementTree.parse(source)
    listeners = tree.getroot().findall("input")
    if not listeners:
        return False
    for element in listeners:
        tree.getroot().remove(element)
    folder.mkdir()
    tree.write(folder / source.name)
    return True
