"""The loop through a simulated vehicle, closed: it is flown by the altitude that is corrected."""

import math
from dataclasses import replace

import pytest

from sim.studies.feedback import CASES, HOURS, START_S, Case, Job, fly
from sim.studies.feedback_page import errors, page_of, simple_correction_m, slug


@pytest.mark.parametrize("case", [*CASES, *HOURS], ids=lambda case: case.title)
def test_every_case_can_be_flown(case: Case) -> None:
    scenario = case.scenario()
    assert scenario.flown_by == "estimate"


def test_every_case_has_a_figure_of_its_own() -> None:
    names = [slug(case.title) for case in (*CASES, *HOURS)]
    assert len(set(names)) == len(names)


@pytest.mark.long
def test_feedback_holds_what_drifts_without_it() -> None:
    case = replace(CASES[0], duration_s=200.0)
    without, with_feedback = (fly(Job(case, feedback)) for feedback in (False, True))
    assert without[-1]["own_m"] - without[-1]["true_m"] > 4.5
    found = errors(with_feedback, START_S)
    assert abs(with_feedback[-1]["own_m"] - with_feedback[-1]["true_m"]) < 1.5
    assert found["step_m"] <= 0.15
    assert found["writes"] > 30
    assert with_feedback[-1]["raised_m"] < -3.0


def drifting(rate_mps: float, count: int = 600) -> list[dict[str, float]]:
    """A row a second of a vehicle whose altitude drifts from 210 s on."""
    rows = []
    for second in range(count):
        error_m = rate_mps * max(0, second - 210)
        rows.append(
            {
                "time_s": float(second),
                "boots": 0,
                "true_m": 100.0,
                "own_m": 100.0 + error_m,
                "relative_error_m": error_m,
                "raised_m": 0.0,
                "gnss_m": 100.0,
                "ours_m": 100.0,
                "writes": 0,
            }
        )
    return rows


def test_a_simple_correction_lags_by_its_low_pass_and_the_autopilot_s() -> None:
    rows = drifting(0.05)
    for source, time_s in (("gnss_m", 60.0), ("ours_m", 10.0)):
        left_m = rows[-1]["own_m"] - 100.0 + simple_correction_m(rows, source)[-1]
        assert left_m == pytest.approx(0.05 * (time_s + 4.95), abs=0.1)


def test_a_simple_correction_keeps_its_value_without_a_height() -> None:
    rows = drifting(0.05)
    for row in rows[400:]:
        row["gnss_m"] = math.nan
    effects = simple_correction_m(rows, "gnss_m")
    assert effects[-1] == pytest.approx(effects[450], abs=0.01)


def test_errors_and_the_page() -> None:
    rows = drifting(0.05)
    found = errors(rows, START_S)
    assert found["amsl_max_m"] == found["relative_max_m"] == pytest.approx(0.05 * 389)
    page = page_of([("a case", rows, rows)], START_S)
    assert "| a case | 11." in page
    assert "worse than 1.1 times nothing: none" in page
    jump = [row | {"raised_m": 5.0, "boots": 1} if k > 500 else row for k, row in enumerate(rows)]
    assert errors(jump, START_S)["step_m"] == 0.0  # a restart is no write
