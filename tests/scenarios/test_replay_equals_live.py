"""Frames decoded in columns give the same estimates, verdicts and messages, bit for bit, as the
bytes fed one packet at a time as live, on every tlog at hand and on a simulated flight."""

from pathlib import Path
from typing import Any

import pytest

from companion.evaluation.report import Collector
from companion.evaluation.samples import samples_of
from companion.logs import open_log
from companion.logs.tlog import TlogReader
from companion.mavlink.codec import Message
from companion.pipeline import Pipeline
from companion.samples import Kind, Rows, SampleLog, Verdict
from companion.settings import CompanionSettings
from tests.paths import DATA

QUICK_BYTES = 230_000
LOGS = [
    pytest.param(
        path, id=path.stem, marks=() if path.stat().st_size < QUICK_BYTES else pytest.mark.long
    )
    for path in sorted(DATA.glob("*/*.tlog"))
    if path.name != "raw_capture_taken_for_tlog.tlog"
]


class Taken(Collector):
    """Everything that happens, as bytes."""

    def __init__(self) -> None:
        super().__init__()
        self.log = SampleLog()
        self.seen: list[Any] = []

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        super().sample(kind, row, verdict, estimate)
        self.log.append(kind, row)
        self.seen.append((kind, row.tobytes(), verdict, estimate.tobytes()))

    def published(self, message: Message) -> None:
        super().published(message)
        self.seen.append(repr(message))


def both_ways(path: Path) -> tuple[Taken, Taken]:
    """What happens when `path` is fed as packets, and as decoded frames."""
    live, replayed = Taken(), Taken()
    slow = Pipeline(CompanionSettings(), datagrams=True, observer=live)
    fast = Pipeline(CompanionSettings(), datagrams=True, observer=replayed)
    for packet in TlogReader(path):
        live.seen.append(slow.feed(packet))
    for time_us, frame in open_log(path).items(fast.wanted):
        replayed.seen.append(fast.feed_item(frame, time_us))
    assert slow.heard == fast.heard
    assert slow.verdicts == fast.verdicts
    assert slow.identity.counters == fast.identity.counters
    assert slow.decoder.counters == fast.decoder.counters
    return live, replayed


def same(path: Path) -> None:
    live, replayed = both_ways(path)
    assert live.seen == replayed.seen
    for name in ("truth", "autopilot", "published", "estimate"):
        assert live.track(name).tobytes() == replayed.track(name).tobytes()
    samples = samples_of(path)
    for ours, theirs in zip(samples.tables, live.log.tables, strict=True):
        assert ours.tobytes() == theirs.tobytes()


def test_a_simulated_flight(short_hop: Path) -> None:
    same(short_hop)


@pytest.mark.parametrize("path", LOGS)
def test_every_log_at_hand(path: Path) -> None:
    same(path)
