"""The page of a reproduced paper: tables of printed against ours.

A module of this package builds one in reading order::

    page = Page("H", seeds, out)
    page.text("What is simulated.")
    page.table("Table 1", [
        compare("P at iteration 400", printed=160.693, ours=spread(values), within=3.0, unit="m2",
        where="Table 1"), holds("P is below R_GPS", below(P, R_GPS), P, where="(21)"),
    ])
    return page

A verdict is always computed from numbers by a `Check`, so that a page cannot go on claiming what no
longer holds; no row can be given one. Figures and plain tables: `sim.studies.page`.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import islice, pairwise
from pathlib import Path

from companion import __version__
from sim.studies import page as general
from sim.studies.page import SEED_ROOT, Spread, Value, markdown_table
from sim.studies.papers import PAPERS, Paper


class Match(Enum):
    """How a printed number or claim compares with ours."""

    REPRODUCES = "reproduces"
    ONLY_UNDER = "only under this reading"
    """of an ambiguous or wrong print; the note says which"""
    DOES_NOT = "**does not**"
    NOT_COMPARABLE = "not comparable"
    """depends on what the paper does not give, or on its computer"""


@dataclass(frozen=True)
class Check:
    """A comparison of numbers, chosen before they are known. NaN never passes."""

    test: Callable[..., bool]
    numbers: tuple[float, ...]

    @property
    def passes(self) -> bool:
        return bool(self.test(*self.numbers))

    def fed(self, number: float, place: int) -> "Check":
        """The same comparison with another number in one place."""
        numbers = (*self.numbers[:place], number, *self.numbers[place + 1 :])
        return replace(self, numbers=numbers)


def near(mean: float, printed: float, within: float) -> Check:
    """|mean - printed| <= within."""
    return Check(lambda a, b, c: abs(a - b) <= c, (mean, printed, within))


def below(*numbers: float) -> Check:
    """Each number is below the next."""
    return Check(lambda *n: all(a < b for a, b in pairwise(n)), numbers)


def at_most(number: float, limit: float) -> Check:
    """number <= limit."""
    return Check(lambda a, b: a <= b, (number, limit))


def both(*checks: Check) -> Check:
    """All of the comparisons."""
    sizes = [len(check.numbers) for check in checks]

    def test(*numbers: float) -> bool:
        rest = iter(numbers)
        return all(
            check.test(*islice(rest, size)) for check, size in zip(checks, sizes, strict=True)
        )

    return Check(test, tuple(number for check in checks for number in check.numbers))


@dataclass(frozen=True)
class Row:
    """One printed number or claim, and ours. Without a check the two are not comparable."""

    claim: str
    printed: Value = None
    ours: Value | tuple[Value, ...] = None
    """several where a table has several columns of ours"""
    unit: str = ""
    where: str = ""
    """equation, table, figure or section of the paper"""
    note: str = ""
    check: Check | None = None
    reading: str = ""
    """what has to be assumed about the print; it stands before the note"""

    @property
    def verdict(self) -> Match:
        """What follows from the numbers."""
        if self.check is None:
            return Match.NOT_COMPARABLE
        if not self.check.passes:
            return Match.DOES_NOT
        return Match.ONLY_UNDER if self.reading else Match.REPRODUCES

    @property
    def notes(self) -> str:
        """Reading and note."""
        return "; ".join(part for part in (self.reading, self.note) if part)


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
    """A row about a number.

    Reproduces when our mean is no further than `within` (same unit) from the printed value; given a
    `reading` (what has to be assumed about the print), only under it.
    """
    mean = ours.mean if isinstance(ours, Spread) else ours
    return Row(claim, printed, ours, unit, where, note, near(mean, printed, within), reading)


def holds(
    claim: str,
    check: Check,
    ours: Value | tuple[Value, ...],
    *,
    printed: Value = None,
    reading: str = "",
    unit: str = "",
    where: str = "",
    note: str = "",
) -> Row:
    """A row about a claim in words: reproduces when the check passes with our numbers."""
    return Row(claim, printed, ours, unit, where, note, check, reading)


@dataclass(frozen=True)
class Table:
    """Printed against ours; `ours` names the columns of ours."""

    title: str
    rows: Sequence[Row]
    ours: tuple[str, ...] = ("ours",)

    def markdown(self) -> str:
        optional = [
            name
            for name in ("where", "unit", "notes")
            if any(getattr(row, name) for row in self.rows)
        ]
        header = [
            "claim",
            *_only(optional, "where"),
            "printed",
            *self.ours,
            *_only(optional, "unit"),
            "verdict",
        ]
        header += ["note"] if "notes" in optional else []
        lines = []
        for row in self.rows:
            ours = row.ours if isinstance(row.ours, tuple) else (row.ours,)
            if len(ours) != len(self.ours):
                raise ValueError(
                    f"{self.title}: {row.claim}: {len(ours)} values for {len(self.ours)} columns"
                )
            cells: list[Value] = [
                row.claim,
                *([row.where] if "where" in optional else []),
                row.printed,
                *ours,
            ]
            cells += [row.unit] if "unit" in optional else []
            cells += [row.verdict.value, *([row.notes] if "notes" in optional else [])]
            lines.append(cells)
        return f"### {self.title}\n\n{markdown_table(header, lines)}"


class Page(general.Page):
    """The page of the paper with this key letter."""

    def __init__(self, key: str, seeds: int, out: Path | None) -> None:
        super().__init__(PAPERS[key].slug, out)
        self.key, self.seeds, self.root = key, seeds, SEED_ROOT.get()
        self.others: list[Page] = []
        """the same page with other seed roots"""

    @property
    def paper(self) -> Paper:
        return PAPERS[self.key]

    def table(self, title: str, rows: Sequence[Row], ours: tuple[str, ...] = ("ours",)) -> None:
        """Add a table of printed against ours."""
        self.blocks.append(Table(title, rows, ours))

    @property
    def tables(self) -> list[Table]:
        """The tables of printed against ours."""
        return [block for block in self.blocks if isinstance(block, Table)]

    @property
    def rows(self) -> list[Row]:
        """Every row of every table."""
        return [row for table in self.tables for row in table.rows]

    @property
    def lucky(self) -> list[str]:
        """The rows whose verdict another seed root changes, in words."""
        titles = [table.title for table in self.tables for _ in table.rows]
        found = []
        for title, row, *others in zip(
            titles, self.rows, *(other.rows for other in self.others), strict=True
        ):
            changed = [
                f"{other.verdict.value} with root {page.root}"
                for other, page in zip(others, self.others, strict=True)
                if other.verdict is not row.verdict
            ]
            if changed:
                found.append(f"{row.claim} ({title}): {row.verdict.value}, {', '.join(changed)}")
        return found

    @property
    def counts(self) -> Counter[Match]:
        """How many rows have which verdict."""
        return Counter(row.verdict for row in self.rows)

    def head(self) -> list[str]:
        """Title, citation, how the page was made, and what came of the paper's numbers."""
        estimators = ", ".join(f"`{name}`" for name in self.paper.estimators)
        root = f" --seed-root {self.root}" if self.root else ""
        checked = "".join(f" --check-root {other.root}" for other in self.others)
        command = (
            f"kollsman-sim reproduce {self.key}{root}{checked} --seeds {self.seeds} "
            "--out docs/papers"
        )
        return [
            f"# {self.paper.title}",
            f"{self.paper.citation}. Estimators: {estimators}.",
            f"Generated by `{command}` (Kollsman {__version__}, {self.seeds} seeds), never edited "
            "by hand. A value `a ± b` is the mean and the standard deviation over the seeds.",
            f"Of {len(self.rows)} printed numbers and claims: {summary(self.counts)}.",
            *self._luck(),
        ]

    def _luck(self) -> list[str]:
        """Whether other random numbers give the same verdicts."""
        if not self.others:
            return []
        roots = " and ".join(str(page.root) for page in self.others)
        other = f"With the seed roots {roots}, which draw other random numbers,"
        if not self.lucky:
            return [f"{other} every verdict is the same."]
        lines = "".join(f"\n- {line}" for line in self.lucky)
        return [f"{other} these verdicts change; they depend on luck:\n{lines}"]


def summary(counts: Counter[Match]) -> str:
    """Such as "21 reproduce, 3 only under one reading, 4 do not"."""
    words = {
        Match.REPRODUCES: "reproduce",
        Match.ONLY_UNDER: "only under one reading",
        Match.DOES_NOT: "do not",
        Match.NOT_COMPARABLE: "not comparable",
    }
    return (
        ", ".join(f"{counts[verdict]} {text}" for verdict, text in words.items() if counts[verdict])
        or "none"
    )


def _only(names: list[str], name: str) -> list[str]:
    return [name] if name in names else []
