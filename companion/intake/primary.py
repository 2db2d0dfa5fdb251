"""Selects the primary sensor of a kind: estimators without redundancy use that one only.

It is instance 0, unless another instance has a value before instance 0 ever had one: a barometer
that sends 0 Pa, a receiver without a fix, or a sensor that is not heard for two seconds. The two
then change their numbers, until the vehicle restarts.
"""

import logging

from companion.intake import receiver_steps as steps
from companion.intake.receiver_steps import NONE_US, PRIMARY
from companion.samples import Kind, Rows, rows

logger = logging.getLogger("kollsman.intake")

NAMES = {Kind.GNSS: "GNSS receiver", Kind.PRESSURE: "barometer"}


class Primary:
    """The primary sensor of one kind."""

    def __init__(self, kind: Kind) -> None:
        self._kind = kind
        self.state: Rows = rows(PRIMARY)
        self.state["first"], self.state["since_us"] = -1, NONE_US

    def number(self, row: Rows) -> None:
        """Give a row, shape (1,), the number of its sensor among its kind."""
        is_gnss = self._kind is Kind.GNSS
        works = steps.fix_works(row) if is_gnss else steps.pressure_works(row)
        if steps.number(self.state, row, works):
            self.tell()

    def tell(self) -> None:
        """Log which other sensor is the primary one now."""
        name, number = NAMES[self._kind], int(self.state["first"][0]) + 1
        logger.warning("%s 1 has no value: number %d is used", name, number)
