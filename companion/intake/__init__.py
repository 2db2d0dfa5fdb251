"""Readings in, sample rows out: the vehicle clock and the plausibility check. Knows no estimator."""

from companion.intake.rows import Intake, SampleReject
from companion.intake.settings import IntakeSettings
from companion.intake.vehicle_clock import Clockwork, VehicleClock

__all__ = ["SampleReject", "Clockwork", "Intake", "IntakeSettings", "VehicleClock"]
