"""A stall ends the flight, by JSBSim's own wing: where it is, how it is told, and what is none."""

import math
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import jsbsim
import pytest

from companion.config import validate
from companion.errors import SimulationError
from sim.aircraft import Aircraft
from sim.airframes import MODELS
from sim.flight import Flight
from sim.pilot.profile import Glide, Land
from sim.pilot.stall import StallWatch
from sim.scenario import Scenario

BASE = {"name": "test", "summary": "of a test"}


def flight(aircraft: str, aloft_m: float, *legs: dict[str, Any], **changes: Any) -> Flight:
    aloft = {"altitude_amsl_m": aloft_m, **changes.pop("aloft", {})}
    values = {**BASE, "aircraft": aircraft, "aloft": aloft, "profile": list(legs), **changes}
    return Flight(validate(values, Scenario, "a test"))


def lift_curve(jsbsim_name: str) -> list[tuple[float, float]]:
    """(angle of attack, lift coefficient) of the model's file; the middle column where there are
    several."""
    source = (
        Path(jsbsim.FGFDMExec(None).get_root_dir())
        / "aircraft"
        / jsbsim_name
        / f"{jsbsim_name}.xml"
    )
    (lift,) = (
        axis
        for axis in ElementTree.parse(source).getroot().iter("axis")
        if axis.get("name") == "LIFT"
    )
    table = next(
        table
        for table in lift.iter("table")
        if (table.findtext("independentVar") or "").strip() == ALPHA
    )
    data = table.find("tableData")
    assert data is not None
    rows = [
        [float(cell) for cell in line.split()] for line in (data.text or "").strip().splitlines()
    ]
    columns = len(rows[-1]) - 1
    heads = rows[0] if len(rows[0]) == columns > 1 else [0.0]
    column = 1 + min(
        range(columns), key=lambda index: abs(heads[index])
    )  # not stalled before, elevator neutral
    return [(row[0], row[column]) for row in rows if len(row) == columns + 1]


ALPHA = "aero/alpha-rad"


@pytest.mark.parametrize("name", MODELS)
def test_the_stall_is_where_the_model_s_lift_is_greatest(name: str) -> None:
    curve = lift_curve(MODELS[name].jsbsim_name)
    assert len(curve) >= 4
    assert max(curve, key=lambda point: point[1])[0] == MODELS[name].stall_rad


TOO_SLOW: dict[str, tuple[str, float, dict[str, Any], dict[str, Any], str]] = {
    "bank": ("c172p", 1500, {"leg": "hold", "duration_s": 60, "bank_deg": 60, "airspeed_mps": 30},
             {}, "less bank_deg"),
    "climb": ("c172p", 3500, {"leg": "climb", "altitude_amsl_m": 6000, "rate_mps": 10}, {},
              "a lower rate_mps"),
    "height": (
        "737", 11500, {"leg": "hold", "duration_s": 60, "airspeed_mps": 83},
        {"aloft": {"airspeed_mps": 83}}, "a higher airspeed_mps",
    ),
    "gust": (
        "sgs126", 1500,
        {"leg": "glide", "altitude_amsl_m": 600, "airspeed_mps": 16, "heading_deg": 90},
        {"weather": {
            "gusts": [{"time_s": 30, "duration_s": 10, "speed_mps": 10, "from_deg": 270}],
        }},
        "the weather less wind",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", TOO_SLOW)
def test_a_stall_ends_the_flight_and_says_what_to_change(case: str) -> None:
    aircraft, aloft_m, leg, changes, remedy = TOO_SLOW[case]
    slow = flight(aircraft, aloft_m, leg, **changes)
    said = (
        r"^at (\d+\.\d\d) s the aircraft stalled during '.+': \d+ m AMSL, [\d.]+ m/s calibrated, "
        r"bank \d+ degrees, "
        r"angle of attack [\d.]+ degrees with the greatest lift at [\d.]+; it needs about \d+ m/s "
        r"there: give the leg "
    )
    with pytest.raises(SimulationError, match=f"{said}.*{remedy}"):
        slow.run()
    assert slow.time_us < 60e6
    truth = slow.vehicle.state.truth
    assert truth is not None
    assert truth.altitude_amsl_m > 0.9 * aloft_m  # long before the ground


def test_the_airspeed_it_is_told_to_need_is_that_of_its_lift() -> None:
    """The trainer's 26.5 m/s at one g (lift 1.47, 16.2 m2, 10.2 kN), times sqrt(2), less what the
    engine carries."""
    slow = flight(
        "c172p", 1500, {"leg": "hold", "duration_s": 60, "bank_deg": 60, "airspeed_mps": 30}
    )
    with pytest.raises(SimulationError, match=r"needs about 3[3-8] m/s"):
        slow.run()
    flight(
        "c172p", 1500, {"leg": "hold", "duration_s": 40, "bank_deg": 45, "airspeed_mps": 45}
    ).run()


def test_a_moment_and_the_ground_are_no_stall() -> None:
    aircraft = Aircraft("c172p", aloft=(1000.0, 40.0))
    aircraft.advance(1)
    truth, leg = aircraft.truth(), Glide(leg="glide", altitude_amsl_m=500.0)
    angles = {"now": 0.3}
    aircraft.angle_of_attack_rad = lambda: angles["now"]
    watch = StallWatch(aircraft)
    for time_us in range(0, 480_001, 20_000):
        watch.check(truth._replace(time_us=time_us), leg, lambda: "Glide")
    angles["now"] = 0.2
    watch.check(truth._replace(time_us=500_000), leg, lambda: "Glide")
    angles["now"] = 0.3
    for time_us in range(520_000, 1_000_001, 20_000):
        watch.check(truth._replace(time_us=time_us), leg, lambda: "Glide")
    watch.check(truth._replace(time_us=1_020_000, on_ground=True), leg, lambda: "Glide")
    watch.check(truth._replace(time_us=1_040_000), leg, lambda: "Glide")
    with pytest.raises(
        SimulationError, match=r"angle of attack 17\.2 degrees .* give the leg calmer weather"
    ):
        watch.check(truth._replace(time_us=1_540_000), Land(leg="land"), lambda: "Landing")


def test_a_landing_may_end_beyond_it() -> None:
    """In the flare the lift may go: that is how an aircraft lands."""
    landing = flight("c172p", 500, {"leg": "land"})
    landing._stall._aircraft.angle_of_attack_rad = lambda: (
        math.inf if landing.aircraft.flow().height_m < 2.0 else 0.0
    )
    landing.run()
    assert landing.profile.done


def test_a_hold_that_cannot_be_held_is_the_end() -> None:
    """Its wires keep the F-16 from stalling, and so it sinks instead."""
    with pytest.raises(
        SimulationError, match=r"cannot hold its altitude; give the leg less bank_deg"
    ):
        flight(
            "f16", 3000, {"leg": "hold", "duration_s": 240, "bank_deg": 60, "airspeed_mps": 85}
        ).run()
