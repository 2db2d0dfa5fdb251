"""The command `kollsman` as a user types it (in process; the live commands have tests of their
own)."""

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from companion import cli
from companion.logs.tlog import TlogReader
from companion.mavlink.codec import Decoder, mavlink


def call(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *arguments: str
) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of `kollsman ARGUMENTS`."""
    monkeypatch.setattr(sys, "argv", ["kollsman", *arguments])
    try:
        cli.main()
        code = 0
    except SystemExit as stop:
        code = int(stop.code or 0)
    out, err = capsys.readouterr()
    return code, out, err


@pytest.fixture
def kollsman(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):  # type: ignore[no-untyped-def]
    return lambda *arguments: call(capsys, monkeypatch, *map(str, arguments))


def test_replay_reports_errors_beside_the_others(kollsman, short_hop: Path) -> None:  # type: ignore[no-untyped-def]
    code, out, _ = kollsman("replay", short_hop)
    assert code == 0
    for label in (
        "Kollsman",
        "autopilot's own",
        "raw GNSS",
        "raw barometer",
        "error against truth",
        "ALTITUDE sent",
        "Altitude is known within",
    ):
        assert label in out


def test_replay_json_csv_and_log(kollsman, short_hop: Path, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    table, log = tmp_path / "a.csv", tmp_path / "a.tlog"
    code, out, _ = kollsman("replay", short_hop, "--json", "--smooth", "--csv", table, "--out", log)
    document = json.loads(out)
    assert code == 0
    assert document["schema"] == "kollsman-report/1"
    (report,) = document["sessions"]
    sources = report["sources"]
    assert report["reference"]["kind"] == "truth"
    assert sources["estimate"]["rmse_m"] < sources["gnss"]["rmse_m"] * 1.2
    assert sources["smoothed"]["rmse_m"] < sources["gnss"]["rmse_m"]
    assert report["samples"]["pressure"]["used"] > 4000
    lines = list(csv.DictReader(table.read_text().splitlines()))
    assert list(lines[0])[:3] == ["session", "utc", "time_us"]
    assert len(lines) > 5000
    last = lines[-1]
    assert abs(float(last["altitude_amsl_m"]) - float(last["truth_altitude_m"])) < 10.0
    assert 900.0 < float(last["qnh_hpa"]) < 1100.0
    assert last["verdict"] == "used"
    decoder = Decoder(datagrams=True)
    ours = [
        f
        for p in TlogReader(log)
        for f in decoder.feed(p.data)
        if f.message_id == mavlink.MAVLINK_MSG_ID_ALTITUDE
    ]
    assert len(ours) == report["altitude"]["published"]
    assert sum(1 for _ in TlogReader(log)) == sum(1 for _ in TlogReader(short_hop)) + len(
        ours
    ) + others(log)


def others(log: Path) -> int:
    """Frames of ours that are not ALTITUDE."""
    decoder = Decoder(datagrams=True)
    frames = [frame for packet in TlogReader(log) for frame in decoder.feed(packet.data)]
    return sum(
        frame.component_id == 191 and frame.message_id != mavlink.MAVLINK_MSG_ID_ALTITUDE
        for frame in frames
    )


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["replay", "/nowhere/flight.tlog"], 1, "flight.tlog"),
        (["replay", "{hop}", "--estimator", "magic"], 1, "adaptive-fusion"),
        (["replay", "{hop}", "--out", "{hop}"], 1, "is the log itself"),
        (["replay", "{hop}", "--csv", "/nowhere/a.csv"], 1, "does not exist: create it"),
        (["replay", "{hop}", "--expect", "max<9", "--junit", "{hop}"], 1, "is the log itself"),
        (["replay", "{hop}", "--csv", "a.csv", "--out", "a.csv"], 1, "named for two outputs"),
        (["replay", "{hop}", "--config", "/nowhere/c.yaml"], 1, "no such file"),
        (["run", "carrier-pigeon:1"], 1, "carrier-pigeon"),
        (["check", "/nowhere/c.yaml"], 1, "no such file"),
        (["fly"], 2, "fly"),
    ],
)
def test_mistakes_are_one_line(  # type: ignore[no-untyped-def]
    kollsman, short_hop: Path, arguments: list[str], code: int, says: str
) -> None:
    got, _, err = kollsman(*(argument.replace("{hop}", str(short_hop)) for argument in arguments))
    assert got == code
    assert says in err
    assert "Traceback" not in err
    if code == 1:
        assert len([line for line in err.splitlines() if line.startswith("kollsman:")]) == 1


def test_an_unreadable_log_does_not_stop_the_others(  # type: ignore[no-untyped-def]
    kollsman, short_hop: Path, tmp_path: Path
) -> None:
    empty = tmp_path / "[ü] {0}.tlog"
    empty.touch()
    code, out, err = kollsman("replay", str(empty), str(short_hop), "--json")
    first, second = json.loads(out)
    assert code == 1
    assert "the file is empty" in first["error"]
    assert not first["sessions"]
    assert len(second["sessions"]) == 1
    assert "1 of 2 logs could not be read" in err


def test_check_prints_what_it_resolved(kollsman, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    config = tmp_path / "companion.yaml"
    config.write_text("publish: {altitude_hz: 5}\n")
    code, out, _ = kollsman("check", config)
    assert code == 0
    assert "altitude_hz: 5.0" in out
    assert "component_id: 191" in out
    config.write_text("publish: {altitude_hz: 500}\n")
    code, _, err = kollsman("check", config)
    assert code == 1
    for part in ("companion.yaml:1", "publish.altitude_hz", "500", "from 0.1 to 100", "Hz"):
        assert part in err


@pytest.mark.parametrize("command", ["links", "estimators", "--version"])
def test_lists(kollsman, command: str) -> None:  # type: ignore[no-untyped-def]
    code, out, _ = kollsman(command)
    assert code == 0
    assert out.strip()


def test_help_imports_nothing_heavy() -> None:
    script = (
        "import sys; import companion.cli; print([m for m in ('numba', 'numpy', 'pymavlink') "
        "if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, env=os.environ
    )
    assert done.stdout.strip() == "[]"
