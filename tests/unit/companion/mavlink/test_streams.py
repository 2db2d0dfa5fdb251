"""Asking the vehicle for messages: one at a time, again when unanswered, no further when refused."""

import pytest

from companion.clock import ManualClock
from companion.links.memory import pair
from companion.mavlink.codec import Decoder, Message, mavlink
from companion.mavlink.streams import ATTEMPTS, Request, StreamRequester, StreamSettings, wanted
from companion.samples import Kind
from companion.service import Service
from companion.settings import CompanionSettings
from tests import vehicle
from tests.vehicle import Vehicle

PRESSURE, GPS, RAW_IMU, HIGHRES, ATTITUDE = 29, 24, 27, 105, 30
SYSTEM_TIME, HOME, EXTENDED = 2, 242, 245
ARDUPILOT, PX4 = 3, 12
ACCEPTED, TEMPORARILY, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = 0, 1, 2, 3, 4, 5
SET_INTERVAL = 511
SECOND_US = 1_000_000


def ack(result: int, command: int = SET_INTERVAL, **target: int) -> Message:
    return mavlink.MAVLink_command_ack_message(command, result, **target)


class Bench:
    """A requester and the host's clock."""

    def __init__(self, count: int = 2) -> None:
        self.requests = [Request(PRESSURE, 20.0), Request(GPS, 5.0), Request(RAW_IMU, 50.0)][:count]
        self.requester = StreamRequester(list(self.requests), (1, 1))
        self.now_us = 1_700_000_000 * SECOND_US
        self.sent: list[Message] = []

    def run(self, duration_s: float) -> list[Message]:
        """Poll ten times a second; what was sent meanwhile."""
        before = len(self.sent)
        for _ in range(round(duration_s * 10)):
            message = self.requester.poll(self.now_us)
            if message is not None:
                self.sent.append(message)
            self.now_us += SECOND_US // 10
        return self.sent[before:]


def test_a_request_says_what_and_how_often() -> None:
    (message,) = Bench().run(0.1)
    assert message.get_type() == "COMMAND_LONG"
    assert (message.target_system, message.target_component, message.command) == (
        1,
        1,
        SET_INTERVAL,
    )
    assert (message.param1, message.param2, message.confirmation) == (PRESSURE, 50_000.0, 0)


def test_the_next_goes_out_when_the_last_was_accepted() -> None:
    bench = Bench()
    assert [message.param1 for message in bench.run(0.5)] == [PRESSURE]
    bench.requester.acknowledge(ack(ACCEPTED))
    assert [message.param1 for message in bench.run(0.5)] == [GPS]
    bench.requester.acknowledge(ack(ACCEPTED))
    assert bench.run(10.0) == []
    assert bench.requester.done
    assert bench.requester.granted == bench.requests


@pytest.mark.parametrize(
    ("result", "why"),
    [(UNSUPPORTED, "UNSUPPORTED"), (DENIED, "DENIED"), (FAILED, "FAILED"), (99, "99")],
)
def test_a_refusal_is_noted_and_not_repeated(result: int, why: str) -> None:
    bench = Bench()
    bench.run(0.1)
    bench.requester.acknowledge(ack(result))
    assert bench.requester.refused == [(bench.requests[0], why)]
    assert [message.param1 for message in bench.run(0.5)] == [GPS]


def test_without_an_answer_it_asks_again_and_gives_up() -> None:
    bench = Bench()
    messages = bench.run(2 * ATTEMPTS + 5.0)
    assert [message.param1 for message in messages] == [PRESSURE] * ATTEMPTS + [GPS] * ATTEMPTS
    assert [message.confirmation for message in messages[:ATTEMPTS]] == list(range(ATTEMPTS))
    assert [why for _, why in bench.requester.refused] == ["no answer"] * 2
    assert bench.requester.done


def test_a_late_answer_after_a_retry_counts_once() -> None:
    bench = Bench(count=1)
    bench.run(2.5)
    bench.requester.acknowledge(ack(ACCEPTED))
    bench.requester.acknowledge(ack(ACCEPTED))
    assert bench.requester.granted == bench.requests


def test_temporarily_rejected_asks_again_later() -> None:
    bench = Bench(count=1)
    bench.run(0.1)
    bench.requester.acknowledge(ack(TEMPORARILY))
    assert bench.run(0.5) == []
    assert len(bench.run(1.0)) == 1
    bench.requester.acknowledge(ack(ACCEPTED))
    assert bench.requester.done


def test_in_progress_waits() -> None:
    bench = Bench(count=1)
    bench.run(0.1)
    bench.requester.acknowledge(ack(IN_PROGRESS))
    assert not bench.requester.done
    assert not bench.requester.refused


def test_answers_to_nothing_are_ignored() -> None:
    bench = Bench()
    bench.requester.acknowledge(ack(ACCEPTED))
    assert not bench.requester.granted
    bench.run(0.1)
    bench.requester.acknowledge(ack(ACCEPTED, command=400))
    assert not bench.requester.granted


@pytest.mark.parametrize(("autopilot", "imu"), [(ARDUPILOT, RAW_IMU), (PX4, HIGHRES), (0, RAW_IMU)])
def test_what_is_asked_for(autopilot: int, imu: int) -> None:
    everything = wanted(StreamSettings(), list(Kind), autopilot)
    assert [request.message_id for request in everything] == [
        PRESSURE,
        GPS,
        imu,
        ATTITUDE,
        SYSTEM_TIME,
        HOME,
        EXTENDED,
    ]


def test_only_what_the_estimator_uses_and_only_rates_above_zero() -> None:
    few = wanted(StreamSettings(status_hz=0), [Kind.PRESSURE, Kind.GNSS], ARDUPILOT)
    assert [(request.name, request.rate_hz) for request in few] == [
        ("SCALED_PRESSURE", 20.0),
        ("GPS_RAW_INT", 5.0),
    ]
    assert wanted(StreamSettings(status_hz=0, pressure_hz=0), [Kind.PRESSURE], ARDUPILOT) == []


class Live:
    """A service on a memory link, and a vehicle that answers by hand."""

    def __init__(self, **streams: bool) -> None:
        self.clock = ManualClock()
        near, self.far = pair(self.clock)
        self.service = Service(near, CompanionSettings().with_changes(streams=streams), self.clock)
        self.vehicle, self._decoder = Vehicle(), Decoder()

    def send(self, message: Message, sender: Vehicle | None = None) -> None:
        self.far.send((sender or self.vehicle).pack(message))
        self.service.turn(0.0)

    def requests(self, duration_s: float) -> list[int]:
        """Message ids asked for during `duration_s`."""
        found: list[Message] = []
        for _ in range(round(duration_s * 10)):
            self.clock.advance_s(0.1)
            self.service.turn(0.0)
            while data := self.far.receive(0.0):
                found += [self._decoder.decode(frame) for frame in self._decoder.feed(data)]
        return [int(message.param1) for message in found if message.get_type() == "COMMAND_LONG"]


def test_nothing_is_asked_before_a_vehicle_is_there() -> None:
    live = Live()
    live.send(vehicle.pressure(1.0))
    assert live.requests(3.0) == []
    live.send(vehicle.heartbeat())
    assert live.requests(0.5) == [PRESSURE]


def test_answers_to_a_ground_station_are_not_ours() -> None:
    """It asks for intervals too; its refusals must not end our requests."""
    live = Live()
    live.send(vehicle.heartbeat())
    assert live.requests(0.5) == [PRESSURE]
    live.send(ack(DENIED, target_system=255, target_component=190))
    assert live.requests(1.0) == [PRESSURE]
    live.send(ack(ACCEPTED), sender=Vehicle(2, 1))
    assert live.requests(1.0) == [PRESSURE]
    live.send(ack(ACCEPTED, target_system=1, target_component=191))
    assert live.requests(0.5) == [GPS]


def test_configured_off() -> None:
    live = Live(request=False)
    live.send(vehicle.heartbeat())
    assert live.requests(3.0) == []
