"""The warm-up before a run: its made-up vehicle gets an altitude from every estimator."""

import pytest

from companion.estimators import ESTIMATORS
from companion.settings import CompanionSettings
from companion.warmup import warm_up, warm_up_with_loops


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_every_estimator_can_be_warmed_up(name: str) -> None:
    """A height of exactly 0 is no height to the intake: four estimators did not start."""
    warm_up(CompanionSettings().with_changes(estimator=name))
    warm_up_with_loops(name)
