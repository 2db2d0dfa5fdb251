"""Barometer in a GNSS/INS extended Kalman filter (paper R). Other packages use its `METHOD` only."""

from companion.estimators.baro_gnss_ins.steps import METHOD

__all__ = ["METHOD"]
