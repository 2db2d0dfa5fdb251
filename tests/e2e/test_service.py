"""The live loop on a memory link with a manual clock: the whole service, without sockets, processes
or sleeps."""

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from companion.clock import ManualClock
from companion.errors import LogFormatError
from companion.links.memory import MemoryLink, pair
from companion.logs import LogWriter
from companion.logs.tlog import TlogReader, TlogWriter
from companion.mavlink.codec import Decoder, Encoder, Message, mavlink
from companion.notices import notice
from companion.pipeline import Pipeline
from companion.samples import Packet
from companion.service import Service
from companion.settings import CompanionSettings

ALTITUDE = mavlink.MAVLINK_MSG_ID_ALTITUDE
HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
TIMESYNC = mavlink.MAVLINK_MSG_ID_TIMESYNC
COMMAND_LONG = mavlink.MAVLINK_MSG_ID_COMMAND_LONG


class Bench:
    """A service on one end of a memory link, a hand-driven vehicle on the other."""

    def __init__(self, recorder: LogWriter | None = None) -> None:
        self.clock = ManualClock()
        self.near, self.far = pair(self.clock)
        self.service = Service(self.near, CompanionSettings(), self.clock, recorder=recorder)
        self.vehicle = Encoder(1, 1)
        self._decoder = Decoder()

    def send(self, *messages: Message) -> None:
        for message in messages:
            self.far.send(self.vehicle.encode(message))

    def turn(self, count: int = 1) -> None:
        for _ in range(count):
            self.service.turn(0.0)

    def heard(self) -> list[Message]:
        """What the vehicle's side received since the last call."""
        data = b""
        while chunk := self.far.receive(0.0):
            data += chunk
        return [self._decoder.decode(frame) for frame in self._decoder.feed(data)]

    def second(self, boot_ms: int) -> None:
        """One second of a vehicle that stands at 500 m: 5 Hz GNSS and barometer."""
        self.send(heartbeat())
        for step in range(5):
            stamp = boot_ms + 200 * step
            self.send(
                mavlink.MAVLink_scaled_pressure_message(stamp, 954.61, 0, 2500),
                mavlink.MAVLink_gps_raw_int_message(
                    stamp * 1000,
                    3,
                    470000000,
                    80000000,
                    500_000,
                    100,
                    150,
                    0,
                    0,
                    10,
                    0,
                    1000,
                    2000,
                    0,
                    0,
                ),
            )
            self.turn(4)  # a memory link hands over one message a turn
            self.clock.advance_s(0.2)

    def close(self) -> None:
        self.near.close()
        self.far.close()


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.close()


def heartbeat() -> Message:
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3
    )


def feed(link: MemoryLink, service: Service, clock: ManualClock, packets: list[Packet]) -> None:
    for before, packet in zip([packets[0], *packets], packets, strict=False):
        clock.advance_s((packet.time_us - before.time_us) * 1e-6)
        link.send(packet.data)
        service.turn(0.0)


def test_altitude_comes_back_at_ten_hertz_of_vehicle_time(short_hop: Path) -> None:
    bench = Bench()
    packets = list(TlogReader(short_hop))
    feed(bench.far, bench.service, bench.clock, packets)
    stamps = [message.time_usec for message in bench.heard() if message.get_msgId() == ALTITUDE]
    bench.close()
    flown_s = (packets[-1].time_us - packets[0].time_us) * 1e-6
    assert len(stamps) > 9 * (flown_s - 15)  # no altitude before the first fix
    gaps_us = [after - before for before, after in pairwise(stamps)]
    assert min(gaps_us) >= 50_000
    assert sorted(gaps_us)[len(gaps_us) // 2] == 100_000


def test_live_and_replay_of_its_recording_agree_byte_for_byte(
    short_hop: Path, tmp_path: Path
) -> None:
    """ALTITUDE, DEBUG and STATUSTEXT of a live run equal those of a replay of what it recorded,
    sequence apart."""
    recording = tmp_path / "live.tlog"
    with TlogWriter(recording) as recorder:
        bench = Bench(recorder)
        feed(bench.far, bench.service, bench.clock, list(TlogReader(short_hop)))
        bench.close()
    hosts_own = {HEARTBEAT, COMMAND_LONG, TIMESYNC}  # these follow the host's clock
    pipeline, decoder = Pipeline(CompanionSettings(), datagrams=True), Decoder(datagrams=True)
    live: list[bytes] = []
    replayed: list[bytes] = []
    for packet in TlogReader(recording):
        (frame,) = decoder.feed(packet.data)
        if frame.component_id == 191:
            if frame.message_id not in hosts_own:
                live.append(without_sequence(packet.data))
        else:
            replayed += [without_sequence(sent) for sent in pipeline.feed(packet)]
    assert len(live) > 2000
    assert live == replayed
    assert pipeline.filter.checkpoint() == bench.service.pipeline.filter.checkpoint()


def without_sequence(frame: bytes) -> bytes:
    """A MAVLink 2 frame without its sequence number and checksum."""
    return frame[:4] + frame[5:-2]


def test_requests_each_stream_once_and_reads_the_answers(bench: Bench) -> None:
    asked: list[float] = []
    for tick in range(20):
        if tick % 10 == 0:
            bench.send(heartbeat())
        bench.turn()
        for message in bench.heard():
            if message.get_msgId() == COMMAND_LONG:
                asked.append(message.param1)
                bench.send(
                    mavlink.MAVLink_command_ack_message(
                        message.command, mavlink.MAV_RESULT_ACCEPTED
                    )
                )
        bench.turn()
        bench.clock.advance_s(0.05)
    assert asked.count(mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE) == 1
    assert asked.count(mavlink.MAVLINK_MSG_ID_GPS_RAW_INT) == 1
    assert len(asked) == len(set(asked))


def test_silent_link_is_lost_and_comes_back(bench: Bench) -> None:
    for second in range(6):
        bench.second(10_000 + 1000 * second)
    assert any(message.get_msgId() == ALTITUDE for message in bench.heard())
    for _ in range(50):
        bench.clock.advance_s(0.1)
        bench.turn()
    silent = bench.heard()
    texts = [
        message.text
        for message in silent
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_STATUSTEXT
    ]
    assert len(texts) == 1
    assert texts[0] == "Kollsman LOST: nothing heard"
    assert not any(message.get_msgId() == ALTITUDE for message in silent)
    beats = [message for message in silent if message.get_msgId() == HEARTBEAT]
    assert beats[-1].system_status == mavlink.MAV_STATE_CRITICAL
    for second in range(6):
        bench.second(30_000 + 1000 * second)
    assert any(message.get_msgId() == ALTITUDE for message in bench.heard())


def test_our_heartbeat_is_an_onboard_controller_on_the_vehicles_system(bench: Bench) -> None:
    bench.second(10_000)
    beat, *_ = [message for message in bench.heard() if message.get_msgId() == HEARTBEAT]
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (1, 191)
    assert (beat.type, beat.autopilot) == (
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
        mavlink.MAV_AUTOPILOT_INVALID,
    )


def test_our_heartbeat_goes_out_from_the_first_second_vehicle_or_not(bench: Bench) -> None:
    """PX4 on USB, a server and a router speak only to who spoke."""
    bench.turn()
    (first,) = bench.heard()
    assert first.get_msgId() == HEARTBEAT
    assert first.system_status == mavlink.MAV_STATE_CRITICAL
    for _ in range(100):
        bench.clock.advance_s(0.1)
        bench.turn()
    beats = bench.heard()
    assert len(beats) == 10
    assert {message.get_msgId() for message in beats} == {HEARTBEAT}


def test_second_companion_with_our_ids_makes_us_move(bench: Bench) -> None:
    """Anybody could send its heartbeats, so they must not end us."""
    other = Encoder(1, 191)
    bench.second(10_000)
    for _ in range(2):
        bench.far.send(other.encode(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)))
    bench.turn(2)
    assert any("1/192" in text for text in texts_of(bench.heard()))
    for second in range(1, 8):
        bench.second(10_000 + 1000 * second)
    heard = bench.heard()
    assert {message.get_srcComponent() for message in heard} == {192}
    assert any(message.get_msgId() == ALTITUDE for message in heard)


def texts_of(messages: list[Message]) -> list[str]:
    return [m.text for m in messages if m.get_msgId() == mavlink.MAVLINK_MSG_ID_STATUSTEXT]


def test_our_own_echo_is_no_second_companion(bench: Bench) -> None:
    for second in range(5):
        bench.second(10_000 + 1000 * second)
        while data := bench.far.receive(0.0):
            bench.far.send(data)
        bench.turn(50)


def test_commands_to_us_are_answered_unsupported(bench: Bench) -> None:
    bench.second(10_000)
    bench.heard()
    station = Encoder(255, 190)
    bench.far.send(
        station.encode(mavlink.MAVLink_command_long_message(1, 191, 400, 0, 1, 0, 0, 0, 0, 0, 0))
    )
    bench.far.send(
        station.encode(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
    )
    bench.turn(2)
    answers = [m for m in bench.heard() if m.get_msgId() == mavlink.MAVLINK_MSG_ID_COMMAND_ACK]
    assert [(answer.command, answer.result) for answer in answers] == [
        (400, mavlink.MAV_RESULT_UNSUPPORTED)
    ]


@pytest.mark.parametrize(
    ("messages", "expected"),
    [
        ([], "nothing received on .*baud rate"),
        ([mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)], "no heartbeat of an autopilot"),
        ([heartbeat()], "no barometer .*only HEARTBEAT"),
        (
            [heartbeat(), mavlink.MAVLink_scaled_pressure_message(1000, 0.0, 0, 2500)],
            "1 messages of the barometer .*none usable",
        ),
    ],
)
def test_notice_says_what_was_heard_and_what_to_check(
    bench: Bench, messages: list[Message], expected: str
) -> None:
    bench.send(*messages)
    bench.turn(len(messages) + 1)
    line = notice(bench.service.pipeline, bench.near)
    assert "\n" not in line
    assert re.search(expected, line)


def test_noise_on_the_line_is_named(bench: Bench) -> None:
    bench.far.send(b"console text, no MAVLink\r\n" * 20)
    bench.turn(2)
    assert "no MAVLink" in notice(bench.service.pipeline, bench.near)


def test_a_full_disk_ends_the_recording_not_the_service() -> None:
    class FullDisk:
        """A mock: a file system cannot be filled from here."""

        def write(self, time_us: int, frame: bytes) -> None:
            raise LogFormatError("flight.tlog: cannot be written (No space left on device)")

        def close(self) -> None: ...

        def __enter__(self) -> "FullDisk":
            return self

        def __exit__(self, *error: object) -> None: ...

    bench = Bench(FullDisk())
    for second in range(6):
        bench.second(10_000 + 1000 * second)
    assert any(message.get_msgId() == ALTITUDE for message in bench.heard())
    bench.close()
