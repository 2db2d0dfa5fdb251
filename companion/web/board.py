"""The slot between the estimator's thread and the server's, and the history of the live page.

`Board.put` is all that the estimator's thread does: one assignment, which replaces what was there.
The server's thread calls `Board.refresh` a few times a second, and encodes what is new once for all
readers.
"""

import json
import time
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

HISTORY_S = 600.0
ROW_S = 0.5
"""time between two rows of the history"""
COLUMNS = (
    "time_s",  # UNIX
    "altitude_m",
    "altitude_sd_m",
    "level_m",
    "climb_mps",
    "gnss_m",
    "baro_m",
    "autopilot_m",
    "qnh_hpa",
    "qnh_sd_hpa",
    "health",  # 0 OK, 1 DEGRADED, 2 LOST
)
STALLED_S = 3.0
"""without a new snapshot for so long the estimator's thread does not run"""


class Snapshot(NamedTuple):
    """What the service was at one moment; nothing in it changes any more."""

    document: dict[str, Any]
    """the report schema, one session; JSON-ready"""
    row: tuple[float | None, ...]
    """the values of `COLUMNS`"""


class Board:
    """The newest snapshot, and the last ten minutes of its row.

    Parameters
    ----------
    clock_s : a clock that never goes back.
    """

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._slot: tuple[Snapshot, float] | None = None
        self._shown: tuple[Snapshot, float] | None = None
        self._rows: deque[tuple[float | None, ...]] = deque(maxlen=round(HISTORY_S / ROW_S))
        self._row_due_s = 0.0
        self._encoded = "null"
        self.has_ended = False
        """whether a log that was shown has ended; what is shown stays right"""
        self.number = 0
        """of the snapshot that `event` holds"""

    def put(self, snapshot: Snapshot) -> None:
        """Replace the newest snapshot, and keep its row where one is due by the time in it. The
        estimator's thread: never waits."""
        self._slot = (snapshot, self._clock_s())
        time_s = snapshot.row[0] or 0.0
        if time_s < self._row_due_s - HISTORY_S:  # a log of several days that is out of order
            self._rows.clear()
            self._row_due_s = time_s
        if time_s >= self._row_due_s:
            on_grid = time_s < self._row_due_s + ROW_S
            self._row_due_s = (self._row_due_s if on_grid else time_s) + ROW_S
            self._rows.append(snapshot.row)

    def end(self) -> None:
        """A log has ended: its last snapshot stays."""
        self.has_ended = True
        if self._slot is not None:
            self._slot = (self._slot[0], self._clock_s())

    @property
    def newest(self) -> Snapshot | None:
        """The newest snapshot; None before the first."""
        slot = self._slot
        return slot[0] if slot is not None else None

    @property
    def age_s(self) -> float:
        """Time since the newest snapshot was put; infinite before the first."""
        slot = self._slot
        return self._clock_s() - slot[1] if slot is not None else float("inf")

    @property
    def is_stalled(self) -> bool:
        """Whether the estimator's thread has not put a snapshot for `STALLED_S`."""
        return self.age_s > STALLED_S and not self.has_ended

    def refresh(self) -> bool:
        """Take what is new into the event and the history; whether anything was. The server's
        thread."""
        slot = self._slot
        if slot is None or slot is self._shown:
            return False
        self._shown = slot
        row = json.dumps(slot[0].row, separators=(",", ":"))
        state = json.dumps(slot[0].document, separators=(",", ":"), ensure_ascii=False)
        self._encoded = f'"row":{row},"state":{state}'
        self.number += 1
        return True

    def event(self) -> bytes:
        """The newest snapshot as a server-sent event: age_s; row and state once there are any."""
        age_s = self.age_s
        head = f'{{"age_s":{age_s:.2f}' if self._shown is not None else '{"age_s":null'
        head += ',"ended":true' if self.has_ended else ""
        body = f",{self._encoded}" if self._shown is not None else ""
        return f"data: {head}{body}}}\n\n".encode()

    def history(self) -> list[bytes]:
        """The rows as JSON, ``{"columns": [...], "rows": [[...], ...]}``, in pieces: to join all of
        it at once would hold the interpreter."""
        rows = list(self._rows)
        pieces = [f'{{"columns":{json.dumps(COLUMNS)},"rows":['.encode()]
        for start in range(0, len(rows), 100):
            comma = "," if start else ""
            part = json.dumps(rows[start : start + 100], separators=(",", ":"))
            pieces.append((comma + part[1:-1]).encode())
        return [*pieces, b"]}"]
