"""The slot and the history of the live page."""

import json
from typing import Any

from companion.web.board import COLUMNS, HISTORY_S, ROW_S, Board, Snapshot


class Time:
    """A clock that is moved by hand."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def snapshot(number: int, time_s: float = 0.0) -> Snapshot:
    return Snapshot({"number": number}, (time_s, *[None] * (len(COLUMNS) - 1)))


def event_of(board: Board) -> dict[str, Any]:
    text = board.event().decode()
    assert text.startswith("data: ")
    assert text.endswith("\n\n")
    found: dict[str, Any] = json.loads(text.removeprefix("data: "))
    return found


def history_of(board: Board) -> list[float]:
    found = json.loads(b"".join(board.history()))
    assert tuple(found["columns"]) == COLUMNS
    return [row[0] for row in found["rows"]]


def test_the_newest_wins() -> None:
    board = Board(Time())
    for number in range(5):
        board.put(snapshot(number))
    assert board.refresh()
    assert not board.refresh()
    assert event_of(board)["state"] == {"number": 4}
    assert board.number == 1


def test_before_the_first_snapshot_there_is_an_event_without_a_state() -> None:
    board = Board(Time())
    assert not board.refresh()
    assert event_of(board) == {"age_s": None}
    assert board.newest is None
    assert board.is_stalled
    assert history_of(board) == []


def test_a_snapshot_grows_old() -> None:
    time = Time()
    board = Board(time)
    board.put(snapshot(1))
    board.refresh()
    time.now_s += 2.5
    assert event_of(board)["age_s"] == 2.5
    assert not board.is_stalled
    time.now_s += 1.0
    assert board.is_stalled


def test_the_history_has_two_rows_a_second_and_ten_minutes_at_most() -> None:
    board = Board(Time())
    for number in range(8000):  # half an hour, four a second
        board.put(snapshot(number, 0.25 * number))
    rows = history_of(board)
    assert len(rows) == HISTORY_S / ROW_S
    assert rows[-1] - rows[0] == ROW_S * (len(rows) - 1)


def test_after_a_pause_the_history_does_not_catch_up() -> None:
    board = Board(Time())
    for time_s in (0.0, 0.25, 60.25, 60.5, 60.75, 61.0):
        board.put(snapshot(0, time_s))
    assert history_of(board) == [0.0, 60.25, 60.75]


def test_an_earlier_flight_begins_the_history_anew() -> None:
    board = Board(Time())
    for time_s in (90_000.0, 90_001.0, 500.0, 500.5):
        board.put(snapshot(0, time_s))
    assert history_of(board) == [500.0, 500.5]


def test_the_end_of_a_log_is_not_a_stall() -> None:
    time = Time()
    board = Board(time)
    board.put(snapshot(1))
    board.end()
    time.now_s += 100.0
    board.refresh()
    assert not board.is_stalled
    assert event_of(board)["ended"] is True
