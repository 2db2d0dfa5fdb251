"""Whole flights with a sensor fault: errors of the estimator, raw sensors, an autopilot that
follows its barometer.

The flights are ArduPilot-like: that flavour's messages, and a receiver that errs as ArduPilot's
SITL lets it (two slow swings of the height, no noise, a reported accuracy that does not contain
them). A flight is flown once and its log corrupted by `sim.faults`, as ``kollsman-sim corrupt``
does. The simulated autopilot's own height in the log does not know of faults on packets; so
`sim.vehicle.own_estimate.OwnEstimate` is run again on the faulty samples: height by the barometer,
origin from one early fix, as EKF3 by default.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.estimators import DEFAULT_ESTIMATOR, ESTIMATORS, run_log
from companion.evaluation.compare import SETTLE_S, Series, raw_series
from companion.evaluation.metrics import Array, truth_at
from companion.evaluation.samples import samples_of
from companion.samples import Kind, SampleLog
from companion.settings import CompanionSettings
from sim.faults import parse_fault
from sim.scenario import Scenario, load_scenario
from sim.sensors.barometer import Pressure
from sim.sensors.gnss import Fix
from sim.studies.corrupt import corrupt
from sim.studies.runs import flown
from sim.vehicle.own_estimate import EstimateConfig, OwnEstimate

Row = dict[str, Any]
ESTIMATOR = DEFAULT_ESTIMATOR
BASE = "calm-circuit"
SITL_RECEIVER = {
    "height_white_sd_m": 0.1, "height_wander_sd_m": 0.0, "accuracy": "stuck",
    "stuck_accuracy_m": 0.3, "fix": 6, "latency_s": 0.15, "latency_jitter_s": 0.05,
}  # fmt: skip
SITL_SWINGS = (
    "swing:quantity=gnss_height,size=1,period_s=12.566",
    "swing:quantity=gnss_height,size=3,period_s=314.16",
)
"""ArduPilot's SITL adds sines of half and a fiftieth of a radian a second; sizes for 2.2 m RMS"""


@dataclass(frozen=True)
class FaultFlight:
    """A flight, the faults of its log, and the sensor that they harm."""

    name: str
    sensor: str
    """"barometer", "gnss" or "none" """
    faults: tuple[str, ...] = ()
    """faults, as ``kollsman-sim corrupt --fault`` takes them"""
    hot: bool = False
    """the day is 20 K too warm and its sea-level pressure 7 hPa too low"""


FLIGHTS = (
    FaultFlight("healthy", "none"),
    FaultFlight("hot day, QNH 7 hPa off", "barometer", hot=True),
    FaultFlight("barometer noise x 15", "barometer",
                ("noise:quantity=pressure,sd=36,start_s=200",)),
    FaultFlight("barometer +40 m for 300 s", "barometer", (
        "step:quantity=pressure_altitude,size=40,start_s=400,duration_s=300",)),
    FaultFlight("barometer -30 m for 300 s", "barometer", (
        "step:quantity=pressure_altitude,size=-30,start_s=400,duration_s=300",)),
    FaultFlight("barometer frozen for 60 s in the climb", "barometer",
                ("freeze:start_s=300,duration_s=60",)),
    FaultFlight("barometer dead (repeats its value)", "barometer", ("freeze:start_s=400",)),
    FaultFlight("barometer silent", "barometer", ("drop:message=SCALED_PRESSURE,start_s=400",)),
    FaultFlight("barometer 150 ms late", "barometer", ("lag:lag_s=0.15",)),
    FaultFlight("GNSS +60 m for 180 s", "gnss",
                ("step:quantity=gnss_height,size=60,start_s=400,duration_s=180",)),
    FaultFlight("GNSS outage of 90 s", "gnss", ("outage:start_s=400,duration_s=90",)),
    FaultFlight("GNSS 3 satellites for 120 s", "gnss",
                ("two_dimensional:start_s=400,duration_s=120",)),
    FaultFlight("GNSS jammed for 120 s", "gnss", ("jamming:start_s=400,duration_s=120",)),
)  # fmt: skip


def scenario(*, hot: bool) -> Scenario:
    """The flight that is flown."""
    base = load_scenario(BASE)
    sensors = base.sensors.model_dump() | {"gnss": base.sensors.gnss.model_dump() | SITL_RECEIVER}
    changed: Row = {
        "sensors": sensors,
        "faults": [parse_fault(text).model_dump() for text in SITL_SWINGS],
    }
    if hot:
        changed["weather"] = {
            "pressure": [{"time_s": 0, "sea_level_hpa": 1006.25}],
            "temperature": [{"time_s": 0, "offset_k": 20}],
        }  # fmt: skip
    return Scenario.model_validate(base.model_dump() | changed)


def fly(seed: int, flights: Sequence[FaultFlight] = FLIGHTS) -> list[Row]:
    """One seed of every flight: a row for each flight and source."""
    rows: list[Row] = []
    for hot in sorted({flight.hot for flight in flights}):
        with flown(scenario(hot=hot), seed) as (sound, _):
            for flight in flights:
                if flight.hot == hot:
                    rows += [
                        {"flight": flight.name, "seed": seed} | row
                        for row in _judge(sound, flight, seed)
                    ]
    return rows


def _judge(sound: Path, flight: FaultFlight, seed: int) -> list[Row]:
    path = sound
    if flight.faults:
        path = sound.with_name("faulty.tlog")
        corrupt(sound, path, [parse_fault(text) for text in flight.faults], seed)
    log = samples_of(path, CompanionSettings())
    truth_us, truth_m = (
        np.asarray(log.truth[name], np.float64) for name in ("time_us", "altitude_amsl_m")
    )
    start_us = float(log.first_us) + SETTLE_S * 1e6

    def errors(times_us: Array, altitude_m: Array) -> Row:
        late = times_us >= start_us
        error = altitude_m[late] - truth_at(times_us[late], truth_us, truth_m)
        error = error[np.isfinite(error)]
        if not error.size:
            return {"rmse_m": float("nan"), "max_m": float("nan")}
        return {"rmse_m": float(np.sqrt(np.mean(error**2))), "max_m": float(np.max(np.abs(error)))}

    takeoff_us, takeoff_m = _takeoff(log, truth_us, truth_m)
    found = []
    for each in _others(log):
        since = (
            np.interp(takeoff_us, each.times_us, each.altitude_m)
            if each.times_us.size
            else math.nan
        )
        above = errors(each.times_us, each.altitude_m - since + takeoff_m)
        found.append(
            {"source": each.label, **_above_takeoff(above)} | errors(each.times_us, each.altitude_m)
        )
    estimates, _, _ = run_log(ESTIMATORS[ESTIMATOR], log)
    chosen = estimates[np.asarray(log.tables.order["kind"]) == Kind.PRESSURE]
    if flight.name == "barometer silent":
        chosen = estimates[np.asarray(log.tables.order["kind"]) == Kind.GNSS]
    times_us = chosen["time_us"].astype(np.float64)
    above = errors(times_us, chosen["height_above_takeoff_m"] + takeoff_m)
    named = sorted({int(each) for each in chosen["faulty"] if each})
    ours: Row = {"source": ESTIMATOR, "named": named, **_above_takeoff(above)}
    return [ours | errors(times_us, chosen["altitude_amsl_m"]), *found]


def _above_takeoff(errors: Row) -> Row:
    return {f"takeoff_{name}": value for name, value in errors.items()}


def _takeoff(log: SampleLog, truth_us: Array, truth_m: Array) -> tuple[float, float]:
    """When the vehicle armed, and the truth there; NaN when it did not."""
    status = log[Kind.STATUS]
    armed = np.asarray(status["time_us"], np.float64)[np.asarray(status["armed"]) == 1]
    return (
        (float(armed[0]), float(np.interp(armed[0], truth_us, truth_m)))
        if armed.size
        else (math.nan, math.nan)
    )


def _others(log: SampleLog) -> list[Series]:
    raw = [each for each in raw_series(log) if each.label != "autopilot's own"]
    own = OwnEstimate(EstimateConfig(), 1, 0.02)
    times_us, altitudes_m = [], []
    tables = log.tables
    for kind, row in zip(tables.order["kind"], tables.order["row"], strict=True):
        if kind == Kind.GNSS and tables.gnss["instance"][row] == 0:
            own.on_fix(_fix(tables.gnss[row]))
        elif kind == Kind.PRESSURE and tables.pressure["instance"][row] == 0:
            value = tables.pressure[row]
            own.on_pressure(Pressure(int(value["time_us"]), float(value["pressure_pa"]), 300.0))
            position = own.position(int(value["time_us"]))
            if position is not None:
                times_us.append(float(value["time_us"]))
                altitudes_m.append(position.altitude_amsl_m)
    unknown = np.full(len(times_us), np.nan)
    return [
        *raw,
        Series("simulated autopilot", np.array(times_us), np.array(altitudes_m), unknown, unknown),
    ]


def _fix(value: Any) -> Fix:
    time_us = int(value["time_us"])
    known: Row = {
        "measured_us": time_us, "stamp_us": time_us, "fix_type": int(value["fix_type"]),
        "altitude_amsl_m": float(value["altitude_amsl_m"]),
    }  # fmt: skip
    return Fix(
        **{name: known.get(name, 0) for name in Fix._fields}
    )  # of position and height alone, the latter counts
