"""`kollsman run` as a service: outputs that fail, signals, interruptions, recordings. Real
processes and sockets."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from companion.logs.tlog import TlogReader
from companion.mavlink.codec import Message, mavlink
from tests.live import STREAMS, Companion, LiveVehicle, flying, free_port, until
from tests.paths import ROOT

pytestmark = pytest.mark.slow


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture
def vehicle(port: int) -> Iterator[LiveVehicle]:
    with flying(port) as made:
        yield made


def position(boot_s: float) -> Message:
    """The vehicle's own heights; its sensors say 500 m."""
    return mavlink.MAVLink_global_position_int_message(
        round(boot_s * 1e3), 470_000_000, 80_000_000, 507_123, 12_345, 0, 0, 0, 0
    )


def altitudes(vehicle: LiveVehicle, since: float = 0.0) -> int:
    return len(vehicle.messages("ALTITUDE", since))


def command(port: int) -> list[str]:
    return [sys.executable, "-m", "companion.cli", "run", f"udpin:127.0.0.1:{port}"]


@pytest.mark.parametrize(
    "shell",
    ["{run} > /dev/full", "{run} | head -n 1", "{run} <&- >&- 2>&-", "{run} | sleep 1000"],
    ids=["full disk", "reader gone", "closed", "reader stopped"],
)
def test_output_never_ends_the_service(port: int, vehicle: LiveVehicle, shell: str) -> None:
    process = subprocess.Popen(
        ["bash", "-c", shell.format(run=" ".join(command(port)))],
        cwd=ROOT,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        until(lambda: altitudes(vehicle) > 20, 120)
        since = time.monotonic()
        until(lambda: altitudes(vehicle, since) > 30, 10)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_stop_does_not_wait_for_the_compiler(
    port: int, vehicle: LiveVehicle, tmp_path: Path, number: signal.Signals
) -> None:
    """Without a cache the start takes half a minute, on a Raspberry Pi minutes."""
    environment = {"KOLLSMAN_CACHE": str(tmp_path)}
    companion = Companion(f"udpin:127.0.0.1:{port}", environment=environment)
    until(lambda: vehicle.messages("HEARTBEAT"), 60.0)
    time.sleep(1.0)
    asked_s = time.monotonic()
    assert companion.stop(number) == 0
    assert time.monotonic() - asked_s < 10.0
    assert companion.lines[-1] == "stopped: before the service was ready"


def test_hang_up_stops_cleanly_and_the_recording_is_whole(
    port: int, vehicle: LiveVehicle, tmp_path: Path
) -> None:
    with Companion(f"udpin:127.0.0.1:{port}", "--record", str(tmp_path)) as companion:
        until(lambda: altitudes(vehicle) > 20)
        assert companion.stop(signal.SIGHUP) == 0
    assert any(line.startswith("stopped:") for line in companion.lines)
    (path,) = tmp_path.iterdir()
    reader = TlogReader(path)
    assert sum(1 for _ in reader) > 100
    assert not +reader.counters


def test_an_interruption_is_not_followed_by_a_burst(port: int, vehicle: LiveVehicle) -> None:
    """Stopped for five seconds: what arrived in the meantime gives no altitudes."""
    with Companion(f"udpin:127.0.0.1:{port}") as companion:
        until(lambda: altitudes(vehicle) > 20)
        companion.process.send_signal(signal.SIGSTOP)
        time.sleep(5.0)
        since = time.monotonic()
        companion.process.send_signal(signal.SIGCONT)
        time.sleep(1.0)
        burst = [when for when in vehicle.times("ALTITUDE", since) if when < since + 0.5]
        until(lambda: altitudes(vehicle, since) > 15, 6)
        companion.stop()
    assert len(burst) <= 11  # 10 Hz: half a second old at most, and half a second since
    assert any("outdated not sent" in line for line in companion.lines[-3:])


def test_json_lines(port: int, vehicle: LiveVehicle) -> None:
    with Companion(f"udpin:127.0.0.1:{port}", "--json") as companion:
        until(lambda: altitudes(vehicle) > 20)
        companion.stop()
    lines = [json.loads(line) for line in companion.lines]
    events = [line["event"] for line in lines if "event" in line]
    assert events[0] == "ready"
    assert events[-1] == "stopped"
    assert {"OK"} <= {line.get("health") for line in lines}
    assert all("message" in line for line in lines if "event" not in line)


def test_configuration_and_link_come_from_the_environment(
    port: int, vehicle: LiveVehicle, tmp_path: Path
) -> None:
    folder = tmp_path / "kollsman"
    folder.mkdir()
    (folder / "companion.yaml").write_text("publish: {altitude_hz: 2, debug: false}\n")
    environment = {
        "XDG_CONFIG_HOME": str(tmp_path),
        "KOLLSMAN_LINK": f"udpin:127.0.0.1:{port}",
        "KOLLSMAN_IDENTITY__COMPONENT_ID": "194",
    }
    with Companion(environment=environment):
        until(lambda: altitudes(vehicle) > 6)
    stamps = [message.time_usec for message in vehicle.messages("ALTITUDE")]
    assert min(b - a for a, b in pairwise(stamps)) > 400_000
    assert vehicle.messages("ALTITUDE")[0].get_srcComponent() == 194
    assert not vehicle.messages("DEBUG")


def test_socket_is_free_after_a_kill(port: int) -> None:
    companion = Companion(f"udpin:127.0.0.1:{port}")
    companion.wait_ready()
    companion.stop(signal.SIGKILL)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(("127.0.0.1", port))


def test_the_first_thing_after_a_kill_is_the_vehicles_own_height(port: int) -> None:
    """Before the estimators are loaded: a display that follows ALTITUDE is frozen until then."""
    streams = dict(STREAMS) | {"position": (5.0, position)}
    url = f"udpin:127.0.0.1:{port}"
    with flying(port, streams=streams) as vehicle:
        with Companion(url) as companion:
            until(lambda: altitudes(vehicle) > 20)
            companion.stop(signal.SIGKILL)
        since = time.monotonic()
        with Companion(url):
            ready = time.monotonic()
            first, *_ = vehicle.times("ALTITUDE", since)
            height = vehicle.messages("ALTITUDE", since)[0]
    assert first < ready
    assert (height.altitude_amsl, height.altitude_relative) == pytest.approx((507.123, 12.345))


def test_estimate_is_back_within_a_second_after_a_kill(
    port: int, vehicle: LiveVehicle, tmp_path: Path
) -> None:
    environment = {"RUNTIME_DIRECTORY": str(tmp_path)}
    url = f"udpin:127.0.0.1:{port}"
    with Companion(url, environment=environment) as companion:
        until(lambda: altitudes(vehicle) > 50)
        companion.stop(signal.SIGKILL)
    with Companion(url, environment=environment) as companion:
        since = time.monotonic()
        until(lambda: altitudes(vehicle, since) > 0, 10)
        took_s = time.monotonic() - since
        until(lambda: altitudes(vehicle, since) > 30, 10)
        heights = [m.altitude_amsl for m in vehicle.messages("ALTITUDE", since)]
    assert any("continuing from a checkpoint" in line for line in companion.lines)
    assert took_s < 1.0, companion.lines
    assert max(abs(height - 500.0) for height in heights) < 3.0
