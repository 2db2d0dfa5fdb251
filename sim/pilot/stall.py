"""Stall detection: a flight whose wing stalls cannot follow its profile and ends with one line.

A wing is stalled beyond the angle of attack at which its lift is greatest, whatever the airspeed,
the bank or the load. That angle is taken from the lift curve of JSBSim's model (`Model.stall_rad`).
A gust can exceed it briefly; an aircraft that stays beyond it sinks while the autopilot pulls up.
"""

import math
from collections.abc import Callable

from companion.errors import SimulationError
from sim.aircraft import Aircraft
from sim.aircraft_state import Truth
from sim.pilot.profile import Climb, Flown, Leg

_STAYS_US = 500_000
_KNIFE_EDGE = 0.1
"""smallest cosine of the bank for which the message gives an airspeed"""


class StallWatch:
    """Checks the wing at every truth."""

    def __init__(self, aircraft: Aircraft) -> None:
        self._aircraft = aircraft
        self._since_us: int | None = None
        self._needed_mps = 0.0
        """airspeed at which the greatest lift equals the weight in this bank"""

    def check(self, truth: Truth, leg: Leg, describe: Callable[[], str]) -> None:
        """Raise `SimulationError` if the wing is stalled in the air for half a second; `describe`
        names the leg."""
        angle_rad = self._aircraft.angle_of_attack_rad()
        if truth.on_ground or angle_rad <= self._aircraft.stall_rad:
            self._since_us = None
            return
        if self._since_us is None:
            self._since_us = truth.time_us
            self._needed_mps = self._enough_mps(truth)
        if truth.time_us - self._since_us >= _STAYS_US:
            angle_deg, stall_deg = math.degrees(angle_rad), math.degrees(self._aircraft.stall_rad)
            raise SimulationError(
                f"at {truth.time_us / 1e6:.2f} s the aircraft stalled during '{describe()}': "
                f"{truth.altitude_amsl_m:.0f} m AMSL, {truth.airspeed_mps:.1f} m/s calibrated, "
                f"bank {abs(math.degrees(truth.roll_rad)):.0f} degrees, angle of attack "
                f"{angle_deg:.1f} degrees with the greatest lift at {stall_deg:.1f}; it needs "
                f"about {self._needed_mps:.0f} m/s there: give the leg {_remedy(leg)}"
            )

    def _enough_mps(self, truth: Truth) -> float:
        """Airspeed at which the lift, proportional to its square, equals that which the bank
        needs."""
        carried = max(self._aircraft.flow().load, _KNIFE_EDGE)
        asked = 1.0 / max(math.cos(truth.roll_rad), _KNIFE_EDGE)
        return truth.airspeed_mps * math.sqrt(max(asked / carried, 1.0))


def _remedy(leg: Leg) -> str:
    """What to change in the profile."""
    match leg:
        case Flown(bank_deg=float()):
            return "less bank_deg or a higher airspeed_mps"
        case Climb(rate_mps=float()):
            return "a lower rate_mps, a lower altitude_amsl_m or a higher airspeed_mps"
        case Climb():
            return "a lower altitude_amsl_m or a higher airspeed_mps"
        case Flown():
            return "a higher airspeed_mps, or the weather less wind"
        case _:
            return "calmer weather"
