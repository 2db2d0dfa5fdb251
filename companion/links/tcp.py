"""TCP: `TcpClient` connects to a server, `TcpServer` serves one client at a time."""

import os
import socket
from errno import EINPROGRESS

from companion.clock import Clock
from companion.links.base import Backoff, HasFileno, readable, writable
from companion.links.sockets import listener, resolve
from companion.links.stream import ByteStream, StreamLink
from companion.links.urls import Endpoint

CONNECT_TIMEOUT_S = 2.0
"""Time after which a host that does not answer is tried again."""
SILENCE_S = 5.0
"""Time of silence after which a client is replaced by the next one (MAVLink sends a heartbeat each
second)."""


def _tuned(connection: socket.socket) -> socket.socket:
    """Send small frames at once; detect a peer that vanished silently after about 11 s."""
    options = {
        "TCP_NODELAY": 1,
        "TCP_KEEPIDLE": 5,
        "TCP_KEEPINTVL": 2,
        "TCP_KEEPCNT": 3,
        "TCP_USER_TIMEOUT": 11_000,
    }
    try:
        connection.setblocking(False)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in options.items():
            if hasattr(socket, option):  # not on every system
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
    except OSError:
        connection.close()
        raise
    return connection


class TcpClient(StreamLink):
    """Connects, and connects again when the server closes the connection.

    The name is resolved for every attempt, because a restarted container has a new address; the
    addresses of a host are tried in turn. While DNS is unreachable, resolving a name (never a
    numeric address) can block.
    """

    def __init__(self, endpoint: Endpoint, clock: Clock) -> None:
        super().__init__(str(endpoint), clock)
        self._endpoint = endpoint
        self._calling: socket.socket | None = None
        self._give_up_us = 0
        self._calls = 0
        resolve(
            endpoint, socket.SOCK_STREAM
        )  # a host that does not exist: an error now, an outage later

    def _dial(self, timeout_s: float) -> ByteStream | None:
        """An attempt may outlast this method, so that a short `receive` does not cut off a slow
        handshake."""
        if self._calling is None:
            self._calling = self._call()
            self._give_up_us = self._clock.now_us() + round(CONNECT_TIMEOUT_S * 1e6)
        if not writable(self._calling, timeout_s) and self._clock.now_us() < self._give_up_us:
            return None
        connection, self._calling = self._calling, None
        try:
            self._check(connection)
        except OSError:
            connection.close()
            raise
        return connection

    def _call(self) -> socket.socket:
        addresses = resolve(self._endpoint, socket.SOCK_STREAM)
        family, address = addresses[self._calls % len(addresses)]
        self._calls += 1
        connection = _tuned(socket.socket(family, socket.SOCK_STREAM))
        error = connection.connect_ex(address)
        if error not in (0, EINPROGRESS):
            connection.close()
            raise OSError(error, os.strerror(error))
        return connection

    @staticmethod
    def _check(connection: socket.socket) -> None:
        error = connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if error:
            raise OSError(error, os.strerror(error))
        if connection.getpeername() == connection.getsockname():  # OSError when still unconnected
            raise ConnectionRefusedError("connected to itself: nobody listens on this local port")

    def _close(self) -> None:
        if self._calling is not None:
            self._calling.close()
            self._calling = None
        super()._close()


class TcpServer(StreamLink):
    """Serves one client. The next client waits until the first one disconnects, or replaces it once
    it is silent."""

    def __init__(self, endpoint: Endpoint, clock: Clock) -> None:
        self._listener = listener(endpoint, socket.SOCK_STREAM)
        url = str(endpoint._replace(number=self._listener.getsockname()[1]))
        super().__init__(
            url, clock, Backoff(clock, first_s=0.05, longest_s=0.05)
        )  # it is the clients who wait
        self._heard_us = clock.now_us()

    def _dial(self, timeout_s: float) -> ByteStream | None:
        if not readable(self._listener, timeout_s):
            return None
        connection, _ = self._listener.accept()
        self._heard_us = self._clock.now_us()
        return _tuned(connection)

    def descriptors(self) -> list[HasFileno]:
        return [*super().descriptors(), self._listener] if self._stream is None else [self._stream]

    def _receive(self, timeout_s: float) -> bytes:
        silent_s = (self._clock.now_us() - self._heard_us) / 1e6
        if self._stream is not None and silent_s > SILENCE_S and readable(self._listener, 0.0):
            self._hang_up("silent, and another client calls")
        data = super()._receive(timeout_s)
        if data:
            self._heard_us = self._clock.now_us()
        return data

    def _close(self) -> None:
        self._listener.close()
        super()._close()
