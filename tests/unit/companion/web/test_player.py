"""A log on the live page: its pace, and what is shown of it."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from companion.mavlink.codec import Encoder, Frame, mavlink, scan
from companion.replay.run import replay
from companion.replay.schema import ALTITUDE_KEYS, SESSION_KEYS
from companion.settings import CompanionSettings
from companion.web.board import Board
from companion.web.player import LogClock, Player
from tests import flights, logfiles

SMALL: dict[str, Any] = {
    "duration_s": 60.0,
    "imu_hz": 4.0,
    "pressure_hz": 5.0,
    "gnss_hz": 2.0,
    "attitude_hz": 4.0,
}
START_US = 1_600_000_000_000_000


class Real:
    """Real time that passes only when it is slept."""

    def __init__(self) -> None:
        self.now_s = 50.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        assert duration_s > 0.0
        self.now_s += duration_s


@pytest.mark.parametrize("speed", [0.5, 1.0, 20.0])
def test_a_minute_of_the_log_takes_as_long_as_the_speed_says(speed: float) -> None:
    real, seen = Real(), []
    clock = LogClock(speed, real.monotonic, real.sleep)
    for k in range(601):
        clock.reach(START_US + k * 100_000, lambda: seen.append(clock.now_us()))
    assert real.now_s - 50.0 == pytest.approx(60.0 / speed, rel=1e-3)
    assert seen == sorted(seen)  # it goes on between the frames
    assert len(seen) > 40.0 / speed / 0.05


def test_gaps_are_skipped_and_the_clock_never_goes_back() -> None:
    real = Real()
    clock = LogClock(1.0, real.monotonic, real.sleep)
    for after_us in (0, 1_000_000, 86_400_000_000, 86_401_000_000, 5_000_000, 6_000_000):
        before_us = clock.now_us()
        clock.reach(START_US + after_us, lambda: None)
        assert clock.now_us() >= before_us
    assert real.now_s - 50.0 == pytest.approx(3.0, abs=0.2)


@pytest.mark.parametrize("form", ["tlog", "bin"])
def test_the_state_has_the_schema_and_the_figures_of_the_replay(form: str, tmp_path: Path) -> None:
    if form == "tlog":
        log = tmp_path / "flight.tlog"
        logfiles.write_tlog(log, flights.flight(**SMALL))
    else:
        log, _ = logfiles.write(form, tmp_path, **SMALL)
    board, settings = Board(), CompanionSettings()
    player = Player(log, board, settings, LogClock(math.inf))
    found = replay(log, settings, writer=player, observe=player.observe)
    player.end()
    snapshot = board.newest
    assert snapshot is not None
    assert board.has_ended
    state = json.loads(json.dumps(snapshot.document, allow_nan=False))
    assert (state["command"], state["log"]) == ("replay", str(log))
    session, told = state["sessions"][0], found.report["sessions"][0]
    assert set(told) == set(SESSION_KEYS) <= set(session)
    assert set(told["altitude"]) == set(ALTITUDE_KEYS) == set(session["altitude"])
    assert session["vehicle"] == told["vehicle"]
    assert session["duration_s"] == pytest.approx(told["duration_s"], abs=2.0)
    assert session["altitude"]["last_m"] == pytest.approx(told["altitude"]["last_m"], abs=2.0)
    assert session["sensors"]["pressure"]["rate_hz"] == pytest.approx(5.0, abs=1.0)
    assert session["sensors"]["pressure"]["age_s"] < 1.0
    assert session["altitude"]["published"] == player.published > 100
    assert session["link"]["frames"] > 500
    assert any(each["from"] == "Kollsman" for each in session["texts"])
    rows = json.loads(b"".join(board.history()))["rows"]
    assert len(rows) > 100


def test_what_is_shown_changes_no_result(tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    logfiles.write_tlog(log, flights.flight(**SMALL))
    player = Player(log, Board(), CompanionSettings(), LogClock(math.inf))
    shown = replay(log, writer=player, observe=player.observe)
    plain = replay(log)
    assert [each.seen.rows.tobytes() for each in shown.sessions] == [
        each.seen.rows.tobytes() for each in plain.sessions
    ]


def test_the_frames_go_on_to_the_log_that_is_written(tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    logfiles.write_tlog(log, flights.flight(**(SMALL | {"duration_s": 5.0})))
    written: list[bytes] = []

    class Onward:
        def write(self, time_us: int, frame: bytes) -> None:
            written.append(frame)

    player = Player(log, Board(), CompanionSettings(), LogClock(math.inf), Onward())
    replay(log, writer=player, observe=player.observe)
    assert len(written) > 50


def test_a_radio_is_shown_with_its_age(tmp_path: Path) -> None:
    log, radio = tmp_path / "flight.tlog", Encoder(51, 68)
    logfiles.write_tlog(log, flights.flight(**(SMALL | {"duration_s": 5.0})))
    status = mavlink.MAVLink_radio_status_message(187, 255, 90, 43, 45, 7, 3)
    board = Board()
    player = Player(log, board, CompanionSettings(), LogClock(math.inf))
    replay(log, writer=player, observe=player.observe)
    assert board.newest is not None
    assert board.newest.document["sessions"][0]["link"]["radio"] is None
    now_us = player.clock.now_us()
    player.write(now_us, radio.encode(status))
    player.write(now_us + 2_000_000, log_frame(log))
    shown = board.newest.document["sessions"][0]["link"]["radio"]
    assert shown == {
        "rssi": 187, "remote_rssi": None, "noise": 43, "remote_noise": 45,
        "receive_errors": 7, "corrected": 3, "free_buffer_percent": 90, "age_s": 2.0,
    }  # fmt: skip


def log_frame(log: Path) -> bytes:
    """The first frame of a tlog."""
    found = scan(log.read_bytes(), 8)
    assert isinstance(found, Frame)
    return bytes(found.data)
