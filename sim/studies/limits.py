"""Every estimator at its limits: one flight, replayed through the pipeline with sensors missing.

A condition changes the frames of the log (`Condition.keeps`, `Condition.faults`) or the
configuration. Each pair of estimator and condition gives a line: error, reported spread, share of
the time in which ALTITUDE was sent, and health.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from companion.estimators import ESTIMATORS
from companion.kernels.atmosphere import G0_MPS2, L0_KPM, R_AIR, T0_K, qnh_pa
from companion.logs.tlog import TlogReader
from companion.mavlink.codec import Message, mavlink
from companion.mavlink.framing import V2
from companion.pipeline import Pipeline
from companion.samples import Kind, Packet, Rows, Verdict
from companion.settings import CompanionSettings
from sim.faults import Fault, apply_faults, parse_fault
from sim.flight import Flight
from sim.scenario import Scenario
from sim.studies.page import Page, Value

SETTLED_S, ONSET_S, OUTAGE_S = 60.0, 200.0, 300.0
SEA_LEVEL_HPA, WARMER_K, FIELD_M, SEED = 1005.0, 10.0, 300.0, 1
STEP_PA = -450.0
"""step of pressure: 40 m of barometer height at 700 m"""
IMU = {mavlink.MAVLINK_MSG_ID_RAW_IMU}
TRUTH = {mavlink.MAVLINK_MSG_ID_SIM_STATE}
BARO = {
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE,
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE2,
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU,
}
GNSS = {mavlink.MAVLINK_MSG_ID_GPS_RAW_INT}

Keeps = Callable[[int, float, int], bool]
"""(message id, seconds since the first packet, how many of this id came before) -> kept"""


def every(ids: set[int], nth: int) -> Keeps:
    """One frame in `nth` of these ids."""
    return lambda message_id, _, count: message_id not in ids or count % nth == 0


def without(ids: set[int], start_s: float = 0.0, end_s: float = math.inf) -> Keeps:
    """No frame of these ids in an interval."""
    return lambda message_id, at_s, _: message_id not in ids or not start_s <= at_s < end_s


@dataclass(frozen=True)
class Condition:
    """What is different from the whole flight, and when it is judged (seconds)."""

    name: str
    keeps: Keeps = lambda *_: True
    faults: tuple[Fault, ...] = ()
    settings: tuple[str, ...] = ()
    judged_s: tuple[float, float] = (SETTLED_S, math.inf)


def conditions() -> tuple[Condition, ...]:
    """The table's columns."""
    after, outage = (ONSET_S, math.inf), (ONSET_S, ONSET_S + OUTAGE_S)
    qnh = f"air.qnh_hpa={field_qnh_hpa()}"
    step = parse_fault(f"step:quantity=pressure,size={STEP_PA:g},start_s={ONSET_S:g}")
    return (
        Condition("all sensors"),
        Condition("no IMU", without(IMU)),
        Condition("IMU 5 Hz", every(IMU, 5)),
        Condition("no barometer", without(BARO)),
        Condition("barometer lost", without(BARO, ONSET_S), judged_s=after),
        Condition("barometer +40 m", faults=(step,), judged_s=after),
        Condition("GNSS lost for 300 s", without(GNSS, *outage), judged_s=outage),
        Condition("no GNSS", without(GNSS)),
        Condition("no GNSS, QNH", without(GNSS), settings=(qnh,)),
        Condition(
            "no GNSS, QNH and air temperature",
            without(GNSS),
            settings=(qnh, f"air.temperature_c={field_temperature_c()}"),
        ),
    )


def field_qnh_hpa() -> int:
    """QNH that a METAR of the field reports: its pressure in the warm air, reduced through the
    standard atmosphere, in whole hectopascals, rounded down."""
    column = 1.0 + L0_KPM * FIELD_M / (T0_K + WARMER_K)
    field_pa = 100.0 * SEA_LEVEL_HPA * column ** (-G0_MPS2 / (R_AIR * L0_KPM))
    return int(qnh_pa(field_pa, FIELD_M) * 0.01)


def field_temperature_c() -> int:
    """Air temperature that the same METAR reports, in whole degrees."""
    return round(T0_K + WARMER_K + L0_KPM * FIELD_M - 273.15)


def scenario() -> Scenario:
    """Nine minutes between 300 and 900 m, 10 K warmer than standard."""
    return Scenario.model_validate(
        {
            "name": "limits",
            "summary": "the flight of the table of limits",
            "weather": {
                "pressure": [{"time_s": 0, "sea_level_hpa": SEA_LEVEL_HPA}],
                "temperature": [{"time_s": 0, "offset_k": WARMER_K}],
            },
            "profile": [
                {"leg": "wait", "duration_s": 30},
                {"leg": "take_off", "height_m": 60},
                {"leg": "climb", "altitude_amsl_m": 600},
                {"leg": "hold", "duration_s": 120, "heading_deg": 180},
                {"leg": "climb", "altitude_amsl_m": 900},
                {"leg": "hold", "duration_s": 90},
                {"leg": "descend", "altitude_amsl_m": 500, "rate_mps": 3},
                {"leg": "hold", "duration_s": 60},
            ],
        }
    )


@dataclass
class Watch:
    """An observer that notes the pipeline's output with every truth."""

    pipeline: Pipeline | None = None
    times_us: list[int] = field(default_factory=list)
    errors_m: list[float] = field(default_factory=list)
    sds_m: list[float] = field(default_factory=list)
    healths: list[str] = field(default_factory=list)
    sent_us: list[int] = field(default_factory=list)

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        """Ignored: the truth is frequent enough."""

    def truth(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        assert self.pipeline is not None
        value = self.pipeline.estimate[0]
        self.times_us.append(time_us)
        self.errors_m.append(float(value["altitude_amsl_m"]) - altitude_amsl_m)
        self.sds_m.append(float(value["altitude_sd_m"]))
        self.healths.append(self.pipeline.health.health.name)

    def autopilot(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        """Not compared here."""

    def published(self, message: Message) -> None:
        assert self.pipeline is not None
        self.sent_us.append(self.pipeline.now_us)


@dataclass(frozen=True)
class Outcome:
    """One estimator in one condition; NaN where there was no altitude."""

    rmse_m: float
    sd_m: float
    sent_ratio: float
    health: str

    @property
    def cell(self) -> str:
        """RMSE / sd in metres, share of the seconds with ALTITUDE, health."""
        if not math.isfinite(self.rmse_m):
            return f"- / -, {100 * self.sent_ratio:.0f} %, {self.health}"
        return f"{self.rmse_m:.1f} / {self.sd_m:.1f}, {100 * self.sent_ratio:.0f} %, {self.health}"


def message_id_of(data: bytes) -> int:
    """Message id of a frame."""
    return int.from_bytes(data[7:10], "little") if data[0] == V2 else data[5]


def changed(packets: list[Packet], condition: Condition) -> Iterator[Packet]:
    """The packets of a log as the condition has them."""
    counts: Counter[int] = Counter()
    start_us = packets[0].time_us
    for packet in apply_faults(iter(packets), condition.faults, SEED):
        message_id = message_id_of(packet.data)
        counts[message_id] += 1
        if condition.keeps(message_id, (packet.time_us - start_us) * 1e-6, counts[message_id] - 1):
            yield packet


def judge(packets: list[Packet], estimator: str, condition: Condition) -> Outcome:
    """Replay the log in one condition."""
    settings = CompanionSettings().with_assignments([f"estimator={estimator}", *condition.settings])
    watch = Watch()
    pipeline = Pipeline(settings, datagrams=True, observer=watch)
    watch.pipeline = pipeline
    for packet in changed(packets, condition):
        pipeline.feed(packet)
    elapsed_s = (np.array(watch.times_us) - watch.times_us[0]) * 1e-6
    judged = (elapsed_s >= condition.judged_s[0]) & (elapsed_s < condition.judged_s[1])
    error, sd = np.array(watch.errors_m)[judged], np.array(watch.sds_m)[judged]
    known = np.isfinite(error)
    sent_s = {int((at_us - watch.times_us[0]) * 1e-6) for at_us in watch.sent_us}
    seconds = {int(at_s) for at_s in elapsed_s[judged]}
    health = Counter(np.array(watch.healths)[judged].tolist()).most_common(1)[0][0]
    return Outcome(
        float(np.sqrt(np.mean(error[known] ** 2))) if known.any() else math.nan,
        float(np.median(sd[known])) if known.any() else math.nan,
        len(sent_s & seconds) / len(seconds),
        health,
    )


def thinned(path: Path) -> list[Packet]:
    """The log with 25 Hz of IMU and 5 Hz of truth: enough, and a third of the work."""
    counts: Counter[int] = Counter()
    keeps = dict.fromkeys(IMU, 2) | dict.fromkeys(TRUTH, 5)
    kept = []
    for packet in TlogReader(path):
        message_id = message_id_of(packet.data)
        counts[message_id] += 1
        if counts[message_id] % keeps.get(message_id, 1) == 0:
            kept.append(packet)
    return kept


def measure(progress: Callable[[float, str], None]) -> Mapping[str, Mapping[str, Outcome]]:
    """Fly once, and judge every estimator in every condition: estimator -> condition -> outcome."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "limits.tlog"
        Flight(scenario(), tlog=path, seed=SEED).run()
        packets = thinned(path)
    columns = conditions()
    found: dict[str, dict[str, Outcome]] = {}
    for row, name in enumerate(ESTIMATORS):
        for column, condition in enumerate(columns):
            progress((row + column / len(columns)) / len(ESTIMATORS), f"{name}: {condition.name}")
            found.setdefault(name, {})[condition.name] = judge(packets, name, condition)
    return found


def write(found: Mapping[str, Mapping[str, Outcome]], out: Path) -> Path:
    """The page of the table."""
    page = Page("limits", out)
    page.text("# Every estimator at its limits")
    page.text(
        "Generated by `kollsman-sim limits --out docs/evaluation`, never edited by hand. One "
        f"simulated flight of nine minutes between 300 and 900 m, QNH {field_qnh_hpa()} hPa, "
        f"{WARMER_K:g} K warmer than standard, IMU 25 Hz, is replayed through the pipeline. A "
        "cell holds the RMSE against truth and the median reported spread (sd) in metres, the "
        "share of the seconds in which ALTITUDE was sent, and the most frequent health. Judged "
        f"from 60 s on; faults from {ONSET_S:g} s on, and the outage while it lasts."
    )
    names = list(next(iter(found.values())))
    rows: list[list[Value]] = [
        [name, *(found[estimator][name].cell for estimator in found)] for name in names
    ]
    page.grid("RMSE / sd (m), ALTITUDE sent, health", ["condition", *found], rows)
    return page.write()
