"""What the vertical bank assumes: section ``estimators.vertical-bank``, and the same as numbers for
its steps."""

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from companion.config import Settings
from companion.estimators.vertical_bank.mixture import BANK
from companion.samples import Rows, rows

PARAMS = np.dtype(
    [
        ("integrity", "i8"),
        ("vehicle_attitude", "i8"),
        ("accel_noise_mps2", "f8"),
        ("blind_noise_mps2", "f8"),
        ("tilt_ratio", "f8"),
        ("accel_bias_sd_mps2", "f8"),
        ("accel_bias_walk_mps2", "f8"),
        ("offset_sd_m", "f8"),
        ("offset_walk_m", "f8"),
        ("known_qnh_sd_pa", "f8"),
        ("known_temperature_sd_k", "f8"),
        ("rate_sd_mps", "f8", (BANK,)),
        ("rate_time_s", "f8"),
        ("weather_prior", "f8", (BANK,)),
        ("switching_s", "f8"),
        ("fast_sd_m", "f8"),
        ("fast_time_s", "f8"),
        ("scale_sd_ratio", "f8"),
        ("scale_walk_ratio", "f8"),
        ("baro_sd_m", "f8"),
        ("gnss_time_s", "f8"),
        ("gnss_slow_ratio", "f8"),
        ("gnss_slow_floor_m", "f8"),
        ("gnss_white_ratio", "f8"),
        ("gnss_white_floor_m", "f8"),
        ("gnss_sd_unknown_m", "f8"),
        ("gnss_climb_sd_mps", "f8"),
        ("protection_sigma", "f8"),
        ("fault_sigma", "f8"),
    ],
    align=True,
)


class VerticalBankSettings(Settings):
    """Section ``estimators.vertical-bank``. Each state can be switched off by a spread of 0, the
    bank by three equal rates."""

    integrity: bool = True
    """name a sensor that is wrong, and leave it out; without this, whatever is plausible is taken"""
    vehicle_attitude: bool = False
    """prefer the autopilot's attitude while it agrees with our own; an EKF's is wild while it
    starts and when jammed"""
    accel_noise_mps2: float = Field(0.05, gt=0, le=10)
    """white noise of the upward acceleration in the mean of a second, vibration and attitude
    included"""
    blind_noise_mps2: float = Field(1.5, gt=0, le=100)
    """the same without IMU: manoeuvres"""
    tilt_ratio: float = Field(0.3, ge=0, le=10)
    """noise that a wrong attitude adds while the horizontal force changes, over what its spread
    says, which is wide"""
    accel_bias_sd_mps2: float = Field(0.2, ge=0, le=10)
    """of a consumer accelerometer after warm-up, and a tilt of some degrees"""
    accel_bias_walk_mps2: float = Field(2e-3, ge=0, le=1)
    """its random walk in a second"""
    offset_sd_m: float = Field(100.0, gt=0, le=10_000)
    """barometer's slow error at sea level at the start: 12 hPa. A tighter prior that is wrong costs
    metres"""
    offset_walk_m: float = Field(0.05, ge=0, le=10)
    """its random walk in a second: 3 m in an hour, besides the drift rate"""
    known_qnh_sd_pa: float = Field(100.0, gt=0, le=10_000)
    """of a QNH that is given (section `air`): it is rounded down to a hectopascal, and of another
    place"""
    known_temperature_sd_k: float = Field(5.0, gt=0, le=100)
    """of an air temperature that is given: the layers above are others"""
    rate_sd_mps: tuple[
        Annotated[float, Field(ge=0, le=10)],
        Annotated[float, Field(ge=0, le=10)],
        Annotated[float, Field(ge=0, le=10)],
    ] = (0.01, 0.1, 0.4)
    """drift rate of the barometer's error on a calm, a fair and a stormy day: 4, 40, 160 hPa an
    hour"""
    rate_time_s: float = Field(600.0, gt=0, le=1e5)
    """for how long a drift rate lasts"""
    weather_prior: tuple[
        Annotated[float, Field(gt=0, le=1)],
        Annotated[float, Field(gt=0, le=1)],
        Annotated[float, Field(gt=0, le=1)],
    ] = (0.8, 0.15, 0.05)
    """share of time with each"""
    switching_s: float = Field(1200.0, gt=0, le=1e6)
    """for how long the weather stays the same kind"""
    fast_sd_m: float = Field(0.5, ge=0, le=100)
    """barometer's fast error: gusts over the static port, sensor wander"""
    fast_time_s: float = Field(60.0, gt=0, le=1e5)
    """for how long that lasts"""
    scale_sd_ratio: float = Field(0.05, ge=0, le=1)
    """change of the barometer's error with height: 15 K"""
    scale_walk_ratio: float = Field(5e-4, ge=0, le=1)
    """its random walk in a second: .03 (9 K) in an hour"""
    baro_sd_m: float = Field(0.4, gt=0, le=100)
    """white noise of the barometer height; more when the stream shows more"""
    gnss_time_s: float = Field(250.0, gt=0, le=1e5)
    """for how long the slow part of the GNSS height error lasts"""
    gnss_slow_ratio: float = Field(0.7, ge=0, le=1)
    """slow part of the spread that the receiver claims"""
    gnss_slow_floor_m: float = Field(2.5, ge=0, le=100)
    """and no less than this"""
    gnss_white_ratio: float = Field(0.7, ge=0, le=1)
    """white part of the spread that the receiver claims"""
    gnss_white_floor_m: float = Field(1.0, gt=0, le=100)
    """and no less than this"""
    gnss_sd_unknown_m: float = Field(10.0, gt=0, le=1000)
    """spread of a receiver that claims nothing"""
    gnss_climb_sd_mps: float = Field(0.6, gt=0, le=100)
    """of a GNSS climb: more than its noise, as its errors last for seconds"""

    integrity_risk_probability: float = Field(1e-3, gt=0, lt=1)
    """chance that the error exceeds the protection level within an hour"""
    fault_probability: float = Field(1e-3, gt=0, lt=1)
    """how often a sensor goes wrong unseen"""

    def params(self) -> Rows:
        row = rows(PARAMS)
        row["protection_sigma"] = crossing_sigma(self.integrity_risk_probability, self.gnss_time_s)
        row["fault_sigma"] = crossing_sigma(
            self.integrity_risk_probability / self.fault_probability, self.gnss_time_s
        )
        for name in PARAMS.names or ():
            if hasattr(self, name):
                row[name] = getattr(self, name)
        return row


def crossing_sigma(rate_per_h: float, time_s: float) -> float:
    """The level k that an error with this correlation time exceeds so often, in sigma; NaN for a
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
