"""What the companion would have sent over a log: health and ALTITUDE, by the rules of the pipeline.

The estimator's compiled loop runs over the whole log; then the checker, the health monitor and the
output rules of the pipeline follow its estimates after every pressure and fix. Where the checker
restarts the estimator, the loop runs anew over what follows. So a flight of an hour costs a
second, not minutes. Two simplifications: the vehicle's silence on the host's clock is not seen, and
an ALTITUDE that an IMU sample would have triggered is sent with the next pressure or fix.
"""

import time
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from companion.checker import Checker
from companion.config import Settings
from companion.estimators import ESTIMATORS, Filter, Method, run_log
from companion.evaluation.metrics import Array
from companion.evaluation.samples import BOOT_US
from companion.health import HealthMonitor
from companion.intake import restart_row
from companion.mavlink.outputs import Outputs
from companion.samples import Kind, Rows, SampleLog, Verdict
from companion.settings import CompanionSettings


@dataclass(frozen=True)
class Published:
    """What one estimator said and the companion sent, at every pressure and fix; shape (n,)
    each."""

    estimates: Rows
    """ESTIMATE rows"""
    times_us: Array
    """time of the estimate, with `BOOT_US` added for each reboot, as the truth of a log has it"""
    now_us: NDArray[np.int64]
    """the vehicle's clock"""
    kind: NDArray[np.int64]
    """`Kind` of the sample"""
    health: NDArray[np.int64]
    """`Health` after the sample"""
    is_sent: NDArray[np.bool_]
    """whether an ALTITUDE went out"""
    cost_us: float
    """processor time of the compiled loop, us a sample of any kind; it must have run before"""

    def of(self, name: str) -> Array:
        """A field of the estimates."""
        return np.asarray(self.estimates[name], np.float64)


def published(log: SampleLog, estimator: str, settings: CompanionSettings) -> Published:
    """Run `estimator` over `log`, and follow what the companion would have sent."""
    method, section = ESTIMATORS[estimator], settings.section(estimator)
    before_s = time.thread_time()
    runs = _Runs(method, section, log)
    estimates, verdicts = runs.estimates, runs.verdicts
    cost_us = (time.thread_time() - before_s) * 1e6 / max(1, len(log))
    kinds, rows = (np.asarray(log.tables.order[name]) for name in ("kind", "row"))
    clock_us = _clock(log, kinds, rows, round(settings.intake.gnss_latency_s * 1e6))
    reboots, primary = _is_reboot(log, kinds, rows), _instances(log, kinds, rows) == 0
    followed = np.flatnonzero((kinds == Kind.PRESSURE) | (kinds == Kind.GNSS) | reboots)
    tables = {int(kind): log[kind] for kind in Kind}
    follower = _Follower(settings, method.uses)
    health, is_sent = np.zeros(followed.size, np.int64), np.zeros(followed.size, bool)
    for k, i in enumerate(followed.tolist()):
        kind, now_us = int(kinds[i]), int(clock_us[i])
        if reboots[i]:
            follower.restart()
        row, estimate = tables[kind][rows[i] : rows[i] + 1], estimates[i : i + 1]
        follower.take(_KINDS[kind], row, _VERDICTS[verdicts[i]], now_us, is_primary=primary[i])
        if follower.asks_restart(_VERDICTS[verdicts[i]], now_us, estimate):
            runs.restart(i + 1, now_us)
        is_sent[k] = follower.sends(_VERDICTS[verdicts[i]], now_us, estimate)
        health[k] = follower.monitor.health
    kept = np.asarray(estimates[followed])
    times_us = kept["time_us"] + np.cumsum(reboots)[followed] * float(BOOT_US)
    return Published(kept, times_us, clock_us[followed], kinds[followed], health, is_sent, cost_us)


_KINDS, _VERDICTS = tuple(Kind), tuple(Verdict)


class _Runs:
    """An estimator over a log, with the restarts that the checker asks for."""

    def __init__(self, method: Method, section: Settings, log: SampleLog) -> None:
        self._filter, self._tables = Filter(method, section), log.tables
        self._begun = 0
        self.estimates, self.verdicts, _ = run_log(method, log, section)

    def restart(self, start: int, now_us: int) -> None:
        """Restart the estimator before sample `start`; estimates and verdicts from there on are
        those of what it knew then and keeps."""
        self._run(self._begun, start)
        self._filter.step(Kind.STATUS, restart_row(now_us, now_us))
        self._begun, kept = start, self._filter.state.copy()
        self._run(start, self.estimates.size)
        self._filter.state = kept

    def _run(self, start: int, stop: int) -> None:
        running, part = self._filter, slice(start, stop)
        tables = self._tables._replace(order=self._tables.order[part])
        estimates, verdicts = self.estimates[part], self.verdicts[part]
        running.method.run(running.state, running.params, tables, estimates, verdicts)


class _Follower:
    """Checker, health and outputs, as `companion.pipeline.Pipeline` keeps them."""

    def __init__(self, settings: CompanionSettings, uses: frozenset[Kind]) -> None:
        self.monitor = HealthMonitor(settings.health, uses)
        self._checker = Checker()
        self._outputs = Outputs(settings.publish)

    def restart(self) -> None:
        """The vehicle restarted."""
        self.monitor.restart()
        self._outputs.restart()
        self._checker.restart()

    def take(
        self, kind: Kind, row: Rows, verdict: Verdict, now_us: int, *, is_primary: bool
    ) -> None:
        """Follow a sample and its verdict."""
        self._checker.sample(kind, row)
        if is_primary:
            self.monitor.sample(kind, verdict, now_us, now_us)

    def asks_restart(self, verdict: Verdict, now_us: int, estimate: Rows) -> bool:
        """Assess the health; whether the estimator must start anew."""
        if verdict is not Verdict.USED and not self.monitor.is_due(now_us):
            return False
        objection = self._checker.judge(now_us, estimate)
        self.monitor.assess(now_us, estimate, *objection)
        return self._checker.asks_restart(now_us, supported=self.monitor.has_altitude)

    def sends(self, verdict: Verdict, now_us: int, estimate: Rows) -> bool:
        """Whether an ALTITUDE goes out because of the sample."""
        if verdict is not Verdict.USED:
            return False
        return self._outputs.altitude(now_us, self.monitor.health, estimate) is not None


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
