"""The five published systems, each held against what its paper prints: `kollsman-sim reproduce`.

`PAPERS` is the table that the command line and the tests read. A paper is one package here, named
after its estimator, with a function

    reproduce(seeds, out, progress) -> Page

that rebuilds the paper's simulation, runs the estimator of `companion.estimators` on it, and
returns the page of what holds and what does not (`sim.studies.papers.page`). Adding a paper is that
module and a line in the table.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim.studies.papers.page import Page

Progress = Callable[[float, str], None]
"""Called with the fraction done (0..1) and what is being computed."""


@dataclass(frozen=True)
class Paper:
    """One published system."""

    key: str
    title: str
    citation: str
    module: str
    """of this package, imported only when the paper is reproduced"""
    estimators: tuple[str, ...]
    """names in `companion.estimators.ESTIMATORS`"""
    seeds: int = 100
    """how many Monte-Carlo runs unless told otherwise"""

    @property
    def slug(self) -> str:
        """Stem of the file names of its page and figures."""
        return self.module.replace("_", "-")

    def reproduce(self, seeds: int, out: Path | None, progress: Progress) -> "Page":
        """Rebuild the paper's simulation with `seeds` Monte-Carlo runs; figures are written to the
        folder `out`, unless it is None."""
        page: Page = import_module(f"sim.studies.papers.{self.module}").reproduce(
            seeds, out, progress
        )
        return page


_PAPERS = (
    Paper(
        key="H",
        title="Integration of Barometric and GPS Altimeters via Adaptive Data Fusion Algorithm",
        citation="C. Hajiyev, U. Hacizade, D. Cilden-Guler, 2019",
        module="adaptive_fusion",
        estimators=("adaptive-fusion",),
        seeds=400,
    ),
    Paper(
        key="W",
        title="Simple Altitude Estimator using Air-Data and GPS Measurements",
        citation="I-H. Whang, W-S. Ra, IFAC World Congress 2008",
        module="air_data_gnss",
        estimators=("air-data-gnss",),
    ),
    Paper(
        key="C",
        title="Robust Kalman Filter-Based Fault-Tolerant Integrated Baro-Inertial-GPS Altimeter",
        citation="A. Mañero Contreras, C. Hajiyev, 2019",
        module="robust_altimeter",
        estimators=("robust-altimeter",),
    ),
    Paper(
        key="R",
        title="Technical Note: Summary of Baro Pressure for GPS-INS Vertical Channel Stability",
        citation="P. F. Roysdon, J. A. Farrell",
        module="baro_gnss_ins",
        estimators=("baro-gnss-ins",),
    ),
    Paper(
        key="K",
        title="Design and Implementation of GA Filter Algorithm for Baro-inertial Altitude Error "
        "Compensation",
        citation="J. Keighobadi, H. Nourmohammadi, S. Rafatnia",
        module="damping_loop",
        estimators=("damping-loop", "baro-ins-kf"),
    ),
)

PAPERS: dict[str, Paper] = {paper.key: paper for paper in _PAPERS}
"""By key letter."""
