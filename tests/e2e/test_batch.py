"""Batches on real processes: a pool whose worker is killed, and a real Dask scheduler on
loopback."""

import json
import os
import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from companion import jobs
from companion.errors import ConfigError
from companion.replay.batch import BatchFailedError, BatchJob, find_logs, run_batch
from tests import logfiles

SMALL = {"duration_s": 40.0, "imu_hz": 4.0, "pressure_hz": 5.0, "gnss_hz": 2.0, "attitude_hz": 4.0}
GOOD = 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs of every format, one of them wrong by 200 m, and two that are none."""
    root = tmp_path_factory.mktemp("logs")
    for index, name in enumerate(("tlog", "bin", "ulg", "log", "raw", "tlog")):
        place = root / f"{index}"
        place.mkdir()
        logfiles.write(name, place, seed=index, **SMALL)
    (root / "text.log").write_text("this is no log\n", encoding="ascii")
    (root / "noise.tlog").write_bytes(os.urandom(4000))
    return root


def batch(folder: Path, out: Path, **options: Any) -> list[jobs.Row]:
    return run_batch(find_logs([str(folder)]), out, settle_s=20.0, **options)


def check(table: list[jobs.Row], out: Path) -> None:
    """Every log once, with rows where it could be read."""
    names = [(row["log"], row["session"]) for row in table]
    assert len(set(names)) == len(names) == GOOD + 2
    unread = [row for row in table if row["error"] is not None]
    assert [row["error"] is not None for row in table] == [False] * GOOD + [True] * 2
    assert len({row["error"] for row in unread}) == 2
    assert all((out / "rows" / row["rows"]).exists() for row in table if row["error"] is None)
    assert len(list((out / "rows").iterdir())) == GOOD
    document = json.loads((out / "fleet.json").read_text())
    assert document["schema"] == "kollsman-report/1"
    assert len(document["sessions"]) == len(table)
    links = re.findall(r'<a href="([^"]+)"', (out / "index.html").read_text(encoding="utf-8"))
    assert len(set(links)) == GOOD
    assert all((out / link).is_file() for link in links)


def test_a_batch_goes_on_where_it_was_stopped(folder: Path, tmp_path: Path) -> None:
    from pyarrow import parquet

    half = find_logs([str(folder)])[:3]
    run_batch(half, tmp_path, settle_s=20.0, workers=1)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "rows").iterdir()}
    counts: list[int] = []
    table = batch(folder, tmp_path, workers=1, on_done=lambda count, _: counts.append(count))
    check(table, tmp_path)
    assert counts == list(range(3, 9))  # three were kept
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in before.items())
    rows = parquet.read_table(tmp_path / "rows" / table[0]["rows"])
    assert {"utc", "session", "altitude_amsl_m", "qnh_sd_hpa", "verdict"} <= set(rows.column_names)


def _kill_itself_once(job: BatchJob) -> list[jobs.Row]:
    from companion.replay.batch import replay_job

    mark = job.out / "killed"
    if job.log.suffix == ".ulg" and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return replay_job(job)


@pytest.mark.long
def test_a_pool_survives_a_worker_that_was_killed(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("companion.replay.batch.replay_job", _kill_itself_once)
    check(batch(folder, tmp_path, workers=2), tmp_path)
    assert (tmp_path / "killed").exists()


@pytest.fixture
def cluster() -> Iterator[Any]:
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
    ) as started:
        yield started


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_dask_cluster_loses_nothing_with_a_worker(
    folder: Path, tmp_path: Path, cluster: Any
) -> None:
    """One of two workers is killed after the first log: every log once."""
    pids = [worker.process.pid for worker in cluster.workers.values()]

    def kill_one(count: int, newest: Any) -> None:
        if newest is not None and pids:
            os.kill(pids.pop(), signal.SIGKILL)
            pids.clear()
            time.sleep(0.1)

    table = batch(folder, tmp_path, scheduler=cluster.scheduler_address, on_done=kill_one)
    check(table, tmp_path)


def test_finds_logs_by_folder_pattern_and_name(folder: Path) -> None:
    assert len(find_logs([str(folder)])) == GOOD + 2
    assert len(find_logs([f"{folder}/**/*.tlog"])) == 3
    assert find_logs([str(folder / "text.log")]) == [folder / "text.log"]
    place = folder / "0"
    assert len(find_logs([str(place), f"{place}/../0", *map(str, find_logs([str(place)]))])) == 1
    with pytest.raises(ConfigError, match=r"no log in .*nothing"):
        find_logs([str(folder), f"{folder}/*.nothing"])


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a file that is always full")
def test_a_full_disk_is_not_kept_as_a_fault_of_the_log(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The batch says so at its end, and the next run tries the log again."""
    logs = find_logs([str(folder / "0")])
    rows = tmp_path / "rows"
    rows.mkdir()
    key = BatchJob(logs[0], tmp_path.resolve(), 20.0).key
    (rows / f"{key}.parquet.partial").symlink_to("/dev/full")
    with pytest.raises(BatchFailedError, match="1 logs failed, the first with: ") as failure:
        run_batch(logs, tmp_path, settle_s=20.0, reports=False)
    assert "cannot be written" in failure.value.table[0]["error"]
    (rows / f"{key}.parquet.partial").unlink(missing_ok=True)
    assert run_batch(logs, tmp_path, settle_s=20.0, reports=False)[0]["error"] is None


@pytest.mark.long
def test_no_scheduler_is_one_clear_line(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no Dask scheduler answers"):
        batch(folder, tmp_path, scheduler="tcp://127.0.0.1:1")
