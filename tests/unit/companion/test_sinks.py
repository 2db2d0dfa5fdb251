"""CSV: its columns are an interface, unknown is an empty cell, and a full disk is one line."""

import csv
import math
from pathlib import Path

import pytest

from companion.errors import LogFormatError
from companion.samples import ESTIMATE, Kind, Rows, Verdict, rows, sample
from companion.sinks import COLUMNS, CsvSink, Observers
from tests.vehicle import feed, standing

SECOND_US = 1_000_000


def estimate(time_s: float = 1.0, altitude_m: float = 500.0) -> Rows:
    row = rows(ESTIMATE)
    row["time_us"], row["altitude_amsl_m"] = round(time_s * SECOND_US), altitude_m
    row["altitude_sd_m"] = 2.0
    return row


def lines(path: Path) -> list[list[str]]:
    with path.open(newline="", encoding="ascii") as file:
        return list(csv.reader(file))


def test_the_columns_begin_as_promised(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    with CsvSink(path, lambda: "OK") as sink:
        sink.sample(Kind.PRESSURE, sample(Kind.PRESSURE, 1), Verdict.USED, estimate())
    head, line = lines(path)
    assert head[:4] == ["time_us", "altitude_amsl_m", "climb_mps", "altitude_sd_m"]
    assert head == list(COLUMNS)
    assert len(line) == len(head)
    assert line[:4] == ["1000000", "500.0000", "", "2.0000"]
    assert line[-1] == "OK"


def test_only_new_estimates_are_written(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    row = sample(Kind.GNSS, 1)
    with CsvSink(path, lambda: "OK") as sink:
        sink.sample(Kind.GNSS, row, Verdict.GATED, estimate())
        sink.sample(Kind.STATUS, sample(Kind.STATUS, 1), Verdict.USED, estimate())
        sink.sample(Kind.GNSS, row, Verdict.USED, estimate(altitude_m=math.nan))
        sink.truth(1, 2.0, 3.0)
        sink.autopilot(1, 2.0, 3.0)
    assert len(lines(path)) == 1


def test_a_replay_into_two_observers(tmp_path: Path) -> None:
    """Ten seconds with five pressures, five fixes and ten IMU samples in each."""
    path = tmp_path / "out.csv"
    first = feed(standing(30, 40))
    with CsvSink(path, lambda: "OK") as sink:
        both = Observers([first, sink])
        first.pipeline.observe(both)
        before = len(first.samples)
        for packet in standing(40, 50):
            first.pipeline.feed(packet)
    found = lines(path)[1:]
    used = [
        kind
        for kind, _, verdict in first.samples[before:]
        if verdict is Verdict.USED and kind is not Kind.STATUS
    ]
    assert len(found) == len(used) == 200
    assert [int(line[0]) for line in found] == sorted(int(line[0]) for line in found)


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    path = tmp_path / "none" / "out.csv"
    with pytest.raises(LogFormatError, match=f"^{path}: cannot be written"):
        CsvSink(path, lambda: "OK")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such device")
@pytest.mark.parametrize("count", [1, 5000])
def test_a_full_disk_is_one_line(count: int) -> None:
    """At the first full buffer, or when the file is closed."""

    def fill() -> None:
        with CsvSink(Path("/dev/full"), lambda: "OK") as sink:
            for _ in range(count):
                sink.sample(Kind.PRESSURE, sample(Kind.PRESSURE, 1), Verdict.USED, estimate())

    with pytest.raises(
        LogFormatError, match=r"^/dev/full: cannot be written \(No space left on device\)$"
    ):
        fill()
