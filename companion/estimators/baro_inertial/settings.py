"""Settings that the two baro-inertial filters share, and those of the Kalman filter."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from companion.estimators.baro_inertial.inputs import MOST_START_FIXES
from companion.estimators.params import EstimatorSettings


class InputSettings(EstimatorSettings):
    """Keys that the sections of both filters share."""

    start_altitude_m: float | None = Field(None, ge=-1000, le=20_000)
    """altitude above mean sea level at the start; default: from GNSS"""
    start_fixes: int = Field(15, ge=1, le=MOST_START_FIXES)
    """number of credible GNSS heights whose median is the altitude at the start"""
    start_temperature_k: Annotated[float, Field(gt=150, le=350)] | Literal["standard", "die"] = (
        "standard"
    )
    """air temperature at the start: a number; standard: as told before the start (section air,
    HYGROMETER_SENSOR), else that of the standard atmosphere; die: as told, else the barometer's own
    sensor less die_excess_k"""
    die_excess_k: float = Field(20.0, ge=0, le=60)
    """excess of the barometer's own sensor over the air's temperature"""
    use_attitude: bool = True
    """whether the autopilot's roll and pitch are used while they agree with our own"""
    gnss_sd_floor_m: float = Field(1.0, gt=0, le=100)
    """least standard deviation of a GNSS height; a smaller reported accuracy is raised to it"""
    gnss_sd_unknown_m: float = Field(13.0, gt=0, le=1000)
    """standard deviation of a GNSS height whose receiver reports no accuracy"""
    pressure_drift_mps: float = Field(0.003, ge=0, le=10)
    """drift of the pressure level by weather: 10 m an hour is usual, 30 a front"""

    def derived(self) -> Mapping[str, Any]:
        temperature = self.start_temperature_k
        return {
            "start_temperature_k": math.nan if isinstance(temperature, str) else temperature,
            "use_die_temperature": int(temperature == "die"),
        }


class BaroInsKfSettings(InputSettings):
    """Section ``estimators.baro-ins-kf``."""

    accelerometer_bias_state: bool = True
    """whether the accelerometer's bias is a fourth state, which the paper's filter lacks"""
    baro_bias_sd_m: float = Field(0.5, ge=0, le=100)
    """standard deviation of the barometer's bias (sigma of (12)): its wander in quiet air"""
    baro_bias_time_s: float = Field(60.0, gt=0, le=1e5)
    """correlation time of the barometer's bias (1 / beta of (12))"""
    baro_sd_m: float = Field(0.3, gt=0, le=100)
    """standard deviation of one barometer sample's white noise (v_a)"""
    acceleration_noise_mps2_rthz: float = Field(0.1, gt=0, le=10)
    """noise of the vertical acceleration with an IMU (w): attitude errors of a degree or two in
    manoeuvres, far more than the accelerometer's own"""
    unknown_acceleration_mps2_rthz: float = Field(1.0, gt=0, le=100)
    """noise of the vertical acceleration without an IMU (w); 1 is 1 m/s2 for a second"""
    accelerometer_bias_sd_mps2: float = Field(0.1, gt=0, le=10)
    """standard deviation of the accelerometer's bias; 0.1 is 10 mg"""
    accelerometer_bias_time_s: float = Field(600.0, gt=0, le=1e5)
    """correlation time of the accelerometer's bias"""

    def derived(self) -> Mapping[str, Any]:
        """The letters of the paper."""
        has_bias = self.accelerometer_bias_state
        return {
            **super().derived(),
            "sigma_m": self.baro_bias_sd_m,
            "beta_ps": 1.0 / self.baro_bias_time_s,
            "R_m2": self.baro_sd_m**2,
            "q_m2ps3": self.acceleration_noise_mps2_rthz**2,
            "baro_alone_q_m2ps3": self.unknown_acceleration_mps2_rthz**2,
            "bias_mps2": self.accelerometer_bias_sd_mps2 if has_bias else 0.0,
            "bias_beta_ps": 1.0 / self.accelerometer_bias_time_s,
        }
