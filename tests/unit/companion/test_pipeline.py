"""Packets in, estimates and frames out: deterministic, however the bytes are cut, and deaf to the
host's clock."""

import math
import os
import sys
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.estimators import ESTIMATORS
from companion.health import Health
from companion.mavlink.codec import Frame, Message, mavlink
from companion.mavlink.identity import Origin
from companion.pipeline import Pipeline
from companion.samples import Kind, Packet, Verdict
from companion.settings import CompanionSettings
from tests import vehicle
from tests.flights import HOST_EPOCH_US
from tests.vehicle import Vehicle, feed, merged, parsed, standing

OK, DEGRADED, LOST = Health


def stream(pipeline: Pipeline, data: bytes, cuts: list[int]) -> list[bytes]:
    """Feed bytes cut at these places, all at once on the host's clock."""
    sent: list[bytes] = []
    places = sorted({0, len(data), *(cut % len(data) for cut in cuts)})
    for start, end in pairwise(places):
        sent += pipeline.feed(Packet(0, data[start:end]))
    return sent


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_the_same_bytes_give_the_same_frames(estimator: str) -> None:
    chosen = CompanionSettings().with_changes(estimator=estimator)
    packets = standing(30, 60, attitude=(5.0, vehicle.attitude))
    first, second = (feed(packets, chosen) for _ in range(2))
    assert first.sent == second.sent
    assert "ALTITUDE" in first.names()
    assert first.pipeline.filter.state.tobytes() == second.pipeline.filter.state.tobytes()


@settings(deadline=None, max_examples=15)
@given(cuts=st.lists(st.integers(0, 10**9), max_size=200))
def test_cutting_the_stream_changes_nothing(cuts: list[int]) -> None:
    packets = standing(30, 40)
    whole = feed(packets)
    cut = stream(Pipeline(CompanionSettings()), b"".join(packet.data for packet in packets), cuts)
    assert cut == whole.sent


def test_an_observer_sees_and_does_not_disturb() -> None:
    packets = standing(30, 50, attitude=(5.0, vehicle.attitude))
    blind = Pipeline(CompanionSettings(), datagrams=True)
    sent = [frame for packet in packets for frame in blind.feed(packet)]
    seen = feed(packets)
    assert seen.sent == sent
    assert blind.verdicts == seen.pipeline.verdicts
    counted = np.zeros((len(Kind), len(Verdict)), int)
    for kind, _, verdict in seen.samples:
        counted[kind, verdict] += 1
    assert counted.tolist() == seen.pipeline.verdicts


def test_published_altitudes_are_those_on_the_wire() -> None:
    outcome = feed(standing())
    wire = [message for message in parsed(outcome.sent) if message.get_type() == "ALTITUDE"]
    assert [message.time_usec for message in wire] == [
        message.time_usec for message in outcome.altitudes
    ]


def test_nothing_is_sent_before_there_is_a_vehicle() -> None:
    outcome = feed(standing(30, 60, heartbeat=None))
    assert outcome.sent == []
    assert outcome.pipeline.identity.counters[Origin.EARLY] == 600
    (beat,) = parsed(outcome.pipeline.heartbeat())  # for peers that speak only to who spoke
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (1, 191)
    assert beat.system_status == mavlink.MAV_STATE_CRITICAL


def test_the_autopilots_own_altitude_and_truth_are_seen_but_not_used() -> None:
    """Whatever they say, our frames are the same."""

    class Comparison:
        heights: list[tuple[int, float, float]]

        def __init__(self) -> None:
            self.heights = []

        def sample(self, *_: Any) -> None:
            """Not of interest."""

        def published(self, _: Message) -> None:
            """Not of interest."""

        def truth(self, *height: Any) -> None:
            self.heights.append(height)

        autopilot = truth

    def position(boot_s: float) -> Message:
        return mavlink.MAVLink_global_position_int_message(
            round(boot_s * 1e3), 1, 1, 9_000_000, 0, 0, 0, 0, 0
        )

    def truth(boot_s: float) -> Message:
        names = mavlink.MAVLink_sim_state_message.fieldnames
        values = dict.fromkeys(names, 0.0) | {"lat_int": 0, "lon_int": 0, "alt": 8000.0}
        return mavlink.MAVLink_sim_state_message(**values)

    comparison = Comparison()
    settings = CompanionSettings().with_changes(publish={"altitude": "never"})
    pipeline = Pipeline(settings, datagrams=True, observer=comparison)
    packets = standing(30, 50, own=(5.0, position), truth=(5.0, truth))
    sent = [frame for packet in packets for frame in pipeline.feed(packet)]
    assert {height[1] for height in comparison.heights} == {9000.0, 8000.0}
    assert sent == feed(standing(30, 50), settings).sent


def test_commands_to_us_are_refused_others_are_not_ours() -> None:
    """We have no command; whoever asks is told so, and the vehicle's own are left alone."""
    pipeline = feed(standing(30, 35)).pipeline
    station = Vehicle(255, 190)

    def answers(system: int, component: int) -> list[Message]:
        request = mavlink.MAVLink_command_long_message(
            system, component, 400, 0, 1, 0, 0, 0, 0, 0, 0
        )
        return parsed(pipeline.feed(Packet(HOST_EPOCH_US, station.pack(request))))

    (answer,) = answers(1, 191)
    assert (answer.command, answer.result) == (400, mavlink.MAV_RESULT_UNSUPPORTED)
    assert (answer.target_system, answer.target_component) == (255, 190)
    for system, component in ((1, 1), (2, 191), (0, 0), (1, 0)):
        assert answers(system, component) == []


def test_a_lost_link_says_so_once() -> None:
    pipeline = feed(standing(30, 50)).pipeline
    assert pipeline.health.health is OK
    last_us = HOST_EPOCH_US + 50_000_000
    assert pipeline.age(last_us + 2_800_000) == []
    (text,) = parsed(pipeline.age(last_us + 3_000_000))
    assert text.text == "Kollsman LOST: nothing heard"
    assert pipeline.age(last_us + 3_100_000) == []
    (beat,) = parsed(pipeline.heartbeat())
    assert beat.system_status == mavlink.MAV_STATE_CRITICAL
    sent = [frame for packet in standing(53, 63) for frame in pipeline.feed(packet)]
    assert pipeline.health.health is OK
    assert "ALTITUDE" in [message.get_type() for message in parsed(sent)]


def test_our_ids_on_the_link_are_reported() -> None:
    seen: list[Frame] = []
    pipeline = feed(standing(30, 35)).pipeline
    pipeline.on_own_ids = seen.append
    ours = Vehicle(1, 191).pack(vehicle.heartbeat(type=18, autopilot=8))
    pipeline.feed(Packet(HOST_EPOCH_US, ours))
    pipeline.feed(
        Packet(HOST_EPOCH_US, Vehicle(1, 154).pack(vehicle.heartbeat(type=26, autopilot=8)))
    )
    assert [frame.component_id for frame in seen] == [191]


def test_configured_ids_are_on_every_frame() -> None:
    chosen = CompanionSettings().with_changes(identity={"system_id": 42, "component_id": 77})
    outcome = feed(standing(30, 40), chosen)
    messages = parsed([*outcome.sent, *outcome.pipeline.heartbeat()])
    assert {(message.get_srcSystem(), message.get_srcComponent()) for message in messages} == {
        (42, 77)
    }


def test_listeners_get_what_they_asked_for_of_the_vehicle_only() -> None:
    heard: list[Message] = []
    number = mavlink.MAVLINK_MSG_ID_VFR_HUD
    pipeline = Pipeline(CompanionSettings(), datagrams=True, listeners={number: heard.append})

    def hud(boot_s: float) -> Message:
        return mavlink.MAVLink_vfr_hud_message(0, 0, 0, 0, boot_s, 0)

    other = standing(34, 44, vehicle=Vehicle(2, 1), hud=(1.0, hud))
    for packet in merged(standing(30, 40, hud=(1.0, hud)), other):
        pipeline.feed(packet)
    assert len(heard) == 10


def test_highres_pressure_steps_in_where_there_is_no_scaled_one() -> None:
    """PX4 sends both: one barometer must not be measured twice."""
    both = standing(30, 60, imu=(10.0, vehicle.highres_imu))
    assert feed(both).count(Kind.PRESSURE, Verdict.USED) == pytest.approx(150, abs=2)
    fails = (5.0, lambda boot_s: vehicle.pressure(boot_s) if boot_s < 40 else None)
    after = feed(
        standing(
            30,
            60,
            imu=(10.0, vehicle.highres_imu),
            pressure=fails,
            clock=(1.0, vehicle.system_time),
        )
    )
    assert after.count(Kind.PRESSURE, Verdict.USED) == pytest.approx(50 + 180, abs=12)
    assert after.pipeline.health.health is OK


def test_an_estimator_that_uses_no_imu_is_not_fed_any() -> None:
    """Its samples are counted as ignored, and cost no more than that, unless an observer wants
    them."""
    pipeline = Pipeline(
        CompanionSettings().with_changes(estimator="adaptive-fusion"), datagrams=True
    )
    for packet in standing(30, 40):
        pipeline.feed(packet)
    assert pipeline.verdicts[Kind.IMU][Verdict.IGNORED] == pytest.approx(100, abs=2)


def test_a_reboot_is_one_word_and_a_new_start() -> None:
    outcome = feed([*standing(100, 130), *standing(5, 40)])
    texts = [message.text for message in parsed(outcome.sent) if message.get_type() == "STATUSTEXT"]
    assert [text.split(":")[0] for text in texts] == ["Kollsman OK", "Kollsman LOST", "Kollsman OK"]
    assert outcome.pipeline.intake.clock.reboots == 1
    local_m = [message.altitude_local for message in outcome.altitudes if message.time_usec < 50e6]
    assert local_m[0] == 0.0
    assert not any(math.isnan(value) for value in local_m)


def test_no_compiled_step_gets_a_member_of_an_enum() -> None:
    """Numba finds the type of such an argument anew at every call, in a quarter of a
    millisecond."""
    feed(standing(20, 60, attitude=(5.0, vehicle.attitude)), CompanionSettings())
    compiled = [
        (f"{module.__name__}.{name}", kept.signatures)
        for module in list(sys.modules.values())
        if module.__name__.startswith("companion.")
        for name, kept in vars(module).items()
        if hasattr(kept, "signatures")
    ]
    assert compiled or os.environ.get("NUMBA_DISABLE_JIT") == "1"
    assert [name for name, signatures in compiled if "Enum" in str(signatures)] == []


def test_a_pipeline_that_changes_a_step_takes_no_blocks() -> None:
    """Compiled loops call no overridden method."""

    class Same(Pipeline):
        estimates = False

        def extra(self) -> int:
            return 1

    class Mixed:
        def heartbeat(self) -> list[bytes]:
            return []

    class Changed(Same):
        def feed_item(self, item: Any, arrival_us: int) -> list[bytes]:
            return super().feed_item(item, arrival_us)

    class ByAncestor(Mixed, Pipeline):
        pass

    assert Same.in_blocks
    assert not Changed.in_blocks
    assert not ByAncestor.in_blocks
