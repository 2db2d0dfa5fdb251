"""ArduPilot SITL sends one height for sea level and ellipsoid: a ground station beside the live
companion gets a narrow protection level from a vehicle that is simulated, and none from one that
may send the wrong height."""

from dataclasses import replace

import pytest

from companion.clock import ManualClock
from companion.links.memory import pair
from companion.mavlink.codec import Decoder, Encoder, Message, mavlink
from companion.service import Service
from companion.settings import CompanionSettings
from sim.flight import Flight
from sim.scenario import Scenario
from sim.vehicle import flavours
from sim.vehicle.flavours import COPTER

FLIGHT = Scenario.model_validate(
    {
        "name": "sitl",
        "summary": "As ArduCopter in SITL: no geoid, and no stream that was not requested.",
        "flavour": "copter",
        "sensors": {
            "gnss": {"undulation_m": 0, "height_white_sd_m": 0.1, "height_wander_sd_m": 0.3}
        },
        "profile": [{"leg": "wait", "duration_s": 32}],
    }
)
TRUTHS = {mavlink.MAVLINK_MSG_ID_SIMSTATE, mavlink.MAVLINK_MSG_ID_SIM_STATE}


def fly() -> tuple[list[Message], Service]:
    """What a ground station on another link of the vehicle heard, and the companion."""
    clock = ManualClock()
    near, far = pair(clock)
    ground, port = pair(clock)
    flight = Flight(FLIGHT, links=[far, port], clock=clock)
    service = Service(near, CompanionSettings(), clock)
    ground.send(Encoder(255, 190).encode(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)))
    heard, decoder = b"", Decoder()
    while not flight.profile.done:
        flight.tick()
        clock.advance_s(0.01)
        for _ in range(2):  # a memory link hands over one message a turn
            service.turn(0.0)
        heard += ground.receive(0.0)
    for link in (near, far, ground, port):
        link.close()
    found = (decoder.decode(frame) for frame in decoder.feed(heard))
    return [message for message in found if message is not None], service


def levels_m(heard: list[Message]) -> list[float]:
    return [
        float(message.value)
        for message in heard
        if message.get_type() == "NAMED_VALUE_FLOAT" and message.name == "klVpl"
    ]


def test_a_ground_station_sees_a_narrow_level_in_a_simulation() -> None:
    heard, service = fly()
    assert service.pipeline.intake.simulation.is_flat
    assert levels_m(heard)[-1] < 15.0
    truth_m = FLIGHT.runway.elevation_m
    heights_m = [m.altitude_amsl for m in heard if m.get_type() == "ALTITUDE"]
    assert len(heights_m) > 100
    assert abs(heights_m[-1] - truth_m) < 10.0
    assert service.pipeline.intake.notes == []


@pytest.mark.slow
def test_a_real_vehicle_is_asked_in_vain_without_a_word(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has no SIMSTATE: the command fails, ArduPilot says nothing, and so do we."""
    messages = {key: row for key, row in COPTER.messages.items() if key not in TRUTHS}
    real = {**flavours.FLAVOURS, "copter": replace(COPTER, messages=messages)}
    monkeypatch.setattr("sim.flight.FLAVOURS", real)
    heard, service = fly()
    assert not service.pipeline.intake.simulation.is_flat
    assert "ellipsoid" in service.pipeline.health.reason
    texts = [message.text for message in heard if message.get_type() == "STATUSTEXT"]
    assert not [text for text in texts if "SIMSTATE" in text or "(164)" in text]
    assert service.problems == []
    assert "ellipsoid" in service.pipeline.intake.notes[0]
