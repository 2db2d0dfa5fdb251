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
    """thermometer that is used: air is a probe in the air; die adds the barometer's own sensor,
    10-30 K too warm, where there is no probe; none uses neither"""
    temperature_law: Literal["exact", "linear", "printed"] = "exact"
    """scale factor as a function of temperature: exact is T0/T - 1, linear its linear part, printed
    that with the paper's wrong sign"""
    regressor: Literal["predicted", "gnss"] = "predicted"
    """height by which bias and scale factor are separated: the filter's prediction, or the GNSS
    height as the paper prints"""
    covariance: Literal["joint", "marginal"] = "joint"
    """covariance of bias and scale factor after a fix: joint keeps their correlation, marginal
    drops it as the paper does"""
    correction: Literal["carried", "filtered"] = "carried"
    """path of a new correction to the height: carried changes it at once, filtered passes it
    through the height filter as the paper does"""
    outliers: Literal["damped", "kept"] = "damped"
    """weight of measurements far from the prediction: damped reduces it, kept does not"""
    reference_height_m: float = Field(0.0, ge=-500, le=9000)
    """height H_0 at which the scale factor has no effect"""
    scale_walk_per_second: float = Field(5e-9, gt=0, le=1)
    """growth of the scale factor's variance in a second (Q^a)"""
    bias_walk_m2ps: float = Field(0.05, gt=0, le=1e6)
    """growth of the bias' variance in a second (Q^b)"""
    climb_walk_m2ps3: float = Field(8.0, gt=0, le=1e6)
    """growth of the climb's variance in a second (Q^h); 8 is 2 m/s2 that last a second"""
    climb_time_s: float = Field(100.0, ge=10, le=1e6)
    """time constant of the climb's decay (tau)"""
    scale_sd: float = Field(0.05, gt=0, le=1)
    """standard deviation of the scale factor at the start; 0.05 is 15 K"""
    bias_sd_m: float = Field(100.0, gt=0, le=10_000)
    """standard deviation of the bias at the start; 100 m is 12 hPa"""
    baro_variance_m2: float = Field(0.25, gt=0, le=1e6)
    """variance of the barometer height's white noise, gusts and propellers included (R^B)"""
    gnss_variance_m2: float | Literal["claimed"] = "claimed"
    """variance of a GNSS height (R^GPS): a number, or claimed: from the reported accuracy"""
    gnss_sd_floor_m: float = Field(2.0, gt=0, le=100)
    """least standard deviation of a GNSS height; a smaller reported accuracy is raised to it"""
    gnss_sd_unknown_m: float = Field(10.0, gt=0, le=1000)
    """standard deviation of a GNSS height whose receiver reports no accuracy"""
    temperature_sd_k: float = Field(1.5, gt=0, le=100)
    """standard deviation of a measured air temperature"""
    temperature_time_s: float = Field(60.0, ge=0, le=1e5)
    """time within which temperatures count as one measurement; 0: each counts"""
    die_offset_k: float = Field(20.0, ge=-50, le=100)
    """excess of the barometer's own thermometer over the air's temperature"""
    die_sd_k: float = Field(10.0, gt=0, le=100)
    """standard deviation of die_offset_k"""

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
