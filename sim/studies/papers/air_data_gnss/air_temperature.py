"""Paper W live: a simulated flight with a probe for the air temperature, through the pipeline.

HYGROMETER_SENSOR carries the temperature (once a second); the pipeline makes AIR samples of it, and
the estimator updates its scale factor with each. The same log without these frames is the flight
without a probe.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from companion.kernels.atmosphere import T0_K
from companion.logs.tlog import TlogReader
from companion.mavlink.codec import Message, mavlink
from companion.mavlink.framing import V2
from companion.pipeline import Pipeline
from companion.samples import Kind, Packet, Rows, Verdict
from companion.settings import CompanionSettings
from sim.flight import Flight
from sim.scenario import Scenario
from sim.studies.page import SEED_ROOT

WARMER_K, SEED = 15.0, 1
TRUE_SCALE = T0_K / (T0_K + WARMER_K) - 1.0
"""a of (2) in a column that is warmer by WARMER_K at every height."""
HYGROMETER = mavlink.MAVLINK_MSG_ID_HYGROMETER_SENSOR


@dataclass
class Scales:
    """Scale factor and its time after each pressure; an observer of the pipeline."""

    times_s: list[float] = field(default_factory=list)
    scales: list[float] = field(default_factory=list)
    errors_m: list[float] = field(default_factory=list)
    temperatures: int = 0
    """AIR samples that were used"""
    _altitude_m: float = float("nan")

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        self._altitude_m = float(estimate[0]["altitude_amsl_m"])
        if kind is Kind.AIR and verdict is Verdict.USED:
            self.temperatures += 1
        elif kind is Kind.PRESSURE:
            self.times_s.append(float(row[0]["time_us"]) * 1e-6)
            self.scales.append(float(estimate[0]["baro_scale"]))

    def truth(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        self.errors_m.append(self._altitude_m - altitude_amsl_m)

    def autopilot(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        """Not compared here."""

    def published(self, message: Message) -> None:
        """Not compared here."""

    @property
    def curve(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Seconds since boot, and scale factor."""
        return np.array(self.times_s), np.array(self.scales)


def scenario() -> Scenario:
    """Three minutes between 300 and 420 m, 15 K warmer than standard, a probe on board."""
    return Scenario.model_validate(
        {
            "name": "probe",
            "summary": "a flight in warm air with a probe for its temperature",
            "weather": {"temperature": [{"time_s": 0, "offset_k": WARMER_K}]},
            "sensors": {"thermometer": {"fitted": True}},
            "profile": [
                {"leg": "wait", "duration_s": 30},
                {"leg": "take_off", "height_m": 60},
                {"leg": "climb", "altitude_amsl_m": 420},
                {"leg": "hold", "duration_s": 60},
            ],
        }
    )


def fly() -> tuple[Scales, Scales]:
    """The flight with its probe, and without; another seed root flies through other noise."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "probe.tlog"
        Flight(scenario(), tlog=path, seed=SEED + SEED_ROOT.get()).run()
        return tuple(_replay(path, probe) for probe in (True, False))  # type: ignore[return-value]


def _replay(path: Path, probe: bool) -> Scales:
    scales = Scales()
    settings = CompanionSettings().with_assignments(["estimator=air-data-gnss"])
    pipeline = Pipeline(settings, datagrams=True, observer=scales, sends=False)
    for packet in _packets(path, probe):
        pipeline.feed(packet)
    return scales


def _packets(path: Path, probe: bool) -> Iterator[Packet]:
    """Frames of a log; those of the probe left out unless wanted."""
    for packet in TlogReader(path):
        data = packet.data
        message_id = int.from_bytes(data[7:10], "little") if data[0] == V2 else data[5]
        if probe or message_id != HYGROMETER:
            yield packet
