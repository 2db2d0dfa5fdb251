"""One message that the estimator needs: its request, and the rate that arrives."""

from enum import Enum

from companion.mavlink.streams import Stream

FRUITLESS = 3
"""number of requests without effect after which the rate that arrives is accepted"""
WINDOW_US = 1_000_000
WINDOW_MESSAGES = 5
RETRY_US = 10_000_000
BUSY_US = 3_000_000


class Asked(Enum):
    """State of a request."""

    NO = "to be requested"
    YES = "granted, or not answered"
    REFUSED = "refused"


class Watch:
    """One message: its request, and its rate."""

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self.heard = False
        self.rate_hz = 0.0
        """last measured rate"""
        self.result = ""
        """result of a refused request"""
        self.reported = ""
        """the problem that was logged last"""
        self.changed = False
        """whether an interval of ours is in force"""
        self._settled_us = 0
        self.start()

    def start(self) -> None:
        """Forget what was granted: to be requested now."""
        self.asked = Asked.NO
        self.asked_hz = self.ceiling_hz = self.stream.rate_hz
        self.due_us = 0
        self.good = False
        self.fruitless = 0
        self.retry_us, self.busy_us = RETRY_US, BUSY_US
        self._begin: tuple[int, int, int] | None = None

    def settle(self, settled_us: int) -> None:
        """Measure anew, from `settled_us` on."""
        self._begin = None
        self._settled_us = settled_us

    def measure(self, now_us: int, vehicle_us: int, count: int, *, stopped: bool) -> float | None:
        """The rate of the window that ends now, Hz; None while it goes on.

        `stopped` : the vehicle's clock stands still, so the host's clock measures.
        """
        if self._begin is None or vehicle_us < self._begin[1]:
            if now_us >= self._settled_us:
                self._begin = (now_us, vehicle_us, count)
            return None
        window_us = max(WINDOW_US, round(WINDOW_MESSAGES * 1e6 / self.asked_hz))
        elapsed_us = now_us - self._begin[0] if stopped else vehicle_us - self._begin[1]
        if elapsed_us < window_us:
            return None
        rate_hz = (count - self._begin[2]) * 1e6 / elapsed_us
        self._begin = (now_us, vehicle_us, count)
        return rate_hz

    @property
    def problem(self) -> str:
        """The problem of this message, for the user; empty when there is none."""
        stream = self.stream
        if not stream.label or self.rate_hz >= 0.8 * stream.floor_hz:
            return ""
        if self.asked is Asked.REFUSED:
            return f"{stream.label} refused ({self.result}), {self.rate_hz:.0f} Hz"
        if self.fruitless < FRUITLESS and not self.reported:
            return ""
        if self.rate_hz == 0.0:
            return f"no {stream.name}" if not self.heard else f"{stream.label} silent"
        return f"{stream.label} slow: {self.rate_hz:.0f} of {stream.rate_hz:.0f} Hz"
