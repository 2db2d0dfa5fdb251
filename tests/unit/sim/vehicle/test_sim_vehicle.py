"""The simulated vehicle over memory links: what it sends unasked, what it obeys, what it refuses,
what it remembers."""

import math
from collections import Counter
from itertools import pairwise
from pathlib import Path

import pytest

from companion.logs.tlog import TlogReader
from companion.mavlink.codec import Decoder, Encoder, mavlink
from sim.vehicle.ardupilot import NAMES
from sim.vehicle.flavours import FLAVOURS
from sim.vehicle.frames import Packer, packer
from tests.bench_vehicle import Bench, Client

ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
SET_INTERVAL, GET_INTERVAL, REQUEST = 511, 510, 512


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_silent_client_gets_one_hertz_of_everything(bench: Bench) -> None:
    bench.fly(30.0)
    messages = bench.client.messages()
    counts = Counter(message.get_type() for message in messages)
    for name in NAMES.keys() - {
        "HOME_POSITION",
        "GLOBAL_POSITION_INT",
        "HIGHRES_IMU",
        "DEBUG_FLOAT_ARRAY",
        "HYGROMETER_SENSOR",
        "SIMSTATE",
    }:
        assert counts[name] == pytest.approx(30, abs=1), name
    assert counts["GLOBAL_POSITION_INT"] == pytest.approx(12, abs=1)  # from the origin at 18 s
    assert counts["HOME_POSITION"] == 3
    assert counts["HIGHRES_IMU"] == counts["DEBUG_FLOAT_ARRAY"] == 0
    assert {(message.get_srcSystem(), message.get_srcComponent()) for message in messages} == {
        (1, 1)
    }
    sequence = [message.get_seq() for message in messages]
    assert all(after == (before + 1) % 256 for before, after in pairwise(sequence))


def test_all_streams_asks_for_nothing_and_gets_the_full_rates() -> None:
    bench = Bench(all_streams=True)
    bench.fly(10.0)
    counts = Counter(message.get_type() for message in bench.client.messages())
    assert counts["RAW_IMU"] == 500
    assert counts["SCALED_PRESSURE"] == pytest.approx(200, abs=1)
    assert counts["GPS_RAW_INT"] == pytest.approx(50, abs=1)


def test_the_heartbeat_is_a_plane_s(bench: Bench) -> None:
    bench.fly(1.5)
    heartbeat = bench.client.messages("HEARTBEAT")[0]
    assert (heartbeat.type, heartbeat.autopilot) == (
        mavlink.MAV_TYPE_FIXED_WING,
        mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
    )
    assert not heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert heartbeat.system_status == mavlink.MAV_STATE_STANDBY


def test_it_is_armed_from_the_take_off_run_on() -> None:
    legs = [{"leg": "wait", "duration_s": 20}, {"leg": "take_off", "height_m": 40}]
    bench = Bench(scenario={"profile": legs})
    while not bench.flight.profile.done:
        bench.flight.tick()
    armed, landed, texts = {}, {}, []
    heartbeat, boot_ms = False, 0
    for message in bench.client.messages():
        boot_ms = getattr(message, "time_boot_ms", boot_ms)
        if message.get_type() == "HEARTBEAT":
            heartbeat = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        elif message.get_type() == "SYSTEM_TIME":  # follows it in the same tick
            armed[boot_ms] = heartbeat
        elif message.get_type() == "EXTENDED_SYS_STATE":
            landed[boot_ms] = message.landed_state
        elif message.get_type() == "STATUSTEXT":
            texts.append(message.text)
    assert all(value == (time_ms >= 20_020) for time_ms, value in armed.items())
    assert "Throttle armed" in texts
    assert "Mission: Takeoff" in texts
    assert set(landed.values()) == {1, 2}
    first_in_air = min(time_ms for time_ms, state in landed.items() if state == 2)
    assert all((state == 2) == (time_ms >= first_in_air) for time_ms, state in landed.items())


@pytest.mark.parametrize("as_int", [False, True])
def test_an_interval_is_obeyed_in_simulated_time(bench: Bench, as_int: bool) -> None:
    ack, _ = bench.answer(SET_INTERVAL, NAMES["RAW_IMU"], 40_000, as_int=as_int)
    assert (ack.command, ack.result, ack.target_system, ack.target_component) == (
        511,
        ACCEPTED,
        255,
        190,
    )
    bench.fly(10.0)
    times = [message.time_usec for message in bench.client.messages("RAW_IMU")]
    assert len(times) == pytest.approx(250, abs=1)
    assert {after - before for before, after in pairwise(times)} == {40_000}


def test_an_interval_that_is_no_multiple_of_the_samples_holds_on_average(bench: Bench) -> None:
    bench.answer(SET_INTERVAL, NAMES["RAW_IMU"], 33_333)  # ArduPilot cuts it to 33 ms
    bench.fly(10.0)
    times = [message.time_usec for message in bench.client.messages("RAW_IMU")]
    assert len(times) == pytest.approx(303, abs=2)
    assert {after - before for before, after in pairwise(times)} <= {20_000, 40_000}


def test_intervals_are_clamped_stopped_and_restored(bench: Bench) -> None:
    pressure = NAMES["SCALED_PRESSURE"]
    for asked, in_force in (
        (25_000, 25_000),
        (2e9, 60_000_000),
        (-1, -1),
        (0, 1_000_000),
        (50_000, 50_000),
    ):
        ack, _ = bench.answer(SET_INTERVAL, pressure, asked)
        assert ack.result == ACCEPTED
        ack, others = bench.answer(GET_INTERVAL, pressure)
        assert ack.result == ACCEPTED
        assert [
            (m.message_id, m.interval_us) for m in others if m.get_type() == "MESSAGE_INTERVAL"
        ] == [(pressure, in_force)]
    bench.answer(SET_INTERVAL, pressure, -1)
    bench.fly(3.0)
    assert bench.client.messages("SCALED_PRESSURE") == []


@pytest.mark.parametrize("asked", [-2.0, math.nan, math.inf, 1.0, 20_000.0, 24_999.0])
def test_an_interval_that_is_none_or_too_short_is_denied(bench: Bench, asked: float) -> None:
    ack, _ = bench.answer(SET_INTERVAL, NAMES["RAW_IMU"], asked)
    assert ack.result == DENIED


@pytest.mark.parametrize("message_id", [141, 28, 9999, math.nan])
def test_what_ardupilot_does_not_have_is_denied(bench: Bench, message_id: float) -> None:
    """ALTITUDE (141) and RAW_PRESSURE (28) as measured on ArduPlane 4.7."""
    assert bench.answer(SET_INTERVAL, message_id, 100_000)[0].result == DENIED
    assert bench.answer(REQUEST, message_id)[0].result == FAILED


def test_an_unknown_interval_is_not_available(bench: Bench) -> None:
    ack, others = bench.answer(GET_INTERVAL, 141)
    assert ack.result == FAILED
    assert [m.interval_us for m in others if m.get_type() == "MESSAGE_INTERVAL"] == [0]


def test_a_requested_message_comes_at_once(bench: Bench) -> None:
    assert bench.answer(REQUEST, NAMES["HOME_POSITION"])[0].result == FAILED  # there is no fix yet
    bench.fly(20.0)
    ack, others = bench.answer(REQUEST, NAMES["HOME_POSITION"])
    assert ack.result == ACCEPTED
    homes = [message for message in others if message.get_type() == "HOME_POSITION"]
    assert len(homes) == 1
    assert homes[0].altitude * 1e-3 == pytest.approx(301.3, abs=25.0)  # one fix: 4.2 m, one sigma


@pytest.mark.parametrize("command", [400, 176, 22, 31010])
def test_every_other_command_is_unsupported(bench: Bench, command: int) -> None:
    assert bench.answer(command, 1.0)[0].result == UNSUPPORTED


def test_a_command_for_somebody_else_is_none_of_its_business(bench: Bench) -> None:
    bench.client.command(SET_INTERVAL, NAMES["RAW_IMU"], 20_000, target=(1, 191))
    bench.client.command(SET_INTERVAL, NAMES["RAW_IMU"], 20_000, target=(2, 1))
    bench.fly(2.0)
    messages = bench.client.messages()
    assert not [message for message in messages if message.get_type() == "COMMAND_ACK"]
    assert sum(message.get_type() == "RAW_IMU" for message in messages) <= 3


def test_rates_are_a_link_s_own() -> None:
    bench = Bench(clients=2)
    bench.answer(SET_INTERVAL, NAMES["ATTITUDE"], 25_000)
    for client in bench.clients:
        client.messages()
    bench.fly(10.0)
    counts = [len(client.messages("ATTITUDE")) for client in bench.clients]
    assert counts[0] == pytest.approx(400, abs=1)
    assert counts[1] == pytest.approx(10, abs=1)


def test_request_data_stream_sets_a_group(bench: Bench) -> None:
    bench.client.send(
        mavlink.MAVLink_request_data_stream_message(
            1, 1, mavlink.MAV_DATA_STREAM_RAW_SENSORS, 10, 1
        )
    )
    bench.client.send(
        mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_EXTRA1, 0, 0)
    )
    bench.fly(0.5)
    bench.client.messages()
    bench.fly(10.0)
    counts = Counter(message.get_type() for message in bench.client.messages())
    assert counts["RAW_IMU"] == 100
    assert counts["SCALED_PRESSURE"] == 100
    assert counts["ATTITUDE"] == 0
    assert counts["HEARTBEAT"] == 10


def test_timesync_is_answered_with_boot_nanoseconds(bench: Bench) -> None:
    bench.fly(5.0)
    bench.client.send(mavlink.MAVLink_timesync_message(0, 123_456_789))
    bench.client.send(mavlink.MAVLink_timesync_message(77, 5))  # somebody's answer: not a question
    bench.fly(0.01)
    answers = [(message.tc1, message.ts1) for message in bench.client.messages("TIMESYNC")]
    assert answers == [(5_010_000_000, 123_456_789)]


def test_system_time_is_unknown_before_the_first_fix(bench: Bench) -> None:
    bench.fly(12.0)
    for message in bench.client.messages("SYSTEM_TIME"):
        if message.time_boot_ms < 8000:
            assert message.time_unix_usec == 0
        elif message.time_boot_ms > 8200:
            assert message.time_unix_usec // 1000 - message.time_boot_ms == 1_767_225_600_000


def test_the_receiver_is_blind_at_first_and_honest_later() -> None:
    bench = Bench(all_streams=True)
    bench.fly(12.0)
    fixes = bench.client.messages("GPS_RAW_INT")
    blind = [fix for fix in fixes if fix.fix_type < 3]
    seeing = [fix for fix in fixes if fix.fix_type >= 3]
    assert {(fix.fix_type, fix.eph, fix.epv, fix.alt, fix.time_usec) for fix in blind} == {
        (1, 65535, 65535, 0, 0)
    }
    assert seeing[0].time_usec == 8_110_000
    for fix in seeing:
        assert fix.alt_ellipsoid - fix.alt == pytest.approx(47_600, abs=1)
        assert fix.v_acc == 4243
        assert fix.lat * 1e-7 == pytest.approx(47.0, abs=2e-4)


def test_the_imu_is_quantised_as_ardupilot_does() -> None:
    quiet = {
        "accel_noise_mps2_rthz": 0,
        "accel_bias_sd_mps2": 0,
        "gyro_noise_radps_rthz": 0,
        "gyro_bias_sd_radps": 0,
    }
    bench = Bench(all_streams=True, scenario={"sensors": {"imu": quiet}})
    bench.fly(5.0)
    samples = bench.client.messages("RAW_IMU")
    assert {sample.zacc for sample in samples} <= {-1000, -999, -998}
    assert {sample.xacc for sample in samples} <= {41, 42, 43}  # it stands 2.4 degrees nose up
    assert {sample.xgyro for sample in samples} == {0}
    assert 400 < math.hypot(samples[0].xmag, samples[0].ymag, samples[0].zmag) < 520
    assert all(sample.temperature == 4000 for sample in samples)


def test_what_the_companion_sends_is_heard_and_recorded(tmp_path: Path) -> None:
    path = tmp_path / "log.tlog"
    bench = Bench(tlog=path, scenario={"profile": [{"leg": "wait", "duration_s": 4}]})
    companion = Client(bench.client.link, 1, 191)
    bench.fly(1.0)
    companion.send(
        mavlink.MAVLink_altitude_message(990_000, 1.0, 301.5, 0.0, 0.0, math.nan, math.nan)
    )
    companion.send(mavlink.MAVLink_statustext_message(6, b"Kollsman: OK", 0, 0))
    companion.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    bench.client.link.send(b"\xfdnoise")
    summary = bench.flight.run()
    heard = summary.heard
    assert heard.counts == {
        (1, 191, "ALTITUDE"): 1,
        (1, 191, "STATUSTEXT"): 1,
        (1, 191, "HEARTBEAT"): 1,
    }
    assert heard.altitude.altitude_amsl == 301.5
    assert heard.altitude_us == 1_010_000
    assert list(heard.texts) == [(1_010_000, "Kollsman: OK")]
    decoder = Decoder()
    logged = [decoder.decode(decoder.feed(packet.data)[0]) for packet in TlogReader(path)]
    assert sum(message.get_srcComponent() == 191 for message in logged if message) == 3
    assert summary.received_bytes > 60


def test_the_packer_agrees_with_pymavlink() -> None:
    encoder = Encoder(1, 1)
    messages = [
        mavlink.MAVLink_statustext_message(6, b"Throttle armed", 0, 0),
        mavlink.MAVLink_command_ack_message(511, 2, 0, 0, 255, 190),
        mavlink.MAVLink_message_interval_message(141, 0),
        mavlink.MAVLink_timesync_message(1, -2),
        mavlink.MAVLink_heartbeat_message(1, 3, 81, 0, 3, 3),
        mavlink.MAVLink_param_value_message(
            b"SENS_BARO_QNH", 1013.25, 9, 29, 65535
        ),  # an array that the wire moves
        mavlink.MAVLink_autopilot_version_message(
            8194, 1, 2, 3, 4, [1] * 8, [2] * 8, [3] * 8, 5, 6, 7, [0] * 17 + [9]
        ),
        mavlink.MAVLink_mission_count_message(255, 190, 0, 2),
        mavlink.MAVLink_extended_sys_state_message(0, 0),  # a payload of zeros keeps one byte
    ]
    for sequence, message in enumerate(messages):
        pack = Packer(message.get_type())
        fields = {name: getattr(message, name) for name in message.get_fieldnames()}
        assert pack.frame(pack.named(**fields), sequence) == encoder.encode(message)


def test_the_packer_refuses_a_field_that_is_none() -> None:
    with pytest.raises(TypeError, match="HEARTBEAT has no field mode"):
        packer("HEARTBEAT").named(mode=3)


@pytest.mark.parametrize("name", FLAVOURS)
def test_every_message_has_its_rates(name: str) -> None:
    for row in FLAVOURS[name].messages.values():
        assert 0 <= row.default_hz <= row.full_hz <= 50
