"""What the evaluation changes of a flight's samples: exactly that, and nothing else."""

from pathlib import Path

import numpy as np
import pytest

from companion.evaluation.compare import compare_log, takeoff_of
from companion.evaluation.samples import samples_of
from companion.samples import Kind, SampleLog
from companion.settings import CompanionSettings
from sim.studies.goals.samples import (
    copy,
    sample_times,
    thinned,
    with_sea_level_pressure,
    without_gnss,
)


@pytest.fixture(scope="module")
def log(short_hop: Path) -> SampleLog:
    return samples_of(short_hop)


def test_a_copy_is_the_same_samples_in_the_same_order(log: SampleLog) -> None:
    made = copy(log)
    for kind in Kind:
        assert made[kind].tobytes() == log[kind].tobytes()
    assert made.tables.order.tobytes() == log.tables.order.tobytes()
    assert made.truth.tobytes() == log.truth.tobytes()


def test_another_sea_level_pressure_scales_every_pressure_of_the_copy_alone(log: SampleLog) -> None:
    before = np.array(log[Kind.PRESSURE]["pressure_pa"])
    made = with_sea_level_pressure(log, 1200.0)
    np.testing.assert_allclose(
        made[Kind.PRESSURE]["pressure_pa"] / before, 1.0 + 1200.0 / 101_325.0, rtol=1e-12
    )
    np.testing.assert_array_equal(log[Kind.PRESSURE]["pressure_pa"], before)


def test_thinned_streams_are_no_faster_than_asked_for(log: SampleLog) -> None:
    made = thinned(log, {Kind.IMU: 0.25, Kind.GNSS: 1.0})
    for kind, interval_us in ((Kind.IMU, 250_000), (Kind.GNSS, 1_000_000)):
        gaps = np.diff(made[kind]["time_us"])
        assert interval_us - 1000 <= gaps.min() <= gaps.max() < 1.5 * interval_us
    assert made[Kind.PRESSURE].size == log[Kind.PRESSURE].size


def test_an_outage_leaves_out_fixes_and_nothing_else(log: SampleLog) -> None:
    made = without_gnss(log, 30.0, 50.0)
    kinds, times = sample_times(made)
    elapsed_s = (times - log.first_us) * 1e-6
    assert not ((kinds == Kind.GNSS) & (elapsed_s >= 30.0) & (elapsed_s < 50.0)).any()
    gone = len(log) - len(made)
    assert gone == log[Kind.GNSS].size - made[Kind.GNSS].size
    assert gone == pytest.approx(100, abs=2)


def test_height_above_takeoff_counts_from_the_ground(log: SampleLog) -> None:
    truth = log.truth
    times_us, ground_m = takeoff_of(
        log, *(np.asarray(truth[name], np.float64) for name in ("time_us", "altitude_amsl_m"))
    )
    assert truth["time_us"][0] <= times_us < truth["time_us"][-1]
    assert ground_m == pytest.approx(float(truth["altitude_amsl_m"].min()), abs=1.0)
    results = {
        each.label: each
        for each in compare_log(log, CompanionSettings(), estimators=["vertical-bank"]).results
    }
    assert results["raw barometer"].takeoff_rmse_m < 3.0
    assert results["vertical-bank"].takeoff_rmse_m < 3.0


@pytest.mark.slow
def test_the_receivers_own_climb_is_that_of_the_truth() -> None:
    from sim.studies.goals.samples import flown

    without, with_climb = flown("short-hop", 1)
    assert np.isnan(without[Kind.GNSS]["climb_mps"]).all()
    table, truth = with_climb[Kind.GNSS], with_climb.truth
    fixed = table["fix_type"] >= 3
    known = np.isfinite(table["climb_mps"]) & fixed
    assert known.sum() > 0.95 * fixed.sum()
    expected = np.interp(table["time_us"][known], truth["time_us"], truth["climb_mps"])
    assert np.std(table["climb_mps"][known] - expected) == pytest.approx(0.1, abs=0.1)
