"""What the vertical bank is held against: its goals, and how a measured row is judged by
its limits."""

import math
from dataclasses import asdict, dataclass
from typing import Any, Self


@dataclass(frozen=True)
class Goal:
    """A line of the goal table: one test, measured by the rows of one section."""

    key: str
    section: str
    test: str
    goal: str


_GOALS = (
    Goal(
        "jsbsim",
        "flights",
        "recorded jsbsim_A, jsbsim_B, no GNSS vertical velocity",
        "RMSE <= 2.6, 2.6 m; climb <= .08, .10 m/s",
    ),
    Goal(
        "simulated",
        "flights",
        "mean over >= 20 seeds: calm-circuit, weather-change, airliner-descent, airliner-front",
        "RMSE <= 2.9, 3.1, 3.1, 3.4 m",
    ),
    Goal(
        "simulated-climb",
        "flights",
        "the same with GNSS vertical velocity (R .6 m/s)",
        "RMSE <= 2.5, 2.65, 2.5, 3.0 m",
    ),
    Goal(
        "qnh",
        "flights",
        "all pressures scaled by +-12 hPa at sea level, jsbsim_A and ardupilot_nominal",
        "estimate changes by <= .1 m after 60 s",
    ),
    Goal("thinned", "flights", "IMU 4 Hz, barometer 4 Hz, GNSS 1 Hz", "RMSE <= 10 % worse"),
    Goal(
        "ardupilot",
        "flights",
        "recorded ardupilot_nominal, ardupilot_weather",
        "RMSE <= .15 m; <= 2.4 m and max 5.5 m",
    ),
    Goal(
        "baro-faults",
        "faults",
        "flights with barometer faults, hot day",
        "RMSE <= 2.4 m, max <= 5.5 m",
    ),
    Goal("gnss-faults", "faults", "flights with GNSS faults", "RMSE <= 2.6 m, max <= 9 m"),
    Goal("takeoff", "flights", "height above take-off, barometer healthy", "RMSE <= .5 m"),
    Goal(
        "outage",
        "flights",
        "300 s GNSS outage in the weather ramp of jsbsim_B",
        "RMSE <= 20 m, max 33 m",
    ),
    Goal(
        "bound",
        "bound",
        "S1-S5 of the papers' common scenarios with their priors, 200 seeds; S6-S8",
        "RMSE <= 1.10 x Cramer-Rao bound; <= 1.15 x fault-free",
    ),
    Goal("nees", "flights", "NEES of height, >= 24 seeds", ".7 to 1.4"),
    Goal(
        "baro-step",
        "faults",
        "barometer step +15 m, ramp 1 m/s: attributed right",
        "100 % within 1 s, 3 s",
    ),
    Goal(
        "frozen",
        "faults",
        "frozen barometer in a climb or descent",
        "within max(1 s, 11 update intervals)",
    ),
    Goal("gnss-step", "faults", "GNSS +30 m", "excluded <= 1.5 s, and stays excluded while wrong"),
    Goal(
        "gnss-ramp",
        "faults",
        "GNSS ramp 2 m/s detected, attributed; .5 m/s detected",
        "<= 45, 60 s; >= 70 % in 100 s",
    ),
    Goal("false-alarms", "protection", "false alarms", "0 in 10 h of healthy flight"),
    Goal(
        "protection",
        "protection",
        "protection level, 1000 h at sensor level and 20 h of JSBSim; median on jsbsim_A and "
        "jsbsim_B",
        "exceedances at 1e-1, 1e-2, 1e-3 an hour within 95 % Poisson of what is allocated and not "
        "below a tenth; median <= 25 m",
    ),
    Goal(
        "cost",
        "flights",
        "cost of an IMU sample in the compiled loop; checkpoint",
        "<= 2.5 us; < 64 KiB",
    ),
    Goal(
        "real-ratio",
        "real",
        "real flights: RMSE / raw GNSS, mean over flights and errors at every IMU rate; worst cell",
        "<= .75; <= 1.1",
    ),
    Goal(
        "real-smoothed",
        "real",
        "real flights: RMSE of the smoother / raw GNSS; squared error over variance",
        "<= .60; .4 to 1.4",
    ),
    Goal(
        "real-max",
        "real",
        "real flights: largest error / that of raw GNSS, mean; worst cell",
        "<= 1.2; <= 2",
    ),
    Goal("real-nees", "real", "real flights: NEES over the errors laid on", ".7 to 1.4"),
    Goal(
        "real-takeoff",
        "real",
        "real flights, field elevation known to 1 m: height above take-off",
        "RMSE <= 3.0 m",
    ),
    Goal(
        "real-sent",
        "real",
        "real flights without a fault: ALTITUDE sent; sent and > 50 m wrong",
        ">= 98 % of the slots; none",
    ),
    Goal(
        "real-health",
        "real",
        "real flights: OK although the error is beyond 4 standard deviations",
        "never longer than 5 s",
    ),
    Goal(
        "real-level",
        "real",
        "real flights: protection level; share of ALTITUDE beyond it",
        "median <= 13 m; <= 1e-3",
    ),
    Goal(
        "real-cost",
        "real",
        "real flights at 50 Hz: processor time of the compiled loop for an IMU sample",
        "<= 4 us",
    ),
    Goal(
        "real-presets",
        "real",
        "simulated flights with the barometer presets of real aircraft: RMSE / raw GNSS, less "
        "that of the real flights, without IMU",
        "within .1",
    ),
    Goal(
        "real-rtk",
        "real",
        "recorded RTK receiver: RMSE / that of the receiver; RMSE / spread; level",
        "<= 1.5; .5 to 2; < .5 m",
    ),
    Goal(
        "real-gnss-step",
        "real",
        "GNSS step >= 30 m on real flights: named; published error; back after it; 10 minutes",
        "<= 1 s; <= 15 m; <= 2 s; stays out",
    ),
    Goal(
        "real-gnss-ramp",
        "real",
        "GNSS ramps on real flights",
        "2 m/s named <= 12 s, error <= 12 m; 1 m/s 40 s, 25 m; .5, .3 m/s silent before 50 m",
    ),
    Goal(
        "real-baro-step",
        "real",
        "barometer step of 15 m, frozen barometer on real flights: named; published error",
        "<= .5 s; <= 10 m",
    ),
    Goal(
        "real-baro-blind",
        "real",
        "barometer moves 50, 300 m without GNSS on real flights: published error",
        "<= 15 m or silent",
    ),
    Goal(
        "real-return",
        "real",
        "first ALTITUDE after an outage, gap, short contact, restart",
        "<= 5 s",
    ),
    Goal(
        "real-scenarios",
        "real",
        "the simulator's scenarios with IMU at 0 to 5 Hz",
        "no ALTITUDE > 50 m wrong",
    ),
    Goal("real-outage", "real", "NEES of outages of 60 to 600 s on real flights", "<= 1.5"),
    Goal(
        "outages-nees",
        "outages",
        "NEES of outages of 60, 300, 600 s, every estimator, all real weather",
        "<= 1.5",
    ),
    Goal("outages-sent", "outages", "ALTITUDE in these outages: largest error", "<= 50 m"),
    Goal("outages-return", "outages", "first ALTITUDE after them later than 5 s", "none"),
)

GOALS: dict[str, Goal] = {goal.key: goal for goal in _GOALS}
"""The goals by key, in the order of the index."""


@dataclass(frozen=True)
class Measured:
    """One figure that a goal is judged by. A limit that is None does not bind."""

    goal: str
    """key in `GOALS`"""
    what: str
    """such as "jsbsim_A, climb" """
    value: float | None = None
    """None is "not run"; NaN is a figure that could not be had, and misses"""
    at_most: float | None = None
    at_least: float | None = None
    unit: str = ""
    shown: str = ""
    """in place of the bare value: with its confidence interval, say"""
    note: str = ""

    @property
    def excess(self) -> float:
        """Distance of the value from its limits; 0 when it is within."""
        if self.value is None:
            return math.nan
        if math.isnan(self.value):
            return math.inf
        over = self.value - self.at_most if self.at_most is not None else 0.0
        under = self.at_least - self.value if self.at_least is not None else 0.0
        return max(over, under, 0.0)

    @property
    def verdict(self) -> str:
        """Such as "met", "**missed by 0.3 m**" or "not run"."""
        if self.value is None:
            return "not run"
        if self.excess == 0.0:
            return "met"
        by = f" by {_with_unit(self.excess, self.unit)}" if math.isfinite(self.excess) else ""
        return f"**missed{by}**"

    @property
    def limits(self) -> str:
        """Such as "<= 2.6 m" or "0.7 to 1.4"."""
        if self.at_most is not None and self.at_least is not None:
            return _with_unit(f"{self.at_least:g} to {self.at_most:g}", self.unit)
        if self.at_most is not None:
            return _with_unit(f"<= {self.at_most:.4g}", self.unit)
        return _with_unit(f">= {self.at_least:.4g}", self.unit) if self.at_least is not None else ""

    @property
    def text(self) -> str:
        """The value as it is shown."""
        if self.value is None:
            return ""
        return _with_unit(self.shown or self.value, self.unit)

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready: NaN is the text "nan"."""
        row = asdict(self)
        return row | {"value": "nan"} if self.value is not None and math.isnan(self.value) else row

    @classmethod
    def of(cls, row: dict[str, Any]) -> Self:
        """The inverse of `as_dict`."""
        return cls(**row | ({"value": math.nan} if row.get("value") == "nan" else {}))


def _with_unit(value: float | str, unit: str) -> str:
    text = value if isinstance(value, str) else f"{value:.3g}"
    return f"{text} {unit}".rstrip()
