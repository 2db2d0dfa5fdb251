"""Section ``http`` of the configuration, and the form of an address."""

import ipaddress
from typing import NamedTuple

from pydantic import Field, field_validator

from companion.config import Settings

DEFAULT_PORT = 8080


class Address(NamedTuple):
    """Where the server listens."""

    host: str
    port: int

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine reaches it."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"


def read_address(text: str) -> Address:
    """``HOST:PORT``, ``PORT`` or ``[IPv6]:PORT``; a host alone gets port 8080.

    Raises ValueError, with what to give instead.
    """
    bracketed = text.startswith("[")
    if text.isdigit():
        host, port = "127.0.0.1", text
    elif bracketed:
        host, _, port = text[1:].partition("]")
        port = port.removeprefix(":")
    else:
        host, _, port = text.partition(":")
    is_port = port == "" or (port.isdigit() and int(port) <= 65_535)
    if not host or not is_port or (":" in host and not bracketed):
        raise ValueError(
            f"{text!r} is no address: give HOST:PORT such as 127.0.0.1:8080, or a port alone"
        )
    return Address(host, int(port or DEFAULT_PORT))


class HttpSettings(Settings):
    """Section ``http``: the live page."""

    address: str | None = Field(None, max_length=255)
    """HOST:PORT on which the live page, /metrics, /healthz and /api/state are served; none: not
    served; option --http replaces it"""
    hosts: list[str] = Field([], max_length=16)
    """names under which a browser may ask for the page, besides localhost, this machine's name and
    every IP address; a request for another name is refused (403)"""

    @field_validator("address")
    @classmethod
    def _has_an_address(cls, address: str | None) -> str | None:
        if address is not None:
            read_address(address)
        return address
