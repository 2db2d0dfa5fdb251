"""Snapshots of a service on a memory link: what a page and other programs are told."""

import json
from collections.abc import Iterator
from typing import Any

import pytest

from companion.mavlink.codec import mavlink
from companion.web.board import COLUMNS, Board
from companion.web.snapshot import Snapshots
from tests.e2e.test_service import Bench


class Watched(Bench):
    """A bench whose snapshots go to a board."""

    def __init__(self) -> None:
        super().__init__()
        self.board = Board()
        self.snapshots = Snapshots(self.service, self.board)

    def turn(self, count: int = 1) -> None:
        super().turn(count)
        self.snapshots.poll()

    @property
    def session(self) -> dict[str, Any]:
        assert self.board.newest is not None
        (session,) = self.board.newest.document["sessions"]
        found: dict[str, Any] = session
        return found

    def column(self, name: str) -> float | None:
        assert self.board.newest is not None
        return self.board.newest.row[COLUMNS.index(name)]


@pytest.fixture
def bench() -> Iterator[Watched]:
    made = Watched()
    yield made
    made.close()


def fly(bench: Watched, seconds: int = 20) -> None:
    for second in range(seconds):
        bench.second(10_000 + 1000 * second)


def test_before_anything_is_heard_nothing_is_known(bench: Watched) -> None:
    bench.turn()
    session = bench.session
    assert session["health"]["at_end"] == "LOST"
    assert session["vehicle"] is None
    assert session["now"]["altitude_m"] is None
    assert session["sensors"]["pressure"]["age_s"] is None
    assert bench.column("altitude_m") is None
    assert bench.column("health") == 2


def test_a_vehicle_at_500_m(bench: Watched) -> None:
    fly(bench)
    session = bench.session
    assert bench.board.newest is not None
    json.dumps(bench.board.newest.document, allow_nan=False)
    assert bench.board.newest.document["schema"] == "kollsman-report/1"
    assert (session["vehicle"], session["autopilot"]) == ("1/1", "ArduPilot")
    assert session["health"]["at_end"] == "OK"
    assert session["now"]["altitude_m"] == pytest.approx(500.0, abs=3.0)
    assert session["altitude"]["last_m"] == session["now"]["altitude_m"]
    assert session["now"]["gnss_m"] == pytest.approx(500.0)
    assert session["now"]["baro_m"] == pytest.approx(500.0, abs=1.0)
    assert session["now"]["autopilot_m"] is None
    assert session["now"]["sends"] == "ours"
    assert session["altitude"]["qnh_hpa"] == pytest.approx(1013.25, abs=1.0)
    assert sum(session["health"]["share"].values()) == pytest.approx(1.0)
    assert bench.column("altitude_m") == pytest.approx(session["now"]["altitude_m"], abs=1e-3)
    assert bench.column("health") == 0


def test_rates_ages_and_verdicts(bench: Watched) -> None:
    fly(bench)
    sensors = bench.session["sensors"]
    gnss, pressure = sensors["gnss"], sensors["pressure"]
    assert gnss["rate_hz"] == pytest.approx(5.0, abs=0.7)
    assert gnss["age_s"] < 0.5
    assert set(gnss["verdicts"]) == {"used"}
    assert (gnss["fix_type"], gnss["satellites"]) == (3, 10)
    assert pressure["pressure_hpa"] == pytest.approx(954.61)
    assert sensors["imu"] == {"rate_hz": 0.0, "age_s": None, "verdicts": {}, "used": True}
    for _ in range(16):
        bench.clock.advance_s(0.25)
        bench.turn()
    gnss = bench.session["sensors"]["gnss"]
    assert gnss["rate_hz"] == 0.0
    assert gnss["age_s"] == pytest.approx(4.0, abs=0.5)
    assert bench.session["health"]["at_end"] == "LOST"
    for name in ("altitude_m", "gnss_m", "baro_m", "qnh_hpa"):
        assert bench.column(name) is None  # the curves end where the vehicle fell silent


def test_texts_of_the_vehicle_and_our_own(bench: Watched) -> None:
    fly(bench)
    bench.send(mavlink.MAVLink_statustext_message(2, b"<b>Crash</b>"))
    bench.turn(2)
    bench.clock.advance_s(0.5)
    bench.turn()
    texts = [(each["from"], each["severity"], each["text"]) for each in bench.session["texts"]]
    assert ("vehicle", "critical", "<b>Crash</b>") in texts
    assert any(who == "Kollsman" and text.startswith("Kollsman OK") for who, _, text in texts)


def test_four_snapshots_a_second(bench: Watched) -> None:
    count = 0
    for _ in range(100):
        before = bench.board.newest
        bench.clock.advance_s(0.02)
        bench.turn()
        count += bench.board.newest is not before
    assert count == 8


def test_a_fault_of_a_snapshot_ends_the_page_and_not_the_service(
    bench: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def fail(now_us: int) -> None:
        calls.append(now_us)
        raise ZeroDivisionError

    monkeypatch.setattr(bench.snapshots, "take", fail)
    for _ in range(3):
        bench.clock.advance_s(1.0)
        bench.turn()
    assert len(calls) == 1
