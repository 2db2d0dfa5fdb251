"""Real flights: loaders, GNSS errors of recorded logs, and what would be published."""

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from companion.estimators import DEFAULT_ESTIMATOR
from companion.evaluation.published import longest_s, published
from companion.evaluation.samples import samples_of
from companion.logs import open_log
from companion.pipeline import Pipeline
from companion.samples import Kind, SampleLog
from companion.settings import CompanionSettings
from sim.studies.real import found, source_of
from sim.studies.real.gnss_errors import GaussMarkovError, logs, stationary
from sim.studies.real.recording import Plan
from tests.paths import DATA

TRUTH = DATA / "truth"
needs_data = pytest.mark.skipif(not TRUTH.exists(), reason="the real flights are not here")


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SampleLog, SampleLog]:
    """Ten minutes of a real flight: the tlog of the data's own maker, its samples, and ours."""
    folder = tmp_path_factory.mktemp("real")
    rows = (TRUTH / "g1000_KCKN.csv").read_text(errors="replace").splitlines(keepends=True)
    csv, tlog = folder / "short.csv", folder / "short.tlog"
    csv.write_text("".join(rows[:400]))
    command = [sys.executable, str(TRUTH / "make_flights.py"), str(csv), str(tlog)]
    subprocess.run([*command, "--imu", "10", "--seed", "3", "--lag", "0"], check=True)
    source = source_of(csv)
    assert source is not None
    return tlog, samples_of(tlog), source(csv).samples(Plan(10, True, 0.0, 3), GaussMarkovError())


@needs_data
class TestAgainstTheLog:
    @pytest.mark.parametrize(
        ("kind", "field", "tolerance"),
        [
            (Kind.PRESSURE, "pressure_pa", 0.01),
            (Kind.PRESSURE, "die_temperature_k", 0.011),
            (Kind.GNSS, "altitude_amsl_m", 0.0011),
            (Kind.GNSS, "latitude_deg", 1.1e-7),
            (Kind.GNSS, "vertical_sd_m", 1e-6),
            (Kind.GNSS, "ground_speed_mps", 0.011),
            (Kind.ATTITUDE, "roll_rad", 1e-6),
            (Kind.ATTITUDE, "angular_rate_b_radps", 1e-5),
            (Kind.IMU, "specific_force_b_mps2", 0.0099),
            (Kind.IMU, "angular_rate_b_radps", 0.0011),
        ],
    )
    def test_samples_are_those_of_the_log(
        self, both: tuple[Path, SampleLog, SampleLog], kind: Kind, field: str, tolerance: float
    ) -> None:
        _, logged, made = both
        assert abs(len(logged[kind]) - len(made[kind])) <= 1
        size = min(len(logged[kind]), len(made[kind]))
        one, other = logged[kind][-size:], made[kind][-size:]
        assert np.max(np.abs(one["time_us"] - other["time_us"])) <= 1000
        assert np.nanmax(np.abs(one[field] - other[field])) <= tolerance
        assert np.array_equal(np.isnan(one[field]), np.isnan(other[field]))

    def test_published_is_what_the_pipeline_sends(
        self, both: tuple[Path, SampleLog, SampleLog]
    ) -> None:
        tlog, logged, made = both
        sent: list[tuple[int, float]] = []

        class Tap:
            def sample(self, *_: object) -> None: ...
            def truth(self, *_: object) -> None: ...
            def autopilot(self, *_: object) -> None: ...
            def published(self, message: object) -> None:
                sent.append((message.time_usec, message.altitude_amsl))  # type: ignore[attr-defined]

        pipeline = Pipeline(CompanionSettings(), datagrams=True, observer=Tap())
        for time_us, frame in open_log(tlog).items(pipeline.wanted):
            pipeline.feed_item(frame, time_us)
        times_us, heights_m = np.array(sent, np.float64).T
        for log in (logged, made):
            said = published(log, DEFAULT_ESTIMATOR, CompanionSettings())
            ours_us = said.of("time_us")[said.is_sent]
            ours_m = said.of("altitude_amsl_m")[said.is_sent]
            # IMU samples fill slots that ours leaves to the next pressure
            assert ours_us.size == pytest.approx(times_us.size, rel=0.1)
            late = ours_us > ours_us[0] + 10e6
            error_m = ours_m[late] - np.interp(ours_us[late], times_us, heights_m)
            assert np.max(np.abs(error_m)) < 0.5


@needs_data
def test_flights_are_found_by_format(tmp_path: Path) -> None:
    copied = tmp_path / "held back" / "x.csv"
    copied.parent.mkdir()
    copied.write_bytes((TRUTH / "g1000_KCKN.csv").read_bytes())
    (tmp_path / "other.csv").write_bytes((TRUTH / "nyc_metar_2013.csv").read_bytes()[:5000])
    (tmp_path / "other.npz").write_bytes((TRUTH / "soundings.npz").read_bytes())
    assert found(tmp_path) == [copied]
    assert {path.name for path in found(TRUTH)} >= {"carbonix_rtk.npz", "flight_1936026.csv"}


@needs_data
def test_rtk_receiver_is_near_its_truth() -> None:
    path = TRUTH / "carbonix_rtk.npz"
    source = source_of(path)
    assert source is not None
    log = source(path).samples(Plan(50, True, 0.0, 1), None)
    gnss, truth = log[Kind.GNSS], log.truth
    there = np.interp(gnss["time_us"], truth["time_us"], truth["altitude_amsl_m"])
    assert np.sqrt(np.mean((gnss["altitude_amsl_m"] - there)[50:-50] ** 2)) < 0.1
    assert np.median(gnss["fix_type"]) == 6
    force = np.linalg.norm(log[Kind.IMU]["specific_force_b_mps2"], axis=1)
    assert np.median(force) == pytest.approx(9.8, abs=0.2)
    rate_hz = 1e6 / np.median(np.diff(log[Kind.IMU]["time_us"]))
    assert rate_hz == pytest.approx(50.0, rel=0.05)


@pytest.mark.long
@pytest.mark.skipif(not (DATA / "real").exists(), reason="the recorded logs are not here")
def test_a_stationary_receiver_is_found_and_runs_to_and_fro() -> None:
    (stretch,) = stationary(DATA / "real" / "eagle_f759975_mav.tlog")
    assert stretch.time_s[-1] > 600.0
    assert np.std(stretch.error_m) > 3.0  # its height goes from 20 to 49 m
    assert np.median(stretch.vertical_sd_m) == pytest.approx(0.8, abs=0.1)
    grid_s = np.arange(0.0, 3000.0, 0.02)
    said = stretch.at(grid_s, np.random.default_rng(1))
    assert np.max(np.abs(said.error_m)) <= np.max(np.abs(stretch.error_m))
    assert np.max(np.abs(np.diff(said.error_m))) < 1.0  # no jump where it turns
    assert not stationary(DATA / "flights" / "jsbsim_A.tlog")  # a simulator's


def test_nothing_stands_still_in_an_empty_folder(tmp_path: Path) -> None:
    assert logs(tmp_path) == []
    assert found(tmp_path) == []


def test_gauss_markov_error_has_its_spread() -> None:
    grid_s = np.arange(0.0, 40_000.0, 0.02)
    said = GaussMarkovError(4.0).at(grid_s, np.random.default_rng(1))
    assert np.std(said.error_m) == pytest.approx(4.0, rel=0.25)
    assert set(said.vertical_sd_m) == {4.0}


def test_longest_time_of_a_condition() -> None:
    times_us = np.array([0.0, 1e6, 2e6, 5e6, 6e6])
    assert longest_s(times_us, np.array([True, True, False, True, True])) == 1.0
    assert longest_s(times_us, np.zeros(5, bool)) == 0.0
    assert not math.isnan(longest_s(times_us, np.ones(5, bool)))
