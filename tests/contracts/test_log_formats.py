"""What every log format must do. A format in `FORMATS` is tested here as soon as it has a writer."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.errors import LogFormatError
from companion.logs import FORMATS, Format, open_log
from companion.mavlink.codec import Encoder, mavlink
from companion.samples import Packet

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


def test_reads_what_it_wrote(known: Format, path: Path) -> None:
    packets = [Packet(NOON_US + index * 20_000, data) for index, data in enumerate(frames(3000))]
    write(known, path, packets)
    reader = open_log(path)
    assert list(reader) == packets
    assert list(reader) == packets
    assert reader.counters.total() == 0
    assert reader.position_bytes == reader.size_bytes == path.stat().st_size


@settings(
    deadline=None, max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(times=st.lists(st.integers(0, 30_000_000_000_000_000), min_size=1, max_size=8))
def test_keeps_any_time(known: Format, path: Path, times: list[int]) -> None:
    packets = [Packet(time, data) for time, data in zip(times, frames(len(times)), strict=True)]
    write(known, path, packets)
    assert list(open_log(path)) == packets


def test_is_recognised_without_its_suffix(known: Format, path: Path) -> None:
    packets = [Packet(NOON_US, data) for data in frames(3)]
    plain = path.with_suffix("")
    write(known, plain, packets)
    assert list(open_log(plain)) == packets


def test_replaces_an_older_file(known: Format, path: Path) -> None:
    write(known, path, [Packet(NOON_US, data) for data in frames(30)])
    write(known, path, [Packet(NOON_US, data) for data in frames(2)])
    assert len(list(open_log(path))) == 2


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
