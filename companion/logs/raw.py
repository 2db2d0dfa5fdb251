"""Raw captures: MAVLink frames one after the other without times (.raw, .tlog.raw).

The vehicle's own boot stamps are the only clock there is: a frame arrives at the newest boot time
heard from its sender's system, and what has no stamp arrives with the frame before it.
"""

from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path

from companion.errors import LogFormatError
from companion.logs.files import opened, read
from companion.mavlink.codec import Decoder, Frame, FrameReject
from companion.mavlink.columns import boot_stamp_us
from companion.samples import Packet

CHUNK = 1 << 18
PROBE_BYTES = 1 << 18
FEWEST_FRAMES = 3
LOWEST_SHARE = 0.5
STAMP_BYTES = 8


def is_raw(head: bytes) -> bool:
    """Whether most frames in the first bytes of a file follow each other without a time between."""
    return _share_apart(head, 0) > LOWEST_SHARE


def is_tlog(head: bytes) -> bool:
    """Whether most frames in the first bytes of a file follow each other with a time between."""
    return _share_apart(head, STAMP_BYTES) > LOWEST_SHARE


def _share_apart(head: bytes, gap_bytes: int) -> float:
    """Share of the frames that begin `gap_bytes` after the end of the frame before."""
    frames = Decoder().feed(head)
    apart, end = 0, -1
    for frame in frames:
        at = head.find(frame.data, max(end, 0))
        apart += at == end + gap_bytes
        end = at + len(frame.data)
    return apart / (len(frames) - 1) if len(frames) >= FEWEST_FRAMES else 0.0


class RawReader:
    """The good frames of a raw capture in file order. Every iteration starts anew.

    ``counters`` tell what was left out in the current iteration, by cause. Raises `LogFormatError`
    when the file cannot be read or holds no MAVLink frame.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.counters: Counter[FrameReject] = Counter()
        self.position_bytes = self.frames = 0
        with opened(self.path) as file:
            head = read(file, self.path, PROBE_BYTES)
            self.size_bytes = self.path.stat().st_size
        if not head:
            raise LogFormatError(f"{self.path}: the file is empty")
        if not Decoder(datagrams=True).feed(head):
            raise LogFormatError(
                f"{self.path}: not a raw capture of MAVLink: no frame of a known dialect in it"
            )

    def __iter__(self) -> Iterator[Packet]:
        for time_us, frame in self.items():
            yield Packet(time_us, frame.data)

    def items(self, wanted: Collection[int] = ()) -> Iterator[tuple[int, Frame]]:
        """(time_us, frame) of every good frame; the time is the vehicle's boot clock."""
        decoder, now_us = Decoder(), 0
        self.counters = decoder.counters
        self.position_bytes = self.frames = 0
        with opened(self.path) as file:
            while True:
                chunk = read(file, self.path, CHUNK)
                for frame in decoder.feed(chunk) if chunk else decoder.flush():
                    now_us = boot_stamp_us(frame, now_us)
                    self.frames += 1
                    yield now_us, frame
                self.position_bytes += len(chunk)
                if not chunk:
                    return
