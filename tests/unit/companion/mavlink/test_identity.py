"""Whom we listen to: one vehicle for life, nobody who only claims to be one, nothing unsigned in a
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
from tests import vehicle
from tests.vehicle import Vehicle

KEY = bytes(range(32))
ARDUPILOT, PX4, INVALID, GENERIC = 3, 12, 8, 0
QUAD, GCS, ONBOARD, GIMBAL = 2, 6, 18, 26
NOW_US = 1_700_000_000_000_000


def frame(sender: Vehicle, message: Message) -> Frame:
    (found,) = Decoder(datagrams=True).feed(sender.pack(message))
    return found


def heard(
    identity: Identity, sender: Vehicle, message: Message, arrival_us: int = NOW_US
) -> Origin:
    """As the pipeline does: offer heartbeats while there is no vehicle, then ask whose frame it is."""
    found = frame(sender, message)
    if message.get_type() == "HEARTBEAT":
        identity.offer(found, message)
    return identity.origin(found, arrival_us)


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
        (INVALID, QUAD, False),  # a companion that claims to be a quadrotor
        (INVALID, GIMBAL, False),
        (INVALID, ONBOARD, False),
        (INVALID, GCS, False),
        (ARDUPILOT, GCS, False),  # DroneKit
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


def test_a_wanted_vehicle_is_waited_for() -> None:
    identity = Identity(system_id=2)
    assert heard(identity, Vehicle(1, 1), vehicle.heartbeat()) is Origin.EARLY
    assert heard(identity, Vehicle(2, 1), vehicle.heartbeat()) is Origin.VEHICLE
    assert identity.vehicle == (2, 1)


def test_system_id_0_is_broadcast_and_no_vehicle() -> None:
    identity = Identity()
    assert heard(identity, Vehicle(0, 1), vehicle.heartbeat()) is Origin.EARLY


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
