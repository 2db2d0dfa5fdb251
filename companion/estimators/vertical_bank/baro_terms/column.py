"""Temperature column: a column of other than standard temperature stretches heights.

With a known air temperature T the local ratio is s = T_standard / T - 1, a measurement of the state
`SCALE`. Prior: 0 +- `scale_sd_ratio` (5 %), and `known_temperature_sd_k` (5 K) about a temperature
that is given. Off: `scale_sd_ratio` 0.
"""

from companion.jit import step
from companion.kernels.atmosphere import pressure_altitude_m, standard_temperature_k


@step
def column_ratio(pressure_pa: float, air_k: float) -> float:
    """d(barometer error)/d(height) where the air has this pressure and temperature."""
    return standard_temperature_k(pressure_altitude_m(pressure_pa)) / air_k - 1.0
