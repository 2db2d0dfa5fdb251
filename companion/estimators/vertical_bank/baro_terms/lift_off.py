"""Lift-off: the barometer's error changes by k_b when the wing carries the vehicle.

It grows with the square of airspeed up to `lift_speed_mps` and is whole above. Prior: 0 +-
`lift_sd_m` (8 m; 10-13 found on three of four light aircraft). Off: `lift_sd_m` 0.
"""

from companion.jit import step


@step
def lift_share(airspeed_mps: float, full_mps: float) -> float:
    """Share of the lift-off error at this airspeed, 0 to 1."""
    return min(1.0, (airspeed_mps / full_mps) ** 2)
