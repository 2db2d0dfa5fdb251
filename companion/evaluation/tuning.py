"""Noise parameters of an estimator by maximum likelihood of its innovations, cross-validated over
logs.

Every estimator with ``Method.tunable`` counts the log-likelihood of its innovations in its state
(`companion.estimators.judging.score`). The keys are searched in their logarithms by L-BFGS-B with
finite differences (`scipy.optimize`), within a factor of `WIDEST`.

A key is observable when the likelihood falls by at least `LEAST_DROP` both when it is doubled and
when it is halved, at the optimum, and when its standard deviation, with what it may trade with the
other keys, is below `FACTOR`; others keep their value, with the reason. Each part (a session, or
half of one when there is only one) is also judged with the values that the others give; unless the
parts become more likely in sum, the tuning is refused. Source: Abbeel et al., Discriminative
training of Kalman filters, 2005.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from companion import __version__
from companion.config import Settings
from companion.errors import ConfigError, LogFormatError
from companion.estimators import ESTIMATORS, Method
from companion.estimators.judging import IGNORED
from companion.evaluation.compare import compare_log
from companion.evaluation.samples import Sampler, Tap
from companion.logs import open_log
from companion.replay.sessions import sessions_of
from companion.samples import ESTIMATE, SampleLog, rows
from companion.settings import CompanionSettings

WIDEST = 30.0
LEAST_DROP = 2.0
"""of the log-likelihood: two standard deviations of a Gaussian"""
FACTOR = 2.0
MOST_FOLDS = 5
MOST_ITERATIONS = 25
DIFFERENCE = 0.05
"""of a logarithm: the likelihood is not smooth where a gate opens"""
LEAST_INNOVATIONS = 100.0
RELATIVE = 1e-5
"""improvement at which the search ends, as a share of the likelihood"""


class Part(NamedTuple):
    """A stretch of a log that is judged as a whole."""

    log: SampleLog
    first: int
    end: int
    """its entries of ``log.tables.order``; the estimator begins with the log in any case"""


@dataclass(frozen=True)
class Change:
    """A key before and after."""

    key: str
    before: float
    after: float
    factor_sd: float
    """standard deviation of `after` as a factor"""


@dataclass(frozen=True)
class Tuned:
    """Values found, and what they are worth."""

    estimator: str
    changes: list[Change]
    kept: dict[str, str]
    """keys that the logs do not show, and why"""
    innovations: float
    likelihood: tuple[float, float]
    """log-likelihood of an innovation, before and after"""
    held_out: tuple[float, float]
    """the same on parts that were left out of the search"""
    rmse_m: list[tuple[str, float, float]]
    """(reference, before, after) of each session"""
    parts: int

    def table(self) -> str:
        """For a terminal."""
        lines = [f"{'key':30s}{'before':>12s}{'after':>12s}   factor sd"]
        for each in self.changes:
            lines.append(
                f"{each.key:30s}{each.before:12.4g}{each.after:12.4g}   {each.factor_sd:.3f}"
            )
        lines += [f"{key:30s} kept: {reason}" for key, reason in self.kept.items()]
        lines += ["", *self.figures()]
        return "\n".join(lines)

    def figures(self) -> list[str]:
        """What changes, in lines."""
        lines = [
            f"{self.innovations:.0f} innovations in {self.parts} parts",
            "log-likelihood of an innovation: {:.4f} before, {:.4f} after".format(*self.likelihood),
            "on parts left out of the search: {:.4f} before, {:.4f} after".format(*self.held_out),
        ]
        for number, (reference, before_m, after_m) in enumerate(self.rmse_m, 1):
            where = f"session {number}, RMSE to {reference}"
            lines.append(f"{where}: {before_m:.2f} m before, {after_m:.2f} m after")
        return lines

    def snippet(self) -> str:
        """Lines for companion.yaml."""
        lines = [
            f"# {self.estimator}: maximum likelihood of the innovations, kollsman {__version__}",
            *(f"# {line}" for line in self.figures()),
            f"estimator: {self.estimator}",
            "estimators:",
            f"  {self.estimator}:",
        ]
        lines += [
            f"    {each.key}: {each.after:.4g}  # {each.before:.4g} before" for each in self.changes
        ]
        return "\n".join(lines) + "\n"


def tune(
    paths: Sequence[Path],
    estimator: str,
    settings: CompanionSettings | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> Tuned:
    """Tune an estimator on every session of the logs.

    Raises `ConfigError` for an estimator that cannot be tuned, `LogFormatError` for logs that
    cannot be read, or that do not show any of its keys, or from which nothing is learned for
    others.
    """
    method, settings = ESTIMATORS[estimator], settings or CompanionSettings()
    if not method.tunable:
        known = ", ".join(name for name, each in ESTIMATORS.items() if each.tunable or each.tune)
        raise ConfigError(f"{estimator!r} has no noise parameters to tune; these have: {known}")
    logs = [
        each.seen.log
        for path in paths
        for each in sessions_of(open_log(path), settings, lambda _: Tap(), Sampler)
    ]
    section = settings.section(estimator)
    likelihood = _Likelihood(method, section, on_progress)
    parts = _usable(likelihood, logs, f"{paths[0]}: {estimator}")
    found, spread, kept = _observable(likelihood, parts)
    if not found:
        reasons = "; ".join(f"{key}: {reason}" for key, reason in kept.items())
        raise LogFormatError(f"the logs show no noise parameter of {estimator}: {reasons}")
    held = _held_out(likelihood, parts, list(found))
    if held[1] <= held[0]:
        raise LogFormatError(
            "refused: with values from the other parts, a part of the logs becomes less likely "
            f"({held[0]:.4f} before, {held[1]:.4f} after, an innovation): the logs differ too "
            "much, or are too few"
        )
    total = [_sum(likelihood, parts, values) for values in ({}, found)]
    after = _with(section, found)
    return Tuned(
        estimator,
        [Change(key, getattr(section, key), value, spread[key]) for key, value in found.items()],
        kept,
        total[0][1],
        (total[0][0] / total[0][1], total[1][0] / total[1][1]),
        held,
        _errors(logs, settings, estimator, after),
        len(parts),
    )


def _usable(likelihood: "_Likelihood", logs: Sequence[SampleLog], name: str) -> list[Part]:
    """The logs as parts with innovations enough; a single one in two halves."""
    parts = [part for part in _parts(logs) if likelihood.of({}, part)[1] >= LEAST_INNOVATIONS]
    if not parts:
        least = f"fewer than {LEAST_INNOVATIONS:.0f} innovations"
        raise LogFormatError(f"{name} has {least}: nothing to tune on")
    return _halves(parts) if len(parts) == 1 else parts


class _Likelihood:
    """The log-likelihood of the innovations under other values of the keys."""

    def __init__(
        self, method: Method, section: Settings, on_progress: Callable[[float], None] | None
    ) -> None:
        self.keys = method.tunable
        self.section = section
        self._method, self._on_progress = method, on_progress
        self._count = 0

    def of(self, values: Mapping[str, float], part: Part) -> tuple[float, float]:
        """(log-likelihood, number of innovations) of a part."""
        self._count += 1
        if self._on_progress is not None:
            self._on_progress(1.0 - math.exp(-self._count / 300.0))
        params = _with(self.section, values).params()  # type: ignore[attr-defined]
        before = self._run(params, part.log, part.first) if part.first else (0.0, 0.0)
        whole = self._run(params, part.log, part.end)
        return whole[0] - before[0], whole[1] - before[1]

    def _run(self, params: object, log: SampleLog, end: int) -> tuple[float, float]:
        state = self._method.init(params)  # type: ignore[arg-type]
        tables = log.tables._replace(order=log.tables.order[:end])
        verdicts = np.full(end, IGNORED, np.int64)
        self._method.run(state, params, tables, rows(ESTIMATE, end), verdicts)
        return float(state[0]["log_likelihood"]), float(state[0]["innovations"])


def _with(section: Settings, values: Mapping[str, float]) -> Settings:
    return section.model_copy(update=dict(values))


def _parts(logs: Sequence[SampleLog]) -> list[Part]:
    return [Part(log, 0, len(log)) for log in logs if len(log)]


def _halves(parts: Sequence[Part]) -> list[Part]:
    log, middle = parts[0].log, len(parts[0].log) // 2
    return [Part(log, 0, middle), Part(log, middle, len(log))]


def _sum(
    likelihood: _Likelihood, parts: Sequence[Part], values: Mapping[str, float]
) -> tuple[float, float]:
    told = [likelihood.of(values, part) for part in parts]
    return math.fsum(value for value, _ in told), math.fsum(count for _, count in told)


def _search(
    likelihood: _Likelihood, parts: Sequence[Part], keys: Sequence[str]
) -> dict[str, float]:
    """The values of `keys` under which the parts are most likely."""
    from scipy.optimize import minimize

    start = np.log([float(getattr(likelihood.section, key)) for key in keys])
    scale = max(1.0, abs(_sum(likelihood, parts, {})[0]))
    found = minimize(
        lambda x: -_sum(likelihood, parts, dict(zip(keys, np.exp(x), strict=True)))[0] / scale,
        start,
        method="L-BFGS-B",
        bounds=[(x - math.log(WIDEST), x + math.log(WIDEST)) for x in start],
        options={"eps": DIFFERENCE, "maxiter": MOST_ITERATIONS, "ftol": RELATIVE},
    )
    return {key: float(value) for key, value in zip(keys, np.exp(found.x), strict=True)}


def _observable(
    likelihood: _Likelihood, parts: Sequence[Part]
) -> tuple[dict[str, float], dict[str, float], dict[str, str]]:
    """Values of the keys that the parts show, their standard deviations as factors, and why the
    others are left out.

    Keys that run to the bound are left out first, then the one that shows least, until all show.
    """
    kept = dict.fromkeys(likelihood.keys, NOT_SHOWN)
    keys = [key for key in likelihood.keys if getattr(likelihood.section, key) > 0]
    keys = [key for key in keys if max(map(abs, _drops(likelihood, parts, {}, key))) >= LEAST_DROP]
    while keys:
        values = _search(likelihood, parts, keys)
        outside = [key for key in keys if not _is_inside(likelihood.section, key, values[key])]
        if outside:
            kept |= {key: _bound_reason(likelihood.section, key, values[key]) for key in outside}
            keys = [key for key in keys if key not in outside]
            continue
        drops = {key: min(_drops(likelihood, parts, values, key)) for key in keys}
        weakest = min(drops, key=drops.__getitem__)
        if drops[weakest] >= LEAST_DROP:
            sd = _log_sd(likelihood, parts, values)
            weakest = max(sd, key=sd.__getitem__)
            if sd[weakest] <= math.log(FACTOR):
                spread = {key: math.exp(value) for key, value in sd.items()}
                return values, spread, {key: kept[key] for key in kept if key not in keys}
            others = ", ".join(key for key in keys if key != weakest)
            kept[weakest] = f"it cannot be told from {others}"
        keys = [key for key in keys if key != weakest]
    return {}, {}, kept


NOT_SHOWN = f"the likelihood falls by less than {LEAST_DROP:g} when it is doubled or halved"


def _bound_reason(section: Settings, key: str, value: float) -> str:
    less = value < getattr(section, key)
    return f"it runs to {'1/' if less else ''}{WIDEST:g} of its value: " + (
        "the other noise explains the innovations already" if less else "no value explains them"
    )


def _log_sd(
    likelihood: _Likelihood, parts: Sequence[Part], values: Mapping[str, float]
) -> dict[str, float]:
    """Standard deviations of the logarithms of the keys, by the curvature of the likelihood; what
    two keys may trade is in them. Infinite where it does not fall in some direction."""
    keys, size = list(values), 0.5 * math.log(FACTOR)

    def at(*moves: tuple[str, int]) -> float:
        moved = dict(values)
        for key, sign in moves:
            moved[key] *= math.exp(sign * size)
        return _sum(likelihood, parts, moved)[0]

    here, curvature = at(), np.zeros((len(keys), len(keys)))
    for i, one in enumerate(keys):
        curvature[i, i] = 2.0 * here - at((one, 1)) - at((one, -1))
        for j, other in enumerate(keys[:i]):
            both = at((one, 1), (other, 1)) + at((one, -1), (other, -1))
            across = at((one, 1), (other, -1)) + at((one, -1), (other, 1))
            curvature[i, j] = curvature[j, i] = 0.25 * (across - both)
    if np.linalg.eigvalsh(curvature).min() <= 0.0:
        least = keys[int(np.argmin(np.diag(curvature)))]
        return {key: math.inf if key == least else 0.0 for key in keys}
    sd = size * np.sqrt(np.diag(np.linalg.inv(curvature)))
    return dict(zip(keys, sd.tolist(), strict=True))


def _is_inside(section: Settings, key: str, value: float) -> bool:
    """Whether a value is not at the bound of the search."""
    return abs(math.log(value / getattr(section, key))) < 0.99 * math.log(WIDEST)


def _drops(
    likelihood: _Likelihood, parts: Sequence[Part], values: Mapping[str, float], key: str
) -> tuple[float, float]:
    """By how much the log-likelihood falls when a key is doubled, and when it is halved."""
    here = _sum(likelihood, parts, values)[0]
    value = values.get(key, getattr(likelihood.section, key))
    up, down = (
        here - _sum(likelihood, parts, {**values, key: value * factor})[0]
        for factor in (FACTOR, 1.0 / FACTOR)
    )
    return up, down


def _held_out(
    likelihood: _Likelihood, parts: Sequence[Part], keys: Sequence[str]
) -> tuple[float, float]:
    """Log-likelihood of an innovation of parts that were left out, before and after."""
    folds = min(len(parts), MOST_FOLDS)
    before = after = count = 0.0
    for fold in range(folds):
        left_out = list(parts[fold::folds])
        others = [part for k in range(folds) if k != fold for part in parts[k::folds]]
        values = _search(likelihood, others, keys)
        told, number = _sum(likelihood, left_out, {})
        before, count = before + told, count + number
        after += _sum(likelihood, left_out, values)[0]
    return before / count, after / count


def _errors(
    logs: Sequence[SampleLog], settings: CompanionSettings, estimator: str, after: Settings
) -> list[tuple[str, float, float]]:
    """RMSE of each session to its reference, before and after."""
    name = estimator.replace("-", "_")
    sections = settings.estimators.model_copy(update={name: after})
    changed = settings.model_copy(update={"estimators": sections})
    found = []
    for log in logs:
        first, second = (
            compare_log(log, each, estimators=(estimator,)) for each in (settings, changed)
        )
        if first.reference != "nothing":
            found.append((first.reference, first.results[0].rmse_m, second.results[0].rmse_m))
    return found
