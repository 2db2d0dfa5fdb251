"""Settings of the GNSS/INS filter with barometer: section ``estimators.baro-gnss-ins``."""

from typing import Any, Literal

from pydantic import Field

from companion.estimators.params import EstimatorSettings


class BaroGnssInsSettings(EstimatorSettings):
    """Section ``estimators.baro-gnss-ins``."""

    attitude: Literal["own", "vehicle"] = "own"
    """where attitude comes from: aligned in motion from the IMU and GNSS, or also the vehicle's
    ATTITUDE"""
    barometer: Literal["always", "gnss_unreliable"] = "always"
    """When the barometer corrects height: with every pressure, or only while GNSS is missing or
    contradicted, as the paper allows."""
    baro_sd_m: float = Field(1.0, gt=0, le=100)
    """white error of a pressure altitude (the paper's sigma_b)"""
    baro_bias_sd_m: float = Field(100.0, gt=0, le=1000)
    """prior of the barometer's bias: 12 hPa of weather"""
    baro_walk_m_rts: float = Field(0.3, ge=0, le=10)
    """random walk of the bias, per root second: 18 m in an hour"""
    baro_scale_sd_ratio: float = Field(0.04, ge=0, le=1)
    """prior of the barometer's scale factor: air 11 K from standard"""
    baro_scale_walk_rts: float = Field(1e-4, ge=0, le=0.1)
    """random walk of the scale factor, per root second: 2 K in an hour"""
    spike_gate_pa: float = Field(8.0, gt=0, le=1000)
    """least deviation from the trend that makes a pressure a spike"""
    gnss_sd_floor_m: float = Field(2.0, gt=0, le=100)
    """a claimed spread below this is not believed"""
    gnss_sd_unknown_m: float = Field(10.0, gt=0, le=1000)
    """spread of a receiver that claims nothing"""
    gnss_velocity_sd_mps: float = Field(0.3, gt=0, le=10)
    """spread of GNSS velocity, lateness within a manoeuvre included"""
    gnss_correlation_s: float = Field(2.0, ge=0, le=600)
    """fixes within this time count as one"""
    gnss_correlated_ratio: float = Field(0.75, ge=0, le=1)
    """share of the claimed variance that no averaging removes: added to the reported spread"""
    accel_noise_mps2_rthz: float = Field(0.05, gt=0, le=10)
    """white noise of the accelerometers on an airframe with a running motor"""
    accel_bias_sd_mps2: float = Field(0.2, gt=0, le=10)
    """prior of their bias: 20 mg"""
    accel_walk_mps2_rts: float = Field(1e-3, ge=0, le=1)
    """random walk of their bias, per root second"""
    gyro_noise_radps_rthz: float = Field(2e-3, gt=0, le=1)
    """white noise of the gyros, on the same airframe"""
    gyro_bias_sd_radps: float = Field(0.02, gt=0, le=1)
    """prior of their bias: 1 degree a second"""
    gyro_walk_radps_rts: float = Field(1e-4, ge=0, le=1)
    """random walk of their bias, per root second"""
    coast_noise_mps2_rthz: float = Field(1.5, gt=0, le=10)
    """white acceleration of the vehicle while no IMU tells it"""

    def derived(self) -> dict[str, Any]:
        return {
            "use_vehicle_attitude": int(self.attitude == "vehicle"),
            "calibrates_only": int(self.barometer == "gnss_unreliable"),
        }
