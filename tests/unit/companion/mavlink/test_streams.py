"""Which messages are wanted, and at which rates a link can carry them."""

import pytest

from companion.mavlink.streams import LINK_SHARE, StreamSettings, planned, wanted
from companion.samples import Kind

PRESSURE, GPS, RAW_IMU, HIGHRES, ATTITUDE = 29, 24, 27, 105, 30
SYSTEM_TIME, HOME, EXTENDED, POSITION = 2, 242, 245, 33
RANGE, PRESSURE2, PRESSURE3, GPS2, HUD, WIND, HYGROMETER = 132, 137, 143, 124, 74, 168, 12920
ARDUPILOT, PX4 = 3, 12


@pytest.mark.parametrize(("autopilot", "imu"), [(ARDUPILOT, RAW_IMU), (PX4, HIGHRES), (0, RAW_IMU)])
def test_what_is_wanted(autopilot: int, imu: int) -> None:
    everything = wanted(StreamSettings(), list(Kind), autopilot)
    assert [stream.message_id for stream in everything] == [
        *(PRESSURE, GPS, imu, ATTITUDE, SYSTEM_TIME, HOME, EXTENDED, POSITION),
        *(RANGE, PRESSURE2, PRESSURE3, GPS2, HUD, WIND, HYGROMETER),
    ]


def test_only_what_the_estimator_uses_and_only_rates_above_zero() -> None:
    settings = StreamSettings(status_hz=0, spare_hz=0, range_hz=0)
    few = wanted(settings, [Kind.PRESSURE], ARDUPILOT, vehicle_height=False)
    assert [(stream.name, stream.rate_hz) for stream in few] == [("SCALED_PRESSURE", 20.0)]


def test_a_wide_link_carries_everything() -> None:
    full = wanted(StreamSettings(), list(Kind), ARDUPILOT)
    assert planned(full, None) == full
    assert planned(full, 92_160) == full


@pytest.mark.parametrize("baud", [38_400, 57_600, 115_200])
def test_a_narrow_link_is_not_flooded(baud: int) -> None:
    full = wanted(StreamSettings(), list(Kind), ARDUPILOT)
    plan = planned(full, baud / 10)
    assert sum(stream.bytes_per_s for stream in plan) <= LINK_SHARE * baud / 10
    rates_hz = {stream.message_id: stream.rate_hz for stream in plan}
    assert rates_hz[RAW_IMU] >= 10.0
    assert rates_hz[PRESSURE] >= 5.0
    assert rates_hz[GPS] >= 1.0


def test_what_an_estimator_needs_at_least_is_wanted_on_any_link() -> None:
    full = wanted(StreamSettings(), list(Kind), ARDUPILOT)
    assert all(stream.rate_hz == stream.floor_hz or stream.rate_hz < 2 * stream.floor_hz
               for stream in planned(full, 100.0))  # fmt: skip
