"""A generated page: tables, figures, Markdown, in one style.

A page is built in reading order::

    page = Page("bound", Path("docs/evaluation"))
    page.text("What is simulated.")
    page.grid("Errors", ["scenario", "RMSE (m)"], [["S1", spread(values)]])
    with page.figure("errors", "Absolute errors of one run.", rows=2) as axes:
        axes[0].plot(t, error, color=BARO)
    page.write()

Nothing here depends on the clock: the same seeds give the same bytes.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from companion.plots.drawing import PANEL_IN, figure, write_png


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


SEED_ROOT: ContextVar[int] = ContextVar("SEED_ROOT", default=0)
"""Root of the random numbers of `generators`: another one draws other numbers for all studies."""

Value = float | str | Spread | None


def spread(values: ArrayLike) -> Spread:
    """Mean and sample standard deviation of one value a seed; the latter is 0 for a single one."""
    array = np.asarray(values, dtype=np.float64).ravel()
    return Spread(float(array.mean()), float(array.std(ddof=1)) if array.size > 1 else 0.0)


def generators(key: str, seeds: int) -> list[np.random.Generator]:
    """One random generator a Monte-Carlo run of study `key`: the first n are the same however many
    are asked for."""
    drawn = [SEED_ROOT.get()] if SEED_ROOT.get() else []
    root = np.random.SeedSequence([ord(letter) for letter in key] + drawn)
    return [np.random.default_rng(child) for child in root.spawn(seeds)]


class Block(Protocol):
    """A part of a page that is not plain text."""

    def markdown(self) -> str: ...


@dataclass(frozen=True)
class Grid:
    """A table without verdicts: a matrix of our own results."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[Value]]

    def markdown(self) -> str:
        return f"### {self.title}\n\n{markdown_table(self.header, self.rows)}"


@dataclass(frozen=True)
class Figure:
    """A PNG beside the page."""

    file: str
    caption: str

    def markdown(self) -> str:
        return f"![{self.caption}]({self.file})\n\n*{self.caption}*"


@dataclass
class Page:
    """A page built in reading order; its files go to the folder `out` and begin with `slug`.
    Without `out` nothing is written: figures are set up but not drawn."""

    slug: str
    out: Path | None
    blocks: list[str | Block] = field(default_factory=list)

    def text(self, paragraph: str) -> None:
        """Add Markdown as it is: a paragraph, a list, or a heading."""
        self.blocks.append(paragraph)

    def grid(self, title: str, header: Sequence[str], rows: Sequence[Sequence[Value]]) -> None:
        """Add a table without verdicts."""
        self.blocks.append(Grid(title, header, rows))

    @contextmanager
    def figure(
        self,
        name: str,
        caption: str,
        *,
        rows: int = 1,
        columns: int = 1,
        panel_in: float = PANEL_IN,
        **kwargs: Any,
    ) -> Iterator[Any]:
        """Draw a figure of `rows` x `columns` panels; yields a flat array of Matplotlib axes.

        `panel_in` is the height of a panel in inches; `kwargs` go to ``Figure.subplots``
        (``sharex`` and the like). The panels' legends, titles and labels are up to the caller; the
        file is ``<slug>-<name>.png``.
        """
        with figure(rows, columns, panel_in, **kwargs) as (canvas, axes):
            yield axes
            file = f"{self.slug}-{name}.png"
            if self.out is not None:
                write_png(canvas, self.out / file)
        self.blocks.append(Figure(file, caption))

    def head(self) -> list[str]:
        """The paragraphs above the blocks, title first."""
        return []

    def markdown(self) -> str:
        """The whole page."""
        body = [block if isinstance(block, str) else block.markdown() for block in self.blocks]
        return "\n\n".join(part.strip() for part in self.head() + body) + "\n"

    def write(self) -> Path:
        """Write the Markdown file, and return its path. Raises `ValueError` without a folder."""
        if self.out is None:
            raise ValueError(f"the page {self.slug} has no folder: give `out`")
        self.out.mkdir(parents=True, exist_ok=True)
        path = self.out / f"{self.slug}.md"
        path.write_text(self.markdown(), encoding="utf-8", newline="\n")
        return path


def _number(value: float) -> str:
    return f"{value:.6g}"


def _cell(value: Value) -> str:
    text = (
        "" if value is None else _number(value) if isinstance(value, (int, float)) else str(value)
    )
    return text.replace("|", "\\|").replace("\n", " ")


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[Value]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(_cell(value) for value in row) + " |" for row in rows]
    return "\n".join(lines)
