"""Messages to systemd: ready, alive, stopping, and the status that ``systemctl status`` shows.

Without ``NOTIFY_SOCKET`` in the environment nothing is sent. The protocol is one datagram of
``NAME=VALUE`` lines (sd_notify(3)); it never raises and never blocks.
"""

import contextlib
import os
import socket


class Notifier:
    """Sends the state of this process to systemd."""

    def __init__(self, address: str | None = None) -> None:
        address = address if address is not None else os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket: socket.socket | None = None
        if self._address:
            with contextlib.suppress(OSError):
                self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
                self._socket.setblocking(False)

    def ready(self) -> None:
        """The service is up."""
        self._send("READY=1")

    def alive(self, status: str) -> None:
        """The loop runs: call more often than WatchdogSec."""
        self._send(f"WATCHDOG=1\nSTATUS={status[:200]}")

    def stopping(self) -> None:
        """The service ends in order."""
        self._send("STOPPING=1")

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, text: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(text.encode(), self._address)
