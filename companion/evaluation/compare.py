"""Every estimator on one log, beside the raw sensors and the autopilot's own result."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.estimators import ESTIMATORS, run_log
from companion.evaluation.detection import Attribution
from companion.evaluation.integrity import coverage, protection
from companion.evaluation.metrics import Array, errors, truth_at
from companion.evaluation.samples import BOOT_US, Sampler, Tap, samples_of
from companion.evaluation.smoother import measured_of, smooth
from companion.kernels.arrays import baro_altitude_array
from companion.logs import open_log
from companion.replay.sessions import Session, sessions_of
from companion.samples import Kind, Rows, SampleLog
from companion.settings import CompanionSettings

SETTLE_S = 60.0
OF_TRUTH = (
    "nees", "coverage_1", "coverage_2", "coverage_3", "exceedances", "exceeded_share",
    "takeoff_rmse_m",
)  # fmt: skip
"""of a `Result`: what only truth can tell"""


@dataclass(frozen=True)
class Result:
    """One line of the table; unknown is NaN. Errors are against truth; where there is none they are
    differences to the smoother of barometer and GNSS."""

    label: str
    rmse_m: float = math.nan
    p95_m: float = math.nan
    max_m: float = math.nan
    bias_m: float = math.nan
    unbiased_rmse_m: float = math.nan
    takeoff_rmse_m: float = math.nan
    """RMSE of the height above take-off: the source's own, or its altitude since arming or the
    first climb, m"""
    climb_rmse_mps: float = math.nan
    nees: float = math.nan
    """mean of (error / reported standard deviation)^2: 1 is consistent, more is overconfident"""
    median_sd_m: float = math.nan
    baro_residual_m: float = math.nan
    """RMS of altitude minus barometer height, without its mean, m"""
    cost_us: float = math.nan
    """processor time of a sample in the compiled loop, us"""
    coverage_1: float = math.nan
    """share of |error| <= 1 reported standard deviation; .683 for a consistent Gaussian"""
    coverage_2: float = math.nan
    coverage_3: float = math.nan
    median_level_m: float = math.nan
    """protection level"""
    exceedances: float = math.nan
    """exceedances: |error| above the protection level (`companion.evaluation.integrity`)"""
    exceeded_share: float = math.nan


@dataclass(frozen=True)
class Series:
    """One source over time: shape (n,) each; climb and spread are NaN where the source has none."""

    label: str
    times_us: Array
    altitude_m: Array
    climb_mps: Array
    sd_m: Array
    cost_us: float = math.nan
    attribution: Attribution | None = None
    """of estimators"""
    takeoff_m: Array | None = None
    """height above take-off, m; None where the source has none"""
    level_m: Array | None = None
    """protection level; None where the source has none"""


@dataclass(frozen=True)
class Comparison:
    """The series of one log, their reference, and the table of results."""

    reference: str
    """"truth"; "smoother" where the log has no truth, "nothing" where it has no GNSS either"""
    series: list[Series]
    results: list[Result]
    truth_us: Array
    truth_m: Array
    start_us: float = 0.0
    """arrival time before which errors do not count"""

    def errors_of(self, series: Series) -> tuple[NDArray[np.bool_], Array]:
        """Whether each altitude counts (late enough), shape (n,), and the errors of those that
        do."""
        late = series.times_us >= self.start_us
        return late, series.altitude_m[late] - truth_at(
            series.times_us[late], self.truth_us, self.truth_m
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready: unknown is None."""
        rows = [asdict(result) for result in self.results]
        plain = [
            {
                k: None if isinstance(v, float) and not math.isfinite(v) else v
                for k, v in row.items()
            }
            for row in rows
        ]
        return {"reference": self.reference, "results": plain}


def compare(
    path: Path,
    settings: CompanionSettings | None = None,
    settle_s: float = SETTLE_S,
    on_progress: Callable[[float], None] | None = None,
    estimators: Sequence[str] = tuple(ESTIMATORS),
) -> Comparison:
    """Run estimators over the log at `path`. Raises `LogFormatError`."""
    settings = settings or CompanionSettings()
    log = samples_of(
        path, settings, lambda fraction: on_progress(0.6 * fraction) if on_progress else None
    )
    return compare_log(log, settings, settle_s, on_progress, estimators)


def compare_log(
    log: SampleLog,
    settings: CompanionSettings,
    settle_s: float = SETTLE_S,
    on_progress: Callable[[float], None] | None = None,
    estimators: Sequence[str] = tuple(ESTIMATORS),
) -> Comparison:
    """Run estimators over samples; `on_progress` is called with 0.6 to 1."""
    series = []
    for index, name in enumerate(estimators):
        series.append(estimate_series(name, log, settings))
        if on_progress:
            on_progress(0.6 + 0.4 * (index + 1) / len(estimators))
    series += raw_series(log)
    truth = log.truth
    start_us = float(log.first_us) + settle_s * 1e6
    if truth.size > 1:
        truth_us, truth_m, truth_climb = (
            _floats(truth[name]) for name in ("time_us", "altitude_amsl_m", "climb_mps")
        )
        reference = "truth"
    else:
        truth_us, truth_m, truth_climb = _smoothed(log)
        reference = "smoother" if truth_us.size else "nothing"
    baro = next((each for each in series if each.label == "raw barometer"), None)
    takeoff = takeoff_of(log, truth_us, truth_m)
    results = [
        _judge(each, (truth_us, truth_m, truth_climb), baro, start_us, takeoff) for each in series
    ]
    if reference != "truth":  # what differs from a reference of less than perfect is no error
        unknown: dict[str, Any] = dict.fromkeys(OF_TRUTH, math.nan)
        results = [replace(each, **unknown) for each in results]
    return Comparison(reference, series, results, truth_us, truth_m, start_us)


def compare_sessions(
    path: Path,
    settings: CompanionSettings | None = None,
    settle_s: float = SETTLE_S,
    on_progress: Callable[[float], None] | None = None,
    estimators: Sequence[str] = tuple(ESTIMATORS),
) -> list[tuple[Session[Tap], Comparison]]:
    """Run estimators over every session of the log at `path`. Raises `LogFormatError`."""
    settings = settings or CompanionSettings()
    sessions = sessions_of(
        open_log(path),
        settings,
        lambda _: Tap(),
        Sampler,
        on_progress=lambda share: on_progress(0.6 * share) if on_progress else None,
    )
    return [
        (each, compare_log(each.seen.log, settings, settle_s, on_progress, estimators))
        for each in sessions
    ]


def _smoothed(log: SampleLog) -> tuple[Array, Array, Array]:
    """Times, altitude and climb of the smoother, on the clock of the series; empty without one."""
    reboots = int(np.sum(np.asarray(log[Kind.STATUS]["reboot"]) == 1))
    smoothed = smooth(measured_of(log)) if reboots <= 1 else None
    if smoothed is None:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    times_us = smoothed.time_us + reboots * float(BOOT_US)
    return times_us, smoothed.altitude_m, smoothed.climb_mps


def estimate_series(name: str, log: SampleLog, settings: CompanionSettings) -> Series:
    """What the estimator `name` says after every barometer sample (every fix, in a log without a
    barometer)."""
    method, section = ESTIMATORS[name], settings.section(name)
    run_log(method, log, section)  # compiled and in the processor's cache
    before_s = time.thread_time()
    estimates, _, _ = run_log(method, log, section)
    cost_us = (time.thread_time() - before_s) * 1e6 / max(1, len(log))
    order = log.tables.order
    kinds = np.asarray(order["kind"])
    boots = np.cumsum((kinds == Kind.STATUS) & _reboots(log, kinds, np.asarray(order["row"])))
    ticks = Kind.PRESSURE if np.any(kinds == Kind.PRESSURE) else Kind.GNSS
    chosen = (kinds == ticks) & np.isfinite(_floats(estimates["altitude_amsl_m"]))
    arrival_us = _floats(log[ticks]["arrival_us"][np.asarray(order["row"])[chosen]])
    level_m = _floats(estimates["protection_level_m"][chosen])
    return Series(
        name,
        _floats(estimates["time_us"][chosen]) + boots[chosen] * float(BOOT_US),
        _floats(estimates["altitude_amsl_m"][chosen]),
        _floats(estimates["climb_mps"][chosen]),
        _floats(estimates["altitude_sd_m"][chosen]),
        cost_us,
        _attribution(estimates[chosen], arrival_us),
        _floats(estimates["height_above_takeoff_m"][chosen]),
        level_m if np.isfinite(level_m).any() else None,
    )


def _attribution(estimates: Rows, arrival_us: Array) -> Attribution:
    """With the estimated onset, which is on the vehicle's clock, moved to the clock of arrival."""
    since_us = _floats(estimates["faulty_since_us"]) + arrival_us - _floats(estimates["time_us"])
    return Attribution(arrival_us, np.asarray(estimates["faulty"], np.int64), since_us)


def takeoff_of(log: SampleLog, truth_us: Array, truth_m: Array) -> tuple[float, float]:
    """Take-off: its time (us) and true height (m); NaN where there is none.

    Arming, as the vehicle says it; in a log of one that never arms, the start that it has climbed 2
    m from.
    """
    if truth_m.size < 2:
        return math.nan, math.nan
    status = log[Kind.STATUS]
    armed = np.flatnonzero(np.asarray(status["armed"]) == 1)
    if armed.size:
        time_us = float(status["time_us"][armed[0]])
        return time_us, float(np.interp(time_us, truth_us, truth_m))
    climbed = np.flatnonzero(truth_m > truth_m[0] + 2.0)
    return (
        (float(truth_us[climbed[0]]), float(truth_m[0])) if climbed.size else (math.nan, math.nan)
    )


def raw_series(log: SampleLog) -> list[Series]:
    """The autopilot's own height, GNSS and barometer as they are, where the log has them."""
    order = log.tables.order
    kinds, rows = np.asarray(order["kind"]), np.asarray(order["row"])
    boots = np.cumsum((kinds == Kind.STATUS) & _reboots(log, kinds, rows)) * float(BOOT_US)
    found = []
    own = log.autopilot
    if own.size:
        found.append(
            Series(
                "autopilot's own",
                _floats(own["time_us"]),
                _floats(own["altitude_amsl_m"]),
                _floats(own["climb_mps"]),
                np.full(own.size, np.nan),
            )
        )
    gnss, pressure = log[Kind.GNSS], log[Kind.PRESSURE]
    fixed = (np.asarray(gnss["fix_type"]) >= 3) & (np.asarray(gnss["instance"]) == 0)
    primary = np.asarray(pressure["instance"]) == 0
    gnss_us = _floats(gnss["time_us"]) + boots[kinds == Kind.GNSS]
    baro_us = _floats(pressure["time_us"]) + boots[kinds == Kind.PRESSURE]
    for label, times_us, altitude_m in (
        ("raw GNSS", gnss_us[fixed], _floats(gnss["altitude_amsl_m"])[fixed]),
        ("raw barometer", baro_us[primary], baro_altitude_array(pressure["pressure_pa"][primary])),
    ):
        if times_us.size:
            unknown = np.full(times_us.size, np.nan)
            found.append(Series(label, times_us, altitude_m, unknown, unknown))
    return found


def _judge(
    series: Series,
    reference: tuple[Array, Array, Array],
    baro: Series | None,
    start_us: float,
    takeoff: tuple[float, float],
) -> Result:
    reference_us, reference_m, reference_climb = reference
    late = series.times_us >= start_us
    times_us, altitude_m = series.times_us[late], series.altitude_m[late]
    expected_m = truth_at(times_us, reference_us, reference_m)
    found = errors(altitude_m, expected_m)
    if found is None:
        return Result(series.label, cost_us=series.cost_us)
    climb = errors(series.climb_mps[late], truth_at(times_us, reference_us, reference_climb))
    sd_m = series.sd_m[late]
    covered = coverage(altitude_m - expected_m, sd_m)
    protected = (
        protection(times_us * 1e-6, altitude_m - expected_m, series.level_m[late])
        if series.level_m is not None
        else None
    )
    against_baro = (
        errors(altitude_m, truth_at(times_us, baro.times_us, baro.altitude_m))
        if baro is not None
        else None
    )
    return Result(
        series.label,
        found.rmse_m,
        found.p95_m,
        found.max_m,
        found.bias_m,
        found.unbiased_rmse_m,
        _takeoff_rmse_m(series, reference_us, reference_m, start_us, takeoff),
        climb.rmse_m if climb is not None else math.nan,
        covered.nees,
        float(np.nanmedian(sd_m)) if np.isfinite(sd_m).any() else math.nan,
        against_baro.unbiased_rmse_m if against_baro is not None else math.nan,
        series.cost_us,
        covered.within_1,
        covered.within_2,
        covered.within_3,
        protected.median_level_m if protected is not None else math.nan,
        protected.exceedances if protected is not None else math.nan,
        protected.exceeded_share if protected is not None else math.nan,
    )


def _takeoff_rmse_m(
    series: Series, truth_us: Array, truth_m: Array, start_us: float, takeoff: tuple[float, float]
) -> float:
    """After take-off and the time to settle, against the truth's height above take-off."""
    takeoff_us, ground_m = takeoff
    flown = series.times_us >= takeoff_us
    if not flown.any():
        return math.nan
    own, altitude_m = series.takeoff_m, series.altitude_m
    if own is None or not np.isfinite(own).any():
        then_m = float(np.interp(takeoff_us, truth_us, truth_m))
        own = altitude_m - altitude_m[flown][0] + then_m - ground_m
    late = flown & (series.times_us >= start_us)
    found = errors(own[late], truth_at(series.times_us[late], truth_us, truth_m) - ground_m)
    return found.rmse_m if found is not None else math.nan


def _reboots(log: SampleLog, kinds: Any, rows: Any) -> Any:
    """Whether each entry of the order is a STATUS row that reports a reboot."""
    reboot = np.asarray(log[Kind.STATUS]["reboot"])
    flags = np.zeros(kinds.size, bool)
    status = kinds == Kind.STATUS
    flags[status] = reboot[rows[status]] == 1
    return flags


def _floats(values: Any) -> Array:
    return np.asarray(values, np.float64)
