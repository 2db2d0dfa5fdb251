"""A folder of logs: every session to Parquet rows, and one fleet table, the worst altitude first.

Layout of the output folder::

    fleet.csv, fleet.parquet   a row for each session, and for each log that could not be read
    fleet.json                 the same as the report schema, command "batch"
    rows/                      one Parquet file a log: the rows of `companion.replay.table`
    index.html, reports/       the flight report of each session (needs jinja2)
    parts/                     what is done; a batch that was killed goes on from there

On a Dask cluster the workers must see the logs and the output folder under the same paths.
"""

import csv
import glob
import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import zip_longest
from pathlib import Path
from typing import Any

from companion import whole_file
from companion.errors import ConfigError, KollsmanError, LogFormatError
from companion.jit import source_hash
from companion.jobs import Done, OnDone, Row, run_on
from companion.logs import FORMATS
from companion.replay.pages import write_index
from companion.replay.reports import is_installed, write_reports
from companion.replay.run import Replayed, replay
from companion.replay.schema import document
from companion.replay.summary import SETTLE_S
from companion.replay.table import write
from companion.replay.verdict import badness
from companion.settings import CompanionSettings

FLEET_COLUMNS = (
    "log", "session", "wrong", "score_m", "reason", "verdict", "vehicle", "start_utc",
    "duration_s", "health", "reference", "published_p95_m", "published_max_m", "autopilot_p95_m",
    "autopilot_max_m", "drift_m", "drift_m_per_h", "gnss_wander_m", "gnss_sd_m", "gnss_share_3d",
    "satellites", "rows", "report", "error",
)  # fmt: skip


@dataclass(frozen=True)
class BatchJob:
    """One log of a batch."""

    log: Path
    out: Path
    settle_s: float = SETTLE_S
    settings: CompanionSettings = field(default_factory=CompanionSettings)
    reports: bool = False
    """whether flight reports are written"""

    @property
    def key(self) -> str:
        """Changes with everything that the rows depend on: file, settings, code."""
        state = self.log.stat()
        content = [
            str(self.log), state.st_size, state.st_mtime_ns, self.settle_s,
            self.settings.model_dump(mode="json"), self.reports, _code_hash(),
        ]  # fmt: skip
        digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
        return f"{self.log.stem[:60]}-{digest}"


@cache
def _code_hash() -> str:
    digest = hashlib.sha256(source_hash().encode())
    root = Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def find_logs(places: Sequence[str]) -> list[Path]:
    """The logs in folders (searched to their depths), of patterns such as ``'logs/*.BIN'``, and
    named; each once. Raises `ConfigError` when there is none in one of `places`."""
    suffixes = {suffix for known in FORMATS.values() for suffix in known.suffixes}
    logs: set[Path] = set()
    for place in places:
        path = Path(place)
        if path.is_dir():
            found = [each for each in path.rglob("*") if each.suffix.lower() in suffixes]
        else:
            found = [path] if path.exists() else [*map(Path, glob.glob(place, recursive=True))]
        files = {each.resolve() for each in found if each.is_file()}
        if not files:
            raise ConfigError(f"no log in {place}; suffixes: {', '.join(sorted(suffixes))}")
        logs |= files
    return sorted(logs)


def other_files(places: Sequence[str]) -> Counter[str]:
    """The files in folders that are no logs by their names: how many of each suffix."""
    logs = {suffix for known in FORMATS.values() for suffix in known.suffixes}
    found = (each for place in places if Path(place).is_dir() for each in Path(place).rglob("*"))
    suffixes = (each.suffix.lower() or "no suffix" for each in found if each.is_file())
    return Counter(suffix for suffix in suffixes if suffix not in logs)


class BatchFailedError(ConfigError):
    """Logs that could not be replayed for a reason outside of them; the others are done."""

    def __init__(self, table: list[Row], failed: Sequence[Done[BatchJob, list[Row]]]) -> None:
        super().__init__(
            f"{len(failed)} logs failed, the first with: {failed[0].error}; the same command tries "
            "them again"
        )
        self.table = table


def replay_job(job: BatchJob) -> list[Row]:
    """Replay one log; its sessions, or one row that says why there are none."""
    try:
        found = replay(job.log, job.settings, settle_s=job.settle_s)
        rows = job.out / "rows" / f"{job.key}.parquet"
        rows.parent.mkdir(parents=True, exist_ok=True)
        write(rows, found.tables())
        reports = _write_reports(found, job) if job.reports else []
    except LogFormatError as error:
        return [{"log": str(job.log), "error": f"{error}".removeprefix(f"{job.log}: ")}]
    except KollsmanError:
        raise  # of the environment: the next run tries again
    return [
        {"log": str(job.log), "rows": rows.name, "report": report, "error": None} | session
        for session, report in zip_longest(found.report["sessions"], reports)
    ]


def _write_reports(found: Replayed, job: BatchJob) -> list[str]:
    """The report of every session; their names in the folder ``reports``."""
    pages = write_reports(found, job.out / "reports" / f"{job.key}.html", job.log.name)
    return [page.name for page in (pages if len(pages) == 1 else pages[1:])]


def run_batch(
    logs: Sequence[Path],
    out: Path,
    settings: CompanionSettings | None = None,
    *,
    settle_s: float = SETTLE_S,
    workers: int = 1,
    scheduler: str | None = None,
    reports: bool | None = None,
    on_done: OnDone | None = None,
) -> list[Row]:
    """Replay `logs`, write the fleet's files into `out`, and return the fleet table, worst first.

    `reports` tells whether flight reports are written; None: if jinja2 is installed.

    A log that is done, with these settings and this code, is not replayed again. Raises
    `ConfigError`, also when the folder cannot be written; `BatchFailedError` at the end.
    """
    settings, out = settings or CompanionSettings(), out.resolve()
    try:
        (out / "parts").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written: {error.strerror or error}") from None
    reports = is_installed("jinja2") if reports is None else reports
    jobs = [BatchJob(log, out, settle_s, settings, reports) for log in logs]
    done = run_on(
        workers,
        scheduler,
        replay_job,
        jobs,
        key=lambda job: job.key,
        parts=out / "parts",
        weight=lambda job: float(job.log.stat().st_size),
        on_done=on_done,
    )
    sessions = [row for each in done for row in _rows_of(each)]
    sessions.sort(key=_order, reverse=True)
    table = [fleet_row(session) for session in sessions]
    _write_fleet(out, sessions, table)
    if reports:
        write_index(out / "index.html", f"Flights in {out.name}", list(map(_index_row, sessions)))
    if failed := [each for each in done if each.error is not None]:
        raise BatchFailedError(table, failed)
    return table


def _index_row(session: Row) -> Row:
    """A line of the index page."""
    number = session.get("session")
    name = Path(session["log"]).name + (f", session {number}" if number and number > 1 else "")
    report = session.get("report")
    href = f"reports/{report}" if report else None
    return {"name": name, "href": href, "session": session, "error": session["error"]}


def _rows_of(done: Done[BatchJob, list[Row]]) -> list[Row]:
    if done.result is not None:
        return done.result
    return [{"log": str(done.job.log), "error": done.error}]


def _order(session: Row) -> tuple[Any, ...]:
    """The worst first; what could not be read last."""
    is_read = session["error"] is None
    return is_read, *(badness(session) if is_read else ())


def fleet_row(session: Row) -> Row:
    """A session's summary as a flat row of the fleet table."""
    sources, gnss = session.get("sources", {}), session.get("gnss", {})
    barometer = session.get("barometer", {})
    values = {
        "wrong": " and ".join(session.get("wrong") or []),
        "health": session.get("health", {}).get("at_end"),
        "reference": session.get("reference", {}).get("kind"),
        "published_p95_m": sources.get("published", {}).get("p95_m"),
        "published_max_m": sources.get("published", {}).get("max_m"),
        "autopilot_p95_m": sources.get("autopilot", {}).get("p95_m"),
        "autopilot_max_m": sources.get("autopilot", {}).get("max_m"),
        "drift_m": barometer.get("drift_m"),
        "drift_m_per_h": barometer.get("drift_m_per_h"),
        "gnss_wander_m": gnss.get("wander_m"),
        "gnss_sd_m": gnss.get("median_sd_m"),
        "gnss_share_3d": gnss.get("share_3d"),
        "satellites": gnss.get("median_satellites"),
    }
    return {name: values.get(name, session.get(name)) for name in FLEET_COLUMNS}


def _write_fleet(out: Path, sessions: Sequence[Row], table: Sequence[Row]) -> None:
    try:
        report = document("batch", str(out), sessions)
        whole_file.write(out / "fleet.json", json.dumps(report, indent=1).encode("utf-8"))
        with (
            whole_file.replacing(out / "fleet.csv") as partial,
            partial.open("w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.DictWriter(file, FLEET_COLUMNS)
            writer.writeheader()
            writer.writerows(table)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written: {error.strerror or error}") from None
    columns: dict[str, list[Any]] = {name: [row[name] for row in table] for name in FLEET_COLUMNS}
    write(out / "fleet.parquet", [columns])
