"""Recordings by others, whole: no exception, and every published altitude within 50 m of the
healthy source.

The files stay outside the repository (see their README for origin and licence); where they are
absent this is skipped, and `test_quirks` tests the same peculiarities on logs made here.
"""

import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from companion.estimators import DEFAULT_ESTIMATOR, ESTIMATORS
from companion.evaluation.report import Collector
from companion.logs.tlog import TlogReader
from companion.pipeline import Pipeline
from companion.settings import CompanionSettings
from tests.paths import DATA

LIMIT_M = 50.0
LONGEST_S = 60.0


class Case(NamedTuple):
    """What is known of a recording."""

    healthy: str | None
    """the track to compare with: "gnss", "truth", or None where nothing is healthy and nothing may
    be published"""
    published: int
    """at least this many"""
    reboots: int = 0
    slow: bool = False
    long: bool = False


CASES = {
    "real/cuav_2018sitl_flight.tlog": Case("gnss", 700),  # the year 2908
    "real/codelever_2013-10-13_16-58-51.tlog": Case("gnss", 600),  # MAVLink 1, gaps of 6 s
    "real/bruno_20211202-132614.tlog": Case("gnss", 450),  # 1 Hz
    "real/bruno_20211202-133659.tlog": Case("gnss", 20),  # begins at 0, 0, 0; ends in zeros
    "real/bruno_20211123-010337.tlog": Case(None, 0, slow=True),  # indoors: never a fix, alt -17 m
    "real/bruno_20211125-124019.tlog": Case(None, 0),
    "real/pymavlink_swift_flight.tlog": Case("gnss", 6000, reboots=4, long=True),
    "real/dronekit_flight_replay.tlog": Case("gnss", 2400, reboots=1, long=True),  # another dialect
    "real/lester_b_mav.tlog": Case("gnss", 1800, long=True),  # half pressure
    "real/eagle_f759975_mav.tlog": Case("gnss", 2300, slow=True),  # a companion as quadrotor
    "real/ardusub_small.tlog": Case(None, 0),  # injected position at exactly 0 m: no height
    "real/SITL_wlichon_mixed_signed.tlog": Case("gnss", 300),
    "real/SITL_wlichon_twin_sysid2.tlog": Case("gnss", 40),  # alt = alt_ellipsoid, 26 m of doubt
    "real/SITL_uavlogviewer_flight_logs.tlog": Case(
        "gnss", 2700, reboots=1, long=True
    ),  # two boots
    "real/SITL_uavlogviewer_vtol.tlog": Case("gnss", 700),
    "flights/jsbsim_A.tlog": Case("truth", 12_000, long=True),
    "flights/jsbsim_B.tlog": Case("truth", 12_000, long=True),
    "flights/ardupilot_nominal.tlog": Case("truth", 9_500, long=True),
    "flights/ardupilot_weather.tlog": Case("truth", 9_000, long=True),
}


def marks(name: str, estimator: str) -> list[pytest.MarkDecorator]:
    """Slow and long ones."""
    slow, other = CASES[name].slow, estimator != DEFAULT_ESTIMATOR
    if other or CASES[name].long:
        return [pytest.mark.long]
    return [pytest.mark.slow] if slow else []


def cases() -> list[Any]:
    """Every recording with the default estimator; with the others in the long run."""
    return [
        pytest.param(
            name,
            estimator,
            marks=marks(name, estimator),
            id=f"{estimator}-{Path(name).stem}",
        )
        for estimator in ESTIMATORS
        for name in CASES
    ]


@pytest.mark.parametrize(("name", "estimator"), cases())
def test_what_is_published_is_near_the_healthy_source(name: str, estimator: str) -> None:
    path, case = DATA / name, CASES[name]
    if not path.exists():
        pytest.skip("not here")
    collector = Collector()
    settings = CompanionSettings().with_changes(estimator=estimator)
    pipeline = Pipeline(settings, datagrams=True, observer=collector)
    started_s = time.perf_counter()
    for packet in TlogReader(path):
        pipeline.feed(packet)
    assert time.perf_counter() - started_s < LONGEST_S
    times_us, altitudes_m = collector.track("published")
    if estimator == DEFAULT_ESTIMATOR:
        assert times_us.size >= case.published
    assert pipeline.intake.clock.reboots == case.reboots
    if case.healthy is None:
        assert times_us.size == 0
        return
    healthy_us, healthy_m = collector.track(case.healthy)
    expected_m = np.interp(times_us, healthy_us, healthy_m)
    # Others may be silent: the receiver of mixed_signed is in doubt by 26 m, baro-gnss-ins by 30.
    assert np.abs(altitudes_m - expected_m).max(initial=0.0) <= LIMIT_M


@pytest.mark.skipif(not DATA.exists(), reason="the recordings are not here")
def test_every_recording_is_in_the_table() -> None:
    found = {
        str(path.relative_to(DATA))
        for folder in ("real", "flights")
        for path in (DATA / folder).glob("*.tlog")
    }
    assert found == set(CASES)
