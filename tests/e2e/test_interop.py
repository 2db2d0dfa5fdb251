"""Clients that we did not write, against the simulated vehicle: MAVSDK (native, from its Python
wheel) and MAVProxy.

They live in an environment of their own, made once under the user's cache folder: MAVProxy is GPL
and large, and is run, never imported. Where it cannot be made, the tests are skipped with pip's
reason.
"""

import contextlib
import fcntl
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from sim.studies.demo import free_port
from sim.vehicle.flavours import FLAVOURS

pytestmark = pytest.mark.slow

REQUIREMENTS = ("mavsdk>=4,<5", "MAVProxy>=1.8.70")
INSTALL_TIMEOUT_S = 400.0
PATIENCE_S = 70.0
CLIENT = Path(__file__).parent / "mavsdk_client.py"


@pytest.fixture(scope="session")
def python() -> Path:
    """The interpreter of the clients' environment."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    key = hashlib.sha256(f"{REQUIREMENTS} {sys.version}".encode()).hexdigest()[:12]
    folder = cache / "kollsman" / f"interop-{key}"
    folder.parent.mkdir(parents=True, exist_ok=True)
    with (folder.parent / f"interop-{key}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        ready = folder / "ready"
        if not ready.exists():
            shutil.rmtree(folder, ignore_errors=True)
            _install(folder)
            ready.touch()
    return folder / "bin" / "python"


def _install(folder: Path) -> None:
    made = folder / "bin" / "python"
    pip = [
        str(made),
        "-m",
        "pip",
        "--disable-pip-version-check",
        "install",
        "--quiet",
        *REQUIREMENTS,
    ]
    for command in ([sys.executable, "-m", "venv", str(folder)], pip):
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=INSTALL_TIMEOUT_S, check=False
            )
        except subprocess.TimeoutExpired:
            pytest.skip(f"the clients cannot be installed: not done after {INSTALL_TIMEOUT_S:g} s")
        if done.returncode:
            reason = (done.stderr or done.stdout).strip().splitlines()[-1:]
            pytest.skip(f"the clients cannot be installed: {' '.join(reason)}")


class Running:
    """A process of ours with the lines that it has printed so far. What is expected of it comes in
    `patience_s`."""

    def __init__(
        self,
        command: list[str],
        *,
        patience_s: float = PATIENCE_S,
        cwd: Path | None = None,
        env: dict[str, str] | None = None,
    ) -> None:
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            cwd=cwd,
            env=env,
        )
        self._deadline_s = time.monotonic() + patience_s
        self.text = ""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        while part := self.process.stdout.readline():
            self.text += part

    def tell(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def expect(self, pattern: str, again: Callable[[], None] = lambda: None) -> "re.Match[str]":
        """Wait until it has printed `pattern`; meanwhile `again` is called every two seconds."""
        asked_s = 0.0
        while time.monotonic() < self._deadline_s:
            found = re.search(pattern, self.text)
            if found:
                return found
            if self.process.poll() is not None:
                break
            if time.monotonic() - asked_s > 2.0:
                again()
                asked_s = time.monotonic()
            time.sleep(0.05)
        raise AssertionError(f"{pattern!r} was not printed; what was:\n{self.text}")

    def end(self) -> str:
        """Ctrl-C; if that is not heeded within ten seconds, the end of its whole group."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(10)
        except subprocess.TimeoutExpired:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait(10)
        self._reader.join(10)
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()
        return self.text


@contextlib.contextmanager
def running(command: list[str], **options: Any) -> Iterator[Running]:
    process = Running(command, **options)
    try:
        yield process
    finally:
        process.end()


def vehicle(flavour: str, *links: str) -> list[str]:
    command = [
        sys.executable,
        "-m",
        "sim.cli",
        "fly",
        "short-hop",
        "--flavour",
        flavour,
        "--speed",
        "3",
    ]
    return command + [part for link in links for part in ("--link", link)]


def mavsdk(python: Path, port: int, parameter: str) -> dict[str, Any]:
    with running([str(python), str(CLIENT), f"udpin://127.0.0.1:{port}", parameter]) as client:
        found: dict[str, Any] = json.loads(client.expect(r"FOUND (\{.*\})\n")[1])
    return found


@pytest.mark.parametrize(
    ("flavour", "autopilot", "parameter"),
    [("ardupilot", 2, "RTL_ALTITUDE"), ("px4", 1, "NAV_ACC_RAD"), ("generic", 3, "LOITER_RADIUS")],
)
def test_mavsdk_discovers_reads_and_sets(
    python: Path, flavour: str, autopilot: int, parameter: str
) -> None:
    port = free_port()
    with running(vehicle(flavour, f"udpout:127.0.0.1:{port}")) as flight:
        found = mavsdk(python, port, parameter)
        summary = flight.end()
    table = {row.name: row.value for row in FLAVOURS[flavour].parameters}
    assert (found["system_id"], found["components"], found["autopilot"]) == (1, [1], autopilot)
    assert found["version"] == list(FLAVOURS[flavour].software[:2])
    assert found["latitude_deg"] == pytest.approx(47.0, abs=1e-3)
    assert found["absolute_altitude_m"] == pytest.approx(302.0, abs=20.0)
    assert found["before"] == pytest.approx(table[parameter])
    assert found["parameters"].keys() == table.keys()
    assert found["parameters"][parameter] == 12.5
    if flavour == "px4":
        assert found["mode"] == 3  # MAVSDK's HOLD: it understands the custom mode
        assert found["altitude_amsl_m"] == pytest.approx(found["absolute_altitude_m"], abs=5.0)
        assert found["altitude_monotonic_m"] == pytest.approx(302.0, abs=20.0)
    assert "PARAM_SET 1" in summary


def test_mavsdk_on_one_link_sees_the_companion_on_another(python: Path) -> None:
    ours, theirs = free_port(), free_port()
    command = [sys.executable, "-m", "companion.cli", "run", f"udpin:127.0.0.1:{ours}"]
    with running(command, patience_s=200.0) as companion:  # without a cache it compiles first
        companion.expect(r"ready")
        links = (f"udpout:127.0.0.1:{ours}", f"udpout:127.0.0.1:{theirs}")
        with running(vehicle("ardupilot", *links)) as flight:
            companion.expect(r"(?m)^OK ")
            found = mavsdk(python, theirs, "RTL_ALTITUDE")
            summary = flight.end()
    assert found["components"] == [1, 191]
    assert int(re.search(r"(\d+) of them sent on to another link", summary)[1]) > 20  # type: ignore[index]


def test_mavproxy_connects_and_shows(python: Path, tmp_path: Path) -> None:
    port = free_port()
    script = python.parent / "mavproxy.py"
    command = [
        str(python),
        str(script),
        f"--master=udpin:127.0.0.1:{port}",
        f"--state-basedir={tmp_path}",
    ]
    environment = {**os.environ, "HOME": str(tmp_path), "PYTHONUNBUFFERED": "1"}
    with (
        running(vehicle("ardupilot", f"udpout:127.0.0.1:{port}")),
        running(command, cwd=tmp_path, env=environment) as ground,
    ):
        ground.expect(r"online system 1")
        ground.expect(r"Mode MANUAL")
        ground.expect(r"EKF3 IMU0 origin set")
        ground.expect(rf"Received {len(FLAVOURS['ardupilot'].parameters)} parameters")
        ground.expect(r"WP_RADIUS +90", lambda: ground.tell("param show WP_RADIUS"))
        position = ground.expect(
            r"lat : (\d+), lon : \d+, alt : (\d+)",
            lambda: ground.tell("status GLOBAL_POSITION_INT"),
        )
        assert int(position[1]) == pytest.approx(470_000_000, abs=50_000)
        assert 280_000 < int(position[2]) < 560_000
        ground.expect(r"Requesting 0 waypoints", lambda: ground.tell("wp list"))
        ground.expect(r"link 1 OK .* 0 lost", lambda: ground.tell("link"))
