"""Fault windows, in which a scenario's faults make a sensor wrong, and their attribution by
estimators."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.evaluation.compare import Series
from companion.evaluation.detection import Detection, detection, false_alarms
from sim import BOOT_UNIX_US
from sim.faults import Fault


@dataclass(frozen=True)
class FaultWindow:
    """A fault that makes a sensor wrong, and its time on the clock of the flight's log."""

    fault: Fault
    onset_us: float
    end_us: float
    """infinite for a fault that lasts"""

    @property
    def is_silent(self) -> bool:
        """Whether the sensor does not report the fault itself: then an estimator should name it."""
        return not self.fault.announced

    def judge(self, series: Series) -> Detection | None:
        """How an estimator attributed it; None for a source without attribution."""
        if series.attribution is None:
            return None
        return detection(*series.attribution, self.onset_us, self.end_us, self.fault.faulty_sensor)


def fault_windows(faults: Sequence[Fault], duration_s: float) -> list[FaultWindow]:
    """The windows of those `faults` that harm a sensor and begin within the flight."""
    found = []
    for fault in faults:
        if fault.faulty_sensor and fault.start_s < duration_s:
            onset_us = BOOT_UNIX_US + fault.start_s * 1e6
            lasts_us = math.inf if fault.duration_s is None else fault.duration_s * 1e6
            found.append(FaultWindow(fault, onset_us, onset_us + lasts_us))
    return found


def attribution(found: Sequence[FaultWindow], series: Series) -> dict[str, Any]:
    """How an estimator attributed the faults of one flight, as a row's values; None of a source
    without attribution.

    `faults` are those that should be named and `detected` those that were, after a mean of
    `detection_s` (s); `wrong_share` is the mean share of their time in which another sensor was
    named; `false_alarms` began when no sensor was wrong.
    """
    if series.attribution is None:
        return dict.fromkeys(("faults", "detected", "detection_s", "wrong_share", "false_alarms"))
    judged = [
        each
        for each in (window.judge(series) for window in found if window.is_silent)
        if each is not None
    ]
    delays_s = [each.delay_s for each in judged if each.detected]
    wrong = [each.wrong_share for each in judged if math.isfinite(each.wrong_share)]
    times_us, faulty, _ = series.attribution
    return {
        "faults": len(judged),
        "detected": len(delays_s),
        "detection_s": float(np.mean(delays_s)) if delays_s else None,
        "wrong_share": float(np.mean(wrong)) if wrong else None,
        "false_alarms": false_alarms(
            times_us, faulty, [(each.onset_us, each.end_us) for each in found]
        ),
    }
