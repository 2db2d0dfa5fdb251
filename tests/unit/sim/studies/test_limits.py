"""The table of limits: what a condition leaves of a log, and what a cell says."""

import math
from pathlib import Path

import pytest

from companion.samples import Packet
from sim.flight import Flight
from sim.scenario import Scenario
from sim.studies import limits
from sim.studies.limits import Outcome, conditions, judge, thinned

CONDITIONS = {condition.name: condition for condition in conditions()}


@pytest.fixture(scope="module")
def packets(tmp_path_factory: pytest.TempPathFactory) -> list[Packet]:
    """80 s at rest in the weather of the table's flight."""
    path = tmp_path_factory.mktemp("limits") / "rest.tlog"
    flown = limits.scenario().model_dump(exclude={"profile"}) | {
        "profile": [{"leg": "wait", "duration_s": 80}]
    }
    Flight(Scenario.model_validate(flown), tlog=path, seed=1).run()
    return thinned(path)


def test_without_gnss_an_altitude_needs_a_setting(packets: list[Packet]) -> None:
    nothing, told, warm = (
        judge(packets, "adaptive-fusion", CONDITIONS[name])
        for name in ("no GNSS", "no GNSS, QNH", "no GNSS, QNH and air temperature")
    )
    assert math.isnan(nothing.rmse_m)
    assert (nothing.sent_ratio, nothing.health) == (0.0, "LOST")
    for outcome in (told, warm):
        assert outcome.rmse_m < 2.0 * outcome.sd_m < 30.0
        assert (outcome.sent_ratio, outcome.health) == (1.0, "DEGRADED")


def test_a_lost_barometer_leaves_gnss(packets: list[Packet]) -> None:
    outcome = judge(packets, "adaptive-fusion", CONDITIONS["no barometer"])
    assert outcome.rmse_m < 15.0
    assert outcome.health == "DEGRADED"


def test_the_page_has_a_row_a_condition_and_a_column_an_estimator(tmp_path: Path) -> None:
    cells = {name: Outcome(2.5, 3.0, 1.0, "OK") for name in CONDITIONS}
    cells["no GNSS"] = Outcome(math.nan, math.nan, 0.0, "LOST")
    text = limits.write({"one": cells, "two": cells}, tmp_path).read_text(encoding="utf-8")
    assert "| condition | one | two |" in text
    assert "| all sensors | 2.5 / 3.0, 100 %, OK | 2.5 / 3.0, 100 %, OK |" in text
    assert "| no GNSS | - / -, 0 %, LOST | - / -, 0 %, LOST |" in text
    assert len(CONDITIONS) == len(conditions())
