"""The simulator's scenarios at the IMU rates of telemetry links: each is flown once and its IMU
samples are thinned."""

from typing import NamedTuple

from companion.estimators import DEFAULT_ESTIMATOR
from companion.evaluation.samples import samples_of
from companion.jobs import Row
from companion.samples import Kind, SampleLog
from sim.scenario import Scenario, load_scenario, scenario_paths
from sim.studies.goals.samples import copy, sample_times, thinned
from sim.studies.real.matrix import measures, warm
from sim.studies.runs import flown

IMU_HZ = (0, 1, 2, 5)
PRESETS = ("real-light-aircraft", "real-small-uav")
"""scenarios with the barometer errors of real flights"""


class Slow(NamedTuple):
    """A scenario, flown with its own seed."""

    scenario: Scenario


def slow_flights() -> list[Slow]:
    """Every scenario that comes with the simulator."""
    return [Slow(load_scenario(name)) for name in scenario_paths()]


def preset_flights(seeds: int) -> list[Slow]:
    """The scenarios of `PRESETS` with seeds 1 to `seeds`."""
    return [
        Slow(load_scenario(name).model_copy(update={"seed": seed}))
        for name in PRESETS
        for seed in range(1, seeds + 1)
    ]


def fly_slow(job: Slow) -> list[Row]:
    """A row for each IMU rate."""
    warm()
    with flown(job.scenario) as (tlog, _):
        log = samples_of(tlog)
    return [
        {"scenario": job.scenario.name, "imu_hz": imu_hz}
        | measures(at_rate(log, imu_hz), DEFAULT_ESTIMATOR)
        for imu_hz in IMU_HZ
    ]


def at_rate(log: SampleLog, imu_hz: int) -> SampleLog:
    """The samples with IMU samples at `imu_hz`; 0 leaves them out."""
    if imu_hz == 0:
        kinds, _ = sample_times(log)
        return copy(log, kinds != Kind.IMU)
    return thinned(log, {Kind.IMU: 1.0 / imu_hz})
