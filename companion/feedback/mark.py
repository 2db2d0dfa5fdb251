"""What must survive a crash of this program: which parameter of which vehicle holds a value of
ours, and its original value."""

import contextlib
import hashlib
import json
import logging
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from companion import locations, whole_file

logger = logging.getLogger("kollsman.feedback")


@dataclass(frozen=True)
class Mark:
    """A parameter that holds a value of ours."""

    system_id: int
    parameter: str
    original: float
    """its value before ours"""
    written: float
    """the last value sent"""
    previous: float
    """the one before, which the vehicle still has if the last was lost"""
    time_us: int
    """vehicle's clock at the last write; a smaller one later is a restart of the vehicle"""
    reference_m: float | None = None
    """the correction at arming, from which the change counts, m; None before arming"""
    reference_sd_m: float = 0.0
    """its standard deviation, m"""


class MarkFile:
    """One mark on disk, for one set of links.

    Parameters
    ----------
    links : the canonical URLs that this process serves.
    directory : where; default `locations.state_directory`, which outlasts a restart of the
        computer.
    """

    def __init__(self, links: Sequence[str], directory: Path | None = None) -> None:
        folder = directory or locations.state_directory()
        name = hashlib.sha256("\n".join(links).encode()).hexdigest()[:16]
        self.path = folder / f"feedback-{name}.json" if folder is not None else None
        self._saved: Mark | None = None

    def load(self) -> Mark | None:
        """The mark of an earlier run; None where there is none, or none that can be read."""
        if self.path is None:
            return None
        try:
            values = json.loads(self.path.read_text(encoding="utf-8"))
            names = [each.name for each in fields(Mark)]
            mark = Mark(**{name: values[name] for name in names if name in values})
            numbers = (mark.original, mark.written, mark.previous, mark.reference_sd_m)
            if not all(isinstance(number, float) and math.isfinite(number) for number in numbers):
                raise ValueError("a value is no number")
        except FileNotFoundError:
            return None
        except (OSError, ValueError, TypeError, AttributeError) as error:
            logger.warning("mark of an earlier run not used: %s: %s", self.path, error)
            return None
        self._saved = mark
        return mark

    def save(self, mark: Mark | None) -> bool:
        """Write `mark`, or remove the file when it is None; False when the disk refuses it."""
        if mark == self._saved:
            return True
        if self.path is None:
            return False
        try:
            if mark is None:
                with contextlib.suppress(FileNotFoundError):
                    self.path.unlink()
            else:
                content = json.dumps(asdict(mark)).encode("utf-8")
                whole_file.write(self.path, content, is_synced=True)
        except OSError as error:
            logger.error("the mark of feedback cannot be kept: %s", error)
            return False
        self._saved = mark
        return True
