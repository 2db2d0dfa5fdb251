"""Errors of a GNSS height that are laid over a flight: a Gauss-Markov model, or what a recorded
receiver that stood still really did.

A stationary stretch of a recorded log gives the error as height minus its mean over the stretch,
and the accuracy that the receiver reported with it. The mean error of the stretch is unknown and
left out. To cover a longer flight a stretch is run to and fro, which keeps it continuous; each seed
starts elsewhere in it and may change its sign.
"""

import hashlib
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion import whole_file
from companion.errors import KollsmanError
from companion.evaluation.samples import samples_of
from companion.samples import Kind
from sim.studies.runs import kept_parts

Array = NDArray[np.float64]

STILL_MPS = 0.7
"""ground speed of a receiver that stands still"""
SHORTEST_S = 120.0
LEAST_SD_M = 0.05
"""a height that moves less is a simulator's"""
STEP_S = 0.02
VERSION = 1
"""version of the results that are kept of a log"""
TIME_CONSTANT_S = 250.0
WHITE_SD_M = 0.15
LONGEST_STEP_S = 3.0
FIX_3D = 3
LOGS = (".tlog",)


class Reported(NamedTuple):
    """Height error of every fix, m, and what the receiver reports with it; NaN is not reported."""

    error_m: Array
    vertical_sd_m: Array
    vdop: Array
    hdop: Array


class GnssError:
    """A height error over time. `at` is called once a flight."""

    label = ""

    def at(self, elapsed_s: Array, random: np.random.Generator) -> Reported:
        """At `elapsed_s`, a grid of `STEP_S`, shape (n,)."""
        raise NotImplementedError


@dataclass(frozen=True)
class GaussMarkovError(GnssError):
    """Gauss-Markov of `sd_m` over `TIME_CONSTANT_S` and `WHITE_SD_M` of white noise; the receiver
    reports `sd_m`."""

    sd_m: float = 4.0

    label = "Gauss-Markov"

    def at(self, elapsed_s: Array, random: np.random.Generator) -> Reported:
        n = elapsed_s.size
        keep = math.exp(-STEP_S / TIME_CONSTANT_S)
        value = float(random.normal(0.0, self.sd_m))
        drive = random.normal(size=n) * self.sd_m * math.sqrt(1.0 - keep * keep)
        error = np.empty(n)
        for i, push in enumerate(drive.tolist()):
            value = keep * value + push
            error[i] = value
        error += WHITE_SD_M * random.normal(size=n)
        return Reported(error, np.full(n, self.sd_m), np.full(n, 1.3), np.full(n, 0.8))


@dataclass(frozen=True)
class RecordedError(GnssError):
    """What a stationary receiver did: times (s) from 0, height errors (m) and reports, shape
    (m,)."""

    path: Path
    number: int
    """number of the stretch in its log"""
    time_s: Array
    error_m: Array
    vertical_sd_m: Array
    vdop: Array
    hdop: Array
    seed: int = 0

    label = "recorded"

    def at(self, elapsed_s: Array, random: np.random.Generator) -> Reported:
        own = np.random.default_rng([self.seed, 11])
        length_s = float(self.time_s[-1])
        phase_s = own.uniform(0.0, 2.0 * length_s) + elapsed_s
        here_s = length_s - np.abs(phase_s % (2.0 * length_s) - length_s)
        sign = 1.0 if own.random() < 0.5 else -1.0
        row = np.clip(np.searchsorted(self.time_s, here_s, "right") - 1, 0, self.time_s.size - 1)
        return Reported(
            sign * np.interp(here_s, self.time_s, self.error_m),
            self.vertical_sd_m[row],
            self.vdop[row],
            self.hdop[row],
        )


def stationary(path: Path) -> list[RecordedError]:
    """The stretches of a recorded log over which its first receiver stood still; none of a log that
    is a simulator's or cannot be read.

    They are kept in the user's cache by the contents of the file: reading a log takes seconds.
    """
    digest = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    kept = kept_parts() / f"still-{VERSION}-{digest}.json"
    if not kept.exists():
        found = [stretch.tolist() for stretch in _still(_fixes(path))]
        whole_file.write(kept, json.dumps(found).encode("utf-8"))
    stretches = json.loads(kept.read_text(encoding="utf-8"))
    return [
        RecordedError(path, number, *np.array(each, np.float64).T)
        for number, each in enumerate(stretches)
    ]


def _still(fixes: Array) -> Iterator[Array]:
    """Columns time from 0, height error, v_acc, vdop, hdop of every stretch at rest."""
    if fixes.shape[0] == 0:
        return
    still = (fixes[:, 2] < STILL_MPS) & np.isfinite(fixes[:, 1])
    steps_s = np.diff(fixes[:, 0])
    breaks = np.concatenate([[True], (steps_s <= 0.0) | (steps_s > LONGEST_STEP_S)])
    ends = np.flatnonzero(np.diff(np.concatenate([[0], (still & ~breaks).astype(int), [0]])))
    for start, stop in zip(ends[::2], ends[1::2], strict=True):
        time_s, height_m = fixes[start:stop, 0] - fixes[start, 0], fixes[start:stop, 1]
        if time_s[-1] >= SHORTEST_S and np.std(height_m) > LEAST_SD_M:
            error_m = height_m - np.mean(height_m)
            yield np.column_stack([time_s, error_m, fixes[start:stop, 3:6]])


def _fixes(path: Path) -> Array:
    """Columns time_s, altitude, speed, v_acc, vdop, hdop of every 3D fix of the first receiver; no
    rows when the log has a simulator's truth or cannot be read."""
    try:
        log = samples_of(path)
    except (KollsmanError, OSError):
        return np.zeros((0, 6))
    gnss = log[Kind.GNSS]
    if log.truth.size or not gnss.size:
        return np.zeros((0, 6))
    fixed = (np.asarray(gnss["instance"]) == 0) & (np.asarray(gnss["fix_type"]) >= FIX_3D)
    names = ("altitude_amsl_m", "ground_speed_mps", "vertical_sd_m", "vdop", "hdop")
    columns = [np.asarray(gnss[name], np.float64)[fixed] for name in names]
    return np.stack([np.asarray(gnss["time_us"])[fixed] * 1e-6, *columns], axis=1)


def logs(folder: Path) -> list[Path]:
    """The logs below `folder` in which a stationary receiver may be."""
    return sorted(path for path in folder.rglob("*") if path.suffix.lower() in LOGS)
