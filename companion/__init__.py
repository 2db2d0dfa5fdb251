"""Kollsman's companion: estimates the altitude of a MAVLink vehicle, and its accuracy.

Data path
---------
bytes -> `Packet` (arrival time, data) -> frame -> message -> sample row -> estimator -> estimate
row -> sinks. Live, replay, simulation and benchmark differ only in where the packets come from and
in the clock, so the same bytes give the same estimates, bit for bit.

Units
-----
SI everywhere; the suffix of a name is its unit: ``_m _mps _mps2 _radps _rad _deg _pa _k _s _us
_hz``. A standard deviation is ``_sd_m``, a variance ``_var_m2``. Only three places convert units:
``mavlink/convert.py`` (MAVLink), ``sim/aircraft.py`` (JSBSim) and ``config/`` (YAML).

Time
----
An instant is an integer ``time_us``, microseconds of the sensor's (the vehicle's boot) clock; a
duration is a float ``_s``. ``arrival_us`` is when our host read the bytes (UNIX microseconds); no
estimate depends on it.

Frames
------
``vec_b`` is forward-right-down, ``vec_n`` north-east-down, ``mat_nb`` takes b to n. The scalars
altitude, height and climb are positive upwards.

Datums
------
===========================  =======================================================================
``pressure_altitude_m``      geopotential height in the standard atmosphere, 1013.25 hPa = 0
``altitude_amsl_m``          geometric height above mean sea level (the EGM96 geoid)
``altitude_ellipsoid_m``     geometric height above the WGS-84 ellipsoid
``height_above_home_m``      above HOME_POSITION
===========================  =======================================================================

As a library
------------
`read_log` and `run_estimator` (`companion.api`, docs/estimators.md): a log as arrays, an estimator
over it.

Names
-----
Unknown is NaN in rows; MAVLink's sentinels live in ``mavlink/convert.py`` alone. Paper letters (F H
P Q R S K x z) appear only in ``kernels/kalman.py`` and ``estimators/``, with a map in the module's
docstring.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from companion.api import (
        Estimated,
        LogFlight,
        estimator_names,
        read_log,
        run_estimator,
    )

__version__ = "0.1.0"
__all__ = ["Estimated", "LogFlight", "estimator_names", "read_log", "run_estimator"]


def __getattr__(name: str) -> Any:
    """The names of `companion.api`, which is imported when one is used: it imports Numba."""
    if name in __all__:
        return getattr(import_module("companion.api"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
