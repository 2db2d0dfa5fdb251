"""What of a change is written: nothing that its spread explains, and no more than the change."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.feedback.evidence import proven_m, target_m

METRES = st.floats(-100.0, 100.0)
LIMIT = st.floats(0.0, 50.0)


@pytest.mark.parametrize(
    ("change_m", "proven"), [(0.0, 0.0), (4.0, 0.0), (-4.0, 0.0), (8.0, 6.0), (-8.0, -6.0)]
)
def test_the_proven_part_of_a_change(change_m: float, proven: float) -> None:
    assert proven_m(change_m, 4.0) == pytest.approx(proven)


@given(METRES, LIMIT)
def test_a_correction_never_exceeds_the_change(change_m: float, limit_m: float) -> None:
    target = target_m(0.0, change_m, limit_m)
    assert min(0.0, change_m) <= target <= max(0.0, change_m)
    assert target == 0.0 or abs(change_m) > limit_m


@given(METRES, METRES, LIMIT)
def test_a_target_is_kept_once_it_is_reached(
    written_m: float, change_m: float, limit_m: float
) -> None:
    target = target_m(written_m, change_m, limit_m)
    assert target_m(target, change_m, limit_m) == pytest.approx(target, abs=1e-6)


@given(METRES, METRES, LIMIT)
def test_what_is_not_disproved_stays(written_m: float, change_m: float, limit_m: float) -> None:
    if abs(change_m - written_m) <= limit_m and abs(written_m) >= abs(proven_m(change_m, limit_m)):
        assert target_m(written_m, change_m, limit_m) == written_m


@given(METRES, METRES)
def test_without_a_spread_the_whole_change_is_written(written_m: float, change_m: float) -> None:
    assert target_m(written_m, change_m, 0.0) == pytest.approx(change_m)
