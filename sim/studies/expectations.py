"""Checks the demands of a scenario's `expected:` on one flight, for tests, campaigns and the
gallery."""

from collections.abc import Iterator

import numpy as np

from companion.estimators import DEFAULT_ESTIMATOR
from companion.evaluation.compare import SETTLE_S
from companion.evaluation.metrics import errors, truth_at
from companion.evaluation.published import Published, published, share_sent
from companion.health import Health
from companion.samples import FaultySensor, Kind, SampleLog
from companion.settings import CompanionSettings
from sim.scenario import Expected, Scenario

SENSORS = {"barometer": FaultySensor.BAROMETER, "gnss": FaultySensor.GNSS}


def missed(
    scenario: Scenario, log: SampleLog, settings: CompanionSettings | None = None
) -> list[str]:
    """One line for each demand of the scenario that its flight's samples do not meet; none when all
    are met."""
    said = published(log, DEFAULT_ESTIMATOR, settings or CompanionSettings())
    return [*_errors(scenario.expected, log, said), *_states(scenario.expected, log, said)]


def _errors(expected: Expected, log: SampleLog, said: Published) -> Iterator[str]:
    truth = [np.asarray(log.truth[name], np.float64) for name in ("time_us", "altitude_amsl_m")]
    size = np.abs(said.of("altitude_amsl_m") - truth_at(said.times_us, *truth))
    sent = said.is_sent & np.isfinite(size)
    worst_m = float(np.max(size[sent], initial=0.0))
    if worst_m > expected.published_error_m:
        yield f"published error {worst_m:.1f} m, expected <= {expected.published_error_m:g} m"
    if expected.ratio_to_gnss is None:
        return
    late_us = said.times_us[0] + SETTLE_S * 1e6
    ticks = (said.kind == Kind.PRESSURE) & (said.times_us >= late_us)
    gnss = log[Kind.GNSS]
    times_us = np.asarray(gnss["time_us"], np.float64)
    fixed = (np.asarray(gnss["fix_type"]) >= 3) & (times_us >= late_us)
    ours = errors(size[ticks], np.zeros(np.count_nonzero(ticks)))
    raw = errors(np.asarray(gnss["altitude_amsl_m"])[fixed], truth_at(times_us[fixed], *truth))
    if ours is None or raw is None or ours.rmse_m > expected.ratio_to_gnss * raw.rmse_m:
        found = "unknown" if ours is None or raw is None else f"{ours.rmse_m / raw.rmse_m:.2f}"
        yield f"RMSE / raw GNSS {found}, expected <= {expected.ratio_to_gnss:g}"


def _states(expected: Expected, log: SampleLog, said: Published) -> Iterator[str]:
    start_us = float(said.now_us[0]) + SETTLE_S * 1e6
    share = share_sent(said, start_us, float(said.now_us[-1]))
    if share < expected.published_share:
        yield (
            f"ALTITUDE {100 * share:.1f} % of the time, expected >= "
            f"{100 * expected.published_share:g} %"
        )
    at_end = Health(int(said.health[-1]))
    if at_end > Health[expected.health]:
        yield f"health {at_end.name} at the end, expected {expected.health} or better"
    named = set(np.unique(said.estimates["faulty"]).tolist())
    for name in expected.excluded:
        if SENSORS[name] not in named:
            yield f"{name} never named as faulty"
    for name in expected.not_excluded:
        if SENSORS[name] in named:
            yield f"{name} named as faulty"
