"""What the companion would have sent over a log: health and ALTITUDE, by the rules of the pipeline.

The estimator's compiled loop runs over the whole log; then the health monitor and the output rules
of the pipeline follow its estimates after every pressure and fix. So a flight of an hour costs a
second, not minutes. Two simplifications: the vehicle's silence on the host's clock is not seen,
and an ALTITUDE that an IMU sample would have triggered is sent with the next pressure or fix.
"""

import time
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from companion.estimators import ESTIMATORS, run_log
from companion.evaluation.metrics import Array
from companion.health import HealthMonitor
from companion.mavlink.outputs import Outputs
from companion.samples import Kind, Rows, SampleLog, Verdict
from companion.settings import CompanionSettings


@dataclass(frozen=True)
class Published:
    """What one estimator said and the companion sent, at every pressure and fix; shape (n,) each."""

    estimates: Rows
    """ESTIMATE rows"""
    now_us: NDArray[np.int64]
    """the vehicle's clock"""
    kind: NDArray[np.int64]
    """`Kind` of the sample"""
    health: NDArray[np.int64]
    """`Health` after the sample"""
    is_sent: NDArray[np.bool_]
    """whether an ALTITUDE went out"""
    cost_us: float
    """of the compiled loop, a sample"""

    def of(self, name: str) -> Array:
        """A field of the estimates."""
        return np.asarray(self.estimates[name], np.float64)


def published(log: SampleLog, estimator: str, settings: CompanionSettings) -> Published:
    """Run `estimator` over `log`, and follow what the companion would have sent."""
    method = ESTIMATORS[estimator]
    before_s = time.perf_counter()
    estimates, verdicts, _ = run_log(method, log, settings.section(estimator))
    cost_us = (time.perf_counter() - before_s) * 1e6 / max(1, len(log))
    kinds, rows = (np.asarray(log.tables.order[name]) for name in ("kind", "row"))
    clock_us = _clock(log, kinds, rows, round(settings.intake.gnss_latency_s * 1e6))
    reboots = _is_reboot(log, kinds, rows)
    followed = np.flatnonzero((kinds == Kind.PRESSURE) | (kinds == Kind.GNSS) | reboots)
    follower = _Follower(settings, method.uses)
    health, is_sent = np.zeros(followed.size, np.int64), np.zeros(followed.size, bool)
    primary = _instances(log, kinds, rows) == 0
    for k, i in enumerate(followed.tolist()):
        if reboots[i]:
            follower.restart()
        is_sent[k] = follower.sample(
            Kind(int(kinds[i])),
            Verdict(int(verdicts[i])),
            int(clock_us[i]),
            estimates[i : i + 1],
            is_primary=bool(primary[i]),
        )
        health[k] = follower.monitor.health
    return Published(
        np.asarray(estimates[followed]),
        clock_us[followed],
        kinds[followed],
        health,
        is_sent,
        cost_us,
    )


class _Follower:
    """Health and outputs, as `companion.pipeline.Pipeline` keeps them."""

    def __init__(self, settings: CompanionSettings, uses: frozenset[Kind]) -> None:
        self.monitor = HealthMonitor(settings.health, uses)
        self._outputs = Outputs(settings.publish)

    def restart(self) -> None:
        self.monitor.restart()
        self._outputs.restart()

    def sample(
        self, kind: Kind, verdict: Verdict, now_us: int, estimate: Rows, *, is_primary: bool
    ) -> bool:
        """Whether an ALTITUDE goes out because of a sample."""
        if is_primary:
            self.monitor.sample(kind, verdict, now_us, now_us)
        is_used = verdict is Verdict.USED
        if is_used or self.monitor.is_due(now_us):
            self.monitor.assess(now_us, estimate)
        return is_used and self._outputs.altitude(now_us, self.monitor.health, estimate) is not None


def _clock(
    log: SampleLog, kinds: NDArray[np.int64], rows: NDArray[np.int64], latency_us: int
) -> NDArray[np.int64]:
    """The vehicle's clock after each sample: the newest stamp heard since the last reboot."""
    stamps = np.zeros(kinds.size, np.int64)
    for kind in Kind:
        chosen = kinds == kind
        late_us = latency_us if kind is Kind.GNSS else 0
        stamps[chosen] = np.asarray(log[kind]["time_us"])[rows[chosen]] + late_us
    starts = [0, *np.flatnonzero(_is_reboot(log, kinds, rows)).tolist(), kinds.size]
    for start, stop in pairwise(starts):
        stamps[start:stop] = np.maximum.accumulate(stamps[start:stop])
    return stamps


def _is_reboot(
    log: SampleLog, kinds: NDArray[np.int64], rows: NDArray[np.int64]
) -> NDArray[np.bool_]:
    found = np.zeros(kinds.size, bool)
    status = kinds == Kind.STATUS
    found[status] = np.asarray(log[Kind.STATUS]["reboot"])[rows[status]] == 1
    return found


def _instances(
    log: SampleLog, kinds: NDArray[np.int64], rows: NDArray[np.int64]
) -> NDArray[np.int64]:
    found = np.zeros(kinds.size, np.int64)
    for kind in Kind:
        chosen = kinds == kind
        found[chosen] = np.asarray(log[kind]["instance"])[rows[chosen]]
    return found


def share_sent(found: Published, start_us: float, end_us: float) -> float:
    """Share of the tenths of a second between two times (us, on the vehicle's clock) with an
    ALTITUDE at most a quarter of a second old."""
    sent_us = found.now_us[found.is_sent]
    slots_us = np.arange(start_us, end_us, 1e5)
    if not sent_us.size or not slots_us.size:
        return 0.0
    last = np.searchsorted(sent_us, slots_us, "right") - 1
    return float(np.mean((last >= 0) & (slots_us - sent_us[np.maximum(last, 0)] <= 2.5e5)))


def longest_s(times_us: Array, is_so: NDArray[np.bool_]) -> float:
    """The longest time, s, over which a condition held without a break."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_so.astype(np.int64), [0]])))
    if not edges.size:
        return 0.0
    return float(np.max(times_us[edges[1::2] - 1] - times_us[edges[::2]])) * 1e-6
