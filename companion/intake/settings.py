"""Section ``intake`` of the configuration."""

from typing import Literal

from pydantic import Field

from companion.config import Settings


class IntakeSettings(Settings):
    """Section ``intake``."""

    gnss_latency_s: float = Field(0.12, ge=0, le=1)
    """age of a GNSS height when the autopilot stamps it: receivers of the u-blox class take 0.1 to
    0.2 s"""
    reorder_s: float = Field(2.0, gt=0, le=10)
    """lead of a time stamp over the newest one above which a second consistent time stamp is
    required: the stamp may follow a gap or be damaged"""
    late_s: float = Field(10.0, gt=0, le=60)
    """delay of a time stamp behind the newest one up to which the sample is a late copy over a
    second path; beyond it a second consistent time stamp is required, because the vehicle may have
    rebooted or the stamp be damaged"""
    gap_s: float = Field(10.0, gt=0, le=3600)
    """time of the vehicle's clock within which the second consistent time stamp must follow"""
    datum_limit_m: float = Field(700.0, gt=0, le=10_000)
    """largest difference of barometer and GNSS height that weather can explain at sea level; more
    than twice that of the deepest low"""
    datum_limit_ratio: float = Field(0.15, ge=0, le=1)
    """share of the height that is added to datum_limit_m; an arctic winter needs it"""
    datum_time_s: float = Field(10.0, gt=0, le=600)
    """time for which barometer and GNSS height must contradict each other before one of them is
    marked as suspect, and agree before it is used again"""
    credible_gnss_sd_m: float = Field(20.0, gt=0, le=1000)
    """largest reported accuracy (standard deviation) of a GNSS height that is used to check the
    barometer"""
    step_limit_m: float = Field(60.0, gt=0, le=10_000)
    """largest sudden change of the difference of barometer and GNSS height, beyond what speed and
    reported accuracy explain"""
    equal_heights: Literal["doubt", "ellipsoid", "sea_level"] = "doubt"
    """meaning of a GNSS height that equals the height above the ellipsoid to the millimetre: doubt
    adds the geoid's undulation to the reported accuracy, unless the vehicle tells that it is
    simulated (SIMSTATE, SIM_STATE); ellipsoid subtracts the undulation; sea_level uses the height
    as it is, for simulators without a geoid"""
    air_temperature: Literal["hygrometer", "airspeed", "imu", "none"] = "hygrometer"
    """source of the air temperature: hygrometer is HYGROMETER_SENSOR, a probe in the air; airspeed
    is SCALED_PRESSURE.temperature_press_diff, the sensor behind a pitot tube; imu is
    HIGHRES_IMU.temperature, a die 10-30 K above the air (give air_temperature_excess_k)"""
    air_temperature_excess_k: float = Field(0.0, ge=-20, le=60)
    """excess of the measured temperature over the air's; it is subtracted"""
