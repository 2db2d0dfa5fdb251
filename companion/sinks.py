"""Sinks of estimates besides the link: CSV, and a log that contains our ALTITUDE."""

import csv
import math
from collections.abc import Callable, Iterable
from pathlib import Path
from types import TracebackType
from typing import Self

from companion.errors import LogFormatError
from companion.mavlink.codec import Message
from companion.pipeline import Observer
from companion.samples import Kind, Rows, Verdict

COLUMNS = (
    "time_us",
    "altitude_amsl_m",
    "climb_mps",
    "altitude_sd_m",
    "baro_offset_m",
    "innovation_m",
    "health",
)


class CsvSink:
    """An observer that writes one line for each update of the estimate; unknown is an empty
    cell."""

    def __init__(self, path: Path, health: Callable[[], str]) -> None:
        self._path = path
        try:
            self._file = path.open("w", newline="", encoding="ascii")
        except OSError as error:
            raise self._failure(error) from None
        self._writer = csv.writer(self._file)
        self._writer.writerow(COLUMNS)
        self._health = health

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        value = estimate[0]
        if (
            verdict is not Verdict.USED
            or kind is Kind.STATUS
            or math.isnan(value["altitude_amsl_m"])
        ):
            return
        cells = [
            int(value["time_us"]),
            *(_cell(float(value[name])) for name in COLUMNS[1:-1]),
            self._health(),
        ]
        try:
            self._writer.writerow(cells)
        except OSError as error:
            raise self._failure(error) from None

    def truth(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        """The CSV does not contain it."""

    def autopilot(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        """The CSV does not contain it."""

    def published(self, message: Message) -> None:
        """The CSV does not contain it."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self._file.close()
        except OSError as failure:
            if error is None:  # else the first one tells what happened
                raise self._failure(failure) from None

    def _failure(self, error: OSError) -> LogFormatError:
        return LogFormatError(f"{self._path}: cannot be written ({error.strerror})")


class Observers:
    """Several observers as one."""

    def __init__(self, observers: Iterable[Observer]) -> None:
        self._observers = tuple(observers)

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        for observer in self._observers:
            observer.sample(kind, row, verdict, estimate)

    def truth(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        for observer in self._observers:
            observer.truth(time_us, altitude_amsl_m, climb_mps)

    def autopilot(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        for observer in self._observers:
            observer.autopilot(time_us, altitude_amsl_m, climb_mps)

    def published(self, message: Message) -> None:
        for observer in self._observers:
            observer.published(message)


def _cell(value: float) -> str:
    return f"{value:.4f}" if math.isfinite(value) else ""
