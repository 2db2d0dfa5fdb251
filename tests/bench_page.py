"""The figures of `make bench` on disk, and the part of the README that shows them.

``docs/bench.json`` keeps the rows of every part and when they were measured, so that parts can be
measured one at a time. The README shows the rows that have an aim, between two marks; only
`python -m tests.bench --write` writes there.
"""

import json
import os
import platform
import sys
from collections.abc import Mapping, Sequence
from datetime import date
from typing import Any

from tests.paths import ROOT

KEPT = ROOT / "docs/bench.json"
README = ROOT / "README.md"
BEGIN, END = "<!-- bench: begin, written by `make bench` -->\n", "<!-- bench: end -->\n"

Row = tuple[str, str, str]
Parts = Mapping[str, Mapping[str, Any]]


def table(rows: Sequence[Sequence[str]]) -> str:
    """Rows as Markdown."""
    lines = ["| figure | measured | aim |", "|---|---|---|"]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]) + "\n"


def keep(part: str, rows: Sequence[Row]) -> None:
    """Put the rows of a part in the place of its earlier ones."""
    parts = dict(kept())
    parts[part] = {"measured": _machine(), "rows": rows}
    KEPT.write_text(json.dumps(parts, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def kept() -> Parts:
    """The parts, as they were measured."""
    found: Parts = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else {}
    return found


def write_readme() -> None:
    """Put the figures into the README."""
    README.write_text(with_figures(README.read_text(encoding="utf-8"), kept()), encoding="utf-8")


def with_figures(text: str, parts: Parts) -> str:
    """A README with these figures between its marks."""
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    return before + BEGIN + figures(parts) + END + after


def figures(parts: Parts) -> str:
    """The rows that have an aim, and when each part was measured."""
    rows = [row for part in parts.values() for row in part["rows"] if row[2]]
    measured: dict[str, list[str]] = {}
    for name, part in parts.items():
        measured.setdefault(part["measured"], []).append(f"`{name}`")
    when = "; ".join(f"{', '.join(names)}: {text}" for text, names in measured.items())
    return f"{table(rows)}\nMeasured: {when}.\n"


def _machine() -> str:
    python = ".".join(map(str, sys.version_info[:2]))
    load = os.getloadavg()[2]
    return (
        f"{date.today()}, {os.cpu_count()} cores ({platform.machine()}), Python {python}, "
        f"load {load:.1f}"
    )
