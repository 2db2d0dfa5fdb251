"""UDP: `UdpIn` waits for peers and answers them, `UdpOut` sends first. `receive` returns one
datagram."""

import contextlib
import socket
import time
from dataclasses import dataclass

from companion.clock import Clock
from companion.errors import LinkError
from companion.links.base import Backoff, BaseLink, HasFileno, Incoming, LinkState, readable
from companion.links.sockets import Address, listener, resolve
from companion.links.urls import Endpoint

KNOWN_AFTER = 3
"""datagrams with MAVLink after which a peer is known"""
NEW_PEER_LIFETIME_S = 5.0
PEER_LIFETIME_S = 60.0
"""Time of silence after which a peer is forgotten; that of mavp2p."""
CHECK_US = 100_000
"""interval at which silent peers are looked for"""
MAX_PEERS = 16
DATAGRAM_SIZE = 65535
RECEIVE_BUFFER_SIZE = 1 << 20
"""Size that holds several seconds of telemetry; the kernel grants at most its net.core.rmem_max."""


@dataclass
class _Peer:
    """A sender, and the number of its datagrams."""

    heard_us: int = 0
    count: int = 0

    @property
    def is_known(self) -> bool:
        return self.count >= KNOWN_AFTER


class UdpIn(BaseLink):
    """Listens, and sends to every peer whose MAVLink was heard (`trust`) in the last 60 s, so that
    a vehicle that returns on another port and a ground station beside it both receive our messages.

    A forged source address could make us flood its owner: after one datagram a peer is sent to for
    five seconds, after three for a minute. With more than 16 peers the one that has been silent
    longest is forgotten, new ones first.
    """

    def __init__(self, endpoint: Endpoint, clock: Clock) -> None:
        self._socket = listener(endpoint, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_SIZE)
        super().__init__(str(endpoint._replace(number=self._socket.getsockname()[1])), clock)
        self._incoming = Incoming(self._socket)
        self._buffer = memoryview(bytearray(DATAGRAM_SIZE))
        self._last: Address | None = None
        self._checked_us = clock.now_us()
        self._peers: dict[Address, _Peer] = {}  # longest silent first

    def _receive(self, timeout_s: float) -> bytes:
        self._forget_silent()
        try:
            if not self._incoming.within(timeout_s):
                return b""
            size, peer = self._socket.recvfrom_into(self._buffer)
        except OSError:  # the fate of an earlier datagram of ours
            return b""
        self.source = self._last = peer
        return bytes(self._buffer[:size])

    def descriptors(self) -> list[HasFileno]:
        return [self._socket]

    def trust(self) -> None:
        address = self._last
        if address is None:
            return
        peer = self._peers.pop(address, None) or _Peer()
        peer.heard_us, peer.count = self._clock.now_us(), peer.count + 1
        self._peers[address] = peer
        if len(self._peers) > MAX_PEERS:
            others = list(self._peers)[:-1]
            unknown = (other for other in others if not self._peers[other].is_known)
            del self._peers[next(unknown, others[0])]
        if self._state is not LinkState.OPEN:
            self._found(f"heard {address[0]}:{address[1]}")

    def _send(self, data: bytes) -> bool:
        self._forget_silent()
        sent = False
        for peer in self._peers:
            sent |= self._send_to(peer, data)
        return sent

    def _send_to(self, peer: Address, data: bytes) -> bool:
        try:
            self._socket.sendto(data, peer)
        except OSError:
            return False
        return True

    def _forget_silent(self) -> None:
        now_us = self._clock.now_us()
        if 0 <= now_us - self._checked_us < CHECK_US:
            return
        self._checked_us = now_us
        for address, peer in list(self._peers.items()):
            lifetime_s = PEER_LIFETIME_S if peer.is_known else NEW_PEER_LIFETIME_S
            if now_us - peer.heard_us > round(lifetime_s * 1e6):
                del self._peers[address]
        if not self._peers:
            self._lost("no peer heard for a minute")

    def _close(self) -> None:
        self._socket.close()


class UdpOut(BaseLink):
    """Sends to one host and port. It is OPEN once the host has answered, and LOST when the host
    reports that its port is closed (ICMP port unreachable) or after 60 s of silence. It sends in
    either state."""

    def __init__(self, endpoint: Endpoint, clock: Clock) -> None:
        super().__init__(str(endpoint), clock)
        local, at, remote = endpoint.address.partition("@")
        self._local = int(local) if at else -1
        endpoint = endpoint._replace(address=remote) if at else endpoint
        self._family, self._address = resolve(endpoint, socket.SOCK_DGRAM)[0]
        _refuse_broadcast(endpoint, self._family, self._address)
        self._socket = self._connect()
        self._renewal = Backoff(clock)
        self._heard_us = clock.now_us()

    def descriptors(self) -> list[HasFileno]:
        return [self._socket]

    def _connect(self) -> socket.socket:
        """Connect the socket, so that the kernel drops datagrams of other senders and reports
        refusals."""
        connected = socket.socket(self._family, socket.SOCK_DGRAM)
        connected.setblocking(False)
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_SIZE)
        if self._local >= 0:
            connected.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                connected.bind(("", self._local))
            except OSError as error:
                connected.close()
                raise LinkError(
                    f"{self.url}: port {self._local} cannot be used ({error})"
                ) from error
        with contextlib.suppress(
            OSError
        ):  # no route yet: sending says so too, and renews the socket
            connected.connect(self._address)
        return connected

    def _receive(self, timeout_s: float) -> bytes:
        if self._clock.now_us() - self._heard_us > round(PEER_LIFETIME_S * 1e6):
            self._lost("silent for a minute")
        deadline_s = time.monotonic() + timeout_s
        while readable(self._socket, max(0.0, deadline_s - time.monotonic())):
            try:
                data = self._socket.recv(DATAGRAM_SIZE)
            except BlockingIOError:  # a datagram with a bad checksum
                continue
            except OSError as error:
                self._lost(error)
                continue
            self._heard_us = self._clock.now_us()
            self._renewal.succeeded()
            self._found("answered")
            return data
        return b""

    def _send(self, data: bytes) -> bool:
        try:
            self._socket.send(data)
        except BlockingIOError:
            return False
        except ConnectionRefusedError as error:  # of an earlier datagram; this one did not go out
            self._lost(error)
            return False
        except OSError as error:
            self._lost(error)
            self._renew()
            return False
        return True

    def _renew(self) -> None:
        """Open a new socket: a connected one keeps the source address of an interface that may be
        gone (Wi-Fi roamed)."""
        if self._renewal.wait_s() <= 0.0:
            self._renewal.failed()
            with contextlib.suppress(OSError):  # out of file descriptors: keep the old one
                stale, self._socket = self._socket, self._connect()
                stale.close()

    def _close(self) -> None:
        self._socket.close()


def _refuse_broadcast(endpoint: Endpoint, family: socket.AddressFamily, address: Address) -> None:
    """Refuse a broadcast address: every program on the network would receive our frames."""
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(address)
        except PermissionError:
            raise LinkError(
                f"{endpoint}: is a broadcast address; name the vehicle's own address, or listen "
                f"with udpin:0.0.0.0:{endpoint.number}"
            ) from None
        except OSError:
            return  # no route yet
