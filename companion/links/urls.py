"""Link URLs in the spellings of pymavlink, MAVSDK, mavros, mavp2p and mavlink-server, and their one
canonical form.

The parsers raise ValueError with the reason; `companion.links.parse_url` adds the URL and the
expected form.
"""

import ipaddress
import re
from typing import NamedTuple
from urllib.parse import parse_qsl

UART_BAUD = 57600
USB_BAUD = 115200
BAUD_RANGE = (300, 12_000_000)
AUTO_BAUD = 0

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]*")
_HOST_PORT = re.compile(r"(?:\[(?P<ipv6>.*)\]|(?P<host>[^:]*))(?::(?P<port>[^:]*))?")
_DEVICE_BAUD = re.compile(r"(?P<device>.*?)(?:[,:](?P<baud>\w*))?")
_WINDOWS_PORT = re.compile(r"COM[0-9]+", re.IGNORECASE)
_BARE_HOST_PORT = re.compile(r"(?:[0-9.]+|localhost|\[[0-9a-fA-F:]+\]|[\w-]+(?:\.[\w-]+)+):[0-9]+")
_FRAMING = re.compile(r":(?P<framing>[5-8][NEO][12])", re.IGNORECASE)
_BARE_DEVICE = re.compile(r"/.*|COM[0-9]+(?:[,:?].*)?", re.IGNORECASE)


class Endpoint(NamedTuple):
    """A parsed link URL; its ``str`` is the canonical spelling."""

    scheme: str
    address: str
    """host, path of a serial port, or name; ``PORT@HOST`` where our own port matters (udpout)"""
    number: int = -1
    """port of a host, baud rate of a serial port (`AUTO_BAUD`: found out), -1 where neither makes
    sense"""

    def __str__(self) -> str:
        if self.scheme == "serial" and self.number == AUTO_BAUD:
            return f"{self.scheme}:{self.address}:auto"
        local, at, remote = self.address.partition("@")
        if at and self.scheme == "udpout":
            return f"udp://:{local}@{Endpoint('', remote, self.number)}".replace("@:", "@")
        ipv6 = ":" in self.address and not self.address.startswith("/")
        address = f"[{self.address}]" if ipv6 else self.address
        return f"{self.scheme}:{address}" + (f":{self.number}" if self.number >= 0 else "")


def split(url: str) -> tuple[str, str]:
    """Scheme and the rest; a serial port needs no scheme."""
    if not url.isprintable() or " " in url:
        raise ValueError("has spaces or unprintable characters in it")
    if _BARE_DEVICE.fullmatch(url):
        return "serial", url
    if _BARE_HOST_PORT.fullmatch(url):  # as pymavlink and MAVProxy read it
        return "udpin", url
    scheme, colon, rest = url.partition(":")
    if not colon:
        raise ValueError(
            "is neither a serial port such as /dev/ttyACM0 nor a URL such as udpin:0.0.0.0:14550"
        )
    return scheme.lower(), rest


def host_port(scheme: str, rest: str, *, default_port: int, listens: bool) -> Endpoint:
    """``HOST:PORT``, ``//HOST:PORT/``, ``HOST``, ``[IPV6]:PORT``; for a listener also ``:PORT``,
    ``PORT``, nothing."""
    match = _HOST_PORT.fullmatch(rest.removeprefix("//").removesuffix("/"))
    if not match:
        raise ValueError("is not HOST:PORT (an IPv6 address goes in brackets, as in [::1]:14550)")
    ipv6, host, port_text = match["ipv6"], match["host"], match["port"]
    if ipv6 is not None:
        host = _ipv6(ipv6)
    elif port_text is None and host.isdigit():
        host, port_text = "", host
    elif host and not _NAME.fullmatch(host):
        raise ValueError(f"has a bad host name {host!r}")
    else:
        host = host.lower()
    if not host and not listens:
        raise ValueError("names no host to call")
    port = (
        default_port
        if port_text is None
        else _number(port_text, "port number", 0 if listens else 1, 65535)
    )
    return Endpoint(scheme, host or "0.0.0.0", port)


def udp(scheme: str, rest: str, *, default_port: int) -> Endpoint:
    """As `host_port` of a listener, and mavros' ``//[HOST][:PORT]@[REMOTE[:PORT]]``: listen on the
    first, call the second."""
    own, at, remote = rest.removeprefix("//").removesuffix("/").partition("@")
    if not at:
        return host_port(scheme, rest, default_port=default_port, listens=True)
    listens = host_port(scheme, own, default_port=default_port, listens=True)
    if not remote:
        return listens
    calls = host_port("udpout", remote, default_port=default_port, listens=False)
    return calls._replace(address=f"{listens.number}@{calls.address}")


def serial_port(scheme: str, rest: str) -> Endpoint:
    """``/dev/X``, ``/dev/X,BAUD``, ``/dev/X:BAUD``, ``///dev/X?baudrate=BAUD``, ``COM3``.

    The names in /dev/serial/by-path have colons of their own, but never end like a baud rate.
    """
    text, _, query = rest.partition("?")
    framing = _FRAMING.search(text)
    if framing and framing.end() == len(text):
        if framing["framing"].upper() != "8N1":
            raise ValueError(f"asks for {framing['framing']}; MAVLink is 8N1")
        text = text[: framing.start()]
    match = _DEVICE_BAUD.fullmatch(text)
    assert match is not None, "the pattern takes anything"
    device = "/" + match["device"].lstrip("/") if text.startswith("/") else match["device"]
    if _WINDOWS_PORT.fullmatch(device.lstrip("/")):
        device = device.lstrip("/").upper()
    elif len(device) < 2 or not device.startswith("/"):
        raise ValueError("names no serial port such as /dev/ttyACM0")
    bauds = [] if match["baud"] is None else [match["baud"]]
    for key, value in parse_qsl(query, keep_blank_values=True):
        if key not in ("baudrate", "baud"):
            raise ValueError(f"has an unknown option {key!r}")
        bauds.append(value)
    if len(bauds) > 1:
        raise ValueError("has two baud rates")
    if bauds == ["auto"]:
        return Endpoint(scheme, device, AUTO_BAUD)
    baud = _number(bauds[0], "baud rate", *BAUD_RANGE) if bauds else _usual_baud(device)
    return Endpoint(scheme, device, baud)


def name(scheme: str, rest: str) -> Endpoint:
    """``NAME`` or ``//NAME``."""
    text = rest.removeprefix("//")
    if not _NAME.fullmatch(text):
        raise ValueError(f"has a bad name {text!r} (letters, digits, . _ -)")
    return Endpoint(scheme, text)


def _ipv6(text: str) -> str:
    try:
        return str(ipaddress.IPv6Address(text))
    except ValueError as error:
        raise ValueError(f"has a bad IPv6 address {text!r}") from error


def _number(text: str, what: str, low: int, high: int) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= 8 and low <= int(text) <= high):
        raise ValueError(f"has a bad {what} {text!r} (a number from {low} to {high})")
    return int(text)


def _usual_baud(device: str) -> int:
    """115200 where the autopilot itself is on USB, which ignores the number; else the usual rate of
    telemetry ports."""
    return USB_BAUD if is_usb(device) else UART_BAUD


def is_usb(device: str) -> bool:
    """Whether the autopilot itself is on USB, where the baud rate has no effect."""
    by_id = "/by-id/usb-" in device and "-port" not in device  # FTDI and friends end in -port0
    return by_id or "ttyACM" in device or "usbmodem" in device
