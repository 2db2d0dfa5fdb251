"""One suite that every link passes: each scheme of the table against a real peer (pty, loopback
socket, other end)."""

import contextlib
import errno
import os
import select
import socket
import termios
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

import pytest

from companion.clock import Clock, ManualClock, SystemClock
from companion.errors import LinkError
from companion.links import SCHEMES, Link, LinkState, memory, open_link
from tests.vehicle import Vehicle, heartbeat

FRAMES = [bytes([0xFD, *number.to_bytes(2, "big")]) + bytes(37) for number in range(1000)]
PATIENCE_S = 2.0
"""Upper bound for anything that should happen at once on a loaded machine."""


class Peer(Protocol):
    """What is at the other end of a link: as raw as possible, so that two wrongs cannot make a
    right."""

    url: str

    def write(self, data: bytes) -> None: ...
    def read(self, timeout_s: float) -> bytes: ...

    def vanish(self) -> None:
        """As by pulling the cable, or a program ending."""

    def come_back(self) -> None: ...
    def close(self) -> None: ...


class PtyPeer:
    """Holds the master of a pseudo-terminal whose slave has a lasting name, as in
    /dev/serial/by-id."""

    def __init__(self, folder: Path) -> None:
        self._link = folder / "autopilot"
        self.url = f"serial:{self._link}:57600"
        self.come_back()

    def come_back(self) -> None:
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self._link.symlink_to(os.ttyname(slave))
        self._slave = slave

    def write(self, data: bytes) -> None:
        os.write(self._master, data)

    def read(self, timeout_s: float) -> bytes:
        ready, _, _ = select.select([self._master], [], [], timeout_s)
        return os.read(self._master, 65536) if ready else b""

    def vanish(self) -> None:
        os.close(self._slave)
        os.close(self._master)
        self._link.unlink()

    def close(self) -> None:
        if self._link.is_symlink():
            self.vanish()


class SocketPeer:
    """One socket that talks, and for TCP servers one that listens."""

    url: str
    talking: socket.socket | None = None
    listening: socket.socket | None = None

    def write(self, data: bytes) -> None:
        assert self.talking
        self.talking.sendall(data)

    def read(self, timeout_s: float) -> bytes:
        if self.talking is None or not select.select([self.talking], [], [], timeout_s)[0]:
            return b""
        return self.talking.recv(65536)

    def vanish(self) -> None:
        for open_socket in (self.talking, self.listening):
            if open_socket is not None:
                open_socket.close()
        self.talking = self.listening = None

    close = vanish


class UdpCaller(SocketPeer):
    """Speaks first; the link is udpin."""

    url = "udpin:127.0.0.1:0"
    port = 0

    def come_back(self) -> None:
        self.talking = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.talking.connect(("127.0.0.1", self.port))


class UdpListener(SocketPeer):
    """Answers; the link is udpout."""

    def __init__(self) -> None:
        self._port = 0
        self.come_back()
        self.url = f"udpout:127.0.0.1:{self._port}"

    def come_back(self) -> None:
        self.talking = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.talking.bind(("127.0.0.1", self._port))
        self._port = self.talking.getsockname()[1]

    def write(self, data: bytes) -> None:
        assert self.talking
        self.talking.send(data)

    def read(self, timeout_s: float) -> bytes:
        if self.talking is None or not select.select([self.talking], [], [], timeout_s)[0]:
            return b""
        data, sender = self.talking.recvfrom(65536)
        self.talking.connect(sender)
        return data


class TcpListener(SocketPeer):
    """The link is tcp."""

    def __init__(self) -> None:
        self._port = 0
        self.come_back()
        self.url = f"tcp:127.0.0.1:{self._port}"

    def come_back(self) -> None:
        self.listening = socket.create_server(("127.0.0.1", self._port))
        self._port = self.listening.getsockname()[1]

    def accept(self) -> None:
        if (
            self.listening
            and self.talking is None
            and select.select([self.listening], [], [], 0)[0]
        ):
            self.talking, _ = self.listening.accept()
            self.talking.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


class TcpCaller(SocketPeer):
    """The link is tcpin."""

    url = "tcpin:127.0.0.1:0"
    port = 0

    def come_back(self) -> None:
        self.talking = socket.create_connection(("127.0.0.1", self.port))
        self.talking.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


class MemoryPeer:
    """The other end of a memory link."""

    url = "memory:contract"

    def __init__(self) -> None:
        self.come_back()

    def come_back(self) -> None:
        self._link = open_link(self.url, ManualClock())

    def write(self, data: bytes) -> None:
        assert self._link.send(data)

    def read(self, timeout_s: float) -> bytes:
        return self._link.receive(timeout_s)

    def vanish(self) -> None:
        self._link.close()

    close = vanish


class Rig:
    """A link under test and its peer."""

    def __init__(self, peer: Peer, link: Link, clock: ManualClock | SystemClock) -> None:
        self.peer, self.link, self.clock = peer, link, clock

    def meet(self) -> None:
        """Bring both ends together and drain what that took."""
        give_up = time.monotonic() + PATIENCE_S
        while not self._met():
            assert time.monotonic() < give_up, (
                f"{self.link.url} never met its peer: {self.link.state}"
            )
        while self.link.receive(0.0) or self.peer.read(0.0):
            self.link.trust()

    def _met(self) -> bool:
        if isinstance(self.peer, TcpListener):
            self.peer.accept()
        elif isinstance(self.peer, UdpCaller):
            self.peer.write(b"hello")
        elif isinstance(self.peer, UdpListener):
            self.link.send(b"hello")
            if self.peer.read(0.01):
                self.peer.write(b"hello")
        if self.link.receive(0.01):
            self.link.trust()
        talking = not isinstance(self.peer, SocketPeer) or self.peer.talking is not None
        return talking and self.link.state is LinkState.OPEN

    def lose(self) -> None:
        """The peer goes, and the link gets to notice: on UDP by a refusal or by silence, elsewhere
        by the end."""
        self.peer.vanish()
        if isinstance(self.peer, UdpCaller) and isinstance(self.clock, ManualClock):
            self.clock.advance_s(61.0)
        give_up = time.monotonic() + PATIENCE_S
        while self.link.state is LinkState.OPEN:
            if isinstance(self.peer, UdpListener):
                self.link.send(b"anybody?")
            assert self.link.receive(0.01) == b""
            assert time.monotonic() < give_up, f"{self.link.url} never noticed"

    def hear(self, count: int) -> bytes:
        data = b""
        while len(data) < count and (chunk := self.link.receive(PATIENCE_S)):
            self.link.trust()
            data += chunk
        return data

    def be_heard(self, count: int) -> bytes:
        data = b""
        while len(data) < count and (chunk := self.peer.read(PATIENCE_S)):
            data += chunk
        return data


Make = Callable[[ManualClock | SystemClock], Rig]


@pytest.fixture(params=sorted(SCHEMES))
def make_rig(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Make]:
    """Builds rigs of one scheme, and takes them down."""
    with contextlib.ExitStack() as stack:

        def make(clock: ManualClock | SystemClock) -> Rig:
            peers: dict[str, Callable[[], Peer]] = {
                "serial": lambda: PtyPeer(tmp_path),
                "udpin": UdpCaller,
                "udpout": UdpListener,
                "tcp": TcpListener,
                "tcpin": TcpCaller,
                "memory": MemoryPeer,
            }
            peer = peers[request.param]()
            stack.callback(peer.close)
            link = open_link(peer.url, clock)
            stack.callback(link.close)
            if isinstance(peer, UdpCaller | TcpCaller):
                peer.port = int(link.url.rpartition(":")[2])
                assert link.state is LinkState.WAITING
                peer.come_back()
            return Rig(peer, link, clock)

        yield make


@pytest.fixture
def rig(make_rig: Make) -> Rig:
    rig = make_rig(ManualClock())
    rig.meet()
    return rig


def test_bytes_go_both_ways_and_are_counted(rig: Rig) -> None:
    before = rig.link.statistics.received_bytes, rig.link.statistics.sent_bytes
    rig.peer.write(b"up\x00\xff\r\n\x11\x13")
    assert rig.hear(8) == b"up\x00\xff\r\n\x11\x13"
    assert rig.link.send(b"down\x00\xff\r\n\x03\x04")
    assert rig.be_heard(10) == b"down\x00\xff\r\n\x03\x04"
    after = rig.link.statistics.received_bytes, rig.link.statistics.sent_bytes
    assert (after[0] - before[0], after[1] - before[1]) == (8, 10)
    assert rig.link.statistics.reconnects == 0


def test_a_burst_arrives_whole_and_in_order(rig: Rig) -> None:
    heard = be_heard = b""
    for start in range(0, len(FRAMES), 50):  # a pty holds 4 kB
        burst = FRAMES[start : start + 50]
        for frame in burst:
            rig.peer.write(frame)
        heard += rig.hear(50 * 40)
        for frame in burst:
            assert rig.link.send(frame)
        be_heard += rig.be_heard(50 * 40)
    assert heard == b"".join(FRAMES)
    assert be_heard == b"".join(FRAMES)


def test_a_peer_that_does_not_read_costs_whole_frames_and_no_time(rig: Rig) -> None:
    if rig.link.url.startswith("udp"):
        pytest.skip("UDP sends whether or not anybody reads")
    frame = bytes(1000)
    started = time.monotonic()
    sent = 0
    while rig.link.send(frame):
        sent += 1
    for _ in range(20):
        sent += rig.link.send(frame)
    assert time.monotonic() - started < PATIENCE_S
    assert rig.link.statistics.dropped_bytes >= 1000
    arrived = 0
    while arrived < sent * len(frame):
        chunk = rig.peer.read(0.05)
        arrived += len(chunk)
        # The rest of a frame that did not fit goes out before the next one.
        if not chunk:
            assert rig.link.send(frame)
            sent += 1
    assert arrived % len(frame) == 0
    assert rig.link.state is LinkState.OPEN


@pytest.mark.parametrize("clock", [ManualClock, SystemClock])
def test_silence_ends_with_the_timeout(
    make_rig: Make, clock: Callable[[], ManualClock | SystemClock]
) -> None:
    rig = make_rig(clock())
    rig.meet()
    started, started_us = time.monotonic(), rig.clock.now_us()
    assert rig.link.receive(0.05) == b""
    elapsed_s = max(time.monotonic() - started, (rig.clock.now_us() - started_us) / 1e6)
    assert 0.045 <= elapsed_s < 1.0
    assert rig.link.state is LinkState.OPEN


def test_bytes_that_are_there_come_at_once(rig: Rig) -> None:
    rig.peer.write(b"now")
    started = time.monotonic()
    assert rig.link.receive(PATIENCE_S)
    assert time.monotonic() - started < PATIENCE_S / 4


def test_a_lost_peer_is_a_state_and_comes_back(rig: Rig) -> None:
    for round_ in (1, 2):
        rig.lose()
        assert rig.link.state is LinkState.LOST
        dropped = rig.link.statistics.dropped_bytes
        sent = [rig.link.send(b"into the void") for _ in range(4)]
        assert not all(sent)
        assert rig.link.statistics.dropped_bytes - dropped == 13 * sent.count(False)
        for _ in range(20):  # an outage of minutes, on the link's clock
            assert (
                rig.link.receive(
                    1.0 if isinstance(rig.peer, PtyPeer | TcpListener | MemoryPeer) else 0.0
                )
                == b""
            )
        assert rig.link.state is LinkState.LOST

        rig.peer.come_back()
        rig.meet()
        assert rig.link.statistics.reconnects == round_
        rig.peer.write(b"here again")
        assert rig.hear(10) == b"here again"
        assert rig.link.send(b"welcome")
        assert rig.be_heard(7) == b"welcome"


def test_an_absent_peer_does_not_hold_receive_up(make_rig: Make) -> None:
    rig = make_rig(SystemClock())
    rig.meet()
    rig.peer.vanish()
    rig.link.send(b"anybody?")
    rig.link.receive(0.0)
    started = time.monotonic()
    assert rig.link.receive(0.22) == b""  # through one attempt to come back
    if rig.link.state is LinkState.LOST:
        assert rig.link.receive(0.01) == b""
    assert time.monotonic() - started < 1.0


def test_a_closed_link_is_silent(rig: Rig) -> None:
    rig.link.close()
    rig.link.close()
    assert rig.link.receive(PATIENCE_S) == b""
    assert rig.link.send(b"late") is False
    assert rig.link.statistics.dropped_bytes >= 4
    assert rig.link.state is not LinkState.OPEN


def test_closing_gives_the_address_back(rig: Rig) -> None:
    rig.link.close()
    if isinstance(rig.peer, TcpListener | TcpCaller):
        rig.peer.vanish()
    open_link(rig.link.url, rig.clock).close()


@pytest.mark.parametrize("scheme", ["udpin:127.0.0.1", "tcpin:127.0.0.1"])
def test_two_of_ours_talk(scheme: str) -> None:
    with contextlib.closing(open_link(f"{scheme}:0")) as listens:
        port = listens.url.rpartition(":")[2]
        with contextlib.closing(open_link(f"{scheme[:3]}out:127.0.0.1:{port}")) as calls:
            assert calls.receive(0.05) == b""  # time to connect
            assert calls.send(b"ping")
            assert listens.receive(PATIENCE_S) == b"ping"
            listens.trust()
            assert listens.send(b"pong")
            assert calls.receive(PATIENCE_S) == b"pong"


def test_ipv6() -> None:
    try:
        listens = open_link("udpin:[::1]:0")
    except LinkError as error:
        pytest.skip(str(error))
    with (
        contextlib.closing(listens),
        contextlib.closing(open_link(listens.url.replace("udpin", "udpout"))) as calls,
    ):
        assert calls.send(b"ping")
        assert listens.receive(PATIENCE_S) == b"ping"


def test_udpin_answers_every_live_peer_and_forgets_the_silent() -> None:
    clock = ManualClock()
    with contextlib.ExitStack() as stack:
        link = stack.enter_context(contextlib.closing(open_link("udpin:127.0.0.1:0", clock)))
        callers = [UdpCaller(), UdpCaller()]
        for caller in callers:
            stack.callback(caller.close)
            caller.port = int(link.url.rpartition(":")[2])
            caller.come_back()
            known_from(link, caller)
            clock.advance_s(40.0)
        assert link.send(b"to the second")
        assert [caller.read(0.05) for caller in callers] == [b"", b"to the second"]
        known_from(link, callers[0])
        assert link.send(b"to both")
        assert [caller.read(PATIENCE_S) for caller in callers] == [b"to both", b"to both"]


def test_udpin_bounds_its_peers() -> None:
    with contextlib.ExitStack() as stack:
        link = stack.enter_context(contextlib.closing(open_link("udpin:127.0.0.1:0")))
        callers = [UdpCaller() for _ in range(17)]
        for caller in callers:
            stack.callback(caller.close)
            caller.port = int(link.url.rpartition(":")[2])
            caller.come_back()
            known_from(link, caller)
        assert link.send(b"hello")
        assert callers[0].read(0.02) == b""
        assert all(caller.read(PATIENCE_S) == b"hello" for caller in callers[1:])


def test_udpin_sends_nothing_to_who_sent_no_mavlink() -> None:
    """A source address can be forged: one datagram must not make us flood its owner."""
    clock = ManualClock()
    with contextlib.ExitStack() as stack:
        link = stack.enter_context(contextlib.closing(open_link("udpin:127.0.0.1:0", clock)))
        caller = UdpCaller()
        stack.callback(caller.close)
        caller.port = int(link.url.rpartition(":")[2])
        caller.come_back()
        caller.write(b"x")
        assert link.receive(PATIENCE_S) == b"x"
        assert not link.send(b"hello")
        link.trust()  # it was a frame
        assert link.send(b"hello")
        clock.advance_s(5.1)
        assert not link.send(b"hello")
        known_from(link, caller)
        clock.advance_s(59.0)
        assert link.send(b"hello")


def test_udpin_keeps_who_is_known_when_strangers_crowd_in() -> None:
    with contextlib.ExitStack() as stack:
        link = stack.enter_context(contextlib.closing(open_link("udpin:127.0.0.1:0")))
        callers = [UdpCaller() for _ in range(40)]
        for caller in callers:
            stack.callback(caller.close)
            caller.port = int(link.url.rpartition(":")[2])
            caller.come_back()
        known_from(link, callers[0])
        for caller in callers[1:]:
            caller.write(b"frame")
            assert link.receive(PATIENCE_S)
            link.trust()
        assert link.send(b"hello")
        assert callers[0].read(PATIENCE_S) == b"hello"


def known_from(link: Link, caller: UdpCaller) -> None:
    """Three datagrams that were MAVLink."""
    for _ in range(3):
        caller.write(b"heartbeat")
        assert link.receive(PATIENCE_S) == b"heartbeat"
        link.trust()


def test_udpout_waits_for_a_peer_that_starts_later() -> None:
    peer = UdpListener()
    peer.vanish()
    with contextlib.closing(open_link(peer.url)) as link:
        sent = [link.send(b"hello") for _ in range(4)]
        assert True in sent
        assert False in sent
        assert link.receive(0.01) == b""
        assert link.state is LinkState.WAITING
        peer.come_back()
        with contextlib.closing(peer):
            assert link.send(b"hello")
            assert peer.read(PATIENCE_S) == b"hello"


def test_udpout_without_a_route_drops_and_keeps_trying(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mock: this computer may have a route to everywhere."""

    class Unreachable(socket.socket):
        def send(self, data: object, flags: int = 0, /) -> int:
            raise OSError(errno.ENETUNREACH, "Network is unreachable")

    monkeypatch.setattr("companion.links.udp.socket.socket", Unreachable)
    clock = ManualClock()
    with contextlib.closing(open_link("udpout:127.0.0.1:9", clock)) as link:
        for _ in range(5):
            assert link.send(b"hello") is False
            clock.advance_s(1.0)
        assert link.receive(0.0) == b""
        assert link.state is LinkState.WAITING


def test_tcp_waits_for_a_server_that_starts_later() -> None:
    clock = ManualClock()
    peer = TcpListener()
    peer.vanish()
    with contextlib.closing(open_link(peer.url, clock)) as link:
        started_us = clock.now_us()
        assert link.receive(60.0) == b""
        assert clock.now_us() - started_us == pytest.approx(60e6, abs=1)
        assert link.state is LinkState.WAITING
        peer.come_back()
        with contextlib.closing(peer):
            rig = Rig(peer, link, clock)
            clock.advance_s(5.0)
            rig.meet()
            assert link.statistics.reconnects == 0


def test_tcp_server_that_hangs_up_at_once_is_not_hammered() -> None:
    clock = ManualClock()
    peer = TcpListener()
    with contextlib.closing(peer), contextlib.closing(open_link(peer.url, clock)) as link:
        calls, end_us = 0, clock.now_us() + 60_000_000
        while clock.now_us() < end_us:
            link.receive(0.0)
            clock.advance_s(0.05)
            peer.accept()
            if peer.talking:
                calls += 1
                peer.talking.close()
                peer.talking = None
        assert 5 <= calls <= 20


def test_tcpin_second_client_waits_for_the_first_and_replaces_a_silent_one() -> None:
    clock = ManualClock()
    with contextlib.ExitStack() as stack:
        link = stack.enter_context(contextlib.closing(open_link("tcpin:127.0.0.1:0", clock)))
        first, second = TcpCaller(), TcpCaller()
        for caller in (first, second):
            caller.port = int(link.url.rpartition(":")[2])
            stack.callback(caller.close)
            caller.come_back()
        first.write(b"first")
        second.write(b"second")
        assert link.receive(PATIENCE_S) == b"first"
        assert link.receive(0.02) == b""
        clock.advance_s(6.0)
        assert link.receive(PATIENCE_S) == b"second"
        assert first.read(PATIENCE_S) == b""  # hung up
        assert link.statistics.reconnects == 1


def test_serial_port_is_ours_alone(tmp_path: Path) -> None:
    with (
        contextlib.closing(PtyPeer(tmp_path)) as peer,
        contextlib.closing(open_link(peer.url)),
        pytest.raises(LinkError, match="in use by another program"),
    ):
        open_link(peer.url)


def test_serial_error_while_reading_is_a_loss(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a USB driver reports it, while the device file is still there."""

    def unplugged(*_: object) -> bytes:
        raise OSError(errno.EIO, "Input/output error")

    with (
        contextlib.closing(PtyPeer(tmp_path)) as peer,
        contextlib.closing(open_link(peer.url, ManualClock())) as link,
    ):
        peer.write(b"x")
        with monkeypatch.context() as patch:
            patch.setattr("companion.links.serial_port._Port.recv", unplugged)
            assert link.receive(PATIENCE_S) == b""
        states = [link.state]
        assert link.send(b"x") is False
        assert link.receive(0.3) == b""
        states.append(link.state)
        assert states == [LinkState.LOST, LinkState.OPEN]
        peer.write(b"y")
        assert link.receive(PATIENCE_S) == b"y"


@pytest.mark.parametrize("away_s", [0.5, 3.0, 6.0])
@pytest.mark.parametrize("kind", ["serial", "tcp"])
def test_a_peer_that_is_back_is_met_within_two_seconds(
    tmp_path: Path, kind: str, away_s: float
) -> None:
    peer = PtyPeer(tmp_path) if kind == "serial" else TcpListener()
    with contextlib.closing(peer), contextlib.closing(open_link(peer.url)) as link:
        rig = Rig(peer, link, SystemClock())
        rig.meet()
        peer.write(b"x")
        assert link.receive(PATIENCE_S)
        rig.lose()
        end_s = time.monotonic() + away_s
        while time.monotonic() < end_s:
            link.receive(0.1)
        peer.come_back()
        started = time.monotonic()
        rig.meet()
        assert time.monotonic() - started < 1.3


def test_a_usb_device_is_found_under_another_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was ttyACM0, it comes back as ttyACM1; by-id points to it."""
    by_id = tmp_path / "by-id"
    by_id.mkdir()
    monkeypatch.setattr("companion.links.serial_port.BY_ID", str(by_id))
    with contextlib.closing(PtyPeer(by_id)) as peer:
        numbered = tmp_path / "ttyACM0"
        numbered.symlink_to(os.readlink(by_id / "autopilot"))
        with contextlib.closing(open_link(f"{numbered}:57600")) as link:
            rig = Rig(peer, link, SystemClock())
            rig.meet()
            rig.lose()
            numbered.unlink()
            peer.come_back()
            rig.meet()
            peer.write(b"again")
            assert rig.hear(5) == b"again"


def test_a_serial_port_that_appears_later(tmp_path: Path) -> None:
    peer = PtyPeer(tmp_path)
    peer.vanish()
    with contextlib.closing(open_link(peer.url)) as link:
        assert link.receive(0.1) == b""
        states = [link.state]
        peer.come_back()
        with contextlib.closing(peer):
            Rig(peer, link, SystemClock()).meet()
            states.append(link.state)
    assert states == [LinkState.WAITING, LinkState.OPEN]


@pytest.mark.parametrize("baud", [57600, 115200, 921600])
def test_baud_rate_is_found_by_whole_frames(tmp_path: Path, baud: int) -> None:
    """The far side is understood only at its own rate, as on a UART."""
    frame = Vehicle().pack(heartbeat())
    code = {57600: termios.B57600, 115200: termios.B115200, 921600: termios.B921600}[baud]
    with contextlib.closing(PtyPeer(tmp_path)) as peer:
        url = peer.url.replace(":57600", ":auto")
        with contextlib.closing(open_link(url)) as link:
            heard, give_up = b"", time.monotonic() + 6.0
            while frame * 3 not in heard:
                assert time.monotonic() < give_up
                speed = termios.tcgetattr(peer._slave)[5]
                peer.write(frame if speed == code else bytes(255 - b // 2 for b in frame))
                heard += link.receive(0.05)
            assert link.url.endswith(":auto")


def test_mavros_spelling_calls_from_its_port() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        local = probe.getsockname()[1]
    peer = UdpListener()
    port = peer.url.rpartition(":")[2]
    with (
        contextlib.closing(peer),
        contextlib.closing(open_link(f"udp://:{local}@127.0.0.1:{port}")) as link,
    ):
        assert link.send(b"hello")
        assert peer.read(PATIENCE_S) == b"hello"
        assert peer.talking is not None
        assert peer.talking.getpeername()[1] == local


def test_memory_pair_is_a_link_on_the_clock_it_is_given() -> None:
    clock = ManualClock()
    left, right = memory.pair(clock)
    assert left.send(b"one")
    assert left.send(b"two")
    assert [right.receive(1.0), right.receive(1.0)] == [b"one", b"two"]
    before_us = clock.now_us()
    assert right.receive(1.0) == b""
    assert clock.now_us() - before_us == 1_000_000
    left.send(b"last words")
    left.close()
    assert right.state is LinkState.LOST
    assert right.receive(0.0) == b"last words"
    right.close()


def test_memory_name_has_two_ends() -> None:
    with (
        contextlib.closing(open_link("memory:full")),
        contextlib.closing(open_link("memory:full")),
        pytest.raises(LinkError, match="already in use"),
    ):
        open_link("memory:full")


def _is_a_link(link: Link, clock: Clock) -> None:
    """Only here for mypy: the makers are named by text, so nothing else checks them against the
    protocol."""
    from companion.links import serial_port, tcp, udp, urls

    endpoint = urls.Endpoint("", "")
    makers: list[Callable[[urls.Endpoint, Clock], Link]] = [
        serial_port.SerialLink,
        udp.UdpIn,
        udp.UdpOut,
        tcp.TcpClient,
        tcp.TcpServer,
        memory.MemoryLink,
    ]
    for maker in makers:
        maker(endpoint, clock)
