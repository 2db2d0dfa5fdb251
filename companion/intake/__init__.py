"""Readings in, sample rows out: the vehicle clock and the plausibility check. Knows no estimator."""

from companion.intake.rows import Cause, Intake, restart_row
from companion.intake.settings import IntakeSettings
from companion.intake.vehicle_clock import Clockwork, VehicleClock

__all__ = ["Cause", "Clockwork", "Intake", "IntakeSettings", "VehicleClock", "restart_row"]
