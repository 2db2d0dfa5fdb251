"""`kollsman doctor` explains badly configured vehicles. Real sockets and pseudo-terminals."""

import contextlib
import threading
import time
from pathlib import Path

import pytest

from companion.clock import SystemClock
from companion.doctor import Case, Finding, Grade, examine, report
from companion.links import open_link
from companion.mavlink.codec import Message, mavlink
from companion.reference_link import open_reference
from companion.settings import CompanionSettings
from companion.warmup import warm_up
from tests.live import STREAMS, LiveVehicle, Pty, Udp, accept, free_port
from tests.vehicle import Maker, Vehicle, gps, heartbeat, pressure

SECONDS = 4.0


@pytest.fixture(scope="module", autouse=True)
def compiled() -> None:
    """As the command does before it listens."""
    warm_up(CompanionSettings())


def diagnose(*vehicles: LiveVehicle, url: str) -> tuple[Case, list[Finding]]:
    with contextlib.closing(open_link(url)) as link:
        found = examine(link, CompanionSettings(), SystemClock(), SECONDS)
    for vehicle in vehicles:
        vehicle.close()
    return found


def told(findings: list[Finding], *words: str) -> Finding:
    """The finding that has all of `words` in it or in its cure."""
    for finding in findings:
        if all(word in f"{finding.what} {finding.cure}" for word in words):
            return finding
    raise AssertionError(f"{words} not in {findings}")


@pytest.fixture
def port() -> int:
    return free_port()


def url_of(port: int) -> str:
    return f"udpin:127.0.0.1:{port}"


def test_a_good_vehicle(port: int) -> None:
    vehicle = LiveVehicle(Udp(port), answer=accept)
    case, findings = diagnose(vehicle, url=url_of(port))
    assert not [finding for finding in findings if finding.grade is Grade.WRONG]
    told(findings, "barometer", "hPa at 10 Hz")
    told(findings, "GNSS 500.0 m", "good to 2.0 m")
    text = "\n".join(report(case, findings))
    for part in ("1/1, autopilot ArduPilot", "SCALED_PRESSURE", "hPa", "fix 3"):
        assert part in text


def test_nothing_connected(port: int) -> None:
    _, findings = diagnose(url=url_of(port))
    assert told(findings, "not one byte", "SERIALn_PROTOCOL = 2").grade is Grade.WRONG


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (bytes((7 * n * n + 3 * n + n // 5) % 251 for n in range(400)), ("baud", "SERIALn_BAUD")),
        (b"nsh> ver all\r\nHW arch: PX4_FMU_V5\r\n" * 10, ("text", "console", "MAV_n_CONFIG")),
        (b"$GPGGA,172814.0,3723.46,N,12202.26,W,2,6,1.2,18.893,M*75\r\n" * 8, ("NMEA",)),
    ],
    ids=["baud rate", "console", "NMEA"],
)
def test_a_port_that_is_not_mavlink(tmp_path: Path, data: bytes, words: tuple[str, ...]) -> None:
    cable, done = Pty(tmp_path / "port"), threading.Event()

    def send() -> None:
        while not done.wait(0.1):
            cable.send(data)
            cable.receive()

    thread = threading.Thread(target=send)
    thread.start()
    try:
        _, findings = diagnose(url=f"{cable.path}:57600")
    finally:
        done.set()
        thread.join()
        cable.close()
    assert told(findings, *words).grade is Grade.WRONG


def test_heartbeats_and_no_sensors(port: int) -> None:
    vehicle = LiveVehicle(Udp(port), {"heartbeat": STREAMS["heartbeat"]})
    _, findings = diagnose(vehicle, url=url_of(port))
    assert told(findings, "no barometer", "SRn_RAW_SENS").grade is Grade.WRONG
    assert told(findings, "no GNSS", "SRn_EXT_STAT").grade is Grade.WRONG


def test_px4_is_told_its_own_parameters(port: int) -> None:
    px4 = {"heartbeat": (1.0, lambda boot_s: heartbeat(autopilot=mavlink.MAV_AUTOPILOT_PX4))}
    vehicle = LiveVehicle(Udp(port), px4)
    _, findings = diagnose(vehicle, url=url_of(port))
    told(findings, "no barometer", "MAV_n_MODE")


def test_refused_rates_and_a_slow_imu(port: int) -> None:
    def deny(message: Message) -> Message | None:
        answer = accept(message)
        if answer is not None:
            answer.result = mavlink.MAV_RESULT_DENIED
        return answer

    slow = dict(STREAMS) | {"imu": (1.0, STREAMS["imu"][1])}
    vehicle = LiveVehicle(Udp(port), slow, answer=deny)
    _, findings = diagnose(vehicle, url=url_of(port))
    told(findings, "IMU comes at 1 Hz", "DENIED", "SCHED_LOOP_RATE")
    told(findings, "refused", "SRn_")


def test_no_fix_and_a_dead_barometer(port: int) -> None:
    streams = dict(STREAMS) | {
        "gps": (5.0, lambda boot_s: gps(boot_s, fix_type=1, satellites_visible=0)),
        "pressure": (10.0, lambda boot_s: pressure(boot_s, press_abs=0.0)),
    }
    vehicle = LiveVehicle(Udp(port), streams, answer=accept)
    _, findings = diagnose(vehicle, url=url_of(port))
    assert told(findings, "without a 3D fix", "0 satellites", "GPS1_TYPE").grade is Grade.WRONG
    assert told(findings, "barometer says 0.0 hPa", "BARO_PRIMARY").grade is Grade.WRONG


def test_mavlink_1(port: int) -> None:
    vehicle = LiveVehicle(Udp(port), answer=accept, vehicle=Vehicle(version=1))
    _, findings = diagnose(vehicle, url=url_of(port))
    told(findings, "MAVLink 1", "SERIALn_PROTOCOL = 2")


def test_two_vehicles_with_the_same_ids(port: int) -> None:
    first = LiveVehicle(Udp(port), answer=accept, boot_s=50.0)
    second = LiveVehicle(Udp(port), answer=accept, boot_s=900.0)
    _, findings = diagnose(first, second, url=url_of(port))
    assert told(findings, "clock goes back", "SYSID_THISMAV").grade is Grade.WRONG


def test_only_a_camera(port: int) -> None:
    camera = {"heartbeat": (2.0, lambda boot_s: heartbeat(type=30, autopilot=8))}
    vehicle = LiveVehicle(Udp(port), camera, vehicle=Vehicle(1, 100))
    _, findings = diagnose(vehicle, url=url_of(port))
    assert told(findings, "1/100", "no heartbeat of an autopilot").grade is Grade.WRONG


def test_time_is_bounded(port: int) -> None:
    started = time.monotonic()
    diagnose(url=url_of(port))
    assert time.monotonic() - started < SECONDS + 1.0


STATION_HZ: dict[str, tuple[float, Maker]] = {
    "heartbeat": (1.0, lambda s: heartbeat(type=mavlink.MAV_TYPE_GCS, autopilot=8)),
    "pressure": (2.0, pressure),
}


def diagnose_with_station(port: int, *, sends: bool, seconds: float) -> list[Finding]:
    """The findings with a ground barometer, system 9, on a UDP link of its own."""
    station_port = free_port()
    air = {"reference": f"udpin:127.0.0.1:{station_port}", "reference_elevation_m": 500.0}
    settings = CompanionSettings().with_changes(air=air)
    streams = STATION_HZ if sends else {"heartbeat": STATION_HZ["heartbeat"]}
    vehicle = LiveVehicle(Udp(port), answer=accept)
    station = LiveVehicle(Udp(station_port), streams, vehicle=Vehicle(9, 1))
    with contextlib.ExitStack() as stack:
        for each in (vehicle, station):
            stack.callback(each.close)
        link = stack.enter_context(contextlib.closing(open_link(url_of(port))))
        opened = open_reference(settings.air, stack, SystemClock())
        return examine(link, settings, SystemClock(), seconds, opened)[1]


def test_a_ground_barometer_that_is_heard(port: int) -> None:
    """Before ten seconds there is no QNH yet; what to do is told."""
    found = told(
        diagnose_with_station(port, sends=True, seconds=4.0), "ground barometer heard", "no QNH yet"
    )
    assert found.grade is Grade.NOTE
    assert "--seconds" in found.cure


def test_a_ground_barometer_that_is_not_heard(port: int) -> None:
    found = told(
        diagnose_with_station(port, sends=False, seconds=3.0), "no SCALED_PRESSURE", "not heard"
    )
    assert found.grade is Grade.WRONG
    assert "air.reference_system_id" in found.cure
