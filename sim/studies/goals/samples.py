"""Copies of recorded or flown samples with something changed: what the estimator gets, not the
log."""

import numpy as np
from numpy.typing import NDArray

from companion.evaluation.samples import samples_of
from companion.samples import Kind, SampleLog
from companion.settings import CompanionSettings
from sim.scenario import load_scenario
from sim.sensors.gnss import Fix
from sim.studies import runs
from sim.studies.goals.sensor_level import Array

STANDARD_PA = 101_325.0
MATCH_US = 50_000.0


def flown(scenario: str, seed: int) -> tuple[SampleLog, SampleLog]:
    """A simulated flight's samples, as GPS_RAW_INT has them and with the receiver's own vertical
    velocity, as the autopilot's own log would. Raises `SimulationError`."""
    fixes: list[Fix] = []
    settings = CompanionSettings()
    with runs.flown(load_scenario(scenario), seed, on_fix=fixes.append) as (tlog, _):
        log = samples_of(tlog, settings)
    with_climb = copy(log)
    table = with_climb[Kind.GNSS]
    stamps = np.array([fix.stamp_us for fix in fixes], np.float64)
    wanted = np.asarray(table["time_us"], np.float64) + settings.intake.gnss_latency_s * 1e6
    nearest = np.clip(np.searchsorted(stamps, wanted - MATCH_US), 0, stamps.size - 1)
    climbs = np.array([fix.climb_mps for fix in fixes])
    table["climb_mps"] = np.where(
        np.abs(stamps[nearest] - wanted) <= MATCH_US, climbs[nearest], np.nan
    )
    return log, with_climb


def copy(log: SampleLog, keep: NDArray[np.bool_] | None = None) -> SampleLog:
    """The samples, or those for which `keep`, shape (len(log),), is true."""
    made = SampleLog()
    order = log.tables.order
    tables = {int(kind): log[kind] for kind in Kind}
    chosen = np.flatnonzero(keep) if keep is not None else np.arange(len(log))
    for kind, row in zip(
        order["kind"][chosen].tolist(), order["row"][chosen].tolist(), strict=True
    ):
        made.append(Kind(kind), tables[kind][row : row + 1])
    for height in log.truth:
        made.append_truth((height["time_us"], height["altitude_amsl_m"], height["climb_mps"]))
    return made


def with_sea_level_pressure(log: SampleLog, change_pa: float) -> SampleLog:
    """All pressures scaled as another sea-level pressure would."""
    made = copy(log)
    made[Kind.PRESSURE]["pressure_pa"] *= 1.0 + change_pa / STANDARD_PA
    return made


def thinned(log: SampleLog, intervals_s: dict[Kind, float]) -> SampleLog:
    """Only samples that are at least so much newer than the last one kept of their kind and
    instance."""
    kinds, times = sample_times(log)
    instances = np.zeros(len(log), np.int64)
    for kind in Kind:
        instances[kinds == kind] = log[kind]["instance"]
    keep = np.ones(len(log), bool)
    last: dict[tuple[int, int], float] = {}
    for i, (kind, instance, time_us) in enumerate(
        zip(kinds.tolist(), instances.tolist(), times.tolist(), strict=True)
    ):
        interval_s = intervals_s.get(Kind(kind))
        if interval_s is None:
            continue
        keep[i] = time_us - last.get((kind, instance), -np.inf) >= interval_s * 1e6 - 1e3
        if keep[i]:
            last[kind, instance] = time_us
    return copy(log, keep)


def without_gnss(log: SampleLog, start_s: float, end_s: float) -> SampleLog:
    """No fixes between two times since the first sample."""
    kinds, times = sample_times(log)
    elapsed_s = (times - log.first_us) * 1e-6
    return copy(log, ~((kinds == Kind.GNSS) & (elapsed_s >= start_s) & (elapsed_s < end_s)))


def sample_times(log: SampleLog) -> tuple[NDArray[np.int64], Array]:
    """Kind and time (us) of every sample in order of arrival; a copy has the rows of a kind in that
    order."""
    order = log.tables.order
    kinds, times = np.asarray(order["kind"]), np.zeros(len(log))
    for kind in Kind:
        times[kinds == kind] = log[kind]["time_us"][order["row"][kinds == kind]]
    return kinds, times
