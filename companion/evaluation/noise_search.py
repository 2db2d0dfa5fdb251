"""Search for the noise parameters under which the innovations of logs are most likely.

The keys are searched in their logarithms by L-BFGS-B with finite differences (`scipy.optimize`),
within a factor of `WIDEST`. The key that helps most is moved first, then the others with it, until
none helps by `LEAST_DROP` of the log-likelihood when it is doubled or halved. A key that runs to
the bound, and one of two keys that can be traded for each other (whose standard deviation is a
factor of more than `FACTOR`), keep their value, with the reason.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from companion.config import Settings
from companion.estimators import Method
from companion.estimators.judging import IGNORED
from companion.samples import ESTIMATE, SampleLog, rows

WIDEST = 30.0
LEAST_DROP = 2.0
"""of the log-likelihood: two standard deviations of a Gaussian"""
FACTOR = 2.0
MOST_ITERATIONS = 25
DIFFERENCE = 0.05
"""of a logarithm: the likelihood is not smooth where a gate opens"""
RELATIVE = 1e-5
"""improvement at which the search ends, as a share of the likelihood"""


class Part(NamedTuple):
    """A stretch of a log that is judged as a whole."""

    log: SampleLog
    first: int
    end: int
    """its entries of ``log.tables.order``; the estimator begins with the log in any case"""


class Likelihood:
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
        params = with_values(self.section, values).params()  # type: ignore[attr-defined]
        before = self._run(params, part.log, part.first) if part.first else (0.0, 0.0)
        whole = self._run(params, part.log, part.end)
        return whole[0] - before[0], whole[1] - before[1]

    def _run(self, params: object, log: SampleLog, end: int) -> tuple[float, float]:
        state = self._method.init(params)  # type: ignore[arg-type]
        tables = log.tables._replace(order=log.tables.order[:end])
        verdicts = np.full(end, IGNORED, np.int64)
        self._method.run(state, params, tables, rows(ESTIMATE, end), verdicts)
        return float(state[0]["log_likelihood"]), float(state[0]["innovations"])


def with_values(section: Settings, values: Mapping[str, float]) -> Settings:
    """A section with other values of some keys."""
    return section.model_copy(update=dict(values))


def total(
    likelihood: Likelihood, parts: Sequence[Part], values: Mapping[str, float]
) -> tuple[float, float]:
    """(log-likelihood, number of innovations) of all parts."""
    told = [likelihood.of(values, part) for part in parts]
    return math.fsum(value for value, _ in told), math.fsum(count for _, count in told)


def search(
    likelihood: Likelihood,
    parts: Sequence[Part],
    keys: Sequence[str],
    begin: Mapping[str, float] | None = None,
) -> dict[str, float]:
    """The values of `keys` under which the parts are most likely, from `begin` on."""
    from scipy.optimize import minimize

    own = {key: math.log(getattr(likelihood.section, key)) for key in keys}
    start = np.array([math.log((begin or {}).get(key, math.exp(own[key]))) for key in keys])
    scale = max(1.0, abs(total(likelihood, parts, {})[0]))
    found = minimize(
        lambda x: -total(likelihood, parts, dict(zip(keys, np.exp(x), strict=True)))[0] / scale,
        start,
        method="L-BFGS-B",
        bounds=[(x - math.log(WIDEST), x + math.log(WIDEST)) for x in own.values()],
        options={"eps": DIFFERENCE, "maxiter": MOST_ITERATIONS, "ftol": RELATIVE},
    )
    return {key: float(value) for key, value in zip(keys, np.exp(found.x), strict=True)}


class Shown(NamedTuple):
    """What the parts show."""

    values: dict[str, float]
    factor_sd: dict[str, float]
    """infinite where only one side is known: a value of half or twice is as likely"""
    kept: dict[str, str]
    """why the other keys keep their value"""


def observable(likelihood: Likelihood, parts: Sequence[Part]) -> Shown:
    """The keys that the parts show: the one that helps most first, until none helps."""
    kept = dict.fromkeys(likelihood.keys, NOT_SHOWN)
    free = [key for key in likelihood.keys if getattr(likelihood.section, key) > 0]
    values: dict[str, float] = {}
    for _ in range(2 * len(free)):  # a key may be moved again once others have moved
        gains = {key: _gain(likelihood, parts, values, key) for key in free}
        best = max(gains, key=lambda key: gains[key][0], default=None)
        if best is None or gains[best][0] < LEAST_DROP:
            break
        begin = values | {best: gains[best][1]}
        values = search(likelihood, parts, list(begin), begin)
        for key in [key for key in values if not _is_inside(likelihood.section, key, values[key])]:
            kept[key] = _bound_reason(likelihood.section, key, values.pop(key))
            free.remove(key)
    while values:
        sd = _log_sd(likelihood, parts, values)
        here = total(likelihood, parts, values)[0]
        less = [
            key
            for key in values
            if here - total(likelihood, parts, _without(values, key))[0] < LEAST_DROP
        ]
        traded = [key for key in values if math.log(FACTOR) < sd[key] < math.inf]
        if not less and not traded:
            break
        key = less[0] if less else max(traded, key=sd.__getitem__)
        others = _without(values, key)
        kept[key] = NOT_SHOWN if less else f"it cannot be told from {', '.join(others)}"
        values = search(likelihood, parts, list(others), others) if others else {}
    for key in values:
        del kept[key]
    return Shown(values, {key: math.exp(sd[key]) for key in values}, kept)


def _without(values: Mapping[str, float], key: str) -> dict[str, float]:
    return {each: value for each, value in values.items() if each != key}


NOT_SHOWN = f"twice and half are no more likely by {LEAST_DROP:g}"


def _gain(
    likelihood: Likelihood, parts: Sequence[Part], values: Mapping[str, float], key: str
) -> tuple[float, float]:
    """By how much the log-likelihood grows when a key is doubled or halved, and that value."""
    value, drops = _value(likelihood, values, key), _drops(likelihood, parts, values, key)
    up = drops[0] < drops[1]
    return -min(drops), value * (FACTOR if up else 1.0 / FACTOR)


def _value(likelihood: Likelihood, values: Mapping[str, float], key: str) -> float:
    return float(values.get(key, getattr(likelihood.section, key)))


def _bound_reason(section: Settings, key: str, value: float) -> str:
    less = value < getattr(section, key)
    return f"it runs to {'1/' if less else ''}{WIDEST:g} of its value: " + (
        "the other noise explains the innovations already" if less else "no value explains them"
    )


def _log_sd(
    likelihood: Likelihood, parts: Sequence[Part], values: Mapping[str, float]
) -> dict[str, float]:
    """Standard deviations of the logarithms of the keys, by the curvature of the likelihood; what
    two keys may trade is in them. Infinite where half or twice of the value is as likely."""
    size = 0.5 * math.log(FACTOR)

    def at(*moves: tuple[str, int]) -> float:
        moved = dict(values)
        for key, sign in moves:
            moved[key] *= math.exp(sign * size)
        return total(likelihood, parts, moved)[0]

    keys = [key for key in values if min(_drops(likelihood, parts, values, key)) >= LEAST_DROP]
    here, curvature = at(), np.zeros((len(keys), len(keys)))
    for i, one in enumerate(keys):
        curvature[i, i] = max(1e-9, 2.0 * here - at((one, 1)) - at((one, -1)))
        for j, other in enumerate(keys[:i]):
            both = at((one, 1), (other, 1)) + at((one, -1), (other, -1))
            across = at((one, 1), (other, -1)) + at((one, -1), (other, 1))
            curvature[i, j] = curvature[j, i] = 0.25 * (across - both)
    floor = 1e-6 * np.max(np.diag(curvature), initial=1e-9)
    lengths, axes = np.linalg.eigh(curvature)
    variances = np.square(axes) @ (1.0 / np.maximum(lengths, floor))
    sd = dict(zip(keys, (size * np.sqrt(variances)).tolist(), strict=True))
    return {key: sd.get(key, math.inf) for key in values}


def _is_inside(section: Settings, key: str, value: float) -> bool:
    """Whether a value is not at the bound of the search."""
    return abs(math.log(value / getattr(section, key))) < 0.99 * math.log(WIDEST)


def _drops(
    likelihood: Likelihood, parts: Sequence[Part], values: Mapping[str, float], key: str
) -> tuple[float, float]:
    """By how much the log-likelihood falls when a key is doubled, and when it is halved."""
    here = total(likelihood, parts, values)[0]
    value = values.get(key, getattr(likelihood.section, key))
    up, down = (
        here - total(likelihood, parts, {**values, key: value * factor})[0]
        for factor in (FACTOR, 1.0 / FACTOR)
    )
    return up, down
