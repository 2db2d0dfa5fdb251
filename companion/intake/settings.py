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
    """a stamp that is this many seconds ahead of the newest one is a gap or damaged: a second
    consistent stamp is required"""
    late_s: float = Field(10.0, gt=0, le=60)
    """a stamp that is this many seconds behind the newest one is a late copy over a second path; a
    stamp further behind is a reboot or damaged: a second consistent stamp is required"""
    gap_s: float = Field(10.0, gt=0, le=3600)
    """seconds of the vehicle's clock within which a second stamp must follow such a one"""
    datum_limit_m: float = Field(700.0, gt=0, le=10_000)
    """barometer and GNSS may differ by this, more than twice what the deepest low can do, ..."""
    datum_limit_ratio: float = Field(0.15, ge=0, le=1)
    """... plus this share of the height, which is what an arctic winter can do"""
    datum_time_s: float = Field(10.0, gt=0, le=600)
    """how long they must contradict each other before one is disbelieved, or agree before it is
    believed again"""
    credible_gnss_sd_m: float = Field(20.0, gt=0, le=1000)
    """a fix that admits more than this accuses nobody"""
    step_limit_m: float = Field(60.0, gt=0, le=10_000)
    """barometer and GNSS may move apart by this at once, beyond what speed and accuracy explain"""
    equal_heights: Literal["doubt", "ellipsoid", "sea_level"] = "doubt"
    """what a GNSS height is that equals the height above the ellipsoid to the millimetre: in doubt
    (the geoid's undulation is added to the reported accuracy), one above the ellipsoid (the
    undulation is subtracted), or one above sea level (as simulators without a geoid send)"""
    air_temperature: Literal["hygrometer", "airspeed", "imu", "none"] = "hygrometer"
    """Source of the air temperature: HYGROMETER_SENSOR, a probe in the air; airspeed is
    SCALED_PRESSURE.temperature_press_diff, the sensor behind a pitot tube; imu is
    HIGHRES_IMU.temperature, a die 10-30 K above the air (give air_temperature_excess_k)."""
    air_temperature_excess_k: float = Field(0.0, ge=-20, le=60)
    """Excess of that temperature over the air's, K: it is subtracted."""
