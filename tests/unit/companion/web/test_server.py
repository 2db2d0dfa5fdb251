"""The server of the live page, on real sockets."""

import http.client
import json
import socket
import time
from collections.abc import Iterator
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families

from companion.errors import ConfigError
from companion.web.board import Board
from companion.web.server import MOST_CONNECTIONS, WebServer
from companion.web.settings import Address, read_address
from companion.web.snapshot import Snapshots
from tests.e2e.test_service import Bench

LOOPBACK = Address("127.0.0.1", 0)


class Site:
    """A server on a free port, and a snapshot of a vehicle at 500 m on its board."""

    def __init__(self) -> None:
        self.board = Board()
        self.bench = Bench()
        self.snapshots = Snapshots(self.bench.service, self.board)
        for second in range(20):
            self.bench.second(10_000 + 1000 * second)
            self.snapshots.poll()
        self.server = WebServer(LOOPBACK, self.board, ["kollsman.example"])
        self.server.start()

    def put(self) -> None:
        self.board.put(self.snapshots.take(self.bench.clock.now_us()))

    def get(
        self, path: str, method: str = "GET", **headers: str
    ) -> tuple[int, bytes, dict[str, str]]:
        connection = http.client.HTTPConnection("127.0.0.1", self.server.address.port, timeout=5)
        try:
            connection.request(method, path, headers=headers)
            answer = connection.getresponse()
            return answer.status, answer.read(), {k.lower(): v for k, v in answer.getheaders()}
        finally:
            connection.close()

    def stream(self) -> socket.socket:
        """A page that has asked for the events and has read nothing yet."""
        page = socket.create_connection(("127.0.0.1", self.server.address.port), 5)
        page.sendall(b"GET /api/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        return page

    def close(self) -> None:
        self.server.close()
        self.bench.close()


@pytest.fixture(scope="module")
def shared() -> Iterator[Site]:
    made = Site()
    yield made
    made.close()


@pytest.fixture
def site(shared: Site) -> Site:
    shared.put()
    return shared


@pytest.mark.parametrize("path", ["/", "/page.css", "/style.css", "/style.js", "/curves.js"])
def test_the_page_asks_for_nothing_from_elsewhere(site: Site, path: str) -> None:
    status, body, headers = site.get(path)
    assert status == 200
    assert b"//" not in body.replace(b"// ", b"")  # comments of the scripts have a space
    assert "default-src 'none'" in headers["content-security-policy"]


@pytest.mark.parametrize(
    ("host", "expected"),
    [
        ("127.0.0.1:8080", 200),
        ("localhost", 200),
        ("[::1]:8080", 200),
        ("192.168.4.1:8080", 200),
        ("kollsman.example", 200),
        ("KOLLSMAN.example:80", 200),
        ("evil.example", 403),
        ("localhost.evil.example", 403),
        ("127.0.0.1.evil.example", 403),
        ("[::1", 403),
        ("", 403),
    ],
)
def test_a_host_that_is_not_ours_is_refused(site: Site, host: str, expected: int) -> None:
    """A site that points its own name at this machine must not read the page (DNS rebinding)."""
    for path in ("/", "/api/state", "/api/events") if expected == 403 else ("/", "/api/state"):
        assert site.get(path, Host=host)[0] == expected


def test_another_origin_is_refused(site: Site) -> None:
    own = f"127.0.0.1:{site.server.address.port}"
    assert site.get("/api/state", Host=own, Origin=f"http://{own}")[0] == 200
    for origin in ("http://evil.example", "null", "http://127.0.0.1:1"):
        assert site.get("/api/state", Host=own, Origin=origin)[0] == 403


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH"])
def test_nothing_can_be_changed(site: Site, method: str) -> None:
    assert site.get("/api/state", method)[0] == 405


def test_state_is_the_report_schema(site: Site) -> None:
    status, body, _ = site.get("/api/state")
    found = json.loads(body)
    assert status == 200
    assert (found["schema"], found["command"]) == ("kollsman-report/1", "run")
    assert found["sessions"][0]["altitude"]["last_m"] == pytest.approx(500.0, abs=3.0)
    assert found["age_s"] < 2.0


def test_metrics_are_what_prometheus_reads(site: Site) -> None:
    status, body, headers = site.get("/metrics")
    assert status == 200
    assert headers["content-type"].startswith("text/plain; version=0.0.4")
    samples = {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(body.decode())
        for sample in family.samples
    }
    assert samples["kollsman_altitude_amsl_meters", ()] == pytest.approx(500.0, abs=3.0)
    assert samples["kollsman_qnh_pascals", ()] == pytest.approx(101_325.0, abs=100.0)
    assert samples["kollsman_health", (("state", "OK"),)] == 1.0
    assert samples["kollsman_health", (("state", "LOST"),)] == 0.0
    used = ("kollsman_samples_total", (("sensor", "pressure"), ("verdict", "used")))
    assert samples[used] == 100.0
    assert not any("nan" in str(value).lower() for value in samples.values())


def test_healthz_tells_whether_there_is_an_altitude() -> None:
    site = Site()
    try:
        site.put()
        assert site.get("/healthz")[0] == 200
        site.board._slot = None
        assert (site.get("/healthz")[0], site.get("/api/state")[0]) == (503, 503)
        site.bench.clock.advance_s(10.0)
        site.bench.turn()
        site.put()
        status, body, _ = site.get("/healthz")
        assert (status, json.loads(body)["status"]) == (503, "LOST")
        slot = site.board._slot
        assert slot is not None
        site.board._slot = (slot[0], slot[1] - 60.0)
        status, body, _ = site.get("/healthz")
        assert (status, json.loads(body)["status"]) == (503, "STALLED")
        assert site.get("/metrics")[0] == 200
    finally:
        site.close()


def events_of(page: socket.socket, count: int) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    with page.makefile("rb") as lines:
        while len(found) < count:
            line = lines.readline()
            assert line, "the stream has ended"
            if line.startswith(b"data: "):
                found.append(json.loads(line.removeprefix(b"data: ")))
    return found


def test_pages_get_the_newest_snapshot(site: Site) -> None:
    with site.stream() as page:
        (event,) = events_of(page, 1)
        assert event["state"]["sessions"][0]["health"]["at_end"] == "OK"
        site.put()
        (event,) = events_of(page, 1)
        assert event["age_s"] < 1.0


def test_a_page_that_reads_nothing_delays_nobody() -> None:
    """Putting takes microseconds, whatever the pages do, and the server goes on for the others."""
    site = Site()
    try:
        lazy = [site.stream() for _ in range(8)]
        snapshot = site.snapshots.take(site.bench.clock.now_us())
        big = snapshot._replace(document=snapshot.document | {"notes": "x" * 200_000})
        longest_s = 0.0
        for _ in range(40):  # 8 MB for each page: more than any socket buffers
            started_s = time.perf_counter()
            site.board.put(big)
            longest_s = max(longest_s, time.perf_counter() - started_s)
            time.sleep(0.03)
        assert longest_s < 0.05
        assert site.get("/")[0] == 200
        site.put()
        with site.stream() as eager:
            (event,) = events_of(eager, 1)
            assert "notes" not in event["state"] or event["state"]["notes"] != "x" * 200_000
        for page in lazy:
            page.close()
    finally:
        started_s = time.perf_counter()
        site.close()
        assert time.perf_counter() - started_s < 4.0


def test_connections_are_bounded_and_come_back() -> None:
    site = Site()
    try:
        pages, answers = [], []
        for _ in range(MOST_CONNECTIONS + 2):
            pages.append(site.stream())
            answers.append(pages[-1].recv(12)[-3:])
        assert answers == [b"200"] * (MOST_CONNECTIONS - 1) + [b"503"] * 3
        for page in pages:
            page.close()
        deadline = time.monotonic() + 10.0
        while site.get("/")[0] != 200:
            assert time.monotonic() < deadline
            time.sleep(0.1)
    finally:
        site.close()


def test_closing_ends_the_thread() -> None:
    site = Site()
    with site.stream() as page:
        events_of(page, 1)
        site.close()
    assert not site.server.is_alive
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", site.server.address.port), 1)


def test_a_port_that_is_taken_is_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ConfigError, match=f"127.0.0.1:{port}: .*in use"):
            WebServer(Address("127.0.0.1", port), Board())


@pytest.mark.parametrize(
    ("text", "address", "is_loopback"),
    [
        ("127.0.0.1:8080", Address("127.0.0.1", 8080), True),
        ("8081", Address("127.0.0.1", 8081), True),
        ("localhost:0", Address("localhost", 0), True),
        ("0.0.0.0:80", Address("0.0.0.0", 80), False),
        ("[::1]:90", Address("::1", 90), True),
        ("pi.local", Address("pi.local", 8080), False),
    ],
)
def test_addresses(text: str, address: Address, is_loopback: bool) -> None:
    assert read_address(text) == address
    assert address.is_loopback is is_loopback


@pytest.mark.parametrize("text", ["", ":80", "host:port", "host:70000", "::1", "http://host:80"])
def test_what_is_no_address(text: str) -> None:
    with pytest.raises(ValueError, match="give HOST:PORT"):
        read_address(text)
