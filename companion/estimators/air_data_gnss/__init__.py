"""Barometer with bias and scale factor from GNSS and air temperature (paper W). Other packages use
its `METHOD` only."""

from companion.estimators.air_data_gnss.steps import METHOD

__all__ = ["METHOD"]
