"""The autopilot's own height while the estimators are loaded."""

import hashlib
import time
from pathlib import Path
from typing import Any

import pytest

from companion.clock import ManualClock, SystemClock
from companion.errors import ConfigError
from companion.interim import EarlySettings, Interim, begin, early_settings
from companion.links.memory import pair
from companion.mavlink.codec import Message, mavlink
from tests.vehicle import Vehicle, heartbeat, parsed

ALT_MM, RELATIVE_MM = 507_123, 12_345


def position(boot_s: float) -> Message:
    return mavlink.MAVLink_global_position_int_message(
        round(boot_s * 1e3), 470_000_000, 80_000_000, ALT_MM, RELATIVE_MM, 0, 0, 0, 0
    )


def own_altitude() -> Message:
    return mavlink.MAVLink_altitude_message(1, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0)


class Bench:
    """An autopilot on the other end."""

    def __init__(self, autopilot: int, key: bytes | None = None, **settings: Any) -> None:
        self.clock = ManualClock()
        self.near, self.far = pair(self.clock)
        self.interim = Interim(self.near, EarlySettings(**settings), self.clock)
        self.autopilot = autopilot
        self.vehicle = Vehicle(key=key)
        self.heard: list[Message] = []

    def run(self, seconds: float, *, sends_altitude: bool = False) -> list[str]:
        """Names of what we send."""
        for tenth in range(round(seconds * 10)):
            messages = [heartbeat(autopilot=self.autopilot)] if tenth % 10 == 0 else []
            messages += [position(50.0 + tenth / 10)]
            messages += [own_altitude()] if sends_altitude and tenth % 3 == 1 else []
            for message in messages:
                self.far.send(self.vehicle.pack(message))
                self.interim.turn(0.0)
            self.clock.advance_s(0.1)
        frames = []
        while data := self.far.receive(0.0):
            frames.append(data)
        self.heard = parsed(frames)
        return [message.get_type() for message in self.heard]


def test_ardupilots_own_height_is_sent_on_at_once() -> None:
    bench = Bench(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)
    names = bench.run(2.0)
    assert names[:3] == ["HEARTBEAT", "STATUSTEXT", "ALTITUDE"]
    altitudes = [message for message in bench.heard if message.get_type() == "ALTITUDE"]
    assert len(altitudes) == pytest.approx(20, abs=1)
    assert {round(message.altitude_amsl * 1e3) for message in altitudes} == {ALT_MM}
    assert {round(message.altitude_relative * 1e3) for message in altitudes} == {RELATIVE_MM}
    assert bench.heard[0].system_status == mavlink.MAV_STATE_BOOT
    assert bench.heard[-1].get_srcSystem() == 1


def test_px4_that_sends_altitude_itself_is_left_alone() -> None:
    assert "ALTITUDE" not in Bench(mavlink.MAV_AUTOPILOT_PX4).run(5.0, sends_altitude=True)
    assert "ALTITUDE" in Bench(mavlink.MAV_AUTOPILOT_PX4).run(5.0)


def test_the_configuration_holds() -> None:
    autopilot = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    assert set(Bench(autopilot, publish={"altitude": "never"}).run(3.0)) == {"HEARTBEAT"}
    slow = Bench(autopilot, publish={"altitude_hz": 2, "statustext": False}).run(4.0)
    assert slow.count("ALTITUDE") == pytest.approx(8, abs=1)
    assert "STATUSTEXT" not in slow
    other = Bench(autopilot, vehicle={"system_id": 7}, identity={"component_id": 193})
    assert set(other.run(3.0)) == {"HEARTBEAT"}
    assert (other.heard[0].get_srcSystem(), other.heard[0].get_srcComponent()) == (7, 193)


def test_a_signing_key_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KOLLSMAN_STATE", str(tmp_path))
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    path = tmp_path / "signing.key"
    path.write_text("a passphrase")
    path.chmod(0o600)
    signing = {"key_file": str(path)}
    unsigned = Bench(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, signing=signing)
    assert set(unsigned.run(3.0)) == {"HEARTBEAT"}
    key = hashlib.sha256(b"a passphrase").digest()
    signed = Bench(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, key, signing=signing)
    signed.vehicle._mav.signing.timestamp = 1 << 47
    assert "ALTITUDE" in signed.run(3.0)


def test_settings_come_from_file_environment_and_options(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "companion.yaml"
    path.write_text("publish: {altitude: never, debug_hz: 5}\nestimators: {anything: {at: all}}\n")
    monkeypatch.setenv("KOLLSMAN_PUBLISH__ALTITUDE_HZ", "5")
    made = early_settings(path, ["publish.altitude=always", "health.lost_s=4"])
    assert made.publish.altitude == "always"
    assert (made.publish.altitude_hz, made.publish.debug_hz) == (5.0, 5.0)
    made = early_settings(path, ["identity.system_id=9"])
    assert (made.publish.altitude, made.identity.system_id) == ("never", 9)


def test_what_is_wrong_is_left_to_the_full_reading(tmp_path: Path) -> None:
    clock = ManualClock()
    near, _ = pair(clock)
    assert begin(near, clock, tmp_path / "absent.yaml", []) is None
    assert begin(near, clock, None, ["publish.altitude=perhaps"]) is None
    with pytest.raises(ConfigError, match="key_file"):
        begin(near, clock, None, [f"signing.key_file={tmp_path / 'absent.key'}"])


def test_the_thread_ends_and_leaves_the_link() -> None:
    clock = SystemClock()
    near, far = pair(clock)
    made = begin(near, clock, None, [])
    assert made is not None
    deadline_s = time.monotonic() + 5.0
    while not far.receive(0.05):
        assert time.monotonic() < deadline_s
    made.stop()
    made.stop()
    far.send(Vehicle().pack(heartbeat()))
    assert near.receive(1.0)
