"""Whether the bytes read now were sent long ago, because this process was stopped or delayed.

After SIGSTOP, a suspended computer or a stalled disk the kernel hands over all that arrived in the
meantime at once. The estimate needs these bytes; the altitudes made of them are old and must not be
sent in a burst.
"""

LIMIT_US = 500_000
"""Altitudes older than this on the host's clock are not sent."""


class Backlog:
    """Follows the turns of the loop on the host's clock."""

    def __init__(self) -> None:
        self.behind = False
        """whether what was read last is old"""
        self._returned_us: int | None = None
        self._anchor: tuple[int, int] | None = None
        """host's and vehicle's time at the end of the last turn before the interruption"""

    def received(self, now_us: int, timeout_s: float, has_data: bool) -> None:
        """Reading returned at `now_us`, after `timeout_s` at most if this process was running."""
        if not has_data:  # the kernel has nothing left
            self.behind = False
        elif self._returned_us is not None:
            late_us = now_us - self._returned_us - round(timeout_s * 1e6)
            self.behind |= late_us > LIMIT_US
        self._returned_us = now_us

    def handled(self, now_us: int, vehicle_us: int) -> None:
        """What was read has been handled; the vehicle's clock now says `vehicle_us`."""
        if not self.behind:
            self._anchor = (now_us, vehicle_us)
        elif self._anchor is not None:
            host_us, boot_us = self._anchor
            self.behind = (now_us - host_us) - (vehicle_us - boot_us) > LIMIT_US
