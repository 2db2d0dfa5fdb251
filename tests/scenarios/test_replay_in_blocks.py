"""A replay in blocks gives what the pipeline gives for one message at a time: sessions, rows with
estimates, counts and texts, byte for byte, on a simulated flight and every log at hand."""

import contextlib
import itertools
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.errors import LogFormatError
from companion.logs import FORMATS, open_log
from companion.logs.encoding import encoder_of
from companion.logs.tlog import TlogReader, TlogWriter, record
from companion.mavlink.codec import Frame, Message, mavlink
from companion.mavlink.framing import CRC_EXTRA, V1_LENGTHS, mcrf4xx
from companion.mavlink.identity import Origin
from companion.observer import Observer
from companion.pipeline import Pipeline
from companion.replay.record import Recording
from companion.replay.run import replay
from companion.replay.sessions import Session, sessions_of
from companion.samples import Kind, Rows, Verdict
from companion.settings import CompanionSettings
from tests import logfiles
from tests.paths import DATA, ROOT

QUICK_BYTES = 230_000
ALTITUDE, STATUSTEXT = mavlink.MAVLINK_MSG_ID_ALTITUDE, mavlink.MAVLINK_MSG_ID_STATUSTEXT
HEIGHTS = (mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE, mavlink.MAVLINK_MSG_ID_GPS_RAW_INT)
LOGS = [
    pytest.param(
        path, id=path.name, marks=() if path.stat().st_size < QUICK_BYTES else pytest.mark.long
    )
    for path in sorted(DATA.glob("*/*.*"))
    if path.suffix in (".tlog", ".bin", ".log", ".ulg")
]


class Single:
    """A `Recording` that takes no blocks."""

    def __init__(self, pipeline: Pipeline) -> None:
        self.kept = Recording(pipeline)

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        self.kept.sample(kind, row, verdict, estimate)

    def truth(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        self.kept.truth(time_us, altitude_amsl_m, climb_mps)

    def autopilot(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        self.kept.autopilot(time_us, altitude_amsl_m, climb_mps)

    def published(self, message: Message) -> None:
        self.kept.published(message)


def everything(session: Session[Any], kept: Recording) -> dict[str, Any]:
    """All that a session holds, in a form that can be compared."""
    names = ("vehicle", "autopilot", "first_us", "last_us", "samples", "left_out", "heard",
             "health", "reason", "notes", "rebooted")  # fmt: skip
    return {name: getattr(session, name) for name in names} | {
        "rows": kept.rows.tobytes(),
        "truth": kept.heights(truth=True).tobytes(),
        "autopilot's": kept.heights(truth=False).tobytes(),
        "published": kept.published_count,
        "armed": kept.armed,
        "measured": [np.asarray(each).tobytes() for each in vars(kept.measured()).values()],
        "unix": kept.unix_offset_us,
        "rates": Counter(kept.rates),
        "texts": kept.events.texts,
        "modes": kept.events.modes,
        "radio": session.link.radio,
        "link": [session.link.of(sender) for sender in ((1, 1), session.vehicle)],
    }


def replayed(path: Path, settings: CompanionSettings, observer: type[Any]) -> list[dict[str, Any]]:
    def make(changed: CompanionSettings, seen: Observer) -> Pipeline:
        return Pipeline(changed, datagrams=True, observer=seen, sends=False)

    try:
        found = sessions_of(open_log(path), settings, observer, make)
    except LogFormatError as error:
        return [{"error": str(error)}]
    return [everything(each, getattr(each.seen, "kept", each.seen)) for each in found]


def same(path: Path, **changes: Any) -> None:
    settings = CompanionSettings().with_changes(**changes)
    assert replayed(path, settings, Recording) == replayed(path, settings, Single)


@pytest.mark.parametrize("estimator", ["vertical-bank", "adaptive-fusion"])
def test_a_simulated_flight(short_hop: Path, estimator: str) -> None:
    same(short_hop, estimator=estimator)


@pytest.mark.parametrize(
    "assignments",
    [("air.qnh_hpa=1010",), ("air.field_elevation_m=300", "air.temperature_c=12")],
    ids=["qnh", "field"],
)
def test_known_air(short_hop: Path, tmp_path: Path, assignments: tuple[str, ...]) -> None:
    """What is told of the air, at rest again and again, interrupts the loops only when it is."""
    piece = tmp_path / "piece.tlog"
    piece.write_bytes(short_hop.read_bytes()[:500_000])
    settings = CompanionSettings(estimator="adaptive-fusion").with_assignments(assignments)
    assert replayed(piece, settings, Recording) == replayed(piece, settings, Single)


def test_a_vehicle_that_signs(short_hop: Path, tmp_path: Path) -> None:
    """Signed for a while, with unsigned frames between and long after."""
    path, start_us = tmp_path / "signed.tlog", 0
    with TlogWriter(path) as writer:
        for count, packet in enumerate(itertools.islice(TlogReader(short_hop), 6000)):
            start_us = start_us or packet.time_us
            passed_s = (packet.time_us - start_us) * 1e-6
            signs = 5.0 < passed_s < 15.0 and count % 7
            writer.write(packet.time_us, signed(packet.data) if signs else packet.data)
    same(path, estimator="adaptive-fusion")
    pipeline = Pipeline(CompanionSettings(), datagrams=True, sends=False)
    for packet in TlogReader(path):
        pipeline.feed(packet)
    assert pipeline.identity.counters[Origin.FORGED] > 100


def signed(data: bytes) -> bytes:
    """The frame with a signature, which nobody checks here."""
    body = bytes([data[1], 1]) + data[3:-2]
    extra = CRC_EXTRA[int.from_bytes(data[7:10], "little")]
    return data[:1] + body + mcrf4xx(body + bytes([extra])).to_bytes(2, "little") + bytes(13)


@pytest.mark.parametrize("name", sorted(set(FORMATS) - {"tlog"}))
def test_a_log_of_every_format(name: str, tmp_path: Path) -> None:
    path, _ = logfiles.write(name, tmp_path, duration_s=60.0)
    same(path)


class Kept:
    """A writer of one frame at a time, so that a replay takes one message at a time."""

    def __init__(self) -> None:
        self.records = b""

    def write(self, time_us: int, frame: bytes) -> None:
        self.records += record(time_us, frame)


class KeptRecords(Kept):
    """A writer of many frames at a time."""

    def write_records(self, records: bytes, time_us: int) -> None:
        self.records += records


def merged(path: Path, settings: CompanionSettings, writer: Kept) -> bytes:
    encoder_of.cache_clear()  # its sequence numbers go on
    replay(path, settings, writer=writer)
    return writer.records


def same_output(path: Path, *assignments: str) -> bytes:
    """The merged log, the same in blocks as one message at a time."""
    settings = CompanionSettings(estimator="adaptive-fusion").with_assignments(assignments)
    blocks = merged(path, settings, KeptRecords())
    assert blocks == merged(path, settings, Kept())
    return blocks


@pytest.mark.parametrize(
    "assignments",
    [(), ("publish.debug_hz=20", "health.sd_ok_m=1.5"), ("publish.statustext=false",)],
)
def test_the_merged_log(short_hop: Path, tmp_path: Path, assignments: tuple[str, ...]) -> None:
    """Our messages in it, with their sequence numbers; texts that wait; heights of ours and the
    vehicle's own by turns; and once more on what came out, whose messages of ours are replaced."""
    piece = tmp_path / "piece.tlog"
    with TlogWriter(piece) as writer:
        first_us = 0
        for packet in itertools.islice(TlogReader(short_hop), 8000):
            first_us = first_us or packet.time_us
            is_silent = 10e6 < packet.time_us - first_us < 16e6
            if not is_silent or packet.data[7] not in HEIGHTS:
                writer.write(packet.time_us, packet.data)
    found = same_output(piece, *assignments)
    again = tmp_path / "again.tlog"
    again.write_bytes(found)
    frames = (frame for _, frame in TlogReader(again).items(()) if isinstance(frame, Frame))
    ours = Counter(frame.message_id for frame in frames if frame.component_id == 191)
    assert ours[ALTITUDE] > 100
    assert (ours[STATUSTEXT] > 2) == ("publish.statustext=false" not in assignments)
    if not assignments:
        assert merged(again, CompanionSettings(estimator="adaptive-fusion"), KeptRecords()) == found


@pytest.mark.parametrize("name", ["bin", "ulg"])
def test_the_merged_log_of_another_format(name: str, tmp_path: Path) -> None:
    path, _ = logfiles.write(name, tmp_path, duration_s=20.0)
    assert same_output(path)


def test_the_merged_log_of_a_vehicle_that_begins_with_mavlink_1(
    short_hop: Path, tmp_path: Path
) -> None:
    """Ours are of the version that the vehicle speaks, from its first frame of 2 on."""
    path = tmp_path / "versions.tlog"
    with TlogWriter(path) as writer:
        for count, packet in enumerate(itertools.islice(TlogReader(short_hop), 6000)):
            old = count < 3000 and packet.data[8] == packet.data[9] == 0
            writer.write(packet.time_us, of_version_1(packet.data) if old else packet.data)
    same_output(path)


def of_version_1(data: bytes) -> bytes:
    """The frame in MAVLink 1, without its extension fields."""
    size = V1_LENGTHS[data[7]].start
    payload = data[10:-2][:size].ljust(size, b"\0")
    body = bytes([size, data[4], data[5], data[6], data[7]]) + payload
    crc = mcrf4xx(body + bytes([CRC_EXTRA[data[7]]]))
    return b"\xfe" + body + crc.to_bytes(2, "little")


@pytest.mark.parametrize("path", LOGS)
def test_every_log_at_hand(path: Path) -> None:
    same(path)
    if path.suffix == ".tlog":
        with contextlib.suppress(LogFormatError):
            same_output(path)


@pytest.mark.slow
def test_uncompiled_it_is_the_same(short_hop: Path, tmp_path: Path) -> None:
    """Half a minute of the flight in a process without compilation."""
    piece = tmp_path / "piece.tlog"
    piece.write_bytes(short_hop.read_bytes()[:150_000])
    script = (
        "import sys, hashlib; from pathlib import Path; import numpy as np; "
        "from companion.replay.run import replay; "
        "from companion.settings import CompanionSettings; "
        "found = replay(Path(sys.argv[1]), CompanionSettings(estimator='adaptive-fusion')); "
        "rows = np.asarray(found.sessions[0].seen.rows); "
        "print(rows.size, hashlib.sha256(np.ascontiguousarray(rows).tobytes()).hexdigest())"
    )
    printed = {
        subprocess.check_output(
            [sys.executable, "-c", script, str(piece)],
            env=os.environ | {"NUMBA_DISABLE_JIT": flag},
            cwd=ROOT,
        )
        for flag in ("0", "1")
    }
    assert len(printed) == 1
