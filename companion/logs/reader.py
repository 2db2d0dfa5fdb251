"""`LogReader`: what the readers of all formats have in common."""

from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path

from companion.mavlink.codec import FrameReject
from companion.recorded import Batch, Item


class LogReader:
    """The items of a log in the order of the file. Every iteration starts anew; one at a time.

    A format gives `batches`; all else follows from them.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.counters: Counter[FrameReject] = Counter()
        """what was left out in the current iteration, by cause: JUNK in bytes, others in frames"""
        self.size_bytes = 0
        self.position_bytes = 0
        """how far the iteration is, of ``size_bytes``"""
        self.frames = 0
        """items given in the current iteration"""

    def batches(self) -> Iterator[Batch]:
        """All items, a piece of the log after the other. Arrival is UNIX time, or boot time where
        the log does not know the date."""
        raise NotImplementedError

    def items(self, wanted: Collection[int] = ()) -> Iterator[tuple[int, Item]]:
        """(arrival_us, item) of all; frames of the `wanted` MAVLink kinds carry their message."""
        for batch in self.batches():
            yield from self.items_of(batch, wanted)

    def items_of(self, batch: Batch, wanted: Collection[int]) -> Iterator[tuple[int, Item]]:
        """As `items`, of one batch."""
        for end, entry in zip(batch.ends.tolist(), batch.items(wanted), strict=True):
            self.frames += 1
            self.position_bytes = end
            yield entry
        self.position_bytes = batch.end

    def passed(self, batch: Batch) -> None:
        """The items of a batch were taken without `items_of`."""
        self.frames += batch.size
        self.position_bytes = batch.end
