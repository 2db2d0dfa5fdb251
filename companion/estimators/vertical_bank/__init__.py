"""The vertical bank, our own estimator. Other packages use its `METHOD` only."""

from companion.estimators.vertical_bank.steps import METHOD

__all__ = ["METHOD"]
