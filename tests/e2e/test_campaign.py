"""Campaigns on real processes: a pool, and a real Dask scheduler with workers on loopback."""

import math
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from xml.etree import ElementTree

import pytest

from companion.config import validate
from companion.jobs import executor_of
from sim.scenario import Scenario, load_scenario
from sim.studies import campaign, runs

ESTIMATOR = ("adaptive-fusion",)


class Here(Executor):
    """Runs a job when it is submitted, and counts."""

    def __init__(self) -> None:
        self.count = 0

    def submit(self, function, /, *arguments, **named):  # type: ignore[no-untyped-def]
        self.count += 1
        future: Future[object] = Future()
        try:
            future.set_result(function(*arguments, **named))
        except Exception as error:
            future.set_exception(error)
        return future


def hop(seed: int = 1, **changes: object) -> campaign.Job:
    return campaign.Job(load_scenario("short-hop").model_copy(update=changes), seed, ESTIMATOR)


def test_a_stopped_campaign_goes_on_where_it_was(tmp_path: Path) -> None:
    first, second = Here(), Here()
    rows = campaign.run([hop(1)], first, tmp_path)
    again = campaign.run([hop(1), hop(2)], second, tmp_path)
    assert (first.count, second.count) == (1, 1)
    assert again[: len(rows)] == rows
    assert campaign.read(tmp_path / "campaign.parquet") == again
    assert {row["source"] for row in rows} == {
        "adaptive-fusion",
        "autopilot's own",
        "raw GNSS",
        "raw barometer",
    }
    (line,) = [line for line in campaign.summary(again) if line["source"] == "adaptive-fusion"]
    assert line["flights"] == 2
    assert 0.5 < line["rmse_m"] < 20


def test_a_failed_flight_is_a_row_and_is_tried_again(tmp_path: Path) -> None:
    bad = hop(1, limit_s=10.0)
    executor = Here()
    rows = campaign.run([bad], executor, tmp_path)
    assert "limit_s" in rows[0]["error"]
    assert len(campaign.failures(rows)) == 1
    campaign.run([bad], executor, tmp_path)
    assert executor.count == 2


def test_a_changed_scenario_is_another_job() -> None:
    jobs = (hop(1), hop(2), hop(1, limit_s=900.0))
    assert len({runs.key_of(campaign.run_job, job) for job in jobs}) == 3


def test_detection_times_come_with_the_rows(tmp_path: Path) -> None:
    """A barometer that jumps by 10 hPa (85 m) on the ground; the second fault is after the end."""
    values = {
        "name": "jump", "summary": "Of a test.", "profile": [{"leg": "wait", "duration_s": 150}],
        "faults": [
            {"fault": "step", "start_s": 100, "duration_s": 30, "size": 1000},
            {"fault": "freeze", "start_s": 900},
        ],
    }  # fmt: skip
    job = campaign.Job(
        validate(values, Scenario, "a test"), 1, ("vertical-bank", "adaptive-fusion")
    )
    rows = campaign.run([job], Here(), tmp_path)
    assert all(row["error"] is None for row in rows), rows
    lines = {
        line["source"]: line
        for line in campaign.summary(campaign.read(tmp_path / "campaign.parquet"))
    }
    ours, simple, raw = (lines[name] for name in ("vertical-bank", "adaptive-fusion", "raw GNSS"))
    assert (ours["faults"], ours["detected"], ours["wrong_share"]) == (1, 1, 0.0)
    assert 0.0 <= ours["detection_s"] < 5.0
    assert (simple["faults"], simple["detected"]) == (1, 0)
    assert math.isnan(simple["detection_s"])
    assert raw["faults"] == 0


class Doomed(Executor):
    """A pool whose worker was killed."""

    def submit(self, function, /, *arguments, **named):  # type: ignore[no-untyped-def]
        future: Future[object] = Future()
        future.set_exception(BrokenProcessPool("killed"))
        return future


def test_a_killed_worker_fails_its_flights_and_not_the_campaign(tmp_path: Path) -> None:
    rows = campaign.run([hop(1), hop(2)], Doomed(), tmp_path)
    assert [row["seed"] for row in rows] == [1, 2]
    assert len(campaign.failures(rows)) == 2
    assert not list((tmp_path / "parts").iterdir())


@pytest.mark.long
def test_a_killed_campaign_goes_on_where_it_was(tmp_path: Path) -> None:
    """SIGKILL to the command and its workers after the first flight; the second run flies the
    others only."""
    command = [
        sys.executable,
        "-m",
        "sim.cli",
        "campaign",
        "short-hop",
        "--seeds",
        "5",
        "--workers",
        "1",
    ]
    command += ["--estimator", "adaptive-fusion", "--out", str(tmp_path)]
    first = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    deadline_s = time.monotonic() + 120.0
    while not list(tmp_path.glob("parts/*.pickle")) and time.monotonic() < deadline_s:
        time.sleep(0.02)
    os.killpg(first.pid, signal.SIGKILL)
    first.wait(20)
    done = {path: path.stat().st_mtime_ns for path in tmp_path.glob("parts/*.pickle")}
    assert 1 <= len(done) < 5
    assert not (tmp_path / "campaign.parquet").exists()
    again = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert again.returncode == 0, again.stderr
    assert {path: path.stat().st_mtime_ns for path in done} == done
    rows = campaign.read(tmp_path / "campaign.parquet")
    assert [row["seed"] for row in rows if row["source"] == "adaptive-fusion"] == [1, 2, 3, 4, 5]


_ORPHANING = """
import os, time
from companion.jobs import executor_of

if __name__ == "__main__":
    with executor_of(1, None) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        pool.submit(time.sleep, 600).result()
"""


def test_workers_end_with_a_parent_that_was_killed(tmp_path: Path) -> None:
    script = tmp_path / "orphaning.py"
    script.write_text(_ORPHANING)
    parent = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    worker = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    parent.stdout.close()
    deadline_s = time.monotonic() + 20.0
    while (
        Path(f"/proc/{worker}/stat").exists()
        and " Z " not in Path(f"/proc/{worker}/stat").read_text()
    ):
        assert time.monotonic() < deadline_s, "the worker outlived its parent"
        time.sleep(0.05)


@pytest.mark.long
def test_command_on_two_processes(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "sim.cli",
        "campaign",
        "short-hop",
        "--seeds",
        "2",
        "--workers",
        "2",
    ]
    done = subprocess.run(
        [
            *(*command, "--estimator", "adaptive-fusion", "--out", str(tmp_path)),
            *("--expect", "max<50", "--expect", "max<0.01"),
            *("--junit", str(tmp_path / "found.xml")),
        ],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 3, done.stderr
    assert "adaptive-fusion" in done.stdout
    assert "short-hop seed 2 adaptive-fusion: max<0.01 NOT met" in done.stderr
    assert len(campaign.read(tmp_path / "campaign.parquet")) == 8
    suite = ElementTree.parse(tmp_path / "found.xml").getroot()
    assert (suite.attrib["tests"], suite.attrib["failures"]) == ("4", "2")


@pytest.mark.slow
@pytest.mark.filterwarnings(
    "ignore::pytest.PytestUnraisableExceptionWarning", "ignore::ResourceWarning"
)
def test_dask_cluster_gives_the_same_rows(tmp_path: Path) -> None:
    """A scheduler and two workers in processes of their own, spoken to over TCP."""
    from distributed import LocalCluster

    timing = {"elapsed_s", "cost_us"}
    jobs = [hop(1), hop(2)]
    here = campaign.run(jobs, Here(), tmp_path / "here")
    with (
        LocalCluster(
            n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
        ) as cluster,
        executor_of(1, cluster.scheduler_address) as executor,
    ):
        there = campaign.run(jobs, executor, tmp_path / "there")
    for a, b in zip(here, there, strict=True):
        assert {k: v for k, v in a.items() if k not in timing} == {
            k: v for k, v in b.items() if k not in timing
        }
