"""Fault detection of an estimator: delay, attribution to the right sensor, and false alarms."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.evaluation.metrics import Array
from companion.samples import FaultySensor

Exclusions = NDArray[np.int64]
"""field ``faulty`` of the estimates: `companion.samples.FaultySensor` as numbers, shape (n,)"""


class Attribution(NamedTuple):
    """The faulty sensor that an estimator reports over a log, shape (n,) each, by arrival time."""

    times_us: Array
    faulty: Exclusions
    since_us: Array


@dataclass(frozen=True)
class Detection:
    """Detection of one fault; a time that never came is NaN."""

    delay_s: float
    """time from the onset until the right sensor is named, s"""
    since_error_s: float
    """reported onset (``faulty_since_us``) when the sensor is first named, minus the true onset,
    s"""
    named_share: float
    """share of the estimates during the fault that name the right sensor"""
    wrong_share: float
    """share of the estimates during the fault that name another sensor"""
    cleared_s: float
    """time from the end of the fault until no sensor is named, s; NaN too if none was named at its
    end"""

    @property
    def detected(self) -> bool:
        return math.isfinite(self.delay_s)


def detection(
    times_us: Array,
    faulty: Exclusions,
    since_us: Array,
    onset_us: float,
    end_us: float,
    sensor: FaultySensor,
) -> Detection:
    """Judge the attribution while `sensor` is wrong, from `onset_us` until before `end_us`
    (``math.inf``: to the end).

    `times_us`, `faulty`, `since_us`: time and fields of the estimates, shape (n,), in order of time
    on one clock.
    """
    lasts = (times_us >= onset_us) & (times_us < end_us)
    right = lasts & (faulty == sensor)
    wrong = lasts & (faulty != sensor) & (faulty != FaultySensor.NONE)
    count = np.count_nonzero(lasts)
    first = int(np.argmax(right)) if right.any() else None
    return Detection(
        delay_s=math.nan if first is None else float(times_us[first] - onset_us) * 1e-6,
        since_error_s=math.nan if first is None else float(since_us[first] - onset_us) * 1e-6,
        named_share=np.count_nonzero(right) / count if count else math.nan,
        wrong_share=np.count_nonzero(wrong) / count if count else math.nan,
        cleared_s=_cleared_s(times_us, faulty, lasts, end_us),
    )


def _cleared_s(
    times_us: Array, faulty: Exclusions, lasts: NDArray[np.bool_], end_us: float
) -> float:
    if not lasts.any() or faulty[lasts][-1] == FaultySensor.NONE:
        return math.nan
    clear = (times_us >= end_us) & (faulty == FaultySensor.NONE)
    return float(times_us[np.argmax(clear)] - end_us) * 1e-6 if clear.any() else math.nan


def false_alarms(
    times_us: Array, faulty: Exclusions, windows_us: Sequence[tuple[float, float]] = ()
) -> int:
    """Number of attributions that begin outside all of `windows_us` (onset, end), when no sensor is
    wrong.

    An exclusion begins where ``faulty`` changes to a sensor; one that outlasts a fault is late,
    not false.
    """
    before = np.concatenate([[FaultySensor.NONE], faulty[:-1]])
    begins = (faulty != FaultySensor.NONE) & (faulty != before)
    for onset_us, end_us in windows_us:
        begins &= (times_us < onset_us) | (times_us >= end_us)
    return int(np.count_nonzero(begins))
