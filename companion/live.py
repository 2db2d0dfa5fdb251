"""The live path of plain messages: from bytes to ALTITUDE in three compiled calls.

Nearly all of a vehicle's messages are of a few kinds at a high rate (`companion.mavlink.plain`).
For one of them that is whole, undamaged and in time, the pipeline's steps are taken in one call
before the estimator's step and one after it (`companion.live_steps`), on the pipeline's own state.
All others are left to the pipeline, which gives the same for these bit for bit
(tests/scenarios/test_replay_equals_live.py).
"""

import copy
import operator
from collections.abc import Hashable
from typing import TYPE_CHECKING, Any

import numpy as np

from companion.intake import SampleReject
from companion.jit import Parts
from companion.live_steps import LONGEST, OF_FAULTY, OF_KIND, PARTS, SILENT, U1, follow, take
from companion.mavlink.convert import THERMOMETERS
from companion.mavlink.framing import CRC_TABLE, Frame
from companion.mavlink.plain import plans
from companion.mavlink.plain_steps import MOST_FIELDS
from companion.pipeline_state import following_of, intaking_of, owners_of
from companion.reading_steps import (
    ASSESSED,
    CHANGED,
    DUE,
    LEFT_OUT,
    OF_AIR,
    OF_PRIMARY,
    READING,
    REPLACED,
    RESTARTS,
    SAMPLE,
    TELLS,
    UNUSED,
)
from companion.samples import ORDER, Kind, Verdict, rows

if TYPE_CHECKING:
    from companion.pipeline import Pipeline

NO_VERDICT = -1
KINDS, VERDICTS = tuple(Kind), tuple(Verdict)
# Looked up in its class, a member of an enum costs ten times as much (Python 3.11).
_IMU, _USED, _IGNORED = Kind.IMU, Verdict.USED, Verdict.IGNORED


class LivePath:
    """Takes a pipeline's bytes: plain messages in compiled steps, all others as the pipeline
    does."""

    def __init__(self, pipeline: "Pipeline") -> None:
        self._pipeline = pipeline
        self._plain: _PlainPath | None = None

    def __deepcopy__(self, memo: dict[int, Any]) -> "LivePath":
        """That of a copy of the pipeline has its own arrays."""
        return LivePath(copy.deepcopy(self._pipeline, memo))

    def feed(self, data: bytes, host_us: int, source: Hashable) -> list[bytes]:
        """The frames to send because of `data`."""
        pipeline, decoder = self._pipeline, self._pipeline.decoder
        taken = self._take(data, host_us, source) if decoder.is_empty else None
        if taken is not None:
            decoder.frames += 1
            return taken
        sent: list[bytes] = []
        for frame in decoder.feed(data):
            taken = self._take(frame.data, host_us, source)
            sent += pipeline.take([frame], host_us, source) if taken is None else taken
        return sent

    def _take(self, data: bytes, host_us: int, source: Hashable) -> list[bytes] | None:
        """Take one frame in compiled steps; None where that cannot be."""
        plain, pipeline = self._plain, self._pipeline
        if plain is None or not plain.fits():
            suits = (
                pipeline.in_blocks
                and pipeline.estimates
                and pipeline.signing is None
                and pipeline.identity.vehicle is not None
            )
            plain = self._plain = _PlainPath(pipeline) if suits else None
        return plain.take(data, host_us, source) if plain is not None else None


class _PlainPath:
    """Takes plain messages for a pipeline, whose parts stay as they are meanwhile (`fits`)."""

    def __init__(self, pipeline: "Pipeline") -> None:
        self.pipeline = pipeline
        self._owners = owners_of(pipeline)
        self._autopilot = pipeline.identity.autopilot
        self._listeners, self._scale = len(pipeline.listeners), self._raw_imu_scale()
        vehicle = pipeline.identity.vehicle
        self._vehicle, (self._system_id, self._component_id) = vehicle, vehicle or (0, 0)
        data, bits = np.zeros(LONGEST, U1), np.zeros(1, np.uint32)
        self._data = memoryview(data)  # type: ignore[arg-type]
        samples = [pipeline.intake.newest(kind) for kind in Kind]
        *states, receivers, primaries = intaking_of(pipeline)
        parts: list[Any] = [
            data,
            *plans(self._scale, self._without(pipeline)),
            np.array(CRC_TABLE),
            *(bits, bits.view(np.float32), np.zeros(MOST_FIELDS)),
            *(rows(READING), pipeline.filter.estimate, rows(ORDER)),
            *samples,
            *(np.asarray(row).view(np.float64) for row in samples),
            *(np.asarray(row).view(np.int64) for row in samples),
            *(*states, *receivers, *primaries),
            *following_of(pipeline),
        ]
        assert len(parts) == PARTS
        self._parts = Parts(parts)
        self._argument = self._parts.argument

    @staticmethod
    def _without(pipeline: "Pipeline") -> set[int]:
        """Ids of plain messages that do more here than their sample."""
        listened = set(pipeline.listeners)
        return listened | set(THERMOMETERS[pipeline.settings.intake.air_temperature])

    def fits(self) -> bool:
        """Whether the pipeline still has the parts and the vehicle that this was made with."""
        identity = self.pipeline.identity
        return (
            identity.vehicle == self._vehicle
            and identity.autopilot == self._autopilot
            and all(map(operator.is_, owners_of(self.pipeline), self._owners))
            and len(self.pipeline.listeners) == self._listeners
            and (self._scale is not None or self._raw_imu_scale() is None)
        )

    def _raw_imu_scale(self) -> float | None:
        return self.pipeline.readings.imu.scale(self._autopilot)

    def take(self, data: bytes, host_us: int, source: Hashable) -> list[bytes] | None:
        """The frames to send because of `data`; None when the pipeline has to take it."""
        pipeline, identity, size = self.pipeline, self.pipeline.identity, len(data)
        if size > LONGEST or source != identity.source or identity.signed_us is not None:
            return None
        self._data[:size] = data
        wants_imu, argument = pipeline.wants_imu, self._argument
        code = take(argument, size, self._system_id, self._component_id, host_us, wants_imu)
        if code < 0:
            return None
        message_id, became = data[7], code & 3
        identity.took(1, 2, host_us, None, told_again=False)
        heard = pipeline.heard
        heard[message_id] = heard.get(message_id, 0) + 1
        pipeline.frames.append(Frame(data, message_id, data[5], data[6], data[4], 2, False))
        kind = KINDS[code >> OF_KIND]
        if code & (TELLS | OF_PRIMARY):
            pipeline.intake.tell(kind if code & OF_PRIMARY else None)
        if became == SAMPLE:
            tells_air = bool(code & OF_AIR) or pipeline.air.reference is not None
            return self._sample(kind, host_us, tells_air=tells_air)
        if became == LEFT_OUT:
            pipeline.intake.counters[SampleReject.CLOCK] += 1
            return pipeline.age(host_us)
        if became == REPLACED:
            pipeline.intake.counters[SampleReject.REPLACED] += 1
        elif became == UNUSED:
            pipeline.verdicts[_IMU][_IGNORED] += 1
        return self._react(NO_VERDICT, host_us)

    def _sample(self, kind: Kind, host_us: int, *, tells_air: bool) -> list[bytes]:
        """Give the sample in the row of its kind to the estimator and to all who follow it."""
        pipeline, row = self.pipeline, self.pipeline.intake.newest(kind)
        sent = pipeline.tell_air(kind, row) if tells_air else []
        pipeline.identity.measured(kind)
        verdict = pipeline.filter.step(kind, row)
        pipeline.count(kind, row, verdict)
        return sent + self._react(int(verdict), host_us)

    def _react(self, verdict: int, host_us: int) -> list[bytes]:
        """What is due now that the vehicle's clock has moved."""
        pipeline, altitude = self.pipeline, None
        found = follow(self._argument, verdict, host_us)
        if found & ASSESSED:
            pipeline.announcements.excluded(found >> OF_FAULTY, pipeline.estimate)
        if found & RESTARTS:
            pipeline.restart_estimator()
            now_us, health = pipeline.now_us, pipeline.health.health
            if verdict == _USED:
                altitude = pipeline.outputs.altitude(now_us, health, pipeline.estimate)
        elif found & DUE:
            altitude = pipeline.outputs.message()
        sent = pipeline.publish(altitude, changed=bool(found & CHANGED))
        return sent + (pipeline.age(host_us) if found & SILENT else pipeline.texts(host_us))
