"""Several links as one: who gets what, loops, repeats, loss."""

from collections.abc import Iterator

import pytest

from companion.clock import ManualClock
from companion.links import LinkState, open_links
from companion.links.memory import MemoryLink, pair
from companion.links.routing import Router, target_of
from companion.links.traffic import Traffic
from companion.mavlink.codec import Decoder, Encoder, Frame, Message, mavlink
from tests.vehicle import Vehicle, attitude, heartbeat, parsed

PILOT, STATION, OTHER = Encoder(1, 1), Encoder(255, 190), Encoder(2, 1)


class Rig:
    """A router over three memory links, and the far ends."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        ends = [pair(self.clock) for _ in range(3)]
        self.far: list[MemoryLink] = [far for _, far in ends]
        self.router = Router([near for near, _ in ends], self.clock)

    def turn(self) -> bytes:
        data = b""
        while chunk := self.router.receive(0.0):
            data += chunk
        return data

    def heard(self, index: int) -> list[str]:
        data = b""
        while chunk := self.far[index].receive(0.0):
            data += chunk
        return [message.get_type() for message in parsed([data])]

    def say(self, index: int, encoder: Encoder, message: Message) -> bytes:
        data = encoder.encode(message)
        self.far[index].send(data)
        return data


@pytest.fixture
def rig() -> Iterator[Rig]:
    made = Rig()
    made.say(0, PILOT, heartbeat())
    made.say(1, STATION, heartbeat(type=6, autopilot=8))
    made.turn()
    for index in range(3):
        made.heard(index)
    yield made
    made.router.close()


def command(system: int, component: int) -> Message:
    return mavlink.MAVLink_command_long_message(system, component, 400, 0, 1, 0, 0, 0, 0, 0, 0)


def test_broadcasts_go_to_all_others_and_to_us(rig: Rig) -> None:
    data = rig.say(0, PILOT, attitude(50.0))
    assert rig.turn() == data
    assert [rig.heard(index) for index in range(3)] == [[], ["ATTITUDE"], ["ATTITUDE"]]


def test_targets_get_theirs_alone(rig: Rig) -> None:
    rig.say(1, STATION, command(1, 1))
    rig.turn()
    assert [rig.heard(index) for index in range(3)] == [["COMMAND_LONG"], [], []]


def test_a_target_that_was_never_heard_gets_nothing(rig: Rig) -> None:
    rig.say(1, STATION, command(9, 1))
    assert rig.turn()
    assert [rig.heard(index) for index in range(3)] == [[], [], []]


def test_our_own_frames_go_to_all_or_to_their_target(rig: Rig) -> None:
    own = Encoder(1, 191)
    rig.router.send(own.encode(heartbeat(type=18, autopilot=8)))
    assert [rig.heard(index) for index in range(3)] == [["HEARTBEAT"]] * 3
    rig.router.send(own.encode(command(1, 1)))
    assert [rig.heard(index) for index in range(3)] == [["COMMAND_LONG"], [], []]


def test_a_second_way_is_no_second_frame(rig: Rig) -> None:
    """A station that is on two links at once, or a router that echoes."""
    data = rig.say(0, PILOT, attitude(50.0))
    rig.turn()
    rig.far[1].send(data)
    rig.far[2].send(data)
    assert rig.turn() == b""
    assert rig.router.repeated == 2
    assert rig.heard(0) == []


def test_a_loop_between_two_routers_carries_every_frame_once() -> None:
    clock = ManualClock()
    a, b, vehicle = pair(clock), pair(clock), pair(clock)
    left, right = Router([vehicle[0], a[0], b[0]], clock), Router([a[1], b[1]], clock)
    sent = [PILOT.encode(attitude(50.0 + number * 0.02)) for number in range(50)]
    arrived: tuple[list[bytes], list[bytes]] = ([], [])
    for frame in [*sent, *[b""] * 400]:
        if frame:
            vehicle[1].send(frame)
        for heard, router in zip(arrived, (left, right), strict=True):
            heard.append(router.receive(0.0))
    for heard in arrived:
        assert [frame for frame in heard if frame] == sent
    assert vehicle[1].receive(0.0) == b""


def test_radio_status_stays_on_its_link(rig: Rig) -> None:
    rig.say(0, Encoder(51, 68), mavlink.MAVLink_radio_status_message(60, 0, 50, 40, 0, 0, 0))
    assert rig.turn()
    assert rig.heard(1) == []


def test_frames_of_two_links_never_mix(rig: Rig) -> None:
    """Half a frame on one link, whole ones on the other."""
    data = PILOT.encode(attitude(50.0))
    rig.far[0].send(data[:8])
    other = rig.say(1, STATION, heartbeat(type=6, autopilot=8))
    assert rig.turn() == other
    rig.far[0].send(data[8:])
    assert rig.turn() == data


def test_targets_are_found_on_the_wire() -> None:
    for version in (1, 2):
        for target in ((1, 1), (255, 190), (0, 0)):
            (frame,) = Decoder().feed(STATION.encode(command(*target), version))
            assert target_of(frame) == target
    (frame,) = Decoder().feed(STATION.encode(heartbeat()))
    assert target_of(frame) == (0, 0)


def test_state_and_counters_are_those_of_all(rig: Rig) -> None:
    assert rig.router.state is LinkState.OPEN
    before = rig.router.statistics.received_bytes
    data = rig.say(2, OTHER, heartbeat())
    rig.turn()
    assert rig.router.statistics.received_bytes == before + len(data)


def test_several_urls_open_as_one() -> None:
    link = open_links(["udpin:127.0.0.1:0", "tcpin:127.0.0.1:0"])
    assert isinstance(link, Router)
    assert link.url.count("127.0.0.1") == 2
    assert link.receive(0.05) == b""
    link.close()


def frames(vehicle: Vehicle, numbers: range) -> list[Frame]:
    decoder = Decoder()
    return [f for n in numbers for f in decoder.feed(vehicle.pack(attitude(50.0 + n * 0.1)))]


def test_loss_and_jitter_of_a_sender() -> None:
    traffic = Traffic()
    for index, frame in enumerate(frames(Vehicle(), range(400))):
        late_us = 20_000 if index % 2 else 0
        if index % 10 != 3:
            traffic.take([frame], index * 100_000 + late_us)
    sender = traffic.senders[(1, 1)]
    assert sender.loss == pytest.approx(0.1, abs=0.01)
    assert sender.jitter_s == pytest.approx(0.018, abs=0.004)


def test_a_restarted_sender_and_a_late_frame_are_no_loss() -> None:
    traffic, sent = Traffic(), frames(Vehicle(), range(60))
    traffic.take([sent[50], sent[3], sent[4]], 0)
    assert traffic.senders[(1, 1)].lost == 0
