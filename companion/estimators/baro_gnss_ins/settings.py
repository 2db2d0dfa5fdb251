"""Settings of the GNSS/INS filter with barometer: section ``estimators.baro-gnss-ins``."""

from typing import Any, Literal

from pydantic import Field

from companion.estimators.params import EstimatorSettings


class BaroGnssInsSettings(EstimatorSettings):
    """Section ``estimators.baro-gnss-ins``."""

    attitude: Literal["own", "vehicle"] = "own"
    """source of the attitude: own is aligned in motion from IMU and GNSS, vehicle uses also the
    vehicle's ATTITUDE"""
    barometer: Literal["always", "gnss_unreliable"] = "always"
    """when the barometer corrects the height: always with every pressure, gnss_unreliable only
    while GNSS is missing or contradicted, as the paper allows"""
    baro_sd_m: float = Field(1.0, gt=0, le=100)
    """standard deviation of a pressure altitude's white noise (the paper's sigma_b)"""
    baro_bias_sd_m: float = Field(100.0, gt=0, le=1000)
    """standard deviation of the barometer's bias at the start; 100 m is 12 hPa of weather"""
    baro_walk_m_rts: float = Field(0.3, ge=0, le=10)
    """random walk of the barometer's bias; 0.3 is 18 m in an hour"""
    baro_scale_sd_ratio: float = Field(0.04, ge=0, le=1)
    """standard deviation of the barometer's scale factor at the start; 0.04 is air 11 K from
    standard"""
    baro_scale_walk_rts: float = Field(1e-4, ge=0, le=0.1)
    """random walk of the barometer's scale factor; 0.0001 is 2 K in an hour"""
    spike_gate_pa: float = Field(8.0, gt=0, le=1000)
    """least deviation of a pressure from the trend that makes it a spike"""
    gnss_sd_floor_m: float = Field(2.0, gt=0, le=100)
    """least standard deviation of a GNSS height; a smaller reported accuracy is raised to it"""
    gnss_sd_unknown_m: float = Field(10.0, gt=0, le=1000)
    """standard deviation of a GNSS height whose receiver reports no accuracy"""
    gnss_velocity_sd_mps: float = Field(0.3, gt=0, le=10)
    """standard deviation of GNSS velocity, its delay in manoeuvres included"""
    gnss_correlation_s: float = Field(2.0, ge=0, le=600)
    """time within which fixes count as one"""
    gnss_correlated_ratio: float = Field(0.75, ge=0, le=1)
    """share of the reported variance that no averaging removes; it is added to the estimate's
    variance"""
    accel_noise_mps2_rthz: float = Field(0.05, gt=0, le=10)
    """white noise of the accelerometers, on an airframe with a running motor"""
    accel_bias_sd_mps2: float = Field(0.2, gt=0, le=10)
    """standard deviation of the accelerometers' bias at the start; 0.2 is 20 mg"""
    accel_walk_mps2_rts: float = Field(1e-3, ge=0, le=1)
    """random walk of the accelerometers' bias"""
    gyro_noise_radps_rthz: float = Field(2e-3, gt=0, le=1)
    """white noise of the gyroscopes, on an airframe with a running motor"""
    gyro_bias_sd_radps: float = Field(0.02, gt=0, le=1)
    """standard deviation of the gyroscopes' bias at the start; 0.02 is 1 degree a second"""
    gyro_walk_radps_rts: float = Field(1e-4, ge=0, le=1)
    """random walk of the gyroscopes' bias"""
    coast_noise_mps2_rthz: float = Field(1.5, gt=0, le=10)
    """white acceleration of the vehicle while there is no IMU"""

    def derived(self) -> dict[str, Any]:
        return {
            "use_vehicle_attitude": int(self.attitude == "vehicle"),
            "calibrates_only": int(self.barometer == "gnss_unreliable"),
        }
