"""When a session had an altitude, and whether its vehicle stood still."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from companion.health import Health
from companion.replay.availability import at_rest, availability
from companion.replay.findings import before_origin
from companion.replay.record import RECORD
from companion.samples import Kind

SECONDS = 120
SECOND_PA = 12.0
"""of a metre, about"""


def session(
    heights_m: Any = 0.0, speed_mps: float = 0.1, armed: Any = ((0, False),), fixes: bool = True
) -> Any:
    """A session of one barometer sample and fix a second."""
    rows = np.zeros(SECONDS, RECORD)
    rows["time_us"] = rows["now_us"] = rows["arrival_us"] = np.arange(SECONDS) * 1_000_000
    rows["pressure_pa"] = 100_000.0 - SECOND_PA * np.broadcast_to(heights_m, SECONDS)
    rows["ground_speed_mps"] = speed_mps
    kinds = {Kind.PRESSURE: rows, Kind.GNSS: rows if fixes else rows[:0]}
    return SimpleNamespace(
        armed=list(armed), of=kinds.get, ticks=lambda: rows, unix_offset_us=1_600_000_000_000_000
    )


def rests(recording: Any, from_s: float = 0.0) -> bool:
    return at_rest(recording, from_s * 1e6, SECONDS * 1e6)


def test_a_disarmed_vehicle_that_does_not_move_is_at_rest() -> None:
    warming_m = np.linspace(0.0, 3.0, SECONDS)
    assert rests(session(warming_m))
    assert rests(session(warming_m, fixes=False))


@pytest.mark.parametrize(
    "moving",
    [
        session(armed=[(0, True)]),
        session(armed=[(0, False), (30_000_000, True)]),
        session(armed=[]),  # nothing is known
        session(speed_mps=3.0),
        session(np.linspace(0.0, 40.0, SECONDS)),
        session(np.where(np.arange(SECONDS) < 60, 0.0, 5.0)),  # carried up a stair
    ],
)
def test_every_sign_of_motion_counts(moving: Any) -> None:
    assert not rests(moving)


def test_after_the_flight_it_rests_again() -> None:
    flown = session(armed=[(0, False), (10_000_000, True), (60_000_000, False)])
    assert not rests(flown)
    assert rests(flown, 61.0)


def health(*spans: tuple[int, int]) -> dict[str, Any]:
    """The availability of a session that is LOST in the spans of seconds."""
    recording = session()
    rows = recording.ticks()
    for start, end in spans:
        rows["health"][start:end] = Health.LOST
    return availability(recording, rows)


@pytest.mark.parametrize(("field_m", "count"), [(600.0, 40), (0.0, 0)])
def test_altitudes_before_the_autopilot_has_an_origin(field_m: float, count: int) -> None:
    """It sends 0 m above its start at first; on a field at sea level that is right."""
    us = np.arange(120) * 1e6
    own_m = np.where(np.arange(120) < 40, 0.5, field_m + 0.5)
    tracks = {
        "autopilot": (us, own_m),
        "estimate": (us, np.full(120, field_m)),
        "baro": (us, np.full(120, field_m + 80.0)),
    }
    recording: Any = SimpleNamespace(track=tracks.get)
    assert before_origin(recording) == count


def test_what_is_lost_before_the_first_altitude_is_no_loss() -> None:
    found = health((0, 8))
    assert found == {"at_last_height": "OK", "first_s": 8.0, "lost": []}


def test_each_loss_has_its_time() -> None:
    found = health((0, 8), (40, 50), (110, SECONDS))
    assert [(each["from_s"], each["duration_s"]) for each in found["lost"]] == [
        (39.0, 11.0),
        (109.0, 10.0),
    ]
    assert found["lost"][0]["from_utc"].startswith("2020-09-13T12:27:19")
    assert found["at_last_height"] == "LOST"


def test_a_gap_is_a_loss_without_data() -> None:
    recording = session()
    rows = np.concatenate([recording.ticks()[:30], recording.ticks()[60:]])
    found = availability(recording, rows)
    assert [each["silent"] for each in found["lost"]] == [True]


def test_a_session_that_is_all_lost() -> None:
    assert health((0, SECONDS)) == {"at_last_height": "LOST", "first_s": None, "lost": []}


def test_late_copies_are_no_loss() -> None:
    """Each sample arrives again three seconds and a half later."""
    recording = session()
    rows = np.repeat(recording.ticks(), 2)
    rows["time_us"][1::2] -= 3_500_000
    assert availability(recording, rows)["lost"] == []
