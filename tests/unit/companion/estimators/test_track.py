"""The history of a moving state: what a late fix meets, before and after corrections."""

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.estimators.baro_gnss_ins.track import TRACK, clear, look_up, push, shift
from companion.samples import readable

Array = NDArray[np.float64]
RADIUS_M = 6_371_000.0


class Track:
    """A vehicle on the equator: latitude grows with the velocity north, height with the climb."""

    def __init__(self, period_us: int, count: int, climb_mps: float = 3.0) -> None:
        self.track = readable(np.zeros(1, TRACK))[0]
        self.velocity = np.array([20.0, 0.0, -climb_mps])
        self.position = np.array([0.0, 0.5, 100.0])
        clear(self.track)
        for tick in range(count):
            self.now_us = tick * period_us
            self.position[2] = 100.0 + climb_mps * self.now_us * 1e-6
            push(self.track, self.now_us, self.position, self.velocity)

    def height_m(self, time_us: int) -> float:
        look_up(self.track, self.now_us, self.position, self.velocity, time_us)
        return float(self.track["at"][2])


@pytest.mark.parametrize("period_us", [2_500, 20_000, 100_000])
@pytest.mark.parametrize("age_us", [0, 7_000, 123_456, 999_000])
def test_the_past_is_found_at_every_rate(period_us: int, age_us: int) -> None:
    """At 400 Hz too a second fits: entries keep a distance."""
    track = Track(period_us, 2_000_000 // period_us)
    time_us = track.now_us - age_us
    assert track.height_m(time_us) == pytest.approx(100.0 + 3.0 * time_us * 1e-6, abs=1e-6)


def test_beyond_both_ends_the_velocity_carries_on() -> None:
    track = Track(20_000, 10)
    assert track.height_m(track.now_us + 100_000) == pytest.approx(track.position[2] + 0.3)
    assert track.height_m(-500_000) == pytest.approx(100.0 - 1.5)
    clear(track.track)
    assert track.height_m(track.now_us - 100_000) == pytest.approx(track.position[2] - 0.3)


def test_a_correction_moves_the_past_as_it_moves_the_present() -> None:
    """Up by 5 m now, and 2 m/s faster all along: one second ago that was 3 m up."""
    track = Track(20_000, 60)
    before = [track.height_m(track.now_us - age_us) for age_us in (0, 500_000, 1_000_000)]
    moved, sped = np.array([0.0, 0.0, -5.0]), np.array([0.0, 0.0, -2.0])
    shift(track.track, track.now_us, moved, sped)
    track.position[2] += 5.0
    track.velocity += sped
    after = [track.height_m(track.now_us - age_us) for age_us in (0, 500_000, 1_000_000)]
    np.testing.assert_allclose(np.subtract(after, before), [5.0, 4.0, 3.0], atol=1e-9)
