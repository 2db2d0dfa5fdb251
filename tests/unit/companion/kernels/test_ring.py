"""A late measurement meets the value of its own time: the ring against NumPy's interpolation."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.kernels.ring import at, clear, push, ring_fields

SIZE = 8
REACH_US = 1_000


def filled(times_us: list[int], values: list[float]) -> tuple[np.ndarray, np.ndarray]:
    state = np.zeros(1, np.dtype(list(ring_fields("height", SIZE))))
    ring = state["height_us"][0], state["height_values"][0]
    clear(*ring)
    for time_us, value in zip(times_us, values, strict=True):
        push(*ring, time_us, value)
    return ring


@settings(max_examples=200, deadline=None)
@given(
    gaps=st.lists(st.integers(1, 400), max_size=3 * SIZE),
    query_us=st.integers(0, 10_000),
    seed=st.integers(0, 1000),
)
def test_between_kept_neighbours_it_is_linear(gaps: list[int], query_us: int, seed: int) -> None:
    times_us = np.cumsum(np.array([5, *gaps]))
    values = np.random.default_rng(seed).normal(size=times_us.size)
    ring = filled(times_us.tolist(), values.tolist())
    kept_us, kept = times_us[-SIZE:], values[-SIZE:]
    if query_us < kept_us[0] - REACH_US or query_us > kept_us[-1] + REACH_US:
        assert math.isnan(at(*ring, query_us, REACH_US))
    else:
        assert at(*ring, query_us, REACH_US) == pytest.approx(
            np.interp(query_us, kept_us, kept), abs=1e-12
        )


def test_empty_ring_knows_nothing() -> None:
    assert math.isnan(at(*filled([], []), 0, REACH_US))


def test_a_gap_longer_than_the_reach_is_not_bridged() -> None:
    ring = filled([0, 10_000], [1.0, 2.0])
    assert at(*ring, 900, REACH_US) == 1.0
    assert math.isnan(at(*ring, 5_000, REACH_US))
    assert at(*ring, 9_100, REACH_US) == 2.0
