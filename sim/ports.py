"""A port: one place the vehicle's messages go, with rates, sequence numbers and counts of its own.

A live link starts at ArduPlane's default rates and obeys what is asked on it; a log gets the full set. Rates hold in
simulated time.
"""

from collections import Counter
from collections.abc import Callable, Mapping

from sim import TICK_US
from sim.frames import Packer
from sim.telemetry import NAMES, TELEMETRY, Fresh, State, Telemetry

MIN_INTERVAL_US = 20_000
"""50 Hz, the rate of the IMU samples. ArduPilot's ceiling is 0.8 of its loop rate: 40 Hz on a default Plane."""
MAX_INTERVAL_US = 60_000_000
SYSTEM_ID = COMPONENT_ID = 1


class Port:
    """Sends to one destination. `deliver` takes a whole frame and says whether it was taken."""

    def __init__(
        self, name: str, deliver: Callable[[bytes], bool], rates_hz: Mapping[str, float], *, full: bool = False
    ) -> None:
        self.name = name
        self.sent: Counter[str] = Counter()
        self.sent_bytes = 0
        self.dropped = 0
        self._deliver = deliver
        self._sequence = 0
        self._defaults_us: dict[int, int] = {}
        for message_id, row in TELEMETRY.items():
            rate_hz = rates_hz.get(row.packer.name, row.full_hz if full else row.default_hz)
            self._defaults_us[message_id] = _interval_us(rate_hz)
        self._interval_us = dict(self._defaults_us)
        self._due_us = dict.fromkeys(TELEMETRY, 0)
        self._fix_us = -1
        """measurement time of the last fix sent"""
        self._next_due_us = 0

    def stream(self, state: State) -> None:
        """Send all that is due and has something new to say."""
        now_us = state.time_us
        if now_us < self._next_due_us:
            return
        last_id = -1
        soonest_us = now_us + MAX_INTERVAL_US
        for message_id, row in TELEMETRY.items():
            interval_us = self._interval_us[message_id]
            if interval_us <= 0:
                continue
            if self._due_us[message_id] <= now_us and self._may(row, state, last_id):
                payload = row.payload(state)
                if payload is not None:
                    self._fix_us = _measured_us(state) if row.fresh is Fresh.FIX else self._fix_us
                    self.send(row.packer, payload)
                    last_id = message_id
                    # Behind by more than an interval (it had to wait for a fix): start over instead of catching up.
                    due_us = self._due_us[message_id] + interval_us
                    self._due_us[message_id] = due_us if due_us > now_us else now_us + interval_us
            soonest_us = min(soonest_us, self._due_us[message_id])
        self._next_due_us = soonest_us

    def _may(self, row: Telemetry, state: State, last_id: int) -> bool:
        """Whether there is a sample that was not sent, and the carrier of its time has just gone out."""
        if row.follows and last_id not in row.follows and any(self._interval_us[i] > 0 for i in row.follows):
            return False
        if row.fresh is Fresh.ANY:
            return True
        if row.fresh is Fresh.MOTION:
            return state.truth is not None and state.truth.time_us == state.time_us
        return self._fix_us != _measured_us(state)

    def send(self, packer: Packer, payload: bytes) -> None:
        """Send one message now."""
        frame = packer.frame(payload, self._sequence, SYSTEM_ID, COMPONENT_ID)
        self._sequence = (self._sequence + 1) & 0xFF
        if self._deliver(frame):
            self.sent[packer.name] += 1
            self.sent_bytes += len(frame)
        else:
            self.dropped += 1

    def set_interval(self, message_id: int, interval_us: int, now_us: int) -> None:
        """Microseconds between two of `message_id`: clamped; 0 restores the default, negative stops it."""
        if interval_us == 0:
            interval_us = self._defaults_us[message_id]
        elif interval_us > 0:
            interval_us = max(MIN_INTERVAL_US, min(interval_us, MAX_INTERVAL_US))
        else:
            interval_us = -1
        self._interval_us[message_id] = interval_us
        self._due_us[message_id] = now_us + TICK_US
        self._next_due_us = now_us

    def interval_us(self, message_id: int) -> int:
        """The interval in force; -1 when stopped."""
        return self._interval_us[message_id]


def _measured_us(state: State) -> int:
    return -1 if state.fix is None else state.fix.measured_us


def _interval_us(rate_hz: float) -> int:
    return max(MIN_INTERVAL_US, round(1e6 / rate_hz)) if rate_hz > 0 else -1


def check_rates(rates_hz: Mapping[str, float]) -> None:
    """ValueError naming the first message that is not streamed."""
    for name in rates_hz:
        if name not in NAMES:
            raise ValueError(f"'{name}' is not streamed: use {', '.join(NAMES)}")
