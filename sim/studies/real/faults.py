"""Sensor faults injected into real flights: steps, ramps, freezes, outages, short contact, restart.

A job is one window of one recording at one IMU rate; every case is injected at the same onset. What
a case does to the samples is one function and one line in `CASES`.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.estimators import DEFAULT_ESTIMATOR, ESTIMATORS, run_log
from companion.evaluation.metrics import Array, truth_at
from companion.evaluation.published import Published, published
from companion.health import Health
from companion.jobs import Row
from companion.kernels.atmosphere import baro_altitude_array
from companion.samples import DTYPES, FaultySensor, Kind, Rows, SampleLog, rows
from companion.settings import CompanionSettings
from sim.studies.goals.sensor_level import pressure_pa
from sim.studies.real import source_of
from sim.studies.real.matrix import WRONG_M, error_of, recording, warm
from sim.studies.real.recording import HOST_EPOCH_US, Plan

IMU_HZ = (0, 2, 50)
BEFORE_S, AFTER_S = 300.0, 120.0
"""length of a window before and after the longest case"""
LONGEST_S = 600.0
BACK_M = 5.0
"""an estimate is back when it stays this near to the one of the healthy flight"""
MOVING_MPS, MOVING_S = 1.0, 20.0

Tables = dict[Kind, Rows]
Change = Callable[[Tables, float, float], None]
"""(tables, onset, end), times in us on the vehicle's clock; changes the tables in place"""


def gnss_height(offset_m: float, rate_mps: float = 0.0, claim_m: float | None = None) -> Change:
    """The GNSS height is off by a step and a ramp; the reported accuracy is `claim_m`."""

    def change(tables: Tables, onset_us: float, end_us: float) -> None:
        table = tables[Kind.GNSS]
        hit = _within(table, onset_us, end_us)
        elapsed_s = (table["time_us"][hit] - onset_us) * 1e-6
        table["altitude_amsl_m"][hit] += offset_m + rate_mps * elapsed_s
        if claim_m is not None:
            table["vertical_sd_m"][hit] = claim_m

    return change


def baro_height(offset_m: float, over_s: float = 0.0, *, without_gnss: bool = False) -> Change:
    """The barometer's height is off by a step, or by a ramp that ends after `over_s`; GNSS may be
    away from a minute before."""

    def change(tables: Tables, onset_us: float, end_us: float) -> None:
        table = tables[Kind.PRESSURE]
        hit = _within(table, onset_us, end_us)
        elapsed_s = (table["time_us"][hit] - onset_us) * 1e-6
        share = np.minimum(elapsed_s / over_s, 1.0) if over_s else 1.0
        height_m = baro_altitude_array(table["pressure_pa"][hit])
        table["pressure_pa"][hit] = pressure_pa(height_m + offset_m * share)
        if without_gnss:
            outage(tables, onset_us - 60e6, end_us + 60e6)

    return change


def frozen(tables: Tables, onset_us: float, end_us: float) -> None:
    """The barometer repeats its last value."""
    table = tables[Kind.PRESSURE]
    hit = _within(table, onset_us, end_us)
    table["pressure_pa"][hit] = table["pressure_pa"][max(0, int(np.argmax(hit)) - 1)]


def outage(tables: Tables, onset_us: float, end_us: float) -> None:
    """No fixes."""
    tables[Kind.GNSS] = tables[Kind.GNSS][~_within(tables[Kind.GNSS], onset_us, end_us)]


def silence(tables: Tables, onset_us: float, end_us: float) -> None:
    """Nothing is heard."""
    for kind, table in tables.items():
        tables[kind] = table[~_within(table, onset_us, end_us)]


def short_contact(tables: Tables, onset_us: float, end_us: float) -> None:
    """Five seconds are heard, then nothing until the end."""
    silence(tables, -math.inf, onset_us - 5e6)
    silence(tables, onset_us, end_us)


def reboot(tables: Tables, onset_us: float, end_us: float) -> None:
    """The estimator is told that the vehicle restarted."""
    row = np.asarray(rows(DTYPES[Kind.STATUS]))
    row["time_us"], row["reboot"], row["armed"], row["landed"] = onset_us, 1, 1, -1
    row["arrival_us"] = HOST_EPOCH_US + onset_us
    table = np.concatenate([tables[Kind.STATUS], row])
    tables[Kind.STATUS] = table[np.argsort(table["arrival_us"], kind="stable")]


def _within(table: Rows, onset_us: float, end_us: float) -> NDArray[np.bool_]:
    found: NDArray[np.bool_] = (table["time_us"] >= onset_us) & (table["time_us"] < end_us)
    return found


@dataclass(frozen=True)
class Case:
    """A fault, how long it lasts, and the sensor that should be named."""

    name: str
    lasts_s: float
    sensor: FaultySensor
    change: Change
    moving: bool = False
    """only where the aircraft climbs or descends"""


GNSS, BARO, NONE = FaultySensor.GNSS, FaultySensor.BAROMETER, FaultySensor.NONE
CASES = (
    *(Case(f"GNSS {size:+g} m", 60.0, GNSS, gnss_height(size)) for size in (30.0, -30.0, 100.0)),
    Case("GNSS +100 m, claims 1 mm", 60.0, GNSS, gnss_height(100.0, 0.0, 0.001)),
    Case("GNSS +300 m, claims 0.5 m", 60.0, GNSS, gnss_height(300.0, 0.0, 0.5)),
    Case("GNSS +500 m, claims 1.5 m", 60.0, GNSS, gnss_height(500.0, 0.0, 1.5)),
    Case("GNSS +30 m for 10 min", 600.0, GNSS, gnss_height(30.0)),
    *(
        Case(f"GNSS {rate:+g} m/s", 240.0, GNSS, gnss_height(0.0, rate))
        for rate in (2.0, 1.0, 0.5, 0.3)
    ),
    *(Case(f"barometer {size:+g} m", 60.0, BARO, baro_height(size)) for size in (15.0, -15.0)),
    Case("barometer +50 m in 2 s, no GNSS", 60.0, BARO, baro_height(50.0, 2.0, without_gnss=True)),
    *(
        Case(f"barometer {size:+g} m in 20 s, no GNSS", 60.0, BARO,
             baro_height(size, 20.0, without_gnss=True))
        for size in (50.0, 300.0)
    ),
    Case("barometer frozen", 30.0, BARO, frozen, moving=True),
    *(Case(f"outage of {length:g} s", length, NONE, outage) for length in (60.0, 300.0, 600.0)),
    Case("gap of 60 s", 60.0, NONE, silence),
    Case("5 s of contact, then silence", 600.0, NONE, short_contact),
    Case("restart", 0.0, NONE, reboot),
)  # fmt: skip


@dataclass(frozen=True)
class Window:
    """One onset in one recording at one IMU rate; all cases are tried there."""

    path: Path
    imu_hz: int
    number: int
    """number of the onset, from 0; also the seed of the errors that are added"""
    count: int
    """number of onsets in the recording"""


def windows(paths: Sequence[Path], count: int) -> Iterator[Window]:
    """`count` onsets, evenly over each recording without a receiver of its own, at each IMU
    rate."""
    for path, imu_hz, number in product(paths, IMU_HZ, range(count)):
        source = source_of(path)
        if source is not None and not source.own_gnss:
            yield Window(path, imu_hz, number, count)


def try_all(window: Window) -> list[Row]:
    """A row for each case that fits."""
    warm()
    flight = recording(window.path)
    plan = Plan(window.imu_hz, attitude=True, lag_s=0.0, seed=1 + window.number)
    whole = flight.samples(plan, error_of(None, plan.seed))
    free_s = flight.duration_s - BEFORE_S - LONGEST_S - AFTER_S
    if free_s < 0.0:
        return []
    onset_s = BEFORE_S + free_s * (window.number + 0.5) / window.count
    found = []
    for case in CASES:
        start_s = _moving_s(whole, onset_s) if case.moving else onset_s
        log = cut(whole, start_s - BEFORE_S, start_s + case.lasts_s + AFTER_S)
        head: Row = {
            "flight": flight.name, "imu_hz": window.imu_hz, "onset_s": start_s, "case": case.name,
            "sensor": case.sensor.name,
        }  # fmt: skip
        found.append(head | _judge(case, log, start_s * 1e6))
    return found


def _moving_s(log: SampleLog, onset_s: float) -> float:
    """The first time from `onset_s` on from which the aircraft climbs or descends for a while;
    `onset_s` when there is none."""
    time_s = np.asarray(log.truth["time_us"], np.float64) * 1e-6
    seconds = np.arange(onset_s, time_s[-1] - LONGEST_S - MOVING_S)
    climb = np.interp(
        seconds[:, None] + np.arange(0.0, MOVING_S), time_s, np.asarray(log.truth["climb_mps"])
    )
    steady = np.all(climb > MOVING_MPS, axis=1) | np.all(climb < -MOVING_MPS, axis=1)
    return float(seconds[np.argmax(steady)]) if steady.any() else onset_s


def cut(log: SampleLog, start_s: float, end_s: float) -> SampleLog:
    """The samples between two times of the vehicle's clock, with the truth."""
    tables = {kind: np.asarray(log[kind]) for kind in Kind}
    kept = {
        kind: table[_within(table, start_s * 1e6, end_s * 1e6)].copy()
        for kind, table in tables.items()
    }
    return SampleLog.of_tables(kept, np.asarray(log.truth))


def _judge(case: Case, log: SampleLog, onset_us: float) -> Row:
    end_us = onset_us + case.lasts_s * 1e6
    tables = {kind: np.asarray(log[kind]).copy() for kind in Kind}
    case.change(tables, onset_us, end_us)
    faulty = SampleLog.of_tables(tables, np.asarray(log.truth))
    said = published(faulty, DEFAULT_ESTIMATOR, CompanionSettings())
    truth = [np.asarray(log.truth[name], np.float64) for name in ("time_us", "altitude_amsl_m")]
    times_us, now_us = said.of("time_us"), said.now_us.astype(np.float64)
    size = np.abs(said.of("altitude_amsl_m") - truth_at(times_us, *truth))
    during = (now_us >= onset_us) & (now_us < max(end_us, onset_us + 1e6))
    after = now_us >= end_us
    sent = said.is_sent & np.isfinite(size) & (now_us >= onset_us)
    named = np.asarray(said.estimates["faulty"])
    sd_m = said.of("altitude_sd_m")
    return {
        "named_s": _first_s(now_us, during & (named == case.sensor), onset_us)
        if case.sensor
        else math.nan,
        "wrong_share": float(np.mean((named[during] != 0) & (named[during] != case.sensor)))
        if during.any()
        else math.nan,
        "sent_max_m": float(np.max(size[sent], initial=0.0)),
        "sent_wrong": int(np.count_nonzero(sent & (size > WRONG_M))),
        "sent_above_level": int(np.count_nonzero(sent & (size > said.of("protection_level_m")))),
        "sent_share": float(np.mean(said.is_sent[during])) if during.any() else math.nan,
        "ok_max_m": float(np.max(size[sent & (said.health == Health.OK)], initial=0.0)),
        "back_s": _back_s(said, log, end_us),
        "first_sent_s": _first_s(now_us, after & said.is_sent, end_us),
        "nees": float(np.nanmean((size[during] / sd_m[during]) ** 2))
        if np.isfinite(size[during]).any()
        else math.nan,
        "ok_after_s": _first_s(now_us, after & (said.health == Health.OK), end_us),
    }


def _known(estimates: Rows) -> tuple[Array, Array]:
    """Times and heights of the estimates that are finite."""
    height_m = np.asarray(estimates["altitude_amsl_m"], np.float64)
    finite = np.isfinite(height_m)
    return np.asarray(estimates["time_us"], np.float64)[finite], height_m[finite]


def _first_s(now_us: Array, is_so: NDArray[np.bool_], since_us: float) -> float:
    return float(now_us[np.argmax(is_so)] - since_us) * 1e-6 if is_so.any() else math.nan


def _back_s(said: Published, log: SampleLog, end_us: float) -> float:
    """Time from the end of the fault until the estimate stays within `BACK_M` of the healthy
    flight's; NaN when it does not come back within `BACK_S`."""
    now_us = said.now_us.astype(np.float64)
    chosen = (now_us >= end_us) & (now_us < end_us + AFTER_S * 1e6)
    healthy, _, _ = run_log(ESTIMATORS[DEFAULT_ESTIMATOR], log)
    there = np.interp(now_us[chosen], *_known(healthy))
    away = ~(np.abs(said.of("altitude_amsl_m")[chosen] - there) <= BACK_M)
    if not away.any():
        return 0.0
    if away[-1]:
        return math.nan
    last = np.flatnonzero(away)[-1]
    return float(now_us[chosen][last + 1] - end_us) * 1e-6
