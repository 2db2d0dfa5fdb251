"""Parameters and commands of our own component, as a ground station uses them."""

import math

import pytest

from companion.mavlink.codec import Encoder, Message, mavlink
from companion.mavlink.commands import (
    GET_MESSAGE_INTERVAL,
    ON_REQUEST,
    PREFLIGHT_STORAGE,
    REQUEST_MESSAGE,
)
from companion.mavlink.debug import NAMED
from companion.mavlink.parameters import LONGEST_NAME, NAMES
from companion.pipeline import Pipeline
from companion.samples import Packet
from companion.settings import CompanionSettings
from tests.vehicle import parsed, standing

STATION = Encoder(255, 190)
REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
OURS = (1, 191)


@pytest.fixture(scope="module")
def flown() -> Pipeline:
    pipeline = Pipeline(CompanionSettings())
    for packet in standing(30.0, 40.0):
        pipeline.feed(packet)
    return pipeline


def ask(pipeline: Pipeline, message: Message, at_s: int) -> list[Message]:
    return parsed(pipeline.feed(Packet(10**15 + at_s * 10**6, STATION.encode(message))))


def put(pipeline: Pipeline, name: str, value: float, at_s: int) -> float:
    message = mavlink.MAVLink_param_set_message(*OURS, name.encode(), value, REAL32)
    (answer,) = ask(pipeline, message, at_s)
    assert answer.param_id == name
    return float(answer.param_value)


@pytest.mark.parametrize("target", [OURS, (1, 0), (0, 0)])
def test_list(flown: Pipeline, target: tuple[int, int]) -> None:
    values = ask(flown, mavlink.MAVLink_param_request_list_message(*target), 1 + sum(target))
    assert [value.param_id for value in values] == sorted(NAMES)
    assert [value.param_index for value in values] == list(range(len(NAMES)))
    assert {value.param_count for value in values} == {len(NAMES)}
    assert {(value.get_srcSystem(), value.get_srcComponent()) for value in values} == {OURS}
    known = {value.param_id: value.param_value for value in values}
    assert known["PUB_ALT_HZ"] == 10.0
    assert math.isnan(known["AIR_QNH_HPA"])


def test_names_texts_and_ranges_come_from_the_models(flown: Pipeline) -> None:
    for parameter in flown.parameters.table:
        assert len(parameter.name) <= LONGEST_NAME
        assert parameter.text
        assert parameter.allowed.startswith(("from", "above"))
    qnh = next(each for each in flown.parameters.table if each.name == "AIR_QNH_HPA")
    assert (qnh.allowed, qnh.unit) == ("from 850 to 1100", "hPa")


def test_read_by_name_and_by_index(flown: Pipeline) -> None:
    for number, (name, index) in enumerate([(b"PUB_ALT_HZ", -1), (b"", 6)]):
        message = mavlink.MAVLink_param_request_read_message(*OURS, name, index)
        (value,) = ask(flown, message, 700 + number)
        assert value.param_id == sorted(NAMES)[6] == "PUB_ALT_HZ"
    message = mavlink.MAVLink_param_request_read_message(*OURS, b"NOT_OURS", -1)
    assert ask(flown, message, 710) == []


def test_qnh_in_flight(flown: Pipeline) -> None:
    assert put(flown, "AIR_QNH_HPA", 1009.0, 800) == 1009.0
    assert flown.air.qnh_hpa == 1009.0
    for number, wrong in enumerate((500.0, math.nan, math.inf)):
        assert put(flown, "AIR_QNH_HPA", wrong, 801 + number) == 1009.0
    assert put(flown, "AIR_FIELD_M", 432.0, 810) == 432.0
    assert put(flown, "PUB_ALT_HZ", 50.0, 811) == 10.0


def test_others_parameters_are_not_ours(flown: Pipeline) -> None:
    message = mavlink.MAVLink_param_set_message(1, 1, b"AIR_QNH_HPA", 990.0, REAL32)
    assert ask(flown, message, 820) == []
    assert flown.air.qnh_hpa != 990.0


@pytest.mark.parametrize("command", [mavlink.MAV_CMD_REQUEST_MESSAGE, 520])
def test_version_on_request(flown: Pipeline, command: int) -> None:
    message = mavlink.MAVLink_command_long_message(*OURS, command, 0, 148, 0, 0, 0, 0, 0, 0)
    ack, version = ask(flown, message, 900 + command)
    assert (ack.command, ack.result) == (command, mavlink.MAV_RESULT_ACCEPTED)
    assert version.get_type() == "AUTOPILOT_VERSION"
    assert version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT


def command(flown: Pipeline, number: int, *values: float, at: int) -> list[Message]:
    padded = (*values, *[0.0] * (7 - len(values)))
    return ask(flown, mavlink.MAVLink_command_long_message(*OURS, number, 0, *padded), at)


def test_what_we_send_is_sent_on_request_while_it_is_new() -> None:
    pipeline, packets = Pipeline(CompanionSettings()), list(standing(30.0, 40.0))
    for packet in packets:
        pipeline.feed(packet)
    pipeline.heartbeat()

    def request(message_id: int, after_us: int) -> tuple[int, list[Message]]:
        values = (message_id, 0, 0, 0, 0, 0, 0)
        message = mavlink.MAVLink_command_long_message(*OURS, REQUEST_MESSAGE, 0, *values)
        at_us = packets[-1].time_us + after_us
        ack, *found = parsed(pipeline.feed(Packet(at_us, STATION.encode(message))))
        return ack.result, found

    for number, wanted in enumerate(sorted(ON_REQUEST)):
        result, found = request(wanted, 1000 * number)
        assert result == mavlink.MAV_RESULT_ACCEPTED
        assert {message.get_msgId() for message in found} == {wanted}
        named = wanted == mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT
        assert len(found) == (len(NAMED) + 1 if named else 1)
    assert request(30, 10_000) == (mavlink.MAV_RESULT_UNSUPPORTED, [])
    assert request(141, 2_500_000) == (mavlink.MAV_RESULT_DENIED, [])


def test_intervals_on_request(flown: Pipeline) -> None:
    for number, (wanted, interval_us) in enumerate([(141, 100_000), (254, 1_000_000), (30, 0)]):
        ack, told = command(flown, REQUEST_MESSAGE, 244, wanted, at=1200 + 20 * number)
        assert (told.message_id, told.interval_us) == (wanted, interval_us)
        ack, same = command(flown, GET_MESSAGE_INTERVAL, wanted, at=1210 + 20 * number)
        assert ack.result == mavlink.MAV_RESULT_ACCEPTED
        assert same.interval_us == interval_us


def test_parameters_are_kept_on_request(flown: Pipeline) -> None:
    (ack,) = command(flown, PREFLIGHT_STORAGE, 1, at=1300)
    assert ack.result == mavlink.MAV_RESULT_FAILED  # nowhere to keep them
    told: list[bool] = []
    flown.commands.store = lambda keeps: not told.append(keeps)  # type: ignore[func-returns-value]
    results = [command(flown, PREFLIGHT_STORAGE, n, at=1310 + n)[0].result for n in (1, 2, 3)]
    assert told == [True, False]
    assert results == [0, 0, mavlink.MAV_RESULT_UNSUPPORTED]


def test_everything_else_is_refused(flown: Pipeline) -> None:
    arm = mavlink.MAVLink_command_int_message(*OURS, 0, 400, 0, 0, 1, 0, 0, 0, 0, 0, 0)
    (ack,) = ask(flown, arm, 2000)
    assert ack.result == mavlink.MAV_RESULT_UNSUPPORTED


def test_a_flood_of_requests_is_bounded(flown: Pipeline) -> None:
    request = mavlink.MAVLink_param_request_list_message(*OURS)
    answered = sum(bool(ask(flown, request, 3000)) for _ in range(500))
    assert answered <= 10
