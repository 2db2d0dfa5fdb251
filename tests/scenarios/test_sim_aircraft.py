"""Every aircraft stands on its wheels, takes off or starts aloft, tracks its profile, lands on the
centre line."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.config import validate
from companion.errors import SimulationError
from sim.aircraft import Aircraft
from sim.aircraft_state import Truth
from sim.airframes import MODELS, without_listeners
from sim.flight import Flight
from sim.pilot.autopilot import Mode
from sim.pilot.gains import GAINS
from sim.pilot.profile import Descend, Hold, Land
from sim.scenario import Scenario

STALL_MPS = {"c172p": 25.0, "737": 62.0, "f16": 65.0, "sgs126": 15.0}
"""with the flaps of the landing"""


def flight(aircraft: str, legs: Sequence[dict[str, Any]], **changes: Any) -> Flight:
    values = {
        "name": "test",
        "summary": "of a test",
        "aircraft": aircraft,
        "profile": legs,
        **changes,
    }
    return Flight(validate(values, Scenario, "a test"))


def flown(flight: Flight) -> list[tuple[Truth, Any, float]]:
    """Truth at 50 Hz with its leg and the time since the leg began, to the end of the profile."""
    rows: list[tuple[Truth, Any, float]] = []
    leg, since_us = flight.profile.leg, 0
    while not flight.profile.done:
        flight.tick()
        if flight.profile.leg is not leg:
            leg, since_us = flight.profile.leg, flight.time_us
        truth = flight.vehicle.state.truth
        if truth is not None and truth.time_us == flight.time_us:
            rows.append((truth, leg, (flight.time_us - since_us) * 1e-6))
    return rows


def assert_lands(flight: Flight, rows: list[tuple[Truth, Any, float]]) -> None:
    """Softly, beyond the threshold, on the centre line of a runway that leads east; and never
    stalls before."""
    truths = [truth for truth, leg, _ in rows if isinstance(leg, Land)]
    down = next(i for i, truth in enumerate(truths) if truth.on_ground)
    assert 0.0 < truths[down - 1].down_mps < 2.0
    roll = truths[down:]
    across_m = np.array([(truth.latitude_deg - 47.0) * 111_195.0 for truth in roll])
    assert np.abs(across_m).max() < 12.0
    along_m = (roll[0].longitude_deg - 8.0) * 111_195.0 * math.cos(math.radians(47.0))
    assert 100.0 < along_m < 900.0
    speed_mps = [truth.airspeed_mps for truth in truths[:down] if truth.altitude_amsl_m > 310.0]
    assert min(speed_mps) > STALL_MPS[flight.scenario.aircraft]


def test_every_aircraft_has_gains() -> None:
    assert MODELS.keys() == GAINS.keys() == STALL_MPS.keys()


@pytest.mark.parametrize("name", MODELS)
def test_it_rests_at_its_height(name: str) -> None:
    aircraft = Aircraft(name, field_elevation_m=300.0)
    aircraft.settle()
    assert aircraft.truth().altitude_amsl_m - 300.0 == pytest.approx(
        aircraft.rest_height_m, abs=0.01
    )
    assert aircraft.truth().on_ground


def test_a_model_that_listens_on_tcp_ports_iswithout_listeners(tmp_path: Path) -> None:
    deaf, listening = tmp_path / "deaf", tmp_path / "listening.xml"
    listening.write_text(
        '<fdm_config><input port="5137"/><channel><input>x</input></channel></fdm_config>'
    )
    assert without_listeners(listening, deaf)
    assert "5137" not in (deaf / "listening.xml").read_text()
    assert "<input>x</input>" in (deaf / "listening.xml").read_text()
    assert not without_listeners(deaf / "listening.xml", tmp_path / "again")


@pytest.mark.parametrize("name", ["737", "f16"])
def test_a_jet_takes_off_from_its_runway(name: str) -> None:
    rows = flown(
        flight(name, [{"leg": "wait", "duration_s": 1}, {"leg": "take_off", "height_m": 300}])
    )
    truths = [truth for truth, _, _ in rows]
    lift_off = max(i for i, truth in enumerate(truths) if truth.on_ground)
    rotation = next(
        i for i, truth in enumerate(truths) if truth.airspeed_mps >= GAINS[name].rotate_mps
    )
    assert 0.5 < (lift_off - rotation) * 0.02 < 5.0  # the nose comes up at 4 degrees a second
    assert max(abs(truth.latitude_deg - 47.0) for truth in truths[:lift_off]) * 111_195.0 < 3.0
    assert min(truth.climb_mps for truth in truths[lift_off + 50 :]) > 0.0


def test_an_emergency_descent_keeps_its_rate() -> None:
    legs = [
        {"leg": "hold", "duration_s": 120},
        {"leg": "descend", "altitude_amsl_m": 6000, "rate_mps": 35, "airspeed_mps": 175},
        {"leg": "hold", "duration_s": 60},
    ]
    rows = flown(flight("737", legs, aloft={"altitude_amsl_m": 10_600}))
    held = [
        truth.altitude_amsl_m
        for truth, leg, since_s in rows
        if leg is rows[0][1] and since_s > 80.0
    ]
    assert np.abs(np.array(held) - 10_600.0).max() < 5.0
    steady = [
        t.climb_mps
        for t, leg, s in rows
        if isinstance(leg, Descend) and s > 60.0 and t.altitude_amsl_m > 6800.0
    ]
    assert len(steady) > 1000
    assert np.abs(np.array(steady) + 35.0).max() < 2.5
    final = [
        truth.altitude_amsl_m
        for truth, leg, since_s in rows
        if isinstance(leg, Hold) and since_s > 45.0
    ]
    assert abs(final[-1] - 6000.0) < 5.0


def test_a_continuous_descent_keeps_its_rate_for_minutes() -> None:
    legs = [
        {"leg": "hold", "duration_s": 60},
        {"leg": "descend", "altitude_amsl_m": 2500, "rate_mps": 10, "airspeed_mps": 120},
        {"leg": "hold", "duration_s": 40},
    ]
    rows = flown(flight("737", legs, aloft={"altitude_amsl_m": 5000}))
    steady = [
        t.climb_mps
        for t, leg, s in rows
        if isinstance(leg, Descend) and s > 40.0 and t.altitude_amsl_m > 2800.0
    ]
    assert len(steady) > 120 * 50
    errors_mps = np.abs(np.array(steady) + 10.0)
    assert errors_mps.max() < 2.5  # when 120 m/s are reached the speed brakes go in
    assert np.percentile(errors_mps, 90) < 0.6
    assert max(abs(t.altitude_amsl_m - 2500.0) for t, leg, _ in rows if leg is rows[-1][1]) < 10.0


def test_low_level_ups_and_downs_overshoot_by_metres() -> None:
    rate = {"rate_mps": 25, "airspeed_mps": 200}
    legs: list[dict[str, Any]] = [
        {"leg": "descend", "altitude_amsl_m": 450, **rate},
        {"leg": "climb", "altitude_amsl_m": 1000, **rate},
        {"leg": "descend", "altitude_amsl_m": 450, **rate},
        {"leg": "hold", "duration_s": 15, "airspeed_mps": 200},
    ]
    rows = flown(flight("f16", legs, aloft={"altitude_amsl_m": 1000, "airspeed_mps": 200}))
    climbs_mps = [truth.climb_mps for truth, *_ in rows]
    assert 24.0 < max(climbs_mps) < 26.5
    assert -26.5 < min(climbs_mps) < -24.0
    heights_m = [truth.altitude_amsl_m for truth, *_ in rows]
    assert 435.0 < min(heights_m) < 455.0  # a level-off from 25 m/s
    assert 995.0 < max(heights_m) < 1015.0


def test_a_touch_and_go_touches_on_the_runway_and_goes() -> None:
    legs: list[dict[str, Any]] = [
        {"leg": "land", "touch_and_go": True},
        {"leg": "take_off"},
        {"leg": "climb", "altitude_amsl_m": 450},
    ]
    going = flight("c172p", legs, aloft={"altitude_amsl_m": 450})
    rows = flown(going)
    assert_lands(going, rows)
    wheels = [truth for truth, *_ in rows if truth.on_ground]
    assert 4.0 <= len(wheels) * 0.02 < 15.0
    assert min(truth.airspeed_mps for truth in wheels) > 20.0  # it never stops
    assert max(abs(truth.latitude_deg - 47.0) for truth in wheels) * 111_195.0 < 12.0
    assert rows[-1][0].altitude_amsl_m > 440.0


def test_a_spiral_holds_its_bank_and_a_glide_its_airspeed() -> None:
    legs = [
        {"leg": "glide", "altitude_amsl_m": 940, "airspeed_mps": 22},
        {"leg": "glide", "altitude_amsl_m": 800, "airspeed_mps": 23, "bank_deg": -35},
    ]
    rows = flown(flight("sgs126", legs, aloft={"altitude_amsl_m": 1000}))
    first = rows[0][1]
    glide = [truth for truth, leg, since_s in rows if leg is first and since_s > 25.0]
    spiral = [truth for truth, leg, since_s in rows if leg is not first and since_s > 30.0]
    assert max(abs(truth.airspeed_mps - 22.0) for truth in glide) < 1.0
    assert 0.7 < -np.mean([truth.climb_mps for truth in glide]) < 1.1  # 22 : 1
    assert max(abs(truth.airspeed_mps - 23.0) for truth in spiral) < 1.0
    assert max(abs(math.degrees(truth.roll_rad) + 35.0) for truth in spiral) < 2.0


@pytest.mark.parametrize(
    ("name", "altitude_m", "legs"),
    [("c172p", 450.0, [{"leg": "hold", "duration_s": 20}]), ("sgs126", 800.0, [])],
)
def test_it_lands(name: str, altitude_m: float, legs: list[dict[str, Any]]) -> None:
    landing = flight(
        name, [*legs, {"leg": "land", "glide_deg": 3.5}], aloft={"altitude_amsl_m": altitude_m}
    )
    rows = flown(landing)
    assert_lands(landing, rows)
    end = rows[-1][0]
    assert end.on_ground
    assert math.hypot(end.north_mps, end.east_mps) < 0.6
    assert not landing.vehicle.state.armed


def test_a_glider_that_cannot_reach_the_runway_says_so() -> None:
    legs: list[dict[str, Any]] = [
        {"leg": "glide", "altitude_amsl_m": 380, "heading_deg": 270},
        {"leg": "land"},
    ]
    with pytest.raises(
        SimulationError, match=r"the glider is too low for the runway: \d+ m above it"
    ):
        flown(flight("sgs126", legs, aloft={"altitude_amsl_m": 500}))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["737", "f16"])
def test_a_jet_lands(name: str) -> None:
    landing = flight(
        name, [{"leg": "hold", "duration_s": 30}, {"leg": "land"}], aloft={"altitude_amsl_m": 900}
    )
    assert_lands(landing, flown(landing))


@pytest.mark.slow
@pytest.mark.parametrize("from_deg", [0, 60, 180, 300])
def test_the_trainer_lands_in_wind(from_deg: float) -> None:
    weather = {
        "wind": {"speed_mps": 5, "from_deg": from_deg},
        "turbulence": {"severity": 3, "wind_at_6m_mps": 3},
    }
    legs: list[dict[str, Any]] = [{"leg": "hold", "duration_s": 20}, {"leg": "land"}]
    landing = flight("c172p", legs, aloft={"altitude_amsl_m": 500}, weather=weather)
    assert_lands(landing, flown(landing))


@pytest.mark.slow
@pytest.mark.parametrize("from_deg", [0, 180])
def test_the_trainer_lands_in_the_side_wind_it_may_land_in(from_deg: float) -> None:
    """Its handbook says 15 kt; here with both wing tips off the ground to the end."""
    legs: list[dict[str, Any]] = [{"leg": "land"}, {"leg": "wait", "duration_s": 10}]
    weather = {"wind": {"speed_mps": 8, "from_deg": from_deg}}
    landing = flight("c172p", legs, aloft={"altitude_amsl_m": 450}, weather=weather)
    rows = flown(landing)
    assert_lands(landing, rows)
    assert max(abs(truth.roll_rad) for truth, *_ in rows if truth.on_ground) < math.radians(8.0)


def test_a_storm_that_lifts_what_stands_ends_the_flight() -> None:
    storm = flight(
        "c172p",
        [{"leg": "wait", "duration_s": 5}],
        weather={"wind": {"speed_mps": 40, "from_deg": 90}},
    )
    with pytest.raises(
        SimulationError, match=r"^at \d\.\d\d s the wind lifted the aircraft .* during 'Standing'"
    ):
        flown(storm)


@pytest.mark.parametrize("name", ["737", "f16", "sgs126"])
def test_flying_into_the_ground_ends_the_flight(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    sinking = flight(
        name, [{"leg": "glide", "altitude_amsl_m": 360}], aloft={"altitude_amsl_m": 600}
    )
    fly = sinking.autopilot.update
    monkeypatch.setattr(
        sinking.autopilot,
        "update",
        lambda truth, target: fly(truth, target)._replace(elevator=-0.4),
    )
    sinking.profile._over = lambda truth: False  # type: ignore[method-assign]
    with pytest.raises(
        SimulationError, match=r"^at \d+\.\d\d s the aircraft (hit|is below) the ground"
    ):
        sinking.run()
    assert Mode.PARKED is not sinking.autopilot._mode
