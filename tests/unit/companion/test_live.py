"""The live path: which messages it takes, and that it gives what the pipeline gives for the rest of
them (tests/scenarios/test_replay_equals_live.py compares whole flights)."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from companion.mavlink.codec import Encoder, Message, mavlink
from companion.pipeline import Pipeline
from companion.samples import Kind, Packet, Verdict
from companion.settings import CompanionSettings


def second(boot_ms: int) -> list[tuple[int, Message]]:
    """(boot time, message) of a vehicle that stands at 500 m."""
    found: list[tuple[int, Message]] = [
        (boot_ms, mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 3, 3)),
    ]
    for k in range(10):
        at = boot_ms + 100 * k
        found += [
            (at, mavlink.MAVLink_scaled_pressure_message(at, 954.61 + 0.01 * (k % 3), 0.0, 2500)),
            (at, mavlink.MAVLink_raw_imu_message(at * 1000, 3, 4, -1000, 1, 2, 3, 0, 0, 0)),
            (at, mavlink.MAVLink_attitude_message(at, 0.01, -0.0, 0.03, 0.0, 0.0, 0.0)),
            (
                at,
                mavlink.MAVLink_gps_raw_int_message(
                    at * 1000, 3, 1, 1, 500_000, 100, 150, 0, 0, 10, 548_000, 1000, 2000
                ),
            ),
        ]
    return found


def flown(pipeline: Pipeline, seconds: int = 8) -> list[bytes]:
    """The frames that it sends."""
    vehicle, sent = Encoder(1, 1), []
    for boot_ms in range(1000, 1000 + 1000 * seconds, 1000):
        for at, message in second(boot_ms):
            sent += pipeline.feed(Packet(at * 1000, vehicle.encode(message)))
    return sent


class Slow(Pipeline):
    """Overrides a step: every message goes through the pipeline's own."""

    def _reading(self, *arguments: Any) -> list[bytes]:
        return super()._reading(*arguments)


def test_plain_messages_do_not_go_through_the_pipeline(monkeypatch: pytest.MonkeyPatch) -> None:
    pipeline = Pipeline(CompanionSettings())
    taken: list[int] = []
    steps = pipeline.take

    def take(frames: Any, *rest: Any) -> list[bytes]:
        taken.extend(frame.message_id for frame in frames)
        return steps(frames, *rest)

    monkeypatch.setattr(pipeline, "take", take)
    flown(pipeline)
    assert taken.count(mavlink.MAVLINK_MSG_ID_HEARTBEAT) == 8
    assert taken.count(mavlink.MAVLINK_MSG_ID_GPS_RAW_INT) == 80
    assert taken.count(mavlink.MAVLINK_MSG_ID_ATTITUDE) == 0
    assert taken.count(mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE) <= 1  # it begins the clock
    assert pipeline.verdicts[Kind.PRESSURE][Verdict.USED] > 70


def test_the_same_frames_are_sent_and_the_same_is_counted() -> None:
    slow, fast = Slow(CompanionSettings()), Pipeline(CompanionSettings())
    assert flown(slow) == flown(fast)
    for name in ("heard", "verdicts"):
        assert getattr(slow, name) == getattr(fast, name)
    assert slow.identity.counters == fast.identity.counters
    assert slow.intake.counters == fast.intake.counters
    assert slow.decoder.frames == fast.decoder.frames
    for part in ("filter", "health", "outputs", "checker"):
        assert getattr(slow, part).state.tobytes() == getattr(fast, part).state.tobytes()


def test_another_vehicle_and_a_branch_have_arrays_of_their_own() -> None:
    """A new intake, estimator or health is found by itself."""
    pipeline = Pipeline(CompanionSettings())
    flown(pipeline, 4)
    before = pipeline.filter.state.tobytes()

    class Unseeing:
        def __getattr__(self, _: str) -> Any:
            return lambda *_: None

    branch = pipeline.branch(Unseeing())
    late = Packet(5_500_000, Encoder(1, 1).encode(second(5500)[1][1]))
    branch.feed(late)
    assert pipeline.filter.state.tobytes() == before != branch.filter.state.tobytes()
    pipeline.feed(late)
    assert pipeline.filter.state.tobytes() == branch.filter.state.tobytes()


@pytest.mark.slow
@pytest.mark.skipif("NUMBA_DISABLE_JIT" in os.environ, reason="this is the uncompiled run")
def test_uncompiled_it_is_the_same() -> None:
    files = [__file__, str(Path(__file__).parent / "mavlink" / "test_plain.py")]
    subprocess.run(
        [sys.executable, "-m", "pytest", "-q", *files],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        check=True,
    )
