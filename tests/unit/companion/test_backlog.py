"""Old samples after an interruption: what is made of them is not sent."""

from companion.backlog import Backlog

SECOND = 1_000_000


def turn(backlog: Backlog, now_us: int, vehicle_us: int | None, timeout_s: float = 0.1) -> bool:
    backlog.received(now_us, timeout_s, vehicle_us is not None)
    if vehicle_us is not None:
        backlog.handled(now_us, vehicle_us)
    return backlog.behind


def test_a_steady_stream_is_never_behind() -> None:
    backlog = Backlog()
    assert not any(turn(backlog, step * 100_000, step * 100_000) for step in range(50))


def test_silence_of_the_vehicle_is_no_interruption() -> None:
    backlog = Backlog()
    turn(backlog, 0, 0)
    assert not any(turn(backlog, step * 100_000, None) for step in range(1, 100))
    assert not turn(backlog, 10 * SECOND, SECOND)


def test_after_a_stop_only_what_is_younger_than_half_a_second_counts() -> None:
    backlog = Backlog()
    turn(backlog, 0, 0)
    resumed_us = 10 * SECOND
    late = [turn(backlog, resumed_us + step, (step + 1) * 100_000, 0.0) for step in range(100)]
    assert late[:94] == [True] * 94
    assert not any(late[95:])


def test_an_empty_line_ends_it() -> None:
    """A vehicle that stood still as long as this process."""
    backlog = Backlog()
    turn(backlog, 0, 0)
    assert turn(backlog, 10 * SECOND, 100_000)
    assert not turn(backlog, 10 * SECOND + 1, None, 0.0)
    assert not turn(backlog, 10 * SECOND + 20_000, 120_000)
