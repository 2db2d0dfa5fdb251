"""Section ``feedback`` of the configuration."""

from typing import Literal

from pydantic import Field

from companion.config import Settings


class FeedbackSettings(Settings):
    """Section ``feedback``."""

    mode: Literal["none", "baro-alt-offset", "qnh"] = "none"
    """parameter of the autopilot that is moved so that it holds its true altitude: none,
    baro-alt-offset (ArduPilot's BARO_ALT_OFFSET) or qnh (PX4's SENS_BARO_QNH)"""
    datum: Literal["change", "absolute"] = "change"
    """what is corrected: change is the change since arming; absolute is also the difference that is
    there on the ground, before the first arming only"""
    bound_m: float = Field(50.0, gt=0, le=100)
    """largest total correction of the altitude"""
    level_m: float = Field(25.0, gt=0, le=1000)
    """largest protection level at which the parameter is written"""
    floor_m: float = Field(20.0, ge=0, le=10_000)
    """height above the field below which nothing is written while armed; 0 allows it"""
    dead_band_m: float = Field(0.5, ge=0, le=10)
    """error of the autopilot's altitude at which a correction starts"""
    proof_ratio: float = Field(2.0, ge=0, le=10)
    """number of its own standard deviations that a change must exceed before any of it is written;
    larger changes are written almost whole, and 0 writes every change"""
    period_s: float = Field(2.0, ge=2, le=60)
    """least time between two writes"""
    settle_s: float = Field(30.0, ge=5, le=600)
    """time for which every condition must hold before the first write, and again after each
    interruption"""
    on_stop: Literal["restore", "keep"] = "restore"
    """what a stop of this program does with the parameter: restore writes the original value (in
    flight only where that is no step; otherwise the next start does it after disarming), keep
    leaves it"""
