"""Rules of exclusion over random faults and IMU rates, for every estimator that excludes a sensor.

*Exclusion ends*: once the sensors agree again for 10 s, no sensor stays excluded for longer than
30 s. *The spread covers the disagreement*: while GNSS is not excluded and contradicts the altitude
by d, the spread is d/3 at least and the protection level d, or the altitude is not published.
"""

from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from companion.estimators import ESTIMATORS, run_log
from companion.samples import FaultySensor, Kind
from tests.flights import Flight, flight

Array = NDArray[Any]
EXCLUDES = ("robust-altimeter", "vertical-bank")
LOST_SD_M, LOST_LEVEL_M = 30.0, 50.0
AGREE_S, ENDS_S = 10.0, 30.0
MEAN_S, CONTRADICTS_SD = 5.0, 3.0
HEALTH_CHECKS = list(HealthCheck)
few = partial(settings, deadline=None, derandomize=True)
IMU_HZ = st.sampled_from([0.0, 2.0, 10.0, 25.0])
SEEDS = st.integers(1, 1000)


class Fault(NamedTuple):
    """A height error of one sensor: a step and a ramp, for some seconds."""

    kind: Kind
    step_m: float
    rate_mps: float
    start_s: float
    lasts_s: float

    @property
    def end_s(self) -> float:
        return self.start_s + self.lasts_s

    def on(self, made: Flight) -> Flight:
        """The flight with the fault."""
        table = made.tables[self.kind]
        hit = made.within(self.kind, self.start_s, self.end_s)
        elapsed_s = made.elapsed_s(table["time_us"][hit]) - self.start_s
        error_m = self.step_m + self.rate_mps * elapsed_s
        if self.kind is Kind.GNSS:
            table["altitude_amsl_m"][hit] += error_m
        else:
            table["pressure_pa"][hit] -= 11.6 * error_m
        return made


FAULTS = st.builds(
    Fault,
    st.sampled_from([Kind.GNSS, Kind.PRESSURE]),
    st.sampled_from([0.0, -30.0, 30.0, 100.0]),
    st.sampled_from([0.0, -1.0, 0.5, 2.0]),
    st.floats(90.0, 120.0),
    st.floats(15.0, 60.0),
)


def check_exclusion_ends(name: str, imu_hz: float, seed: int, fault: Fault) -> None:
    made = fault.on(flight(imu_hz=imu_hz, seed=seed, pressure_hz=10.0))
    estimates, _, _ = run_log(ESTIMATORS[name], made.log())
    late = made.elapsed_s(estimates["time_us"]) > fault.end_s + AGREE_S + ENDS_S
    assert late.any()
    assert not estimates["faulty"][late].any()


def check_disagreement(name: str, imu_hz: float, seed: int, fault: Fault) -> None:
    made = fault.on(flight(imu_hz=imu_hz, seed=seed, pressure_hz=10.0))
    log = made.log()
    estimates, _, _ = run_log(ESTIMATORS[name], log)
    order = log.tables.order
    after_fix = np.flatnonzero(np.asarray(order["kind"]) == Kind.GNSS)
    said = np.asarray(estimates)[after_fix]
    fixes = np.asarray(log[Kind.GNSS])[np.asarray(order["row"])[after_fix]]
    apart_m = fixes["altitude_amsl_m"] - said["altitude_amsl_m"]
    size = round(MEAN_S * made.plan.gnss_hz)
    mean_m = np.abs(np.convolve(apart_m, np.full(size, 1.0 / size), "valid"))
    counted = np.convolve(said["faulty"] != FaultySensor.GNSS, np.ones(size), "valid") == size
    level_m, sd_m = (
        sliding_window_view(said[name], size).max(axis=1)
        for name in ("protection_level_m", "altitude_sd_m")
    )  # of the same seconds: a disagreement that has ended was covered while it lasted
    said = said[size - 1 :]
    counted &= mean_m > CONTRADICTS_SD * made.plan.gnss_sd_m
    counted &= made.elapsed_s(said["time_us"]) > 60.0
    is_lost = (sd_m > LOST_SD_M) | (level_m > LOST_LEVEL_M)
    covers = (sd_m >= mean_m / 3.0) & ~(level_m < mean_m)
    wrong = counted & ~is_lost & ~covers
    worst = np.argmax(np.where(wrong, mean_m, 0.0))
    at_s = made.elapsed_s(said["time_us"])
    assert not wrong.any(), (
        f"d {mean_m[worst]:.1f} m, sd {sd_m[worst]:.1f}, level {level_m[worst]:.1f} "
        f"at {at_s[worst]:.0f} s, {wrong.sum()} fixes of {counted.sum()}"
    )


MISSES = {
    "robust-altimeter": "spread 2-3 m at 10-56 m of disagreement in 11 of 12 faults; a sensor "
    "stays excluded after a GNSS ramp in 2",
}
"""What was measured on 2026-11-29 over 12 random faults; vertical-bank: none in 230, but for a
barometer ramp without a usable IMU, where only the priors say whose ramp it is."""
USABLE_HZ = 10.0


def rule(name: str) -> Any:
    missed = pytest.mark.xfail(strict=False, reason=MISSES.get(name, ""))
    return pytest.param(name, marks=missed if name in MISSES else ())


def is_undecidable(imu_hz: float, fault: Fault) -> bool:
    """Whether nothing but a prior says which of two heights slides."""
    return fault.kind is Kind.PRESSURE and fault.rate_mps != 0.0 and imu_hz < USABLE_HZ


@pytest.mark.long
@pytest.mark.parametrize("name", [rule(name) for name in EXCLUDES])
@few(suppress_health_check=HEALTH_CHECKS, max_examples=20)
@given(imu_hz=IMU_HZ, seed=SEEDS, fault=FAULTS)
def test_exclusion_ends(name: str, imu_hz: float, seed: int, fault: Fault) -> None:
    assume(not is_undecidable(imu_hz, fault))
    check_exclusion_ends(name, imu_hz, seed, fault)


@pytest.mark.long
@pytest.mark.parametrize("name", [rule(name) for name in EXCLUDES])
@few(suppress_health_check=HEALTH_CHECKS, max_examples=20)
@given(imu_hz=IMU_HZ, seed=SEEDS, fault=FAULTS)
def test_the_spread_covers_the_disagreement(
    name: str, imu_hz: float, seed: int, fault: Fault
) -> None:
    check_disagreement(name, imu_hz, seed, fault)


RAMPS = st.builds(
    Fault,
    st.just(Kind.PRESSURE),
    st.sampled_from([0.0, -15.0, 15.0]),
    st.sampled_from([-2.0, -1.0, 1.0, 2.0]),
    st.floats(90.0, 120.0),
    st.floats(25.0, 60.0),
)


@pytest.mark.long
@few(suppress_health_check=HEALTH_CHECKS, max_examples=20)
@given(imu_hz=st.sampled_from([10.0, 25.0, 50.0]), seed=SEEDS, fault=RAMPS)
def test_a_barometer_ramp_that_ends_by_a_jump(imu_hz: float, seed: int, fault: Fault) -> None:
    check_exclusion_ends("vertical-bank", imu_hz, seed, fault)
    check_disagreement("vertical-bank", imu_hz, seed, fault)
