"""STATUSTEXT: transitions only, five seconds apart, the last state is told in the end."""

from companion.mavlink.texts import Allowance, StatusTexts

SECOND_US = 1_000_000


def texts(source: StatusTexts, now_s: float) -> list[str]:
    return [str(message.text) for message in source.due(round(now_s * SECOND_US))]


def test_what_comes_too_soon_waits_and_only_its_last_state_is_told() -> None:
    source = StatusTexts()
    source.say("health", "OK", 6, "ok")
    assert texts(source, 10.0) == ["ok"]
    source.say("health", "LOST", 3, "lost")
    source.say("health", "DEGRADED", 4, "degraded")
    assert texts(source, 12.0) == []
    assert texts(source, 15.0) == ["degraded"]
    assert texts(source, 30.0) == []


def test_a_state_that_came_back_is_not_told_twice() -> None:
    source = StatusTexts()
    source.say("health", "OK", 6, "ok")
    assert texts(source, 10.0) == ["ok"]
    source.say("health", "LOST", 3, "lost")
    source.say("health", "OK", 6, "ok again")
    assert texts(source, 30.0) == []


def test_kinds_do_not_wait_for_each_other() -> None:
    source = StatusTexts()
    source.say("health", "OK", 6, "ok")
    source.say("streams", ("IMU slow",), 4, "IMU slow: 4 of 50 Hz")
    assert texts(source, 1.0) == ["ok", "IMU slow: 4 of 50 Hz"]
    source.retract("streams")
    source.say("streams", ("IMU slow",), 4, "IMU slow: 2 of 50 Hz")
    assert texts(source, 7.0) == ["IMU slow: 2 of 50 Hz"]


def test_answers_are_bounded() -> None:
    allowance = Allowance(10)
    assert sum(allowance.takes(0) for _ in range(3000)) == 10
    assert sum(allowance.takes(SECOND_US // 2) for _ in range(3000)) == 5
    assert sum(allowance.takes(100 * SECOND_US) for _ in range(3000)) == 10
