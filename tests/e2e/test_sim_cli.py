"""The command ``kollsman-sim`` as a user runs it: a process, its output, its files, its exit
code."""

import hashlib
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

import pytest

from companion.logs.tlog import TlogReader
from companion.mavlink.codec import Decoder
from sim.flight import Flight
from sim.scenario import load_scenario
from tests.paths import ROOT

REPOSITORY = ROOT
STANDING = "name: standing\nsummary: of a test\nprofile:\n  - {leg: wait, duration_s: 15}\n"


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "sim.cli", *arguments]


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(REPOSITORY), "COLUMNS": "120"}


def run(*arguments: str, cwd: Path, timeout_s: float = 60) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        command(*arguments),
        cwd=cwd,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
    )


def test_fly_writes_the_same_bytes_in_every_process_and_nothing_else(tmp_path: Path) -> None:
    result = run("fly", "short-hop", "--tlog", "hop.tlog", "--seed", "5", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith("flown: 3 min")  # JSBSim's banner stays silent
    assert "RAW_IMU" in result.stdout
    assert result.stderr == ""
    assert [path.name for path in tmp_path.iterdir()] == ["hop.tlog"]
    here = tmp_path / "here.tlog"
    Flight(load_scenario("short-hop"), tlog=here, seed=5).run()
    hashes = [
        hashlib.sha256(path.read_bytes()).hexdigest() for path in (here, tmp_path / "hop.tlog")
    ]
    assert hashes[0] == hashes[1]


def test_expectations_of_a_flight_are_an_exit_code_and_a_junit_file(tmp_path: Path) -> None:
    (tmp_path / "stand.yaml").write_text(STANDING.replace("15}", "75}"))
    conditions = ("--expect", "max<50", "--expect", "rmse<0.001", "--junit", "found.xml")
    result = run("fly", "stand.yaml", "--tlog", "a.tlog", *conditions, cwd=tmp_path, timeout_s=300)
    assert result.returncode == 3
    assert "a.tlog session 1: max<50 met" in result.stdout
    assert "a.tlog session 1: rmse<0.001 NOT met" in result.stderr
    suite = ElementTree.parse(tmp_path / "found.xml").getroot()
    assert suite.attrib["tests"] == "2"
    assert suite.attrib["failures"] == "1"
    assert [case.attrib["name"] for case in suite] == ["max<50", "rmse<0.001"]
    nothing = run("fly", "stand.yaml", "--tlog", "b.tlog", "--expect", "worst<1", cwd=tmp_path)
    assert nothing.returncode == 1
    assert "worst<1" in nothing.stderr
    link = run(
        "fly", "stand.yaml", "--link", "udpout:127.0.0.1:9", "--expect", "max<1", cwd=tmp_path
    )
    assert link.returncode == 2


def test_a_scenario_file_of_one_s_own(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(STANDING)
    result = run("fly", "mine.yaml", "--tlog", "mine.tlog", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "flown: 0 min 15.0 s" in result.stdout


def test_the_documented_scenario_flies_twice_to_the_same_bytes(tmp_path: Path) -> None:
    """What a test engineer does who follows docs/scenarios.md: its file, its first two commands."""
    page = (REPOSITORY / "docs" / "scenarios.md").read_text(encoding="utf-8")
    (tmp_path / "my-approach.yaml").write_text(page.split("```yaml\n")[1].split("```")[0])
    for name in ("first.tlog", "second.tlog"):
        assert f"kollsman-sim fly my-approach.yaml --tlog {name}" in page
        result = run("fly", "my-approach.yaml", "--tlog", name, cwd=tmp_path)
        assert result.returncode == 0, result.stderr
    first, second = ((tmp_path / name).read_bytes() for name in ("first.tlog", "second.tlog"))
    assert first == second
    assert len(first) > 500_000


@pytest.mark.parametrize(
    ("arguments", "code", "complaint"),
    [
        (
            ["fly", "short-hop"],
            2,
            "nothing receives the flight: give a --link URL, a --tlog FILE, or both",
        ),
        (
            ["fly", "short-hop", "--tlog", "x.tlog", "--speed", "fast"],
            2,
            "--speed 'fast' is not valid",
        ),
        (
            ["fly", "nothing", "--tlog", "x.tlog"],
            1,
            "no scenario 'nothing': there are airliner-descent",
        ),
        (["fly", "none.yaml", "--tlog", "x.tlog"], 1, "none.yaml: no such file"),
        (["fly", "short-hop", "--link", "pigeon:1"], 1, "unknown scheme 'pigeon'"),
        (["fly", "short-hop", "--tlog", "no/folder/x.tlog"], 1, "no/folder/x.tlog"),
    ],
)
def test_a_mistake_is_one_line_and_an_exit_code(
    arguments: list[str], code: int, complaint: str, tmp_path: Path
) -> None:
    result = run(*arguments, cwd=tmp_path)
    assert result.returncode == code
    assert result.stdout == ""
    assert result.stderr.startswith("kollsman-sim: ")
    assert result.stderr.count("\n") == 1
    assert complaint in result.stderr


def test_corrupt_writes_the_same_bytes_every_time(short_hop: Path, tmp_path: Path) -> None:
    arguments = ("--fault", "outage:start_s=60,duration_s=20", "--fault", "drop:probability=0.2")
    for name in ("a.tlog", "b.tlog"):
        result = run("corrupt", str(short_hop), name, *arguments, cwd=tmp_path)
        assert result.returncode == 0, result.stderr
        assert result.stderr == ""
        assert " packets written, " in result.stdout
    assert (tmp_path / "a.tlog").read_bytes() == (tmp_path / "b.tlog").read_bytes()
    assert len(list(TlogReader(tmp_path / "a.tlog"))) < len(list(TlogReader(short_hop)))
    listed = run("corrupt", "--list", cwd=tmp_path)
    assert listed.returncode == 0
    for name in ("drop", "blocked_static_port", "spoofing", "jump_s", "half_pressure", "start_s"):
        assert name in listed.stdout


@pytest.mark.parametrize(
    ("arguments", "code", "complaint"),
    [
        (["in.tlog", "out.tlog"], 2, "give IN.tlog, OUT.tlog and at least one --fault NAME"),
        (["in.tlog", "in.tlog", "--fault", "drop"], 1, "in.tlog: is the log to be read"),
        (["none.tlog", "out.tlog", "--fault", "drop"], 1, "none.tlog: no such file"),
        (["in.tlog", "no/folder.tlog", "--fault", "drop"], 1, "the folder no does not exist"),
        (["in.tlog", "out.tlog", "--fault", "drp"], 1, "'drp' is unknown; did you mean `drop`?"),
        (["text.tlog", "out.tlog", "--fault", "drop"], 1, "text.tlog: not a telemetry log"),
    ],
)
def test_a_mistake_of_corrupt_is_one_line(
    arguments: list[str], code: int, complaint: str, short_hop: Path, tmp_path: Path
) -> None:
    (tmp_path / "in.tlog").write_bytes(short_hop.read_bytes()[:10_000])
    (tmp_path / "text.tlog").write_text("not a log\n" * 100)
    result = run("corrupt", *arguments, cwd=tmp_path)
    assert result.returncode == code
    assert result.stderr.startswith("kollsman-sim: ")
    assert result.stderr.count("\n") == 1
    assert complaint in result.stderr


def test_list_shows_every_scenario(tmp_path: Path) -> None:
    result = run("list", cwd=tmp_path)
    assert result.returncode == 0
    for name in ("calm-circuit", "short-hop", "weather-change"):
        assert name in result.stdout


def test_help_is_quick_and_has_examples(tmp_path: Path) -> None:
    elapsed_s = []
    for _ in range(3):
        begun_s = time.perf_counter()
        result = run("fly", "--help", cwd=tmp_path)
        elapsed_s.append(time.perf_counter() - begun_s)
    assert "kollsman-sim fly short-hop --tlog hop.tlog" in result.stdout
    assert min(elapsed_s) < 1.0  # 0.2 s here; no JSBSim, no NumPy: those take 0.6 s
    modules = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys, sim.cli; print({'numpy', 'jsbsim', 'pymavlink'} & set(sys.modules))",
        ],
        env=environment(),
        capture_output=True,
        text=True,
        check=True,
    )
    assert modules.stdout.strip() == "set()"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_live_flight_in_good_order(number: signal.Signals, tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(30.0)
        url = f"udpout:127.0.0.1:{listener.getsockname()[1]}"
        arguments = command(
            "fly",
            "short-hop",
            "--link",
            url,
            "--speed",
            "20",
            "--tlog",
            "live.tlog",
            "--all-streams",
        )
        process = subprocess.Popen(
            arguments,
            cwd=tmp_path,
            env=environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        decoder = Decoder(datagrams=True)
        names: set[str] = set()
        while len(names) < 5:
            messages = map(decoder.decode, decoder.feed(listener.recv(65535)))
            names |= {message.get_type() for message in messages if message is not None}
        process.send_signal(number)
        output, errors = process.communicate(timeout=30)
    assert process.returncode == 0, errors
    assert output.startswith("stopped: ")
    assert "heard: nothing" in output
    assert "HEARTBEAT" in names
    reader = TlogReader(tmp_path / "live.tlog")
    assert len(list(reader)) > 5
    assert reader.counters.total() == 0
