"""Message rates against a vehicle that grants, refuses, ignores, forgets and is overridden."""

import logging
from collections import Counter

import pytest

from companion.mavlink.codec import Message, mavlink
from companion.mavlink.streams import StreamSettings, wanted
from companion.mavlink.supervisor import ATTEMPTS, StreamSupervisor
from companion.samples import Kind

PRESSURE, GPS, RAW_IMU, RANGE = 29, 24, 27, 132
ACCEPTED, TEMPORARILY, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = 0, 1, 2, 3, 4, 5
SET_INTERVAL = 511
SECOND_US = 1_000_000
KINDS = (Kind.PRESSURE, Kind.GNSS, Kind.IMU)
STREAMS = wanted(
    StreamSettings(status_hz=0, spare_hz=0, position_hz=0, gnss_hz=5), KINDS, 3
)  # barometer, GNSS, IMU, range finder, second receiver


@pytest.fixture(autouse=True)
def _logger_on() -> None:
    """import-linter disables loggers when it runs in the same process."""
    logging.getLogger("kollsman.streams").disabled = False


class Autopilot:
    """Streams what was requested, by its own rules, and counts it; the supervisor's other end.

    `speed` : of its clock against the host's.
    """

    def __init__(
        self, *, use_groups: bool = False, speed: float = 1.0, has_range: bool = True
    ) -> None:
        self.supervisor = StreamSupervisor(STREAMS, (1, 1), use_groups=use_groups)
        self.result = ACCEPTED
        self.highest_hz = 1000.0
        self.answers = True
        self.alive = True
        self.clock_runs = True
        self.stations = ""
        self.speed = speed
        self.rates_hz: dict[int, float] = {}
        self.absent = {124} if has_range else {124, RANGE}
        self.sent: list[Message] = []
        self.heard: Counter[int] = Counter()
        self._owed: Counter[int] = Counter()
        self._frames = 0
        self.now_us = 1_700_000_000 * SECOND_US
        self.vehicle_us = 30 * SECOND_US

    def run(self, duration_s: float) -> list[Message]:
        """Twenty turns a second of the host's clock; what was sent meanwhile."""
        before = len(self.sent)
        for _ in range(round(duration_s * 20)):
            self.now_us += SECOND_US // 20
            if self.alive:
                self._stream(0.05 * self.speed)
            messages = self.supervisor.poll(
                self.now_us, self.vehicle_us, self.heard, self._frames, self.stations
            )
            self.sent += messages
            for message in messages:
                if self.alive:
                    self._take(message)
        return self.sent[before:]

    def _stream(self, elapsed_s: float) -> None:
        self._frames += 1  # heartbeats and the like
        moves = False
        for message_id, rate_hz in self.rates_hz.items():
            if message_id in self.absent:
                continue
            self._owed[message_id] += rate_hz * elapsed_s  # type: ignore[assignment]
            whole = int(self._owed[message_id])
            self._owed[message_id] -= whole
            self.heard[message_id] += whole
            self._frames += whole
            moves = moves or rate_hz > 0
        if moves and self.clock_runs:
            self.vehicle_us += round(elapsed_s * 1e6)

    def _take(self, message: Message) -> None:
        if message.get_type() == "REQUEST_DATA_STREAM":
            for stream in STREAMS:
                if stream.group == message.req_stream_id:
                    self.rates_hz[stream.message_id] = message.req_message_rate * message.start_stop
            return
        rate_hz = 1e6 / message.param2 if message.param2 > 0 else 1.0
        result = DENIED if rate_hz > self.highest_hz else self.result
        if result == ACCEPTED and self.answers:
            self.rates_hz[int(message.param1)] = rate_hz
        if self.answers:
            answer = mavlink.MAVLink_command_ack_message(SET_INTERVAL, result)
            self.supervisor.acknowledge(answer, self.now_us)

    def requests(self) -> list[tuple[int, float]]:
        """(message id, Hz) of the intervals requested so far."""
        return [
            (int(message.param1), 1e6 / message.param2 if message.param2 else 0.0)
            for message in self.sent
            if message.get_type() == "COMMAND_LONG"
        ]


def test_a_request_says_what_and_how_often() -> None:
    message = Autopilot().run(0.1)[0]
    assert message.get_type() == "COMMAND_LONG"
    target = (message.target_system, message.target_component, message.command)
    assert target == (1, 1, SET_INTERVAL)
    assert (message.param1, message.param2, message.confirmation) == (PRESSURE, 50_000.0, 0)


def test_what_is_granted_is_requested_once() -> None:
    bench = Autopilot()
    bench.run(120.0)
    asked = [message_id for message_id, _ in bench.requests()]
    assert asked == [stream.message_id for stream in STREAMS]
    assert bench.supervisor.problems == []


@pytest.mark.parametrize("speed", [0.25, 1.0, 20.0])
def test_rates_are_measured_in_vehicle_time(speed: float) -> None:
    bench = Autopilot(speed=speed)
    bench.run(60.0)
    assert len(bench.requests()) == len(STREAMS)
    assert bench.supervisor.watches[RAW_IMU].rate_hz == pytest.approx(50.0, rel=0.1)


@pytest.mark.parametrize("clock_runs", [True, False])
def test_a_vehicle_that_forgets_is_asked_again_within_three_seconds(clock_runs: bool) -> None:
    """As a Copter does that restarts: heartbeats only, so its clock does not even tell."""
    bench = Autopilot()
    bench.run(30.0)
    bench.rates_hz.clear()
    bench.clock_runs = clock_runs
    before = len(bench.requests())
    bench.run(3.0)
    asked = {message_id for message_id, _ in bench.requests()[before:]}
    assert {PRESSURE, GPS, RAW_IMU} <= asked
    bench.clock_runs = True
    bench.run(5.0)
    assert bench.rates_hz[RAW_IMU] == 50.0
    assert bench.supervisor.problems == []


def test_an_imu_that_falls_to_one_hertz_is_asked_again() -> None:
    bench = Autopilot()
    bench.run(20.0)
    bench.rates_hz[RAW_IMU] = 1.0
    before = len(bench.requests())
    bench.run(3.0)
    assert bench.requests()[before:] == [(RAW_IMU, 50.0)]


def test_denied_steps_down() -> None:
    """ArduPlane's loop of 50 Hz sends at most 40 Hz."""
    for highest_hz, expected in ((40.0, [50, 40]), (30.0, [50, 40, 25]), (12.0, [50, 40, 25, 10])):
        bench = Autopilot()
        bench.highest_hz = highest_hz
        bench.run(60.0)
        asked = [rate_hz for message_id, rate_hz in bench.requests() if message_id == RAW_IMU]
        assert asked == expected
        assert bench.supervisor.problems == []


def test_a_refused_stream_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    bench = Autopilot()
    bench.result = FAILED
    with caplog.at_level(logging.WARNING):
        bench.run(120.0)
    assert "IMU refused (FAILED), 0 Hz" in bench.supervisor.problems
    refusals = [record for record in caplog.messages if "refuses RAW_IMU" in record]
    assert len(refusals) == 1
    asked = [rate_hz for message_id, rate_hz in bench.requests() if message_id == RAW_IMU]
    assert asked == [50, 40, 25, 10]


def test_a_sensor_that_never_comes_is_told_and_asked_for_ever_less_often() -> None:
    bench = Autopilot()
    bench.absent.add(RAW_IMU)
    bench.run(20.0)
    assert bench.supervisor.problems == ["no RAW_IMU"]
    count = len(bench.requests())
    bench.run(600.0)
    assert len(bench.requests()) - count < 10
    bench.absent.remove(RAW_IMU)
    bench.run(10.0)
    assert bench.supervisor.problems == []


def test_an_optional_sensor_that_is_absent_is_no_problem() -> None:
    bench = Autopilot(has_range=False)
    bench.run(60.0)
    assert bench.supervisor.problems == []
    assert len(bench.requests()) == len(STREAMS)


def test_without_answers_it_asks_thrice_and_then_once_each() -> None:
    bench = Autopilot()
    bench.answers = False
    bench.run(8.0)
    asked = [message_id for message_id, _ in bench.requests()]
    assert asked[:ATTEMPTS] == [PRESSURE] * ATTEMPTS
    assert [message.confirmation for message in bench.sent[:ATTEMPTS]] == list(range(ATTEMPTS))
    assert asked[ATTEMPTS : ATTEMPTS + 3] == [GPS, RAW_IMU, RANGE]


@pytest.mark.parametrize("result", [UNSUPPORTED, None])
def test_groups_where_intervals_have_no_effect(result: int | None) -> None:
    bench = Autopilot(use_groups=True)
    bench.answers = result is not None
    bench.result = result or ACCEPTED
    bench.run(10.0)
    assert {PRESSURE, GPS, RAW_IMU} <= {key for key, hz in bench.rates_hz.items() if hz > 0}
    assert bench.supervisor.problems == []
    count = len(bench.sent)
    bench.rates_hz.clear()
    bench.run(4.0)
    assert bench.rates_hz[RAW_IMU] > 0
    assert len(bench.sent) > count
    groups = [
        message for message in bench.supervisor.restore() if message.get_type() != "COMMAND_LONG"
    ]
    assert groups
    assert all(message.start_stop == 0 for message in groups)


def test_groups_are_not_used_where_they_would_be_saved(caplog: pytest.LogCaptureFixture) -> None:
    bench = Autopilot(use_groups=False)
    bench.result = UNSUPPORTED
    with caplog.at_level(logging.WARNING):
        bench.run(30.0)
    assert all(message.get_type() == "COMMAND_LONG" for message in bench.sent)
    assert sum("streams.data_stream" in line for line in caplog.messages) == 1


def test_it_backs_off_from_who_insists_and_names_it(caplog: pytest.LogCaptureFixture) -> None:
    """MAVProxy asks for everything at 4 Hz every 15 s."""
    bench = Autopilot()
    bench.run(20.0)
    starts = []
    with caplog.at_level(logging.WARNING):
        for _ in range(40):
            bench.rates_hz = dict.fromkeys(bench.rates_hz, 4.0)
            bench.supervisor.other_request(bench.now_us, "255/230")
            starts.append(len(bench.requests()))
            bench.run(15.0)
    asked = [
        end - start for start, end in zip(starts, [*starts[1:], len(bench.requests())], strict=True)
    ]
    assert all(asked[:3])
    assert sum(count > 0 for count in asked[-20:]) <= 8
    assert "rates lowered by 255/230" in bench.supervisor.problems
    assert sum("again and again by 255/230" in line for line in caplog.messages) == 1
    bench.run(500.0)
    assert bench.rates_hz[RAW_IMU] == 50.0
    assert bench.supervisor.problems == []


def test_nothing_is_requested_from_a_silent_vehicle() -> None:
    bench = Autopilot()
    bench.run(20.0)
    bench.alive = False
    count = len(bench.sent)
    bench.run(30.0)
    assert len(bench.sent) == count
    bench.alive = True
    bench.run(3.0)
    assert len(bench.sent) - count == len(STREAMS)


def test_what_was_requested_is_put_back() -> None:
    bench = Autopilot()
    bench.run(20.0)
    undo = bench.supervisor.restore()
    assert {int(message.param1) for message in undo} == {stream.message_id for stream in STREAMS}
    assert {message.param2 for message in undo} == {0.0}


def test_temporarily_rejected_is_requested_again_after_three_seconds() -> None:
    """While it starts, an autopilot is busy; that says nothing about intervals."""
    bench = Autopilot()
    bench.result = TEMPORARILY
    bench.run(2.0)
    assert len(bench.requests()) == len(STREAMS)
    bench.result = ACCEPTED
    bench.run(3.0)
    assert len(bench.requests()) == 2 * len(STREAMS)
    assert bench.supervisor.problems == []
    forever = Autopilot()
    forever.result = TEMPORARILY
    forever.run(200.0)
    assert len(forever.requests()) <= 8 * len(STREAMS)
    assert not [message for message in forever.sent if message.get_type() != "COMMAND_LONG"]


def test_in_progress_waits() -> None:
    bench = Autopilot()
    bench.result = IN_PROGRESS
    bench.run(0.5)
    assert bench.requests() == [(PRESSURE, 20.0)]


def test_answers_to_other_commands_are_not_ours() -> None:
    bench = Autopilot()
    bench.answers = False
    bench.run(0.1)
    bench.supervisor.acknowledge(mavlink.MAVLink_command_ack_message(400, ACCEPTED), bench.now_us)
    bench.run(0.5)
    assert bench.requests() == [(PRESSURE, 20.0)]
