"""Inputs of public reports against `kollsman run` on real sockets and a real pseudo-terminal.

Each case names its mechanism; the reports are listed in the acceptance data's README.
"""

import contextlib
import os
import signal
import time
from collections.abc import Iterator

import pytest

from companion.mavlink.codec import mavlink
from tests import vehicle
from tests.e2e.live_vehicle import FULL_HZ, Kollsman, LiveVehicle, PtyWire, UdpWire
from tests.vehicle import Vehicle

pytestmark = pytest.mark.slow
CRITICAL = mavlink.MAV_STATE_CRITICAL
GCS = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


@contextlib.contextmanager
def running(url: str) -> Iterator[Kollsman]:
    kollsman = Kollsman(url)
    try:
        yield kollsman
        assert kollsman.stop() == 0, "\n".join(kollsman.lines)
    finally:
        kollsman.close()


@contextlib.contextmanager
def udp(*, answers: int | None = 0, **rates_hz: float) -> Iterator[tuple[LiveVehicle, Kollsman]]:
    """A vehicle that sends to our port."""
    with running("udpin:127.0.0.1:0") as kollsman, contextlib.closing(UdpWire()) as wire:
        wire.peer = ("127.0.0.1", kollsman.port)
        yield LiveVehicle(wire, answers=answers, **rates_hz), kollsman


def is_published(flying: LiveVehicle, count: int = 20) -> bool:
    return flying.fly(20.0, lambda: len(flying.altitudes) >= count)


def silent_since(flying: LiveVehicle, duration_s: float) -> bool:
    """Nothing of ours is published while it goes on, and our heartbeat is critical."""
    flying.altitudes.clear()
    flying.fly(duration_s)
    return not flying.altitudes and flying.status == CRITICAL


def test_a_server_that_answers_only_whom_it_heard() -> None:
    with contextlib.closing(UdpWire(listens=True)) as wire:
        port = wire.socket.getsockname()[1]
        with running(f"udpout:127.0.0.1:{port}"):
            flying = LiveVehicle(wire)
            assert flying.fly(10.0, lambda: len(flying.altitudes) > 5)
            beats = flying.heard["HEARTBEAT"]
            flying.fly(5.0)
            assert flying.heard["HEARTBEAT"] - beats in (4, 5, 6)


def test_a_port_that_is_asleep_until_a_byte_comes() -> None:
    with contextlib.closing(PtyWire(asleep=True)) as wire, running(wire.name):
        flying = LiveVehicle(wire)
        assert flying.fly(10.0, lambda: len(flying.altitudes) > 5)


def test_an_autopilot_that_restarts_is_asked_again_and_streams_are_put_back() -> None:
    with udp() as (flying, kollsman):
        assert is_published(flying)
        flying.reboot()
        flying.intervals.clear()
        assert flying.fly(3.2, lambda: len(flying.intervals) > 2)
        flying.altitudes.clear()
        assert flying.fly(8.0, lambda: len(flying.altitudes) > 5)
        flying.intervals.clear()
        kollsman.interrupt()
        flying.fly(1.0)
        assert {message_id for message_id, rate_hz in flying.intervals if rate_hz == 0} >= {
            29,
            24,
            27,
        }


def test_rates_that_a_ground_station_lowers_come_back() -> None:
    with udp() as (flying, _):
        assert is_published(flying)
        flying.rates_hz |= dict.fromkeys(("imu", "pressure", "gps"), 1.0)
        assert flying.fly(3.2, lambda: flying.rates_hz["imu"] >= 40.0)


def test_fifty_hertz_denied_becomes_forty() -> None:
    with udp() as (flying, kollsman):
        assert is_published(flying)
        asked = [rate_hz for message_id, rate_hz in flying.intervals if message_id == 27]
        assert asked[:2] == [50.0, 40.0]
        assert not any("IMU" in text for text in flying.texts)
        assert "IMU" not in kollsman.lines[-1]


@pytest.mark.parametrize("answers", [3, None])
def test_intervals_without_effect_are_replaced_by_groups(answers: int | None) -> None:
    with udp(answers=answers) as (flying, _):
        assert is_published(flying)
        assert flying.groups


def test_a_refused_imu_is_told() -> None:
    with udp(answers=4, heartbeat=1.0, pressure=10.0, gps=5.0, time=1.0, imu=1.0) as (flying, _):
        assert is_published(flying)
        flying.fly(6.0)
        assert any("IMU" in text for text in flying.texts)


@pytest.mark.parametrize("other", ["station", "radio", "autopilot"])
def test_a_vehicle_that_dies_is_lost_whoever_else_talks(other: str) -> None:
    talk = {
        "station": (Vehicle(255, 190), GCS),
        "radio": (Vehicle(51, 68), mavlink.MAVLink_radio_status_message(60, 0, 50, 40, 0, 0, 0)),
        "autopilot": (Vehicle(9, 1), vehicle.heartbeat()),
    }[other]
    with udp(answers=0, **FULL_HZ) as (flying, kollsman):
        assert is_published(flying)
        flying.alive = False
        for _ in range(8):
            flying.send(talk[1], talk[0])
            flying.fly(0.5)
        for _ in range(6):
            flying.send(talk[1], talk[0])
            assert silent_since(flying, 0.5)
        assert any("LOST" in text for text in flying.texts)
        if other == "autopilot":
            assert any("9/1" in line for line in kollsman.lines)
        flying.alive = True
        flying.altitudes.clear()
        assert flying.fly(6.0, lambda: len(flying.altitudes) > 5)


def test_in_lost_the_vehicles_own_height_is_sent_on() -> None:
    with udp(answers=0, **FULL_HZ, position=5.0) as (flying, kollsman):
        assert flying.fly(20.0, lambda: bool(flying.altitudes))
        assert flying.altitudes[0].altitude_amsl == pytest.approx(507.123, abs=5e-4)
        assert flying.fly(20.0, lambda: abs(flying.altitudes[-1].altitude_amsl - 500.0) < 3.0)
        flying.rates_hz |= dict.fromkeys(("imu", "pressure", "gps"), 0.0)
        flying.answers = 4
        flying.fly(6.0)
        assert flying.altitudes[-1].altitude_amsl == pytest.approx(507.123, abs=5e-4)
        assert "ALTITUDE: the autopilot's own height" in flying.texts
        kollsman.interrupt()
        flying.fly(1.0)
        assert flying.texts[-1] == "Kollsman stops: the autopilot's own height"


@pytest.mark.parametrize(
    ("ids", "kind", "autopilot"),
    [((1, 100), 30, 0), ((1, 154), 26, 0), ((77, 1), 2, 3), ((2, 1), 5, 3), ((1, 191), 2, 0)],
)
def test_who_came_first_is_not_the_vehicle(ids: tuple[int, int], kind: int, autopilot: int) -> None:
    """A camera, a gimbal, a stray datagram, an antenna tracker, and our own ids."""
    with udp(answers=0, **FULL_HZ) as (flying, _):
        flying.send(vehicle.heartbeat(type=kind, autopilot=autopilot), Vehicle(*ids))
        time.sleep(0.3)
        assert is_published(flying)


def test_a_second_program_with_our_ids_and_a_flood_do_not_end_us() -> None:
    with udp(answers=0, **FULL_HZ) as (flying, kollsman), contextlib.closing(UdpWire()) as stranger:
        stranger.peer = ("127.0.0.1", kollsman.port)
        assert is_published(flying)
        other = Vehicle(1, 191)
        for _ in range(5):
            flying.send(vehicle.heartbeat(type=18, autopilot=8), other)
            flying.fly(0.5)
        flying.altitudes.clear()
        for _ in range(50):
            for _ in range(20):
                stranger(b"\xfd" * 1400)  # 280 kB/s
            flying.fly(0.1)
        assert len(flying.altitudes) > 45
        assert {message.get_srcComponent() for message in flying.altitudes} == {192}
        assert stranger.read() == b""
        assert kollsman.process.poll() is None


def test_a_paused_vehicle_goes_on() -> None:
    """SIGSTOP: its clock stands still with it."""
    with udp(answers=0, **FULL_HZ) as (flying, kollsman):
        assert is_published(flying)
        frozen_s = time.monotonic()
        time.sleep(6.0)
        flying._zero_s += time.monotonic() - frozen_s
        flying.fly(0.5)
        flying.altitudes.clear()
        assert flying.fly(6.0, lambda: len(flying.altitudes) > 5)
        assert not any("restarted" in line for line in kollsman.lines)


def test_a_stalled_loop_stops_the_heartbeat() -> None:
    with udp(answers=0, **FULL_HZ) as (flying, kollsman):
        assert is_published(flying)
        os.kill(kollsman.process.pid, signal.SIGSTOP)
        flying.fly(1.0)
        beats = flying.heard["HEARTBEAT"]
        flying.fly(3.0)
        assert flying.heard["HEARTBEAT"] == beats
        os.kill(kollsman.process.pid, signal.SIGCONT)
        flying.fly(2.0)
        assert flying.heard["HEARTBEAT"] > beats
