"""Which sensor is wrong: the probability of the modes that say so, and since when."""

import numpy as np

from companion.estimators.vertical_bank.mixture import (
    N,
    baro_is_wrong,
    gnss_is_wrong,
    imu_is_wrong,
)
from companion.jit import step
from companion.samples import FaultySensor, Record

NOBODY, BAROMETER, GNSS_HEIGHT, INERTIAL = (int(fault) for fault in FaultySensor)
EVEN = 0.5
"""Probability below which a sensor that was named is used again."""

ATTRIBUTION = np.dtype([("since_us", "i8", (len(FaultySensor),))], align=True)  # -1 not named


@step
def attribution_start(named: Record) -> None:
    """No sensor is wrong."""
    for fault in range(named.since_us.size):
        named.since_us[fault] = -1


@step
def fault_probability(bank: Record, fault: int) -> float:
    """Probability of the hypotheses that say that this sensor is wrong."""
    total = 0.0
    for i in range(N):
        wrong = (
            (fault == BAROMETER and baro_is_wrong(i))
            or (fault == GNSS_HEIGHT and gnss_is_wrong(i))
            or (fault == INERTIAL and imu_is_wrong(i))
        )
        if wrong:
            total += bank.weight[i]
    return total


@step
def attribute(named: Record, bank: Record, limit: float, is_blind: bool) -> None:
    """Name the sensors whose faulty modes are more probable than `limit`, until that is even. A
    manoeuvre that is missed without an IMU is no fault."""
    for fault in range(1, named.since_us.size):
        probability = fault_probability(bank, fault)
        if fault == INERTIAL and is_blind:
            probability = 0.0
        if named.since_us[fault] < 0 and probability > limit:
            named.since_us[fault] = bank.now_us
        elif named.since_us[fault] >= 0 and probability < EVEN:
            named.since_us[fault] = -1


@step
def is_named(named: Record, fault: int) -> bool:
    """Whether a sensor is excluded now."""
    return named.since_us[fault] >= 0


@step
def named_fault(named: Record) -> int:
    """The sensor that has been wrong for longest, `FaultySensor.NONE` if all are well."""
    found = NOBODY
    for fault in range(1, named.since_us.size):
        earlier = found == NOBODY or named.since_us[fault] < named.since_us[found]
        if named.since_us[fault] >= 0 and earlier:
            found = fault
    return found
