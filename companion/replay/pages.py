"""The flight report: one HTML file for each session, without network access; and an index page.

A page holds text, tables, the curves (`companion.plots.packing`) and uPlot (MIT licence, 50 kB,
in ``companion/plots/page/``). It draws the smallest and the largest value of each pixel column from
the full data at every zoom, so no curve is decimated beforehand and no peak is hidden. Plotly's
script alone would be 4.7 MB in every file.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from companion import __version__, whole_file
from companion.errors import ConfigError
from companion.plots import style
from companion.plots.packing import pack
from companion.plots.panels import Panel, panels
from companion.plots.ranges import limits
from companion.replay.curves import Curves
from companion.replay.report_tables import about, cards, tables

PAGE = Path(__file__).parents[1] / "plots" / "page"
FOOTER = (
    f"Written by Kollsman {__version__}. The page needs no network; charts by uPlot (MIT licence)."
)


def write_report(
    path: Path,
    title: str,
    session: dict[str, Any],
    curves: Curves,
    damage: Mapping[str, int] | None = None,
) -> None:
    """Write the page of one session.

    Parameters
    ----------
    title : name of the flight.
    session : an object of ``sessions`` of the report schema.
    curves : its curves.
    damage : what could not be read of the log, by cause.

    Raises `ConfigError` when the page cannot be written, or jinja2 is missing.
    """
    flight = flight_object(session, curves) if curves.tables else None
    context = {
        "title": title,
        "about": about(session),
        "findings": session["findings"],
        "cards": cards(session),
        "tables": tables(session, curves, damage or {}),
        "footer": FOOTER,
        "flight": _script(flight) if flight else None,
        "uplot_css": _asset("uPlot.min.css"),
        "uplot_js": _asset("uPlot.iife.min.js"),
        "charts_js": _asset("charts.js"),
    }
    _write(path, "report.html", context)


def write_index(path: Path, title: str, rows: Sequence[dict[str, Any]]) -> None:
    """Write the index page of several sessions: ``name``, ``href`` (None without a page),
    ``session`` (of the report schema) or ``error`` each. Raises `ConfigError`."""
    context = {
        "title": title,
        "about": f"{len(rows)} flights: wrong altitudes first, then by the gravest finding.",
        "rows": [_row(each) for each in rows],
        "footer": FOOTER,
    }
    _write(path, "index.html", context)


def _row(row: dict[str, Any]) -> dict[str, Any]:
    head = {"name": row["name"], "href": row["href"], "failed": row["error"] is not None}
    if row["error"] is not None:
        return head | {"verdict": row["error"], "score": "", "minutes": "", "start": ""}
    session = row["session"]
    return head | {
        "verdict": session["reason"],
        "score": f"{session['score_m']:.1f}",
        "minutes": f"{session['duration_s'] / 60.0:.1f}",
        "start": (session["start_utc"] or "")[:16].replace("T", " "),
    }


def flight_object(session: dict[str, Any], curves: Curves) -> dict[str, Any]:
    """What ``charts.js`` draws, JSON-ready."""
    start_s, has_utc = _start_s(session)
    shown = [each for each in panels(curves.reference) if _is_known(each, curves)]
    return {
        "start_s": start_s,
        "has_utc": has_utc,
        "duration_s": curves.duration_s,
        "error_word": "error" if curves.reference == "truth" else "difference",
        "mode_shades": style.MODE_SHADES,
        "error_colours": style.ERROR_COLOURS,
        "panels": [asdict(each) | {"limits": limits(each, curves.tables)} for each in shown],
        "spans": {
            name: [[round(s.from_s, 3), round(s.to_s, 3), s.name, s.level] for s in spans]
            for name, spans in curves.spans.items()
        },
        "packed": pack(curves.tables),
    }


def _start_s(session: dict[str, Any]) -> tuple[float, bool]:
    """The time of day of the first height in UTC, or the vehicle's clock where no date is known."""
    start = session["start_vehicle_utc"] or session["start_utc"]
    if start is None:
        return session["start_boot_s"], False
    hours, minutes, seconds = start[11:23].split(":")
    return int(hours) * 3600.0 + int(minutes) * 60.0 + float(seconds), True


def _is_known(panel: Panel, curves: Curves) -> bool:
    for line in panel.lines:
        values = curves.tables.get(line.table, {}).get(line.column)
        if values is not None and np.isfinite(values).any():
            return True
    return False


def _script(value: Any) -> Any:
    """JSON that can stand inside a ``<script>``."""
    from markupsafe import Markup

    return Markup(json.dumps(value, separators=(",", ":")).replace("<", "\\u003c"))


def _asset(name: str) -> Any:
    from markupsafe import Markup

    return Markup((PAGE / name).read_text(encoding="utf-8"))


def _write(path: Path, template: str, context: dict[str, Any]) -> None:
    try:
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
    except ImportError:
        raise ConfigError(f"{path}: needs jinja2: pip install 'kollsman[report]'") from None
    environment = Environment(
        loader=FileSystemLoader(PAGE), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    text = environment.get_template(template).render(context | {"css": _asset("report.css")})
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        whole_file.write(path, text.encode("utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from None
