"""Evaluation on real flights: recordings with truth, real GNSS errors, and what would be published.

`SOURCES` is the table of formats with truth. Adding one is a module here with a class that has

    recognises(path) -> bool        whether a file is of this format, by its contents
    __init__(path)                  read it; raises `LogFormatError` when it cannot be used
    samples(plan, error) -> SampleLog

and a line in the table. Files are found by format, not by name, below the folder that ``--data``
names.
"""

from pathlib import Path

from sim.studies.real.carbonix import Carbonix
from sim.studies.real.g1000 import G1000
from sim.studies.real.recording import Recording

SOURCES: dict[str, type[Recording]] = {"Garmin G1000": G1000, "Carbonix RTK": Carbonix}
"""The formats, by the name that the page shows."""


def source_of(path: Path) -> type[Recording] | None:
    """The format of a file; None when it is of none of them."""
    return next((source for source in SOURCES.values() if source.recognises(path)), None)


def found(folder: Path) -> list[Path]:
    """Every recording with truth below `folder`, in the order of their paths; a second copy of one
    is left out."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file() and source_of(path))
    return list({path.read_bytes()[:1_000_000]: path for path in reversed(paths)}.values())[::-1]
