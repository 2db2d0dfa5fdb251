"""Where this computer keeps configuration and state, and which settings its environment names.

===================  ============================================================================
configuration        ``KOLLSMAN_CONFIG``, else ``$XDG_CONFIG_HOME/kollsman/companion.yaml`` (by
                     default in ``~/.config``), else ``/etc/kollsman/companion.yaml``
state that lasts     ``KOLLSMAN_STATE``, else systemd's ``STATE_DIRECTORY``, else
                     ``$XDG_STATE_HOME/kollsman`` (by default in ``~/.local/state``)
state of this boot   systemd's ``RUNTIME_DIRECTORY``, else ``$XDG_RUNTIME_DIR/kollsman``, else
                     ``/dev/shm/kollsman-UID``, else the state that lasts
===================  ============================================================================

``KOLLSMAN_SECTION__KEY=VALUE`` sets one key, as in ``KOLLSMAN_PUBLISH__ALTITUDE_HZ=5``.
"""

import os
from collections.abc import Mapping
from pathlib import Path

SYSTEM_CONFIG = Path("/etc/kollsman/companion.yaml")
PREFIX = "KOLLSMAN_"


def config_path(environment: Mapping[str, str] = os.environ) -> Path | None:
    """The configuration file that is used when none is named; None when there is none.

    A file that ``KOLLSMAN_CONFIG`` names is returned whether or not it exists.
    """
    named = environment.get("KOLLSMAN_CONFIG")
    if named:
        return Path(named)
    places = [SYSTEM_CONFIG]
    home = _home(environment, "XDG_CONFIG_HOME", ".config")
    if home is not None:
        places.insert(0, home / "kollsman" / "companion.yaml")
    for place in places:
        try:
            if place.exists():
                return place
        except OSError:  # a folder of somebody else's
            continue
    return None


def assignments(environment: Mapping[str, str] = os.environ) -> list[str]:
    """``SECTION.KEY=VALUE`` for each variable ``KOLLSMAN_SECTION__KEY``, in order of name."""
    found = []
    for name in sorted(environment):
        path = name.removeprefix(PREFIX).lower().split("__")
        if not name.startswith(PREFIX) or len(path) < 2:
            continue
        if path[0] == "estimators":
            path[1] = path[1].replace("_", "-")
        found.append(f"{'.'.join(path)}={environment[name]}")
    return found


def state_directory(environment: Mapping[str, str] = os.environ) -> Path | None:
    """A writable folder for what must outlast a restart of the computer, made if it is missing."""
    home = _home(environment, "XDG_STATE_HOME", ".local/state")
    return _first_writable(
        [
            environment.get("KOLLSMAN_STATE"),
            _first_of(environment.get("STATE_DIRECTORY")),
            home / "kollsman" if home is not None else None,
        ]
    )


def runtime_directory(environment: Mapping[str, str] = os.environ) -> Path | None:
    """A writable folder in memory for what is of no use after a restart of the computer."""
    session = environment.get("XDG_RUNTIME_DIR")
    return _first_writable(
        [
            _first_of(environment.get("RUNTIME_DIRECTORY")),
            Path(session) / "kollsman" if session else None,
            Path(f"/dev/shm/kollsman-{os.getuid()}") if Path("/dev/shm").is_dir() else None,
            state_directory(environment),
        ]
    )


def _home(environment: Mapping[str, str], variable: str, default: str) -> Path | None:
    named = environment.get(variable)
    if named:
        return Path(named)
    try:
        return Path.home() / default
    except RuntimeError:  # no home directory, as in some containers
        return None


def _first_of(directories: str | None) -> str | None:
    """systemd separates several directories by colons."""
    return directories.split(":")[0] if directories else None


def _first_writable(places: list[str | Path | None]) -> Path | None:
    for directory in (Path(place) for place in places if place):
        try:
            directory.mkdir(parents=True, exist_ok=True, mode=0o700)
        except OSError:
            continue
        is_ours = directory.stat().st_uid == os.getuid() or os.environ.get("RUNTIME_DIRECTORY")
        if is_ours and os.access(directory, os.W_OK | os.X_OK):
            return directory
    return None
