"""Tables of numbers at any width."""

import io
import re

import pytest
from rich.console import Console

from companion import tables

LABELS = {"error to truth (m)": ["vertical-bank", "autopilot"]}
NUMBERS = {f"figure {k}": [f"{k}111.11", f"{k}222.22"] for k in range(14)}


@pytest.mark.parametrize("width", [60, 80, 120])
def test_no_number_is_cut_and_no_row_is_too_long(width: int) -> None:
    text = io.StringIO()
    console = Console(file=text, width=width, force_terminal=True, color_system=None)
    tables.show(LABELS, NUMBERS, console)
    lines = text.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    found = re.findall(r"\d+\.\d+", text.getvalue())
    assert sorted(found) == sorted(cell for cells in NUMBERS.values() for cell in cells)
    assert "…" not in text.getvalue()
    heads = [line for line in lines if "figure" in line]
    assert sum(line.count("figure") for line in heads) == len(NUMBERS)
    assert all(line.startswith("error to truth") for line in heads)


def test_elsewhere_a_row_is_one_line() -> None:
    text = io.StringIO()
    tables.show(LABELS, NUMBERS, Console(file=text, width=40))
    assert len(text.getvalue().splitlines()) == 3
