"""Inputs that failed for others, and attacks on the estimator and the clock: each has the outcome
that the README of the shared data (`reported/`) says.

The recordings stay outside the repository; where they are absent, their tests are skipped. The
attacks change a flight of our own simulator, so a clean clone tests them too.
"""

import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from companion.evaluation.report import Collector
from companion.health import Health
from companion.logs.tlog import TlogReader
from companion.mavlink.codec import Message, mavlink
from companion.pipeline import Pipeline
from companion.replay.run import replay
from companion.samples import Kind, Packet, Rows, Verdict
from companion.settings import CompanionSettings
from tests.paths import DATA
from tests.vehicle import Vehicle, heartbeat

OK, DEGRADED, LOST = Health
FOLDER = DATA / "reported"
LIMIT_M = 50.0
BACK_S = 5.0
UNIX_US = 1_700_000_000_000_000

absent = pytest.mark.skipif(not FOLDER.exists(), reason="the recordings are not here")


@pytest.fixture(autouse=True)
def _heard(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lines of our log reach `caplog`, whatever a command's own logging set before."""
    for name in [name for name in logging.root.manager.loggerDict if name.startswith("kollsman")]:
        logger = logging.getLogger(name)
        monkeypatch.setattr(logger, "propagate", True)
        monkeypatch.setattr(logger, "disabled", False)
        caplog.set_level(logging.INFO, name)


class Seen(NamedTuple):
    """What a recording or a changed flight led to."""

    pipeline: Pipeline
    published_s: np.ndarray[Any, Any]
    error_m: np.ndarray[Any, Any]
    """of what was published, against truth"""

    @property
    def rmse_m(self) -> float:
        return float(np.sqrt(np.mean(self.error_m**2)))


def run(packets: Any, observer: Collector | None = None) -> Seen:
    """Feed packets as a replay does."""
    collector = observer if observer is not None else Collector()
    pipeline = Pipeline(CompanionSettings(), datagrams=True, observer=collector)
    for packet in packets:
        pipeline.feed(packet)
    times_us, altitudes_m = collector.track("published")
    truth_us, truth_m = collector.track("truth")
    if not times_us.size:
        return Seen(pipeline, times_us, altitudes_m)
    return Seen(pipeline, times_us * 1e-6, altitudes_m - np.interp(times_us, truth_us, truth_m))


class Case(NamedTuple):
    """The right outcome of a recording."""

    published: int
    """at least this many"""
    rmse_m: float
    health: tuple[Health, ...] = (OK,)
    vehicle: tuple[int, int] | None = (1, 1)
    reboots: int = 0
    told: str = ""
    """what a line of the log says"""
    first_s: float = np.inf
    """the first ALTITUDE at the latest, on the vehicle's clock"""
    pause_s: float = np.inf
    """the longest time between two ALTITUDE"""


CASES = {
    "control": Case(900, 2.0),
    "camera_generic_first": Case(900, 2.0),
    "antenna_tracker_first": Case(900, 2.0),
    "gps1_without_fix_gps2_good": Case(900, 3.0, (OK, DEGRADED), told="number 2 is used"),
    "baro1_no_data_baro2_good": Case(900, 2.0, told="number 2 is used"),
    "dop_99_99_with_fix": Case(900, 4.0, (OK, DEGRADED)),
    "pressure_stamp_zero": Case(600, 2.0),
    "two_links_one_3s_late": Case(400, 3.0, pause_s=0.25),
    "heartbeats_rare": Case(900, 2.0, pause_s=1.0),
    "two_noisy_barometers_before_fix": Case(600, 10.0),
}
"""Those that must be published, right, to the end."""


def recording(name: str) -> Seen:
    return run(TlogReader(FOLDER / f"{name}.tlog"))


@absent
@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_recording_is_published_right(name: str, caplog: pytest.LogCaptureFixture) -> None:
    case, seen = CASES[name], recording(name)
    assert seen.published_s.size >= case.published
    assert seen.rmse_m < case.rmse_m
    assert np.abs(seen.error_m).max() < LIMIT_M
    assert np.abs(seen.error_m[0]) < 10.0
    assert np.diff(seen.published_s).max() <= case.pause_s
    assert seen.pipeline.health.health in case.health
    assert seen.pipeline.identity.vehicle == case.vehicle
    assert seen.pipeline.intake.clock.reboots == case.reboots
    assert case.told in caplog.text


@absent
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "told"),
    [("altitude_is_ellipsoid", "intake.equal_heights"), ("altitude_zero_with_fix", "exactly 0")],
)
def test_a_height_that_is_none_is_told(
    name: str, told: str, caplog: pytest.LogCaptureFixture
) -> None:
    """47 m and 120 m off. Expected Result: one line says so; nothing 50 m wrong, never OK."""
    seen = recording(name)
    assert told in caplog.text
    assert seen.pipeline.health.health is not OK
    assert seen.error_m.size == 0 or np.abs(seen.error_m).max() < LIMIT_M


@absent
def test_another_system_id_takes_over(caplog: pytest.LogCaptureFixture) -> None:
    """1/1 falls silent after 45 s, 7/1 goes on. Expected Result: both are told; LOST at the end."""
    seen = recording("system_id_changes")
    assert "7/1" in caplog.text
    assert "1/1 lost at 75.0 s" in caplog.text
    assert seen.pipeline.health.health is LOST
    assert np.abs(seen.error_m).max() < LIMIT_M


@absent
def test_an_autopilot_with_system_id_zero_is_told(caplog: pytest.LogCaptureFixture) -> None:
    recording("system_id_zero")
    assert "an autopilot with system id 0/200 is heard" in caplog.text


@absent
def test_a_raw_capture_with_the_name_of_a_tlog() -> None:
    """Expected Result: read by the boot stamps, whole."""
    sessions = replay(FOLDER / "raw_capture_taken_for_tlog.tlog").report["sessions"]
    assert sessions[0]["altitude"]["published"] > 900


@absent
@pytest.mark.slow
def test_two_days_in_one_file() -> None:
    """Expected Result: the second flight is a new session, right within 5 s as the first."""
    seen = recording("two_days_in_one_file")
    assert seen.pipeline.intake.clock.reboots == 1
    assert np.abs(seen.error_m).max() < 10.0
    assert seen.published_s.size > 1000
    assert seen.pipeline.health.health is OK


@pytest.fixture(scope="module")
def hop(short_hop: Path) -> list[tuple[float, Message]]:
    """(seconds since the start, message) of a flight of our simulator, in order."""
    parser, found, start_us = mavlink.MAVLink(None), [], None
    for packet in TlogReader(short_hop):
        start_us = packet.time_us if start_us is None else start_us
        for message in parser.parse_buffer(packet.data) or []:
            found.append(((packet.time_us - start_us) * 1e-6, message))
    return found


def packets_of(
    flight: list[tuple[float, Message]],
    change: Callable[[float, str, dict[str, Any]], None],
    start_s: float = 0.0,
    end_s: float = np.inf,
) -> Iterator[Packet]:
    """The flight's packets, fields changed by `change(seconds, message name, fields)`."""
    packers: dict[tuple[int, int], Vehicle] = {}
    for time_s, message in flight:
        if not start_s <= time_s < end_s:
            continue
        fields = {name: getattr(message, name) for name in message.fieldnames}
        change(time_s, message.get_type(), fields)
        ids = (message.get_srcSystem(), message.get_srcComponent())
        packer = packers.setdefault(ids, Vehicle(*ids))
        made = type(message)(
            **{k: v.encode() if isinstance(v, str) else v for k, v in fields.items()}
        )
        yield Packet(UNIX_US + round(time_s * 1e6), packer.pack(made))


@pytest.mark.slow
@pytest.mark.parametrize(("step_m", "claimed_mm"), [(500, 1500), (300, 500), (100, 1)])
def test_a_receiver_that_lies(
    hop: list[tuple[float, Message]], step_m: int, claimed_mm: int
) -> None:
    """The receiver's height steps for 40 s with a good reported accuracy. Expected Result: nothing
    is published that is 50 m wrong; OK within seconds after the step ends."""

    def lie(time_s: float, name: str, fields: dict[str, Any]) -> None:
        if name == "GPS_RAW_INT" and 100.0 <= time_s < 140.0:
            fields["alt"] += step_m * 1000
            fields["v_acc"] = claimed_mm

    seen = run(packets_of(hop, lie))
    assert seen.published_s.size > 500
    assert np.abs(seen.error_m).max() <= LIMIT_M
    assert seen.pipeline.health.health is OK


@pytest.mark.slow
def test_a_long_gap_after_a_short_contact(hop: list[tuple[float, Message]]) -> None:
    """Heard for 5 s, then the vehicle's clock goes on by an hour. Expected Result: ALTITUDE within
    5 s after both sensors are back."""
    start_s, gap_s, offset_s = 60.0, 3600.0, 5.0

    def gap(time_s: float, name: str, fields: dict[str, Any]) -> None:
        if time_s < start_s + offset_s:
            return
        if "time_boot_ms" in fields:
            fields["time_boot_ms"] += int(gap_s * 1e3)
        if fields.get("time_usec"):
            fields["time_usec"] += int(gap_s * 1e6)

    seen = run(packets_of(hop, gap, start_s, start_s + 40.0))
    back_s = seen.published_s[seen.published_s > gap_s]
    assert back_s.size
    first_boot_s = back_s[0] - gap_s
    began_s = (
        next(
            m.time_boot_ms
            for t, m in hop
            if t >= start_s + offset_s and m.get_type() == "SCALED_PRESSURE"
        )
        * 1e-3
    )
    assert first_boot_s - began_s <= BACK_S


@pytest.mark.slow
def test_a_leap_second_learned_late(hop: list[tuple[float, Message]]) -> None:
    """UNIX stamps of GNSS are 1.01 s ahead for 40 s. Expected Result: GNSS is used again within 5 s
    after they are right."""

    class Uses(Collector):
        def __init__(self) -> None:
            super().__init__()
            self.used_s: list[float] = []

        def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
            super().sample(kind, row, verdict, estimate)
            if kind is Kind.GNSS and verdict is Verdict.USED:
                self.used_s.append(now_s)

    now_s = 0.0

    def leap(time_s: float, name: str, fields: dict[str, Any]) -> None:
        nonlocal now_s
        now_s = time_s
        if name == "GPS_RAW_INT":
            ahead_s = 1.01 if 100.0 < time_s < 140.0 else 0.0
            fields["time_usec"] = UNIX_US + round((time_s + ahead_s) * 1e6)

    observer = Uses()
    seen = run(packets_of(hop, leap), observer)
    assert next(used_s for used_s in observer.used_s if used_s >= 140.0) <= 140.0 + BACK_S
    assert np.abs(seen.error_m).max() <= LIMIT_M


def test_own_system_id() -> None:
    """`identity.system_id` is 200. Expected Result: a command to 200/191 is answered, one to 1/191
    is not."""
    pipeline = Pipeline(CompanionSettings().with_changes(identity={"system_id": 200}))
    pipeline.feed(Packet(UNIX_US, Vehicle(1, 1).pack(heartbeat())))
    station = Vehicle(255, 190)

    def answers(system_id: int) -> int:
        command = mavlink.MAVLink_command_long_message(
            system_id, 191, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0
        )
        return len(pipeline.feed(Packet(UNIX_US + 1, station.pack(command))))

    assert answers(200) == 1
    assert answers(1) == 0
