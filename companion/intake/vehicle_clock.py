"""The vehicle's boot clock: reboots, gaps, wrapped and foreign stamps."""

import logging
from enum import StrEnum

from companion.intake import clock_steps as steps
from companion.intake.clock_steps import CLOCK, CLOCK_PARAMS, NONE_US, WRAP_MS
from companion.intake.settings import IntakeSettings
from companion.mavlink.convert import Reading, TimeBase
from companion.samples import Rows, rows

__all__ = ["WRAP_MS", "Clockwork", "VehicleClock"]

logger = logging.getLogger("kollsman.intake")

BASES = {TimeBase.BOOT: steps.BOOT, TimeBase.EITHER: steps.EITHER, TimeBase.NONE: steps.NO_STAMP}


class Clockwork(StrEnum):
    """Effect of a time stamp on the vehicle's clock."""

    TICK = "tick"
    DOUBT = "doubt"
    REBOOT = "reboot"


EFFECTS = (Clockwork.TICK, Clockwork.DOUBT, Clockwork.REBOOT)
"""by `clock_steps.TICK` and its neighbours"""


class VehicleClock:
    """The vehicle's boot clock, from its time stamps.

    A discontinuity needs a second stamp that agrees with the first. Forwards it is a gap in what we
    heard, or another session when the recorder's clock says that hours passed; backwards by more
    than `late_s` it is a reboot. Less is a late copy over a second path: it keeps its time. Only
    stamps that surely count from boot move the clock; the others may run ahead of them, but not
    away: after a gap they wait up to a second for one. A stamp of 0, or in the wrong unit, is none.
    """

    def __init__(self, settings: IntakeSettings) -> None:
        self.state: Rows = rows(CLOCK)
        self.params: Rows = rows(CLOCK_PARAMS)
        for name in ("reorder", "gap", "late"):
            self.params[f"{name}_us"] = round(getattr(settings, f"{name}_s") * 1e6)
        self._wrong_units = 0
        steps.begin(self.state)

    @property
    def now_us(self) -> int:
        """The newest boot time; -1 before the first."""
        return int(self.state["now_us"][0])

    @property
    def reboots(self) -> int:
        """How often the clock restarted."""
        return int(self.state["reboots"][0])

    def place(self, reading: Reading, source: int, arrival_us: int = 0) -> tuple[Clockwork, int]:
        """What `reading`'s stamp does to the clock, and its time. `source` tells messages with own
        clocks apart; `arrival_us` is the host's or recorder's clock."""
        stamp_us = min(reading.stamp_us, steps.LARGEST_STAMP_US)
        effect, time_us = steps.place(
            self.state, self.params, BASES[reading.base], stamp_us, source, arrival_us
        )
        self.tell()
        return EFFECTS[effect], time_us

    def tick(self, time_us: int, arrival_us: int = 0) -> tuple[Clockwork, int]:
        """Take a boot time as heard."""
        effect, time_us = steps.tick(self.state, self.params, time_us, arrival_us)
        return EFFECTS[effect], time_us

    def note_unix(self, unix_us: int, boot_us: int) -> None:
        """SYSTEM_TIME: what to take from stamps that count from 1970; 0 before the vehicle knows
        the date."""
        steps.note_unix(self.state, min(unix_us, steps.LARGEST_STAMP_US), boot_us)

    @property
    def unix_offset_us(self) -> int | None:
        """UNIX time minus boot time, as the vehicle's SYSTEM_TIME says; None before it knows the
        date."""
        offset_us = int(self.state["unix_us"][0])
        return None if offset_us == NONE_US else offset_us

    def tell(self) -> None:
        """Log the message whose stamps were found to be in the wrong unit, once."""
        if self.state["wrong_units"][0] == self._wrong_units:
            return
        self._wrong_units = int(self.state["wrong_units"][0])
        source = self.state["sources"][0][int(self.state["wrong_unit_of"][0])]
        is_fast = source["unit"] == steps.TOO_FAST
        units = "microseconds in milliseconds" if is_fast else "milliseconds in microseconds"
        logger.warning("message %d stamps %s: its stamps are not used", source["number"], units)
