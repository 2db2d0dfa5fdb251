"""The weather against physics: hydrostatic balance integrated another way, geostrophic balance,
what fronts are.

The oracle of a column is its defining equation, integrated with scipy from the temperature alone.
"""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from companion.config import validate
from companion.errors import ConfigError
from sim.aircraft import Aircraft
from sim.constants import G0_MPS2
from sim.flight import Flight
from sim.scenario import Scenario
from sim.weather import Weather, WeatherConfig
from sim.weather.column import Column, geopotential_m, pressure_altitude_m, standard_k
from sim.weather.fields import (
    FRONTS,
    Diurnal,
    Front,
    Gradient,
    Gust,
    MountainWave,
    WeatherPoint,
    Wind,
)
from sim.weather.metar import parse
from sim.weather.year import PA_PER_M, Hours, Year

GAS_CONSTANT = 287.0521
SEA_LEVEL_PA = 101_325.0


def config(**values: Any) -> WeatherConfig:
    return validate(values, WeatherConfig, "a test")


def place(**values: Any) -> WeatherPoint:
    base = {"time_s": 0.0, "north_m": 0.0, "east_m": 0.0, "altitude_m": 1300.0, "height_m": 1000.0}
    return WeatherPoint(**{**base, "latitude_deg": 47.0, "wind_mps": (0.0, 0.0), **values})


# Columns


@pytest.mark.parametrize("offset_k", [0.0, -20.0, 15.0])
@pytest.mark.parametrize("sea_level_pa", [101_325.0, 98_000.0])
def test_a_column_without_layers_is_jsbsim_s_own(sea_level_pa: float, offset_k: float) -> None:
    column = Column()
    column.solve(offset_k)
    for altitude_m in (0.0, 300.0, 1000.0, 2400.0, 5000.0, 8000.0, 10_900.0, 11_200.0, 12_500.0):
        theirs = Aircraft(field_elevation_m=altitude_m)
        theirs.set_air(sea_level_pa, offset_k)
        theirs.advance(1)
        expected_pa, expected_k = theirs.air()
        ours = Aircraft(field_elevation_m=altitude_m)
        ours.set_column(lambda altitude_m: column.at(altitude_m, sea_level_pa))
        ours.advance(1)
        pressure_pa, temperature_k = ours.air()
        assert pressure_pa == pytest.approx(expected_pa, abs=0.01)
        assert temperature_k == pytest.approx(expected_k, abs=0.001)
        for name in ("P-psf", "T-R", "rho-slugs_ft3"):  # JSBSim flies in it too
            assert ours._fdm[f"atmosphere/{name}"] == pytest.approx(
                theirs._fdm[f"atmosphere/{name}"], rel=1e-6
            )


INVERSION = [(0.0, -8.0), (300.0, -8.0), (600.0, 4.0), (2000.0, 0.0)]


@pytest.mark.parametrize("altitude_m", [150.0, 300.0, 450.0, 601.0, 1500.0, 5000.0])
def test_an_inversion_is_in_hydrostatic_balance(altitude_m: float) -> None:
    column = Column(INVERSION)
    column.solve(3.0)
    heights = [geopotential_m(altitude) for altitude, _ in INVERSION]

    def temperature_k(height_m: float) -> float:
        profile = float(np.interp(height_m, heights, [offset for _, offset in INVERSION]))
        return 288.15 - 0.0065 * height_m + 3.0 + profile

    top = geopotential_m(altitude_m)
    integral, _ = quad(
        lambda h: G0_MPS2 / (GAS_CONSTANT * temperature_k(h)), 0.0, top, points=heights[1:]
    )
    air = column.at(altitude_m, 99_000.0)
    assert air.pressure_pa == pytest.approx(99_000.0 * math.exp(-integral), abs=0.1)
    assert air.temperature_k == pytest.approx(temperature_k(top), abs=1e-6)
    assert air.density_kgpm3 == pytest.approx(
        air.pressure_pa / (GAS_CONSTANT * air.temperature_k), rel=1e-5
    )


def test_an_inversion_misleads_a_barometer() -> None:
    """Cold air below is heavy: 600 m above it the pressure is lower than standard, and a barometer
    reads high."""
    cold = Column([(0.0, -15.0), (300.0, -15.0), (500.0, 0.0)])
    low_pa = Column().at(600.0, SEA_LEVEL_PA).pressure_pa - cold.at(600.0, SEA_LEVEL_PA).pressure_pa
    # Standard integral: 15 K over 300 m, and half of that over 200 m, of 285 K.
    expected_m = 15.0 / 280.0 * 300.0 + 7.5 / 280.0 * 200.0
    assert low_pa / (1.16 * G0_MPS2) == pytest.approx(expected_m, rel=0.1)


def test_moist_air_is_light() -> None:
    dry, moist = Column(), Column((), 1.0)
    for column in (dry, moist):
        column.solve(15.0)
    below, above = dry.at(0.0, SEA_LEVEL_PA), moist.at(0.0, SEA_LEVEL_PA)
    # Saturated air of 30.0 C at 1013.25 hPa: vapour 42.4 hPa (tables), so 1 - 0.378 e / p of the
    # density.
    assert above.density_kgpm3 / below.density_kgpm3 == pytest.approx(
        1.0 - 0.378 * 42.4 / 1013.25, rel=5e-4
    )
    assert above.temperature_k == below.temperature_k == pytest.approx(303.15)
    assert above.pressure_pa == below.pressure_pa
    # A column 1 % lighter over 2000 m: the pressure falls less, by some 170 Pa, which is 17 m.
    assert (
        120.0
        < moist.at(2000.0, SEA_LEVEL_PA).pressure_pa - dry.at(2000.0, SEA_LEVEL_PA).pressure_pa
        < 230.0
    )


def test_a_layered_flight_reads_the_column_where_it_is() -> None:
    """A climb of 5 m/s at 50 Hz: a tenth of a metre of lag would be 1 Pa."""
    weather = {
        "profile": [{"altitude_amsl_m": 0, "offset_k": 5}, {"altitude_amsl_m": 400, "offset_k": -5}]
    }
    legs = [{"leg": "wait", "duration_s": 2}, {"leg": "take_off", "height_m": 150}]
    scenario = validate(
        {"name": "test", "summary": "of a test", "profile": legs, "weather": weather},
        Scenario,
        "a test",
    )
    flight = Flight(scenario)
    flight.run()
    truth = flight.vehicle.state.truth
    assert truth is not None
    assert truth.climb_mps > 2.0
    column = Column([(0.0, 5.0), (400.0, -5.0)])
    expected = column.at(truth.altitude_amsl_m, SEA_LEVEL_PA)
    assert truth.pressure_pa == pytest.approx(expected.pressure_pa, abs=0.05)
    assert truth.temperature_k == pytest.approx(expected.temperature_k, abs=0.01)


# Fronts, gradients, the day


def test_a_cold_front_passes_over_time() -> None:
    front = Front(kind="cold", from_deg=270.0, distance_m=36_000.0, speed_mps=12.0)
    values = {minute: front.at(place(time_s=60.0 * minute)) for minute in range(201)}
    pressure = np.array([change.sea_level_pa for change in values.values()])
    # -2 sech x + 1.5 (1 + tanh x) is least where sinh x = -3/4: 7.7 min before the line comes, at
    # 50 min, and -1 hPa.
    assert int(np.argmin(pressure)) == 42
    assert pressure.min() == pytest.approx(-100.0, abs=0.5)
    assert pressure[-1] == pytest.approx(300.0, abs=5.0)
    offsets = [change.offset_k for change in values.values()]
    assert offsets[0] == pytest.approx(0.0, abs=0.01)
    assert offsets[50] == pytest.approx(-4.0)
    assert offsets[-1] == pytest.approx(-8.0, abs=0.01)
    assert all(after <= before for before, after in pairwise(offsets))


def test_the_page_of_keys_tells_the_usual_fronts() -> None:
    said = " ".join((Front.model_fields["kind"].description or "").split())
    for first, second, name, unit in ((8, 40, "width_m", 1e3), (2, 1, "trough_hpa", 1.0)):
        assert f"{first} or {second} " in said
        assert [front[name] / unit for front in FRONTS.values()] == [first, second]
    assert "step +3 or -3 hPa and -8 or +6 K" in said
    assert [front["pressure_step_hpa"] for front in FRONTS.values()] == [3.0, -3.0]
    assert [front["temperature_step_k"] for front in FRONTS.values()] == [-8.0, 6.0]


def test_a_standing_front_is_met_along_the_track() -> None:
    front = Front(kind="warm", from_deg=90.0, distance_m=30_000.0, speed_mps=0.0, width_m=5_000.0)
    offsets = [
        front.at(place(east_m=east, time_s=1e5)).offset_k for east in (0.0, 30_000.0, 60_000.0)
    ]
    assert offsets == pytest.approx([0.0, 3.0, 6.0], abs=1e-3)
    assert front.at(place(north_m=1e5)).offset_k == pytest.approx(offsets[0], abs=1e-3)


def test_the_wind_shifts_with_the_front() -> None:
    front = Front(
        distance_m=0.0,
        speed_mps=10.0,
        width_m=1000.0,
        wind_behind=Wind(speed_mps=10.0, from_deg=300.0),
    )
    before = Wind(speed_mps=8.0, from_deg=200.0).vector_mps
    late = front.at(place(time_s=10_000.0, wind_mps=before))
    assert (before[0] + late.north_mps, before[1] + late.east_mps) == pytest.approx(
        Wind(speed_mps=10.0, from_deg=300.0).vector_mps
    )
    early = front.at(place(time_s=-10_000.0, wind_mps=before))
    assert (early.north_mps, early.east_mps) == pytest.approx((0.0, 0.0), abs=1e-6)


@pytest.mark.parametrize("latitude_deg", [47.0, -33.0])
def test_the_gradient_s_wind_is_geostrophic(latitude_deg: float) -> None:
    """f k x v = -grad p / rho, component by component, from differences of the pressure."""
    gradient = Gradient(hpa_per_100km=2.0, towards_deg=160.0)
    here = place(latitude_deg=latitude_deg)
    step_m = 1000.0
    slope = [
        (gradient.at(there).sea_level_pa - gradient.at(here).sea_level_pa) / step_m
        for there in (here._replace(north_m=step_m), here._replace(east_m=step_m))
    ]
    assert math.hypot(*slope) == pytest.approx(200.0 / 100_000.0)
    coriolis = 2.0 * 7.292115e-5 * math.sin(math.radians(latitude_deg))
    wind = gradient.at(here)
    assert wind.north_mps == pytest.approx(slope[1] / (1.225 * coriolis))
    assert wind.east_mps == pytest.approx(-slope[0] / (1.225 * coriolis))
    low = gradient.at(
        here._replace(height_m=0.0)
    )  # friction: weaker, and across the isobars towards the low
    assert math.hypot(low.north_mps, low.east_mps) == pytest.approx(
        0.6 * math.hypot(wind.north_mps, wind.east_mps)
    )
    assert low.north_mps * slope[0] + low.east_mps * slope[1] < 0.0
    still = Gradient(hpa_per_100km=2.0, wind=False).at(here)
    assert (still.north_mps, still.east_mps) == (0.0, 0.0)


def test_the_day_is_warmest_in_the_afternoon_and_the_tide_comes_twice() -> None:
    day = Diurnal(start_h=0.0, temperature_k=6.0, pressure_hpa=1.0)
    hours = [day.at(place(time_s=3600.0 * hour)) for hour in range(25)]
    assert max(range(25), key=lambda hour: hours[hour].offset_k) == 15
    assert min(range(25), key=lambda hour: hours[hour].offset_k) == 3
    assert [hour for hour in range(1, 24) if hours[hour].sea_level_pa > 99.0] == [10, 22]
    assert hours[0] == pytest.approx(hours[24])
    assert sum(change.offset_k for change in hours[:24]) == pytest.approx(0.0, abs=1e-9)


def test_a_gust_is_one_minus_cosine() -> None:
    gust = Gust(time_s=100.0, duration_s=10.0, speed_mps=8.0, from_deg=270.0, up_mps=3.0)
    assert gust.at(place(time_s=100.0)) == gust.at(place(time_s=110.5)) == (0.0,) * 6
    peak = gust.at(place(time_s=105.0))
    assert (peak.north_mps, peak.east_mps, peak.down_mps) == pytest.approx(
        (0.0, 8.0, -3.0), abs=1e-9
    )
    assert gust.at(place(time_s=102.5)).east_mps == pytest.approx(4.0)


def test_a_mountain_wave_lifts_and_misleads() -> None:
    wave = MountainWave(up_mps=4.0, wavelength_m=20_000.0, distance_m=5_000.0)
    assert wave.at(place(east_m=4_000.0)) == (0.0,) * 6
    peak = wave.at(place(east_m=10_000.0, altitude_m=3300.0, height_m=30_000.0))
    assert peak.down_mps == pytest.approx(-4.0)
    density = 1.225 * math.exp(-3300.0 / 9500.0)
    assert peak.local_pa == pytest.approx(density * 0.012 * 4.0 * 20_000.0 / math.tau)
    assert (
        10.0 < peak.local_pa / (density * G0_MPS2) < 20.0
    )  # metres: the thing that pilots are warned of
    trough = wave.at(place(east_m=20_000.0, altitude_m=3300.0, height_m=30_000.0))
    assert trough.local_pa == pytest.approx(-peak.local_pa)


def test_the_fields_reach_the_aircraft() -> None:
    aircraft = Aircraft(field_elevation_m=300.0, aloft=(500.0, 50.0))
    weather = Weather(
        config(
            pressure=[{"time_s": 0, "sea_level_hpa": 1020}],
            wind={"speed_mps": 5, "from_deg": 180},
            front={
                "distance_m": 0,
                "speed_mps": 10,
                "width_m": 1000,
                "trough_hpa": 4,
                "pressure_step_hpa": 0,
            },
            gusts=[{"time_s": 10, "duration_s": 2, "speed_mps": 6, "from_deg": 90}],
        ),
        aircraft,
    )
    assert weather.now.sea_level_pa == pytest.approx(102_000.0 - 400.0)
    assert weather.now.offset_k == pytest.approx(-4.0)
    weather.update(11.0)
    aircraft.advance(2)
    assert aircraft._fdm["atmosphere/wind-north-fps"] * 0.3048 == pytest.approx(5.0)
    assert aircraft._fdm["atmosphere/wind-east-fps"] * 0.3048 == pytest.approx(-6.0)
    assert aircraft._fdm["atmosphere/P-sl-psf"] * 47.880259 == pytest.approx(
        weather.now.sea_level_pa
    )
    assert aircraft._fdm["atmosphere/delta-T"] / 1.8 == pytest.approx(weather.now.offset_k)


def test_a_wave_changes_the_static_pressure_by_what_it_says() -> None:
    aircraft = Aircraft(field_elevation_m=300.0)
    still = aircraft.air()[0]
    weather = Weather(
        config(mountain_wave={"distance_m": -5_000, "wavelength_m": 20_000}), aircraft
    )
    aircraft.advance(1)
    before_pa = aircraft.air()[0]
    expected = MountainWave(distance_m=-5_000, wavelength_m=20_000).at(
        place(height_m=aircraft.position()[2] - 300.0, altitude_m=aircraft.position()[2])
    )
    assert before_pa - still == pytest.approx(
        expected.local_pa, abs=0.6
    )  # JSBSim's own day is 1013.2554 hPa
    assert weather.now.sea_level_pa == 101_325.0  # the truth's column is without it


# What the truth says of the air


@pytest.mark.parametrize("altitude_m", [0.0, 1500.0, 8000.0, 10_950.0, 11_050.0, 13_000.0])
def test_pressure_altitude_is_where_the_standard_day_has_that_pressure(altitude_m: float) -> None:
    aircraft = Aircraft(field_elevation_m=altitude_m)
    aircraft.set_air(SEA_LEVEL_PA, 0.0)
    aircraft.advance(1)
    expected_m = geopotential_m(aircraft.position()[2])
    assert pressure_altitude_m(aircraft.air()[0]) == pytest.approx(expected_m, abs=0.1)
    assert aircraft.air()[1] == pytest.approx(standard_k(aircraft.position()[2]), abs=0.001)


@pytest.mark.parametrize(
    "weather",
    [
        {
            "pressure": [{"time_s": 0, "sea_level_hpa": 998}],
            "temperature": [{"time_s": 0, "offset_k": -18}],
        },
        {
            "profile": [
                {"altitude_amsl_m": 0, "offset_k": -15},
                {"altitude_amsl_m": 900, "offset_k": 6},
            ]
        },
        {"relative_humidity": 0.9, "temperature": [{"time_s": 0, "offset_k": 15}]},
        {"front": {"distance_m": 0, "trough_hpa": 4}},
    ],
)
def test_an_altimeter_set_to_the_true_qnh_shows_the_field_s_elevation(
    weather: dict[str, Any],
) -> None:
    aircraft = Aircraft(field_elevation_m=800.0)
    air = Weather(config(**weather), aircraft)
    aircraft.advance(1)
    truth = aircraft.truth()
    told = air.truth(truth)
    shown_m = 288.15 / 0.0065 * (1.0 - (truth.pressure_pa / told.qnh_pa) ** 0.190263)
    assert shown_m == pytest.approx(
        geopotential_m(truth.altitude_amsl_m), abs=0.3
    )  # the wheels are 1.3 m lower
    assert told.offset_k == pytest.approx(
        truth.temperature_k - 288.15 + 0.0065 * truth.altitude_amsl_m, abs=0.01
    )
    assert told.sea_level_pa == air.now.sea_level_pa
    # And of all that a pressure altitude knows nothing: it is that altimeter's at 1013.25 hPa.
    assert pressure_altitude_m(truth.pressure_pa * SEA_LEVEL_PA / told.qnh_pa) == pytest.approx(
        shown_m, abs=0.1
    )


# METARs

DAY = (
    "METAR LSZH 310920Z 24012KT 9999 FEW030 BKN045 09/04 Q1002 NOSIG",
    "LSZH 311020Z 27018G30KT 9999 SHRA BKN030 07/05 Q1003",
    "LSZH 311120Z VRB02KT CAVOK ////// Q1005",
    "LSZH 010020Z 00000KT CAVOK M02/M03 A2992",
)


def test_reports_are_read() -> None:
    reports = parse(DAY)
    assert [report.time_s for report in reports] == [0.0, 3600.0, 7200.0, 54_000.0]
    assert reports[0].qnh_hpa == 1002.0
    assert reports[0].temperature_k == pytest.approx(282.15)
    assert reports[0].dew_point_k == pytest.approx(277.15)
    assert reports[2].dew_point_k is None
    assert reports[1].wind_mps == pytest.approx((0.0, 18.0 * 1852.0 / 3600.0), abs=0.01)
    assert reports[1].gust_mps == pytest.approx(12.0 * 1852.0 / 3600.0, abs=0.01)
    assert reports[0].gust_mps == 0.0
    assert reports[2].temperature_k is None
    assert reports[2].wind_mps == (0.0, 0.0)
    assert reports[3].qnh_hpa == pytest.approx(1013.2, abs=0.1)


@pytest.mark.parametrize("elevation_m", [0.0, 432.0, 1707.0])
def test_the_station_has_the_temperature_and_the_qnh_of_its_report(elevation_m: float) -> None:
    aircraft = Aircraft(field_elevation_m=elevation_m)
    weather = Weather(config(metar={"reports": DAY}), aircraft)
    for time_s, qnh_hpa, celsius in (
        (0.0, 1002.0, 9.0),
        (1800.0, 1002.5, 8.0),
        (3600.0, 1003.0, 7.0),
    ):
        weather.update(time_s)
        aircraft.advance(2)
        altitude_m = aircraft.position()[2]
        pressure_pa, temperature_k = aircraft.air()
        # What an altimeter set to that QNH shows on the field: its elevation, by the standard
        # atmosphere's law.
        height_m = 288.15 / 0.0065 * (1.0 - (pressure_pa / (qnh_hpa * 100.0)) ** 0.190263)
        assert height_m == pytest.approx(geopotential_m(altitude_m), abs=1.0)
        assert temperature_k == pytest.approx(
            celsius + 273.15 - 0.0065 * (altitude_m - elevation_m), abs=0.05
        )


@pytest.mark.parametrize("elevation_m", [0.0, 1707.0])
def test_layers_leave_the_station_what_it_reports(elevation_m: float) -> None:
    aircraft = Aircraft(field_elevation_m=elevation_m)
    layers = [
        {"altitude_amsl_m": elevation_m, "offset_k": -6},
        {"altitude_amsl_m": elevation_m + 400, "offset_k": 3},
    ]
    weather = Weather(config(metar={"reports": DAY}, profile=layers), aircraft)
    aircraft.advance(2)
    told = weather.truth(aircraft.truth())
    assert told.qnh_pa == pytest.approx(100_200.0, abs=1.0)
    assert aircraft.air()[1] == pytest.approx(282.15, abs=0.1)


def test_the_air_is_as_moist_as_the_dew_point_says() -> None:
    aircraft = Aircraft()
    Weather(config(metar={"reports": ["LSZH 121020Z 00000KT CAVOK 30/25 Q1013"]}), aircraft)
    aircraft.advance(2)
    pressure_pa, temperature_k = aircraft.air()
    density = aircraft._fdm["atmosphere/rho-slugs_ft3"] * 515.379
    vapour_pa = 3167.0  # saturated at 25 C, by the steam tables
    dry = pressure_pa / (GAS_CONSTANT * temperature_k)
    assert density / dry == pytest.approx(1.0 - 0.378 * vapour_pa / pressure_pa, rel=2e-4)


def test_a_day_in_a_hurry() -> None:
    aircraft = Aircraft()
    slow = Weather(config(metar={"reports": DAY}), aircraft)
    fast = Weather(config(metar={"reports": DAY, "hurry": 10}), aircraft)
    assert fast.at(180.0) == slow.at(1800.0)


@pytest.mark.parametrize("elevation_m", [300.0, 1707.0])
def test_a_report_without_temperature_keeps_its_qnh(elevation_m: float) -> None:
    """It is reduced with the air that will be flown in, between the reports that tell it."""
    said = {10: "20/18", 11: "/////", 12: "00/M10"}
    reports = [f"LOWW 12{hour}00Z 18005KT CAVOK {air} Q1010" for hour, air in said.items()]
    aircraft = Aircraft(field_elevation_m=elevation_m)
    weather = Weather(config(metar={"reports": reports}), aircraft)
    for time_s in (0.0, 3600.0, 7200.0):
        weather.update(time_s)
        aircraft.advance(2)
        assert weather.truth(aircraft.truth()).qnh_pa == pytest.approx(101_000.0, abs=5.0)


def test_the_strongest_gust_of_ten_minutes_is_the_reported_one() -> None:
    reports = [
        "LSZH 121020Z 24015G25KT CAVOK 15/05 Q1013",
        "LSZH 121120Z 24015G25KT CAVOK 15/05 Q1013",
    ]
    weather = Weather(config(metar={"reports": reports}), Aircraft())
    speeds_mps = []
    for time_s in np.arange(0.0, 3600.0, 0.5):
        weather.update(float(time_s))
        north_mps, east_mps = weather.now.north_mps, weather.now.east_mps
        speeds_mps.append(math.hypot(north_mps, east_mps))
        assert math.degrees(math.atan2(-east_mps, -north_mps)) % 360.0 == pytest.approx(240.0)
    knots = np.array(speeds_mps).reshape(6, -1) * 3600.0 / 1852.0
    assert knots.min() == pytest.approx(15.0)
    assert np.all((knots.max(axis=1) > 24.0) & (knots.max(axis=1) <= 25.0))
    assert np.median(knots) == pytest.approx(15.0)  # lulls are longer than gusts


def test_gusts_come_and_go_with_their_reports() -> None:
    weather = Weather(config(metar={"reports": DAY}), Aircraft())
    gusty = [hour_s for hour_s in (0.0, 3600.0, 7200.0) if any(gusts(weather, hour_s))]
    assert gusty == [3600.0]


def gusts(weather: Weather, start_s: float) -> list[bool]:
    """Whether the wind blows harder than it does on the whole, in the minute around `start_s`."""
    found = []
    for time_s in np.arange(max(0.0, start_s - 30.0), start_s + 30.0):
        weather.update(float(time_s))
        mean_mps = math.hypot(*(ramp(float(time_s)) for ramp in weather._wind_mps))
        found.append(math.hypot(weather.now.north_mps, weather.now.east_mps) > mean_mps + 1.0)
    return found


def test_metars_need_no_clock_of_the_host(monkeypatch: pytest.MonkeyPatch) -> None:
    first = parse(DAY)
    monkeypatch.setenv("TZ", "Asia/Tokyo")
    assert parse(DAY) == first


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"metar": {"reports": ["hello"]}}, "'hello' is no METAR"),
        ({"metar": {"reports": []}}, "metar.reports"),
        (
            {"metar": {"reports": ["LSZH 311020Z 24012KT CAVOK 07/05"]}},
            "no report has a pressure",
        ),
        ({"metar": {"reports": [DAY[1], DAY[0]]}}, "is not later than the report before it"),
        ({"metar": {"reports": [DAY[0]]}, "wind": {"speed_mps": 3}}, "metar replaces"),
        ({"metar": {"reports": [DAY[0]]}, "relative_humidity": 0.5}, "metar replaces"),
        ({"front": {"kind": "hot"}}, "front.kind"),
        ({"front": {"speed": 3}}, "front.speed: unknown key"),
        ({"gusts": [{"speed_mps": 5}]}, "time_s: this key is required"),
        ({"relative_humidity": 80}, "relative_humidity: 80 is out of range"),
        (
            {
                "profile": [
                    {"altitude_amsl_m": 300, "offset_k": 0},
                    {"altitude_amsl_m": 200, "offset_k": 1},
                ]
            },
            "the altitudes of the temperature profile must increase",
        ),
    ],
)
def test_a_mistake_in_the_weather_is_one_line(values: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ConfigError) as failure:
        config(**values)
    assert complaint in str(failure.value)
    assert "\n" not in str(failure.value)


def test_a_years_weather_drifts_as_observations_do() -> None:
    """A year of three airports: sd 4.7 m/h, 99 % within 13.4, at most 31, correlation .65."""
    hours = Hours(Year(), seed=1)
    points = [WeatherPoint(3600.0 * k, 0.0, 0.0, 0.0, 0.0, 45.0, (0.0, 0.0)) for k in range(26_000)]
    pressure_pa = np.array([hours.at(point).sea_level_pa for point in points])
    change_m = np.diff(pressure_pa) / PA_PER_M
    assert np.std(change_m) == pytest.approx(4.7, rel=0.06)
    assert np.percentile(np.abs(change_m), 99) == pytest.approx(13.4, rel=0.1)
    assert 20.0 < np.max(np.abs(change_m)) <= 31.0
    assert np.corrcoef(change_m[:-1], change_m[1:])[0, 1] == pytest.approx(0.65, abs=0.06)
    half = hours.at(WeatherPoint(1800.0, 0.0, 0.0, 0.0, 0.0, 45.0, (0.0, 0.0)))
    assert half.sea_level_pa == pytest.approx(0.5 * (pressure_pa[0] + pressure_pa[1]))
