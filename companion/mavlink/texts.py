"""STATUSTEXT, which a ground station shows its pilot: on changes only, and at a limited rate."""

from companion.mavlink.codec import Message, mavlink

SPACING_US = 5_000_000
LONG_AGO_US = -(1 << 62)
STATUSTEXT_SIZE = 50


class Allowance:
    """Rate limit: `per_s` events at once, and `per_s` events a second."""

    def __init__(self, per_s: int) -> None:
        self._per_s = per_s
        self._left = float(per_s)
        self._time_us: int | None = None

    def takes(self, now_us: int) -> bool:
        """Whether an event is allowed now; if so it is counted."""
        if self._time_us is not None:
            passed_s = max(0, now_us - self._time_us) * 1e-6
            self._left = min(float(self._per_s), self._left + passed_s * self._per_s)
        self._time_us = now_us
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class StatusTexts:
    """At most one text of a kind in five seconds of the host's clock.

    An earlier text waits; a later text of its kind replaces it. It is dropped when its state is the
    one told last.
    """

    def __init__(self) -> None:
        self._waiting: dict[str, tuple[object, int, str]] = {}
        self._told: dict[str, tuple[int, object]] = {}

    def say(self, kind: str, state: object, severity: int, text: str) -> None:
        """A text about `kind`, which is now in `state`: the same state is not told twice
        running."""
        self._waiting[kind] = (state, severity, text)

    def retract(self, kind: str) -> None:
        """Drop the waiting text about `kind`; the next text about it is sent, whatever its
        state."""
        self._waiting.pop(kind, None)
        if kind in self._told:
            self._told[kind] = (self._told[kind][0], None)

    @property
    def waiting_us(self) -> list[int]:
        """When the last text was sent of each kind of which another waits; long ago where that one
        need not wait."""
        found = []
        for kind, (state, _, _) in self._waiting.items():
            last_us, last_state = self._told.get(kind, (LONG_AGO_US, None))
            found.append(LONG_AGO_US if state == last_state else last_us)
        return found

    def due(self, now_us: int) -> list[Message]:
        """The texts that may go out now."""
        if not self._waiting:
            return []
        found: list[Message] = []
        for kind, (state, severity, text) in list(self._waiting.items()):
            last_us, last_state = self._told.get(kind, (None, None))
            if state == last_state:
                del self._waiting[kind]
            elif last_us is None or not 0 <= now_us - last_us < SPACING_US:
                del self._waiting[kind]
                self._told[kind] = (now_us, state)
                ascii_text = text.encode("ascii", "replace")[:STATUSTEXT_SIZE]
                found.append(mavlink.MAVLink_statustext_message(severity, ascii_text))
        return found
