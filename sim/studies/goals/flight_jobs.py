"""What a worker process does for section ``flights``: one recorded or one simulated flight,
measured in every way."""

import math
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from companion.estimators import DEFAULT_ESTIMATOR, ESTIMATORS, Filter, run_log
from companion.estimators.vertical_bank.settings import VerticalBankSettings
from companion.evaluation.compare import compare_log, estimate_series
from companion.evaluation.metrics import errors, truth_at
from companion.evaluation.samples import samples_of
from companion.samples import Kind, SampleLog
from companion.settings import CompanionSettings
from sim.studies.goals.samples import flown, thinned, with_sea_level_pressure, without_gnss
from sim.studies.goals.sensor_level import Array

BANK = DEFAULT_ESTIMATOR
PREFIX = f"estimators.{BANK}."
SLOW_S = {Kind.IMU: 0.25, Kind.PRESSURE: 0.25, Kind.GNSS: 1.0}
QNH_PA = 1200.0
OUTAGES_S, OUTAGE_S = (120.0, 300.0, 420.0), 300.0
"""starts and length: the beginning, the middle and the end of jsbsim_B's ramp"""
ABLATED_SEEDS = 8
SETTLE_S = 60.0

ABLATIONS: dict[str, tuple[str, ...]] = {
    "whole": (),
    "no drift rate": ("rate_sd_mps=[0, 0, 0]",),
    **{
        f"{name} weather alone": (f"rate_sd_mps=[{sd_mps}, {sd_mps}, {sd_mps}]",)
        for name, sd_mps in zip(
            ("calm", "fair", "stormy"), VerticalBankSettings().rate_sd_mps, strict=True
        )
    },
    "no floor of the GNSS error": ("gnss_slow_floor_m=0",),
    "no atmosphere scale": ("scale_sd_ratio=0", "scale_walk_rts=0"),
    "no fast barometer error": ("fast_sd_m=0",),
    "no gusts": ("gust_ratio=[1, 1, 1]",),
    "no static port error": ("port_sd_ratio=0",),
    "no lift-off error": ("lift_sd_m=0",),
    "no barometer lag": ("lag_sd_s=0",),
    "no timing noise": ("timing_sd_s=0",),
    "no accelerometer bias": ("accel_bias_sd_mps2=0", "accel_bias_walk_mps2_rts=0"),
    "no inertial channel": ("accel_noise_mps2_rthz=1.5",),
    "no noise by attitude": ("tilt_ratio=0",),
    "nobody is named": ("integrity=false",),
    "autopilot's attitude": ("vehicle_attitude=true",),
    "QNH trusted to 1 hPa": ("offset_sd_m=8.3",),
}
"""Name -> what ``--set`` is given, without `PREFIX`."""

Row = dict[str, Any]


class Recorded(NamedTuple):
    """A recorded flight."""

    path: Path


class Simulated(NamedTuple):
    """A scenario to be flown with a seed."""

    scenario: str
    seed: int


def work(job: Recorded | Simulated) -> dict[str, Any]:
    """Everything that is measured on one flight; runs in a worker."""
    return recorded(job.path) if isinstance(job, Recorded) else simulated(job.scenario, job.seed)


def simulated(scenario: str, seed: int) -> dict[str, dict[str, Row]]:
    """Measures (as `compare` gives them) of every source, of the bank with GNSS vertical velocity,
    and ablations."""
    log, with_climb = flown(scenario, seed)
    found = {
        result.label: asdict(result)
        for result in compare_log(log, CompanionSettings(), SETTLE_S).results
    }
    found[f"{BANK}, GNSS climb"] = _bank(with_climb)
    return {"results": found, "ablations": ablations(log) if seed <= ABLATED_SEEDS else {}}


def ablations(log: SampleLog) -> dict[str, Row]:
    """The bank with something switched off."""
    return {
        name: _bank(log, tuple(f"{PREFIX}{each}" for each in changes))
        for name, changes in ABLATIONS.items()
    }


def recorded(path: Path) -> dict[str, Any]:
    """Everything that is measured on one recorded flight. Raises `LogFormatError`."""
    log = samples_of(path)
    results = compare_log(log, CompanionSettings(), SETTLE_S).results
    slow, full = thinned(log, SLOW_S), _bank(log)
    return {
        "results": {result.label: asdict(result) for result in results},
        "qnh_m": max(_largest_change_m(log, sign * QNH_PA) for sign in (-1.0, 1.0)),
        "thinned": _bank(slow),
        "whole": full,
        "outages": {start_s: _outage(log, start_s) for start_s in OUTAGES_S},
        "ablations": ablations(log),
    }


def cost(path: Path) -> tuple[float, float, int]:
    """Processor time of the bank: us for each IMU sample if all of it were theirs, us for each
    sample (least of five); bytes of a checkpoint."""
    log, method = samples_of(path), ESTIMATORS[BANK]
    run_log(method, log)
    best_s = math.inf
    for _ in range(5):
        before_s = time.thread_time()
        run_log(method, log)
        best_s = min(best_s, time.thread_time() - before_s)
    return (
        best_s / log[Kind.IMU].size * 1e6,
        best_s / len(log) * 1e6,
        len(Filter(method).checkpoint()),
    )


def _bank(log: SampleLog, assignments: tuple[str, ...] = ()) -> Row:
    settings = CompanionSettings().with_assignments(assignments)
    return next(
        asdict(each) for each in compare_log(log, settings, SETTLE_S, estimators=[BANK]).results
    )


def _largest_change_m(log: SampleLog, change_pa: float) -> float:
    before = estimate_series(BANK, log, CompanionSettings())
    after = estimate_series(BANK, with_sea_level_pressure(log, change_pa), CompanionSettings())
    late = before.times_us >= log.first_us + SETTLE_S * 1e6
    there = np.interp(before.times_us[late], after.times_us, after.altitude_m)
    return float(np.max(np.abs(there - before.altitude_m[late])))


def _outage(log: SampleLog, start_s: float) -> tuple[float, float]:
    """RMSE and maximum within `OUTAGE_S` without fixes."""
    end_s = start_s + OUTAGE_S
    series = estimate_series(BANK, without_gnss(log, start_s, end_s), CompanionSettings())
    elapsed_s = (series.times_us - log.first_us) * 1e-6
    within = (elapsed_s >= start_s) & (elapsed_s < end_s)
    truth: list[Array] = [
        np.asarray(log.truth[name], np.float64) for name in ("time_us", "altitude_amsl_m")
    ]
    found = errors(series.altitude_m[within], truth_at(series.times_us[within], *truth))
    return (found.rmse_m, found.max_m) if found is not None else (math.nan, math.nan)
