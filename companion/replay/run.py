"""Replaying a log: the sessions in it, what they were, and the tables and files asked for."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.logs import LogReader, open_log
from companion.logs.tables import TableReader
from companion.mavlink.codec import FrameReject
from companion.observer import Observer
from companion.pipeline import Pipeline
from companion.replay.merged import Writer
from companion.replay.record import Recording
from companion.replay.schema import document
from companion.replay.sessions import Session, sessions_of
from companion.replay.summary import (
    SETTLE_S,
    Reference,
    damage,
    reference_of,
    summarise,
)
from companion.replay.table import Columns, columns
from companion.settings import CompanionSettings


@dataclass(frozen=True)
class Replayed:
    """A log that was replayed."""

    sessions: list[Session[Recording]]
    report: dict[str, Any]
    """as ``docs/report-schema.md`` describes"""
    references: list[Reference]
    """what the heights of each session are held against"""

    def tables(self) -> list[Columns]:
        """The rows of every session, for `companion.replay.table.write`."""
        return [
            columns(session, number, reference.smoothed)
            for number, (session, reference) in enumerate(
                zip(self.sessions, self.references, strict=True), 1
            )
        ]


def replay(
    path: Path,
    settings: CompanionSettings | None = None,
    *,
    settle_s: float = SETTLE_S,
    smoothing: bool = False,
    writer: Writer | None = None,
    on_progress: Callable[[float], None] | None = None,
    observe: Callable[[Pipeline], Recording] = Recording,
) -> Replayed:
    """Run the log at `path` through the same code as live.

    Parameters
    ----------
    smoothing : also smooth sessions that have truth (without truth the smoother is the reference).
    writer : gets the log's frames with ours between them.
    on_progress : called with the share of the file that is read.
    observe : makes the recording of each session.

    Raises `LogFormatError` when the log is unreadable or holds nothing usable.
    """
    settings = settings or CompanionSettings()
    started_s = time.perf_counter()
    reader = open_log(path)

    def make(changed: CompanionSettings, observer: Observer) -> Pipeline:
        return Pipeline(changed, datagrams=True, observer=observer, sends=writer is not None)

    sessions = sessions_of(reader, settings, observe, make, writer=writer, on_progress=on_progress)
    if isinstance(reader, TableReader):
        for session in sessions:
            session.seen.events.recorded(reader.tables.modes, reader.tables.texts)
    summaries, references = [], []
    unreadable = reader.counters[FrameReject.JUNK] / max(1, reader.size_bytes)
    for number, session in enumerate(sessions, 1):
        reference = reference_of(session.seen, smoothing=smoothing)
        references.append(reference)
        summaries.append(
            summarise(session, number, settings.estimator, settle_s, reference, unreadable)
        )
        session.seen.release()
    report = document("replay", str(path), summaries, **_file(reader, started_s))
    return Replayed(sessions, report, references)


def _file(reader: LogReader, started_s: float) -> dict[str, Any]:
    return {
        "format": type(reader).__name__.removesuffix("Reader").lower(),
        "size_bytes": reader.size_bytes,
        "elapsed_s": round(time.perf_counter() - started_s, 3),
        "damage": damage(reader.counters),
    }
