"""Endurance of the live page: simulated hours with open pages, and the memory meanwhile.

    python -m tests.page_endurance --hours 2 --speed 10      # twelve minutes

`kollsman run --http` beside flights of kollsman-sim, one after the other, with three readers of the
events, one of which reads nothing. Printed: the resident memory of the service each simulated ten
minutes, and its growth after the first.
"""

import argparse
import http.client
import os
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

from tests.live import Companion, free_port

SCENARIO = "weather-change"
PERIOD_S = 600.0


def read_events(port: int, done: threading.Event, counts: list[int], index: int) -> None:
    """Follow the events of one page; a page that reads nothing counts nothing."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", "/api/events")
    events = connection.getresponse()
    while not done.is_set():
        if index == 0:
            time.sleep(0.5)
            continue
        if not events.readline():
            return
        counts[index] += 1


def rss_mb(pid: int) -> float:
    """Resident memory of a process."""
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


def fly(port: int, speed: float, seed: int) -> "subprocess.Popen[bytes]":
    options = ["--link", f"udpout:127.0.0.1:{port}", "--speed", str(speed), "--seed", str(seed)]
    return subprocess.Popen(
        [sys.executable, "-m", "sim.cli", "fly", SCENARIO, *options],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=dict(os.environ),
    )


def run(hours: float, speed: float) -> float:
    """Print the memory; its growth in percent after the first period."""
    port, page = free_port(), free_port(socket.SOCK_STREAM)
    done, counts = threading.Event(), [0, 0, 0]
    measured: list[float] = []
    with Companion(f"udpin:127.0.0.1:{port}", "--http", str(page)) as companion:
        readers = [
            threading.Thread(target=read_events, args=(page, done, counts, k), daemon=True)
            for k in range(len(counts))
        ]
        for reader in readers:
            reader.start()
        flights, flight = 1, fly(port, speed, 1)
        started_s = time.monotonic()
        while (flown_s := (time.monotonic() - started_s) * speed) < hours * 3600.0:
            if flight.poll() is not None:
                flights += 1
                flight = fly(port, speed, flights)
            if flown_s >= len(measured) * PERIOD_S:
                measured.append(rss_mb(companion.process.pid))
                sys.stdout.write(f"{flown_s / 3600.0:5.2f} h  {measured[-1]:6.1f} MB\n")
                sys.stdout.flush()
            time.sleep(0.5)
        done.set()
        flight.send_signal(signal.SIGTERM)
        flight.wait(20)
    growth = 100.0 * (measured[-1] / measured[1] - 1.0) if len(measured) > 2 else 0.0
    sys.stdout.write(
        f"{flights} flights, {counts[1:]} lines of events read; growth after the first "
        f"ten minutes {growth:+.1f} %\n"
    )
    return growth


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--speed", type=float, default=10.0)
    options = parser.parse_args()
    sys.exit(run(options.hours, options.speed) > 5.0)
