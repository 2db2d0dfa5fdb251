"""The signing key on disk, and the whole service with a signed vehicle."""

import hashlib
import os
import stat
from pathlib import Path

import pytest

from companion.clock import ManualClock
from companion.errors import ConfigError
from companion.health import Health
from companion.key_file import SigningStore, load_key, make_key
from companion.links.memory import pair
from companion.mavlink.codec import Encoder, FrameReject, Message, mavlink
from companion.mavlink.signing import SigningSettings, stamp_of
from companion.notices import notice
from companion.service import Service
from companion.settings import CompanionSettings
from tests.vehicle import Vehicle, gps, heartbeat, pressure

PASSPHRASE = "correct horse battery staple"
KEY = hashlib.sha256(PASSPHRASE.encode()).digest()
UNIX_S = 1_760_000_000.0


@pytest.fixture
def path(tmp_path: Path) -> Path:
    made = tmp_path / "signing.key"
    made.write_text(PASSPHRASE + "\n")
    made.chmod(0o600)
    return made


def store(path: Path, folder: Path, unix_s: float = UNIX_S) -> SigningStore:
    settings = SigningSettings(key_file=str(path))
    places = (folder / "memory", folder / "disk")
    for place in places:
        place.mkdir(exist_ok=True)
    return SigningStore(settings, wall_s=lambda: unix_s, folders=places)


def test_a_new_key_is_private_and_never_overwrites(tmp_path: Path) -> None:
    path = tmp_path / "new.key"
    make_key(path)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert len(load_key(path)) == 32
    with pytest.raises(ConfigError, match="never overwritten"):
        make_key(path)


def test_the_key_is_that_of_ground_stations(path: Path) -> None:
    assert load_key(path) == KEY
    path.write_text("hex:" + "ab" * 32)
    assert load_key(path) == b"\xab" * 32


@pytest.mark.parametrize(
    "content", ["", "short", "hex:abcd", "hex:zz", "two\nlines of it", "\0\xff"]
)
def test_a_file_without_a_key_is_refused(path: Path, content: str) -> None:
    path.write_bytes(content.encode("latin-1"))
    with pytest.raises(ConfigError, match="one line of"):
        load_key(path)


def test_a_file_that_others_can_read_is_refused(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path.chmod(0o640)
    with pytest.raises(ConfigError, match="chmod 600"):
        load_key(path)
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(path.parent))  # systemd shows it like this
    assert load_key(path) == KEY
    with pytest.raises(ConfigError, match="cannot be read"):
        load_key(path.with_name("absent.key"))


def test_time_stamps_outlast_a_restart(path: Path, tmp_path: Path) -> None:
    """Whatever the computer's clock says, the first stamp is newer than the last before."""
    first = store(path, tmp_path)
    for _ in range(1000):
        last = first.signing.next_stamp()
        first.keep()
    again = store(path, tmp_path, unix_s=0.0)
    assert again.signing.next_stamp() > last
    assert again.signing.newest < last + stamp_of(0) + 500_000  # five seconds: no minute is lost
    for name in os.listdir(tmp_path / "memory"):
        os.unlink(tmp_path / "memory" / name)  # the computer was restarted
    after = store(path, tmp_path, unix_s=0.0)
    assert after.signing.next_stamp() > last


def test_a_disk_that_is_full_does_not_stop_the_service(path: Path, tmp_path: Path) -> None:
    made = store(path, tmp_path)
    for each in made._reserves:
        each.path = tmp_path / "no folder" / "x.stamp"
        each._due = 0
    made.keep()
    made.keep()
    assert made.signing.next_stamp() >= stamp_of(UNIX_S)


class Bench:
    """The service with a key, and a vehicle on the other end."""

    def __init__(self, signing: SigningStore | None, vehicle: Vehicle) -> None:
        self.clock = ManualClock()
        self.near, self.far = pair(self.clock)
        settings = CompanionSettings()
        self.service = Service(self.near, settings, self.clock, signing=signing)
        self.vehicle = vehicle
        self.receiver = mavlink.MAVLink(None)
        self.receiver.robust_parsing = True  # what is refused is BAD_DATA
        self.receiver.signing.secret_key = KEY
        self.heard: list[Message] = []

    def run(self, boot_s: float, seconds: float) -> None:
        for tenth in range(round(seconds * 10)):
            now_s = boot_s + tenth / 10
            messages = [pressure(now_s), gps(now_s)] + [heartbeat()] * (tenth % 10 == 0)
            for message in messages:
                self.far.send(self.vehicle.pack(message))
                self.service.turn(0.0)
            self.clock.advance_s(0.1)
            while data := self.far.receive(0.0):
                self.heard += self.receiver.parse_buffer(bytearray(data)) or []


def test_a_signed_vehicle_is_served_and_everything_else_refused(path: Path, tmp_path: Path) -> None:
    vehicle = Vehicle(key=KEY)
    vehicle._mav.signing.timestamp = stamp_of(UNIX_S)
    bench = Bench(store(path, tmp_path), vehicle)
    bench.run(30.0, 8.0)
    kinds = [message.get_type() for message in bench.heard]
    assert "ALTITUDE" in kinds
    assert "BAD_DATA" not in kinds
    assert bench.receiver.signing.goodsig_count == len(kinds)
    assert bench.service.pipeline.health.health is not Health.LOST
    before = bench.service.pipeline.estimate.tobytes()
    forger = Encoder(1, 1)
    bench.far.send(forger.encode(pressure(38.0, 4000.0)))
    bench.service.turn(0.0)
    assert bench.service.pipeline.decoder.counters[FrameReject.UNSIGNED] == 1
    assert bench.service.pipeline.estimate.tobytes() == before


def test_an_unsigned_vehicle_is_not_followed_and_that_is_said(path: Path, tmp_path: Path) -> None:
    bench = Bench(store(path, tmp_path), Vehicle())
    bench.run(30.0, 3.0)
    assert bench.service.pipeline.identity.vehicle is None
    assert "unsigned" in notice(bench.service.pipeline, bench.near)
    assert bench.service.rejected()["unsigned"] > 10


def test_another_key_is_told(path: Path, tmp_path: Path) -> None:
    bench = Bench(store(path, tmp_path), Vehicle(key=b"k" * 32))
    bench.run(30.0, 3.0)
    assert "another key" in notice(bench.service.pipeline, bench.near)


def test_a_vehicle_that_signs_is_told_where_we_do_not() -> None:
    bench = Bench(None, Vehicle(key=KEY))
    bench.run(30.0, 3.0)
    assert "signing.key_file" in notice(bench.service.pipeline, bench.near)
