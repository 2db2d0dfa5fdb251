"""Sessions of a log, and the outcomes of reported cases of group "log"."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.errors import LogFormatError
from companion.evaluation.compare import compare_sessions
from companion.logs.tlog import TlogWriter
from companion.replay.run import Replayed, replay
from companion.settings import CompanionSettings
from tests import logfiles
from tests.flights import HOST_EPOCH_US, flight
from tests.paths import DATA

DAY_US = 86_400_000_000
REPORTED = DATA / "reported"
QUICK = {"duration_s": 150.0, "imu_hz": 10.0, "pressure_hz": 10.0}


def frames(**changes: Any) -> list[tuple[int, bytes]]:
    return logfiles.frames_of(flight(**(QUICK | changes)))


def write(path: Path, *parts: list[tuple[int, bytes]], order: str = ">") -> Path:
    records = (struct.pack(f"{order}Q", time) + data for part in parts for time, data in part)
    path.write_bytes(b"".join(records))
    return path


def shifted(part: list[tuple[int, bytes]], by_us: int) -> list[tuple[int, bytes]]:
    return [(time_us + by_us, data) for time_us, data in part]


def rmses(found: Replayed) -> list[float]:
    return [each["sources"]["estimate"]["rmse_m"] for each in found.report["sessions"]]


def test_boots_and_days_are_sessions_with_their_own_settling(tmp_path: Path) -> None:
    """A reboot, then a day later with a boot clock that goes on: three flights, each right."""
    first, second = frames(boot_s=900.0), frames(boot_s=5.0, start_m=500.0)
    third = frames(boot_s=400.0, start_m=900.0)
    path = write(tmp_path / "a.tlog", first, shifted(second, 200_000_000), shifted(third, DAY_US))
    found = replay(path, settle_s=20.0)
    sessions = found.report["sessions"]
    assert [each["session"] for each in sessions] == [1, 2, 3]
    assert [each["after_reboot"] for each in sessions] == [False, True, False]
    assert sessions[2]["start_utc"] == "2023-11-15T22:13:20.000+00:00"
    assert max(rmses(found)) < 2.5
    for session, start_m in zip(sessions, (300.0, 500.0, 900.0), strict=True):
        assert abs(session["altitude"]["max_m"] - start_m - 240.0) < 25.0
        assert session["duration_s"] == pytest.approx(149.0, abs=3.0)


def test_a_host_clock_that_is_set_in_flight_ends_nothing(tmp_path: Path) -> None:
    part = frames()
    third = len(part) // 3
    before = [(time_us - HOST_EPOCH_US + 60_000_000, data) for time_us, data in part[:third]]
    path = write(tmp_path / "a.tlog", before, part[third:])
    found = replay(path, settle_s=20.0)
    assert len(found.sessions) == 1
    assert rmses(found)[0] < 2.5


def test_stamps_that_are_zero_or_step_change_no_altitude(tmp_path: Path) -> None:
    part = frames()
    plain = replay(write(tmp_path / "a.tlog", part), settle_s=20.0)
    odd = part[:900] + shifted(part[900:1800], -7_200_000_000) + part[1800:]
    odd = [(0 if i % 97 == 0 else time_us, data) for i, (time_us, data) in enumerate(odd)]
    found = replay(write(tmp_path / "b.tlog", odd), settle_s=20.0)
    assert rmses(found) == rmses(plain)


@pytest.mark.parametrize(("order", "scale"), [("<", 1), (">", 1000), ("<", 1000)])
def test_little_endian_and_millisecond_stamps_are_read_right(
    tmp_path: Path, order: str, scale: int
) -> None:
    part = [(time_us // scale, data) for time_us, data in frames()]
    found = replay(write(tmp_path / "a.tlog", part, order=order), settle_s=20.0)
    (session,) = found.report["sessions"]
    assert session["start_utc"] == "2023-11-14T22:13:20.000+00:00"
    assert found.report["damage"] == {}
    assert rmses(found)[0] < 2.5


def test_two_vehicles_are_two_sessions(tmp_path: Path) -> None:
    mine = frames()
    other = [(time_us, _from_system(data, 9)) for time_us, data in frames(start_m=900.0)]
    path = write(tmp_path / "a.tlog", sorted(mine + other, key=lambda each: each[0]))
    found = replay(path, settle_s=20.0)
    assert [each["vehicle"] for each in found.report["sessions"]] == ["7/1", "9/1"]
    assert max(rmses(found)) < 2.5
    only = CompanionSettings.model_validate({"vehicle": {"system_id": 9}})
    assert [each["vehicle"] for each in replay(path, only).report["sessions"]] == ["9/1"]


def _from_system(data: bytes, system_id: int) -> bytes:
    from companion.mavlink.framing import CRC_EXTRA, mcrf4xx

    body = bytearray(data[1:-2])
    body[4] = system_id
    extra = CRC_EXTRA[int.from_bytes(body[6:9], "little")]
    return data[:1] + bytes(body) + mcrf4xx(bytes(body) + bytes([extra])).to_bytes(2, "little")


def test_mostly_junk_is_refused_and_zeros_are_not_junk(tmp_path: Path) -> None:
    good = b"".join(struct.pack(">Q", time) + data for time, data in frames()[:400])
    path = tmp_path / "a.tlog"
    path.write_bytes(good + np.random.default_rng(1).bytes(3 * len(good)))
    with pytest.raises(LogFormatError, match="mostly junk"):
        replay(path)
    path.write_bytes(good + bytes(3 * len(good)))
    assert len(replay(path).sessions) == 1


def test_nothing_usable_says_so(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tlog", frames(pressure_hz=0.0, gnss_hz=0.0))
    with pytest.raises(LogFormatError, match="nothing usable"):
        replay(path)


def test_without_truth_differences_are_to_the_smoother(tmp_path: Path) -> None:
    from companion.mavlink.codec import mavlink

    part = [
        (time_us, data) for time_us, data in frames() if data[7] != mavlink.MAVLINK_MSG_ID_SIM_STATE
    ]
    path = write(tmp_path / "a.tlog", part)
    (session,) = replay(path, settle_s=20.0).report["sessions"]
    assert session["reference"]["kind"] == "smoother"
    assert "nees" not in session["sources"]["estimate"]
    assert session["sources"]["gnss"]["rmse_m"] > 0.1
    ((_, comparison),) = compare_sessions(path, settle_s=20.0, estimators=("vertical-bank",))
    assert comparison.reference == "smoother"
    assert np.isnan(comparison.results[0].nees)


@pytest.mark.parametrize("name", ["bin", "log", "ulg", "raw", "tlog"])
def test_the_log_with_our_altitude_replays_as_the_original(name: str, tmp_path: Path) -> None:
    path, _ = logfiles.write(name, tmp_path, **QUICK)
    out = tmp_path / "out.tlog"
    with TlogWriter(out) as writer:
        found = replay(path, settle_s=20.0, writer=writer)
    again = replay(out, settle_s=20.0)
    assert [each["vehicle"] for each in again.report["sessions"]] == ["7/1"]
    assert rmses(again)[0] == pytest.approx(rmses(found)[0], abs=0.3)
    assert found.report["sessions"][0]["altitude"]["published"] > 500


needs_reported = pytest.mark.skipif(not REPORTED.exists(), reason="the recordings are not here")


@needs_reported
def test_reported_two_days_in_one_file() -> None:
    found = replay(REPORTED / "two_days_in_one_file.tlog", settle_s=5.0)
    assert len(found.sessions) == 2
    assert max(rmses(found)) < 2.0


@needs_reported
def test_reported_raw_capture_taken_for_tlog() -> None:
    found = replay(REPORTED / "raw_capture_taken_for_tlog.tlog", settle_s=20.0)
    assert found.report["format"] == "raw"
    assert rmses(found)[0] < 2.0


@needs_reported
def test_reported_system_id_changes() -> None:
    sessions = replay(REPORTED / "system_id_changes.tlog", settle_s=20.0).report["sessions"]
    assert [each["vehicle"] for each in sessions] == ["1/1", "7/1"]
    assert sessions[0]["duration_s"] == pytest.approx(45.0, abs=2.0)
