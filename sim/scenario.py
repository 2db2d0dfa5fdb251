"""A scenario: what is flown, in which weather, with which sensors. YAML holds what differs from the
defaults here."""

import importlib.resources
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from companion.config import Settings, load
from companion.errors import SimulationError
from sim.airframes import MODELS, Model
from sim.faults import AnyFault
from sim.ground_station import GroundStationConfig
from sim.pilot.gains import GAINS
from sim.pilot.profile import Airspeed, Altitude, Land, Leg, TakeOff
from sim.sensors.barometer import BarometerConfig
from sim.sensors.gnss import GnssConfig
from sim.sensors.imu import ImuConfig
from sim.sensors.thermometer import ThermometerConfig
from sim.vehicle.flavours import FLAVOURS, FlavourName
from sim.vehicle.own_estimate import EstimateConfig
from sim.vehicle.ports import check_rates
from sim.weather import WeatherConfig

_REPOSITORY = Path(__file__).parent.parent / "config" / "scenarios"


class Sensors(Settings):
    """Parameters of the sensors, one group for each."""

    barometer: BarometerConfig = BarometerConfig()
    thermometer: ThermometerConfig = ThermometerConfig()
    gnss: GnssConfig = GnssConfig()
    imu: ImuConfig = ImuConfig()
    estimate: EstimateConfig = EstimateConfig()


class Runway(Settings):
    """The runway at which the flight begins."""

    latitude_deg: Annotated[float, Field(ge=-89.0, le=89.0)] = 47.0
    """geodetic latitude of the threshold, north positive"""
    longitude_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 8.0
    """longitude of the threshold, east positive"""
    elevation_m: Annotated[float, Field(ge=-400.0, le=5000.0)] = 300.0
    """elevation of the runway and of all ground above mean sea level"""
    heading_deg: Annotated[float, Field(ge=0.0, lt=360.0)] = 90.0
    """true heading of take-off and landing"""


class Aloft(Settings):
    """Start in the air above the runway, engines running."""

    altitude_amsl_m: Altitude
    """altitude above mean sea level of the start"""
    airspeed_mps: Airspeed | None = None
    """calibrated airspeed of the start; None is the aircraft's cruise"""


Sensor = Literal["barometer", "gnss"]
HealthName = Literal["OK", "DEGRADED", "LOST"]


class Expected(Settings):
    """What the default estimator, and what the companion publishes, must do on the flight."""

    published_error_m: Annotated[float, Field(gt=0.0, le=1000.0)] = 50.0
    """largest error of a published ALTITUDE"""
    published_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """least share of the time with an ALTITUDE, after the first minute"""
    ratio_to_gnss: Annotated[float, Field(gt=0.0, le=100.0)] | None = None
    """largest RMSE in parts of the raw GNSS height's"""
    health: HealthName = "DEGRADED"
    """worst health at the end of the flight"""
    excluded: tuple[Sensor, ...] = ()
    """sensors that must be named as faulty during the flight"""
    not_excluded: tuple[Sensor, ...] = ()
    """sensors that must never be named as faulty"""


class Scenario(Settings):
    """One flight. Everything but its name, summary and profile has a default."""

    name: Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[a-z0-9][a-z0-9-]*$")]
    """name of the scenario, its log and its pictures; lower-case letters, digits and hyphens"""
    summary: Annotated[str, Field(min_length=1, max_length=200)]
    """one sentence that describes the flight"""
    about: str = ""
    """purpose of the flight: what makes it hard, and for whom"""
    expected: Expected = Expected()
    aircraft: str = "c172p"
    """aircraft: c172p (trainer), 737 (airliner), f16 (fighter), sgs126 (glider)"""
    flavour: FlavourName = "ardupilot"
    """autopilot that the vehicle simulates towards MAVLink clients"""
    seed: Annotated[int, Field(ge=0, le=2**31 - 1)] = 1
    """seed of all random numbers; the same seed gives the same bytes"""
    limit_s: Annotated[float, Field(gt=0.0, le=200_000.0)] = 7200.0
    """duration above which the flight ends with an error"""
    runway: Runway = Runway()
    aloft: Aloft | None = None
    """An aircraft without an engine needs it."""
    flown_by: Literal["truth", "estimate"] = "truth"
    """altitude that climbs, holds and descents follow: the true one, or the vehicle's own estimate
    with the weather's error in it; near the ground it is the true one"""
    endless_fuel: bool = False
    """whether the engines burn no fuel; if false, a flight whose tanks are empty ends with an
    error"""
    profile: Annotated[tuple[Leg, ...], Field(min_length=1)]
    """legs of the flight in their order"""
    weather: WeatherConfig = WeatherConfig()
    sensors: Sensors = Sensors()
    ground_station: GroundStationConfig | None = None
    """A ground station that measures the pressure."""
    streams_hz: dict[str, Annotated[float, Field(ge=0.0, le=50.0)]] = Field(default_factory=dict)
    """rates by message name; they replace those of a log and, with --all-streams, of a link"""
    faults: tuple[AnyFault, ...] = ()
    """faults between the vehicle and its peers, on every link and in the log (see
    `sim.faults`)"""

    @property
    def planned_s(self) -> float:
        """A rough duration: the holds and waits, and the heights at the rate of a trainer."""
        heights_m = [
            self.runway.elevation_m if self.aloft is None else self.aloft.altitude_amsl_m,
            *(leg.altitude_amsl_m for leg in self.profile if hasattr(leg, "altitude_amsl_m")),
            *(self.runway.elevation_m for leg in self.profile[-1:] if isinstance(leg, Land)),
        ]
        held_s = sum(leg.duration_s for leg in self.profile if hasattr(leg, "duration_s"))
        climbed_m = sum(abs(after - before) for before, after in pairwise(heights_m))
        return float(held_s + climbed_m / 3.0)

    @model_validator(mode="after")
    def _can_be_flown(self) -> "Scenario":
        if self.aircraft not in MODELS:
            raise ValueError(f"aircraft: no '{self.aircraft}'; give one of {', '.join(MODELS)}")
        check_rates(self.streams_hz, FLAVOURS[self.flavour])
        check_order(
            [leg.leg for leg in self.profile], MODELS[self.aircraft], aloft=self.aloft is not None
        )
        for before, after in zip(self.profile, (*self.profile[1:], None), strict=True):
            if isinstance(before, Land) and before.touch_and_go and not isinstance(after, TakeOff):
                raise ValueError("a touch-and-go is followed by a take_off")
        self._check_airspeeds()
        lowest_m = self.runway.elevation_m + 50.0
        for place in (*self.profile, self.aloft):
            altitude_m = getattr(place, "altitude_amsl_m", None)
            if altitude_m is not None and altitude_m < lowest_m:
                raise ValueError(
                    f"altitude_amsl_m {altitude_m:g} is not 50 m above the runway at "
                    f"{self.runway.elevation_m:g} m"
                )
        return self

    def _check_airspeeds(self) -> None:
        least_mps = GAINS[self.aircraft].minimum_mps
        for place in (*self.profile, self.aloft):
            airspeed_mps = getattr(place, "airspeed_mps", None)
            if airspeed_mps is not None and airspeed_mps < least_mps:
                raise ValueError(
                    f"airspeed_mps {airspeed_mps:g} is too slow for {self.aircraft}: at least "
                    f"{least_mps:g}"
                )


def check_order(legs: Sequence[str], model: Model, *, aloft: bool) -> None:
    """Check that each leg begins where the leg before it ended, on the ground or in the air, with
    an engine if it needs one.

    Raises `ValueError`.
    """
    if not model.engines:
        if not aloft:
            raise ValueError("this aircraft has no engine: give it an altitude to start at (aloft)")
        legs_with_power = [leg for leg in legs if leg in ("take_off", "climb", "hold", "descend")]
        if legs_with_power:
            raise ValueError(
                f"this aircraft has no engine for a {legs_with_power[0]}: it can glide and land"
            )
    for leg in legs:
        if leg in ("wait", "take_off") and aloft:
            raise ValueError(f"a {leg} begins on the ground: after the start or a landing")
        if leg not in ("wait", "take_off") and not aloft:
            raise ValueError(f"a {leg} begins in the air: after a take_off")
        aloft = leg not in ("wait", "land")


def scenario_paths() -> dict[str, Path]:
    """The scenarios that come with the simulator: of the checkout, or of the installed package."""
    folder = (
        _REPOSITORY
        if _REPOSITORY.is_dir()
        else Path(str(importlib.resources.files("sim"))) / "scenarios"
    )
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def load_scenario(name_or_path: str | Path) -> Scenario:
    """A scenario by the path of its file or by name.

    Raises `SimulationError` when there is no such scenario, `ConfigError` when its file cannot be
    used.
    """
    path = Path(name_or_path)
    if path.suffix in (".yaml", ".yml"):
        return load(path, Scenario)
    known = scenario_paths()
    if str(name_or_path) not in known:
        raise SimulationError(
            f"no scenario '{name_or_path}': there are {', '.join(known)} (or give the path of a "
            ".yaml file)"
        )
    return load(known[str(name_or_path)], Scenario)
