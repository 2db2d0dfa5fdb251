"""The page of a reproduced paper: tables of printed against ours, figures, Markdown.

A module of this package builds one in reading order::

    page = Page("H", seeds, out)
    page.text("What is simulated.")
    page.table("Table 1", [
        compare("P at iteration 400", printed=160.693, ours=spread(values), within=3.0, unit="m2", where="Table 1"),
        Row("P below R_GPS", printed="always", ours="always", verdict=Verdict.REPRODUCES, where="(21)"),
    ])
    with page.figure("errors", "Absolute errors of one run.", rows=2) as axes:
        axes[0].plot(t, error, color=BARO)
    return page

A verdict is computed from the numbers wherever there are two to compare (`compare`), so that a page cannot go on
claiming what no longer holds. Nothing here depends on the clock: the same seeds give the same bytes.
"""

import io
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from companion import __version__
from sim.papers import PAPERS, Paper

TRUTH, BARO, GNSS, INERTIAL = "#222222", "#d1772a", "#3874b8", "#8a5aa8"
FUSED, OTHER, BOUND = "#21854c", "#b8403a", "#8c8c8c"
"""Colours by role, the same on every page. FUSED is the paper's own proposal, OTHER what it is compared with."""

_WIDTH_IN, _PANEL_IN, _DPI, _COLOURS = 8.0, 2.7, 110, 48

_STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#777777",
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.xmargin": 0.01,
    "axes.formatter.useoffset": False,
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
}


class Verdict(Enum):
    """What became of a printed number or claim."""

    REPRODUCES = "reproduces"
    ONLY_UNDER = "only under this reading"
    """of an ambiguous or wrong print; the note says which"""
    DOES_NOT = "**does not**"
    NOT_COMPARABLE = "not comparable"
    """depends on what the paper does not give, or on its computer"""


@dataclass(frozen=True)
class Spread:
    """Mean and standard deviation over the seeds."""

    mean: float
    sd: float

    def __str__(self) -> str:
        if not math.isfinite(self.mean) or not self.sd > 0.0:
            return _number(self.mean)
        decimals = min(8, max(0, 1 - math.floor(math.log10(self.sd))))
        return f"{self.mean:.{decimals}f} ± {self.sd:.{decimals}f}"


Value = float | str | Spread | None


def spread(values: ArrayLike) -> Spread:
    """Mean and sample standard deviation of one value a seed; the latter is 0 for a single one."""
    array = np.asarray(values, dtype=np.float64).ravel()
    return Spread(float(array.mean()), float(array.std(ddof=1)) if array.size > 1 else 0.0)


def generators(key: str, seeds: int) -> list[np.random.Generator]:
    """One random generator a Monte-Carlo run of paper `key`: the first n are the same however many are asked for."""
    root = np.random.SeedSequence([ord(letter) for letter in key])
    return [np.random.default_rng(child) for child in root.spawn(seeds)]


@dataclass(frozen=True)
class Row:
    """One printed number or claim, and ours."""

    claim: str
    printed: Value = None
    ours: Value | tuple[Value, ...] = None
    """several where a table has several columns of ours"""
    verdict: Verdict = Verdict.NOT_COMPARABLE
    unit: str = ""
    where: str = ""
    """equation, table, figure or section of the paper"""
    note: str = ""


def compare(
    claim: str,
    printed: float,
    ours: float | Spread,
    within: float,
    *,
    reading: str = "",
    unit: str = "",
    where: str = "",
    note: str = "",
) -> Row:
    """A row whose verdict follows from the numbers.

    Reproduces when our mean is no further than `within` (same unit) from the printed value; given a `reading` (what has
    to be assumed about the print), only under it.
    """
    mean = ours.mean if isinstance(ours, Spread) else ours
    verdict = Verdict.ONLY_UNDER if reading else Verdict.REPRODUCES
    if not abs(mean - printed) <= within:
        verdict = Verdict.DOES_NOT
    notes = "; ".join(part for part in (reading, note) if part)
    return Row(claim, printed, ours, verdict, unit, where, notes)


def holds(
    claim: str, condition: bool, ours: Value, *, printed: Value = None, unit: str = "", where: str = "", note: str = ""
) -> Row:
    """A row about a claim in words: reproduces when `condition` is true of our numbers."""
    return Row(claim, printed, ours, Verdict.REPRODUCES if condition else Verdict.DOES_NOT, unit, where, note)


@dataclass(frozen=True)
class Table:
    """Printed against ours; `ours` names the columns of ours."""

    title: str
    rows: Sequence[Row]
    ours: tuple[str, ...] = ("ours",)

    def markdown(self) -> str:
        optional = [name for name in ("where", "unit", "note") if any(getattr(row, name) for row in self.rows)]
        header = ["claim", *_only(optional, "where"), "printed", *self.ours, *_only(optional, "unit"), "verdict"]
        header += _only(optional, "note")
        lines = []
        for row in self.rows:
            ours = row.ours if isinstance(row.ours, tuple) else (row.ours,)
            if len(ours) != len(self.ours):
                raise ValueError(f"{self.title}: {row.claim}: {len(ours)} values for {len(self.ours)} columns")
            cells: list[Value] = [row.claim, *([row.where] if "where" in optional else []), row.printed, *ours]
            cells += [row.unit] if "unit" in optional else []
            cells += [row.verdict.value, *([row.note] if "note" in optional else [])]
            lines.append(cells)
        return f"### {self.title}\n\n{_markdown_table(header, lines)}"


@dataclass(frozen=True)
class Grid:
    """A table without verdicts: a matrix of our own results."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[Value]]

    def markdown(self) -> str:
        return f"### {self.title}\n\n{_markdown_table(self.header, self.rows)}"


@dataclass(frozen=True)
class Figure:
    """A PNG beside the page."""

    file: str
    caption: str

    def markdown(self) -> str:
        return f"![{self.caption}]({self.file})\n\n*{self.caption}*"


@dataclass
class Page:
    """The page of one paper, built in reading order; its files go to the folder `out`."""

    key: str
    seeds: int
    out: Path
    blocks: list[str | Table | Grid | Figure] = field(default_factory=list)

    @property
    def paper(self) -> Paper:
        return PAPERS[self.key]

    def text(self, paragraph: str) -> None:
        """Add Markdown as it is: a paragraph, a list, or a heading."""
        self.blocks.append(paragraph)

    def table(self, title: str, rows: Sequence[Row], ours: tuple[str, ...] = ("ours",)) -> None:
        """Add a table of printed against ours."""
        self.blocks.append(Table(title, rows, ours))

    def grid(self, title: str, header: Sequence[str], rows: Sequence[Sequence[Value]]) -> None:
        """Add a table without verdicts."""
        self.blocks.append(Grid(title, header, rows))

    @contextmanager
    def figure(
        self, name: str, caption: str, *, rows: int = 1, columns: int = 1, panel_in: float = _PANEL_IN, **kwargs: Any
    ) -> Iterator[Any]:
        """Draw a figure of `rows` x `columns` panels; yields a flat array of Matplotlib axes.

        `panel_in` is the height of a panel in inches; `kwargs` go to ``Figure.subplots`` (``sharex`` and the like).
        The panels' legends, titles and labels are up to the caller; the file is ``<paper>-<name>.png``.
        """
        import matplotlib as mpl  # noqa: PLC0415
        from matplotlib.figure import Figure as Canvas  # noqa: PLC0415

        with mpl.rc_context(_STYLE):
            canvas = Canvas(figsize=(_WIDTH_IN, rows * panel_in + 0.2), dpi=_DPI, layout="constrained")
            yield canvas.subplots(rows, columns, squeeze=False, **kwargs).ravel()
            file = f"{self.paper.slug}-{name}.png"
            self.out.mkdir(parents=True, exist_ok=True)
            (self.out / file).write_bytes(_small_png(canvas))
        self.blocks.append(Figure(file, caption))

    @property
    def rows(self) -> list[Row]:
        """Every row of every table."""
        return [row for block in self.blocks if isinstance(block, Table) for row in block.rows]

    @property
    def counts(self) -> Counter[Verdict]:
        """How many rows have which verdict."""
        return Counter(row.verdict for row in self.rows)

    def markdown(self) -> str:
        """The whole page."""
        estimators = ", ".join(f"`{name}`" for name in self.paper.estimators)
        command = f"kollsman-sim reproduce {self.key} --seeds {self.seeds} --out docs/papers"
        head = [
            f"# {self.paper.title}",
            f"{self.paper.citation}. Estimators: {estimators}.",
            f"Generated by `{command}` (Kollsman {__version__}, {self.seeds} seeds), never edited by hand. "
            "A value `a ± b` is the mean and the standard deviation over the seeds.",
            f"Of {len(self.rows)} printed numbers and claims: {summary(self.counts)}.",
        ]
        body = [block if isinstance(block, str) else block.markdown() for block in self.blocks]
        return "\n\n".join(part.strip() for part in head + body) + "\n"

    def write(self) -> Path:
        """Write the Markdown file, and return its path."""
        self.out.mkdir(parents=True, exist_ok=True)
        path = self.out / f"{self.paper.slug}.md"
        path.write_text(self.markdown(), encoding="utf-8", newline="\n")
        return path


def summary(counts: Counter[Verdict]) -> str:
    """Such as "21 reproduce, 3 only under one reading, 4 do not"."""
    words = {
        Verdict.REPRODUCES: "reproduce",
        Verdict.ONLY_UNDER: "only under one reading",
        Verdict.DOES_NOT: "do not",
        Verdict.NOT_COMPARABLE: "not comparable",
    }
    return ", ".join(f"{counts[verdict]} {text}" for verdict, text in words.items() if counts[verdict]) or "none"


def _only(names: list[str], name: str) -> list[str]:
    return [name] if name in names else []


def _number(value: float) -> str:
    return f"{value:.6g}"


def _cell(value: Value) -> str:
    text = "" if value is None else _number(value) if isinstance(value, (int, float)) else str(value)
    return text.replace("|", "\\|").replace("\n", " ")


def _markdown_table(header: Sequence[str], rows: Sequence[Sequence[Value]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(_cell(value) for value in row) + " |" for row in rows]
    return "\n".join(lines)


def _small_png(canvas: Any) -> bytes:
    """The figure as a PNG of few colours, a third of the size: the pages are kept in the repository."""
    from PIL import Image  # noqa: PLC0415

    drawn, packed = io.BytesIO(), io.BytesIO()
    canvas.savefig(drawn, format="png", metadata={"Software": None})
    with Image.open(drawn) as image:
        few = image.convert("RGB").quantize(_COLOURS, kmeans=2, dither=Image.Dither.NONE)
        few.save(packed, format="png", optimize=True)
    return packed.getvalue()
