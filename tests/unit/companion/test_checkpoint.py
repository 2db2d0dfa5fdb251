"""Continuing after a kill: what is restored, and when not."""

import pickle
import zlib
from pathlib import Path

import pytest

from companion import checkpoint as checkpoints
from companion.checkpoint import MAGIC, Checkpoint, Resumption, fingerprint
from companion.health import Health
from companion.pipeline import Pipeline
from companion.samples import Packet
from companion.settings import CompanionSettings
from tests.flights import HOST_EPOCH_US
from tests.vehicle import Vehicle, parsed, standing

LINKS = ["udpin:0.0.0.0:14550"]
SECOND = 1_000_000


class Host:
    """The clock of the computer since its start, by hand."""

    boot_s = 1000.0


@pytest.fixture(autouse=True)
def host(monkeypatch: pytest.MonkeyPatch) -> Host:
    made = Host()
    monkeypatch.setattr(checkpoints, "_boot_s", lambda: made.boot_s)
    return made


def run(pipeline: Pipeline, packets: list[Packet]) -> list[bytes]:
    return [frame for packet in packets for frame in pipeline.feed(packet)]


def made(tmp_path: Path, settings: CompanionSettings | None = None) -> Checkpoint:
    settings = settings or CompanionSettings()
    return Checkpoint(settings.checkpoint, LINKS, fingerprint(settings), tmp_path)


def saved(tmp_path: Path, end_s: float = 60.0) -> Pipeline:
    pipeline = Pipeline(CompanionSettings())
    run(pipeline, standing(30.0, end_s))
    assert pipeline.health.health is not Health.LOST
    assert made(tmp_path).save(pipeline)
    return pipeline


def resumed(tmp_path: Path) -> tuple[Pipeline, Resumption | None]:
    pipeline = Pipeline(CompanionSettings())
    return pipeline, made(tmp_path).restore(pipeline)


def altitudes(frames: list[bytes]) -> list[int]:
    return [m.time_usec for m in parsed(frames) if m.get_type() == "ALTITUDE"]


def test_altitude_within_a_second_of_the_first_samples(tmp_path: Path, host: Host) -> None:
    before = saved(tmp_path)
    host.boot_s += 8.0
    pipeline, resumption = resumed(tmp_path)
    assert resumption is not None
    assert pipeline.estimate.tobytes() == before.estimate.tobytes()
    published = altitudes(run(pipeline, standing(68.0, 72.0)))
    assert published[0] < 69.0 * SECOND
    resumption.check(HOST_EPOCH_US)
    assert resumption.settled
    cold = altitudes(run(Pipeline(CompanionSettings()), standing(68.0, 80.0)))
    assert cold[0] > published[0] + 1.5 * SECOND


def test_without_a_pause_it_goes_on_bit_for_bit(tmp_path: Path) -> None:
    packets = standing(30.0, 90.0)
    half = next(i for i, packet in enumerate(packets) if packet.time_us > packets[0].time_us + 3e7)
    whole, first = Pipeline(CompanionSettings()), Pipeline(CompanionSettings())
    run(whole, packets)
    run(first, packets[:half])
    assert made(tmp_path).save(first)
    second, _ = resumed(tmp_path)
    run(second, packets[half:])
    assert second.filter.checkpoint() == whole.filter.checkpoint()
    assert second.health.health is whole.health.health


def test_old_checkpoints_are_not_used(tmp_path: Path, host: Host) -> None:
    saved(tmp_path)
    host.boot_s += 40.0
    pipeline, resumption = resumed(tmp_path)
    assert resumption is None
    assert pipeline.identity.vehicle is None


def test_a_checkpoint_is_tried_once(tmp_path: Path) -> None:
    saved(tmp_path)
    assert resumed(tmp_path)[1] is not None
    assert resumed(tmp_path)[1] is None


def test_another_configuration_starts_anew(tmp_path: Path) -> None:
    saved(tmp_path)
    other = CompanionSettings().with_assignments(["publish.altitude_hz=4"])
    assert made(tmp_path, other).restore(Pipeline(other)) is None


def test_after_a_restart_of_the_computer_it_starts_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    saved(tmp_path)
    monkeypatch.setattr(checkpoints, "_boot_id", lambda: "another")
    assert resumed(tmp_path)[1] is None


@pytest.mark.parametrize("start_s", [3.0, 500.0], ids=["rebooted", "another vehicle"])
def test_a_vehicle_whose_clock_did_not_go_on(tmp_path: Path, host: Host, start_s: float) -> None:
    saved(tmp_path)
    host.boot_s += 5.0
    pipeline, resumption = resumed(tmp_path)
    assert resumption is not None
    for packet in standing(start_s, start_s + 20.0, host_us=HOST_EPOCH_US):
        pipeline.feed(packet)
        resumption.check(packet.time_us)
    fresh = Pipeline(CompanionSettings())
    run(fresh, standing(start_s, start_s + 20.0))
    assert abs(pipeline.estimate["altitude_amsl_m"][0] - 500.0) < 5.0
    assert pipeline.now_us == fresh.now_us


def test_another_system_id_starts_anew(tmp_path: Path, host: Host) -> None:
    saved(tmp_path)
    host.boot_s += 5.0
    pipeline, resumption = resumed(tmp_path)
    assert resumption is not None
    for packet in standing(65.0, 85.0, vehicle=Vehicle(7, 1)):
        pipeline.feed(packet)
        resumption.check(packet.time_us)
    assert pipeline.identity.vehicle == (7, 1)


def test_nothing_is_saved_without_an_altitude(tmp_path: Path) -> None:
    assert not made(tmp_path).save(Pipeline(CompanionSettings()))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("damage", ["cut", "flipped", "foreign", "empty"])
def test_damaged_files_are_ignored(tmp_path: Path, damage: str) -> None:
    saved(tmp_path)
    (path,) = tmp_path.iterdir()
    data = path.read_bytes()
    body = pickle.dumps({"fingerprint": print})
    path.write_bytes(
        {
            "cut": data[:-100],
            "flipped": data[:500] + bytes([data[500] ^ 1]) + data[501:],
            "foreign": MAGIC + zlib.crc32(body).to_bytes(4, "little") + body,
            "empty": b"",
        }[damage]
    )
    assert resumed(tmp_path)[1] is None


def test_the_file_is_the_owners_alone(tmp_path: Path) -> None:
    saved(tmp_path)
    (path,) = tmp_path.iterdir()
    assert path.stat().st_mode & 0o777 == 0o600
