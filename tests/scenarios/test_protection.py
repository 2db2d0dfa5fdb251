"""The protection level over hours of the sensor-level generator: exceeded as often as it says,
no sensor is excluded."""

import pytest

from companion.evaluation.integrity import poisson_interval
from sim.studies.goals.sections.protection import Job, work


@pytest.mark.long
def test_level_is_exceeded_as_often_as_allocated() -> None:
    hours = work(Job("sensors", 5000, 80))
    flown_h = sum(row["hours"] for row in hours)
    assert flown_h == pytest.approx(80 * 59 / 60, abs=0.1)
    for risk in (1e-1, 1e-2, 1e-3):
        low, high = poisson_interval(sum(row[f"exceedances {risk:g}"] for row in hours), 0.99)
        assert low <= risk * flown_h
        assert high >= 0.1 * risk * flown_h
    assert sum(row["alarms"] for row in hours) == 0
