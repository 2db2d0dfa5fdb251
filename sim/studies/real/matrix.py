"""The matrix: every recording x IMU rate x attitude x lag x GNSS error, one row a cell.

A cell is one flight made with one plan; the default estimator runs over it, and what the companion
would have published is followed. Every other estimator runs over the cells of the first seed at
`COMPARED_HZ`.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.errors import SimulationError
from companion.estimators import DEFAULT_ESTIMATOR, ESTIMATORS, run_log
from companion.evaluation.integrity import coverage, protection
from companion.evaluation.metrics import Array, errors, truth_at
from companion.evaluation.published import Published, longest_s, published, share_sent
from companion.evaluation.smoother import measured_of, smooth
from companion.health import Health
from companion.jobs import Row
from companion.samples import Kind, SampleLog
from companion.settings import CompanionSettings
from sim.studies.real import source_of
from sim.studies.real.gnss_errors import GaussMarkovError, GnssError, RecordedError, stationary
from sim.studies.real.recording import Plan, Recording

IMU_HZ = (0, 1, 2, 5, 10, 25, 50)
COMPARED_HZ = (0, 50)
"""IMU rates at which every estimator runs, with the first seed"""
LAGS_S = (0.0, 1.0)
"""lags of the recorded barometer that are removed; 0 leaves it as it is"""
SETTLE_S = 60.0
ALL_COMBINATIONS = 20
"""seeds from which on every combination of attitude, lag and error is flown; with fewer seeds each
seed has the next combination"""
WRONG_M = 50.0
TAKEOFF_CLIMB_MPS, TAKEOFF_S = 1.0, 10.0
OK_SD, OK_S = 4.0, 5.0


@dataclass(frozen=True)
class Trace:
    """One stationary stretch of a recorded log: the file, and its number in it."""

    path: Path
    number: int


@dataclass(frozen=True)
class Cell:
    """One flight of the matrix."""

    path: Path
    plan: Plan
    trace: Trace | None
    """whose GNSS error is laid on; None is the Gauss-Markov model"""
    own_gnss: bool = False
    """whether the recording's own receiver is used, and no error laid on"""
    others: bool = False
    """whether all estimators run, not only the default one"""

    @property
    def error(self) -> str:
        """Which GNSS error is laid on."""
        return "own" if self.own_gnss else "recorded" if self.trace else "Gauss-Markov"


def cells(paths: Sequence[Path], traces: Sequence[Trace], seeds: int) -> Iterator[Cell]:
    """The matrix for `seeds` errors a flight and IMU rate; `traces` may be empty."""
    kinds = (False, True) if traces else (False,)
    combinations = list(product((True, False), LAGS_S, kinds))
    for path in paths:
        source = source_of(path)
        if source is not None and source.own_gnss:
            for imu_hz, attitude in product(IMU_HZ, (True, False)):
                yield Cell(path, Plan(imu_hz, attitude, 0.0, 1), None, own_gnss=True)
            continue
        for imu_hz, seed in product(IMU_HZ, range(1, seeds + 1)):
            chosen = [combinations[(seed - 1) % len(combinations)]]
            for attitude, lag_s, is_recorded in (
                combinations if seeds >= ALL_COMBINATIONS else chosen
            ):
                trace = traces[(seed // 2) % len(traces)] if is_recorded else None
                yield Cell(
                    path,
                    Plan(imu_hz, attitude, lag_s, seed),
                    trace,
                    others=seed == 1 and imu_hz in COMPARED_HZ,
                )


@cache
def recording(path: Path) -> Recording:
    """The recording at `path`, read once a process."""
    source = source_of(path)
    if source is None:
        raise SimulationError(f"{path}: of no known format with truth")
    return source(path)


def traces_in(path: Path) -> list[Trace]:
    """The stationary stretches of one log; runs in a worker."""
    return [Trace(path, stretch.number) for stretch in stationary(path)]


@cache
def _stretches(path: Path) -> list[RecordedError]:
    return stationary(path)


def error_of(trace: Trace | None, seed: int) -> GnssError:
    """The GNSS error that is laid on."""
    if trace is None:
        return GaussMarkovError()
    return replace(_stretches(trace.path)[trace.number], seed=seed)


def fly(cell: Cell) -> list[Row]:
    """The rows of a cell: one an estimator."""
    warm()
    flight = recording(cell.path)
    error = None if cell.own_gnss else error_of(cell.trace, cell.plan.seed)
    log = flight.samples(cell.plan, error)
    head: Row = {
        "flight": flight.name,
        "minutes": flight.duration_s / 60.0,
        "imu_hz": cell.plan.imu_hz,
        "attitude": cell.plan.attitude,
        "lag_s": cell.plan.lag_s,
        "error": cell.error,
        "seed": cell.plan.seed,
        "field_elevation": cell.plan.field_elevation,
    }
    names = list(ESTIMATORS) if cell.others else [DEFAULT_ESTIMATOR]
    after = after_the_fact(log) if cell.plan.imu_hz == 0 else {}
    return [
        head
        | {"estimator": name}
        | measures(log, name)
        | (after if name == DEFAULT_ESTIMATOR else {})
        for name in names
    ]


@cache
def warm() -> None:
    """Compile, or load from the cache, before anything is timed."""
    for method in ESTIMATORS.values():
        run_log(method, SampleLog())


def measures(log: SampleLog, estimator: str, settle_s: float = SETTLE_S) -> Row:
    """Errors, honesty, and what would have been published, of one estimator over one log with
    truth."""
    said = published(log, estimator, CompanionSettings())
    truth_us, truth_m, truth_climb = (
        np.asarray(log.truth[name], np.float64)
        for name in ("time_us", "altitude_amsl_m", "climb_mps")
    )
    times_us = said.times_us
    error_m = said.of("altitude_amsl_m") - truth_at(times_us, truth_us, truth_m)
    start_us = float(log.first_us) + settle_s * 1e6
    late = said.now_us >= start_us
    ticks = late & (said.kind == Kind.PRESSURE)
    found = errors(error_m[ticks], np.zeros(np.count_nonzero(ticks)))
    sd_m, level_m = said.of("altitude_sd_m"), said.of("protection_level_m")
    kept = protection(times_us[ticks] * 1e-6, error_m[ticks], level_m[ticks])
    climb = errors(said.of("climb_mps")[ticks], np.interp(times_us[ticks], truth_us, truth_climb))
    row: Row = {
        "rmse_m": found.rmse_m if found else math.nan,
        "max_m": found.max_m if found else math.nan,
        "climb_rmse_mps": climb.rmse_m if climb else math.nan,
        "nees": coverage(error_m[ticks], sd_m[ticks]).nees,
        "median_sd_m": _median(sd_m[ticks]),
        "median_level_m": kept.median_level_m if kept else math.nan,
        "exceeded_share": kept.exceeded_share if kept else math.nan,
        "exceedances": kept.exceedances if kept else 0,
        "hours": kept.hours if kept else math.nan,
        "takeoff_rmse_m": _takeoff_rmse_m(said, ticks, truth_us, truth_m, truth_climb),
        "cost_us": said.cost_us,
        "imu_cost_us": said.cost_us * len(log) / log[Kind.IMU].size
        if log[Kind.IMU].size
        else math.nan,
    }
    return row | _raw(log, start_us, truth_us, truth_m) | _sent(said, error_m, start_us)


def after_the_fact(log: SampleLog, settle_s: float = SETTLE_S) -> Row:
    """Errors and honesty of the smoother, which uses no IMU."""
    smoothed = smooth(measured_of(log))
    if smoothed is None:
        return {}
    late = smoothed.time_us >= float(log.first_us) + settle_s * 1e6
    truth_us, truth_m = (
        np.asarray(log.truth[name], np.float64) for name in ("time_us", "altitude_amsl_m")
    )
    error_m = (smoothed.altitude_m - truth_at(smoothed.time_us, truth_us, truth_m))[late]
    found = errors(error_m, np.zeros(error_m.size))
    return {
        "smoothed_rmse_m": found.rmse_m if found else math.nan,
        "smoothed_nees": coverage(error_m, smoothed.sd_m[late]).nees,
    }


def _takeoff_rmse_m(
    said: Published,
    ticks: NDArray[np.bool_],
    truth_us: Array,
    truth_m: Array,
    truth_climb: Array,
) -> float:
    above = said.of("height_above_takeoff_m")[ticks]
    takeoff_m = truth_m[takeoff_row(truth_us, truth_climb)]
    truth = truth_at(said.of("time_us")[ticks], truth_us, truth_m) - takeoff_m
    found = errors(above, truth)
    return found.rmse_m if found else math.nan


def takeoff_row(times_us: Array, climb_mps: Array) -> int:
    """Row of the truth, shapes (n,), at which its first climb of `TAKEOFF_S` begins; 0 if there is
    none. A runway may be ten metres above the apron where a log starts."""
    climbs = climb_mps >= TAKEOFF_CLIMB_MPS
    edges = np.flatnonzero(np.diff(np.concatenate([[0], climbs.astype(np.int64), [0]])))
    starts, stops = edges[::2], edges[1::2] - 1
    long = times_us[stops] - times_us[starts] >= TAKEOFF_S * 1e6
    return int(starts[np.argmax(long)]) if long.any() else 0


def _raw(log: SampleLog, start_us: float, truth_us: Array, truth_m: Array) -> Row:
    gnss = log[Kind.GNSS]
    chosen = (np.asarray(gnss["fix_type"]) >= 3) & (np.asarray(gnss["instance"]) == 0)
    times_us = np.asarray(gnss["time_us"], np.float64)
    chosen &= times_us >= start_us
    found = errors(
        np.asarray(gnss["altitude_amsl_m"])[chosen], truth_at(times_us[chosen], truth_us, truth_m)
    )
    return {
        "raw_rmse_m": found.rmse_m if found else math.nan,
        "raw_max_m": found.max_m if found else math.nan,
    }


def _sent(said: Published, error_m: Array, start_us: float) -> Row:
    """Share of time with ALTITUDE, and its errors."""
    size = np.abs(error_m)
    sent = said.is_sent & np.isfinite(size)
    level_m, sd_m = said.of("protection_level_m"), said.of("altitude_sd_m")
    is_ok = said.health == Health.OK
    return {
        "sent": int(np.count_nonzero(sent)),
        "sent_share": share_sent(said, start_us, float(said.now_us[-1])),
        "sent_max_m": float(np.max(size[sent], initial=0.0)),
        "sent_wrong": int(np.count_nonzero(sent & (size > WRONG_M))),
        "sent_above_level": int(np.count_nonzero(sent & (size > level_m))),
        "ok_wrong_s": longest_s(said.now_us.astype(np.float64), is_ok & (size > OK_SD * sd_m)),
        "ok_share": float(np.mean(is_ok[said.now_us >= start_us])),
        "first_sent_s": float(said.now_us[np.argmax(said.is_sent)] - said.now_us[0]) * 1e-6
        if said.is_sent.any()
        else math.nan,
    }


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else math.nan


def group(rows: Sequence[Row], *names: str) -> dict[tuple[Any, ...], list[Row]]:
    """Rows by the values of some fields, in the order in which these first appear."""
    found: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(row[name] for name in names), []).append(row)
    return found
