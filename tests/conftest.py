"""Fixtures that several test files share."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from sim.flight import Flight
from sim.scenario import load_scenario

# A second try (`--reruns`) makes a new object of a test's class: no reason to fail.
settings.register_profile("reruns", suppress_health_check=[HealthCheck.differing_executors])
settings.load_profile("reruns")


@pytest.fixture(scope="session")
def short_hop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a real JSBSim flight of 3.5 minutes, flown once a session (about a second)."""
    path = tmp_path_factory.mktemp("flights") / "short-hop.tlog"
    Flight(load_scenario("short-hop"), tlog=path).run()
    return path
