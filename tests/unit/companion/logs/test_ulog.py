"""PX4 logs: what the log says of the vehicle."""

from pathlib import Path

import pytest

from companion.logs import open_log
from companion.mavlink.codec import Frame, mavlink
from tests import logfiles
from tests.flights import flight

pytest.importorskip("pyulog")


@pytest.mark.parametrize(("hardware", "expected"), [("PX4_SITL", 1), ("PX4_FMU_V5", 0)])
def test_a_simulated_vehicle_says_so_once_after_its_first_heartbeat(
    hardware: str, expected: int, tmp_path: Path
) -> None:
    """Its heights above sea level and above the ellipsoid are the same, and right: all of its
    altitude was withheld."""
    path = tmp_path / "flight.ulg"
    logfiles.write_ulg(path, flight(duration_s=5.0), hardware)
    spoken = [item.message_id for _, item in open_log(path).items() if isinstance(item, Frame)]
    beats = spoken.count(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
    assert beats >= 5
    assert spoken[0] == mavlink.MAVLINK_MSG_ID_HEARTBEAT
    assert spoken[1 : 1 + expected] == [mavlink.MAVLINK_MSG_ID_SIMSTATE] * expected
    assert len(spoken) == beats + expected
