"""Reads parameters one at a time, each until it is answered."""

from collections.abc import Sequence

ANSWER_US = 1_000_000
"""after this time without an answer a parameter is asked for (again)"""
ATTEMPTS = 5


class Questions:
    """The parameters to read, and what was answered."""

    def __init__(self, names: Sequence[str]) -> None:
        self.values: dict[str, float] = {}
        self._names = names
        self._name = ""
        self._attempts = 0
        self._asked_us = 0

    @property
    def missing(self) -> str:
        """The first parameter without an answer; empty when there is none."""
        return next((name for name in self._names if name not in self.values), "")

    @property
    def has_failed(self) -> bool:
        """Whether a parameter was asked for in vain."""
        return self._name == self.missing and self._attempts > ATTEMPTS

    def next(self, now_us: int) -> str:
        """The parameter to ask for now; empty when none is due."""
        if self.missing != self._name:
            self._name, self._attempts = self.missing, 0
        if not self._name or (self._attempts and now_us - self._asked_us < ANSWER_US):
            return ""
        self._attempts += 1
        self._asked_us = now_us
        return self._name if self._attempts <= ATTEMPTS else ""
