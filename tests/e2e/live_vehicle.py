"""A vehicle on a real socket or pseudo-terminal beside `kollsman run` in a process of its own."""

import os
import re
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable

from companion.mavlink.codec import Decoder, Message, mavlink
from tests import vehicle
from tests.vehicle import Vehicle

SETTING = 511
DEFAULTS_HZ = {"heartbeat": 1.0}
FULL_HZ = {"heartbeat": 1.0, "pressure": 10.0, "gps": 5.0, "imu": 40.0, "time": 1.0}
NAMES = {29: "pressure", 24: "gps", 27: "imu", 105: "imu", 2: "time", 33: "position"}
MAKERS: dict[str, Callable[[float], Message]] = {
    "heartbeat": lambda boot_s: vehicle.heartbeat(),
    "pressure": vehicle.pressure,
    "gps": vehicle.gps,
    "imu": vehicle.raw_imu,
    "time": vehicle.system_time,
    "position": lambda boot_s: mavlink.MAVLink_global_position_int_message(
        round(boot_s * 1e3), 470_000_000, 80_000_000, 507_123, 12_345, 0, 0, 0, 0
    ),
}


class Kollsman:
    """`kollsman run` as a user starts it."""

    def __init__(self, *arguments: str) -> None:
        command = [sys.executable, "-m", "companion.cli", "run", *arguments]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self.lines: list[str] = []
        self._interrupted = False
        self._ready = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        assert self._ready.wait(300.0), "\n".join(self.lines)

    def _read(self) -> None:
        assert self.process.stdout
        for line in self.process.stdout:
            self.lines.append(line.rstrip())
            if "ready in" in line:
                self._ready.set()
        self._ready.set()

    def interrupt(self) -> None:
        """Ctrl-C, once: a second one while it stops would end it at once."""
        if not self._interrupted and self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        self._interrupted = True

    def stop(self) -> int:
        self.interrupt()
        code = self.process.wait(15.0)
        self.close()
        return code

    def close(self) -> None:
        """End it, whatever it does."""
        self.process.kill()
        self.process.wait()
        self._reader.join()
        if self.process.stdout:
            self.process.stdout.close()

    @property
    def port(self) -> int:
        (line,) = [line for line in self.lines if "ready in" in line]
        found = re.search(r":(\d+); Ctrl-C", line)
        assert found
        return int(found[1])


class UdpWire:
    """A socket of the vehicle's. `listens`: it sends only to who spoke first, as a server does."""

    def __init__(self, *, listens: bool = False) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.peer: tuple[str, int] | None = None
        self._listens = listens

    def __call__(self, data: bytes) -> None:
        if self.peer is not None:
            self.socket.sendto(data, self.peer)

    def read(self) -> bytes:
        if not select.select([self.socket], [], [], 0.0)[0]:
            return b""
        data, sender = self.socket.recvfrom(65536)
        if self._listens:
            self.peer = sender
        return data

    def close(self) -> None:
        self.socket.close()


class PtyWire:
    """A serial cable. `asleep`: it sends nothing before a byte came, as PX4 on USB."""

    def __init__(self, *, asleep: bool = False) -> None:
        import pty
        import tty

        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.name = os.ttyname(self._slave)
        self._asleep = asleep

    def __call__(self, data: bytes) -> None:
        if not self._asleep:
            try:
                os.write(self._master, data)
            except BlockingIOError:
                return

    def read(self) -> bytes:
        try:
            data = os.read(self._master, 65536)
        except OSError:
            return b""
        self._asleep = False
        return data

    def close(self) -> None:
        os.close(self._master)
        os.close(self._slave)


class LiveVehicle:
    """Streams in real time, and obeys SET_MESSAGE_INTERVAL up to 40 Hz unless told otherwise."""

    def __init__(
        self, wire: UdpWire | PtyWire, *, answers: int | None = 0, **rates_hz: float
    ) -> None:
        self.wire = wire
        self.answers = answers
        self.rates_hz = dict(rates_hz or DEFAULTS_HZ)
        self.sender = Vehicle()
        self.alive = True
        self.heard: Counter[str] = Counter()
        self.intervals: list[tuple[int, float]] = []
        self.groups: list[int] = []
        self.texts: list[str] = []
        self.altitudes: list[Message] = []
        self.status: int | None = None
        self.boot_s = 30.0
        self._zero_s = time.monotonic() - 30.0
        self._due_s: dict[str, float] = {}
        self._decoder = Decoder()

    def reboot(self) -> None:
        """Its clock starts anew, and it forgets what was requested."""
        self._zero_s = time.monotonic() - 1.0
        self._due_s.clear()
        self.rates_hz = dict(DEFAULTS_HZ)

    def fly(self, duration_s: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Go on for so long, or until the condition holds."""
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s:
            self._stream()
            while data := self.wire.read():
                for frame in self._decoder.feed(data):
                    message = self._decoder.decode(frame)
                    if message is not None:
                        self._take(message)
            if until():
                return True
            time.sleep(0.005)
        return until()

    def send(self, message: Message, sender: Vehicle | None = None) -> None:
        self.wire((sender or self.sender).pack(message))

    def _stream(self) -> None:
        self.boot_s = time.monotonic() - self._zero_s
        for name, rate_hz in self.rates_hz.items():
            due_s = self._due_s.get(name, 0.0)
            if not self.alive or rate_hz <= 0 or self.boot_s < due_s:
                continue
            self._due_s[name] = max(due_s + 1 / rate_hz, self.boot_s - 0.1)
            self.send(MAKERS[name](self.boot_s))

    def _take(self, message: Message) -> None:
        name = message.get_type()
        self.heard[name] += 1
        if name == "ALTITUDE":
            self.altitudes.append(message)
        elif name == "STATUSTEXT":
            self.texts.append(message.text)
        elif name == "HEARTBEAT":
            self.status = message.system_status
        elif name == "REQUEST_DATA_STREAM" and self.alive:
            self.groups.append(message.req_stream_id)
            self.rates_hz = dict(FULL_HZ)
        elif name == "COMMAND_LONG" and message.command == SETTING and self.alive:
            self._interval(message)

    def _interval(self, message: Message) -> None:
        message_id, rate_hz = int(message.param1), 1e6 / message.param2 if message.param2 else 0.0
        self.intervals.append((message_id, rate_hz))
        if self.answers is None:
            return
        result = mavlink.MAV_RESULT_DENIED if rate_hz > 40 and not self.answers else self.answers
        stream = NAMES.get(message_id)
        if result == 0 and stream:
            self.rates_hz[stream] = rate_hz or 1.0
        answer = mavlink.MAVLink_command_ack_message(
            SETTING, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
        )
        self.send(answer)
