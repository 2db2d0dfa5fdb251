"""Standard output and log lines that never stop the service.

A closed terminal, a reader that ends (``| head``) or is stopped, a full disk behind ``> log`` and
descriptors that were closed before the start are normal for a program that runs for months. A line
that cannot be written at once is dropped and counted.
"""

import json
import logging
import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Any

STANDARD = (0, 1, 2)
DATE_FORMAT = "%Y-%m-%d %H:%M:%S"


def open_standard_descriptors() -> None:
    """Give descriptors 0 to 2 to /dev/null where they are closed.

    Otherwise the next file that is opened, such as a serial port, would get one of these numbers,
    and receive what is printed.
    """
    for descriptor in STANDARD:
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number: this one
    for name, descriptor in (("stdout", 1), ("stderr", 2)):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(descriptor, "w", closefd=False))


def discard_standard_output() -> None:
    """Send what is still buffered for standard output and error to /dev/null, so that the end of
    the interpreter cannot fail on it."""
    sink = os.open(os.devnull, os.O_WRONLY)
    for descriptor in (1, 2):
        os.dup2(sink, descriptor)
    os.close(sink)


class Output:
    """Whole lines to one descriptor, without ever blocking or raising."""

    def __init__(self, descriptor: int = 1) -> None:
        self.descriptor = descriptor
        self.dropped = 0
        """lines that could not be written"""
        self._writes_to = _unblocked(descriptor)

    @property
    def is_terminal(self) -> bool:
        try:
            return os.isatty(self.descriptor)
        except OSError:
            return False

    def line(self, text: str) -> None:
        """Write `text` and a line break."""
        self.write(text + "\n")

    def write(self, text: str) -> None:
        """Write `text`, or drop it when the descriptor does not take it now."""
        data = text.encode("utf-8", "replace")
        try:
            while data and select.select([], [self._writes_to], [], 0.0)[1]:
                data = data[os.write(self._writes_to, data[: select.PIPE_BUF]) :]
        except (OSError, ValueError):
            pass
        if data:
            self.dropped += 1


def _unblocked(descriptor: int) -> int:
    """A terminal opened anew, so that writing never waits for it: it says that it takes bytes, and
    then waits until it has taken all of them. Elsewhere `descriptor` itself."""
    try:
        if os.isatty(descriptor):
            flags = os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY
            return os.open(os.ttyname(descriptor), flags)
    except OSError:  # a terminal of another container has no name here
        pass
    return descriptor


class LogHandler(logging.Handler):
    """Log records as lines of an `Output`."""

    def __init__(self, output: Output) -> None:
        super().__init__()
        self._output = output

    @property
    def is_terminal(self) -> bool:
        """Whether the lines appear on a terminal."""
        return self._output.is_terminal

    def emit(self, record: logging.LogRecord) -> None:
        try:
            text = self.format(record)
        except Exception:  # a log call with wrong arguments must not stop the service
            text = f"{record.name}: {record.msg}"
        self._output.line(text)


class JsonFormatter(logging.Formatter):
    """One JSON object a record: time, level, logger, message."""

    def format(self, record: logging.LogRecord) -> str:
        fields: dict[str, Any] = {
            "time": timestamp(record.created),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        if record.exc_info:
            fields["exception"] = self.formatException(record.exc_info)
        return json.dumps(fields, ensure_ascii=False)


class JournalFormatter(logging.Formatter):
    """Lines for systemd's journal, which adds the time and reads the priority from ``<N>``."""

    def format(self, record: logging.LogRecord) -> str:
        priority = 3 if record.levelno >= logging.ERROR else 4 if record.levelno >= 30 else 6
        return f"<{priority}>{record.name}: {record.getMessage()}".replace("\n", " | ")


def timestamp(unix_s: float) -> str:
    """ISO 8601 in UTC with milliseconds."""
    return datetime.fromtimestamp(unix_s, UTC).isoformat(timespec="milliseconds")


def set_up_logging(level: int) -> None:
    """Send log records to standard error: as text, or in the journal's form."""
    handler = LogHandler(Output(2))
    if os.environ.get("JOURNAL_STREAM"):
        handler.setFormatter(JournalFormatter())
    else:
        handler.setFormatter(
            logging.Formatter("%(asctime)s %(name)s: %(message)s", datefmt=DATE_FORMAT)
        )
    root = logging.getLogger()
    root.handlers = [each for each in root.handlers if not isinstance(each, LogHandler)]
    root.addHandler(handler)
    root.setLevel(level)


@contextmanager
def quiet(level: int) -> Iterator[None]:
    """Within it, the companion logs only what is at least of this level."""
    logger = logging.getLogger("kollsman")
    before = logger.level
    logger.setLevel(level)
    try:
        yield
    finally:
        logger.setLevel(before)


def use_json() -> None:
    """Write log records as JSON objects from now on."""
    for handler in logging.getLogger().handlers:
        if isinstance(handler, LogHandler):
            handler.setFormatter(JsonFormatter())
