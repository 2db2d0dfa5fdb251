"""An observer that keeps the tracks of a pipeline, and their errors against truth."""

import numpy as np

from companion.evaluation.metrics import Array, Errors, errors, truth_at
from companion.evaluation.samples import BOOT_US
from companion.kernels.atmosphere import baro_altitude_array
from companion.mavlink.codec import Message
from companion.samples import Kind, Rows, Verdict

SETTLE_S = 60.0
"""time after the first sample whose errors do not count: estimators initialise"""


class _Track:
    """A growing table of (time_us, value, ...) rows."""

    def __init__(self, columns: int) -> None:
        self._columns = columns
        self._rows: list[tuple[float, ...]] = []

    def add(self, *row: float) -> None:
        self._rows.append(row)

    def array(self) -> Array:
        """shape (columns, rows)"""
        return np.array(self._rows, np.float64).reshape(-1, self._columns).T


class Collector:
    """An observer that keeps what a report needs."""

    def __init__(self) -> None:
        self._boot_us = 0
        self._first_us: int | None = None
        self._last_us = 0
        self._tracks = {
            name: _Track(2) for name in ("gnss", "baro", "truth", "autopilot", "published")
        }
        self._estimate = _Track(4)

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        if kind is Kind.STATUS:
            if row[0]["reboot"] == 1:
                self._boot_us += BOOT_US
            return
        value = row[0]
        time_us = int(value["time_us"]) + self._boot_us
        self._first_us = time_us if self._first_us is None else self._first_us
        self._last_us = max(self._last_us, time_us)
        if value["instance"] == 0 and kind is Kind.GNSS and value["fix_type"] >= 3:
            self._tracks["gnss"].add(time_us, float(value["altitude_amsl_m"]))
        elif value["instance"] == 0 and kind is Kind.PRESSURE:
            self._tracks["baro"].add(time_us, float(value["pressure_pa"]))
        if verdict is Verdict.USED:
            now = estimate[0]
            self._estimate.add(
                int(now["time_us"]) + self._boot_us,
                float(now["altitude_amsl_m"]),
                float(now["climb_mps"]),
                float(now["altitude_sd_m"]),
            )

    def truth(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        self._tracks["truth"].add(time_us + self._boot_us, altitude_amsl_m)

    def autopilot(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        self._tracks["autopilot"].add(time_us + self._boot_us, altitude_amsl_m)

    def published(self, message: Message) -> None:
        self._tracks["published"].add(message.time_usec + self._boot_us, message.altitude_amsl)

    def track(self, name: str) -> Array:
        """(times_us, altitudes_m), shape (2, n), of "estimate", "published", "gnss", "baro",
        "autopilot" or "truth"."""
        if name == "estimate":
            return self._estimate.array()[:2]
        array = self._tracks[name].array()
        if name == "baro" and array.size:
            array = np.array([array[0], baro_altitude_array(array[1])])
        return array

    def spread(self) -> Array:
        """The estimate's own standard deviation, shape (n,), at the times of its track."""
        return self._estimate.array()[3]

    def climb(self) -> Array:
        """The estimated climb, shape (n,), at the times of its track."""
        return self._estimate.array()[2]

    def errors(self, name: str, settle_s: float = SETTLE_S) -> Errors | None:
        """Errors of a track against truth from `settle_s` after the first sample on."""
        times_us, values = self.track(name)
        start_us = (self._first_us or 0) + settle_s * 1e6
        late = times_us >= start_us
        truth_us, truth_m = self.track("truth")
        return errors(values[late], truth_at(times_us[late], truth_us, truth_m))

    @property
    def duration_s(self) -> float:
        """From the first to the last sample of the last boot, or of all boots together."""
        if self._first_us is None:
            return 0.0
        return (self._last_us % BOOT_US - (self._first_us if self._boot_us == 0 else 0)) * 1e-6
