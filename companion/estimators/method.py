"""What every estimator shares: the description of a method, the intake of a sample, and the live
filter.

An estimator is a pure step over a typed state. State and parameters are one-element structured
arrays; each step

    on_pressure(state, params, sample, estimate) -> verdict

reads one sample, updates the state, writes the estimate and returns a `Verdict`. Live calls a step
for each message; `run`, a compiled loop at the end of each estimator's module, does the same over
the tables of a `SampleLog`.
"""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.config import Settings
from companion.estimators.judging import IGNORED, ignore
from companion.samples import ESTIMATE, Kind, Rows, SampleLog, Verdict, readable, rows

Step = Callable[[Rows, Rows, Rows, Rows], int]


@dataclass(frozen=True)
class Method:
    """An estimator: what it is called, what it uses, how it behaves, and its compiled parts."""

    name: str
    summary: str
    citation: str
    settings: type[Settings]
    """pydantic model with the defaults and a method ``params() -> Rows``"""
    state: np.dtype[Any]
    init: Callable[[Rows], Rows]
    """params -> a fresh state"""
    steps: Mapping[Kind, Step]
    """a kind that is missing here is IGNORED"""
    run: Callable[..., None]
    """run(state, params, tables, estimates, verdicts): the steps over a whole log"""
    datum_invariant: bool
    """the same flight one kilometre higher gives the same errors"""
    follows_baro_step: bool
    """after a lasting step of the barometer the altitude comes back to GNSS: the step is learned,
    not kept"""
    version: int = 1
    """version of the state's meaning; a checkpoint of another version is refused"""
    tune: Callable[..., Any] | None = None
    """tune(log, settings, seed, generations, on_progress): gains from a flight; None when it has no
    such search"""
    tunable: tuple[str, ...] = ()
    """noise parameters (keys of the settings) on which the likelihood of the innovations depends"""
    optional: frozenset[Kind] = frozenset()
    """kinds with a step that are IGNORED unless the settings ask for them"""

    @property
    def uses(self) -> frozenset[Kind]:
        """The kinds that it uses as it comes."""
        return frozenset(self.steps) - self.optional


_VERDICTS = tuple(Verdict)


class Filter:
    """One running estimator: a method, its parameters, its state and its latest estimate."""

    def __init__(self, method: Method, settings: Settings | None = None) -> None:
        self.method = method
        self.settings = settings if settings is not None else method.settings()
        self.params: Rows = self.settings.params()  # type: ignore[attr-defined]
        self.state = method.init(self.params)
        self.estimate = rows(ESTIMATE)
        self._steps: list[Step] = [method.steps.get(kind, ignore) for kind in Kind]

    def step(self, kind: Kind, sample: Rows) -> Verdict:
        """Take in one sample (a one-element array of its kind's dtype)."""
        return _VERDICTS[self._steps[kind](self.state, self.params, sample, self.estimate)]

    @property
    def is_valid(self) -> bool:
        """Whether there is an altitude at all."""
        return math.isfinite(self.estimate["altitude_amsl_m"][0])

    def checkpoint(self) -> bytes:
        """State and estimate as bytes that `restore` takes back, bit for bit."""
        head = json.dumps(self._fingerprint()).encode()
        return (
            len(head).to_bytes(4, "little") + head + self.state.tobytes() + self.estimate.tobytes()
        )

    def restore(self, data: bytes) -> None:
        """Continue from a `checkpoint` of the same method and version.

        Raises
        ------
        ValueError
            The checkpoint is of another method, version or layout.
        """
        size = int.from_bytes(data[:4], "little")
        if data[4 : 4 + size] != json.dumps(self._fingerprint()).encode():
            raise ValueError(
                f"this checkpoint is not one of {self.method.name} version {self.method.version}"
            )
        body = data[4 + size :]
        if len(body) != self.state.nbytes + self.estimate.nbytes:
            raise ValueError("this checkpoint is cut")
        self.state = readable(np.frombuffer(body[: self.state.nbytes], self.method.state).copy())
        self.estimate = readable(np.frombuffer(body[self.state.nbytes :], ESTIMATE).copy())

    def _fingerprint(self) -> list[Any]:
        return [self.method.name, self.method.version, repr(self.method.state), repr(ESTIMATE)]


def run_log(
    method: Method, log: SampleLog, settings: Settings | None = None
) -> tuple[Rows, Rows, Rows]:
    """The compiled loop over a whole log.

    Returns
    -------
    estimates : ESTIMATE rows, shape (len(log),), after each sample in order of arrival
    verdicts : int array, shape (len(log),)
    state : the final state, shape (1,)
    """
    params: Rows = (settings if settings is not None else method.settings()).params()  # type: ignore[attr-defined]
    state = method.init(params)
    estimates = rows(ESTIMATE, len(log))
    verdicts = np.full(len(log), IGNORED, np.int64)
    method.run(state, params, log.tables, estimates, verdicts)
    return estimates, verdicts, state
