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
    """height above mean sea level of the place of the start, where it is known; otherwise from
    GNSS"""
    start_fixes: int = Field(15, ge=1, le=MOST_START_FIXES)
    """how many credible GNSS heights the start is the median of"""
    start_temperature_k: Annotated[float, Field(gt=150, le=350)] | Literal["standard", "die"] = (
        "standard"
    )
    """air temperature at the start: a number, the standard atmosphere's, or the sensor die's less
    die_excess_k"""
    die_excess_k: float = Field(20.0, ge=0, le=60)
    """how much warmer the sensor is than the air"""
    use_attitude: bool = True
    """take the autopilot's roll and pitch while they agree with our own"""
    gnss_sd_floor_m: float = Field(1.0, gt=0, le=100)
    """a claimed spread below this is not believed"""
    gnss_sd_unknown_m: float = Field(13.0, gt=0, le=1000)
    """spread of a receiver that claims nothing"""
    pressure_drift_mps: float = Field(0.003, ge=0, le=10)
    """how fast weather moves the pressure level: 10 m an hour is usual, 30 a front"""

    def derived(self) -> Mapping[str, Any]:
        temperature = self.start_temperature_k
        return {
            "start_temperature_k": math.nan if isinstance(temperature, str) else temperature,
            "use_die_temperature": int(temperature == "die"),
        }


class BaroInsKfSettings(InputSettings):
    """Section ``estimators.baro-ins-kf``."""

    accelerometer_bias_state: bool = True
    """the fourth state, which the paper's filter lacks"""
    baro_bias_sd_m: float = Field(0.5, ge=0, le=100)
    """sigma of (12): what a barometer wanders by in a minute, in quiet air"""
    baro_bias_time_s: float = Field(60.0, gt=0, le=1e5)
    """1 / beta of (12)"""
    baro_sd_m: float = Field(0.3, gt=0, le=100)
    """of v_a: noise of one sample"""
    acceleration_noise_mps2_rthz: float = Field(0.1, gt=0, le=10)
    """of w, m/s2/sqrt(Hz): attitude errors of a degree or two in manoeuvres, far more than the
    accelerometer's own"""
    unknown_acceleration_mps2_rthz: float = Field(1.0, gt=0, le=100)
    """of w without an IMU, m/s2/sqrt(Hz): 1 m/s2 for a second"""
    accelerometer_bias_sd_mps2: float = Field(0.1, gt=0, le=10)
    """spread of the accelerometer's bias: 10 mg"""
    accelerometer_bias_time_s: float = Field(600.0, gt=0, le=1e5)
    """how long it lasts"""

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
