"""Recordings: names, sessions, rotation, free space, a disk that is full."""

import logging
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from companion.errors import LogFormatError
from companion.logs.tlog import TlogReader
from companion.recording import Recording, RecordSettings
from tests.paths import ROOT
from tests.vehicle import Vehicle, heartbeat

START_US = 1_700_000_000_000_000  # 2023-11-14 22:13:20 UTC
FRAME = Vehicle().pack(heartbeat())


def frames(path: Path) -> int:
    return sum(1 for _ in TlogReader(path))


def write(recording: Recording, seconds: range) -> None:
    for second in seconds:
        recording.write(START_US + second * 1_000_000, FRAME)


def test_folder_gets_one_dated_file_a_session(tmp_path: Path) -> None:
    with Recording(tmp_path) as recording:
        write(recording, range(10))
        time.sleep(0.3)
        write(recording, range(1000, 1010))
    assert [path.name for path in recording.paths] == [
        "kollsman-20231114T221320Z.tlog",
        "kollsman-20231114T223000Z.tlog",
    ]
    assert [frames(path) for path in recording.paths] == [10, 10]


def test_two_sessions_in_one_batch_are_two_files(tmp_path: Path) -> None:
    with Recording(tmp_path / "new" / "folder") as recording:
        write(recording, range(3))
        write(recording, range(5000, 5004))
    assert [frames(path) for path in recording.paths] == [3, 4]


def test_an_existing_file_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"the last flight")
    for _ in range(2):
        with Recording(path) as recording:
            write(recording, range(3))
    assert path.read_bytes() == b"the last flight"
    assert [frames(tmp_path / f"flight-{number}.tlog") for number in (2, 3)] == [3, 3]


def test_pattern_is_filled_with_the_date(tmp_path: Path) -> None:
    with Recording(tmp_path / "%Y-%m-%d" / "%H%M%S.tlog") as recording:
        write(recording, range(3))
    assert frames(tmp_path / "2023-11-14" / "221320.tlog") == 3


def test_rotation_by_size_loses_nothing(tmp_path: Path) -> None:
    with Recording(tmp_path, RecordSettings(rotate_mb=0.1)) as recording:
        for batch in range(6):
            write(recording, range(batch * 2000, (batch + 1) * 2000))
            time.sleep(0.25)
    assert len(recording.paths) >= 2
    assert sum(frames(path) for path in recording.paths) == 12_000
    assert recording.dropped == 0


def test_nothing_is_written_when_the_disk_has_little_space(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    logging.getLogger("kollsman.recording").disabled = False  # import-linter disables loggers
    with Recording(tmp_path, RecordSettings(free_mb=100_000_000)) as recording:
        write(recording, range(3))
        time.sleep(0.3)
        write(recording, range(3, 6))
    assert list(tmp_path.iterdir()) == []
    assert recording.dropped == 6
    assert [record.levelname for record in caplog.records].count("ERROR") == 1


def test_a_file_that_cannot_grow_keeps_whole_records(tmp_path: Path) -> None:
    """A file-size limit stands for a full disk: the kernel writes a part, then refuses."""
    script = """
import resource, signal, sys, time
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
from companion.recording import Recording, RecordSettings
from tests.unit.companion.test_recording import FRAME, START_US
with Recording(sys.argv[1], RecordSettings(free_mb=0)) as recording:
    for second in range(100):
        recording.write(START_US + second * 1000000, FRAME)
        if second % 10 == 9:
            time.sleep(0.12)
print(recording.dropped, *recording.paths)
"""
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=True,
    )
    dropped, path = done.stdout.split()
    whole = 1000 // (8 + len(FRAME))
    assert frames(Path(path)) + int(dropped) == 100
    assert 10 <= frames(Path(path)) <= whole
    assert "recording pauses" in done.stderr or int(dropped) > 0


def test_playable_after_kill(tmp_path: Path) -> None:
    script = """
import os, signal, sys, time
from companion.recording import Recording
from tests.unit.companion.test_recording import FRAME, START_US
recording = Recording(sys.argv[1])
for second in range(200):
    recording.write(START_US + second * 10000, FRAME)
time.sleep(0.5)
os.kill(os.getpid(), signal.SIGKILL)
"""
    done = subprocess.run([sys.executable, "-c", script, str(tmp_path)], cwd=ROOT, check=False)
    assert done.returncode == -signal.SIGKILL
    (path,) = tmp_path.iterdir()
    assert frames(path) == 200


def test_a_bad_folder_is_told_at_the_start(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(LogFormatError, match="cannot be made"):
        Recording(tmp_path / "file" / "a.tlog")
    if os.getuid() != 0:
        tmp_path.chmod(0o500)
        with pytest.raises(LogFormatError, match="permission denied"):
            Recording(tmp_path)


def test_memory_is_bounded_while_the_disk_hangs(tmp_path: Path) -> None:
    recording = Recording(tmp_path)
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for number in range(100_000):
        recording.write(START_US + number, FRAME)
    recording.close()
    assert recording.dropped > 0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 50_000
