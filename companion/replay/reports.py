"""Flight reports of a replayed log: pages, or pictures of the same panels."""

from pathlib import Path

from companion.errors import ConfigError
from companion.replay.curves import curves_of
from companion.replay.pages import write_index, write_report
from companion.replay.run import Replayed
from companion.replay.verdict import badness

SUFFIXES = (".html", ".png")


def check(path: Path) -> None:
    """Raise `ConfigError` when a report cannot be written under this name, or a package is
    missing."""
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"--report {path}: the name must end with .html or .png")
    package = "jinja2" if path.suffix.lower() == ".html" else "matplotlib"
    if not is_installed(package):
        raise ConfigError(f"--report {path}: needs {package}: pip install 'kollsman[report]'")


def is_installed(package: str) -> bool:
    """Whether a package of the extra `report` can be imported."""
    from importlib.util import find_spec

    return find_spec(package) is not None


def write_reports(found: Replayed, path: Path, name: str) -> list[Path]:
    """Write the report of every session; what was written, the file to open first.

    One session goes to `path`. Several go to files with their numbers, and `path` is an index page
    of them; as PNG there is no index. Raises `ConfigError`.
    """
    sessions = found.report["sessions"]
    if len(sessions) == 1:
        _write(found, 0, path, name)
        return [path]
    written, rows = [], []
    for at, session in enumerate(sessions):
        file = path.with_name(f"{path.stem}-{at + 1}{path.suffix}")
        title = f"{name}, session {at + 1}"
        _write(found, at, file, title)
        written.append(file)
        rows.append({"name": title, "href": file.name, "session": session, "error": None})
    if path.suffix.lower() == ".png":
        return written
    rows.sort(key=lambda row: badness(row["session"]), reverse=True)
    write_index(path, name, rows)
    return [path, *written]


def _write(found: Replayed, at: int, path: Path, title: str) -> None:
    session = found.report["sessions"][at]
    curves = curves_of(found.sessions[at], found.references[at])
    if path.suffix.lower() == ".png":
        from companion.plots.drawing import draw_flight

        draw_flight(path, title, session["findings"], curves)
    else:
        write_report(path, title, session, curves, found.report["damage"])
