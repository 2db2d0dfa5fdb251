"""Resolves addresses and listens on them, with errors that say what to do; for UDP and TCP."""

import errno
import os
import socket
from typing import Any

from companion.errors import LinkError
from companion.links.urls import Endpoint

Address = tuple[Any, ...]
"""(host, port), or the four values of IPv6"""


def resolve(
    endpoint: Endpoint, kind: socket.SocketKind
) -> list[tuple[socket.AddressFamily, Address]]:
    """Family and address of a host. IPv4 comes first, because MAVLink programs on "localhost"
    listen on it."""
    try:
        found = socket.getaddrinfo(endpoint.address, endpoint.number, type=kind)
    except (OSError, UnicodeError) as error:
        raise LinkError(
            f"{endpoint}: cannot find the host {endpoint.address!r} ({error}); check the name or "
            "give its IP address"
        ) from error
    addresses = [(family, address) for family, _, _, _, address in found]
    return sorted(addresses, key=lambda item: item[0] != socket.AF_INET)


def listener(endpoint: Endpoint, kind: socket.SocketKind) -> socket.socket:
    """A non-blocking socket bound to `endpoint`."""
    family, address = resolve(endpoint, kind)[0]
    try:
        bound = socket.socket(family, kind)
    except OSError as error:
        raise LinkError(_explain(endpoint, error)) from error
    try:
        bound.setblocking(False)
        if (
            kind == socket.SOCK_STREAM
        ):  # on UDP it would let two programs share a port and steal from each other
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind(address)
        if kind == socket.SOCK_STREAM:
            bound.listen()
    except OSError as error:
        bound.close()
        raise LinkError(_explain(endpoint, error)) from error
    return bound


def _explain(endpoint: Endpoint, error: OSError) -> str:
    match error.errno:
        case errno.EADDRINUSE:
            why = (
                "address already in use; stop the other program (QGroundControl, MAVProxy?) or "
                "choose another port"
            )
        case errno.EADDRNOTAVAIL:
            call = endpoint._replace(scheme="tcp" if endpoint.scheme == "tcpin" else "udpout")
            why = (
                f"{endpoint.address} is not an address of this computer; listen on 0.0.0.0, or "
                f"call it with {call}"
            )
        case errno.EACCES:
            why = "permission denied; choose a port above 1023"
        case code:
            why = os.strerror(code) if code else str(error)
    return f"{endpoint}: {why}"
