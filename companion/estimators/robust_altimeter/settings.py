"""Settings of the robust altimeter: section ``estimators.robust-altimeter``, and the letters of the
paper."""

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from companion.estimators.params import EstimatorSettings
from companion.estimators.robust_altimeter.error_model import IBI, IBIG, IIG, RECOMMENDED

PUBLISH = {"ibi": IBI, "iig": IIG, "ibig": IBIG, "recommended": RECOMMENDED}
PAPER = {"sigma_a": 2e-5, "P_a": 1e-6}
TUNED = {"sigma_a": 0.037, "P_a": 0.01}
"""sigma_a: the variance 0.1^2 with a time constant of 30 s has the noise density 2 0.1^2 / 30 = T_d
sigma_a^2."""
MANOEUVRE_MPS2, MANOEUVRE_S = 2.0, 2.0
"""Acceleration of a vehicle that nobody measures, and for how long it stays the same: a climb of 4
m/s begins."""
BLIND_PATIENCE_S = 0.1
"""``reacquire_s`` without an IMU: one iteration is refused, not two in a row."""


Patience = Annotated[float, Field(gt=0, le=3600)]


class RobustAltimeterSettings(EstimatorSettings):
    """Section ``estimators.robust-altimeter``."""

    PRESETS: ClassVar = {"paper": {"reacquire_s": 120.0}}

    preset: Literal["tuned", "paper"] = "tuned"
    """errors of the inertial sensors: those of a small IMU, or of the paper's navigation-grade
    one"""
    gain: Literal["robust", "optimal"] = "robust"
    """weight of a measurement: robust multiplies it by the probability that the measurement is
    normal, optimal does not"""
    publish: Literal["ibig", "ibi", "iig", "recommended"] = "ibig"
    """altimeter that is published: ibig both fused, ibi the one with the barometer, iig the one
    with GNSS, recommended the one that fault isolation recommends"""
    use_attitude: bool = True
    """whether the autopilot's roll and pitch are used while they agree with our own"""
    reacquire_s: Patience | Literal["never"] = 10.0
    """longest time for which a measurement is rejected; never: without limit, as in the paper's
    filter. Preset paper: 120 s"""
    reference_s: float = Field(300.0, gt=0, le=1e6)
    """averaging time of the barometer's datum"""
    gnss_sd_floor_m: float = Field(2.23, gt=0, le=100)
    """least standard deviation of a GNSS height; a smaller reported accuracy is raised to it"""
    gnss_sd_unknown_m: float = Field(13.0, gt=0, le=1000)
    """standard deviation of a GNSS height whose receiver reports no accuracy"""
    pressure_drift_mps: float = Field(0.003, ge=0, le=10)
    """drift of the pressure level by weather: 10 m an hour is usual, 30 a front"""

    def derived(self) -> dict[str, Any]:
        """The letters of the paper."""
        preset = PAPER if self.preset == "paper" else TUNED
        T_d, chosen = 0.5, self.reacquire_s
        blind_a = math.sqrt(2.0 * MANOEUVRE_MPS2**2 / MANOEUVRE_S / T_d)
        return {
            "T_d": T_d,
            "beta_g": 0.005,
            "beta": 0.01,
            "H": 1000.0,
            "sigma_g": 2e-5,
            "sigma_UB": 0.2,
            "alpha": (1.0 / MANOEUVRE_S, 0.001),  # without the IMU, with it
            "sigma_a": (blind_a, preset["sigma_a"]),
            "P_a": (MANOEUVRE_MPS2**2, preset["P_a"]),
            "rows_H": ((1.0, 0.0, 0.0, 0.0, -1.0), (1.0, 0.0, 0.0, 0.0, 0.0)),  # (7), (14)
            "sigma_INS": 3.0,
            "sigma_B": 1.0,
            "sigma_GPS": self.gnss_sd_floor_m,
            "sigma_GPS_unknown": self.gnss_sd_unknown_m,
            "P_W": 25.0,
            "P_g": 1e-6,
            "reacquire_s": (BLIND_PATIENCE_S, math.inf if chosen == "never" else chosen),
            "may_doubt_imu": int(chosen != "never"),
            "robust": int(self.gain == "robust"),
            "publish": PUBLISH[self.publish],
        }
