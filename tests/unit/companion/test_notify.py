"""Messages to systemd on a real datagram socket, and the unit that asks for them."""

import configparser
import shutil
import socket
import subprocess
from pathlib import Path

import pytest

from companion.notify import Notifier
from tests.paths import ROOT

UNIT = ROOT / "deploy" / "kollsman.service"


def test_messages_reach_the_socket(tmp_path: Path) -> None:
    path = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(path))
        notifier = Notifier(str(path))
        notifier.ready()
        notifier.alive("OK 120.0 m")
        notifier.stopping()
        notifier.close()
        received = [systemd.recv(1000) for _ in range(3)]
    assert received == [b"READY=1", b"WATCHDOG=1\nSTATUS=OK 120.0 m", b"STOPPING=1"]


def test_nothing_happens_without_systemd(tmp_path: Path) -> None:
    for address in ("", str(tmp_path / "gone")):
        notifier = Notifier(address)
        notifier.ready()
        notifier.close()


def test_unit_has_what_a_service_for_months_needs() -> None:
    unit = configparser.RawConfigParser(strict=False)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read_string(UNIT.read_text(encoding="utf-8"))
    service = unit["Service"]
    assert service["Type"] == "notify"
    assert service["Restart"] == "always"
    assert float(service["WatchdogSec"]) >= 5
    assert service["DynamicUser"] == "yes"
    assert service["CacheDirectory"] == "kollsman"
    assert "KOLLSMAN_CACHE=/var/cache/kollsman" in UNIT.read_text(encoding="utf-8")


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd here")
def test_systemd_accepts_the_unit() -> None:
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(UNIT)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "Unknown" not in done.stderr
