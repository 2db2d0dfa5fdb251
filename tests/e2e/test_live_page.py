"""The live page in a headless Chromium, beside a simulated flight. Skipped without Chromium."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from tests.live import Companion, free_port, until
from tests.paths import ROOT

CHROMIUM = next(
    (path for path in ("/usr/bin/chromium", "/usr/bin/chromium-browser") if Path(path).exists()), ""
)
playwright = pytest.importorskip("playwright.sync_api")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not CHROMIUM, reason="no Chromium (Debian: apt install chromium)"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]
IN_PX = """canvas => {
  const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  const colours = new Set();
  for (let k = 0; k < pixels.length; k += 4)
    colours.add((pixels[k] << 16) + (pixels[k + 1] << 8) + pixels[k + 2]);
  return colours.size;
}"""


class Watched:
    """A page, with what its console said and what it asked for."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.errors: list[str] = []
        self.requests: list[str] = []
        page.on("console", self._said)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("request", lambda each: self.requests.append(each.url))

    def _said(self, message: Any) -> None:
        if message.type == "error":
            self.errors.append(message.text)

    def number(self, element: str) -> float:
        return float(self.page.inner_text(f"#{element}"))

    @property
    def connection(self) -> str:
        return str(self.page.get_attribute("body", "data-connection"))

    def wait(self, condition: str, timeout_s: float = 30.0) -> None:
        """Until a JavaScript expression is true; the page's security policy forbids it to poll."""
        deadline_s = time.monotonic() + timeout_s
        while not self.page.evaluate(condition):
            assert time.monotonic() < deadline_s, condition
            self.page.wait_for_timeout(50)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as started:
        made = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield made
        made.close()


@pytest.fixture
def flight() -> Iterator[int]:
    """The UDP port that a simulated flight sends to, ten times as fast as real time."""
    port = free_port()
    fly = ["fly", "short-hop", "--link", f"udpout:127.0.0.1:{port}", "--speed", "5"]
    process = subprocess.Popen(
        [sys.executable, "-m", "sim.cli", *fly],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=dict(os.environ),
    )
    yield port
    process.send_signal(signal.SIGINT)
    process.wait(20)


def companion(port: int, http: int) -> Companion:
    return Companion(f"udpin:127.0.0.1:{port}", "--http", f"127.0.0.1:{http}")


def test_the_page_follows_a_flight_and_a_restart(browser: Any, flight: int) -> None:
    http = free_port(socket.SOCK_STREAM)
    with companion(flight, http) as first:
        watched = Watched(browser.new_page(viewport={"width": 1300, "height": 900}))
        page = watched.page
        page.goto(f"http://127.0.0.1:{http}/")
        watched.wait("document.body.dataset.health === 'OK'", 60.0)
        start_m = watched.number("altitude")
        watched.wait(
            f"Number(document.getElementById('altitude').textContent) > {start_m} + 20", 60.0
        )
        assert watched.connection == "live"
        assert "ArduPilot 1/1" in page.inner_text("#vehicle")
        assert page.inner_text("#sensors tbody tr:has-text('barometer') td:nth-child(4)") == "used"
        assert page.locator("#texts li").count() > 0
        for name in ("altitude", "difference", "climb", "qnh"):
            assert page.eval_on_selector(f"[data-curve={name}] canvas", IN_PX) > 20, name
        rows = page.evaluate("state.rows.length")

        first.stop()
    watched.wait("document.body.dataset.connection === 'lost'", 10.0)
    assert page.is_visible("#stale")
    assert "No connection to Kollsman" in page.inner_text("#stale")
    assert "NOT CONNECTED" in page.title()
    refused = [text for text in watched.errors if "ERR_CONNECTION_REFUSED" not in text]
    watched.errors.clear()
    with companion(flight, http):
        watched.wait("document.body.dataset.connection === 'live'", 30.0)
        watched.wait(f"state.rows.length > {rows}", 10.0)
        assert page.is_hidden("#stale")
        until(lambda: watched.page.wait_for_timeout(50) or "Kollsman" in page.title())
    assert not [text for text in refused if "INCOMPLETE_CHUNKED" not in text]
    assert {urlsplit(url).netloc for url in watched.requests} == {f"127.0.0.1:{http}"}
    page.close()


def test_a_phone_shows_it_without_scrolling_sideways_and_the_curves_are_linked(
    browser: Any, flight: int
) -> None:
    http = free_port(socket.SOCK_STREAM)
    with companion(flight, http):
        watched = Watched(browser.new_page(viewport={"width": 360, "height": 740}))
        page = watched.page
        page.goto(f"http://127.0.0.1:{http}/")
        watched.wait("document.body.dataset.health === 'OK'", 60.0)
        watched.wait("state.rows.length > 20")
        assert page.evaluate("document.documentElement.scrollWidth") == 360
        page.locator("[data-curve=altitude] canvas").scroll_into_view_if_needed()
        box = page.locator("[data-curve=altitude] canvas").bounding_box()
        page.mouse.move(box["x"] + box["width"] - 20, box["y"] + 60)
        page.wait_for_timeout(300)
        watched.wait("state.hoverS !== null")
        reading = "[data-curve=climb] .legend b"
        shown = page.inner_text(reading)
        expected = page.evaluate(
            "nearest(state.rows, state.hoverS)[state.column.climb_mps].toFixed(1)"
        )
        assert shown == expected
        assert not watched.errors
        page.close()
