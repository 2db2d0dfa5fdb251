"""Physical constants of the simulator and of the studies, each once.

The simulator must not take them from the estimators' kernels: what is wrong there would be wrong in
both, and cancel.
"""

G0_MPS2 = 9.80665
"""standard gravity"""
ZERO_CELSIUS_K = 273.15
EARTH_M_PER_DEG = 111_319.49
"""a degree of latitude on a sphere of the equator's radius: for errors of metres, not for
positions"""
MEAN_EARTH_M_PER_DEG = 111_195.0
"""a degree of latitude on a sphere of the mean radius"""
EQUATORIAL_RADIUS_M = 6_378_137.0
