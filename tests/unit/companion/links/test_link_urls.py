"""Link URLs: every spelling, the canonical one, and what the errors say."""

import errno
import logging
import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import LinkError
from companion.links import SCHEMES, Endpoint, LinkState, help_text, open_link, parse_url
from tests.paths import ROOT

SPELLINGS = {
    "serial:/dev/ttyACM0:115200": [
        "/dev/ttyACM0",
        "/dev/ttyACM0,115200",
        "/dev/ttyACM0:115200",
        "serial:/dev/ttyACM0",
        "serial:///dev/ttyACM0",
        "serial:///dev/ttyACM0:115200",
        "serial:///dev/ttyACM0?baudrate=115200",
        "/dev/ttyACM0?baud=115200",
        "SERIAL:/dev/ttyACM0",
    ],
    "serial:/dev/ttyAMA0:57600": [
        "/dev/ttyAMA0",
        "serial:/dev/ttyAMA0",
        "serial:/dev/ttyAMA0:57600",
    ],
    "serial:/dev/ttyUSB0:57600": ["/dev/ttyUSB0", "/dev/ttyUSB0,57600"],
    "serial:/dev/ttyS1:921600": ["/dev/ttyS1:921600", "serial:///dev/ttyS1?baudrate=921600"],
    "serial:/dev/serial/by-id/usb-Hex_CubeOrange_3A-if00:115200": [
        "/dev/serial/by-id/usb-Hex_CubeOrange_3A-if00",
    ],
    "serial:/dev/serial/by-id/usb-FTDI_FT230X_DN-if00-port0:57600": [
        "/dev/serial/by-id/usb-FTDI_FT230X_DN-if00-port0",
    ],
    "serial:/dev/serial/by-path/pci-0000:01:00.0-usb-0:1.3:1.0:57600": [
        "/dev/serial/by-path/pci-0000:01:00.0-usb-0:1.3:1.0",
        "/dev/serial/by-path/pci-0000:01:00.0-usb-0:1.3:1.0,57600",
    ],
    "serial:COM3:57600": [
        "COM3",
        "com3",
        "COM3,57600",
        "COM3:57600",
        "serial:COM3",
        "serial://COM3:57600",
    ],
    "udpin:0.0.0.0:14550": [
        "udpin:",
        "udpin:14550",
        "udpin::14550",
        "udpin:0.0.0.0:14550",
        "udpin:0.0.0.0",
        "udpin://0.0.0.0:14550",
        "udpin://:14550",
        "udpin://0.0.0.0:14550/",
        "udp:0.0.0.0:14550",
        "udp://:14550",
        "udps:0.0.0.0:14550",
        "udpserver://0.0.0.0:14550",
        "UDPIN:14550",
    ],
    "udpin:0.0.0.0:14540": ["udp://:14540", "udp:14540"],
    "udpin:127.0.0.1:0": ["udpin:127.0.0.1:0", "udp://127.0.0.1:0"],
    "udpin:[::]:14550": ["udpin:[::]", "udpin://[::]:14550", "udp:[0:0:0:0:0:0:0:0]:14550"],
    "udpout:gcs.local:14550": [
        "udpout:gcs.local",
        "udpout://gcs.local:14550",
        "udpc:GCS.local:14550",
    ],
    "udpout:10.0.0.2:14555": ["udpout:10.0.0.2:14555", "udpclient://10.0.0.2:14555"],
    "tcp:127.0.0.1:5760": [
        "tcp:127.0.0.1",
        "tcp:127.0.0.1:5760",
        "tcp://127.0.0.1:5760",
        "tcpout://127.0.0.1:5760",
        "tcpc:127.0.0.1:5760",
        "tcpclient://127.0.0.1:5760",
    ],
    "tcp:[fe80::1%eth0]:5763": ["tcp:[fe80::1%eth0]:5763", "tcp://[FE80::0001%eth0]:5763"],
    "tcp:sitl_1:5760": ["tcp:sitl_1"],
    "tcpin:0.0.0.0:5760": [
        "tcpin:",
        "tcpin:5760",
        "tcpin://0.0.0.0:5760",
        "tcps:0.0.0.0:5760",
        "tcp-l://:5760",
    ],
    "memory:bench": ["memory:bench", "memory://bench"],
    "udpin:127.0.0.1:14550": ["127.0.0.1:14550"],
    "udpin:192.168.1.5:14550": ["192.168.1.5:14550", "udp://192.168.1.5:14550@"],
    "udp://:14555@10.0.0.1:14550": ["udp://:14555@10.0.0.1", "udp://0.0.0.0:14555@10.0.0.1:14550"],
    "serial:/dev/ttyAMA0:921600": ["/dev/ttyAMA0:921600:8N1", "serial:/dev/ttyAMA0:921600:8n1"],
    "serial:/dev/ttyAMA0:auto": ["/dev/ttyAMA0:auto", "/dev/ttyAMA0,auto"],
}

BAD = {
    "": "neither a serial port",
    "ttyACM0": "neither a serial port such as /dev/ttyACM0",
    "udpin:14550 ": "spaces",
    "udpbcast:10.0.0.255:14550": "unknown scheme 'udpbcast'; use .* serial, udpin, udpout, tcp, "
    "tcpin, memory",
    "udpin:0.0.0.0:": "bad port number ''",
    "udpin:0.0.0.0:http": "bad port number 'http' .*; write udpin:",
    "udpin:65536": "bad port number '65536'",
    "udpin:-1": "bad host name '-1'",
    "udpin:::1:14550": "IPv6 address goes in brackets",
    "udpin:[::1:14550": "brackets",
    "udpin:[::g]:14550": "bad IPv6 address '::g'",
    "udpin:²": "bad port number",
    "udp://a/b@10.0.0.1:14550": "bad host name",
    "udp://@10.0.0.1:0": "bad port number '0'",
    "/dev/ttyS0:57600:7E1": "MAVLink is 8N1",
    "udpout:14550": "names no host to call; write udpout:HOST",
    "udpout:host:0": "bad port number '0'",
    "tcp::5760": "names no host to call",
    "tcp:a/b": "bad host name 'a/b'",
    "/dev/ttyS0,fast": "bad baud rate 'fast'",
    "/dev/ttyS0:": "bad baud rate ''",
    "/dev/ttyS0:7": "bad baud rate '7'",
    "serial:/dev/ttyS0?baudrate=-9600": "bad baud rate '-9600'",
    "serial:/dev/ttyS0:57600?baudrate=9600": "two baud rates",
    "serial:/dev/ttyS0?ids=1,240": "unknown option 'ids'",
    "serial:ttyACM0": "names no serial port such as /dev/ttyACM0",
    "serial:": "names no serial port",
    "/": "names no serial port",
    "memory:": "bad name ''",
    "memory:a:b": "bad name 'a:b'",
}


@pytest.mark.parametrize(
    ("url", "canonical"), [(url, key) for key, urls in SPELLINGS.items() for url in [key, *urls]]
)
def test_spellings_have_one_canonical_form(url: str, canonical: str) -> None:
    assert str(parse_url(url)) == canonical


@pytest.mark.parametrize(("url", "message"), BAD.items())
def test_a_bad_url_is_refused_in_one_line_that_helps(url: str, message: str) -> None:
    with pytest.raises(LinkError, match=message) as caught:
        open_link(url)
    assert repr(url) in str(caught.value)
    assert "\n" not in str(caught.value)


hosts = st.one_of(
    st.ip_addresses(v=4).map(str),
    st.ip_addresses(v=6).map(str),
    st.from_regex(r"[a-z][a-z0-9_-]{0,20}(\.[a-z0-9]{1,8})?", fullmatch=True),
)
devices = st.from_regex(r"/dev(/[A-Za-z0-9_.:-]{0,12}[A-Za-z_.-])+", fullmatch=True)
endpoints = st.one_of(
    st.builds(
        Endpoint, st.sampled_from(["udpin", "udpout", "tcp", "tcpin"]), hosts, st.integers(1, 65535)
    ),
    st.builds(Endpoint, st.just("serial"), devices, st.integers(300, 12_000_000)),
    st.builds(
        Endpoint,
        st.just("memory"),
        st.from_regex(r"[a-z][A-Za-z0-9._-]*", fullmatch=True),
        st.just(-1),
    ),
)


@given(endpoints)
def test_every_endpoint_survives_its_own_spelling(endpoint: Endpoint) -> None:
    assert parse_url(str(endpoint)) == endpoint


@given(
    st.tuples(
        st.sampled_from(
            ["", *(f"{name}:" for name in SCHEMES), "/", "udp://", "serial://", "tcp:["]
        ),
        st.text(st.one_of(st.sampled_from("/:,.?=[]%@ 019azCOM"), st.characters()), max_size=30),
    ).map("".join)
)
def test_any_text_is_refused_or_has_a_stable_canonical_form(url: str) -> None:
    try:
        endpoint = parse_url(url)
    except LinkError:
        return
    assert parse_url(str(endpoint)) == endpoint


def test_the_table_is_whole() -> None:
    text = help_text()
    assert len(text.splitlines()) == len(SCHEMES)
    spellings = [
        spelling for scheme in SCHEMES.values() for spelling in (scheme.name, *scheme.aliases)
    ]
    assert len(spellings) == len(set(spellings))
    for name, scheme in SCHEMES.items():
        assert parse_url(scheme.example).scheme == name == scheme.name
        for part in (scheme.syntax, scheme.help, scheme.example):
            assert part in text


def test_only_a_serial_link_imports_pyserial() -> None:
    code = """
import sys
from companion.links import help_text, open_link
help_text()
for url in ("memory:x", "udpin:127.0.0.1:0", "tcpin:127.0.0.1:0"):
    open_link(url).close()
sys.exit("serial" in sys.modules)
"""
    root = ROOT
    subprocess.run([sys.executable, "-c", code], check=True, cwd=root, timeout=30)


@pytest.mark.parametrize(
    ("scheme", "kind"), [("udpin", socket.SOCK_DGRAM), ("tcpin", socket.SOCK_STREAM)]
)
def test_an_address_in_use_says_so(scheme: str, kind: socket.SocketKind) -> None:
    with socket.socket(socket.AF_INET, kind) as taken:
        taken.bind(("127.0.0.1", 0))
        if kind == socket.SOCK_STREAM:
            taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(
            LinkError, match=rf"{scheme}:127.0.0.1:{port}: address already in use; stop the other"
        ):
            open_link(f"{scheme}:127.0.0.1:{port}")


@pytest.mark.parametrize(
    ("url", "call"), [("udp:192.0.2.1:14550", "udpout"), ("tcpin:192.0.2.1:14550", "tcp")]
)
def test_listening_on_somebody_elses_address_suggests_calling_it(url: str, call: str) -> None:
    with pytest.raises(
        LinkError, match=rf"not an address of this computer; .* call it with {call}:192.0.2.1:14550"
    ):
        open_link(url)


@pytest.mark.parametrize("scheme", ["udpin", "udpout", "tcp", "tcpin"])
def test_a_host_that_does_not_resolve_says_so(scheme: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_such_host(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", no_such_host)
    with pytest.raises(
        LinkError, match=r"cannot find the host 'nowhere' .* check the name or give its IP address"
    ):
        open_link(f"{scheme}:nowhere:14550")


def test_a_host_name_that_cannot_be_encoded_says_so() -> None:
    with pytest.raises(LinkError, match="cannot find the host"):
        open_link("tcp:a..b")


@pytest.mark.parametrize("ports", [["/dev/serial/by-id/usb-Cube-if00", "/dev/ttyACM1"], []])
def test_a_missing_serial_port_is_waited_for_and_those_that_exist_are_listed(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    ports: list[str],
) -> None:
    from companion.links import serial_port

    logging.getLogger("kollsman.links").disabled = False  # import-linter disables loggers
    monkeypatch.setattr(serial_port, "serial_ports", lambda: ports)
    link = open_link(f"{tmp_path}/ttyACM0")
    assert link.state is LinkState.WAITING
    listed = ", ".join(ports) or "none, is the cable plugged in"
    assert re.search(rf"there is no .*; serial ports here: {listed}.*waiting", caplog.text)
    link.close()


def test_a_broadcast_address_is_refused() -> None:
    with pytest.raises(LinkError, match=r"broadcast address; .* udpin:0.0.0.0:14550"):
        open_link("udpout:255.255.255.255:14550")


def test_a_path_that_is_no_serial_port_says_what_it_is(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="is a directory"):
        open_link(f"{tmp_path}:57600")
    log = tmp_path / "flight.tlog"
    log.write_bytes(b"")
    with pytest.raises(
        LinkError, match="is a file, not a serial port; to read a log use 'kollsman replay'"
    ):
        open_link(str(log))
    with pytest.raises(LinkError, match="cannot be used as a serial port"):
        open_link("/dev/null")


@pytest.mark.parametrize(
    ("code", "message"),
    [(errno.EACCES, "permission denied; .* dialout"), (errno.EBUSY, "in use by another program")],
)
def test_a_port_we_may_not_open_says_why(
    code: int, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise serial.SerialException(code, os.strerror(code))

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(LinkError, match=message):
        open_link("/dev/ttyX")


def test_a_baud_rate_the_hardware_refuses_is_an_error_of_the_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise ValueError("Failed to set custom baud rate (1234567)")

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(LinkError, match=r"Failed to set custom baud rate \(1234567\)"):
        open_link("/dev/null,1234567")
