"""The protection level over hours of the sensor-level generator: exceeded as often as it says,
no sensor is excluded."""

from typing import Any

import pytest

from companion.evaluation.integrity import poisson_interval
from sim.studies.goals.sections.protection import Job, work

HOURS = 80


@pytest.fixture(scope="module")
def hours() -> list[dict[str, Any]]:
    return work(Job("sensors", 5000, HOURS))


@pytest.mark.long
def test_level_is_exceeded_as_often_as_allocated(hours: list[dict[str, Any]]) -> None:
    flown_h = sum(row["hours"] for row in hours)
    assert flown_h == pytest.approx(HOURS * 59 / 60, abs=0.1)
    for risk in (1e-1, 1e-2, 1e-3):
        low, high = poisson_interval(sum(row[f"exceedances {risk:g}"] for row in hours), 0.99)
        assert low <= risk * flown_h
        assert high >= 0.1 * risk * flown_h


@pytest.mark.long
def test_no_sensor_is_excluded(hours: list[dict[str, Any]]) -> None:
    assert sum(row["alarms"] for row in hours) == 0
