"""The flight report: one file that needs no network, drawn by a real browser."""

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.errors import ConfigError
from companion.logs.tlog import TlogReader, TlogWriter
from companion.mavlink.codec import Encoder, mavlink
from companion.replay.curves import curves_of
from companion.replay.reports import check, write_reports
from companion.replay.run import Replayed, replay
from companion.samples import Kind
from tests import flights, logfiles

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
SMALL: dict[str, Any] = {
    "duration_s": 120.0,
    "imu_hz": 4.0,
    "pressure_hz": 5.0,
    "gnss_hz": 2.0,
    "attitude_hz": 4.0,
}


@pytest.fixture(scope="module")
def replayed(short_hop: Path) -> Replayed:
    return replay(short_hop)


@pytest.fixture(scope="module")
def page(replayed: Replayed, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "short-hop.html"
    assert write_reports(replayed, path, "short-hop.tlog") == [path]
    return path


def test_the_page_is_one_small_file_with_the_verdict_first(page: Path, replayed: Replayed) -> None:
    text = page.read_text(encoding="utf-8")
    assert len(text) < 1_500_000
    assert not re.search(r"""(src|href)=["']?(https?:)?//""", text)
    assert "url(http" not in text
    body = text[text.index("<body>") :]
    findings = replayed.report["sessions"][0]["findings"]
    first = findings[0]["text"].split(" (95")[0].split(" m")[0]
    assert body.index(first) < body.index('id="panels"') < body.index("<table>")


def test_the_page_holds_every_sample(page: Path, replayed: Replayed) -> None:
    from companion.plots.packing import unpack

    text = page.read_text(encoding="utf-8")
    match = re.search(r'<script type="application/json" id="flight">(.*?)</script>', text)
    assert match is not None
    flight = json.loads(match[1])
    tables = unpack(flight["packed"])
    assert tables["estimate"]["t"].size == replayed.sessions[0].seen.ticks().size
    errors = tables["estimate"]["difference_m"]
    late = tables["estimate"]["t"] > 60.0
    rmse_m = float(np.sqrt(np.nanmean(errors[late] ** 2)))
    told = replayed.report["sessions"][0]["sources"]["estimate"]["rmse_m"]
    assert rmse_m == pytest.approx(told, abs=0.02)
    assert {"flight mode", "armed", "health", "barometer", "GNSS"} <= set(flight["spans"])
    names = [panel["name"] for panel in flight["panels"]]
    assert names[:2] == ["altitude", "difference"]
    assert {"qnh", "offsets", "weather", "accuracy", "fix", "innovation", "rates", "link"} <= set(
        names
    )


def test_the_signal_of_a_telemetry_radio_is_a_curve(tmp_path: Path) -> None:
    """Of two sessions in one file, each has its own."""
    radio = Encoder(51, 68)
    log = tmp_path / "radio.tlog"
    with TlogWriter(log) as writer:
        for number, start_us in enumerate((1_600_000_000_000_000, 1_600_000_900_000_000)):
            part = tmp_path / f"{number}.tlog"
            logfiles.write_tlog(part, flights.flight(**(SMALL | {"duration_s": 20.0})))
            for k, packet in enumerate(TlogReader(part)):
                writer.write(start_us + k * 10_000, packet.data)
                if k % 100 == 0:
                    level = 200 - 50 * number
                    status = mavlink.MAVLink_radio_status_message(level, 255, 90, 43, 45, 7, 3)
                    writer.write(start_us + k * 10_000 + 1, radio.encode(status))
    found = replay(log)
    levels = []
    for session, reference in zip(found.sessions, found.references, strict=True):
        columns = curves_of(session, reference).tables["radio"]
        assert columns["t"].size > 3
        assert np.isnan(columns["remote_rssi"]).all()
        levels.append(set(columns["rssi"].tolist()))
    assert levels == [{200.0}, {150.0}]


def test_a_name_with_markup_stays_text(replayed: Replayed, tmp_path: Path) -> None:
    path = tmp_path / "x.html"
    write_reports(replayed, path, "<script>alert(1)</script>.tlog")
    assert "<script>alert" not in path.read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_panels_as_a_picture(tmp_path: Path) -> None:
    from PIL import Image

    log, _ = logfiles.write("bin", tmp_path, **SMALL)
    path = tmp_path / "flight.png"
    assert write_reports(replay(log), path, "flight") == [path]
    with Image.open(path) as image:
        assert image.size[0] == 1600
        assert image.size[1] > 3000


def test_several_sessions_have_an_index(tmp_path: Path) -> None:
    log = tmp_path / "two.tlog"
    first, second = (flights.flight(seed=seed, **SMALL) for seed in (1, 2))
    logfiles.write_tlog(log, first)
    more = tmp_path / "more.tlog"
    logfiles.write_tlog(more, second)
    log.write_bytes(log.read_bytes() + more.read_bytes())
    found = replay(log)
    assert len(found.sessions) == 2
    index, *pages = write_reports(found, tmp_path / "out.html", "two.tlog")
    assert [each.name for each in pages] == ["out-1.html", "out-2.html"]
    links = re.findall(r'<a href="([^"]+)"', index.read_text(encoding="utf-8"))
    assert sorted(links) == ["out-1.html", "out-2.html"]


def test_a_gnss_jump_is_told_with_its_size_and_time(tmp_path: Path) -> None:
    """40 m from 100 s on: whether the estimator excludes it or not, the page says so."""
    made = flights.flight(**(SMALL | {"duration_s": 200.0}))
    made.change(Kind.GNSS, "altitude_amsl_m", lambda height: height + 40.0, 100.0, 160.0)
    log = tmp_path / "jump.tlog"
    logfiles.write_tlog(log, made)
    text = replay(log).report["sessions"][0]["verdict"]
    assert re.search(
        r"GNSS (jumped|and barometer parted by|moved away by up to) \+(3[5-9]|4[0-5]) m", text
    )


def test_a_wrong_name_is_refused_before_the_replay() -> None:
    with pytest.raises(ConfigError, match=r"must end with \.html or \.png"):
        check(Path("report.pdf"))


# In a browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    sync_api = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("chromium is not installed (Debian: apt install chromium)")
    with sync_api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.mark.slow
def test_a_browser_draws_it_without_network(browser: Any, page: Path) -> None:
    told: list[str] = []
    asked: list[str] = []
    tab = browser.new_page(viewport={"width": 1280, "height": 900})
    tab.on("console", lambda message: told.append(message.text))
    tab.on("pageerror", lambda error: told.append(str(error)))
    tab.on("request", lambda request: asked.append(request.url))
    tab.goto(page.as_uri())
    tab.wait_for_selector("body[data-ready]")
    assert told == []
    assert asked == [page.as_uri()]
    coloured = tab.evaluate(
        """() => flightView.charts.map(chart => {
          const {width, height} = chart.ctx.canvas;
          const pixels = chart.ctx.getImageData(0, 0, width, height).data;
          let count = 0;
          for (let i = 0; i < pixels.length; i += 4)
            if (pixels[i + 3] > 0 && Math.max(pixels[i], pixels[i + 1], pixels[i + 2])
                - Math.min(pixels[i], pixels[i + 1], pixels[i + 2]) > 40) count++;
          return count;
        })"""
    )
    assert len(coloured) >= 12
    assert min(coloured) > 200  # every panel has a curve
    _zooms_together(tab)
    tab.close()


def _zooms_together(tab: Any) -> None:
    chart = tab.locator("#panel-altitude .u-over")
    box = chart.bounding_box()
    tab.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 50)
    tab.mouse.down()
    tab.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 50, steps=5)
    tab.mouse.up()
    spans = tab.evaluate("flightView.charts.map(c => [c.scales.x.min, c.scales.x.max])")
    whole_s = tab.evaluate("JSON.parse(document.getElementById('flight').textContent).duration_s")
    assert spans[0][1] - spans[0][0] == pytest.approx(0.25 * whole_s, rel=0.02)
    assert all(span == pytest.approx(spans[0], abs=1e-6) for span in spans)
    tab.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 80)
    value = tab.locator("#panel-altitude .legend button", has_text="Kollsman").last
    assert re.search(r"\d+\.\d", value.inner_text())
    tab.click("button[data-do=whole]")
    spans = tab.evaluate("flightView.charts.map(c => c.scales.x.max - c.scales.x.min)")
    assert spans == pytest.approx([whole_s] * len(spans))


@pytest.mark.slow
def test_fingers_zoom_and_move_the_charts_and_scroll_the_page(browser: Any, page: Path) -> None:
    context = browser.new_context(
        viewport={"width": 390, "height": 800}, has_touch=True, is_mobile=True
    )
    tab = context.new_page()
    tab.goto(page.as_uri())
    tab.wait_for_selector("body[data-ready]")
    chart = tab.locator("#panel-altitude .u-over")
    chart.scroll_into_view_if_needed()
    box, screen = chart.bounding_box(), context.new_cdp_session(tab)

    def drag(*fingers: tuple[tuple[float, float], tuple[float, float]]) -> tuple[float, float]:
        """Move each finger from one place to another, in shares of the chart; the zoom after."""
        for step in range(11):
            points = [
                {
                    "x": box["x"] + box["width"] * (x0 + (x1 - x0) * step / 10),
                    "y": box["y"] + box["height"] * (y0 + (y1 - y0) * step / 10),
                    "id": number,
                }
                for number, ((x0, y0), (x1, y1)) in enumerate(fingers)
            ]
            kind = "touchMove" if step else "touchStart"
            screen.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        screen.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        tab.wait_for_timeout(300)
        low, high = tab.evaluate("[flightView.range().min, flightView.range().max]")
        return low, high

    start, end = tab.evaluate("[flightView.range().min, flightView.range().max]")
    third = drag(((0.4, 0.3), (0.2, 0.3)), ((0.6, 0.3), (0.8, 0.3)))
    assert third[1] - third[0] == pytest.approx((end - start) / 3.0, rel=0.05)
    moved = drag(((0.7, 0.3), (0.4, 0.3)))
    assert moved[0] - third[0] == pytest.approx(0.3 * (third[1] - third[0]), rel=0.1)
    before = tab.evaluate("scrollY")
    assert drag(((0.5, 0.9), (0.5, 0.1))) == moved
    assert tab.evaluate("scrollY") > before + 50
    context.close()


@pytest.mark.slow
def test_on_paper_the_charts_are_whole(browser: Any, page: Path) -> None:
    tab = browser.new_page(viewport={"width": 1280, "height": 900})
    tab.goto(page.as_uri())
    tab.wait_for_selector("body[data-ready]")
    tab.emulate_media(media="print")
    tab.set_viewport_size({"width": 680, "height": 960})
    tab.evaluate("flightView.charts.forEach(chart => chart.setSize({width: 1140, height: 170}))")
    widths = (
        "[...document.querySelectorAll('.panel canvas')].map(c => c.getBoundingClientRect().width)"
    )
    assert max(tab.evaluate(widths)) <= 680
    assert tab.locator("#bar").is_hidden()
    tab.close()


@pytest.mark.slow
@pytest.mark.parametrize("width", [320, 390])
def test_a_phone_needs_no_horizontal_scroll(browser: Any, page: Path, width: int) -> None:
    tab = browser.new_page(viewport={"width": width, "height": 700}, device_scale_factor=2)
    tab.goto(page.as_uri())
    tab.wait_for_selector("body[data-ready]")
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    tab.close()
