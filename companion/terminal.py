"""A terminal: what is shown at its end stays up to date, and lines are printed above it.

Rich draws, in a thread of its own; whoever has something to show only leaves it there. What the
terminal does not take at once is dropped (`companion.output`), so that one that hangs stops nobody.
"""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console, Group, RenderableType
from rich.highlighter import NullHighlighter
from rich.live import Live
from rich.logging import RichHandler
from rich.spinner import Spinner
from rich.text import Text

from companion.output import DATE_FORMAT, LogHandler, Output

REFRESHES_HZ = 4.0


class OutputFile:
    """An `Output` as the file that a Rich console writes to."""

    encoding = "utf-8"

    def __init__(self, output: Output) -> None:
        self._output = output

    def write(self, text: str) -> int:
        self._output.write(text)
        return len(text)

    def flush(self) -> None:
        """Nothing is kept back."""

    def isatty(self) -> bool:
        return self._output.is_terminal

    def fileno(self) -> int:
        return self._output.descriptor


def console_on(output: Output) -> Console:
    """A console that never blocks or raises; colours as the terminal and ``NO_COLOR`` want."""
    return Console(file=OutputFile(output))  # type: ignore[arg-type]


def can_redraw(output: Output) -> bool:
    """Whether `output` is a terminal on which lines can be replaced."""
    console = console_on(output)
    return console.is_terminal and not console.is_dumb_terminal


class ScreenHandler(RichHandler):
    """Log records above what a screen shows."""

    def __init__(self, console: Console) -> None:
        stamp = f"[{DATE_FORMAT}]"
        super().__init__(
            console=console,
            show_path=False,
            omit_repeated_times=False,
            log_time_format=stamp,
            highlighter=NullHighlighter(),  # the default one takes half a second for a long line
        )
        self.setFormatter(logging.Formatter("%(name)s: %(message)s"))

    def emit(self, record: logging.LogRecord) -> None:
        try:
            super().emit(record)
        except Exception:  # a log call with wrong arguments must not stop the service
            self.console.print(Text(f"{record.name}: {record.msg}"))


class Screen:
    """The end of a terminal, redrawn a few times a second.

    While it is open, log records that would go to the same terminal are printed above it.

    Parameters
    ----------
    content : makes what is shown; called in the thread that draws.
    """

    def __init__(self, output: Output, content: Callable[[], RenderableType]) -> None:
        self.content = content
        self.console = console_on(output)
        self._live = Live(
            get_renderable=self._draw,
            console=self.console,
            refresh_per_second=REFRESHES_HZ,
            redirect_stdout=False,
            redirect_stderr=False,
        )
        self._replaced: list[logging.Handler] = []
        self._handler = ScreenHandler(self.console)

    def _draw(self) -> RenderableType:
        return self.content()

    def open(self) -> None:
        """Begin to draw."""
        root = logging.getLogger()
        self._replaced = [
            each for each in root.handlers if isinstance(each, LogHandler) and each.is_terminal
        ]
        for each in self._replaced:
            root.removeHandler(each)
        if self._replaced:
            root.addHandler(self._handler)
        self._live.start()

    def line(self, text: str) -> None:
        """Print a line above what is shown."""
        self.console.print(Text(text), soft_wrap=True)

    def close(self, *, keep: bool) -> None:
        """End drawing; what was shown last is kept or removed."""
        self._live.transient = not keep
        self._live.stop()
        root = logging.getLogger()
        if self._handler in root.handlers:
            root.removeHandler(self._handler)
            for each in self._replaced:
                root.addHandler(each)
        self._replaced = []


class Starting:
    """What is shown while packages are loaded and code is compiled."""

    def __init__(self) -> None:
        self._started_s = time.monotonic()
        self._spinner = Spinner("dots")
        self.compiled: Callable[[], int] = lambda: 0
        """how many functions were compiled so far"""

    def __call__(self) -> RenderableType:
        elapsed_s, count = time.monotonic() - self._started_s, self.compiled()
        what = f"compiling, once after an update: {count} functions" if count else "starting"
        text = f"{what}, {elapsed_s:.0f} s"
        self._spinner.update(text=Text(text, no_wrap=True, overflow="ellipsis"))
        return Group(self._spinner)


@contextmanager
def starting(output: Output) -> Iterator[Starting | None]:
    """Show what is done before the work begins; None where `output` is no terminal."""
    if not can_redraw(output):
        yield None
        return
    content = Starting()
    screen = Screen(output, content)
    screen.open()
    try:
        yield content
    finally:
        screen.close(keep=False)
