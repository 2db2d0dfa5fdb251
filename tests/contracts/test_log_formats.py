"""What every log format must do. A format in `FORMATS` is tested here as soon as it has a
writer."""

import os
import random
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.errors import LogFormatError
from companion.evaluation.report import Collector
from companion.evaluation.samples import samples_of
from companion.logs import FORMATS, Format, LogReader, open_log
from companion.mavlink.codec import Encoder, Frame, mavlink
from companion.pipeline import Pipeline
from companion.samples import Kind, Packet
from companion.settings import CompanionSettings
from tests import logfiles
from tests.flights import Flight

WRITABLE = {name: known for name, known in FORMATS.items() if known.writer is not None}
NOON_US = 1_700_000_000_000_000


def frames(count: int) -> list[bytes]:
    encoder = Encoder(1, 191)
    return [
        encoder.encode(
            mavlink.MAVLink_named_value_float_message(index, b"value", float(index)), 1 + index % 2
        )
        for index in range(count)
    ]


@pytest.fixture(params=sorted(WRITABLE))
def known(request: pytest.FixtureRequest) -> Format:
    return WRITABLE[request.param]


@pytest.fixture
def path(known: Format, tmp_path: Path) -> Path:
    return tmp_path / f"log{known.suffixes[0]}"


def write(known: Format, path: Path, packets: list[Packet]) -> None:
    assert known.writer is not None
    with known.writer(path) as writer:
        for packet in packets:
            writer.write(*packet)


def packets_of(reader: LogReader) -> list[Packet]:
    return [
        Packet(time_us, item.data) for time_us, item in reader.items() if isinstance(item, Frame)
    ]


def test_reads_what_it_wrote(known: Format, path: Path) -> None:
    packets = [Packet(NOON_US + index * 20_000, data) for index, data in enumerate(frames(3000))]
    write(known, path, packets)
    reader = open_log(path)
    assert packets_of(reader) == packets
    assert packets_of(reader) == packets
    assert reader.counters.total() == 0
    assert reader.position_bytes == reader.size_bytes == path.stat().st_size


@settings(
    deadline=None, max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(times=st.lists(st.integers(0, 30_000_000_000_000_000), min_size=1, max_size=8))
def test_keeps_any_time(known: Format, path: Path, times: list[int]) -> None:
    packets = [Packet(time, data) for time, data in zip(times, frames(len(times)), strict=True)]
    write(known, path, packets)
    assert packets_of(open_log(path)) == packets


def test_is_recognised_without_its_suffix(known: Format, path: Path) -> None:
    packets = [Packet(NOON_US, data) for data in frames(3)]
    plain = path.with_suffix("")
    write(known, plain, packets)
    assert packets_of(open_log(plain)) == packets


def test_replaces_an_older_file(known: Format, path: Path) -> None:
    write(known, path, [Packet(NOON_US, data) for data in frames(30)])
    write(known, path, [Packet(NOON_US, data) for data in frames(2)])
    assert len(packets_of(open_log(path))) == 2


def test_an_empty_log_says_so(known: Format, path: Path) -> None:
    write(known, path, [])
    with pytest.raises(LogFormatError, match="empty"):
        open_log(path)


def test_closes_twice(known: Format, path: Path) -> None:
    assert known.writer is not None
    writer = known.writer(path)
    writer.close()
    writer.close()


def test_a_missing_folder_is_one_clear_line(known: Format, path: Path) -> None:
    assert known.writer is not None
    with pytest.raises(LogFormatError, match="create it"):
        known.writer(path.parent / "none" / path.name)


@pytest.mark.parametrize("known", FORMATS.values(), ids=FORMATS)
def test_is_described(known: Format) -> None:
    assert known.help
    assert known.suffixes
    assert all(suffix.startswith(".") and suffix == suffix.lower() for suffix in known.suffixes)


# Every format, with the same flight in it


@pytest.fixture(scope="module", params=sorted(FORMATS))
def flown(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, Path, Flight]:
    path, made = logfiles.write(request.param, tmp_path_factory.mktemp("logs"), duration_s=150.0)
    return request.param, path, made


def seen(reader: LogReader) -> list[tuple[int, str]]:
    return [
        (time_us, repr(item[:7] if isinstance(item, Frame) else item))
        for time_us, item in reader.items()
    ]


def test_gives_the_same_items_each_time(flown: tuple[str, Path, Flight]) -> None:
    _, path, _ = flown
    reader = open_log(path)
    first = seen(reader)
    assert reader.position_bytes == reader.size_bytes == path.stat().st_size
    assert reader.frames == len(first)
    assert first == seen(reader)
    assert reader.counters.total() == 0


def test_is_known_by_its_content(flown: tuple[str, Path, Flight], tmp_path: Path) -> None:
    name, path, _ = flown
    for other in ("", *(f".{each}" for each in FORMATS)):
        copy = tmp_path / f"copy{other}"
        copy.write_bytes(path.read_bytes())
        assert type(open_log(copy)) is FORMATS[name].reader


def test_the_sensors_come_through(flown: tuple[str, Path, Flight]) -> None:
    """Every row of the flight, within what the format can tell."""
    _, path, made = flown
    log = samples_of(path)
    for kind, tolerances in {
        Kind.PRESSURE: {"pressure_pa": 0.01},
        Kind.GNSS: {"altitude_amsl_m": 0.011, "vertical_sd_m": 0.011, "ground_speed_mps": 0.011},
        Kind.ATTITUDE: {"roll_rad": 2e-4, "pitch_rad": 2e-4},
    }.items():
        expected = made.tables[kind]
        found = log[kind]
        assert abs(found.size - expected.size) <= 1
        for field, tolerance in tolerances.items():
            np.testing.assert_allclose(
                np.asarray(found[field]), expected[field][-found.size :], atol=tolerance, rtol=0
            )
    times_us = np.asarray(log[Kind.PRESSURE]["time_us"])
    assert np.abs(times_us - made.tables[Kind.PRESSURE]["time_us"][-times_us.size :]).max() < 1000
    force = np.asarray(log[Kind.IMU]["specific_force_b_mps2"])
    assert np.abs(np.linalg.norm(force, axis=1).mean() - 9.81) < 0.1


def test_the_altitude_is_right(flown: tuple[str, Path, Flight]) -> None:
    _, path, _ = flown
    reader, collector = open_log(path), Collector()
    pipeline = Pipeline(CompanionSettings(), datagrams=True, observer=collector)
    for time_us, item in reader.items(pipeline.wanted):
        pipeline.feed_item(item, time_us)
    assert pipeline.identity.vehicle == (7, 1)
    errors = collector.errors("estimate", 60.0)
    assert errors is not None
    assert errors.rmse_m < 2.0
    assert pipeline.health.health.name == "OK"


def test_damage_is_survived(flown: tuple[str, Path, Flight], tmp_path: Path) -> None:
    """Cut anywhere, and with bytes overwritten: items or one clear error, and no wrong altitude of
    a barometer."""
    name, path, _ = flown
    data = path.read_bytes()
    rng = random.Random(1)
    damaged = [data[: rng.randrange(1, len(data))] for _ in range(4)]
    for _ in range(4):
        hurt = bytearray(data)
        for _ in range(30):
            at = rng.randrange(len(hurt) // 4, len(hurt))
            hurt[at : at + 20] = rng.randbytes(20)
        damaged.append(bytes(hurt[: len(data)]))
    for each in damaged:
        copy = tmp_path / f"damaged.{name}"
        copy.write_bytes(each)
        try:
            for _ in open_log(copy).items():
                pass
        except LogFormatError:
            continue


def test_an_empty_file_and_noise_say_so(flown: tuple[str, Path, Flight], tmp_path: Path) -> None:
    name, _, _ = flown
    path = tmp_path / f"none.{name}"
    path.write_bytes(b"")
    with pytest.raises(LogFormatError, match="empty"):
        open_log(path)
    path.write_bytes(random.Random(2).randbytes(5000))
    with pytest.raises(LogFormatError, match="none"):
        open_log(path)
    with pytest.raises(LogFormatError, match="no such file"):
        open_log(tmp_path / f"missing.{name}")


@pytest.mark.parametrize("name", ["pipe.tlog", "pipe.bin", "pipe"])
def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path, name: str) -> None:
    """Its head is read first, and the rest of it could not be read again."""
    path = tmp_path / name
    os.mkfifo(path)
    for each in (path, Path("/dev/zero")):
        with pytest.raises(LogFormatError, match="is a pipe or a device"):
            open_log(each)
