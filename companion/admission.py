"""Admits bytes of a network link for decoding, so that a flood of junk cannot delay the vehicle's
frames.

A byte that begins no frame costs up to 3 us. So senders that have sent MAVLink lately are always
admitted; all others share a budget.
"""

from collections.abc import Hashable

JUNK_BYTES_PER_S = 16_000
LASTING_US = 10_000_000
MOST_REMEMBERED = 64


class Admission:
    """Follows the senders of one link by their network address. None, the only sender of a serial
    port or a connection, is always admitted."""

    def __init__(self) -> None:
        self.refused_bytes = 0
        self._framed_us: dict[Hashable, int] = {}
        self._left = float(JUNK_BYTES_PER_S)
        self._filled_us: int | None = None

    def admits(self, source: Hashable, size: int, now_us: int) -> bool:
        """Whether `size` bytes from `source` are to be decoded."""
        framed_us = self._framed_us.get(source)
        if source is None or (framed_us is not None and now_us - framed_us < LASTING_US):
            return True
        if self._filled_us is not None:
            passed_s = max(0, now_us - self._filled_us) * 1e-6
            self._left = min(float(JUNK_BYTES_PER_S), self._left + passed_s * JUNK_BYTES_PER_S)
        self._filled_us = now_us
        if size > self._left:
            self.refused_bytes += size
            return False
        self._left -= size
        return True

    def framed(self, source: Hashable, now_us: int) -> None:
        """The last bytes from `source` held a frame."""
        if source is None:
            return
        self._framed_us.pop(source, None)
        self._framed_us[source] = now_us
        if len(self._framed_us) > MOST_REMEMBERED:
            del self._framed_us[next(iter(self._framed_us))]
