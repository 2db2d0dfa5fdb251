"""What is kept of one session: a row for each barometer and GNSS sample, with the estimate after
it.

The IMU is not kept: its rows would be most of a log, and the altitude moves little between them.
"""

import math
from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.evaluation.metrics import Array
from companion.evaluation.smoother import UNKNOWN_GNSS_SD_M, Measured
from companion.health import Health
from companion.kernels.arrays import baro_altitude_array, gnss_sd_array
from companion.kernels.gnss import gnss_sd_m
from companion.mavlink.codec import Message
from companion.observer import Block
from companion.pipeline import Pipeline
from companion.replay.block_steps import copy_words
from companion.replay.events import Events
from companion.samples import DTYPES, ESTIMATE, HEIGHT, Kind, Rows, Suspicion, Verdict, readable

NO_UNIX_US = -(1 << 61)
"""below any offset of UNIX time"""
SECONDS_BITS = 44
SECOND_ZERO = 1 << SECONDS_BITS - 1
"""a second may be negative"""
FROM_SAMPLE = ("time_us", "arrival_us", "instance", "suspect")

RECORD = np.dtype(
    [
        ("time_us", "i8"),  # of the sample, since boot
        ("now_us", "i8"),  # the vehicle's clock
        ("arrival_us", "i8"),
        ("kind", "i8"),
        ("instance", "i8"),
        ("verdict", "i8"),
        ("suspect", "i8"),
        ("health", "i8"),
        ("pressure_pa", "f8"),
        ("gnss_altitude_m", "f8"),
        ("gnss_sd_m", "f8"),
        ("ground_speed_mps", "f8"),
        ("fix_type", "i8"),
        ("satellites", "i8"),
        ("latitude_deg", "f8"),
        ("longitude_deg", "f8"),
        ("estimate", ESTIMATE),
    ],
    align=True,
)

WORD = 8
AT = RECORD.fields["estimate"][1] // WORD  # type: ignore[index]
"""the place of the estimate in a RECORD, in words"""


class Recording:
    """An observer that keeps the heights of a session. Rows grow by doubling."""

    def __init__(self, pipeline: Pipeline) -> None:
        self._pipeline = pipeline
        self._rows = readable(np.zeros(256, RECORD))
        self._count = 0
        self._chosen: dict[Kind, tuple[int, Rows]] = {}
        """kind -> number of rows, and those of the first sensor among them"""
        self._tracks: dict[str, tuple[tuple[int, ...], tuple[Array, Array]]] = {}
        """source -> how much was recorded, and its track"""
        self._heights: dict[bool, list[Rows]] = {True: [], False: []}
        """HEIGHT rows in pieces: of the truth, and of the autopilot"""
        self.published_count = 0
        """ALTITUDE messages of ours"""
        self.armed: list[tuple[int, bool]] = []
        """(time_us, armed) at each change"""
        self.unix_offset_us: int | None = None
        """UNIX time minus boot time, as the vehicle said it; None where it did not"""
        self.events = Events(pipeline)
        """flight modes and texts"""
        self._rates: Counter[tuple[Kind, int]] = Counter()
        self._sampled: list[NDArray[np.int64]] = []
        """kind and second of the samples that are not in `_rates` yet"""
        self._airspeeds: list[Rows] = []
        """AIRSPEED rows in pieces"""

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        value = row[0]
        if kind is Kind.GNSS:
            self.unix_offset_us = self._pipeline.intake.clock.unix_offset_us or self.unix_offset_us
        if value["instance"] == 0:
            self._rates[kind, int(value["time_us"]) // 1_000_000] += 1
        if kind is Kind.STATUS:
            self._note_armed(int(value["time_us"]), int(value["armed"]))
            return
        if kind is Kind.AIRSPEED:
            self._airspeeds.append(row.copy())
            return
        if kind is not Kind.PRESSURE and kind is not Kind.GNSS:
            return
        kept = self._grown(1)[0]
        kept["time_us"], kept["arrival_us"] = value["time_us"], value["arrival_us"]
        kept["now_us"] = self._pipeline.now_us
        kept["kind"], kept["instance"], kept["verdict"] = kind, value["instance"], verdict
        kept["suspect"], kept["health"] = value["suspect"], self._pipeline.health.health
        kept["estimate"] = estimate[0]
        is_gnss = kind is Kind.GNSS
        kept["pressure_pa"] = math.nan if is_gnss else value["pressure_pa"]
        kept["gnss_altitude_m"] = value["altitude_amsl_m"] if is_gnss else math.nan
        kept["gnss_sd_m"] = gnss_sd_m(row, 0.0, UNKNOWN_GNSS_SD_M) if is_gnss else math.nan
        kept["ground_speed_mps"] = value["ground_speed_mps"] if is_gnss else math.nan
        kept["fix_type"] = value["fix_type"] if is_gnss else -1
        kept["satellites"] = value["satellites"] if is_gnss else -1
        kept["latitude_deg"] = value["latitude_deg"] if is_gnss else math.nan
        kept["longitude_deg"] = value["longitude_deg"] if is_gnss else math.nan

    def block(self, block: Block) -> None:
        tables, order = block.tables, block.tables.order
        kinds, places = np.asarray(order["kind"]), np.asarray(order["row"])
        self.published_count += block.published
        for heights, is_truth in ((block.truth, True), (block.autopilot, False)):
            if heights.size:
                self._heights[is_truth].append(heights)
        first = block.instances == 0
        self._sampled.append((kinds[first] << SECONDS_BITS) + block.times_us[first] // 1_000_000)
        status = tables.status[places[kinds == Kind.STATUS]]
        for time_us, armed in zip(
            status["time_us"].tolist(), status["armed"].tolist(), strict=True
        ):
            self._note_armed(time_us, armed)
        if tables.airspeed.size:
            self._airspeeds.append(np.array(tables.airspeed[places[kinds == Kind.AIRSPEED]]))
        chosen = np.flatnonzero((kinds == Kind.PRESSURE) | (kinds == Kind.GNSS))
        is_gnss = kinds[chosen] == Kind.GNSS
        if not chosen.size:
            return
        known_us = block.unix_us[chosen[is_gnss]]
        known_us = known_us[known_us > NO_UNIX_US]
        if known_us.size:
            self.unix_offset_us = int(known_us[-1])
        kept = self._grown(chosen.size)
        kept["now_us"], kept["kind"] = block.now_us[chosen], kinds[chosen]
        kept["verdict"], kept["health"] = block.verdicts[chosen], block.health[chosen]
        words = block.estimates.dtype.itemsize // WORD
        estimates = np.asarray(block.estimates).view(np.int64).reshape(-1, words)
        copy_words(np.asarray(kept).view(np.int64).reshape(chosen.size, -1), AT, estimates, chosen)
        _fill_pressures(kept, ~is_gnss, tables.pressure[places[chosen[~is_gnss]]])
        _fill_fixes(kept, is_gnss, tables.gnss[places[chosen[is_gnss]]])

    def _note_armed(self, time_us: int, armed: int) -> None:
        if armed >= 0 and (not self.armed or self.armed[-1][1] != bool(armed)):
            self.armed.append((time_us, bool(armed)))

    def _grown(self, count: int) -> Rows:
        """The rows of the next `count` samples."""
        first, self._count = self._count, self._count + count
        if self._count > self._rows.size:
            grown = np.zeros(max(self._count, 2 * self._rows.size), RECORD)
            grown[:first] = self._rows[:first]  # what is behind takes no memory before it is used
            self._rows = readable(grown)
        rows: Rows = self._rows[first : self._count]
        return rows

    def truth(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        self._heights[True].append(np.array([(time_us, altitude_amsl_m, climb_mps)], HEIGHT))

    def autopilot(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        self._heights[False].append(np.array([(time_us, altitude_amsl_m, climb_mps)], HEIGHT))

    def published(self, message: Message) -> None:
        self.published_count += 1

    @property
    def rates(self) -> Counter[tuple[Kind, int]]:
        """Samples of the first sensor of each kind in each second of the vehicle's clock."""
        if self._sampled:
            found, counts = np.unique(np.concatenate(self._sampled), return_counts=True)
            self._sampled = []
            for pair, count in zip(found.tolist(), counts.tolist(), strict=True):
                kind = pair + SECOND_ZERO >> SECONDS_BITS
                self._rates[Kind(kind), pair - (kind << SECONDS_BITS)] += count
        return self._rates

    @property
    def rows(self) -> Rows:
        """RECORD rows in order of arrival."""
        rows: Rows = self._rows[: self._count]
        return rows

    def heights(self, *, truth: bool) -> NDArray[Any]:
        """HEIGHT rows of a simulator's truth, or of the autopilot's own."""
        pieces = self._heights[truth]
        return np.concatenate(pieces) if pieces else np.zeros(0, HEIGHT)

    def of(self, kind: Kind) -> Rows:
        """Rows of the first sensor of a kind; of GNSS only fixes."""
        count, rows = self._chosen.get(kind, (-1, self.rows))
        if count == self._count:
            return rows
        rows = self.rows
        chosen = (np.asarray(rows["kind"]) == kind) & (np.asarray(rows["instance"]) == 0)
        if kind is Kind.GNSS:
            chosen &= np.asarray(rows["fix_type"]) >= 3
        self._chosen[kind] = self._count, rows[chosen]
        return self._chosen[kind][1]

    def release(self) -> None:
        """Give back the memory of what can be made again from the rows."""
        self._chosen.clear()
        self._tracks.clear()

    def ticks(self) -> Rows:
        """Rows at which the altitude is judged: the first barometer's, else the receiver's."""
        pressure = self.of(Kind.PRESSURE)
        return pressure if pressure.size else self.of(Kind.GNSS)

    def measured(self) -> Measured:
        """What the smoother takes."""
        baro, gnss = self.of(Kind.PRESSURE), self.of(Kind.GNSS)
        air = np.concatenate([np.zeros(0, DTYPES[Kind.AIRSPEED]), *self._airspeeds])
        air = air[air["instance"] == 0]
        return Measured(
            np.asarray(baro["time_us"], np.float64),
            baro_altitude_array(baro["pressure_pa"]),
            np.asarray(gnss["time_us"], np.float64),
            np.asarray(gnss["gnss_altitude_m"]),
            np.asarray(gnss["gnss_sd_m"]),
            np.asarray(gnss["fix_type"]),
            np.asarray(gnss["ground_speed_mps"]),
            np.asarray(air["time_us"], np.float64),
            np.asarray(air["airspeed_mps"]),
        )

    def track(self, source: str) -> tuple[Array, Array]:
        """(time_us, altitude_m), shape (n,) each, of "estimate", "published" (the estimate where it
        was not lost), "baro", "gnss", "autopilot" or "truth"; unknown altitudes are left out."""
        size = self._count, *map(len, self._heights.values())
        if source not in self._tracks or self._tracks[source][0] != size:
            self._tracks[source] = size, self._track(source)
        return self._tracks[source][1]

    def _track(self, source: str) -> tuple[Array, Array]:
        if source in ("estimate", "published"):
            ticks = self.ticks()
            rows = ticks["estimate"]
            if source == "published":
                rows = rows[np.asarray(ticks["health"]) != Health.LOST]
            times, values = rows["time_us"], rows["altitude_amsl_m"]
        elif source == "baro":
            rows = self.of(Kind.PRESSURE)
            times, values = rows["time_us"], baro_altitude_array(rows["pressure_pa"])
        elif source == "gnss":
            rows = self.of(Kind.GNSS)
            times, values = rows["time_us"], rows["gnss_altitude_m"]
        else:
            rows = self.heights(truth=source == "truth")
            times, values = rows["time_us"], rows["altitude_amsl_m"]
        times, values = np.asarray(times, np.float64), np.asarray(values, np.float64)
        known = np.isfinite(values)
        return times[known], values[known]

    def health_shares(self) -> dict[str, float]:
        """Share of the rows in each state of health."""
        health = np.asarray(self.rows["health"])
        if not health.size:
            return {}
        return {state.name: float(np.mean(health == state)) for state in Health}

    def suspected(self) -> dict[str, int]:
        """Rows that the plausibility check marked, by kind."""
        rows = self.rows
        marked = np.asarray(rows["suspect"]) != Suspicion.NONE
        kinds = np.asarray(rows["kind"])
        return {
            kind.name.lower(): int((marked & (kinds == kind)).sum())
            for kind in (Kind.PRESSURE, Kind.GNSS)
            if (marked & (kinds == kind)).any()
        }


def _fill_pressures(kept: Rows, where: NDArray[Any], pressures: Rows) -> None:
    """The fields of a RECORD that a pressure gives."""
    for name in (*FROM_SAMPLE, "pressure_pa"):
        kept[name][where] = pressures[name]
    for name in ("gnss_altitude_m", "gnss_sd_m", "ground_speed_mps", "latitude_deg"):
        kept[name][where] = math.nan
    kept["longitude_deg"][where] = math.nan
    kept["fix_type"][where] = kept["satellites"][where] = -1


def _fill_fixes(kept: Rows, where: NDArray[Any], fixes: Rows) -> None:
    """The fields of a RECORD that a fix gives."""
    names = ("ground_speed_mps", "fix_type", "satellites", "latitude_deg", "longitude_deg")
    for name in (*FROM_SAMPLE, *names):
        kept[name][where] = fixes[name]
    kept["pressure_pa"][where] = math.nan
    kept["gnss_altitude_m"][where] = fixes["altitude_amsl_m"]
    kept["gnss_sd_m"][where] = gnss_sd_array(fixes, 0.0, UNKNOWN_GNSS_SD_M)
