"""The commands as a user starts them: processes of their own, a real UDP socket, a serial line
(pseudo-terminal)."""

import os
import re
import select
import signal
import socket
import subprocess
import sys
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from companion.evaluation.report import Collector
from companion.logs.tlog import TlogReader
from companion.mavlink.codec import Decoder, mavlink
from companion.pipeline import Pipeline
from companion.settings import CompanionSettings

pytestmark = pytest.mark.slow

SPEED = "15"


@contextmanager
def companion(link: str, *options: str) -> Iterator[tuple["subprocess.Popen[str]", list[str]]]:
    """`kollsman run`, ready; ended with SIGINT."""
    command = [sys.executable, "-m", "companion.cli", "run", link, *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    lines: list[str] = []
    ready = threading.Event()

    def read() -> None:
        for line in process.stdout or ():
            lines.append(line.rstrip())
            if line.startswith("ready"):
                ready.set()

    reader = threading.Thread(target=read)
    reader.start()
    try:
        assert ready.wait(120), lines
        yield process, lines
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.wait(20)
        reader.join(20)
        assert process.stdout is not None
        process.stdout.close()


def fly(link: str, tlog: Path) -> str:
    command = [
        sys.executable,
        "-m",
        "sim.cli",
        "fly",
        "short-hop",
        "--link",
        link,
        "--speed",
        SPEED,
    ]
    done = subprocess.run(
        [*command, "--tlog", str(tlog)], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def received(tlog: Path) -> Collector:
    """Truth of the flight, and the ALTITUDE messages in its log."""
    collector, decoder = Collector(), Decoder(datagrams=True)
    pipeline = Pipeline(CompanionSettings(), datagrams=True, observer=collector)
    heard = Collector()
    for packet in TlogReader(tlog):
        pipeline.feed(packet)
        for frame in decoder.feed(packet.data):
            if frame.message_id == mavlink.MAVLINK_MSG_ID_ALTITUDE:
                heard.published(decoder.decode(frame))
    collector._tracks["published"] = heard._tracks["published"]
    return collector


def check_flight(tlog: Path, summary: str) -> None:
    """What both links must bring: ALTITUDE at 10 Hz of vehicle time, better than a barometer that
    is off."""
    count = int(re.search(r"1/191: ALTITUDE (\d+)", summary)[1])  # type: ignore[index]
    assert count > 1500
    collector = received(tlog)
    published = collector.errors("published")
    gnss = collector.errors("gnss")
    assert published is not None
    assert gnss is not None
    assert published.rmse_m < 1.2 * gnss.rmse_m
    assert published.max_m < 20


def test_flight_over_udp(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    recording = tmp_path / "live.tlog"
    with companion(f"udpin:127.0.0.1:{port}", "--record", str(recording)) as (process, lines):
        summary = fly(f"udpout:127.0.0.1:{port}", tmp_path / "flight.tlog")
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
    check_flight(tmp_path / "flight.tlog", summary)
    assert any(line.startswith("OK") for line in lines)
    assert any("stopped:" in line for line in lines)
    assert sum(1 for _ in TlogReader(recording)) > 5000


def test_flight_over_a_serial_line(tmp_path: Path) -> None:
    with serial_cable() as (near, far):
        with companion(f"{near}:921600") as (process, _):
            summary = fly(f"{far}:921600", tmp_path / "flight.tlog")
            process.send_signal(signal.SIGTERM)
            assert process.wait(20) == 0
        check_flight(tmp_path / "flight.tlog", summary)


@contextmanager
def serial_cable() -> Iterator[tuple[str, str]]:
    """Two pseudo-terminals joined back to back: what is written to one can be read from the
    other."""
    ends = [os.openpty() for _ in range(2)]
    for master, slave in ends:
        tty.setraw(master)
        tty.setraw(slave)
    masters = [master for master, _ in ends]
    done = threading.Event()

    def carry() -> None:
        while not done.is_set():
            for source in select.select(masters, [], [], 0.05)[0]:
                target = masters[1 - masters.index(source)]
                try:
                    os.write(target, os.read(source, 4096))
                except OSError:
                    done.wait(0.01)  # nobody has the other end open

    carrier = threading.Thread(target=carry)
    carrier.start()
    try:
        yield os.ttyname(ends[0][1]), os.ttyname(ends[1][1])
    finally:
        done.set()
        carrier.join()
        for pair in ends:
            for end in pair:
                os.close(end)


@pytest.mark.long
def test_demo(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "sim.cli",
        "demo",
        "--speed",
        "40",
        "--scenario",
        "short-hop",
        "--out",
        str(tmp_path),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert "Kollsman, as received" in done.stdout
    assert (tmp_path / "short-hop.png").stat().st_size > 10_000
