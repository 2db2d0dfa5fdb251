"""Hours at cruise through weather, for the tests and for `make bench`."""

from typing import Any

from companion.config import validate
from sim.scenario import Scenario

_WEATHER = {
    "front": {
        "kind": "cold", "from_deg": 90, "distance_m": 400_000, "speed_mps": 12, "width_m": 60_000,
        "trough_hpa": 3, "pressure_step_hpa": 4, "temperature_step_k": -8,
    },
    "gradient": {"hpa_per_100km": 0.6, "towards_deg": 0},
    "diurnal": {"start_h": 6, "temperature_k": 6, "pressure_hpa": 0.6},
    "turbulence": {"severity": 2},
}  # fmt: skip


def long_flight(aircraft: str, altitude_m: float, hours: float, **changes: Any) -> Scenario:
    """Level flight eastwards, through a front, along the isobars of a gradient and through the
    day."""
    values = {
        "name": f"{aircraft}-for-hours", "summary": "Hours at cruise.", "aircraft": aircraft,
        "weather": _WEATHER, "aloft": {"altitude_amsl_m": altitude_m},
        "profile": [{"leg": "hold", "duration_s": hours * 3600.0}],
        "limit_s": hours * 3600.0 + 600.0, **changes,
    }  # fmt: skip
    return validate(values, Scenario, "a long flight")
