"""What the vertical bank assumes: section ``estimators.vertical-bank``. Every prior has its unit in
the key and its source in the description; the docs (docs/vertical-bank.md) give the tables."""

import math
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from companion.estimators.params import EstimatorSettings

Positive = Annotated[float, Field(gt=0, le=1e6)]
Spread = Annotated[float, Field(ge=0, le=10)]
Share = Annotated[float, Field(gt=0, le=1)]


class VerticalBankSettings(EstimatorSettings):
    """Section ``estimators.vertical-bank``. A spread of 0 switches its error term off."""

    integrity: bool = True
    """whether sensor faults are hypothesised; false: every plausible measurement is used"""
    vehicle_attitude: bool = False
    """whether the autopilot's attitude is preferred while it agrees with our own (an EKF's attitude
    is wrong while it starts and while GNSS is jammed)"""
    accel_noise_mps2_rthz: float = Field(0.05, gt=0, le=10)
    """noise density of the upward acceleration, vibration and attitude included (consumer IMU)"""
    blind_psd_m2ps3: float = Field(10.0, gt=0, le=1e4)
    """spectral density of the vehicle's acceleration without a usable IMU (a light aircraft's
    manoeuvre: 4.4 m/s2 for 2 s)"""
    tilt_ratio: float = Field(0.3, ge=0, le=10)
    """share of the attitude's spread that becomes noise while the horizontal force changes"""
    accel_bias_sd_mps2: float = Field(0.2, ge=0, le=10)
    """standard deviation of the accelerometer's bias: a consumer part after warm-up, with a tilt of
    some degrees"""
    accel_bias_walk_mps2_rts: float = Field(2e-3, ge=0, le=1)
    """random walk of the accelerometer bias"""
    offset_sd_m: float = Field(100.0, gt=0, le=10_000)
    """standard deviation at the start of the barometer's slow error at sea level; 100 m is 12 hPa
    of weather"""
    offset_walk_m_rts: float = Field(0.05, ge=0, le=10)
    """random walk of the barometer's slow error: 3 m in an hour, half of it the slope of pressure
    en route (4 m per 100 km)"""
    rate_sd_mps: tuple[Spread, Spread, Spread] = (0.003, 0.03, 0.1)
    """standard deviation of the drift rate of the barometer's error in calm, fair and stormy
    weather (a year of METARs has 4.7 m/h sd, 31 m/h at most; a jump line 25 m in four minutes)"""
    rate_time_s: tuple[Positive, Positive, Positive] = (1800.0, 600.0, 600.0)
    """correlation time of the drift rate in each weather"""
    measured_rate_sd_mps: tuple[Spread, Spread, Spread] = (0.002, 0.009, 0.03)
    """standard deviation of the drift rate beside the weather that a ground barometer measures, in
    calm, fair and stormy weather: both sensors' own drift (1.6 Pa/K over 20 K in half an hour); a
    station that errs as fast as is plausible (31 m/h); places that a front reaches one after the
    other"""
    weather_prior: tuple[Share, Share, Share] = (0.94, 0.05, 0.01)
    """share of time with calm, fair and stormy weather"""
    switching_s: float = Field(1200.0, gt=0, le=1e6)
    """mean time for which the weather stays of one kind"""
    fast_sd_m: float = Field(1.5, ge=0, le=100)
    """standard deviation of the barometer's fast error: gusts over the static port, sensor
    wander"""
    gust_ratio: tuple[Positive, Positive, Positive] = (1.0, 2.0, 1.0)
    """the barometer's fast error in calm, fair and stormy weather, over `fast_sd_m`: a static port
    that errs by a tenth of the velocity head errs by 3 m in gusts of 10 m/s"""
    fast_time_s: float = Field(60.0, gt=0, le=1e5)
    """correlation time of the barometer's fast error"""
    scale_sd_ratio: float = Field(0.05, ge=0, le=1)
    """standard deviation of the change of the barometer's error with height; 0.05 is a column 15 K
    from standard"""
    scale_walk_rts: float = Field(1e-4, ge=0, le=1)
    """random walk of the change of the barometer's error with height; 0.0001 is 0.7 % from one
    layer of 250 m to the next"""
    port_sd_ratio: float = Field(0.15, ge=0, le=10)
    """standard deviation of the static port error, as a share of dynamic pressure (0.10-0.17 on
    four light aircraft)"""
    wind_sd_mps: float = Field(5.0, ge=0, le=100)
    """standard deviation of the speed from which the static port error is computed: wind beside a
    ground speed, age of an airspeed"""
    lift_sd_m: float = Field(8.0, ge=0, le=1000)
    """standard deviation of the barometer error that comes with lift-off (10-13 m on three of four
    light aircraft)"""
    lift_speed_mps: float = Field(28.0, gt=0, le=1000)
    """airspeed from which the lift-off error is complete; below, it grows with the square of the
    airspeed"""
    lag_sd_s: float = Field(1.0, ge=0, le=10)
    """standard deviation of the barometer's delay behind GNSS (0.5-1.2 s of avionics, 0.1 s of a
    MEMS part)"""
    timing_sd_s: float = Field(0.3, ge=0, le=10)
    """standard deviation of the jitter of time stamps; a height errs by it times the climb"""
    known_qnh_sd_pa: float = Field(100.0, gt=0, le=10_000)
    """standard deviation of a QNH that is given (section `air`): rounded down to a hectopascal, of
    another place"""
    known_temperature_sd_k: float = Field(5.0, gt=0, le=100)
    """standard deviation of the column's mean temperature about an air temperature that is given"""
    known_elevation_sd_m: float = Field(1.0, gt=0, le=100)
    """standard deviation of a field elevation that is given: sensors sit up to 3 m above the
    ground"""
    baro_sd_m: float = Field(0.5, gt=0, le=100)
    """standard deviation of the barometer height's white noise; more while the measurements show
    more"""
    gnss_time_s: float = Field(250.0, gt=0, le=1e5)
    """correlation time of the slow GNSS height error"""
    gnss_slow_floor_m: float = Field(2.5, ge=0, le=100)
    """least standard deviation of the slow GNSS error of a plain 3D fix, whatever accuracy is
    reported"""
    gnss_white_floor_m: float = Field(0.6, gt=0, le=100)
    """least standard deviation of the white noise of the height of a plain 3D fix"""
    gnss_sd_unknown_m: float = Field(10.0, gt=0, le=1000)
    """standard deviation of the height of a receiver that reports no accuracy"""
    gnss_climb_sd_mps: float = Field(0.6, gt=0, le=100)
    """standard deviation of a GNSS climb: more than its noise, as its errors last for seconds"""

    tempering_ratio: float = Field(0.3, gt=0, le=1)
    """share of a measurement's log-likelihood that updates the mode probabilities: real errors are
    correlated"""
    fault_rate_per_h: float = Field(0.1, gt=0, le=100)
    """rate of sudden faults of a sensor (several per ten flight hours in public logs)"""
    slide_rate_per_h: float = Field(0.03, gt=0, le=100)
    """rate of slow faults (spoofing, blocked ports)"""
    gnss_jump_m: float = Field(200.0, gt=0, le=1e5)
    """standard deviation of a sudden GNSS fault"""
    slide_sd_mps: float = Field(1.0, gt=0, le=100)
    """standard deviation of the rate of a slow GNSS fault"""
    slide_time_s: float = Field(300.0, gt=0, le=1e5)
    """correlation time of the rate of a slow GNSS fault"""
    slide_end_s: float = Field(1800.0, gt=0, le=1e6)
    """mean duration of a slow GNSS fault"""
    jump_time_s: float = Field(3600.0, gt=0, le=1e6)
    """mean time after which a GNSS jump that was not reversed has ended"""
    rejump_rate_per_h: float = Field(30.0, gt=0, le=1e4)
    """rate of further jumps of a faulty sensor, the one that ends the fault among them"""
    slide_onset_m: float = Field(5.0, gt=0, le=1000)
    """standard deviation of a slow fault's size when it is first hypothesised"""
    baro_jump_m: float = Field(60.0, gt=0, le=1e5)
    """standard deviation of a sudden barometer fault"""
    baro_fault_rate_mps: float = Field(1.0, gt=0, le=100)
    """standard deviation of the drift rate of a faulty barometer"""
    baro_fault_rate_time_s: float = Field(60.0, gt=0, le=1e5)
    """correlation time of the drift rate of a faulty barometer"""
    baro_fault_walk_m_rts: float = Field(0.3, ge=0, le=100)
    """random walk of the offset of a faulty barometer"""
    baro_fault_time_s: float = Field(20.0, gt=0, le=1e5)
    """mean duration of a barometer fault; its offset stays"""
    outage_fault_m: float = Field(300.0, gt=0, le=1e5)
    """standard deviation of a barometer fault that was not observable during a GNSS outage"""
    outage_fault_probabilities: tuple[Share, Share] = (0.03, 0.003)
    """probability of a barometer fault during a GNSS outage, without and with an IMU"""
    imu_fault_time_s: float = Field(30.0, gt=0, le=1e5)
    """mean duration of an IMU fault"""
    manoeuvre_time_s: float = Field(5.0, gt=0, le=1e5)
    """mean duration of an unusual manoeuvre"""
    manoeuvre_rate_per_h: float = Field(60.0, gt=0, le=1e5)
    """rate of unusual manoeuvres, which matter without an IMU"""
    manoeuvre_mps: float = Field(5.0, gt=0, le=1000)
    """standard deviation of the unexplained climb when an unusual manoeuvre is first
    hypothesised"""
    manoeuvre_ratio: float = Field(10.0, ge=1, le=1000)
    """spectral density of the acceleration in an unusual manoeuvre, over `blind_psd_m2ps3`"""
    start_climb_mps: float = Field(30.0, gt=0, le=1000)
    """standard deviation of the climb at the start and after a long silence"""

    attribution_probability: float = Field(0.9, gt=0.5, lt=1)
    """probability of a sensor's faulty modes from which the sensor is named and excluded"""
    integrity_risk_probability: float = Field(1e-3, gt=0, lt=1)
    """chance that the error exceeds the protection level within an hour"""
    alert_limit_m: float = Field(50.0, gt=0, le=10_000)
    """protection level above which ALTITUDE stops, unless the receiver itself reports more"""

    def derived(self) -> Mapping[str, Any]:
        return {
            "crossings_per_h": 2.0 * 3600.0 / (math.sqrt(math.tau) * self.gnss_time_s),
            "risk_sigma": crossing_sigma(self.integrity_risk_probability, self.gnss_time_s),
        }


def crossing_sigma(rate_per_h: float, time_s: float) -> float:
    """the level k that an error with this correlation time exceeds so often, in sigma; NaN for a
    rate of 1 and more.

    A Gauss-Markov process leaves +-k at the rate 2 k / (sqrt(2 pi) tau) exp(-k^2 / 2), for k well
    above 1.
    """
    if rate_per_h >= 1.0:
        return math.nan
    low, high = 1.0, 20.0
    for _ in range(60):
        k = 0.5 * (low + high)
        rate = 3600.0 / time_s * 2.0 * k / math.sqrt(math.tau) * math.exp(-0.5 * k * k)
        low, high = (k, high) if rate > rate_per_h else (low, k)
    return high
