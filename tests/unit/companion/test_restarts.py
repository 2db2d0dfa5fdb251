"""A failure of the service is no end of it; what the user can act on is."""

import pytest

from companion.clock import ManualClock
from companion.errors import LinkError
from companion.restarts import serve


def test_it_goes_on_after_failures_and_does_not_spin() -> None:
    clock, runs = ManualClock(), []

    def run(number: int) -> None:
        runs.append(clock.now_us())
        if len(runs) == 1:
            clock.advance_s(60.0)
        if len(runs) < 4:
            raise ZeroDivisionError("a fault")

    start_us = clock.now_us()
    assert serve(lambda: len(runs), run, clock) == 3
    assert [us - start_us for us in runs] == [0, 60_000_000, 61_000_000, 62_000_000]


def test_an_error_of_the_environment_ends_it() -> None:
    def run(_: int) -> None:
        raise LinkError("no such port")

    with pytest.raises(LinkError):
        serve(lambda: 1, run, ManualClock())
