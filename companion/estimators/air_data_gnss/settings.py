"""Settings of the barometer compensated by GNSS and air temperature: section
``estimators.air-data-gnss``, and the letters of the paper."""

import math
from typing import Any, ClassVar, Literal

from pydantic import Field

from companion.estimators.air_data_gnss.error import EXACT, LINEAR, PRINTED
from companion.estimators.params import EstimatorSettings
from companion.kernels.atmosphere import L0_KPM, T0_K

GNSS_GATE, BARO_GATE = 3.0, 5.0
LAWS = {"exact": EXACT, "linear": LINEAR, "printed": PRINTED}

PAPER: dict[str, Any] = {
    "temperature_law": "linear",
    "covariance": "marginal",
    "correction": "filtered",
    "outliers": "kept",
    "scale_walk_per_second": 2e-5 / 0.2,
    "bias_walk_m2ps": 400.0 / 0.2,
    "climb_walk_m2ps3": 39.69 / 0.2,
    "scale_sd": 0.2,
    "bias_sd_m": 20.0,
    "baro_variance_m2": 25.0,
    "gnss_variance_m2": 4900.0,
    "temperature_time_s": 0.0,
}
"""Where section 3 of the paper differs from the defaults, which are the preset ``tuned``."""


class AirDataGnssSettings(EstimatorSettings):
    """Section ``estimators.air-data-gnss``. The defaults are the preset ``tuned``; a key that is
    given overrides it."""

    PRESETS: ClassVar = {"paper": PAPER}

    preset: Literal["tuned", "paper"] = "tuned"
    """defaults of the other keys: physical ones, or those of the paper's simulation"""
    temperature: Literal["air", "die", "none"] = "air"
    """air: only a thermometer in the air is trusted; die: else the barometer's own, which is 10-30
    K too warm"""
    temperature_law: Literal["exact", "linear", "printed"] = "exact"
    """scale factor of a temperature: T0/T - 1, its linear part, or that with the paper's wrong
    sign"""
    regressor: Literal["predicted", "gnss"] = "predicted"
    """height with which GNSS tells bias from scale factor: the filter's own, or GNSS height as the
    paper prints"""
    covariance: Literal["joint", "marginal"] = "joint"
    """marginal: bias and scale factor taken as independent after each fix, as in the paper"""
    correction: Literal["carried", "filtered"] = "carried"
    """filtered: a new correction passes the height filter as if it were a measurement, as in the
    paper"""
    outliers: Literal["damped", "kept"] = "damped"
    """whether measurements far from the prediction lose weight"""
    reference_height_m: float = Field(0.0, ge=-500, le=9000)
    """H0: the scale factor counts from here"""
    scale_walk_per_second: float = Field(5e-9, gt=0, le=1)
    """Q^a: growth of the scale factor's variance in a second"""
    bias_walk_m2ps: float = Field(0.05, gt=0, le=1e6)
    """Q^b: growth of the bias' variance (m2) in a second"""
    climb_walk_m2ps3: float = Field(8.0, gt=0, le=1e6)
    """Q^h: growth of the climb's variance (m2/s2) in a second: 2 m/s2 that last a second"""
    climb_time_s: float = Field(100.0, ge=10, le=1e6)
    """tau: the climb decays with this time constant"""
    scale_sd: float = Field(0.05, gt=0, le=1)
    """spread of the scale factor at the start: 15 K"""
    bias_sd_m: float = Field(100.0, gt=0, le=10_000)
    """spread of the bias at the start: 12 hPa"""
    baro_variance_m2: float = Field(0.25, gt=0, le=1e6)
    """R^B: white noise of the barometer height, with gusts and propellers"""
    gnss_variance_m2: float | Literal["claimed"] = "claimed"
    """R^GPS: a number, or as the receiver claims"""
    gnss_sd_floor_m: float = Field(2.0, gt=0, le=100)
    """a claimed spread below this is not believed"""
    gnss_sd_unknown_m: float = Field(10.0, gt=0, le=1000)
    """spread of a receiver that claims nothing"""
    temperature_sd_k: float = Field(1.5, gt=0, le=100)
    """of an air temperature"""
    temperature_time_s: float = Field(60.0, ge=0, le=1e5)
    """temperatures closer together than this count as one; 0: each counts"""
    die_offset_k: float = Field(20.0, ge=-50, le=100)
    """how much warmer than the air the barometer's own thermometer is"""
    die_sd_k: float = Field(10.0, gt=0, le=100)
    """spread of that"""

    def derived(self) -> dict[str, Any]:
        """The letters of the paper."""
        damped, reported = self.outliers == "damped", self.gnss_variance_m2 == "claimed"
        return {
            "use_air": int(self.temperature != "none"),
            "use_die": int(self.temperature == "die"),
            "law": LAWS[self.temperature_law],
            "regress_gnss": int(self.regressor == "gnss"),
            "joint": int(self.covariance == "joint"),
            "carried": int(self.correction == "carried"),
            "gnss_gate": GNSS_GATE if damped else math.inf,
            "baro_gate": BARO_GATE if damped else math.inf,
            "H_0": self.reference_height_m,
            "T_0": T0_K + L0_KPM * self.reference_height_m,
            "Q_a": self.scale_walk_per_second,
            "Q_b": self.bias_walk_m2ps,
            "Q_h": self.climb_walk_m2ps3,
            "tau": self.climb_time_s,
            "P_a0": self.scale_sd**2,
            "P_b0": self.bias_sd_m**2,
            "R_B": self.baro_variance_m2,
            "R_GPS": math.nan if reported else self.gnss_variance_m2,  # NaN: as reported
            "R_T": self.temperature_sd_k**2,
            "R_die": self.die_sd_k**2,
        }
