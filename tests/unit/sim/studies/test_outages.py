"""Section ``outages`` of the evaluation: where the outages are, and what is measured of each."""

import math

import numpy as np
import pytest

from companion.estimators import ESTIMATORS
from companion.evaluation.published import published
from companion.jobs import Row
from companion.samples import Kind, SampleLog
from companion.settings import CompanionSettings
from sim.scenario import scenario_paths
from sim.studies.goals import outage_flights
from sim.studies.goals.outage_flights import CONTACT_S, FIRST_S, RETURN_S, measure, outages_s
from sim.studies.goals.sections.outages import BEYOND, SCENARIOS, mean_nees
from sim.studies.real.faults import Change, outage, reboot, short_contact, silence
from tests.flights import flight

DURATION_S = 300.0


def test_outages_fit_and_have_contact_before_them() -> None:
    for duration_s in (100.0, 400.0, 1000.0, 4000.0):
        for seed in (1, 2, 3):
            end_s, lengths = FIRST_S - CONTACT_S, []
            for start_s, length_s in outages_s(duration_s, seed):
                assert start_s - end_s == CONTACT_S
                end_s = start_s + length_s
                lengths.append(length_s)
                assert end_s + RETURN_S <= duration_s
            assert duration_s < FIRST_S + 60.0 or lengths
    whole = [{length for _, length in outages_s(4000.0, seed)} for seed in (1, 2, 3)]
    assert whole == [set(outage_flights.LENGTHS_S)] * 3


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    made = flight(duration_s=DURATION_S, imu_hz=0.0, pressure_hz=5.0, gnss_hz=2.0)
    samples = made.log()
    for time_us in np.arange(made.start_us, made.start_us + DURATION_S * 1e6, 5e5):
        samples.append_truth((int(time_us), float(made.truth_m(time_us)), 0.0))
    return list(measure(samples, seed=1))


def test_every_estimator_is_measured(rows: list[Row]) -> None:
    """A minute without GNSS in standard air: published, honest, and there again at once."""
    assert [row["estimator"] for row in rows] == list(ESTIMATORS)
    for row in rows:
        assert row["length_s"] == 60.0
        assert 0.0 <= row["ok_max_m"] <= row["sent_max_m"] <= row["max_m"] < 15.0
        assert row["nees"] < 1.5, row
        assert row["first_sent_s"] <= 5.0
        assert row["sent_share"] > 0.5


@pytest.mark.parametrize("change", [outage, silence, short_contact, reboot])
@pytest.mark.parametrize("name", ESTIMATORS)
def test_altitude_is_back_within_five_seconds(name: str, change: Change) -> None:
    """After two minutes without GNSS or without anything, with five seconds' contact before, and
    after a restart; with the independent check and the rules of health."""
    made = flight(duration_s=DURATION_S, imu_hz=10.0, pressure_hz=5.0, gnss_hz=2.0)
    onset_us = made.start_us + 100e6
    end_us = onset_us if change is reboot else onset_us + 120e6
    tables = {kind: np.asarray(made.log()[kind]).copy() for kind in Kind}
    change(tables, onset_us, end_us)
    said = published(SampleLog.of_tables(tables, made.log().truth), name, CompanionSettings())
    sent_us = said.now_us[said.is_sent & (said.now_us >= end_us)]
    assert (sent_us[0] - end_us) * 1e-6 <= 5.0
    error_m = said.of("altitude_amsl_m") - made.truth_m(said.of("time_us"))
    assert np.abs(error_m[said.is_sent]).max() < 15.0


def test_the_mean_counts_every_outage_alike() -> None:
    assert mean_nees([{"nees": 1.0}, {"nees": 2.0}]) == 1.5
    assert math.isnan(mean_nees([]))


def test_the_scenarios_exist() -> None:
    assert set(SCENARIOS) | set(BEYOND) <= set(scenario_paths())
