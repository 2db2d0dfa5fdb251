"""Noise parameters of an estimator by maximum likelihood of its innovations, cross-validated over
logs.

Every estimator with ``Method.tunable`` counts the log-likelihood of its innovations in its state
(`companion.estimators.judging.score`); `companion.evaluation.noise_search` finds the most likely
values. Each part (a session, or half of one when there is only one) is also judged with the values
that the others give; unless the parts become more likely in sum, the tuning is refused. Source:
Abbeel et al., Discriminative training of Kalman filters, 2005.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from companion import __version__
from companion.config import Settings
from companion.errors import ConfigError, LogFormatError
from companion.estimators import ESTIMATORS
from companion.evaluation.compare import compare_log
from companion.evaluation.noise_search import (
    Likelihood,
    Part,
    observable,
    search,
    total,
    with_values,
)
from companion.evaluation.samples import Sampler, Tap
from companion.logs import open_log
from companion.replay.sessions import sessions_of
from companion.samples import SampleLog
from companion.settings import CompanionSettings

MOST_FOLDS = 5
LEAST_INNOVATIONS = 100.0


@dataclass(frozen=True)
class Change:
    """A key before and after."""

    key: str
    before: float
    after: float
    factor_sd: float
    """standard deviation of `after` as a factor; infinite where only one side is known"""


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
            side = "at most" if each.after < each.before else "at least"
            known = f"{each.factor_sd:.3f}" if math.isfinite(each.factor_sd) else side
            lines.append(f"{each.key:30s}{each.before:12.4g}{each.after:12.4g}   {known}")
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
    likelihood = Likelihood(method, section, on_progress)
    parts = _usable(likelihood, logs, f"{paths[0]}: {estimator}")
    found, factor_sd, kept = observable(likelihood, parts)
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
    sums = [total(likelihood, parts, values) for values in ({}, found)]
    after = with_values(section, found)
    return Tuned(
        estimator,
        [Change(key, getattr(section, key), value, factor_sd[key]) for key, value in found.items()],
        kept,
        sums[0][1],
        (sums[0][0] / sums[0][1], sums[1][0] / sums[1][1]),
        held,
        _errors(logs, settings, estimator, after),
        len(parts),
    )


def _usable(likelihood: "Likelihood", logs: Sequence[SampleLog], name: str) -> list[Part]:
    """The logs as parts with innovations enough; a single one in two halves."""
    parts = [part for part in _parts(logs) if likelihood.of({}, part)[1] >= LEAST_INNOVATIONS]
    if not parts:
        least = f"fewer than {LEAST_INNOVATIONS:.0f} innovations"
        raise LogFormatError(f"{name} has {least}: nothing to tune on")
    return _halves(parts) if len(parts) == 1 else parts


def _parts(logs: Sequence[SampleLog]) -> list[Part]:
    return [Part(log, 0, len(log)) for log in logs if len(log)]


def _halves(parts: Sequence[Part]) -> list[Part]:
    log, middle = parts[0].log, len(parts[0].log) // 2
    return [Part(log, 0, middle), Part(log, middle, len(log))]


def _held_out(
    likelihood: Likelihood, parts: Sequence[Part], keys: Sequence[str]
) -> tuple[float, float]:
    """Log-likelihood of an innovation of parts that were left out, before and after."""
    folds = min(len(parts), MOST_FOLDS)
    before = after = count = 0.0
    for fold in range(folds):
        left_out = list(parts[fold::folds])
        others = [part for k in range(folds) if k != fold for part in parts[k::folds]]
        values = search(likelihood, others, keys)
        told, number = total(likelihood, left_out, {})
        before, count = before + told, count + number
        after += total(likelihood, left_out, values)[0]
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
