"""When the messages that we send at a rate are due."""


class Schedule:
    """Slots of vehicle time: the first update after a slot falls due takes it. There is no timer.

    An update a tenth of a period early takes it too: stamps of a stream at this very rate jitter.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_us = round(1e6 / rate_hz)
        self._due_us: int | None = None

    def takes(self, now_us: int) -> bool:
        """Whether an update at `now_us` is due; if so its slot is used up. A clock that went back
        starts anew."""
        due_us, early_us = self._due_us, self._period_us // 10
        if due_us is None:
            self._due_us = now_us + self._period_us
            return True
        if due_us - 2 * self._period_us <= now_us < due_us - early_us:
            return False
        is_on_grid = -early_us <= now_us - due_us < self._period_us
        self._due_us = (due_us if is_on_grid else now_us) + self._period_us
        return True
