"""`kollsman run` beside `kollsman-sim fly` as PX4 and as an autopilot of no name, over UDP; and the
option itself."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from companion.evaluation.report import Collector
from companion.logs.tlog import TlogReader
from companion.pipeline import Pipeline
from companion.settings import CompanionSettings
from sim.studies.demo import Companion, free_port

FLY = [sys.executable, "-m", "sim.cli", "fly", "short-hop"]


def test_a_flavour_that_is_none_is_wrong_usage(tmp_path: Path) -> None:
    command = [*FLY, "--flavour", "betaflight", "--tlog", str(tmp_path / "x.tlog")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    said = "--flavour 'betaflight' is unknown: give one of ardupilot, copter, px4, generic"
    assert done.stderr == f"kollsman-sim: {said}\n"


@pytest.mark.long
@pytest.mark.parametrize("flavour", ["px4", "generic"])
def test_the_companion_with_it(flavour: str, tmp_path: Path) -> None:
    port, tlog, said = free_port(), tmp_path / "flight.tlog", tmp_path / "companion.txt"
    companion = Companion(f"udpin:127.0.0.1:{port}", said, lambda _: None)
    try:
        companion.wait_until_ready()
        command = [
            *FLY,
            "--flavour",
            flavour,
            "--link",
            f"udpout:127.0.0.1:{port}",
            "--speed",
            "10",
            "--tlog",
            str(tlog),
        ]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    finally:
        companion.stop()
    assert done.returncode == 0, done.stderr
    text = said.read_text()
    assert text.count("COMMAND_ACK") == 0
    assert "does not grant" not in text
    assert re.search(r"(?m)^OK +\d", text), text
    altitudes = re.search(r"1/191: .*ALTITUDE (\d+)", done.stdout)
    if flavour == "px4":
        assert altitudes is None, done.stdout  # PX4 sends its own
    else:
        assert altitudes is not None
        assert int(altitudes[1]) > 1500
    assert int(re.search(r"NAMED_VALUE_FLOAT (\d+)", done.stdout)[1]) > 500  # type: ignore[index]
    collector = Collector()
    pipeline = Pipeline(CompanionSettings(), datagrams=True, observer=collector)
    for packet in TlogReader(tlog):
        pipeline.feed(packet)
    estimate, gnss = collector.errors("estimate"), collector.errors("gnss")
    assert estimate is not None
    assert gnss is not None
    assert estimate.rmse_m < gnss.rmse_m
    assert estimate.max_m < 20
