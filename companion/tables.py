"""Tables of numbers on a terminal: columns that have no room follow in a second table, so that no
number is cut or broken. Elsewhere a row is one line, however long."""

from collections.abc import Iterator, Mapping, Sequence

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

Columns = Mapping[str, Sequence[str]]
"""head -> cells, one a row"""


def show(labels: Columns, numbers: Columns, console: Console | None = None) -> None:
    """Print a table: the `labels` of each row, then as many `numbers` as there is room for."""
    console = console or Console()
    if not console.is_terminal:
        console = Console(file=console.file, width=10_000)
    for number, table in enumerate(_fitting(labels, numbers, console)):
        if number:
            console.print()
        console.print(table)


def _fitting(labels: Columns, numbers: Columns, console: Console) -> Iterator[Table]:
    names = list(numbers)
    while names:
        for count in range(len(names), 0, -1):
            table = _table(labels, {name: numbers[name] for name in names[:count]})
            needed = Measurement.get(console, console.options.update(max_width=10_000), table)
            if count == 1 or needed.maximum <= console.width:
                yield table
                names = names[count:]
                break


def _table(labels: Columns, numbers: Columns) -> Table:
    table = Table(box=None, pad_edge=False)
    for head in labels:
        table.add_column(head)
    for head in numbers:
        table.add_column(head, justify="right", no_wrap=True)
    for cells in zip(*labels.values(), *numbers.values(), strict=True):
        table.add_row(*cells)
    return table
