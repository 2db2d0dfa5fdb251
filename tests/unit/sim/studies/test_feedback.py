"""The loop through a simulated vehicle, closed: it is flown by the altitude that is corrected."""

from dataclasses import replace

import pytest

from sim.studies.feedback import CASES, HOURS, Case, Job, errors, fly


@pytest.mark.parametrize("case", [*CASES, *HOURS], ids=lambda case: case.name)
def test_every_case_can_be_flown(case: Case) -> None:
    scenario = case.scenario()
    assert scenario.flown_by == "estimate"


def test_feedback_holds_what_drifts_without_it() -> None:
    case = replace(CASES[0], duration_s=200.0)
    without, with_feedback = (fly(Job(case, feedback)) for feedback in (False, True))
    assert without[-1]["own_m"] - without[-1]["true_m"] > 6.0
    found = errors(with_feedback)
    assert abs(with_feedback[-1]["own_m"] - with_feedback[-1]["true_m"]) < 5.0
    assert found["step_m"] <= 0.15
    assert with_feedback[-1]["raised_m"] < -3.0
