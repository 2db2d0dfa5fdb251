"""The simulator's air against the tables of the standard atmosphere, and its forces against the
Earth's gravity."""

import math

import pytest

from companion.errors import SimulationError
from sim import STEP_HZ
from sim.aircraft import Aircraft
from sim.aircraft_state import Controls
from sim.constants import G0_MPS2
from sim.weather import PressurePoint, TemperaturePoint, Weather, WeatherConfig
from sim.weather.fields import Wind

# U.S. Standard Atmosphere 1976, table I (NOAA-S/T 76-1562): geometric altitude m, pressure Pa,
# temperature K.
TABLE = [
    (0.0, 101325.0, 288.150),
    (1000.0, 89876.3, 281.651),
    (2000.0, 79501.4, 275.154),
    (3000.0, 70121.2, 268.659),
    (5000.0, 54048.3, 255.676),
    (8000.0, 35651.6, 236.215),
    (10000.0, 26499.9, 223.252),
]
GAS_CONSTANT = 287.05287
LAPSE_K_PER_M = 0.0065
EARTH_RADIUS_M = 6_356_766.0


def parked(
    elevation_m: float, *, sea_level_pa: float = 101_325.0, offset_k: float = 0.0
) -> Aircraft:
    aircraft = Aircraft(field_elevation_m=elevation_m)
    aircraft.set_air(sea_level_pa, offset_k)
    aircraft.advance(1)
    return aircraft


@pytest.mark.parametrize(("altitude_m", "pressure_pa", "temperature_k"), TABLE)
def test_pressure_and_temperature_follow_the_standard_tables(
    altitude_m: float, pressure_pa: float, temperature_k: float
) -> None:
    truth = parked(altitude_m).truth()
    above_m = truth.altitude_amsl_m - altitude_m  # the centre of gravity on its wheels
    expected_pa = pressure_pa * math.exp(-G0_MPS2 * above_m / (GAS_CONSTANT * temperature_k))
    assert truth.pressure_pa == pytest.approx(expected_pa, abs=1.0)  # 1 Pa is 0.1 m at sea level
    assert truth.temperature_k == pytest.approx(temperature_k, abs=0.02)


@pytest.mark.parametrize("offset_k", [-20.0, 15.0])
@pytest.mark.parametrize("altitude_m", [300.0, 1000.0, 2400.0, 6000.0])
def test_a_warm_or_cold_column_is_in_hydrostatic_balance(
    altitude_m: float, offset_k: float
) -> None:
    """Integrated by hand: T = T0 + offset - L H, p = p0 (T / (T0 + offset)) ** (g0 / (R L)), H
    geopotential."""
    truth = parked(altitude_m, offset_k=offset_k).truth()
    geopotential_m = (
        EARTH_RADIUS_M * truth.altitude_amsl_m / (EARTH_RADIUS_M + truth.altitude_amsl_m)
    )
    base_k = 288.15 + offset_k
    temperature_k = base_k - LAPSE_K_PER_M * geopotential_m
    expected_pa = 101_325.0 * (temperature_k / base_k) ** (G0_MPS2 / (GAS_CONSTANT * LAPSE_K_PER_M))
    assert truth.pressure_pa == pytest.approx(expected_pa, abs=1.0)
    assert truth.temperature_k == pytest.approx(temperature_k, abs=0.02)


def test_a_pressure_ramp_moves_the_static_pressure_in_proportion() -> None:
    aircraft = parked(300.0)
    config = WeatherConfig(
        pressure=(
            PressurePoint(time_s=10, sea_level_hpa=1019),
            PressurePoint(time_s=20, sea_level_hpa=1011),
        )
    )
    weather = Weather(config, aircraft)
    readings = {}
    for time_s in (0.0, 10.0, 12.5, 20.0, 99.0):
        weather.update(time_s)
        aircraft.settle(2.0)
        readings[time_s] = aircraft.air()[0]
    # Hydrostatic balance is linear in the pressure at its foot: at 300 m every hectopascal is worth
    # p/p0 of one.
    for time_s, sea_level_hpa in ((0.0, 1019.0), (12.5, 1017.0), (20.0, 1011.0), (99.0, 1011.0)):
        assert readings[time_s] / readings[10.0] == pytest.approx(sea_level_hpa / 1019.0, rel=2e-7)


def test_a_temperature_ramp_lifts_the_pressure_aloft() -> None:
    config = WeatherConfig(
        temperature=(
            TemperaturePoint(time_s=0, offset_k=0),
            TemperaturePoint(time_s=100, offset_k=15),
        )
    )
    aircraft = parked(2400.0)
    weather = Weather(config, aircraft)
    weather.update(0.0)
    aircraft.advance(1)
    cold_pa, cold_k = aircraft.air()
    weather.update(100.0)
    aircraft.advance(1)
    warm_pa, warm_k = aircraft.air()
    assert warm_k - cold_k == pytest.approx(15.0, abs=0.01)
    # d(ln p) = g H dT / (R T^2) to first order: a warm column is 1.5 % heavier at 2400 m, which
    # reads 120 m low.
    expected = G0_MPS2 * 2400.0 * 15.0 / (GAS_CONSTANT * 280.0 * 295.0)
    assert math.log(warm_pa / cold_pa) == pytest.approx(expected, rel=0.05)


def test_specific_force_at_rest_is_one_local_gravity_upwards() -> None:
    aircraft = Aircraft(latitude_deg=47.0, field_elevation_m=300.0)
    aircraft.settle()
    aircraft.advance(STEP_HZ)
    motion, truth = aircraft.mean_motion(), aircraft.truth()
    sin2 = math.sin(math.radians(47.0)) ** 2
    gravity = (
        9.7803253359 * (1 + 0.00193185265241 * sin2) / math.sqrt(1 - 0.00669437999013 * sin2)
        - 3.086e-6 * 301.0
    )
    forward, right, down = motion.specific_force_b_mps2
    assert math.hypot(forward, right, down) == pytest.approx(gravity, abs=5e-4)
    assert down < -9.7
    assert forward == pytest.approx(
        gravity * math.sin(truth.pitch_rad), abs=2e-3
    )  # nose up: forward is partly up
    assert motion.angular_rate_b_radps == pytest.approx(
        (0.0, 0.0, 0.0), abs=1e-4
    )  # the Earth's 7e-5 rad/s


@pytest.mark.parametrize(
    ("from_deg", "ahead_mps", "right_mps"), [(90.0, 12.0, 0.0), (150.0, 6.0, 10.392)]
)
def test_the_wind_blows_from_where_it_says(
    from_deg: float, ahead_mps: float, right_mps: float
) -> None:
    aircraft = Aircraft(heading_deg=90.0, aloft=(500.0, 60.0))
    before = air_from(aircraft)
    Weather(WeatherConfig(wind=Wind(speed_mps=12.0, from_deg=from_deg)), aircraft)
    aircraft.advance(2)
    ahead, right = air_from(aircraft)
    assert ahead - before[0] == pytest.approx(ahead_mps, abs=0.2)
    assert right - before[1] == pytest.approx(right_mps, abs=0.2)


def air_from(aircraft: Aircraft) -> tuple[float, float]:
    """How fast the air comes, from ahead and from the right (m/s)."""
    return aircraft._fdm["velocities/u-aero-fps"] * 0.3048, aircraft._fdm[
        "velocities/v-aero-fps"
    ] * 0.3048


@pytest.mark.parametrize("from_deg", [60.0, 90.0, 180.0, 270.0])
@pytest.mark.parametrize("model", ["c172p", "737", "f16"])
def test_what_stands_in_the_wind_stands_still(model: str, from_deg: float) -> None:
    """JSBSim's models know no air from the side: without shelter a trainer lies on its back within
    seconds."""
    for speed_mps in (5.0, 15.0):
        aircraft = Aircraft(model, heading_deg=0.0)
        Weather(WeatherConfig(wind=Wind(speed_mps=speed_mps, from_deg=from_deg)), aircraft)
        aircraft.settle()
        aircraft.advance(10 * STEP_HZ)
        truth = aircraft.truth()
        assert abs(truth.roll_rad) < 0.03
        assert abs(truth.pitch_rad) < 0.06
        assert math.hypot(truth.north_mps, truth.east_mps, truth.down_mps) < 0.1


def test_a_headwind_is_felt_on_the_wheels() -> None:
    aircraft = Aircraft(heading_deg=90.0)
    Weather(WeatherConfig(wind=Wind(speed_mps=12.0, from_deg=110.0)), aircraft)
    aircraft.settle()
    # At sea level on a standard day calibrated airspeed is true airspeed.
    assert aircraft.truth().airspeed_mps == pytest.approx(12.0, rel=0.02)


def test_same_seed_same_turbulence_and_no_more() -> None:
    def gusts(seed: int) -> list[float]:
        aircraft = Aircraft(field_elevation_m=300.0, seed=seed)
        aircraft.set_turbulence(4, 10.0)
        aircraft.set_wind(5.0, 0.0)
        readings = []
        for _ in range(50):
            aircraft.advance(20)
            readings.append(aircraft.truth().airspeed_mps)
        return readings

    assert gusts(3) == gusts(3)
    assert gusts(3) != gusts(4)


def test_a_crash_is_an_error_that_says_when() -> None:
    aircraft = Aircraft(field_elevation_m=300.0)
    aircraft.settle()
    while aircraft.truth().altitude_amsl_m < 330.0:
        aircraft.control(
            Controls(elevator=0.3, aileron=-0.5 * aircraft.truth().roll_rad, throttle=1.0)
        )
        aircraft.advance(STEP_HZ // 10)
    aircraft.control(Controls(elevator=-1.0))

    def fall() -> None:
        for _ in range(3000):
            aircraft.advance(STEP_HZ // 50)
            aircraft.truth()

    with pytest.raises(
        SimulationError, match=r"^at \d+\.\d\d s .*(hit the ground|below the ground)"
    ) as failure:
        fall()
    assert "\n" not in str(failure.value)


def test_below_the_ground_is_an_error() -> None:
    aircraft = parked(300.0)
    truth = aircraft.truth()
    with pytest.raises(
        SimulationError,
        match=r"^at 0\.\d\d s the aircraft is below the ground: -12\.0 m above a field",
    ):
        aircraft._check(truth._replace(altitude_amsl_m=288.0))


@pytest.mark.parametrize(("roll_rad", "pitch_rad"), [(math.pi, 0.0), (-0.39, -0.22)])
def test_what_lies_on_its_back_or_its_wing_tip_is_an_error(
    roll_rad: float, pitch_rad: float
) -> None:
    aircraft = parked(300.0)
    truth = aircraft.truth()._replace(roll_rad=roll_rad, pitch_rad=pitch_rad)
    with pytest.raises(
        SimulationError,
        match=r"^at 0\.\d\d s the aircraft hit the ground with more than its wheels: .* bank -?\d+",
    ):
        aircraft._check(truth)
    aircraft._check(truth._replace(altitude_amsl_m=truth.altitude_amsl_m + 2.0))


def test_a_state_that_is_not_finite_is_an_error_that_names_it() -> None:
    aircraft = parked(300.0)
    truth = aircraft.truth()
    with pytest.raises(
        SimulationError, match=r"^at 0\.\d\d s the flight dynamics diverged: down_mps not finite$"
    ):
        aircraft._check(truth._replace(down_mps=math.nan))


def test_an_unknown_aircraft_names_those_that_there_are() -> None:
    with pytest.raises(SimulationError, match="no aircraft 'concorde': there are 737, c172p"):
        Aircraft("concorde")
