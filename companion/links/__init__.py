"""Links: bytes to and from an autopilot over serial, UDP, TCP or memory. One table, `SCHEMES`,
drives parsing and help.

    link = open_link("udpin:0.0.0.0:14550")
    while True:
        data = link.receive(timeout_s=0.1)

Opening raises `LinkError` with one line that says what to do. An open link never raises: see
`Link`.

Adding a transport is one file with a class ``(Endpoint, Clock) -> Link`` and one line in the table.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module

from companion.clock import Clock, SystemClock
from companion.errors import LinkError
from companion.links import urls
from companion.links.base import Link, LinkState, Statistics
from companion.links.urls import Endpoint

__all__ = [
    "SCHEMES",
    "Endpoint",
    "Link",
    "LinkState",
    "Scheme",
    "Statistics",
    "help_text",
    "open_link",
    "open_links",
    "parse_url",
]

UDP_PORT = 14550
TCP_PORT = 5760


@dataclass(frozen=True)
class Scheme:
    """One kind of link: syntax, help, the parser of its URL, and the class that opens it."""

    name: str
    aliases: tuple[str, ...]
    syntax: str
    help: str
    example: str
    parse: Callable[[str, str], Endpoint]
    """(name, text after the colon) -> endpoint; raises ValueError with the reason"""
    maker: str
    """``module:class`` in this package, imported when first used: only serial links need
    pyserial"""

    def make(self, endpoint: Endpoint, clock: Clock) -> Link:
        module, _, name = self.maker.partition(":")
        make: Callable[[Endpoint, Clock], Link] = getattr(
            import_module(f"{__name__}.{module}"), name
        )
        return make(endpoint, clock)


_SCHEMES = (
    Scheme(
        "serial",
        (),
        "[serial:]DEVICE[:BAUD]",
        f"a serial port or USB cable, {urls.UART_BAUD} baud unless given; BAUD auto finds it out",
        "/dev/ttyAMA0:921600",
        urls.serial_port,
        "serial_port:SerialLink",
    ),
    Scheme(
        "udpin",
        ("udp", "udps", "udpserver"),
        "udpin:[HOST:]PORT",
        "wait for UDP, answer everybody heard within a minute",
        f"udpin:0.0.0.0:{UDP_PORT}",
        partial(urls.udp, default_port=UDP_PORT),
        "udp:UdpIn",
    ),
    Scheme(
        "udpout",
        ("udpc", "udpclient"),
        "udpout:HOST[:PORT]",
        "send UDP to one host, hear only its answers",
        f"udpout:192.168.1.20:{UDP_PORT}",
        partial(urls.host_port, default_port=UDP_PORT, listens=False),
        "udp:UdpOut",
    ),
    Scheme(
        "tcp",
        ("tcpout", "tcpc", "tcpclient"),
        "tcp:HOST[:PORT]",
        "connect to a TCP server such as ArduPilot SITL",
        f"tcp:127.0.0.1:{TCP_PORT}",
        partial(urls.host_port, default_port=TCP_PORT, listens=False),
        "tcp:TcpClient",
    ),
    Scheme(
        "tcpin",
        ("tcps", "tcpserver", "tcp-l"),
        "tcpin:[HOST:]PORT",
        "wait for one TCP client",
        f"tcpin:0.0.0.0:{TCP_PORT}",
        partial(urls.host_port, default_port=TCP_PORT, listens=True),
        "tcp:TcpServer",
    ),
    Scheme(
        "memory",
        (),
        "memory:NAME",
        "another link of the same name in this process (tests)",
        "memory:bench",
        urls.name,
        "memory:MemoryLink",
    ),
)

SCHEMES: Mapping[str, Scheme] = {scheme.name: scheme for scheme in _SCHEMES}
_SPELLINGS = {
    spelling: scheme for scheme in _SCHEMES for spelling in (scheme.name, *scheme.aliases)
}


def parse_url(url: str) -> Endpoint:
    """The endpoint of `url` in any accepted spelling; its ``str`` is the canonical spelling."""
    try:
        name, rest = urls.split(url)
    except ValueError as error:
        raise LinkError(f"link {url!r} {error}") from error
    scheme = _SPELLINGS.get(name)
    if scheme is None:
        known = ", ".join(SCHEMES)
        raise LinkError(
            f"link {url!r} has an unknown scheme {name!r}; use the path of a serial port, or "
            f"{known}"
        )
    try:
        return scheme.parse(scheme.name, rest)
    except ValueError as error:
        raise LinkError(
            f"link {url!r} {error}; write {scheme.syntax}, for example {scheme.example}"
        ) from error


def open_links(links: Sequence[str], clock: Clock | None = None) -> Link:
    """One link, or several as one with MAVLink routing between them (see `routing.Router`)."""
    from companion.links.routing import Router

    clock = clock or SystemClock()
    opened: list[Link] = []
    try:
        for url in links:
            opened.append(open_link(url, clock))
    except LinkError:
        for link in opened:
            link.close()
        raise
    return opened[0] if len(opened) == 1 else Router(opened, clock)


def open_link(url: str, clock: Clock | None = None) -> Link:
    """Open a link. Raises `LinkError` if the URL, the address or the port cannot be used; a missing
    peer is not an error."""
    endpoint = parse_url(url)
    try:
        return SCHEMES[endpoint.scheme].make(endpoint, clock or SystemClock())
    except LinkError:
        raise
    except OSError as error:
        raise LinkError(f"{endpoint}: cannot be opened ({error})") from error


def help_text() -> str:
    """A table of the link URLs for the command line; each line has the syntax, a description and an
    example."""
    width = max(len(scheme.syntax) for scheme in _SCHEMES)
    help_width = max(len(scheme.help) for scheme in _SCHEMES)
    return "\n".join(f"{s.syntax:{width}}  {s.help:{help_width}}  {s.example}" for s in _SCHEMES)
