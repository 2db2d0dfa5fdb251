"""The effect of a fault: one flight, branched where the fault begins, compared with itself without
the fault.

A log is read once as it is, which shows where it climbs and what a healthy estimator says of it. It
is read again, and a little before each onset the pipeline branches (`Pipeline.branch`): the branch
gets the same packets through `sim.faults`, to some time after the fault, and a `Watch` notes what
the estimator says. So every packet passes everything that it would pass in a live run, and an hour
of flight needs to be heard only once for all its faults.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.evaluation.detection import detection, false_alarms
from companion.evaluation.metrics import Array, truth_at
from companion.logs.tlog import TlogReader
from companion.mavlink.codec import Message
from companion.pipeline import Pipeline
from companion.samples import FaultySensor, Kind, Packet, Rows, Verdict
from companion.settings import CompanionSettings
from sim.faults import Fault as PacketFault
from sim.faults import FaultChain
from sim.faults.readings import Freeze
from sim.faults.values import Ramp, Step

Row = dict[str, Any]

LEAD_S = 2.0
"""the branch begins this long before the onset: a frozen sensor must have had a reading"""
SETTLED_S = 180.0
"""least time from the first estimate to the first onset"""
MOVING_MPS, MOVING_S = 1.0, 15.0
"""what counts as a climb or a descent, and how long it must go on after the onset"""
DOUBT_RATIO = 1.5
"""a fault counts as detected when its sensor is named, or when the estimated spread is this much
wider than without it"""


@dataclass(frozen=True)
class Case:
    """A fault to be tried, with the same size at every onset."""

    name: str
    sensor: FaultySensor
    make: Callable[[float, float], PacketFault]
    """(start_s, duration_s) -> the fault"""
    lasts_s: float
    after_s: float = 20.0
    """how long the flight is followed after it"""
    moving: bool = False
    """only in climbs and descents"""
    once: bool = False
    """one onset a flight, not several"""


def _height(
    kind: type[Step] | type[Ramp], quantity: str, value: float
) -> Callable[[float, float], PacketFault]:
    name = "size" if kind is Step else "rate"
    return lambda start_s, duration_s: kind.model_validate(
        {"quantity": quantity, name: value, "start_s": start_s, "duration_s": duration_s}
    )


def _baro(name: str, kind: type[Step] | type[Ramp], value: float) -> Case:
    return Case(name, FaultySensor.BAROMETER, _height(kind, "pressure_altitude", value), 20.0)


def _gnss(
    name: str, kind: type[Step] | type[Ramp], value: float, lasts_s: float, **more: Any
) -> Case:
    return Case(name, FaultySensor.GNSS, _height(kind, "gnss_height", value), lasts_s, **more)


CASES = (
    _baro("barometer +15 m", Step, 15.0),
    _baro("barometer -15 m", Step, -15.0),
    _baro("barometer +1 m/s", Ramp, 1.0),
    _baro("barometer -1 m/s", Ramp, -1.0),
    Case(
        "barometer frozen",
        FaultySensor.BAROMETER,
        lambda start_s, duration_s: Freeze(start_s=start_s, duration_s=duration_s),
        30.0,
        moving=True,
    ),
    _gnss("GNSS +30 m", Step, 30.0, 100.0, after_s=40.0),
    _gnss("GNSS -30 m", Step, -30.0, 100.0, after_s=40.0),
    _gnss("GNSS +30 m for 10 min", Step, 30.0, 600.0, once=True),
    _gnss("GNSS -30 m for 10 min", Step, -30.0, 600.0, once=True),
    _gnss("GNSS +2 m/s", Ramp, 2.0, 90.0),
    _gnss("GNSS -2 m/s", Ramp, -2.0, 90.0),
    _gnss("GNSS +0.5 m/s", Ramp, 0.5, 120.0),
    _gnss("GNSS -0.5 m/s", Ramp, -0.5, 120.0),
)


class Watch:
    """An observer that notes what the estimator says after each pressure and fix of the primary
    sensors."""

    def __init__(self) -> None:
        self.packet_us = 0
        """arrival of the packet that is being read"""
        self.pipeline: Pipeline | None = None
        self._rows: list[tuple[float, ...]] = []
        self._truth: list[tuple[float, float, float]] = []

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        if (
            kind not in (Kind.PRESSURE, Kind.GNSS)
            or row[0]["instance"] != 0
            or self.pipeline is None
        ):
            return
        e = estimate[0]
        value = row[0]["pressure_pa"] if kind is Kind.PRESSURE else row[0]["altitude_amsl_m"]
        self._rows.append(
            (self.packet_us, self.pipeline.now_us, kind, verdict, value, e["altitude_amsl_m"],
             e["altitude_sd_m"],
             e["protection_level_m"], e["faulty"], e["faulty_since_us"])
        )  # fmt: skip

    def truth(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        self._truth.append((time_us, altitude_amsl_m, climb_mps))

    def autopilot(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        """Not compared here."""

    def published(self, message: Message) -> None:
        """Not an estimate of its own."""

    def seen(self) -> "Seen":
        rows, truth = (
            np.array(self._rows, np.float64).reshape(-1, 10),
            np.array(self._truth, np.float64).reshape(-1, 3),
        )
        return Seen(truth, *rows.T)


@dataclass(frozen=True)
class Seen:
    """What a `Watch` has noted, shape (n,) each; truth has the columns time_us, altitude_amsl_m,
    climb_mps."""

    truth: Array
    packet_us: Array
    now_us: Array
    """the vehicle's clock when it was said"""
    kind: Array
    verdict: Array
    value: Array
    """pressure or GNSS height, by kind"""
    altitude_m: Array
    sd_m: Array
    level_m: Array
    faulty: Array
    since_us: Array

    @property
    def error_m(self) -> Array:
        """Error of the estimate against the newest truth, m."""
        return self.altitude_m - truth_at(self.now_us, self.truth[:, 0], self.truth[:, 1])


def try_faults(
    path: Path, settings: CompanionSettings, onsets: int, cases: Sequence[Case] = CASES
) -> tuple[list[Row], Row]:
    """Every case at up to `onsets` instants of the log at `path`.

    Returns a row for each fault, and one for the flight without any: its length and false alarms.
    Raises `LogFormatError`.
    """
    packets = list(TlogReader(path))
    healthy = _watched(packets, settings)
    plan = sorted(
        ((onset_us, case) for case in cases for onset_us in _onsets(healthy, case, onsets)),
        key=lambda each: each[0],
    )
    times_us = np.array([packet.time_us for packet in packets], np.float64)
    pipeline, rows, at = Pipeline(settings, datagrams=True, observer=Watch()), [], 0
    for onset_us, case in plan:
        start = int(np.searchsorted(times_us, onset_us - LEAD_S * 1e6))
        for packet in packets[at:start]:
            pipeline.feed(packet)
        at = max(at, start)
        stop = int(np.searchsorted(times_us, onset_us + (case.lasts_s + case.after_s) * 1e6))
        rows.append(_try(pipeline, case, packets[at:stop], onset_us, healthy))
    alive = healthy.now_us[np.isfinite(healthy.sd_m)]
    flight: Row = {
        "flight_s": float(alive[-1] - alive[0]) * 1e-6 if alive.size else 0.0,
        "false_alarms": false_alarms(healthy.now_us, healthy.faulty.astype(np.int64)),
        "interval_s": _interval_s(healthy),
    }
    return rows, flight


def _watched(packets: Sequence[Packet], settings: CompanionSettings) -> Seen:
    watch = Watch()
    watch.pipeline = Pipeline(settings, datagrams=True, observer=watch)
    for packet in packets:
        watch.packet_us = packet.time_us
        watch.pipeline.feed(packet)
    return watch.seen()


def _onsets(healthy: Seen, case: Case, count: int) -> Iterator[float]:
    """Arrival times of first faulty packets, evenly over the flight, or over its climbs and
    descents."""
    known = healthy.packet_us[np.isfinite(healthy.altitude_m)]
    if not known.size:
        return
    first_us, last_us = known[0] + SETTLED_S * 1e6, known[-1] - (case.lasts_s + case.after_s) * 1e6
    candidates = np.arange(first_us, last_us, 1e6)
    if case.moving and candidates.size and healthy.truth.size:
        shift_us = float(np.median(healthy.packet_us - healthy.now_us))
        ahead_us = np.arange(0.0, MOVING_S + 1.0) * 1e6
        climb = np.abs(
            np.interp(
                candidates[:, None] + ahead_us - shift_us, healthy.truth[:, 0], healthy.truth[:, 2]
            )
        ).min(axis=1)
        candidates = candidates[climb > MOVING_MPS]
    elif case.moving:
        return
    chosen = min(1 if case.once else count, candidates.size)
    for k in range(chosen):
        yield float(candidates[int((k + 0.5) * candidates.size / chosen)])


def _try(
    pipeline: Pipeline, case: Case, packets: Sequence[Packet], onset_us: float, healthy: Seen
) -> Row:
    watch = Watch()
    branch = watch.pipeline = pipeline.branch(watch)
    if not packets:
        raise ValueError("no packets after the onset")
    stream = FaultChain([case.make((onset_us - packets[0].time_us) * 1e-6, case.lasts_s)], seed=1)
    clock_us = float("nan")
    for packet in packets:
        if np.isnan(clock_us) and packet.time_us >= onset_us:
            clock_us = float(branch.now_us)
        for each in stream.feed(packet):
            watch.packet_us = each.time_us
            branch.feed(each)
    return {"case": case.name, "sensor": case.sensor.name, "onset_s": clock_us * 1e-6} | _judged(
        watch.seen(), case, clock_us, healthy
    )


def _judged(seen: Seen, case: Case, onset_us: float, healthy: Seen) -> Row:
    end_us = onset_us + case.lasts_s * 1e6
    faulty = seen.faulty.astype(np.int64)
    found = detection(seen.now_us, faulty, seen.since_us, onset_us, end_us, case.sensor)
    lasts = (seen.now_us >= onset_us) & (seen.now_us < end_us)
    wide = seen.sd_m > DOUBT_RATIO * np.interp(seen.now_us, healthy.now_us, healthy.sd_m)
    doubtful = lasts & (wide | (faulty == case.sensor))
    named = onset_us + found.delay_s * 1e6
    kind = Kind.PRESSURE if case.sensor is FaultySensor.BAROMETER else Kind.GNSS
    after = lasts & (seen.now_us > named)
    return asdict(found) | {
        "detected_s": float(seen.now_us[np.argmax(doubtful)] - onset_us) * 1e-6
        if doubtful.any()
        else float("nan"),
        "used_while_wrong": int(
            np.count_nonzero(after & (seen.kind == kind) & (seen.verdict == Verdict.USED))
        ),
        "max_error_m": float(np.nanmax(np.abs(seen.error_m[lasts]), initial=0.0)),
        "max_error_after_m": float(
            np.nanmax(np.abs(seen.error_m[seen.now_us >= end_us]), initial=0.0)
        ),
        "misleading_s": _time_s(seen, lasts & (np.abs(seen.error_m) > seen.level_m)),
    }


def _time_s(seen: Seen, chosen: Any) -> float:
    """How long a condition held."""
    spans = np.diff(seen.now_us, append=seen.now_us[-1:])
    return float(np.sum(spans[chosen])) * 1e-6


def _interval_s(seen: Seen) -> float:
    """Interval between new values of the barometer, s."""
    chosen = seen.kind == Kind.PRESSURE
    times_us, values = seen.now_us[chosen], seen.value[chosen]
    fresh = times_us[1:][np.diff(values) != 0.0]
    return float(np.median(np.diff(fresh))) * 1e-6 if fresh.size > 1 else float("nan")
