"""Selects the primary sensor of a kind: estimators without redundancy use that one only.

It is instance 0, unless another instance has a value before instance 0 ever had one: a barometer
that sends 0 Pa, a receiver without a fix, or a sensor that is not heard for two seconds. The two
then change their numbers, until the vehicle restarts.
"""

import logging
import math

from companion.samples import Kind, Rows

logger = logging.getLogger("kollsman.intake")

WAIT_US = 2_000_000
LEAST_PA = 100.0


class Primary:
    """The primary sensor of one kind."""

    def __init__(self, kind: Kind) -> None:
        self._kind = kind
        self._first: int | None = None
        self._zero_heard = False
        self._since_us: int | None = None

    def number(self, row: Rows) -> None:
        """Give a row, shape (1,), the number of its sensor among its kind."""
        instance, time_us = int(row["instance"][0]), int(row["time_us"][0])
        if self._first is None and self._works(row):
            self._since_us = time_us if self._since_us is None else self._since_us
            if instance == 0 or self._zero_heard or time_us - self._since_us >= WAIT_US:
                self._first = instance
                if instance:
                    logger.warning(
                        "%s 1 has no value: number %d is used", self._name(), instance + 1
                    )
        self._zero_heard |= instance == 0
        if self._first and instance in (0, self._first):
            row["instance"] = self._first - instance

    def _works(self, row: Rows) -> bool:
        if self._kind is Kind.GNSS:
            value = row[0]
            return bool(value["fix_type"] >= 3 and math.isfinite(value["altitude_amsl_m"]))
        return bool(row[0]["pressure_pa"] > LEAST_PA)

    def _name(self) -> str:
        return "GNSS receiver" if self._kind is Kind.GNSS else "barometer"
