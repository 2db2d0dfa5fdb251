"""Errors of a GNSS height that are laid over a flight: a Gauss-Markov model, or what a recorded
receiver that stood still really did.

A stationary stretch of a recorded log gives the error as height minus its mean over the stretch,
and the accuracy that the receiver reported with it. The mean error of the stretch is unknown and
left out. To cover a longer flight a stretch is run to and fro, which keeps it continuous; each seed
starts elsewhere in it and may change its sign.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.errors import KollsmanError
from companion.logs import open_log
from companion.mavlink import convert
from companion.mavlink.codec import Decoder, mavlink

Array = NDArray[np.float64]

STILL_MPS = 0.7
"""ground speed of a receiver that stands still"""
SHORTEST_S = 120.0
LEAST_SD_M = 0.05
"""a height that moves less is a simulator's"""
STEP_S = 0.02
TIME_CONSTANT_S = 250.0
WHITE_SD_M = 0.15
GPS_RAW_INT = mavlink.MAVLINK_MSG_ID_GPS_RAW_INT
FIX_3D = 3
SIM_STATE = mavlink.MAVLINK_MSG_ID_SIM_STATE


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
    """What a stationary receiver did: times (s) from 0, height errors (m) and reports, shape (m,)."""

    path: Path
    number: int
    """of the stretch in its log"""
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
    is a simulator's or cannot be read."""
    try:
        fixes = np.array(_fixes(path))
    except (KollsmanError, OSError):
        return []
    if fixes.size == 0:
        return []
    still = (fixes[:, 2] < STILL_MPS) & np.isfinite(fixes[:, 1])
    breaks = np.concatenate([[True], np.abs(np.diff(fixes[:, 0]) - 1.0) > 2.0])
    ends = np.flatnonzero(np.diff(np.concatenate([[0], (still & ~breaks).astype(int), [0]])))
    found: list[RecordedError] = []
    for start, stop in zip(ends[::2], ends[1::2], strict=True):
        time_s, height_m = fixes[start:stop, 0] - fixes[start, 0], fixes[start:stop, 1]
        if time_s[-1] >= SHORTEST_S and np.std(height_m) > LEAST_SD_M:
            v_acc, vdop, hdop = (fixes[start:stop, k] for k in (3, 4, 5))
            error_m = height_m - np.mean(height_m)
            found.append(RecordedError(path, len(found), time_s, error_m, v_acc, vdop, hdop))
    return found


def _fixes(path: Path) -> list[tuple[float, ...]]:
    """(time_s, altitude, speed, v_acc, vdop, hdop) of every 3D fix of the first receiver; empty when
    the log has a simulator's truth."""
    decoder, system = Decoder(datagrams=True), None
    found: list[tuple[float, ...]] = []
    for packet in open_log(path):
        for frame in decoder.feed(packet.data):
            if frame.message_id == SIM_STATE:
                return []
            if frame.message_id != GPS_RAW_INT or system not in (None, frame.system_id):
                continue
            message = decoder.decode(frame)
            if message is None or message.fix_type < FIX_3D:
                continue
            system = frame.system_id
            reading = convert.gps_raw(message, 0)[0]
            _, _, altitude, _, speed, _, _, _, v_acc, hdop, vdop, *_ = reading.values
            time_s = reading.stamp_us * 1e-6
            if not found or time_s > found[-1][0]:
                found.append((time_s, altitude, speed, v_acc, vdop, hdop))
            elif time_s < found[-1][0] - 1.0:  # another boot: what follows is another log
                break
    return found


def recorded(folder: Path) -> list[RecordedError]:
    """Every stationary stretch below `folder`, longest first."""
    paths: Sequence[Path] = sorted(folder.rglob("*.tlog"))
    stretches = [each for path in paths for each in stationary(path)]
    return sorted(stretches, key=lambda each: -float(each.time_s[-1]))
