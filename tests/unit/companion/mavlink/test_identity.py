"""Whom we listen to: one vehicle for life, nobody who only says to be one, nothing unsigned in a
signed stream."""

from typing import Any

import pytest

from companion.mavlink.codec import Decoder, Frame, Message, mavlink
from companion.mavlink.identity import (
    SIGNING_TIMEOUT_US,
    Identity,
    Origin,
    autopilot_name,
    is_autopilot,
)
from companion.samples import Kind
from tests import vehicle
from tests.vehicle import Vehicle

KEY = bytes(range(32))
ARDUPILOT, PX4, INVALID, GENERIC = 3, 12, 8, 0
QUAD, GCS, ONBOARD, GIMBAL, TRACKER, CAMERA, ADSB = 2, 6, 18, 26, 5, 30, 27
NOW_US = 1_700_000_000_000_000


def frame(sender: Vehicle, message: Message) -> Frame:
    (found,) = Decoder(datagrams=True).feed(sender.pack(message))
    return found


def heard(
    identity: Identity,
    sender: Vehicle,
    message: Message,
    arrival_us: int = NOW_US,
    source: object = None,
) -> Origin:
    """As the pipeline does: take heartbeats of all but the vehicle, then ask whose frame it is."""
    found = frame(sender, message)
    speaker = (found.system_id, found.component_id)
    if message.get_type() == "HEARTBEAT" and speaker not in (identity.vehicle, identity.own):
        identity.heartbeat(found, message, arrival_us, source)
    return identity.origin(found, arrival_us, source)


def beats(
    identity: Identity, duration_s: float, *senders: tuple[Vehicle, Message], start_s: float = 0.0
) -> None:
    """Heartbeats of several senders at 1 Hz."""
    for second in range(round(duration_s)):
        for number, (sender, message) in enumerate(senders):
            at_us = NOW_US + round((start_s + second + 0.1 * number) * 1e6)
            heard(identity, sender, message, at_us)


def latched(**options: Any) -> Identity:
    identity = Identity(**options)
    heard(identity, Vehicle(1, 1), vehicle.heartbeat())
    assert identity.vehicle == (1, 1)
    return identity


@pytest.mark.parametrize(
    ("autopilot", "kind", "is_one"),
    [
        (ARDUPILOT, QUAD, True),
        (PX4, 1, True),
        (GENERIC, 1, True),
        (INVALID, QUAD, False),  # a companion that says it is a quadrotor
        (INVALID, GIMBAL, False),
        (INVALID, ONBOARD, False),
        (INVALID, GCS, False),
        (ARDUPILOT, GCS, False),  # DroneKit
        (ARDUPILOT, TRACKER, False),
        (GENERIC, CAMERA, False),
        (GENERIC, GIMBAL, False),
        (GENERIC, ONBOARD, False),
        (GENERIC, ADSB, False),
    ],
)
def test_what_is_an_autopilot(autopilot: int, kind: int, is_one: bool) -> None:
    heartbeat = vehicle.heartbeat(autopilot=autopilot, type=kind)
    assert is_autopilot(heartbeat) is is_one
    identity = Identity()
    assert heard(identity, Vehicle(9, 1), heartbeat) is (Origin.VEHICLE if is_one else Origin.EARLY)
    assert identity.vehicle == ((9, 1) if is_one else None)


def test_what_comes_before_the_first_heartbeat_is_not_measured() -> None:
    identity = Identity()
    assert heard(identity, Vehicle(), vehicle.pressure(1)) is Origin.EARLY
    assert heard(identity, Vehicle(), vehicle.heartbeat()) is Origin.VEHICLE
    assert heard(identity, Vehicle(), vehicle.pressure(2)) is Origin.VEHICLE
    assert identity.counters == {Origin.EARLY: 1, Origin.VEHICLE: 2}


def test_the_first_vehicle_stays() -> None:
    identity = latched()
    second = Vehicle(2, 1)
    assert heard(identity, second, vehicle.heartbeat()) is Origin.STRANGER
    assert heard(identity, second, vehicle.pressure(1)) is Origin.STRANGER
    assert heard(identity, Vehicle(1, 154), vehicle.pressure(1, press_abs=0.0)) is Origin.STRANGER
    assert identity.vehicle == (1, 1)
    assert identity.strangers == {(2, 1): 2, (1, 154): 1}


def test_our_own_ids_are_those_configured() -> None:
    identity = latched(own_system_id=200)
    assert identity.own == (200, 191)
    assert heard(identity, Vehicle(200, 191), vehicle.heartbeat(type=ONBOARD)) is Origin.OURSELVES
    assert heard(identity, Vehicle(1, 191), vehicle.heartbeat(type=ONBOARD)) is Origin.STRANGER


def test_a_wanted_vehicle_is_waited_for() -> None:
    identity = Identity(system_id=2)
    assert heard(identity, Vehicle(1, 1), vehicle.heartbeat()) is Origin.EARLY
    assert heard(identity, Vehicle(2, 1), vehicle.heartbeat()) is Origin.VEHICLE
    assert identity.vehicle == (2, 1)


@pytest.mark.parametrize("ids", [(0, 1), (0, 200), (1, 200), (1, 0)])
def test_an_autopilot_with_other_ids_is_told_and_followed_when_configured(
    ids: tuple[int, int],
) -> None:
    """Betaflight and LibrePilot send 0/200."""
    identity = Identity()
    beats(identity, 4, (Vehicle(*ids), vehicle.heartbeat()))
    assert identity.vehicle is None
    (line,) = identity.notes
    assert f"{ids[0]}/{ids[1]}" in line
    assert f"vehicle.component_id: {ids[1]}" in line
    configured = Identity(ids[0], vehicle_component_id=ids[1])
    beats(configured, 1, (Vehicle(*ids), vehicle.heartbeat()))
    assert configured.vehicle == ids
    assert configured.own == (ids[0] or 1, 191)


def test_two_autopilots_in_the_first_seconds_are_refused_with_one_line() -> None:
    identity = Identity()
    both = ((Vehicle(1, 1), vehicle.heartbeat()), (Vehicle(2, 1), vehicle.heartbeat(type=1)))
    beats(identity, 8, *both)
    assert identity.vehicle is None
    (line,) = identity.notes
    assert "1/1" in line
    assert "2/1" in line
    assert "vehicle.system_id" in line
    assert identity.refusal == line
    beats(identity, 14, both[1], start_s=8)  # one has gone: the other is followed
    assert identity.vehicle == (2, 1)
    assert identity.refusal == ""


def test_one_of_two_autopilots_can_be_chosen() -> None:
    identity = Identity(2)
    beats(identity, 5, (Vehicle(1, 1), vehicle.heartbeat()), (Vehicle(2, 1), vehicle.heartbeat()))
    assert identity.vehicle == (2, 1)


@pytest.mark.parametrize("ids", [(77, 1), (1, 154), (1, 156), (1, 191)])
def test_a_stray_heartbeat_before_the_vehicle_does_not_count(ids: tuple[int, int]) -> None:
    identity = Identity()
    heard(identity, Vehicle(*ids), vehicle.heartbeat(autopilot=GENERIC))
    beats(identity, 6, (Vehicle(1, 1), vehicle.heartbeat()), start_s=0.5)
    assert identity.vehicle == (1, 1)


def test_heartbeats_without_sensors_give_way_to_a_vehicle_once_they_cease() -> None:
    identity = Identity()
    beats(identity, 20, (Vehicle(77, 1), vehicle.heartbeat()))
    assert identity.vehicle == (77, 1)
    beats(identity, 15, (Vehicle(1, 1), vehicle.heartbeat()), start_s=20)
    assert identity.vehicle == (1, 1)


def test_another_autopilot_in_flight_is_told_and_not_followed() -> None:
    identity = latched()
    identity.measured(Kind.PRESSURE)
    beats(identity, 30, (Vehicle(9, 1), vehicle.heartbeat()), start_s=60)
    assert identity.vehicle == (1, 1)
    (line,) = identity.notes
    assert "9/1" in line
    assert identity.others(NOW_US + 80_000_000) == ["autopilot 9/1"]


def test_every_sender_beside_a_silent_vehicle_is_named() -> None:
    """A radio that goes on without the vehicle is heard, and so is a camera."""
    identity = latched()
    heard(identity, Vehicle(51, 68), mavlink.MAVLink_radio_status_message(60, 0, 50, 40, 0, 0, 0))
    heard(identity, Vehicle(1, 100), vehicle.heartbeat(autopilot=GENERIC, type=CAMERA))
    heard(identity, Vehicle(255, 190), vehicle.heartbeat(autopilot=INVALID, type=GCS))
    assert identity.others(NOW_US - 1) == ["radio 51/68", "1/100", "255/190"]
    for system_id in (201, 202, 203):
        heard(identity, Vehicle(system_id, 190), vehicle.heartbeat(autopilot=INVALID, type=GCS))
    assert identity.others(NOW_US - 1) == ["radio 51/68", "1/100", "255/190", "201/190", "2 more"]
    assert identity.others(NOW_US) == []


def test_the_vehicle_is_heard_from_where_it_speaks() -> None:
    """A forger elsewhere is refused; a vehicle that moved is accepted after three seconds."""
    identity, sender = Identity(), Vehicle()
    heard(identity, sender, vehicle.heartbeat(), NOW_US, "here")
    late_us = NOW_US + 2_900_000
    assert heard(identity, sender, vehicle.pressure(1), NOW_US, "there") is Origin.ELSEWHERE
    assert heard(identity, sender, vehicle.pressure(1), late_us, "there") is Origin.ELSEWHERE
    assert heard(identity, sender, vehicle.pressure(2), late_us, "here") is Origin.VEHICLE
    moved_us = late_us + 3_000_000
    assert heard(identity, sender, vehicle.pressure(3), moved_us, "there") is Origin.VEHICLE
    assert heard(identity, sender, vehicle.pressure(4), moved_us, "here") is Origin.ELSEWHERE


def test_a_second_program_with_our_ids_makes_us_move() -> None:
    identity = latched()
    heard(identity, Vehicle(1, 192), vehicle.heartbeat(autopilot=INVALID, type=ONBOARD))
    assert "1/193" in identity.yield_ids(may_move=True)
    assert identity.own == (1, 193)
    assert "1/193" in identity.yield_ids(may_move=False)
    assert identity.own == (1, 193)


def test_what_is_remembered_of_strangers_is_bounded() -> None:
    identity = latched()
    for system_id in range(2, 200):
        for kind in (QUAD, GCS):
            heard(identity, Vehicle(system_id, 1), vehicle.heartbeat(type=kind))
    assert len(identity.strangers) <= 64
    assert len(identity.stations) <= 64
    assert len(identity.notes) <= 20


def test_our_own_ids_are_recognised() -> None:
    identity = latched(component_id=77)
    assert (
        heard(identity, Vehicle(1, 77), vehicle.heartbeat(autopilot=INVALID, type=ONBOARD))
        is Origin.OURSELVES
    )
    assert (
        heard(identity, Vehicle(2, 77), vehicle.heartbeat(autopilot=INVALID, type=ONBOARD))
        is Origin.STRANGER
    )
    assert (
        heard(identity, Vehicle(1, 191), vehicle.heartbeat(autopilot=INVALID, type=ONBOARD))
        is Origin.STRANGER
    )


def test_unsigned_frames_in_a_signed_stream_are_forged() -> None:
    identity, signer, forger = Identity(), Vehicle(key=KEY), Vehicle()
    assert heard(identity, signer, vehicle.heartbeat()) is Origin.VEHICLE
    assert heard(identity, forger, vehicle.pressure(1)) is Origin.FORGED
    assert heard(identity, signer, vehicle.pressure(1)) is Origin.VEHICLE
    assert (
        heard(identity, forger, vehicle.pressure(2), NOW_US + SIGNING_TIMEOUT_US - 1)
        is Origin.FORGED
    )
    assert heard(identity, Vehicle(version=1), vehicle.pressure(2), NOW_US + 1) is Origin.FORGED


def test_a_vehicle_that_stopped_signing_is_heard_again() -> None:
    identity = Identity()
    heard(identity, Vehicle(key=KEY), vehicle.heartbeat())
    assert (
        heard(identity, Vehicle(), vehicle.pressure(9), NOW_US + SIGNING_TIMEOUT_US)
        is Origin.VEHICLE
    )


def test_strangers_signatures_mean_nothing() -> None:
    identity = latched()
    assert heard(identity, Vehicle(2, 1, key=KEY), vehicle.heartbeat()) is Origin.STRANGER
    assert heard(identity, Vehicle(), vehicle.pressure(1)) is Origin.VEHICLE


def test_we_answer_in_the_highest_version_heard() -> None:
    identity = Identity()
    heard(identity, Vehicle(version=1), vehicle.heartbeat())
    assert identity.version == 1
    heard(identity, Vehicle(255, 190), vehicle.heartbeat(type=GCS, autopilot=INVALID))
    assert identity.version == 1
    heard(identity, Vehicle(version=2), vehicle.pressure(1))
    heard(identity, Vehicle(version=1), vehicle.pressure(2))
    assert identity.version == 2


def test_the_autopilot_is_what_it_says_last() -> None:
    identity = latched()
    assert identity.autopilot == ARDUPILOT
    for _ in range(3):  # one alone may be forged: it would change the scale of RAW_IMU
        assert (identity.autopilot, identity.vehicle_type) == (ARDUPILOT, QUAD)
        identity.note(vehicle.heartbeat(autopilot=PX4, type=1))
    assert (identity.autopilot, identity.vehicle_type) == (PX4, 1)
    assert [autopilot_name(number) for number in (ARDUPILOT, PX4, 42)] == [
        "ArduPilot",
        "PX4",
        "type 42",
    ]


def test_types_of_the_wire() -> None:
    assert mavlink.MAV_AUTOPILOT_INVALID == INVALID
    assert mavlink.MAV_TYPE_GCS == GCS
