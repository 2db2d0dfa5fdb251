"""Messages -> readings: units, frames, sentinels, one table; and nothing a message holds can raise
or be infinite."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.intake.rows import unsaid
from companion.mavlink import convert
from companion.mavlink.codec import Frame, Message, decode, mavlink
from companion.mavlink.convert import CONVERTERS, Reading, TimeBase
from companion.samples import DTYPES, Kind, rows
from tests import vehicle

NAN = math.nan
G = 9.80665
MESSAGES = [*CONVERTERS, mavlink.MAVLINK_MSG_ID_RAW_IMU]


def readings(message: Message) -> tuple[Reading, ...]:
    if (
        type(message).id == mavlink.MAVLINK_MSG_ID_RAW_IMU
    ):  # a field called id hides that of the class
        return convert.raw_imu(message, 1e-3 * G)
    return CONVERTERS[type(message).id](message)


def fields(reading: Reading) -> dict[str, Any]:
    """The reading's values by the names of its dtype."""
    names = list(DTYPES[reading.kind].names or ())[3:]
    assert len(names) == len(reading.values) + len(unsaid(reading))
    return dict(zip(names[: len(reading.values)], reading.values, strict=True))


def only(message: Message) -> dict[str, Any]:
    (reading,) = readings(message)
    return fields(reading)


def scaled_imu(kind: Any) -> Message:
    return kind(5000, 1000, -500, -1000, 1000, -500, 250, 0, 0, 0)


def gps2(**changes: Any) -> Message:
    known = vehicle.gps(5.0).to_dict() | {"dgps_numch": 0, "dgps_age": 0} | changes
    names = mavlink.MAVLink_gps2_raw_message.fieldnames
    return mavlink.MAVLink_gps2_raw_message(
        **{name: known[name] for name in names if name in known}
    )


def quaternion(w: float, x: float, y: float, z: float) -> Message:
    return mavlink.MAVLink_attitude_quaternion_message(5000, w, x, y, z, 0.1, 0.2, 0.3)


TABLE: list[tuple[str, Message, dict[str, Any]]] = [
    ("hPa and centidegrees", vehicle.pressure(5, press_abs=1013.25, temperature=-4050),
     {"pressure_pa": 101325.0, "die_temperature_k": 232.65, "suspect": 0}),
    ("pressure 0 stays 0: an estimator refuses it", vehicle.pressure(5, press_abs=0.0),
     {"pressure_pa": 0.0}),
    ("pressure infinite", vehicle.pressure(5, press_abs=math.inf), {"pressure_pa": NAN}),
    ("pressure NaN", vehicle.pressure(5, press_abs=NAN), {"pressure_pa": NAN}),
    ("GPS in SI", vehicle.gps(5, 1234.5, lat=473_977_420, lon=-85_455_940, vel=1250, cog=27000,
                              hdg_acc=0),
     {"latitude_deg": 47.397742, "longitude_deg": -8.545594, "altitude_amsl_m": 1234.5,
      "altitude_ellipsoid_m": 1281.5, "ground_speed_mps": 12.5, "course_rad": 1.5 * math.pi,
      "climb_mps": NAN, "horizontal_sd_m": 1.2, "vertical_sd_m": 2.0, "hdop": 0.9, "vdop": 1.4,
      "fix_type": 3, "satellites": 12, "suspect": 0}),
    ("below the sea", vehicle.gps(5, -430.5), {"altitude_amsl_m": -430.5}),
    ("GPS without extensions (MAVLink 1)", vehicle.gps(5, alt_ellipsoid=0, h_acc=0, v_acc=0),
     {"altitude_ellipsoid_m": NAN, "horizontal_sd_m": NAN, "vertical_sd_m": NAN}),
    ("DOP unknown", vehicle.gps(5, eph=65535, epv=65535), {"hdop": NAN, "vdop": NAN}),
    ("DOP zero", vehicle.gps(5, eph=0, epv=0), {"hdop": NAN, "vdop": NAN}),
    ("DOP 9999: no solution", vehicle.gps(5, eph=9999, epv=9999, fix_type=1),
     {"hdop": 99.99, "vdop": 99.99}),
    ("DOP 9999 beside a fix", vehicle.gps(5, eph=9999, epv=9999), {"hdop": NAN, "vdop": NAN}),
    ("airspeed of the autopilot", mavlink.MAVLink_vfr_hud_message(23.5, 20.0, 90, 50, 500.0, 0.0),
     {"airspeed_mps": 23.5}),
    ("no airspeed", mavlink.MAVLink_vfr_hud_message(NAN, 20.0, 90, 50, 500.0, 0.0),
     {"airspeed_mps": NAN}),
    ("speed, course, satellites unknown", vehicle.gps(5, vel=65535, cog=65535,
                                                      satellites_visible=255),
     {"ground_speed_mps": NAN, "course_rad": NAN, "satellites": -1}),
    ("nowhere", vehicle.gps(5, 77.0, lat=0, lon=0),
     {"latitude_deg": NAN, "longitude_deg": NAN, "altitude_amsl_m": NAN}),
    ("on the equator is somewhere", vehicle.gps(5, 77.0, lat=0, lon=10), {"altitude_amsl_m": 77.0}),
    ("accuracy of kilometres", vehicle.gps(5, v_acc=3_750_000_128),
     {"vertical_sd_m": 3_750_000.128}),
    ("second receiver", gps2(alt=88_000), {"altitude_amsl_m": 88.0, "vertical_sd_m": 2.0}),
    ("mG and mrad/s", scaled_imu(mavlink.MAVLink_scaled_imu_message),
     {"specific_force_b_mps2": (G, -0.5 * G, -G), "angular_rate_b_radps": (1.0, -0.5, 0.25)}),
    ("RAW_IMU in the scale given", vehicle.raw_imu(5, xacc=250, zgyro=-40),
     {"specific_force_b_mps2": (0.25 * G, 0.0, -G), "angular_rate_b_radps": (0.0, 0.0, -0.04)}),
    ("radians as they are", vehicle.attitude(5, roll=0.1, pitch=-0.2, yaw=3.0, yawspeed=0.4),
     {"roll_rad": 0.1, "pitch_rad": -0.2, "yaw_rad": 3.0, "angular_rate_b_radps": (0.0, 0.0, 0.4)}),
    ("attitude infinite", vehicle.attitude(5, roll=math.inf, pitch=-math.inf, rollspeed=math.inf),
     {"roll_rad": NAN, "pitch_rad": NAN, "yaw_rad": 0.0, "angular_rate_b_radps": (NAN, 0.0, 0.0)}),
    ("quaternion, 90 degrees of roll", quaternion(math.sqrt(0.5), math.sqrt(0.5), 0, 0),
     {"roll_rad": math.pi / 2, "pitch_rad": 0.0, "yaw_rad": 0.0,
      "angular_rate_b_radps": (0.1, 0.2, 0.3)}),
    ("quaternion, 30 degrees of pitch", quaternion(math.cos(math.pi / 12), 0,
                                                   math.sin(math.pi / 12), 0),
     {"roll_rad": 0.0, "pitch_rad": math.pi / 6, "yaw_rad": 0.0}),
    ("quaternion, due west", quaternion(math.sqrt(0.5), 0, 0, -math.sqrt(0.5)),
     {"yaw_rad": -math.pi / 2}),
    ("range finder in cm", vehicle.range_finder(5, current_distance=1234),
     {"distance_m": 12.34, "downward": 1}),
    ("looks forward", vehicle.range_finder(5, orientation=0), {"distance_m": 10.0, "downward": 0}),
    ("below its minimum", vehicle.range_finder(5, current_distance=10), {"distance_m": NAN}),
    ("beyond its maximum", vehicle.range_finder(5, current_distance=4001), {"distance_m": NAN}),
    ("at its maximum", vehicle.range_finder(5, current_distance=4000), {"distance_m": 40.0}),
    ("distance 0", vehicle.range_finder(5, current_distance=0, min_distance=0),
     {"distance_m": NAN}),
    ("of no quality", vehicle.range_finder(5, signal_quality=1), {"distance_m": NAN}),
    ("armed", vehicle.heartbeat(base_mode=mavlink.MAV_MODE_FLAG_SAFETY_ARMED | 1),
     {"armed": 1, "landed": -1, "reboot": 0}),
    ("disarmed", vehicle.heartbeat(base_mode=0x7F), {"armed": 0, "landed": -1}),
    ("on the ground", mavlink.MAVLink_extended_sys_state_message(0, 1), {"armed": -1, "landed": 1}),
    ("in the air", mavlink.MAVLink_extended_sys_state_message(0, 2), {"landed": 0}),
    ("landing", mavlink.MAVLink_extended_sys_state_message(0, 4), {"landed": 0}),
    ("landed state unknown", mavlink.MAVLink_extended_sys_state_message(0, 0), {"landed": -1}),
    ("boot clock only", vehicle.system_time(5.0, 1_700_000_000_000_000),
     {"armed": -1, "landed": -1, "reboot": 0}),
    ("home in mm", vehicle.home(584.25),
     {"latitude_deg": 47.0, "longitude_deg": 8.0, "altitude_amsl_m": 584.25}),
]  # fmt: skip


@pytest.mark.parametrize(
    ("message", "expected"), [row[1:] for row in TABLE], ids=[row[0] for row in TABLE]
)
def test_units_and_sentinels(message: Message, expected: dict[str, Any]) -> None:
    found = only(message)
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=1e-6, abs=1e-7, nan_ok=True), name


def test_every_message_is_in_the_table() -> None:
    covered = {type(message).id for _, message, _ in TABLE}
    cousins = {116, 129, 137, 143}  # second and third instances, tested below
    assert covered | cousins | {mavlink.MAVLINK_MSG_ID_HIGHRES_IMU} == set(MESSAGES)


@pytest.mark.parametrize(
    ("message", "instance"),
    [
        (mavlink.MAVLink_scaled_pressure_message(1, 1000.0, 0, 2000), 0),
        (mavlink.MAVLink_scaled_pressure2_message(1, 1000.0, 0, 2000), 1),
        (mavlink.MAVLink_scaled_pressure3_message(1, 1000.0, 0, 2000), 2),
        (scaled_imu(mavlink.MAVLink_scaled_imu_message), 0),
        (scaled_imu(mavlink.MAVLink_scaled_imu2_message), 1),
        (scaled_imu(mavlink.MAVLink_scaled_imu3_message), 2),
        (vehicle.gps(1), 0),
        (gps2(), 1),
        (vehicle.range_finder(1, id=2), 2),
    ],
)
def test_instances(message: Message, instance: int) -> None:
    (reading,) = readings(message)
    assert reading.instance == instance


@pytest.mark.parametrize(
    ("message", "base", "stamp_us"),
    [
        (vehicle.pressure(4.2), TimeBase.BOOT, 4_200_000),
        (vehicle.attitude(4.2), TimeBase.BOOT, 4_200_000),
        (vehicle.system_time(4.2), TimeBase.BOOT, 4_200_000),
        (vehicle.gps(4.2), TimeBase.EITHER, 4_200_000),
        (vehicle.raw_imu(4.2), TimeBase.EITHER, 4_200_000),
        (vehicle.heartbeat(), TimeBase.NONE, 0),
        (vehicle.home(1.0), TimeBase.NONE, 0),
        (mavlink.MAVLink_extended_sys_state_message(0, 1), TimeBase.NONE, 0),
    ],
)
def test_stamps(message: Message, base: TimeBase, stamp_us: int) -> None:
    (reading,) = readings(message)
    assert (reading.base, reading.stamp_us) == (base, stamp_us)


def test_highres_imu_is_two_sensors() -> None:
    imu, pressure = readings(
        vehicle.highres_imu(5, abs_pressure=950.0, temperature=21.5, xgyro=0.25)
    )
    assert fields(imu)["specific_force_b_mps2"] == pytest.approx((0, 0, -9.81))
    assert fields(imu)["angular_rate_b_radps"] == pytest.approx((0.25, 0, 0))
    assert fields(pressure)["pressure_pa"] == pytest.approx(95_000.0)
    assert fields(pressure)["die_temperature_k"] == pytest.approx(294.65)


@pytest.mark.parametrize(
    ("changes", "kinds", "pressure_pa"),
    [
        ({"abs_pressure": 95_000.0}, [Kind.IMU, Kind.PRESSURE], 95_000.0),  # old PX4 sent Pa
        ({"abs_pressure": 0.0}, [Kind.IMU], None),
        ({"abs_pressure": NAN}, [Kind.IMU], None),
        ({"abs_pressure": math.inf}, [Kind.IMU, Kind.PRESSURE], NAN),
        ({"fields_updated": 0x3F}, [Kind.IMU], None),
        ({"fields_updated": 0x200, "abs_pressure": 950.0}, [Kind.PRESSURE], 95_000.0),
        ({"fields_updated": 0, "abs_pressure": 950.0}, [Kind.IMU, Kind.PRESSURE], 95_000.0),
    ],
)
def test_highres_imu_says_what_is_new(
    changes: dict[str, Any], kinds: list[Kind], pressure_pa: float | None
) -> None:
    found = readings(vehicle.highres_imu(5, **changes))
    assert [reading.kind for reading in found] == kinds
    if pressure_pa is not None:
        assert fields(found[-1])["pressure_pa"] == pytest.approx(pressure_pa, nan_ok=True)


def test_highres_imu_without_a_new_temperature_has_none() -> None:
    _, pressure = readings(vehicle.highres_imu(5, fields_updated=0x3F | 0x200))
    assert math.isnan(fields(pressure)["die_temperature_k"])


def test_a_quaternion_that_is_none_gives_nothing() -> None:
    for values in ((0, 0, 0, 0), (NAN, 0, 0, 0), (math.inf, 0, 0, 0), (2, 0, 0, 0)):
        assert readings(quaternion(*values)) == ()


def test_a_home_that_was_never_set_gives_nothing() -> None:
    assert readings(vehicle.home(0.0, latitude=0, longitude=0)) == ()


def test_heights_for_comparison() -> None:
    position = mavlink.MAVLink_global_position_int_message(5000, 1, 1, 584_250, 1000, 0, 0, -150, 0)
    assert convert.global_position(position) == pytest.approx((5_000_000, 584.25, 1.5))
    names = mavlink.MAVLink_sim_state_message.fieldnames
    truth = mavlink.MAVLink_sim_state_message(
        **dict.fromkeys(names, 0.0) | {"alt": 584.25, "vd": -1.5} | LATITUDES
    )
    assert convert.sim_state(truth) == pytest.approx((584.25, 1.5))


LATITUDES = {"lat_int": 0, "lon_int": 0}


@settings(deadline=None, max_examples=300)
@given(message_id=st.sampled_from(MESSAGES), data=st.data())
def test_any_payload_gives_finite_values_or_nan(message_id: int, data: st.DataObject) -> None:
    kind = mavlink.mavlink_map[message_id]
    size = kind.unpacker.size
    awkward = st.sampled_from(
        [b"\x00\x00\x80\x7f", b"\x00\x00\x80\xff", b"\x00\x00\xc0\x7f", b"\xff" * 4, b"\0" * 4]
    )
    payload = b"".join(
        data.draw(st.lists(awkward | st.binary(min_size=4, max_size=4), min_size=1, max_size=20))
    )
    payload = payload[:size].ljust(size, b"\0")
    head = bytes([0xFD, size, 0, 0, 0, 1, 1]) + message_id.to_bytes(3, "little")
    message = decode(Frame(head + payload + b"\0\0", message_id, 1, 1, 0, 2, False))
    assert message is not None
    for reading in readings(message):
        assert isinstance(reading.stamp_us, int)
        row = rows(DTYPES[reading.kind])
        row[0] = (0, 0, reading.instance, *reading.values, *unsaid(reading))
        for name, (dtype, *_) in (DTYPES[reading.kind].fields or {}).items():
            if dtype.base.kind == "f":
                assert not np.isinf(row[name]).any(), (kind.msgname, name)
