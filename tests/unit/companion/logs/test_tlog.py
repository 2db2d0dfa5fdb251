"""The tlog reader on everything that real logs do, and on the real logs where they are at hand."""

import random
import struct
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from companion.errors import LogFormatError
from companion.logs import open_log, tlog
from companion.logs.tlog import TlogReader, TlogWriter
from companion.mavlink.codec import Encoder, FrameReject, mavlink
from companion.mavlink.framing import mcrf4xx
from companion.samples import Packet
from tests.paths import DATA

NOON_US = 1_700_000_000_000_000
SECOND = 1_000_000
REAL = DATA
REAL_LOGS = sorted([*REAL.glob("real/*.tlog"), *REAL.glob("flights/*.tlog")])
LONG_IF_LARGE = [
    pytest.param(
        path, id=path.stem, marks=() if path.stat().st_size < 1_000_000 else pytest.mark.long
    )
    for path in REAL_LOGS
]

Log = Callable[..., TlogReader]


def packets(
    count: int, *, start_us: int = NOON_US, version: int = 2, system_id: int = 1
) -> list[Packet]:
    encoder = Encoder(system_id, 1)
    return [
        Packet(
            start_us + index * SECOND,
            encoder.encode(
                mavlink.MAVLink_altitude_message(index, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0), version
            ),
        )
        for index in range(count)
    ]


def record(packet: Packet) -> bytes:
    return struct.pack(">Q", packet.time_us) + packet.data


def records(some: list[Packet]) -> bytes:
    return b"".join(map(record, some))


def foreign(payload: bytes, message_id: int = 142, extra: int = 99) -> bytes:
    body = bytes([0xFE, len(payload), 1, 255, 190, message_id]) + payload
    return body + mcrf4xx(body[1:] + bytes([extra])).to_bytes(2, "little")


def damaged(packet: Packet) -> Packet:
    data = bytearray(packet.data)
    data[15] ^= 0x40
    return packet._replace(data=bytes(data))


@pytest.fixture(params=["one chunk", "many chunks"])
def log(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Log:
    """Bytes -> a reader of them, with buffers so small that everything happens across their edges,
    and not."""
    if request.param == "many chunks":
        monkeypatch.setattr(tlog, "_CHUNK", 37)

    def write(*parts: bytes) -> TlogReader:
        path = tmp_path / "a.tlog"
        path.write_bytes(b"".join(parts))
        return TlogReader(path)

    return write


def test_clean(log: Log) -> None:
    some = packets(200)
    reader = log(records(some))
    for _ in range(2):  # every iteration starts anew
        assert list(reader) == some
        assert reader.counters == {}
        assert reader.frames == 200
        assert reader.position_bytes == reader.size_bytes == len(records(some))


def test_position_moves(log: Log) -> None:
    reader = log(records(packets(50)))
    assert reader.position_bytes == 0
    positions = [reader.position_bytes for _ in reader]
    assert positions == sorted(positions)
    assert 0 < positions[0] < 100


def test_junk_head(log: Log) -> None:
    some = packets(20)
    junk = random.Random(5).randbytes(2500)
    reader = log(junk, records(some))
    assert list(reader) == some
    assert reader.counters == {FrameReject.JUNK: 2500}


def test_head_of_stamps_without_frames(log: Log) -> None:
    some = packets(20)
    reader = log(
        b"".join(struct.pack(">Q", NOON_US + i) + b"\r\n" for i in range(250)), records(some)
    )
    assert list(reader) == some
    assert reader.counters == {FrameReject.JUNK: 2500}


def test_zero_tail(log: Log) -> None:
    some = packets(20)
    reader = log(records(some), bytes(2955))
    assert list(reader) == some
    assert reader.counters == {FrameReject.JUNK: 2955}


def test_zero_gap(log: Log) -> None:
    some = packets(40)
    reader = log(records(some[:20]), bytes(3333), records(some[20:]))
    assert list(reader) == some
    assert reader.counters == {FrameReject.JUNK: 3333}


def test_large_zero_gap(tmp_path: Path) -> None:
    some = packets(4)
    path = tmp_path / "a.tlog"
    path.write_bytes(records(some[:2]) + bytes(5_000_000) + records(some[2:]))
    assert list(TlogReader(path)) == some


def test_zeros_over_half_a_time_make_no_time(log: Log) -> None:
    some = packets(40)
    whole = records(some[20:])
    reader = log(records(some[:20]), bytes(104), whole[4:])  # the time that is left says 1970
    assert list(reader) == some[:20] + some[21:]
    assert reader.counters[FrameReject.TIMESTAMP] == 1


@pytest.mark.parametrize("left", [1, 5, 8, 9, 12, 40])
def test_cut_last_frame(log: Log, left: int) -> None:
    some = packets(10)
    reader = log(records(some), record(packets(1)[0])[:left])
    assert list(reader) == some
    assert reader.counters == {FrameReject.TRUNCATED: 1}


def test_appended_after_a_cut_frame(log: Log) -> None:
    first, second = packets(10), packets(10, start_us=NOON_US + 100 * 86_400 * SECOND)
    reader = log(records(first)[:-20], records(second))
    assert list(reader) == first[:-1] + second


def test_junk_between_frames(log: Log) -> None:
    some = packets(30)
    rng = random.Random(8)
    parts = [record(packet) + rng.randbytes(rng.randrange(60)) for packet in some]
    reader = log(*parts, records(packets(1)))
    assert list(reader)[:-1] == some


def test_foreign_frames_are_skipped_by_length(log: Log) -> None:
    some = packets(20)
    inner = b"xx" + record(packets(1, start_us=NOON_US + SECOND // 2)[0]) + b"yy"
    parts = [record(packet) + record(packet._replace(data=foreign(inner))) for packet in some]
    reader = log(*parts)
    assert list(reader) == some
    assert reader.counters == {FrameReject.DIALECT: 20}


def test_unknown_ids(log: Log) -> None:
    some = packets(5)
    parts = [
        record(packet) + record(packet._replace(data=foreign(b"abc", message_id=255)))
        for packet in some
    ]
    reader = log(*parts)
    assert list(reader) == some
    assert reader.counters == {FrameReject.UNKNOWN_ID: 5}


def test_damaged_frames_keep_the_alignment(log: Log) -> None:
    some = packets(30)
    parts = [
        record(damaged(packet) if index % 3 == 1 else packet) for index, packet in enumerate(some)
    ]
    reader = log(*parts)
    assert list(reader) == [packet for index, packet in enumerate(some) if index % 3 != 1]
    assert reader.counters == {FrameReject.CRC: 10}


def test_damaged_last_frame(log: Log) -> None:
    some = packets(3)
    reader = log(records(some[:2]), record(damaged(some[2])))
    assert list(reader) == some[:2]
    assert reader.counters == {FrameReject.CRC: 1}


def test_damaged_length_byte(log: Log) -> None:
    some = packets(20)
    for wrong in (0, 3, 200, 255):
        broken = bytearray(record(some[10]))
        broken[9] = wrong
        reader = log(records(some[:10]), bytes(broken), records(some[11:]))
        assert list(reader) == some[:10] + some[11:]


def test_start_byte_in_the_time(log: Log) -> None:
    some = [
        packet._replace(time_us=0x0006_FDFE_FDFE_FDFE + index * 256)
        for index, packet in enumerate(packets(20))
    ]
    reader = log(b"\xfdjunk", records(some))
    assert list(reader) == some
    reader = log(records(some))
    assert list(reader) == some
    assert reader.counters == {}


def test_clock_that_steps_back_is_passed_on(log: Log) -> None:
    times = [NOON_US, NOON_US + SECOND, NOON_US - 600 * SECOND, 0, 5, NOON_US]
    some = [packet._replace(time_us=time) for packet, time in zip(packets(6), times, strict=True)]
    reader = log(records(some))
    assert list(reader) == some
    assert reader.counters == {}


def test_year_2908_is_passed_on(log: Log) -> None:
    some = packets(3, start_us=29_600_000_000_000_000)
    assert list(log(records(some))) == some


def test_year_146000_is_not_invented(log: Log) -> None:
    """A good frame right behind a lost half record: where its time should be there are other
    bytes."""
    some = packets(20)
    absurd = struct.pack(">Q", 146_000 * 31_556_952 * SECOND)
    reader = log(records(some[:10]), b"\x40junk junk" + absurd + some[10].data, records(some[11:]))
    assert list(reader) == some[:10] + some[11:]
    assert reader.counters[FrameReject.TIMESTAMP] == 1
    reader = log(records(some[:10]), absurd + some[10].data, records(some[11:]))
    assert list(reader) == some[:10] + some[11:]
    assert reader.counters == {FrameReject.TIMESTAMP: 1}


def test_versions_and_signatures_mixed(log: Log) -> None:
    sender = mavlink.MAVLink(None, srcSystem=3, srcComponent=1)
    sender.signing.secret_key = b"k" * 32
    sender.signing.sign_outgoing = True
    signed = [
        Packet(NOON_US, mavlink.MAVLink_system_time_message(i, i).pack(sender)) for i in range(10)
    ]
    some = [
        packet
        for group in zip(packets(10), packets(10, version=1), signed, strict=True)
        for packet in group
    ]
    reader = log(records(some))
    assert list(reader) == some
    assert reader.counters == {}


def test_random_damage_never_raises_and_never_invents(log: Log) -> None:
    some = packets(60)
    rng = random.Random(11)
    for _ in range(60):
        data = bytearray(records(some))
        for _ in range(rng.randrange(1, 6)):
            at = rng.randrange(200, len(data))
            match rng.randrange(4):
                case 0:
                    data[at] ^= 1 << rng.randrange(8)
                case 1:
                    del data[at : at + rng.randrange(100)]
                case 2:
                    data[at:at] = rng.randbytes(rng.randrange(400))
                case _:
                    data[at : at + rng.randrange(300)] = bytes(rng.randrange(300))
        got = list(log(bytes(data)))
        assert {packet.data for packet in got} <= {packet.data for packet in some}
        assert len(got) > 30


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "empty"),
        (bytes(5000), "zeros"),
        (b"\xa3\x95\x80" + bytes(200), "dataflash"),
        (b"ULog\x01\x12\x35\x01" + bytes(200), "PX4"),
        (b"<!DOCTYPE html><html>", "text"),
        (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
        (random.Random(2).randbytes(50_000), "no MAVLink frame"),
        (records(packets(9, start_us=0x7F7F7F7F7F7F7F7F)), "impossible times"),
    ],
)
def test_says_what_a_file_is_that_is_no_tlog(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "a.tlog"
    path.write_bytes(content)
    with pytest.raises(LogFormatError, match=says) as caught:
        open_log(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_says_what_is_wrong_with_a_path(tmp_path: Path) -> None:
    with pytest.raises(LogFormatError, match="no such file"):
        open_log(tmp_path / "none.tlog")
    with pytest.raises(LogFormatError, match="is a folder"):
        open_log(tmp_path)
    with pytest.raises(LogFormatError, match="does not exist: create it"):
        TlogWriter(tmp_path / "none" / "a.tlog")
    with pytest.raises(LogFormatError, match="cannot be written"):
        TlogWriter(tmp_path)


def test_writer_loses_at_most_a_second(tmp_path: Path) -> None:
    path = tmp_path / "a.tlog"
    some = [
        packet._replace(time_us=NOON_US + index * SECOND // 4)
        for index, packet in enumerate(packets(10))
    ]
    with TlogWriter(path) as writer:
        for index, packet in enumerate(some):
            writer.write(*packet)
            on_disk = list(TlogReader(path))
            assert on_disk == some[: len(on_disk)]
            assert len(on_disk) > index - 4


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_writer_on_a_full_disk() -> None:
    writer = TlogWriter("/dev/full")
    with pytest.raises(LogFormatError, match="No space left"):
        writer.write(*packets(1)[0])
    with pytest.raises(LogFormatError, match="No space left"):
        writer.close()


def test_mavlogdump_plays_what_we_write(tmp_path: Path) -> None:
    tool = Path(sys.executable).parent / "mavlogdump.py"
    if not tool.exists():
        pytest.skip("pymavlink's tools are not installed")
    path = tmp_path / "a.tlog"
    with TlogWriter(path) as writer:
        for packet in packets(5) + packets(5, start_us=NOON_US + 10 * SECOND, version=1):
            writer.write(*packet)
    run = subprocess.run(
        [sys.executable, str(tool), "--dialect=ardupilotmega", str(path)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert [line.split(": ")[1].split()[0] for line in run.stdout.splitlines()] == ["ALTITUDE"] * 10


@pytest.mark.parametrize("path", LONG_IF_LARGE)
def test_every_byte_of_a_real_log_is_accounted_for(path: Path) -> None:
    reader = TlogReader(path)
    read = sum(8 + len(packet.data) for packet in reader)
    failed = sum(
        number for cause, number in reader.counters.items() if cause is not FrameReject.JUNK
    )
    left = reader.size_bytes - read - reader.counters[FrameReject.JUNK]
    assert 0 <= left <= failed * 288
    assert (left == 0) == (failed == 0)


@pytest.mark.parametrize("path", LONG_IF_LARGE)
def test_finds_every_frame_that_pymavlink_finds(path: Path) -> None:
    theirs = pymavlink_packets(path)
    ours = Counter(packet.data for packet in TlogReader(path))
    assert ours.total() >= len(theirs)
    assert not Counter(packet.data for packet in theirs) - ours


def pymavlink_packets(path: Path) -> list[Packet]:
    from pymavlink import mavutil

    log: Any = mavutil.mavlogfile(str(path))
    found = []
    while (message := log.recv_msg()) is not None or log.f.tell() < log.filesize:
        if message is not None and not message.get_type().startswith(("BAD_DATA", "UNKNOWN")):
            found.append(Packet(round(message._timestamp * SECOND), bytes(message.get_msgbuf())))
    log.close()
    return found
