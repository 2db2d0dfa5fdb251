"""The signing key on disk, and the time stamps that must outlast a restart.

A key file holds one line of text, the passphrase; the key is its SHA-256, as in MAVProxy,
QGroundControl and Mission Planner. ``hex:`` and 64 digits give the key itself.

A receiver refuses a signature that is not newer than the last one. So the time stamp up to which we
may have signed is on disk before it is used. There are two files: one in memory, two seconds ahead,
for a restart of this process; one that outlasts a restart of the computer, a minute ahead, written
once a minute, to write little to a memory card.
"""

import contextlib
import hashlib
import logging
import os
import secrets
import time
from collections.abc import Callable
from pathlib import Path

from companion import locations, whole_file
from companion.errors import ConfigError
from companion.mavlink.signing import KEY_BYTES, UNIT_US, Signing, SigningSettings, stamp_of

logger = logging.getLogger("kollsman.signing")

PASSPHRASE_BYTES = 24
SHORTEST_PASSPHRASE = 8
LONGEST_FILE = 4096
HEX = "hex:"


def make_key(path: Path) -> None:
    """Write a file with a new random passphrase, readable by its owner alone.

    Raises `ConfigError` where the file exists or cannot be written.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        raise ConfigError(f"{path}: exists; a key is never overwritten") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from None
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        file.write(secrets.token_urlsafe(PASSPHRASE_BYTES) + "\n")


def load_key(path: Path) -> bytes:
    """The key of a file.

    Raises `ConfigError`, in one line, for a file that others can read or that holds no key.
    """
    try:
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode & 0o777
            data = file.read(LONGEST_FILE + 1)
    except OSError as error:
        raise ConfigError(
            f"signing.key_file: {path}: cannot be read: {error.strerror}; "
            "'kollsman key FILE' makes one"
        ) from None
    shared = mode & (0o007 if _is_credential(path) else 0o077)
    if shared:
        raise ConfigError(f"signing.key_file: {path}: others can read it; chmod 600 {path}")
    try:
        text = data.decode("utf-8").strip()
    except UnicodeDecodeError:
        text = ""
    key = _key_of(text)
    if key is None:
        raise ConfigError(
            f"signing.key_file: {path}: give one line of {SHORTEST_PASSPHRASE} characters or more "
            f"(a passphrase), or {HEX} and {2 * KEY_BYTES} hexadecimal digits"
        )
    return key


def _key_of(text: str) -> bytes | None:
    if len(text.splitlines()) != 1 or len(text) < SHORTEST_PASSPHRASE:
        return None
    if not text.startswith(HEX):
        return hashlib.sha256(text.encode()).digest()
    with contextlib.suppress(ValueError):
        key = bytes.fromhex(text.removeprefix(HEX))
        return key if len(key) == KEY_BYTES else None
    return None


def _is_credential(path: Path) -> bool:
    """Whether systemd lends the file to this service: it shows the reader as a group."""
    folder = os.environ.get("CREDENTIALS_DIRECTORY")
    return bool(folder) and path.parent == Path(folder or "")


class Reserve:
    """A file that holds a time stamp which we have not reached yet."""

    def __init__(self, path: Path, period_s: float) -> None:
        self.path = path
        self._ahead = round(period_s * 1e6 / UNIT_US)
        self._due = 0
        self._failed = False

    def read(self) -> int:
        """What an earlier run may have reached; 0 where there is nothing."""
        try:
            return int(self.path.read_text(encoding="ascii"))
        except (OSError, ValueError):
            return 0

    def keep(self, newest: int) -> None:
        """Write when `newest` comes near to what is on disk."""
        if newest < self._due or self._failed:
            return
        try:
            whole_file.write(self.path, b"%d\n" % (newest + 2 * self._ahead), mode=0o600)
        except OSError as error:
            self._failed = True
            logger.warning("time stamps of signatures are not kept: %s", error)
        self._due = newest + self._ahead


class SigningStore:
    """A `Signing` whose time stamps outlast a restart.

    Parameters
    ----------
    wall_s : UNIX time.
    folders : in memory, and lasting; default those of `locations`.
    """

    def __init__(
        self,
        settings: SigningSettings,
        *,
        wall_s: Callable[[], float] = time.time,
        folders: tuple[Path | None, Path | None] | None = None,
    ) -> None:
        assert settings.key_file is not None
        path = Path(settings.key_file).expanduser()
        key = load_key(path)
        places = folders or (locations.runtime_directory(), locations.state_directory())
        name = f"signing-{hashlib.sha256(os.fsencode(path.absolute())).hexdigest()[:16]}"
        self._reserves = [
            Reserve(folder / f"{name}-{kind}.stamp", period_s)
            for folder, kind, period_s in zip(places, ("boot", "state"), (1.0, 60.0), strict=True)
            if folder is not None
        ]
        start = next((found for each in self._reserves if (found := each.read())), 0)
        self.signing = Signing(
            key, lambda: stamp_of(wall_s()), link_id=settings.link_id, start=start
        )
        self.keep()

    def keep(self) -> None:
        """Call before and while frames are signed, at least twice a second."""
        for reserve in self._reserves:
            reserve.keep(self.signing.newest)


def open_signing(settings: SigningSettings) -> SigningStore | None:
    """The store of the configured key; None when there is none. Raises `ConfigError`."""
    return SigningStore(settings) if settings.key_file is not None else None
