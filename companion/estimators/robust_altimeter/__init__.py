"""Fault-tolerant baro-inertial-GPS altimeter (paper C). Other packages use its `METHOD` only."""

from companion.estimators.robust_altimeter.steps import METHOD

__all__ = ["METHOD"]
