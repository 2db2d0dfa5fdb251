"""The vehicle as ArduPilot, as PX4, and as neither: what it streams, how it answers, its
parameters, several links."""

import math
from collections import Counter
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import pytest

from companion.clock import ManualClock
from companion.errors import ConfigError
from companion.feedback.knobs import parameter_value
from companion.logs.tlog import TlogReader
from companion.mavlink.codec import Decoder, mavlink
from companion.pipeline import Pipeline
from companion.samples import Packet
from companion.settings import CompanionSettings
from sim.vehicle.ardupilot import NAMES
from sim.vehicle.flavours import FLAVOURS
from tests.bench_vehicle import Bench, Client

ACCEPTED, DENIED, FAILED = 0, 2, 4
GET_INTERVAL, SET_INTERVAL, REQUEST, REQUEST_CAPABILITIES = 510, 511, 512, 520
GET_HOME = 410
QUIET = {
    "accel_noise_mps2_rthz": 0,
    "accel_bias_sd_mps2": 0,
    "gyro_noise_radps_rthz": 0,
    "gyro_bias_sd_radps": 0,
}
ALL = pytest.mark.parametrize("flavour", list(FLAVOURS))


def as_(flavour: str, **options: Any) -> Bench:
    return Bench(flavour=flavour, **options)


def after(bench: Bench, message: Any, name: str, duration_s: float = 0.01) -> list[Any]:
    """The messages called `name` that follow on one sent."""
    bench.client.messages()
    bench.client.send(message)
    bench.fly(duration_s)
    return bench.client.messages(name)


def read(name: str, index: int = -1, target: tuple[int, int] = (1, 1)) -> Any:
    return mavlink.MAVLink_param_request_read_message(*target, name.encode(), index)


def write(name: str, value: float) -> Any:
    return mavlink.MAVLink_param_set_message(
        1, 1, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32
    )


# Streams


def test_a_silent_link_of_px4_carries_the_streams_of_mode_onboard() -> None:
    bench = as_("px4")
    bench.fly(30.0)
    bench.client.messages()
    bench.fly(10.0)
    counts = Counter(message.get_type() for message in bench.client.messages())
    assert counts == {
        "HEARTBEAT": 10, "SYSTEM_TIME": 10, "SCALED_PRESSURE": 10, "ATTITUDE": 500,
        "HIGHRES_IMU": 500, "GPS_RAW_INT": 50, "GLOBAL_POSITION_INT": 500, "ALTITUDE": 100,
        "EXTENDED_SYS_STATE": 50, "HOME_POSITION": 5, "SYS_STATUS": 50, "VFR_HUD": 100,
    }  # fmt: skip


def test_px4_sends_scaled_imu_and_truth_when_asked_and_never_raw_imu() -> None:
    bench = as_("px4")
    for message_id in (mavlink.MAVLINK_MSG_ID_SCALED_IMU, mavlink.MAVLINK_MSG_ID_SIM_STATE):
        assert bench.answer(SET_INTERVAL, message_id, 40_000)[0].result == ACCEPTED
    assert bench.answer(SET_INTERVAL, mavlink.MAVLINK_MSG_ID_RAW_IMU, 40_000)[0].result == FAILED
    assert bench.answer(REQUEST, mavlink.MAVLINK_MSG_ID_RAW_IMU)[0].result == DENIED
    ack, others = bench.answer(GET_INTERVAL, mavlink.MAVLINK_MSG_ID_RAW_IMU)
    assert ack.result == ACCEPTED
    assert [
        message.interval_us for message in others if message.get_type() == "MESSAGE_INTERVAL"
    ] == [0]
    bench.client.messages()
    bench.fly(4.0)
    counts = Counter(message.get_type() for message in bench.client.messages())
    assert (counts["SCALED_IMU"], counts["SIM_STATE"], counts["RAW_IMU"]) == (100, 100, 0)


def test_px4_sends_a_pressure_once_with_its_own_time() -> None:
    bench = as_("px4")
    bench.answer(SET_INTERVAL, mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE, 20_000)
    bench.fly(5.0)
    samples = bench.client.messages("SCALED_PRESSURE")
    times = [sample.time_boot_ms for sample in samples]
    assert len(times) == pytest.approx(
        100, abs=1
    )  # the barometer's 20 Hz, not the 50 Hz that were asked for
    assert {later - earlier for earlier, later in pairwise(times)} == {50}


def test_highres_imu_is_in_si_and_marks_what_is_new() -> None:
    bench = as_("px4", scenario={"sensors": {"imu": QUIET}})
    bench.fly(10.0)
    samples = bench.client.messages("HIGHRES_IMU")
    assert {later.time_usec - earlier.time_usec for earlier, later in pairwise(samples)} == {20_000}
    for sample in samples:
        assert math.hypot(sample.xacc, sample.yacc, sample.zacc) == pytest.approx(9.807, abs=0.02)
        assert math.hypot(sample.xmag, sample.ymag, sample.zmag) == pytest.approx(0.476, abs=0.01)
        assert sample.abs_pressure == pytest.approx(977.7, abs=3.0)
    flags = Counter(sample.fields_updated for sample in samples[50:])
    assert flags.keys() == {0x1FF, 0x1FFF}
    assert flags[0x1FFF] == pytest.approx(
        2 / 5 * flags.total(), abs=2
    )  # 20 pressures in 50 samples


def test_px4_s_fix_has_dilutions_accuracies_and_no_time_before_utc() -> None:
    bench = as_("px4")
    bench.fly(12.0)
    fixes = bench.client.messages("GPS_RAW_INT")
    blind = [fix for fix in fixes if fix.fix_type < 3]
    assert {(fix.time_usec, fix.eph, fix.epv, fix.satellites_visible) for fix in blind} == {
        (0, 9999, 9999, 0)
    }
    for fix in fixes[len(blind) :]:
        assert (fix.eph, fix.epv, fix.v_acc) == (80, 130, 4242)
        assert fix.alt_ellipsoid - fix.alt == pytest.approx(47_600, abs=1)
    times = [fix.time_usec for fix in fixes[len(blind) :]]
    assert times[0] == 8_110_000
    assert {later - earlier for earlier, later in pairwise(times)} == {200_000}


def test_px4_s_altitude_knows_the_barometer_first_and_follows_its_qnh() -> None:
    bench = as_("px4")
    bench.fly(5.0)
    early = bench.client.messages("ALTITUDE")[-1]
    assert early.altitude_amsl == early.altitude_monotonic == pytest.approx(300.0, abs=15.0)
    assert all(
        math.isnan(value)
        for value in (early.altitude_local, early.altitude_relative, early.bottom_clearance)
    )
    bench.fly(25.0)
    later = bench.client.messages("ALTITUDE")[-1]
    assert later.altitude_amsl != later.altitude_monotonic
    assert abs(later.altitude_local) < 3.0
    assert abs(later.altitude_relative) < 3.0
    bench.client.send(write("SENS_BARO_QNH", 1003.25))
    bench.fly(5.0)
    stepped = bench.client.messages("ALTITUDE")[-1]
    assert stepped.altitude_monotonic - later.altitude_monotonic == pytest.approx(
        -82.0, abs=4.0
    )  # 8.2 m/hPa
    # EKF2_HGT_REF is the barometer: the estimate follows what SENS_BARO_QNH makes of it
    assert stepped.altitude_amsl - later.altitude_amsl == pytest.approx(-82.0, abs=4.0)


def test_heartbeats_tell_whose_autopilot_it_is() -> None:
    legs = [{"leg": "wait", "duration_s": 2}, {"leg": "take_off", "height_m": 40}]
    seen = {}
    for flavour in FLAVOURS:
        bench = as_(flavour, scenario={"profile": legs})
        bench.fly(8.0)
        beats = bench.client.messages("HEARTBEAT")
        seen[flavour] = [
            (beat.autopilot, beat.base_mode, beat.custom_mode) for beat in (beats[0], beats[-1])
        ]
        kind = mavlink.MAV_TYPE_QUADROTOR if flavour == "copter" else mavlink.MAV_TYPE_FIXED_WING
        assert {beat.type for beat in beats} == {kind}
    assert seen["px4"] == [
        (12, 29, 0x03040000),
        (12, 157, 0x04040000),
    ]  # AUTO.LOITER; armed, AUTO.MISSION
    assert seen["ardupilot"] == [(3, 81, 0), (3, 217, 10)]
    assert seen["copter"] == [(3, 81, 0), (3, 217, 3)]
    assert [entry[0] for entry in seen["generic"]] == [0, 0]
    assert [entry[1] & 128 for entry in seen["generic"]] == [0, 128]
    assert [entry[1] & 1 for entry in seen["generic"]] == [0, 0]  # it has no custom modes


def test_a_plane_grants_forty_hertz_and_a_copter_is_silent_until_asked() -> None:
    """Plane's loop of 50 Hz sends in 0.8 of its loops; Copter's default rates are zero."""
    for flavour, refused_us in (("ardupilot", 20_000), ("copter", 3_000)):
        bench = as_(flavour)
        bench.fly(5.0)
        names = {message.get_type() for message in bench.client.messages()}
        assert ("RAW_IMU" in names) == (flavour == "ardupilot")
        assert "HEARTBEAT" in names
        raw_imu = NAMES["RAW_IMU"]
        assert bench.answer(SET_INTERVAL, raw_imu, refused_us)[0].result == DENIED
        assert bench.answer(SET_INTERVAL, raw_imu, 25_000)[0].result == ACCEPTED


def test_a_generic_autopilot_s_raw_imu_is_in_milli_g() -> None:
    bench = as_("generic", scenario={"sensors": {"imu": QUIET}})
    bench.fly(5.0)
    assert {sample.zacc for sample in bench.client.messages("RAW_IMU")} <= {-1000, -999, -998}


def test_ardupilot_has_highres_imu_for_who_asks() -> None:
    bench = as_("ardupilot")
    assert (
        bench.answer(SET_INTERVAL, mavlink.MAVLINK_MSG_ID_HIGHRES_IMU, 100_000)[0].result
        == ACCEPTED
    )
    bench.fly(2.0)
    samples = bench.client.messages("HIGHRES_IMU")
    assert len(samples) == pytest.approx(20, abs=1)
    assert (
        400 < math.hypot(samples[0].xmag, samples[0].ymag, samples[0].zmag) < 520
    )  # milligauss: a known bug
    assert abs(samples[0].diff_pressure) < 0.5


def test_ardupilot_has_room_for_ten_intervals() -> None:
    bench = as_("ardupilot")
    streamed = list(FLAVOURS["ardupilot"].messages)
    messages = [*streamed[:10], mavlink.MAVLINK_MSG_ID_HIGHRES_IMU]  # which is off
    for message_id in streamed[10:]:
        bench.answer(SET_INTERVAL, message_id, -1)
    for step, message_id in enumerate(messages):
        assert bench.answer(SET_INTERVAL, message_id, 100_000 + 10_000 * step)[0].result == ACCEPTED
    _, others = bench.answer(GET_INTERVAL, messages[-1])
    assert [m.interval_us for m in others if m.get_type() == "MESSAGE_INTERVAL"] == [190_000]


def test_px4_knows_no_stream_groups() -> None:
    bench = as_("px4")
    bench.client.send(
        mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_ALL, 0, 0)
    )
    bench.fly(2.0)
    assert len(bench.client.messages("HIGHRES_IMU")) == pytest.approx(100, abs=3)


def test_rates_of_a_scenario_are_of_its_flavour() -> None:
    Bench(scenario={"flavour": "px4", "streams_hz": {"SCALED_IMU": 10}})
    with pytest.raises(ConfigError, match=r"'SCALED_IMU' is not streamed: use .*ardupilot"):
        Bench(scenario={"streams_hz": {"SCALED_IMU": 10}})
    with pytest.raises(ConfigError, match="flavour"):
        Bench(scenario={"flavour": "betaflight"})


# Who it is, and what time it has


@ALL
def test_it_tells_its_version_by_either_command(flavour: str) -> None:
    bench = as_(flavour)
    versions = []
    for command, parameter in (
        (REQUEST, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION),
        (REQUEST_CAPABILITIES, 1),
    ):
        ack, others = bench.answer(command, parameter)
        assert ack.result == ACCEPTED
        versions += [message for message in others if message.get_type() == "AUTOPILOT_VERSION"]
    assert len(versions) == 2
    for version in versions:
        assert version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        assert (
            not version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_FTP
        )  # what it has not it does not promise
        assert version.flight_sw_version >> 24 == FLAVOURS[flavour].software[0]
        assert bytes(version.flight_custom_version) == b"kollsman"


@pytest.mark.parametrize(("flavour", "period_s"), [("ardupilot", 10.0), ("px4", 0.1)])
def test_it_asks_for_the_time_where_somebody_is(flavour: str, period_s: float) -> None:
    bench = as_(flavour, clients=2)
    bench.client.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    bench.fly(40.0)
    asked = bench.client.messages("TIMESYNC")
    assert len(asked) == pytest.approx(40.0 / period_s, abs=1)
    assert {message.tc1 for message in asked} == {0}
    assert (asked[0].ts1 - asked[0].ts1 // 1000 * 1000) == (1 if flavour == "ardupilot" else 0)
    assert bench.clients[1].messages("TIMESYNC") == []


@ALL
def test_it_has_no_mission_and_takes_none(flavour: str) -> None:
    bench = as_(flavour)
    counts = after(bench, mavlink.MAVLink_mission_request_list_message(1, 1, 2), "MISSION_COUNT")
    assert [(m.count, m.mission_type, m.target_system, m.target_component) for m in counts] == [
        (0, 2, 255, 190)
    ]
    acks = after(bench, mavlink.MAVLink_mission_count_message(1, 1, 3, 0), "MISSION_ACK")
    assert [(m.type, m.target_system) for m in acks] == [(mavlink.MAV_MISSION_UNSUPPORTED, 255)]
    assert (
        after(bench, mavlink.MAVLink_mission_request_list_message(1, 191, 0), "MISSION_COUNT") == []
    )


@ALL
def test_a_ping_comes_back_except_from_ardupilot(flavour: str) -> None:
    bench = as_(flavour)
    pings = after(bench, mavlink.MAVLink_ping_message(123, 7, 0, 0), "PING")
    answer = [] if FLAVOURS[flavour].ardupilot else [(123, 7, 255, 190)]
    assert [
        (ping.time_usec, ping.seq, ping.target_system, ping.target_component) for ping in pings
    ] == answer
    assert (
        after(bench, mavlink.MAVLink_ping_message(123, 7, 255, 190), "PING") == []
    )  # somebody's answer


@pytest.mark.parametrize(
    ("flavour", "asked_hz", "new_hz"), [("ardupilot", 20, 10), ("px4", 20, 20), ("px4", 50, 20)]
)
def test_the_barometer_is_as_old_as_the_real_one_s(
    flavour: str, asked_hz: int, new_hz: int
) -> None:
    """ArduPilot takes a reading at 10 Hz and sends it again under fresh stamps; PX4 sends a reading
    once."""
    bench = as_(flavour)
    bench.answer(SET_INTERVAL, mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE, 1e6 / asked_hz)
    bench.fly(1.0)
    bench.client.messages()
    bench.fly(10.0)
    samples = bench.client.messages("SCALED_PRESSURE")
    assert len({sample.time_boot_ms for sample in samples}) == len(samples)
    repeats = flavour == "ardupilot"
    assert len(samples) == pytest.approx(10 * (asked_hz if repeats else new_hz), abs=2)
    readings = groupby(sample.press_abs for sample in samples)
    assert len(list(readings)) == pytest.approx(10 * new_hz, abs=3)  # two may be alike


def test_a_scenario_s_barometer_is_as_quick_as_it_says() -> None:
    bench = as_("ardupilot", all_streams=True, scenario={"sensors": {"barometer": {"rate_hz": 20}}})
    bench.fly(10.0)
    readings = groupby(sample.press_abs for sample in bench.client.messages("SCALED_PRESSURE"))
    assert len(list(readings)) == pytest.approx(200, abs=3)


@ALL
def test_a_fix_is_as_old_as_the_real_ones(flavour: str) -> None:
    bench = as_(
        flavour,
        all_streams=True,
        scenario={"sensors": {"gnss": {"latency_s": 0.05, "latency_jitter_s": 0.06}}},
    )
    ages_s = []
    for _ in range(3000):
        bench.fly(0.01)
        fix = bench.flight.vehicle.state.fix
        for _ in bench.client.messages("GPS_RAW_INT"):
            assert fix is not None
            ages_s.append((bench.flight.time_us - fix.measured_us) * 1e-6)
    assert 0.05 <= min(ages_s) < 0.07
    assert 0.12 < max(ages_s) < 0.30
    assert len({round(age, 2) for age in ages_s}) > 5


@ALL
def test_a_ground_station_sees_its_sensors_and_its_instruments(flavour: str) -> None:
    legs = [{"leg": "wait", "duration_s": 20}, {"leg": "take_off", "height_m": 60}]
    bench = as_(flavour, scenario={"profile": legs, "runway": {"heading_deg": 250}})
    for name in ("SYS_STATUS", "VFR_HUD"):  # a Copter sends them to who asks
        bench.answer(SET_INTERVAL, NAMES[name], 1_000_000)
    gps, ahrs = mavlink.MAV_SYS_STATUS_SENSOR_GPS, mavlink.MAV_SYS_STATUS_AHRS
    for until_s, healthy in (
        (6.0, 0),
        (17.0, gps),
        (19.9, gps | ahrs),
    ):  # the fix at 8 s, the origin at 18
        bench.fly(until_s - bench.flight.time_us * 1e-6)
        status = bench.client.messages("SYS_STATUS")[-1]
        assert status.onboard_control_sensors_health & (gps | ahrs) == healthy
        assert status.onboard_control_sensors_enabled & (gps | ahrs) == gps | ahrs
        assert (status.voltage_battery, status.current_battery, status.battery_remaining) == (
            65535,
            -1,
            -1,
        )
    while not bench.flight.profile.done:
        bench.flight.tick()
    truth, instruments = bench.flight.vehicle.state.truth, bench.client.messages("VFR_HUD")[-1]
    assert truth is not None
    assert instruments.airspeed == pytest.approx(truth.airspeed_mps, abs=2.0)
    assert instruments.groundspeed == pytest.approx(
        math.hypot(truth.north_mps, truth.east_mps), abs=2.0
    )
    assert instruments.alt == pytest.approx(truth.altitude_amsl_m, abs=20.0)
    assert instruments.climb == pytest.approx(truth.climb_mps, abs=2.0)
    assert instruments.heading == pytest.approx(250, abs=6)
    assert instruments.throttle == 100


@ALL
def test_the_home_is_told_by_the_older_command_too(flavour: str) -> None:
    bench = as_(flavour)
    assert (
        bench.answer(GET_HOME)[0].result == FLAVOURS[flavour].unknown_request
    )  # there is none yet
    bench.fly(20.0)
    ack, others = bench.answer(GET_HOME)
    assert ack.result == ACCEPTED
    assert [message.get_type() for message in others].count("HOME_POSITION") == 1


@ALL
def test_the_truth_of_the_air_goes_to_logs_and_to_who_asks(flavour: str, tmp_path: Path) -> None:
    path = tmp_path / "log.tlog"
    weather = {
        "pressure": [{"time_s": 0, "sea_level_hpa": 1000}],
        "temperature": [{"time_s": 0, "offset_k": 10}],
        "wind": {"speed_mps": 5, "from_deg": 180},
    }  # fmt: skip
    bench = as_(flavour, tlog=path, scenario={"weather": weather})
    bench.fly(3.0)
    assert bench.client.messages("DEBUG_FLOAT_ARRAY") == []
    ack, others = bench.answer(REQUEST, mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY)
    assert ack.result == ACCEPTED
    (told,) = [message for message in others if message.get_type() == "DEBUG_FLOAT_ARRAY"]
    truth = bench.flight.vehicle.state.truth
    assert truth is not None
    assert (told.name, told.time_usec) == ("trueAir", truth.time_us)
    qnh_hpa, sea_level_hpa, offset_k, pressure_altitude_m, *wind_mps = told.data[:7]
    assert sea_level_hpa == pytest.approx(1000.0, abs=1e-3)
    assert qnh_hpa == pytest.approx(1001.2, abs=0.1)  # 300 m of air 3.5 % lighter than standard
    assert offset_k == pytest.approx(10.0, abs=0.01)
    assert pressure_altitude_m == pytest.approx(
        truth.altitude_amsl_m + 8.4 * (1013.25 - 1001.2), abs=2.0
    )
    assert wind_mps == pytest.approx([5.0, 0.0, 0.0], abs=1e-6)
    bench.flight.stop()
    bench.flight.run()
    decoder = Decoder()
    logged = [
        frame.message_id for packet in TlogReader(path) for frame in decoder.feed(packet.data)
    ]
    assert logged.count(mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY) == 4


# Parameters


@ALL
def test_all_parameters_are_listed(flavour: str) -> None:
    bench = as_(flavour)
    values = after(bench, mavlink.MAVLink_param_request_list_message(1, 1), "PARAM_VALUE", 1.0)
    table = FLAVOURS[flavour].parameters
    assert [value.param_index for value in values] == list(range(len(table)))
    assert [value.param_id for value in values] == [row.name for row in table]
    assert [value.param_type for value in values] == [row.kind for row in table]
    assert {value.param_count for value in values} == {len(table)}
    held = bench.flight.vehicle.parameters.values
    read_as = {"px4": mavlink.MAV_AUTOPILOT_PX4}.get(flavour, mavlink.MAV_AUTOPILOT_GENERIC)
    assert all(
        parameter_value(value, read_as) == pytest.approx(held[value.param_id], rel=1e-6)
        for value in values
    )
    assert len(table) == len(held)
    assert all(len(row.name) <= 16 for row in table)


def test_streams_of_ardupilot_slow_down_while_it_lists() -> None:
    bench = as_("ardupilot")
    bench.answer(SET_INTERVAL, mavlink.MAVLINK_MSG_ID_ATTITUDE, 25_000)
    bench.fly(1.0)
    during = after(bench, mavlink.MAVLink_param_request_list_message(1, 1), "ATTITUDE", 0.34)
    assert len(during) == pytest.approx(13.6 / 4, abs=1)
    bench.fly(1.0)
    bench.client.messages()
    bench.fly(1.0)
    assert len(bench.client.messages("ATTITUDE")) == pytest.approx(40, abs=1)


@ALL
def test_one_parameter_is_read_by_name_or_index(flavour: str) -> None:
    bench = as_(flavour)
    name = FLAVOURS[flavour].parameters[2].name
    by_name = after(bench, read(name), "PARAM_VALUE")
    by_index = after(bench, read("", 2), "PARAM_VALUE")
    assert [value.param_id for value in by_name + by_index] == [name, name]
    assert by_index[0].param_index == 2
    assert by_name[0].param_index == (65535 if FLAVOURS[flavour].ardupilot else 2)
    for question in (
        read("NONE_SUCH"),
        read("", 999),
        read(name, target=(1, 191)),
        read(name, target=(7, 1)),
    ):
        assert after(bench, question, "PARAM_VALUE") == []


@ALL
def test_a_set_is_held_and_told_to_every_link_that_speaks(flavour: str) -> None:
    bench = as_(flavour, clients=3)
    name = FLAVOURS[flavour].parameters[-1].name
    bench.clients[1].send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    bench.fly(0.01)
    bench.client.send(write(name, 42.0))
    bench.fly(0.01)
    told = [
        [value.param_value for value in client.messages("PARAM_VALUE")] for client in bench.clients
    ]
    assert told == [[42.0], [42.0], []]
    assert [value.param_value for value in after(bench, read(name), "PARAM_VALUE")] == [42.0]
    assert after(bench, write("NONE_SUCH", 1.0), "PARAM_VALUE") == []


def test_an_integer_of_ardupilot_loses_its_fraction_and_one_of_px4_needs_its_type() -> None:
    bench = as_("ardupilot")
    assert [v.param_value for v in after(bench, write("EK3_SRC1_POSZ", 2.9), "PARAM_VALUE")] == [2]
    bench = as_("px4")
    (refused,) = after(bench, write("EKF2_HGT_REF", 1.0), "PARAM_VALUE")
    assert parameter_value(refused, mavlink.MAV_AUTOPILOT_PX4) == 0.0
    as_integer = write("EKF2_HGT_REF", math.ldexp(1.0, -149))
    as_integer.param_type = mavlink.MAV_PARAM_TYPE_INT32
    (taken,) = after(bench, as_integer, "PARAM_VALUE")
    assert parameter_value(taken, mavlink.MAV_AUTOPILOT_PX4) == 1.0


def test_a_set_that_is_refused_is_answered_with_the_old_value() -> None:
    bench = as_("ardupilot")
    bench.fly(1.0)
    bench.client.messages()
    bench.client.send(write("BARO1_GND_PRESS", 1.0))
    bench.fly(0.01)
    messages = bench.client.messages()
    values = [message.param_value for message in messages if message.get_type() == "PARAM_VALUE"]
    assert values == [pytest.approx(97_770, abs=300)]
    texts = [message.text for message in messages if message.get_type() == "STATUSTEXT"]
    assert texts == ["Param write denied (BARO1_GND_PRESS)"]
    assert (
        after(bench, write("WP_RADIUS", math.nan), "PARAM_VALUE") == []
    )  # ArduPilot does not even answer
    other = as_("px4")
    assert [v.param_value for v in after(other, write("NAV_ACC_RAD", math.nan), "PARAM_VALUE")] == [
        10.0
    ]


# Several links


class Two:
    """A companion on one link, a ground station on another, and a third that nobody has spoken
    on."""

    def __init__(self, flavour: str = "ardupilot", tlog: Path | None = None) -> None:
        self.bench = as_(flavour, clients=3, tlog=tlog)
        self.companion = Client(self.bench.clients[0].link, 1, 191)
        self.ground = Client(self.bench.clients[1].link, 255, 190)
        self.silent = self.bench.clients[2]
        self.companion.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
        self.ground.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        self.bench.fly(0.05)
        self.drain()

    def drain(self) -> None:
        for client in (self.companion, self.ground, self.silent):
            client.messages()

    def foreign(self, client: Client) -> list[Any]:
        return [message for message in client.messages() if message.get_srcComponent() != 1]


@ALL
def test_what_the_companion_says_goes_to_the_ground_station_and_to_nobody_silent(
    flavour: str,
) -> None:
    two = Two(flavour)
    said = [
        mavlink.MAVLink_altitude_message(1, 1.0, 301.5, 0.0, 0.0, math.nan, math.nan),
        mavlink.MAVLink_debug_message(1, 0, 1.0),
        mavlink.MAVLink_named_value_float_message(1, b"sd_m", 1.0),
        mavlink.MAVLink_debug_float_array_message(1, b"state", 0, [0.5] * 58),
        mavlink.MAVLink_statustext_message(6, b"Kollsman: OK", 0, 0),
        mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3),
    ]
    for message in said:
        two.companion.send(message)
    two.bench.fly(0.02)
    passed = two.foreign(two.ground)
    assert [message.get_msgbuf() for message in passed] == [
        message.get_msgbuf() for message in said
    ]
    assert two.foreign(two.companion) == []  # no echo
    assert two.foreign(two.silent) == []
    assert (
        sum(port.forwarded for port in two.bench.flight.vehicle.ports) == len(said) + 1
    )  # and a first heartbeat


def test_a_command_for_the_companion_is_routed_to_it_and_its_answer_back() -> None:
    two = Two()
    two.ground.command(REQUEST, 148, target=(1, 191))
    two.bench.fly(0.02)
    routed = two.foreign(two.companion)
    assert [(message.get_type(), message.target_component) for message in routed] == [
        ("COMMAND_LONG", 191)
    ]
    assert two.ground.messages("COMMAND_ACK") == []  # the vehicle does not answer for it
    two.companion.send(mavlink.MAVLink_command_ack_message(REQUEST, 3, 0, 0, 255, 190))
    two.bench.fly(0.02)
    assert [message.get_srcComponent() for message in two.ground.messages("COMMAND_ACK")] == [191]
    assert two.foreign(two.silent) == []


def test_what_is_for_the_vehicle_alone_or_for_nobody_known_goes_nowhere() -> None:
    two = Two()
    two.ground.command(SET_INTERVAL, 30, 100_000, target=(1, 1))
    two.ground.command(SET_INTERVAL, 30, 100_000, target=(9, 1))
    two.ground.send(mavlink.MAVLink_radio_status_message(1, 1, 1, 1, 1, 1, 1))
    Client(two.bench.clients[1].link, 1, 1).send(
        mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3)
    )  # a forger
    two.bench.fly(0.02)
    assert two.foreign(two.companion) == []
    assert [
        message for message in two.companion.messages() if message.get_type() == "COMMAND_ACK"
    ] == []


def test_a_question_to_every_component_reaches_the_vehicle_and_the_companion() -> None:
    two = Two()
    two.ground.send(mavlink.MAVLink_param_request_list_message(1, 0))
    two.bench.fly(0.05)
    assert two.foreign(two.companion)[0].get_type() == "PARAM_REQUEST_LIST"
    assert two.ground.messages("PARAM_VALUE")


def test_a_heartbeat_does_not_go_where_its_sender_is_heard() -> None:
    two = Two()
    again = Client(two.bench.clients[1].link, 1, 191)  # the companion is on the second link as well
    again.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    two.bench.fly(0.02)
    two.drain()
    two.companion.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    two.bench.fly(0.02)
    assert two.foreign(two.ground) == []


def test_the_log_holds_a_forwarded_message_once(tmp_path: Path) -> None:
    path = tmp_path / "log.tlog"
    two = Two(tlog=path)
    two.companion.send(mavlink.MAVLink_statustext_message(6, b"Kollsman: OK", 0, 0))
    two.bench.fly(0.02)
    two.bench.flight.stop()
    two.bench.flight.run()
    decoder = Decoder(datagrams=True)
    frames = [frame for packet in TlogReader(path) for frame in decoder.feed(packet.data)]
    assert sum(frame.component_id == 191 and frame.message_id == 253 for frame in frames) == 1


# The companion with each of them


@ALL
def test_the_companion_estimates_with_each_and_is_silent_where_there_is_altitude(
    flavour: str,
) -> None:
    bench = as_(flavour, all_streams=True)
    clock = ManualClock()
    pipeline = Pipeline(CompanionSettings(), datagrams=False)
    sent: Counter[int] = Counter()
    decoder = Decoder()
    for _ in range(3000):
        bench.fly(0.02)
        while data := bench.client.link.receive(0.0):
            for answer in pipeline.feed(Packet(clock.now_us() + bench.flight.time_us, data)):
                sent.update(frame.message_id for frame in decoder.feed(answer))
    altitude_id = mavlink.MAVLINK_MSG_ID_ALTITUDE
    assert (sent[altitude_id] > 300) == (flavour != "px4")
    assert sent[mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT] > 100
    assert pipeline.identity.autopilot == {"px4": 12, "generic": 0}.get(flavour, 3)
    estimate = pipeline.filter.estimate[0]
    assert estimate["altitude_amsl_m"] == pytest.approx(301.0, abs=12.0)
