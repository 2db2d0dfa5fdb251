"""One flight with GNSS outages of 60, 300 and 600 s, for section ``outages``: how honest the spread
of every estimator is meanwhile, what is published, and how soon after."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.estimators import ESTIMATORS
from companion.evaluation.metrics import Array, truth_at
from companion.evaluation.published import Published, published, share_sent
from companion.health import Health
from companion.jobs import Row
from companion.samples import Kind, SampleLog
from companion.settings import CompanionSettings
from sim.studies.goals.samples import flown
from sim.studies.real.faults import outage
from sim.studies.real.matrix import error_of, recording
from sim.studies.real.recording import Plan

LENGTHS_S = (60.0, 300.0, 600.0)
FIRST_S, CONTACT_S = 180.0, 240.0
"""contact before the first outage, and after each"""
RETURN_S = 30.0
"""for so long after an outage the first ALTITUDE is looked for"""


class Simulated(NamedTuple):
    """A scenario to be flown with a seed."""

    scenario: str
    seed: int


class Recorded(NamedTuple):
    """A real flight, at one IMU rate, with the GNSS error of a seed laid on."""

    path: Path
    imu_hz: int
    seed: int


def fly(job: Simulated | Recorded) -> list[Row]:
    """The rows of a flight, one an outage and estimator; runs in a worker. Raises
    `SimulationError`."""
    if isinstance(job, Simulated):
        log, name = flown(job.scenario, job.seed)[0], job.scenario
    else:
        flight = recording(job.path)
        name = f"{flight.name}, IMU {job.imu_hz} Hz"
        log = flight.samples(Plan(job.imu_hz, True, 0.0, job.seed), error_of(None, job.seed))
    return [{"flight": name, "seed": job.seed} | row for row in measure(log, job.seed)]


def outages_s(duration_s: float, seed: int) -> Iterator[tuple[float, float]]:
    """Start and length of each outage of a flight. Other seeds have another order."""
    start_s, k = FIRST_S, seed
    while True:
        left_s = duration_s - start_s - RETURN_S
        fitting = [length for length in LENGTHS_S if length <= left_s]
        if not fitting:
            return
        length_s = fitting[k % len(fitting)]
        yield start_s, length_s
        start_s, k = start_s + length_s + CONTACT_S, k + 1


def measure(log: SampleLog, seed: int) -> Iterator[Row]:
    """A row for each outage and estimator on a flight with truth."""
    begin_us = float(log.first_us)
    times_us, truth_m = (
        np.asarray(log.truth[name], np.float64) for name in ("time_us", "altitude_amsl_m")
    )
    planned = [
        (begin_us + 1e6 * start_s, 1e6 * length_s)
        for start_s, length_s in outages_s((float(times_us[-1]) - begin_us) * 1e-6, seed)
    ]
    tables = {kind: np.asarray(log[kind]) for kind in Kind}
    for start_us, length_us in planned:
        outage(tables, start_us, start_us + length_us)
    cut = SampleLog.of_tables(tables, np.asarray(log.truth))
    for name in ESTIMATORS:
        said = published(cut, name, CompanionSettings())
        error_m = said.of("altitude_amsl_m") - truth_at(said.times_us, times_us, truth_m)
        for start_us, length_us in planned:
            yield {"estimator": name, "length_s": length_us * 1e-6} | _judged(
                said, error_m, start_us, start_us + length_us
            )


def _judged(said: Published, error_m: Array, start_us: float, end_us: float) -> Row:
    now_us = said.now_us.astype(np.float64)
    during = (now_us >= start_us) & (now_us < end_us) & np.isfinite(error_m)
    sent = during & said.is_sent
    after = (now_us >= end_us) & (now_us < end_us + RETURN_S * 1e6) & said.is_sent
    ratio = error_m / said.of("altitude_sd_m")
    return {
        "nees": float(np.mean(ratio[during] ** 2)) if during.any() else math.nan,
        "max_m": _largest(error_m, during),
        "sent_share": share_sent(said, start_us, end_us),
        "sent_max_m": _largest(error_m, sent),
        "ok_max_m": _largest(error_m, sent & (said.health == Health.OK)),
        "first_sent_s": float(now_us[np.argmax(after)] - end_us) * 1e-6
        if after.any()
        else math.inf,
    }


def _largest(error_m: Array, chosen: NDArray[np.bool_]) -> float:
    return float(np.max(np.abs(error_m[chosen]), initial=0.0))
