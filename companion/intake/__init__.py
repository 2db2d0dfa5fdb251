"""Readings in, sample rows out: the vehicle clock and the plausibility check. Knows no
estimator."""

from companion.intake.rows import Intake, SampleReject, restart_row
from companion.intake.settings import IntakeSettings
from companion.intake.vehicle_clock import Clockwork, VehicleClock

__all__ = [
    "Clockwork",
    "Intake",
    "IntakeSettings",
    "SampleReject",
    "VehicleClock",
    "restart_row",
]
