"""Static port: the pressure there differs from the air's by a share k_q of dynamic pressure.

As height that is k_q V^2 / (2 g), with V true airspeed. Prior: 0 +- `port_sd_ratio` (.15; .10-.17
found on four light aircraft, reading high). Off: `port_sd_ratio` 0.

A speed is known to `wind_sd_mps` (5 m/s): wind beside a ground speed, age of a measured airspeed.
That makes an error of k_q V w / g; since no speed is heard, w grows, to V at most. It adds to the
fast error.
"""

import math

from companion.jit import step
from companion.kernels.atmosphere import G0_MPS2, P0_PA

DENSITY_POWER = 0.809737
"""of the pressure ratio, in the standard troposphere"""


@step
def velocity_head_m(true_airspeed_mps: float) -> float:
    """V^2 / (2 g)."""
    return true_airspeed_mps * true_airspeed_mps / (2.0 * G0_MPS2)


@step
def unseen_head_m2(head_m: float, unseen_mps: float, port2: float) -> float:
    """Variance of the barometer height by a speed that is wrong by `unseen_mps` (V at most), for
    the mean square `port2` of the coefficient."""
    speed_mps = math.sqrt(2.0 * G0_MPS2 * head_m)
    wrong_m = speed_mps * min(speed_mps, unseen_mps) / G0_MPS2
    return port2 * wrong_m * wrong_m


@step
def true_airspeed_mps(calibrated_mps: float, pressure_pa: float) -> float:
    """True airspeed of a calibrated one in standard air of this pressure."""
    return calibrated_mps * (P0_PA / pressure_pa) ** (0.5 * DENSITY_POWER)
