"""Hours at cruise, and what happens when the tanks are empty."""

from typing import Any

import numpy as np
import pytest

from companion.errors import SimulationError
from sim.flight import Flight, Progress
from tests.long_flights import long_flight


def drained(**changes: Any) -> Flight:
    """A trainer in level flight with fuel for seconds."""
    flight = Flight(long_flight("c172p", 1000.0, 0.1, **changes))
    for number in range(2):
        flight.aircraft._fdm[f"propulsion/tank[{number}]/contents-lbs"] = 0.02
    return flight


def test_empty_tanks_end_the_flight_with_what_to_do() -> None:
    with pytest.raises(
        SimulationError, match=r"fuel is used up during 'Hold 1000m': .* set endless_fuel"
    ):
        drained().run()


def test_endless_fuel_flies_on_with_the_weight_it_began_with() -> None:
    flight = drained(endless_fuel=True)
    flight.tick()  # JSBSim sums up the tanks in a step
    before_kg = flight.aircraft.fuel_kg()
    assert flight.run().completed
    assert flight.aircraft.fuel_kg() == before_kg > 0.0


@pytest.mark.long
@pytest.mark.parametrize(
    ("aircraft", "altitude_m", "hours", "endless"),
    [("737", 11_000.0, 4.0, False), ("f16", 6000.0, 3.0, True), ("c172p", 2000.0, 4.0, False)],
)
def test_hours_at_cruise_hold_the_altitude(
    aircraft: str, altitude_m: float, hours: float, endless: bool
) -> None:
    """Through a front, a day and turbulence, and as the fuel's weight goes."""
    altitudes_m: list[float] = []

    def take(progress: Progress) -> None:
        altitudes_m.append(progress.truth.altitude_amsl_m)

    summary = Flight(long_flight(aircraft, altitude_m, hours, endless_fuel=endless)).run(take)
    assert summary.duration_s == pytest.approx(hours * 3600.0, abs=1.0)
    errors_m = np.abs(np.array(altitudes_m[120:]) - altitude_m)
    assert np.sqrt(np.mean(errors_m**2)) < 10.0
    assert errors_m.max() < 60.0
