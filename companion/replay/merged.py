"""The log that `kollsman replay --out` writes: the frames of a log and ours between them."""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from companion.health import Health
from companion.logs.encoding import frame_of
from companion.mavlink.codec import Message
from companion.mavlink.debug import debug_messages
from companion.mavlink.outputs import altitude_message
from companion.mavlink.record_scan import STAMP, merge_records
from companion.pipeline import Pipeline
from companion.recorded import Batch, Item
from companion.replay.block_steps import DEBUG_DUE
from companion.samples import Rows


class Writer(Protocol):
    """Takes the frames of a log and ours between them."""

    def write(self, time_us: int, frame: bytes) -> None: ...


@runtime_checkable
class RecordWriter(Writer, Protocol):
    """A writer that takes many frames at once, as records of a tlog."""

    def write_records(self, records: bytes, time_us: int) -> None:
        """Take records, the last of which is of `time_us`."""


class Outgoing(NamedTuple):
    """Messages of ours that are due in a piece of a log."""

    due: Rows
    """`block_steps.MESSAGE` rows"""
    estimates: Rows
    """ESTIMATE rows: before the first sample, and after each"""
    floats: list[list[float]]
    """those of the estimator's state, for each of the DEBUG family"""


class Merged:
    """Writes what was taken of a log, with our frames behind those that they follow."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer

    @property
    def takes_blocks(self) -> bool:
        """Whether the writer takes many frames at once."""
        return isinstance(self._writer, RecordWriter)

    def item(self, pipeline: Pipeline, time_us: int, item: Item, sent: list[bytes]) -> None:
        """One item that `pipeline` has taken, and what was `sent`. Frames with our own ids are of
        an earlier run: ours replace them."""
        if not pipeline.heard_ourselves:
            data = frame_of(item, pipeline.identity.vehicle[0] if pipeline.identity.vehicle else 1)
            if data:
                self._writer.write(time_us, data)
        for frame in sent:
            self._writer.write(time_us, frame)

    def piece(self, pipeline: Pipeline, part: Batch, outgoing: Outgoing) -> None:
        """A part of a batch that was taken in the loops; the items of `outgoing` count from its
        first."""
        places, ours = _encoded(pipeline, part.times_us, outgoing)
        if part.places is not None:
            self._singly(pipeline, part, places, ours)
            return
        size = int((part.index["stop"] - part.index["start"]).sum()) + sum(map(len, ours))
        records = np.empty(size + STAMP * (part.size + len(ours)), np.uint8)
        merge_records(
            part.times_us,
            part.data,
            part.index,
            np.array(places, np.int64),
            np.cumsum(np.array([0, *map(len, ours)], np.int64)),
            np.frombuffer(b"".join(ours), np.uint8),
            records,
        )
        assert isinstance(self._writer, RecordWriter)
        self._writer.write_records(records.tobytes(), int(part.times_us[-1]))

    def _singly(
        self, pipeline: Pipeline, part: Batch, places: list[int], ours: list[bytes]
    ) -> None:
        """A part whose items are not all frames."""
        sent: dict[int, list[bytes]] = {}
        for place, frame in zip(places, ours, strict=True):
            sent.setdefault(place, []).append(frame)
        for place, (time_us, item) in enumerate(part.items()):
            self.item(pipeline, time_us, item, sent.get(place, []))


def _encoded(
    pipeline: Pipeline, times_us: NDArray[np.int64], outgoing: Outgoing
) -> tuple[list[int], list[bytes]]:
    """The frames of the messages that are due, and the items that they follow."""
    due, floats = np.asarray(outgoing.due), iter(outgoing.floats)
    places: list[int] = []
    frames: list[bytes] = []
    names = ("of_item", "what", "now_us", "health", "sample", "qnh_hpa", "heights")
    columns = (due[name].tolist() for name in names)
    for place, what, now_us, health, sample, qnh_hpa, heights in zip(*columns, strict=True):
        messages: list[Any] = [altitude_message(heights)]
        if what == DEBUG_DUE:
            estimate = outgoing.estimates[sample : sample + 1]
            messages = debug_messages(now_us, Health(health), estimate, next(floats), qnh_hpa)
        made = _sent(pipeline, messages, int(times_us[place]))
        places += [place] * len(made)
        frames += made
    return places, frames


def _sent(pipeline: Pipeline, messages: list[Message], host_us: int) -> list[bytes]:
    pipeline.arrived(host_us)
    return pipeline.encode(messages)
