"""A vehicle in real time on a real socket or pseudo-terminal, and `kollsman run` as a process."""

import contextlib
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Protocol

from companion.mavlink.codec import Decoder, Message, decode, mavlink
from tests.paths import ROOT
from tests.vehicle import HEALTHY, Maker, Vehicle, attitude, system_time

STREAMS: Mapping[str, tuple[float, Maker]] = {
    **HEALTHY,
    "pressure": (10.0, HEALTHY["pressure"][1]),
    "imu": (20.0, HEALTHY["imu"][1]),
    "attitude": (10.0, attitude),
    "time": (1.0, system_time),
}


class Carrier(Protocol):
    """Bytes to and from the companion."""

    def send(self, data: bytes) -> None: ...
    def receive(self) -> bytes: ...
    def close(self) -> None: ...


class Udp:
    """The vehicle calls the companion's ``udpin``, or answers its ``udpout``."""

    def __init__(self, companion_port: int = 0) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self.port = self._socket.getsockname()[1]
        self._peer = ("127.0.0.1", companion_port)

    def send(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            self._socket.sendto(data, self._peer)

    def receive(self) -> bytes:
        try:
            data, self._peer = self._socket.recvfrom(65536)
        except OSError:
            return b""
        return data

    def close(self) -> None:
        self._socket.close()


class Pty:
    """The vehicle is the far side of a serial line; `path` is a lasting name of the near side."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._ends: tuple[int, int] | None = None
        self.plug()

    def plug(self) -> None:
        master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        self._ends = (master, slave)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(slave))

    def unplug(self) -> None:
        if self._ends is not None:
            ends, self._ends = self._ends, None
            self.path.unlink(missing_ok=True)
            for end in ends:
                os.close(end)

    close = unplug

    def send(self, data: bytes) -> None:
        if self._ends is not None:
            with contextlib.suppress(OSError):
                os.write(self._ends[0], data)

    def receive(self) -> bytes:
        if self._ends is None:
            return b""
        try:
            return os.read(self._ends[0], 65536)
        except OSError:
            return b""


class LiveVehicle:
    """Sends its streams in real time from a thread, and keeps what it hears with the time."""

    def __init__(
        self,
        carrier: Carrier,
        streams: Mapping[str, tuple[float, Maker]] = STREAMS,
        *,
        vehicle: Vehicle | None = None,
        answer: Callable[[Message], Message | None] | None = None,
        boot_s: float = 50.0,
    ) -> None:
        self.carrier = carrier
        self.vehicle = vehicle or Vehicle()
        self.heard: list[tuple[float, Message]] = []
        """(monotonic time, message)"""
        self.streams = dict(streams)
        self.paused = False
        self._answer = answer
        self._boot = time.monotonic() - boot_s
        self._due: dict[str, float] = {}
        self._decoder = Decoder()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def messages(self, name: str, since: float = 0.0) -> list[Message]:
        return [m for when, m in list(self.heard) if when >= since and m.get_type() == name]

    def times(self, name: str, since: float = 0.0) -> list[float]:
        return [when for when, m in list(self.heard) if when >= since and m.get_type() == name]

    def reboot(self) -> None:
        """The boot clock starts anew."""
        self._boot = time.monotonic()
        self._due.clear()

    def send(self, message: Message) -> None:
        self.carrier.send(self.vehicle.pack(message))

    def close(self) -> None:
        self._done.set()
        self._thread.join()
        self.carrier.close()

    def _work(self) -> None:
        while not self._done.wait(0.004):
            if not self.paused:
                self._send_due()
            while data := self.carrier.receive():
                self._take(data)

    def _send_due(self) -> None:
        boot_s = time.monotonic() - self._boot
        for name, (rate_hz, make) in list(self.streams.items()):
            due_s = self._due.get(name, boot_s)
            if boot_s < due_s:
                continue
            self._due[name] = max(due_s + 1.0 / rate_hz, boot_s - 0.2)
            message = make(boot_s)
            if message is not None:
                self.send(message)

    def _take(self, data: bytes) -> None:
        for frame in self._decoder.feed(data):
            message = decode(frame)
            if message is None:
                continue
            self.heard.append((time.monotonic(), message))
            answer = self._answer(message) if self._answer else None
            if answer is not None:
                self.send(answer)


def accept(message: Message) -> Message | None:
    """An autopilot that acknowledges every command (and keeps its rates)."""
    if message.get_type() != "COMMAND_LONG":
        return None
    return mavlink.MAVLink_command_ack_message(
        message.command, 0, 0, 0, message.get_srcSystem(), message.get_srcComponent()
    )


class Companion:
    """`kollsman run`, with what it printed."""

    def __init__(self, *arguments: str, environment: Mapping[str, str] | None = None) -> None:
        self.lines: list[str] = []
        self.process = subprocess.Popen(
            [sys.executable, "-m", "companion.cli", "run", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=ROOT,
            env={**os.environ, **(environment or {})},
        )
        self._ready = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout
        for line in self.process.stdout:
            self.lines.append(line.rstrip())
            if line.startswith("ready") or '"event": "ready"' in line:
                self._ready.set()

    def wait_ready(self, timeout_s: float = 240.0) -> None:
        """Until it serves; a process that ends before is told at once."""
        ends_s = time.monotonic() + timeout_s
        while not self._ready.wait(0.1) and time.monotonic() < ends_s:
            if self.process.poll() is not None:
                break
        if not self._ready.is_set():
            self.stop()
            raise AssertionError(self.lines)

    def stop(self, number: int = signal.SIGINT) -> int:
        if self.process.poll() is None:
            self.process.send_signal(number)
        code = self.process.wait(20)
        self._reader.join(5)
        assert self.process.stdout
        self.process.stdout.close()
        return code

    def __enter__(self) -> "Companion":
        self.wait_ready()
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()


def until(condition: Callable[[], object], timeout_s: float = 20.0) -> float:
    """Wait for a condition; how long it took in seconds."""
    started = time.monotonic()
    while not condition():
        elapsed_s = time.monotonic() - started
        assert elapsed_s < timeout_s, f"not within {timeout_s} s"
        time.sleep(0.01)
    return time.monotonic() - started


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def flying(port: int, **options: object) -> Iterator[LiveVehicle]:
    """A vehicle that calls ``udpin:127.0.0.1:port``."""
    vehicle = LiveVehicle(Udp(port), answer=accept, **options)  # type: ignore[arg-type]
    try:
        yield vehicle
    finally:
        vehicle.close()


def drained(descriptor: int) -> bytes:
    """What a descriptor holds now."""
    data = b""
    while select.select([descriptor], [], [], 0.0)[0]:
        chunk = os.read(descriptor, 65536)
        if not chunk:
            break
        data += chunk
    return data
