"""The feedback of `kollsman run` on a vehicle whose altitude drifts: kill -9, stop, restart.

Real processes and sockets; the mark is on disk.
"""

import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.mavlink.codec import Message, mavlink
from tests.live import STREAMS, Companion, LiveVehicle, Udp, accept, free_port, until
from tests.vehicle import heartbeat

NAME = "BARO_ALT_OFFSET"
TRUE_M, HOME_M, DRIFT_MPS = 500.0, 400.0, -0.1
SETTINGS = {
    "KOLLSMAN_FEEDBACK__MODE": "baro-alt-offset",
    "KOLLSMAN_FEEDBACK__SETTLE_S": "5",
    "KOLLSMAN_FEEDBACK__DEAD_BAND_M": "0.1",
    "KOLLSMAN_FEEDBACK__PROOF_RATIO": "0",
    "KOLLSMAN_FEEDBACK__LEVEL_M": "1000",
}


class Autopilot:
    """ArduPilot's parameters, and its own altitude, which drifts and is raised by the offset."""

    def __init__(self, port: int) -> None:
        self.values = {
            NAME: (0.0, mavlink.MAV_PARAM_TYPE_REAL32),
            "AHRS_EKF_TYPE": (3.0, mavlink.MAV_PARAM_TYPE_INT8),
            "EK3_SRC1_POSZ": (1.0, mavlink.MAV_PARAM_TYPE_INT8),
            "EK3_OGN_HGT_MASK": (0.0, mavlink.MAV_PARAM_TYPE_INT8),
        }
        self.armed = True
        self.writes: list[float] = []
        self._lock = threading.Lock()
        streams = dict(STREAMS) | {
            "heartbeat": (2.0, self._heartbeat),
            "position": (5.0, self._position),
        }
        self.link = LiveVehicle(Udp(port), streams, answer=self._answer)

    @property
    def offset_m(self) -> float:
        return self.values[NAME][0]

    def texts(self) -> list[str]:
        return [str(m.text) for m in self.link.messages("STATUSTEXT") if "feedback" in m.text]

    def _heartbeat(self, boot_s: float) -> Message:
        del boot_s
        armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0
        return heartbeat(base_mode=mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | armed)

    def _position(self, boot_s: float) -> Message:
        own_m = TRUE_M + DRIFT_MPS * (boot_s - 50.0) + self.offset_m
        heights = [round((own_m - datum_m) * 1e3) for datum_m in (0.0, HOME_M)]
        return mavlink.MAVLink_global_position_int_message(
            round(boot_s * 1e3), 470_000_000, 80_000_000, *heights, 0, 0, 0, 0
        )

    def tell(self) -> None:
        """PARAM_VALUE that nobody asked for."""
        request = mavlink.MAVLink_param_request_read_message(1, 1, NAME.encode(), -1)
        answer = self._answer(request)
        assert answer is not None
        self.link.send(answer)

    def _answer(self, message: Message) -> Message | None:
        kind = message.get_type()
        if kind == "PARAM_SET" and message.param_id == NAME:
            self.values[NAME] = (float(message.param_value), mavlink.MAV_PARAM_TYPE_REAL32)
            self.writes.append(self.offset_m)
        elif kind != "PARAM_REQUEST_READ" or message.param_id not in self.values:
            return accept(message)
        value, param_type = self.values[message.param_id]
        return mavlink.MAVLink_param_value_message(
            message.param_id.encode(), value, param_type, len(self.values), 65535
        )


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture
def autopilot(port: int) -> Iterator[Autopilot]:
    made = Autopilot(port)
    yield made
    made.link.close()


def start(port: int, folder: Path, **more: str) -> Companion:
    environment = SETTINGS | {"KOLLSMAN_STATE": str(folder), "RUNTIME_DIRECTORY": str(folder)}
    return Companion(f"udpin:127.0.0.1:{port}", environment=environment | more)


def marks(folder: Path) -> list[Path]:
    return list(folder.glob("feedback-*.json"))


@pytest.mark.slow
def test_kill_9_in_flight_then_a_stop_then_disarmed(
    port: int, autopilot: Autopilot, tmp_path: Path
) -> None:
    with start(port, tmp_path) as companion:
        until(lambda: len(autopilot.writes) >= 3, 60.0)
        companion.stop(signal.SIGKILL)
    left_m = autopilot.offset_m
    assert left_m > 0.2
    assert len(marks(tmp_path)) == 1

    with start(port, tmp_path) as companion:
        writes = len(autopilot.writes)
        until(lambda: len(autopilot.writes) >= writes + 2, 60.0)
        assert autopilot.writes[writes] == pytest.approx(left_m + 0.1, abs=0.02)  # goes on from it
        assert any(f"found its {NAME}" in text for text in autopilot.texts())
        kept_m = autopilot.offset_m
        companion.stop(signal.SIGINT)
    assert autopilot.offset_m == pytest.approx(kept_m, abs=0.11)  # no step in flight
    assert any("stops" in text for text in autopilot.texts())
    assert len(marks(tmp_path)) == 1

    autopilot.armed = False
    with start(port, tmp_path):
        until(lambda: autopilot.offset_m == 0.0, 60.0)
        until(lambda: marks(tmp_path) == [], 10.0)
        until(lambda: f"Kollsman feedback {NAME} restored to 0" in autopilot.texts(), 10.0)


@pytest.mark.long
def test_a_vehicle_that_restarts_and_somebody_who_sets_the_parameter(
    port: int, autopilot: Autopilot, tmp_path: Path
) -> None:
    with start(port, tmp_path):
        until(lambda: len(autopilot.writes) >= 2, 60.0)
        autopilot.values[NAME] = (0.0, mavlink.MAV_PARAM_TYPE_REAL32)  # as ArduPilot at boot
        autopilot.link.reboot()
        writes, starts = len(autopilot.writes), autopilot.link.messages("PARAM_REQUEST_READ")
        until(lambda: len(autopilot.writes) > writes, 90.0)
        assert autopilot.writes[writes] == pytest.approx(0.1, abs=0.01)
        assert len(autopilot.link.messages("PARAM_REQUEST_READ")) >= len(starts) + 4  # read anew
        autopilot.values[NAME] = (1.5, mavlink.MAV_PARAM_TYPE_REAL32)
        autopilot.tell()
        until(lambda: any("changed to 1.5" in text for text in autopilot.texts()), 10.0)
        writes = len(autopilot.writes)
        autopilot.armed = False
        time.sleep(4.0)
        assert len(autopilot.writes) == writes
    assert autopilot.offset_m == 1.5
    assert marks(tmp_path) == []
