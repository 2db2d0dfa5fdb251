"""Replay in blocks: the messages of a log's block through compiled loops of the pipeline's steps.

The state is the pipeline's own, and so are the steps, so that what comes out is what the pipeline
gives for one message at a time, bit for bit. Messages that need more than these steps (the first
HEARTBEAT, commands, a restart of the vehicle, anything that is logged) are left to the pipeline:
the piece before such a message is taken anew up to it, from a copy of the state.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.intake import SampleReject
from companion.intake.row_steps import DOUBTED, RIGHT, UNSETTLED
from companion.mavlink.codec import Frame, decode, mavlink
from companion.mavlink.debug import state_floats
from companion.mavlink.identity import Origin
from companion.mavlink.outputs import SOURCES
from companion.mavlink.record_scan import INDEX
from companion.mavlink.texts import SPACING_US
from companion.observer import Block, BlockObserver
from companion.pipeline import Pipeline
from companion.pipeline_state import following_of, intaking_of
from companion.recorded import Batch, Item
from companion.replay.block_steps import MESSAGE, PYTHON, TELLING, Telling, follow, take_in
from companion.replay.columns import (
    CUSTOM_MODE,
    HEARTBEAT,
    Arrays,
    Beat,
    Speaker,
    arrays_of,
    heights,
    sent_by,
    stations,
)
from companion.replay.merged import Merged, Outgoing
from companion.samples import ESTIMATE, Kind, Rows, Verdict, readable, rows

SMALLEST, LARGEST = 64, 1 << 14
"""frames of a piece: fewer where many are left to the pipeline"""
SIMSTATE = mavlink.MAVLINK_MSG_ID_SIMSTATE
REJECTS = (SampleReject.NO_CLOCK, SampleReject.CLOCK, SampleReject.REPLACED)
Take = Callable[[int, Item], list[bytes]]
Passed = Callable[[Batch], None]


class _Piece(NamedTuple):
    """What the loops found in a piece of a block."""

    stop: int
    size: int
    """number of samples"""
    published: int
    estimates: Rows
    verdicts: NDArray[np.int64]
    health: NDArray[np.int64]
    due: Rows
    """`block_steps.MESSAGE` rows of what is sent"""
    floats: list[list[float]]
    """of the estimator's state, for each of the DEBUG family"""


class BlockRunner:
    """Takes batches of a log for a pipeline.

    Parameters
    ----------
    take : gives one item to the pipeline.
    passed : told the part of a batch that was taken. `flush` tells it of all up to now.
    merged : gets the items, and our frames; needed where the pipeline sends.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        take: Take,
        passed: Passed | None = None,
        merged: Merged | None = None,
    ) -> None:
        self.pipeline = pipeline
        self._take, self._passed, self._merged = take, passed, merged
        self._beat: Beat | None = None
        self._session = 0
        self._batch: Batch | None = None
        self._own = self._others = np.zeros(0, np.bool_)
        """which items of the batch are frames of the vehicle, and of others, that were taken in the
        loops"""
        self._signs = False
        """whether frames of the batch are signed"""
        self._told = self._at = 0
        """the frames of the batch that are counted, and those that were taken"""
        self._length = SMALLEST
        self._counts = np.zeros(len(REJECTS), np.int64)
        self._silent = Telling(rows(TELLING), np.zeros(0, np.int64), rows(MESSAGE, 0))

    def compile(self) -> None:
        """Compile the loops, by an empty block."""
        none: frozenset[int] = frozenset()
        speaker = Speaker((1, 1), (1, 191), 2, 0, 0, None, none, none, "none", 0, 0)
        times_us = np.zeros(0, np.int64)
        nothing = Batch(times_us, times_us, 0, b"", rows(INDEX, 0))
        self._loops(arrays_of(nothing, 0, speaker, None), 0, 0)

    def run(self, batch: Batch, observer: Callable[[], BlockObserver]) -> None:
        """Take all items of a batch; `observer` gives the one of the present session."""
        at, size = 0, batch.size
        self._batch, self._told, self._at = batch, 0, 0
        self._own, self._others = np.zeros((2, size), np.bool_)
        self._signs = bool(np.asarray(batch.index["signed"]).any())
        arrays: Arrays | None = None
        first, known = 0, None
        while at < size:
            speaker = self._speaker(observer())
            if speaker is not None:
                if arrays is None or speaker != known:
                    self.flush()
                    signed_us = self.pipeline.identity.signed_us
                    arrays, first = arrays_of(batch, at, speaker, signed_us), at
                    known = speaker
                stop = self._stop(arrays, at - first)
                reached = self._piece(arrays, first, (at - first, stop), observer())
                at = self._at = first + reached
                if at == size or (reached == stop and arrays.items["what"][reached] != PYTHON):
                    continue
                if reached < stop:
                    self.flush()
            self._single(batch, at)
            at += 1
        self.flush()

    def _speaker(self, observer: BlockObserver) -> Speaker | None:
        """What decides how frames are taken; None where the pipeline has to take all of them."""
        pipeline, identity = self.pipeline, self.pipeline.identity
        vehicle = identity.vehicle
        if (
            vehicle is None
            or pipeline.now_us < 0
            or (pipeline.sends and not self._can_send())
            or pipeline.signing is not None
            or pipeline.air.reference is not None
        ):
            return None
        simulation, session = pipeline.intake.simulation, id(observer)
        if session != self._session:
            self._session, self._beat = session, None
        return Speaker(
            vehicle,
            identity.own,
            identity.version,
            identity.autopilot,
            identity.vehicle_type,
            pipeline.readings.imu.scale(identity.autopilot),
            pipeline.wanted - ({SIMSTATE} if simulation.is_flat else set()),
            frozenset(pipeline.listeners),
            pipeline.settings.intake.air_temperature,
            self._equal_heights(),
            session,
            self._beat,
        )

    def _can_send(self) -> bool:
        """Whether what the pipeline sends can be made in blocks."""
        pipeline, identity = self.pipeline, self.pipeline.identity
        return (
            self._merged is not None
            and pipeline.feedback.knob is None
            and identity.own != identity.vehicle
        )

    def _equal_heights(self) -> int:
        """What a fix with equal heights above sea level and ellipsoid is now."""
        simulation = self.pipeline.intake.simulation
        meaning = self.pipeline.settings.intake.equal_heights
        if simulation.is_flat or meaning == "sea_level":
            return RIGHT
        return DOUBTED if meaning == "doubt" and simulation.in_question else UNSETTLED

    def _stop(self, arrays: Arrays, at: int) -> int:
        """The end of the piece that begins at `at`."""
        place = int(np.searchsorted(arrays.python, at))
        end = int(arrays.python[place]) if place < arrays.python.size else arrays.items.size
        return min(end, at + self._length)

    def _single(self, batch: Batch, at: int) -> None:
        """Let the pipeline take one item."""
        time_us, item = batch.item(at)
        is_beat = isinstance(item, Frame) and item.message_id == HEARTBEAT
        if is_beat or self._signs or self.pipeline.identity.signed_us is not None:
            self.flush()
        self._at = at + 1
        sent = self._take(time_us, item)
        if self._merged is not None:
            self._merged.item(self.pipeline, time_us, item, sent)
        if not (is_beat and isinstance(item, Frame)):
            return
        if (item.system_id, item.component_id) == self.pipeline.identity.vehicle:
            message = decode(item)
            if message is not None and self.pipeline.now_us >= 0:
                custom = int(message.base_mode & CUSTOM_MODE != 0)
                self._beat = (message.type, message.autopilot, custom, message.custom_mode)

    def _piece(
        self,
        arrays: Arrays,
        first: int,
        extent: tuple[int, int],
        observer: BlockObserver,
    ) -> int:
        """Take the frames from the one place to the other of `extent` in the loops; the first frame
        that the pipeline has to take, or the last place. The arrays begin at `first` of the
        batch."""
        start, stop = extent
        if start == stop:
            return stop
        states = self._states()
        before = [state.copy() for state in states]
        piece = self._loops(arrays, start, stop)
        if piece.stop < stop:
            self._length = max(SMALLEST, self._length // 2)
            arrays.restore(start, stop)
            for state, old in zip(states, before, strict=True):
                state[:] = old
            if piece.stop == start:
                return start
            piece = self._loops(arrays, start, piece.stop)
        else:
            self._length = min(LARGEST, 2 * self._length)
        items, self._at = arrays.items[start : piece.stop], first + piece.stop
        own = np.asarray(items["is_vehicle"]) == 1
        self._own[first + start : self._at] = own
        self._others[first + start : self._at] = ~own & (np.asarray(items["is_frame"]) == 1)
        self._keep(arrays, start, piece, observer)
        return piece.stop

    def _states(self) -> list[Rows]:
        """Everything that the loops write to, beside the arrays of the block."""
        pipeline = self.pipeline
        intaking = intaking_of(pipeline)
        return [
            *intaking[:-2],
            *intaking.receivers,
            *intaking.primaries,
            *following_of(pipeline),
            pipeline.filter.state,
            pipeline.filter.estimate,
        ]

    def _telling(self, arrays: Arrays, start: int, stop: int) -> Telling:
        """What is sent because of ``items[start:stop]``, and what is told already."""
        pipeline, publish = self.pipeline, self.pipeline.settings.publish
        if not pipeline.sends or start == stop:
            return self._silent
        announcements, state = pipeline.announcements, rows(TELLING)
        state["sends"], state["debug"], state["texts"] = 1, publish.debug, publish.statustext
        state["source"] = SOURCES.index(announcements.told_source)
        state["excluded"], state["spacing_us"] = announcements.told_excluded, SPACING_US
        most = stop - start + 2 * arrays.readings_of(start, stop).size
        waiting_us = np.array(announcements.waiting_us, np.int64)
        return Telling(state, waiting_us, readable(np.empty(most, MESSAGE)))

    def _loops(self, arrays: Arrays, start: int, stop: int) -> _Piece:
        """The compiled loops over ``items[start:stop]``."""
        items, readings, tables = arrays.items, arrays.readings, arrays.tables
        outputs, telling = self.pipeline.outputs, self._telling(arrays, start, stop)
        self._counts[:] = 0
        self.pipeline.intake.params["equal_heights"] = self._equal_heights()
        slots = outputs.state, outputs.params, telling.state
        intaking = intaking_of(self.pipeline)
        stop, count = take_in(
            items, readings, tables, intaking, *slots, self._counts, start, stop
        )  # fmt: skip
        verdicts = np.full(count, Verdict.IGNORED, np.int64)
        health = np.zeros(count, np.int64)
        if not self.pipeline.estimates:
            return _Piece(stop, count, 0, rows(ESTIMATE, 0), verdicts, health, telling.messages, [])
        running = self.pipeline.filter
        estimates = readable(np.empty(count + 1, ESTIMATE))
        estimates[0] = running.estimate[0]
        if count:
            estimates[1] = running.estimate[0]
        floats: list[list[float]] = []
        first = 0
        for last in [*self._debugs(arrays, start, stop, telling), count]:
            if last > first:
                if first:
                    estimates[first + 1] = estimates[first]
                taken = tables._replace(order=tables.order[first:last])
                part = estimates[first + 1 : last + 1], verdicts[first:last]
                running.method.run(running.state, running.params, taken, *part)
            floats.append(state_floats(running.state) if telling.state["debug"][0] else [])
            first = last
        following = following_of(self.pipeline)
        stop, published = follow(
            items, readings, tables, estimates, verdicts, health, following, telling, start, stop
        )
        due = telling.messages[: int(telling.state["count"][0])]
        return _Piece(stop, count, published, estimates, verdicts, health, due, floats)

    def _debugs(self, arrays: Arrays, start: int, stop: int, telling: Telling) -> list[int]:
        """How many samples there are up to each of the DEBUG family in ``items[start:stop]``."""
        if not telling.state["debug"][0] or start == stop:
            return []
        found = np.asarray(arrays.readings_of(start, stop)["debug"])
        return (found[found > 0] - 1).tolist()

    def _keep(self, arrays: Arrays, start: int, piece: _Piece, observer: BlockObserver) -> None:
        """Count the samples, and show them to the observer."""
        pipeline, items = self.pipeline, arrays.items[start : piece.stop]
        readings = arrays.readings_of(start, piece.stop)
        sampled = np.flatnonzero(np.asarray(readings["place"]) >= 0)
        order = arrays.tables.order[: piece.size]
        pairs = np.bincount(np.asarray(order["kind"]) * len(Verdict) + piece.verdicts)
        for pair in np.flatnonzero(pairs).tolist():
            kind, verdict = divmod(pair, len(Verdict))
            pipeline.identity.measured(Kind(kind))
            pipeline.verdicts[kind][verdict] += int(pairs[pair])
        for cause, number in zip(REJECTS, self._counts.tolist(), strict=True):
            if number:
                pipeline.intake.counters[cause] += number
        if pipeline.estimates:
            pipeline.filter.estimate[:] = piece.estimates[piece.size :]
        if self._merged is not None and self._batch is not None:
            part = self._batch.part(self._at - items.size, self._at)
            piece.due["of_item"] -= start
            self._merged.piece(
                pipeline, part, Outgoing(piece.due, piece.estimates, piece.floats)
            )  # fmt: skip
        if pipeline.health.is_vehicle_silent:  # who else is heard at the end of the piece
            self.flush()
            pipeline.age(int(items["arrival_us"][-1]))
        observer.block(
            Block(
                arrays.tables._replace(order=order),
                piece.verdicts,
                piece.estimates[1:],
                np.asarray(readings["time_us"][sampled]),
                np.asarray(readings["number"][sampled]),
                np.asarray(readings["now_us"][sampled]),
                np.asarray(readings["unix_us"][sampled]),
                piece.health,
                heights(items, truth=True),
                heights(items, truth=False),
                piece.published,
            )
        )

    def flush(self) -> None:
        """Count what was taken since the last time, by sender and kind."""
        batch, first, stop = self._batch, self._told, self._at
        if batch is None or first == stop:
            return
        self._told = stop
        places, index = batch.frames(first, stop)
        self._count(index, self._own[first:stop][places])
        others = self._others[first:stop][places]
        if others.any():
            self._count_others(index[others], batch)
        if self._passed is not None:
            self._passed(batch.part(first, stop))

    def _count(self, index: Rows, own: NDArray[np.bool_]) -> None:
        """Count the vehicle's `own` frames, `record_scan.INDEX` rows."""
        if not own.any():
            return
        pipeline, ids = self.pipeline, index["message_id"][own]
        counts, times_us = np.bincount(ids), index["time_us"]
        signed = np.flatnonzero(own & (index["signed"] != 0))
        pipeline.identity.took(
            ids.size,
            int(index["version"][own].max()),
            int(times_us[np.flatnonzero(own)[-1]]),
            int(times_us[signed[-1]]) if signed.size else None,
            told_again=bool(counts[HEARTBEAT]),
        )
        for message_id in np.flatnonzero(counts).tolist():
            heard = pipeline.heard.get(message_id, 0)
            pipeline.heard[message_id] = heard + int(counts[message_id])

    def _count_others(self, others: Rows, batch: Batch) -> None:
        """Count frames of others, and forged ones."""
        identity = self.pipeline.identity
        if identity.vehicle is not None:
            is_forged = sent_by(others, identity.vehicle)
            identity.counters[Origin.FORGED] += int(is_forged.sum())
            others = others[~is_forged]
        beats = others[others["message_id"] == HEARTBEAT]
        for speaker, time_us in stations(batch.data, beats).items():
            identity.station(speaker, time_us)
        columns = (others[name].tolist() for name in ("system_id", "component_id", "time_us"))
        for system_id, component_id, arrival_us in zip(*columns, strict=True):
            identity.stranger((system_id, component_id), arrival_us)
