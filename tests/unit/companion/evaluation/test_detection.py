"""Exclusions against known faults."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.evaluation.detection import Detection, detection, false_alarms
from companion.evaluation.metrics import Array
from companion.samples import FaultySensor

TIMES_US: Array = np.arange(100, dtype=np.float64) * 1e6
SINCE_US: Array = np.full(100, 38e6)


def excluding(*spans: tuple[int, int, FaultySensor]) -> NDArray[np.int64]:
    """The faulty sensor of each second: (from, until, sensor)."""
    faulty = np.zeros(100, np.int64)
    for begin, end, sensor in spans:
        faulty[begin:end] = sensor
    return faulty


def judged(
    *spans: tuple[int, int, FaultySensor],
    end_s: float = 60.0,
    sensor: FaultySensor = FaultySensor.GNSS,
) -> Detection:
    return detection(TIMES_US, excluding(*spans), SINCE_US, 40e6, end_s * 1e6, sensor)


def test_times_and_shares_of_a_detected_fault() -> None:
    found = judged((45, 63, FaultySensor.GNSS))
    assert found.detected
    assert found.delay_s == pytest.approx(5.0)
    assert found.since_error_s == pytest.approx(-2.0)
    assert (found.named_share, found.wrong_share) == (0.75, 0.0)
    assert found.cleared_s == pytest.approx(3.0)


def test_the_wrong_sensor_is_counted_and_is_no_detection() -> None:
    found = judged((41, 46, FaultySensor.BAROMETER), (50, 100, FaultySensor.GNSS))
    assert found.delay_s == pytest.approx(10.0)
    assert found.wrong_share == 0.25
    other = judged((41, 60, FaultySensor.BAROMETER))
    assert not other.detected
    assert math.isnan(other.since_error_s)
    assert other.wrong_share == pytest.approx(0.95)
    assert other.cleared_s == 0.0


def test_what_is_named_only_afterwards_is_missed() -> None:
    found = judged((61, 70, FaultySensor.GNSS))
    assert not found.detected
    assert found.named_share == 0.0
    assert math.isnan(found.cleared_s)


def test_a_fault_to_the_end_is_never_cleared() -> None:
    found = judged((50, 100, FaultySensor.GNSS), end_s=math.inf)
    assert found.named_share == pytest.approx(50 / 60)
    assert math.isnan(found.cleared_s)


def test_nothing_estimated_is_unknown() -> None:
    found = detection(
        np.zeros(0), np.zeros(0, np.int64), np.zeros(0), 0.0, math.inf, FaultySensor.GNSS
    )
    assert not found.detected
    assert math.isnan(found.named_share)


def test_false_alarms_begin_where_nothing_is_wrong() -> None:
    faulty = excluding(
        (10, 12, FaultySensor.GNSS),
        (12, 14, FaultySensor.IMU),
        (45, 70, FaultySensor.GNSS),
        (80, 90, FaultySensor.BAROMETER),
    )
    assert false_alarms(TIMES_US, faulty) == 4
    assert false_alarms(TIMES_US, faulty, [(40e6, 60e6)]) == 3
    assert false_alarms(TIMES_US, faulty, [(40e6, 60e6), (80e6, math.inf), (0.0, 20e6)]) == 0
    assert false_alarms(np.zeros(0), np.zeros(0, np.int64)) == 0
