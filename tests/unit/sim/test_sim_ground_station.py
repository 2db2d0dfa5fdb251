"""The ground station of a simulated flight: the same weather, its own sensor, its own link."""

from pathlib import Path
from typing import Any

import pytest

from companion.clock import ManualClock
from companion.links.memory import pair
from companion.logs.tlog import TlogReader
from companion.mavlink.codec import Decoder, Encoder, Frame, Message, mavlink
from sim.flight import Flight
from sim.scenario import Scenario


def scenario(**changes: Any) -> Scenario:
    profile = [{"leg": "wait", "duration_s": 4.0}]
    return Scenario.model_validate({"name": "st", "summary": "s", "profile": profile, **changes})


def heard(frames: bytes) -> list[tuple[int, Message]]:
    """System id and message of all frames."""
    decoder = Decoder()
    found: list[Frame] = decoder.feed(frames)
    messages = [(frame.system_id, decoder.decode(frame)) for frame in found]
    return [(system_id, message) for system_id, message in messages if message is not None]


def pressures_hpa(messages: list[tuple[int, Message]], system_id: int) -> list[float]:
    return [
        float(message.press_abs)
        for sender, message in messages
        if sender == system_id and message.get_type() == "SCALED_PRESSURE"
    ]


@pytest.mark.parametrize(
    "weather",
    [
        {"pressure": [{"time_s": 0.0, "sea_level_hpa": 990.0}]},
        {"temperature": [{"time_s": 0.0, "offset_k": 25.0}]},
        {"profile": [{"altitude_amsl_m": 0.0, "offset_k": 10.0}], "relative_humidity": 0.5},
    ],
)
def test_station_and_parked_aircraft_are_in_the_same_air(weather: dict[str, Any]) -> None:
    flight = Flight(scenario(weather=weather, ground_station={}))
    for _ in range(300):
        flight.tick()
    altitude_m = flight.aircraft.position()[2]
    pressure_pa, temperature_k = flight.weather.station_air(flight.time_us * 1e-6, altitude_m)
    assert (pressure_pa, temperature_k) == pytest.approx(flight.aircraft.air(), abs=0.1)


def test_log_has_the_station_and_the_same_vehicle(tmp_path: Path) -> None:
    logs = tmp_path / "with.tlog", tmp_path / "without.tlog"
    for path, station in zip(logs, ({"system_id": 42, "elevation_m": 310.0}, None), strict=True):
        Flight(scenario(ground_station=station), tlog=path).run()
    with_it, without = ([packet.data for packet in TlogReader(path)] for path in logs)
    found = heard(b"".join(with_it))
    assert [frame for frame in with_it if frame[5] != 42] == without
    assert len(pressures_hpa(found, 42)) == 4
    # 310 m less the 301 m of the parked aircraft, and two sensors' biases of 50 Pa
    apart_hpa = pressures_hpa(found, 42)[-1] - pressures_hpa(found, 1)[-1]
    assert apart_hpa == pytest.approx(-1.0, abs=2.0)


@pytest.mark.parametrize("has_link", [True, False])
def test_station_speaks_on_its_own_link_or_the_vehicles(has_link: bool) -> None:
    clock = ManualClock()
    near, vehicle_end = pair(clock)
    station_near, station_end = pair(clock)
    flight = Flight(
        scenario(ground_station={"rate_hz": 2}),
        links=[vehicle_end],
        station_link=station_end if has_link else None,
        clock=clock,
    )
    near.send(Encoder(255, 190).encode(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)))
    received = {"vehicle": b"", "station": b""}
    for _ in range(300):
        flight.tick()
        for name, link in (("vehicle", near), ("station", station_near)):
            while data := link.receive(0.0):
                received[name] += data
    carrier, other = ("station", "vehicle") if has_link else ("vehicle", "station")
    assert len(pressures_hpa(heard(received[carrier]), 9)) == 6
    assert pressures_hpa(heard(received[other]), 9) == []
    for link in (near, vehicle_end, station_near, station_end):
        link.close()
