"""Expectations of an altitude, for tests of a vehicle: ``max<10``, ``nees<2``; exit code and JUnit.

An expectation holds for every session (flight) or it is not met. What is not known (``nees`` of a
log without truth) is not met either: a test that cannot tell must not pass.
"""

import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from companion.errors import ConfigError

EXIT_WRONG = 3
"""the exit code of a command whose expectations are not met"""
METRICS = {
    "max": ("max_m", "largest |difference|, m"),
    "p95": ("p95_m", "95 % of |differences|, m"),
    "rmse": ("rmse_m", "root mean square, m"),
    "bias": ("bias_m", "|mean|, m"),
    "unbiased": ("unbiased_rmse_m", "root mean square without the mean, m"),
    "nees": ("nees", "mean of (error / sd)^2; needs truth"),
}
"""name -> (key of a source in the report schema, meaning)"""
_FORM = re.compile(r"\s*(\w+)\s*(<=|<|>=|>)\s*([-+.\deE]+)\s*")
_COMPARE: dict[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


@dataclass(frozen=True)
class Expectation:
    """One condition on the figures of an altitude."""

    metric: str
    relation: str
    limit: float

    def __str__(self) -> str:
        return f"{self.metric}{self.relation}{self.limit:g}"


@dataclass(frozen=True)
class Outcome:
    """An expectation held against one session or flight."""

    where: str
    expectation: Expectation
    value: float
    """NaN when it is not known"""

    @property
    def met(self) -> bool:
        relation = _COMPARE[self.expectation.relation]
        return math.isfinite(self.value) and relation(self.value, self.expectation.limit)

    def __str__(self) -> str:
        known = f"{self.value:.3g}" if math.isfinite(self.value) else "unknown"
        state = "met" if self.met else "NOT met"
        return f"{self.where}: {self.expectation} {state}: {self.expectation.metric} is {known}"

    def as_dict(self) -> dict[str, Any]:
        value = self.value if math.isfinite(self.value) else None
        where = {"where": self.where, "expectation": str(self.expectation)}
        return where | {"value": value, "met": self.met}


def parse(texts: Sequence[str]) -> list[Expectation]:
    """Expectations from texts such as ``max<10``. Raises `ConfigError`."""
    found = []
    for text in texts:
        match = _FORM.fullmatch(text)
        if match is None or match[1] not in METRICS:
            known = ", ".join(f"{name} ({meaning})" for name, (_, meaning) in METRICS.items())
            raise ConfigError(
                f"--expect {text!r}: give a metric, < or >, and a number; metrics: {known}"
            )
        try:
            found.append(Expectation(match[1], match[2], float(match[3])))
        except ValueError:
            raise ConfigError(f"--expect {text!r}: {match[3]!r} is not a number") from None
    return found


def hold(
    where: str, expectations: Sequence[Expectation], figures: Mapping[str, Any] | None
) -> list[Outcome]:
    """Every expectation against the figures of one altitude (an object of ``sources``)."""
    outcomes = []
    for each in expectations:
        value = (figures or {}).get(METRICS[each.metric][0])
        number = math.nan if value is None else float(value)
        outcomes.append(Outcome(where, each, abs(number) if each.metric == "bias" else number))
    return outcomes


def hold_all(
    name: str, expectations: Sequence[Expectation], report: Mapping[str, Any]
) -> list[Outcome]:
    """Every expectation against the estimate of every session of a report."""
    return [
        outcome
        for session in report["sessions"]
        for outcome in hold(
            f"{name} session {session['session']}",
            expectations,
            session["sources"].get("estimate"),
        )
    ]


def write_junit(path: Path, name: str, outcomes: Sequence[Outcome]) -> None:
    """The outcomes as a JUnit file, a test case each. Raises `ConfigError` when it cannot be
    written."""
    failed = sum(not each.met for each in outcomes)
    counts = {"tests": str(len(outcomes)), "failures": str(failed)}
    suite = ElementTree.Element("testsuite", {"name": name, "errors": "0", **counts})
    for each in outcomes:
        attributes = {"classname": each.where, "name": str(each.expectation)}
        case = ElementTree.SubElement(suite, "testcase", attributes)
        if not each.met:
            ElementTree.SubElement(case, "failure", {"message": str(each)})
    try:
        ElementTree.ElementTree(suite).write(path, encoding="utf-8", xml_declaration=True)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from None
