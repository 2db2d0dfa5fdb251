"""Every scenario's `expected:`, held against its flight by the function that the gallery and
campaigns use."""

from pathlib import Path

import pytest

from companion.config import validate
from companion.evaluation.samples import samples_of
from companion.samples import Kind
from sim.scenario import Scenario, load_scenario, scenario_paths
from sim.studies.expectations import missed
from sim.studies.runs import flown

QUICK = {"rtk-fallback", "reboot-in-flight"}
"""Scenarios that the slow run flies; the long run flies the others."""
KNOWN_MISSES: dict[str, str] = {
    "airliner-front": "ALTITUDE 81 % of the time: the pressure falls faster than 31 m/h, as a slow"
    " spoofer would show it, and nothing says which: silent",
    "cold-front-descent": "RMSE / raw GNSS 1.26: the front's cold air comes while it descends",
    "iced-static-port": "silent a third of the time: the bank excludes the barometer and is right"
    " to 4 m, but the pressure leaves slowly, and the independent check, which has no IMU, takes"
    " GNSS for the one that left: only an IMU tells that the descent goes on",
    "inversion-approach": "ALTITUDE 91 % of the time: the cold layer ends in the first climb, which"
    " a sliding barometer would show alike (.2 % probable, more than the allowed risk)",
    "spoofed-approach": "follows a spoofer of 0.3 m/s as weather, and is silent in the end",
    "weather-change": "RMSE / raw GNSS 1.40: the pressure falls faster than in any real weather",
}
"""Scenario -> why the default estimator does not meet its demands yet."""


def test_short_hop_meets_its_expectations(short_hop: Path) -> None:
    assert missed(load_scenario("short-hop"), samples_of(short_hop)) == []


def test_each_demand_is_judged(short_hop: Path) -> None:
    log = samples_of(short_hop)
    demands = {
        "published_error_m": 0.01, "published_share": 1.0, "ratio_to_gnss": 0.01, "health": "OK",
        "excluded": ["gnss"],
    }  # fmt: skip
    base = load_scenario("short-hop").model_dump()
    strict = validate(base | {"expected": demands}, Scenario, "a test")
    lines = missed(strict, log)
    assert [line.split()[0] for line in lines][:2] == ["published", "RMSE"]
    assert "gnss never named as faulty" in lines
    log[Kind.GNSS]["altitude_amsl_m"][-100:] += 500.0  # the last 20 s
    never = validate(
        base | {"expected": {"not_excluded": ["gnss"], "published_error_m": 1000}},
        Scenario,
        "a test",
    )
    assert missed(never, log) == ["gnss named as faulty"]


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name in QUICK else pytest.mark.long)
        for name in scenario_paths()
    ],
)
def test_scenario_meets_its_expectations(name: str, request: pytest.FixtureRequest) -> None:
    if name in KNOWN_MISSES:
        request.applymarker(pytest.mark.xfail(reason=KNOWN_MISSES[name]))
    scenario = load_scenario(name)
    with flown(scenario) as (tlog, _):
        log = samples_of(tlog)
    assert missed(scenario, log) == []
