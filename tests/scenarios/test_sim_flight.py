"""Flights on JSBSim: they track their profile, obey physics, and repeat to the byte."""

import hashlib
import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.clock import ManualClock
from companion.config import validate
from companion.errors import SimulationError
from companion.links.memory import pair
from companion.logs.tlog import TlogReader
from companion.mavlink.codec import Decoder
from sim import BOOT_UNIX_US
from sim.aircraft_state import Controls, Motion, Truth
from sim.flight import Flight, Progress
from sim.pilot.autopilot import Target
from sim.pilot.profile import Climb, Descend, Hold, Leg, TakeOff
from sim.scenario import Scenario, load_scenario
from sim.vehicle.flavours import FlavourName

BASE = {"name": "test", "summary": "of a test", "profile": [{"leg": "wait", "duration_s": 20}]}


def scenario(**changes: Any) -> Scenario:
    return validate({**BASE, **changes}, Scenario, "a test")


@dataclass
class Row:
    truth: Truth
    motion: Motion
    leg: Leg
    leg_time_s: float


def flown(flight: Flight) -> list[Row]:
    """Fly to the end, keeping truth and motion at 50 Hz and which leg they belong to."""
    rows: list[Row] = []
    leg, since_us = flight.profile.leg, 0
    while not flight.profile.done:
        flight.tick()
        state = flight.vehicle.state
        if flight.profile.leg is not leg:
            leg, since_us = flight.profile.leg, flight.time_us
        if (
            state.truth is not None
            and state.motion is not None
            and state.truth.time_us == flight.time_us
        ):
            rows.append(Row(state.truth, state.motion, leg, (flight.time_us - since_us) * 1e-6))
    return rows


@pytest.fixture(scope="module")
def hop() -> list[Row]:
    return flown(Flight(load_scenario("short-hop")))


def altitude_errors(rows: list[Row], settled_s: float) -> np.ndarray[Any, Any]:
    """Error in level flight, once the level-off or turn is over."""
    target_m = math.nan
    errors = []
    for row in rows:
        if isinstance(row.leg, Climb | Descend):
            target_m = row.leg.altitude_amsl_m
        elif isinstance(row.leg, Hold) and row.leg_time_s > settled_s:
            errors.append(row.truth.altitude_amsl_m - target_m)
    return np.array(errors)


def assert_flies_well(rows: list[Row], minimum_mps: float) -> None:
    """Never slow, never steep once it has left the runway."""
    airborne = [row.truth for row in rows if isinstance(row.leg, Climb | Hold | Descend)]
    assert min(truth.airspeed_mps for truth in airborne) > minimum_mps
    assert max(abs(math.degrees(truth.roll_rad)) for truth in airborne) < 40.0
    assert max(abs(math.degrees(truth.pitch_rad)) for truth in airborne) < 25.0


def test_the_hop_tracks_its_profile(hop: list[Row]) -> None:
    errors = altitude_errors(hop, 25.0)
    assert np.abs(errors).max() < 1.0
    assert_flies_well(hop, 34.0)
    descent = [row for row in hop if isinstance(row.leg, Descend)]
    steady = [
        row.truth.climb_mps
        for row in descent
        if row.leg_time_s > 12.0 and row.truth.altitude_amsl_m > 440.0
    ]
    assert steady
    assert np.abs(np.array(steady) + 3.0).max() < 0.3
    end = hop[-1].truth
    assert math.degrees(end.yaw_rad) == pytest.approx(180.0, abs=3.0)


def test_the_take_off_is_one(hop: list[Row]) -> None:
    run = [row.truth for row in hop if isinstance(row.leg, TakeOff)]
    on_ground = [truth for truth in run if truth.on_ground]
    lift_off = on_ground[-1]
    assert run[0].airspeed_mps < 0.5
    assert 26.0 < lift_off.airspeed_mps < 36.0
    assert (
        max(abs(math.degrees(truth.yaw_rad) - 90.0) for truth in on_ground) < 3.0
    )  # it stays on the runway
    after = [truth for truth in run if truth.time_us > lift_off.time_us]
    assert min(truth.climb_mps for truth in after) > -0.1


def test_the_mean_specific_force_integrates_to_the_climb(hop: list[Row]) -> None:
    """a_down = f_down + g - 2 Omega v_east cos(lat) - v^2 / R, summed over the climb: 50 Hz means
    lose nothing."""
    rows = [row for row in hop if isinstance(row.leg, TakeOff | Climb)]
    rate, dt_s = 7.292115e-5, 0.02
    sin2 = math.sin(math.radians(47.0)) ** 2
    climb_mps, drift = -rows[0].truth.down_mps, []
    for before, row in pairwise(rows):
        truth = row.truth
        roll = 0.5 * (before.truth.roll_rad + truth.roll_rad)
        pitch = 0.5 * (before.truth.pitch_rad + truth.pitch_rad)
        forward, right, down = row.motion.specific_force_b_mps2
        force_down = -math.sin(pitch) * forward + math.cos(pitch) * (
            math.sin(roll) * right + math.cos(roll) * down
        )
        gravity = (
            9.7803253359 * (1 + 0.00193185265241 * sin2) / math.sqrt(1 - 0.00669437999013 * sin2)
        )
        gravity -= 3.086e-6 * truth.altitude_amsl_m
        speed2 = truth.north_mps**2 + truth.east_mps**2
        eotvos = 2 * rate * truth.east_mps * math.cos(math.radians(47.0)) + speed2 / 6.38e6
        climb_mps -= (force_down + gravity - eotvos) * dt_s
        drift.append(climb_mps - truth.climb_mps)
    assert len(rows) > 2000
    assert abs(drift[-1]) < 0.15  # over 50 s: 3 mm/s2, of 9.8
    assert np.abs(drift).max() < 0.3


def log_hash(path: Path, **changes: Any) -> str:
    Flight(scenario(**changes), tlog=path).run()
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_same_seed_same_bytes_and_another_seed_others(tmp_path: Path) -> None:
    rough = {
        "profile": [{"leg": "wait", "duration_s": 5}, {"leg": "take_off", "height_m": 30}],
        "weather": {"turbulence": {"severity": 4, "wind_at_6m_mps": 8}, "wind": {"speed_mps": 5}},
    }
    first = log_hash(tmp_path / "a.tlog", **rough, seed=5)
    assert log_hash(tmp_path / "b.tlog", **rough, seed=5) == first
    assert log_hash(tmp_path / "c.tlog", **rough, seed=6) != first


def payloads(path: Path) -> dict[str, list[bytes]]:
    """Messages by name, without the header (sequence numbers) and the checksum."""
    decoder = Decoder()
    found: dict[str, list[bytes]] = {}
    for packet in TlogReader(path):
        for frame in decoder.feed(packet.data):
            name = decoder.decode(frame).get_type()  # type: ignore[union-attr]
            found.setdefault(name, []).append(frame.data[10:-2])
    return found


OWN = ("GLOBAL_POSITION_INT", "VFR_HUD")
"""what the vehicle's own estimate says"""


@pytest.mark.parametrize(
    ("sensor", "changed"),
    [
        ("barometer", {"SCALED_PRESSURE", *OWN, "HOME_POSITION"}),  # the origin is of a height, too
        ("gnss", {"GPS_RAW_INT", *OWN, "HOME_POSITION"}),
        ("imu", {"RAW_IMU"}),
        ("estimate", {"ATTITUDE", *OWN}),  # which carry the heading
    ],
)
def test_one_sensor_s_seed_changes_that_sensor_alone(
    sensor: str, changed: set[str], tmp_path: Path
) -> None:
    paths = (tmp_path / "a.tlog", tmp_path / "b.tlog")
    for path, seed in zip(paths, (11, 12), strict=True):
        Flight(scenario(seed=3, sensors={sensor: {"seed": seed}}), tlog=path).run()
    first, second = (payloads(path) for path in paths)
    assert first.keys() == second.keys()
    assert {name for name in first if first[name] != second[name]} == changed


def test_truth_follows_a_message_that_carries_its_time(tmp_path: Path) -> None:
    for streams in ({}, {"RAW_IMU": 0.0}, {"RAW_IMU": 10.0, "SIM_STATE": 50.0}):
        path = tmp_path / "log.tlog"
        Flight(scenario(streams_hz=streams), tlog=path).run()
        decoder, before, count = Decoder(), "", 0
        for packet in TlogReader(path):
            name = decoder.decode(decoder.feed(packet.data)[0]).get_type()  # type: ignore[union-attr]
            if name == "SIM_STATE":
                count += 1
                assert before in ("RAW_IMU", "ATTITUDE")
            before = name
        assert count > 190


def test_the_log_is_stamped_with_simulated_time(tmp_path: Path) -> None:
    path = tmp_path / "log.tlog"
    summary = Flight(scenario(), tlog=path).run()
    times = [packet.time_us for packet in TlogReader(path)]
    assert times == sorted(times)
    assert times[0] - BOOT_UNIX_US == 10_000
    assert times[-1] - BOOT_UNIX_US == summary.duration_s * 1e6
    assert summary.sent.total() == len(times)
    assert summary.sent["RAW_IMU"] == pytest.approx(50 * summary.duration_s, abs=2)
    assert summary.sent["SCALED_PRESSURE"] == pytest.approx(20 * summary.duration_s, abs=2)


class JumpyClock(ManualClock):
    """Once, the host stands still for ten seconds."""

    def __init__(self) -> None:
        super().__init__()
        self.slept_s = 0.0

    def sleep_s(self, duration_s: float) -> None:
        first = self.slept_s == 0.0
        self.slept_s += duration_s
        super().sleep_s(duration_s + 10.0 if first else duration_s)


@pytest.mark.parametrize("speed", [1.0, 20.0, 0.5])
def test_the_pace_is_kept_on_the_injected_clock(speed: float) -> None:
    clock = ManualClock()
    begun_us = clock.now_us()
    link, _ = pair(clock)
    summary = Flight(scenario(), links=[link], speed=speed, clock=clock).run()
    assert (clock.now_us() - begun_us) * 1e-6 == pytest.approx(summary.duration_s / speed, abs=0.02)


def test_time_lost_by_the_host_is_not_rushed_after() -> None:
    clock = JumpyClock()
    link, _ = pair(clock)
    summary = Flight(scenario(), links=[link], speed=1.0, clock=clock).run()
    assert clock.slept_s == pytest.approx(summary.duration_s, abs=0.05)


def test_as_fast_as_possible_never_sleeps(tmp_path: Path) -> None:
    clock = ManualClock()
    begun_us = clock.now_us()
    Flight(scenario(), tlog=tmp_path / "log.tlog", clock=clock).run()
    assert clock.now_us() == begun_us


def test_a_stopped_flight_leaves_a_whole_log(tmp_path: Path) -> None:
    flight = Flight(scenario(), tlog=tmp_path / "log.tlog")
    summary = flight.run(lambda progress: flight.stop() if progress.time_s >= 3.0 else None)
    assert not summary.completed
    assert summary.duration_s == pytest.approx(3.0)
    reader = TlogReader(tmp_path / "log.tlog")
    assert len(list(reader)) == summary.sent.total()
    assert reader.counters.total() == 0


def test_flying_into_the_ground_ends_the_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    flight = Flight(load_scenario("short-hop"))
    while flight.time_us < 70e6:
        flight.tick()
    fly = flight.autopilot.update

    def nose_down(truth: Truth, target: Target) -> Controls:
        return fly(truth, target)._replace(elevator=-0.3)

    monkeypatch.setattr(flight.autopilot, "update", nose_down)
    with pytest.raises(
        SimulationError, match=r"^at \d+\.\d\d s the aircraft (hit|is below) the ground"
    ):
        flight.run()


def test_a_flight_that_does_not_end_is_an_error() -> None:
    with pytest.raises(
        SimulationError, match=r"'test' has not ended after limit_s = 5 s, in 'Standing'"
    ):
        Flight(scenario(limit_s=5.0)).run()


@pytest.mark.long
def test_twenty_calm_minutes() -> None:
    rows = flown(Flight(load_scenario("calm-circuit")))
    assert np.abs(altitude_errors(rows, 25.0)).max() < 2.0
    assert_flies_well(rows, 34.0)
    assert 1100.0 < len(rows) * 0.02 < 1400.0


@pytest.mark.long
@pytest.mark.parametrize("seed", [1])
def test_twenty_minutes_of_changing_weather(seed: int) -> None:
    flight = Flight(load_scenario("weather-change"), seed=seed)
    rows = flown(flight)
    errors = altitude_errors(rows, 25.0)
    assert np.abs(errors).max() < 30.0
    assert math.sqrt(np.mean(errors**2)) < 8.0
    assert_flies_well(rows, 25.7)  # the clean stall: 50 kt
    # The vehicle's own height follows its barometer, and the front takes it tens of metres away.
    state = flight.vehicle.state
    assert state.position is not None
    assert state.truth is not None
    assert state.position.altitude_amsl_m - state.truth.altitude_amsl_m > 15.0


# The truth of the air four times a second, and a station: both read the weather in mid-second.
STATION_IN_FALLING_PRESSURE = scenario(
    name="falling-pressure",
    profile=[{"leg": "wait", "duration_s": 60}],
    weather={"pressure": [{"time_s": t, "sea_level_hpa": 1020 - t} for t in (0, 60)]},
    ground_station={"rate_hz": 2},
    streams_hz={"DEBUG_FLOAT_ARRAY": 4},
)


@pytest.mark.parametrize(
    ("case", "flavour"),
    [
        (load_scenario("short-hop"), "px4"),
        (load_scenario("lossy-radio"), None),
        (STATION_IN_FALLING_PRESSURE, None),
    ],
    ids=lambda case: getattr(case, "name", case),
)
def test_blocks_of_ticks_give_the_bytes_of_single_ticks(
    case: Scenario, flavour: FlavourName | None, tmp_path: Path
) -> None:
    """`run` flies up to a second before the sensors take it; `tick` takes each tick at once."""
    end_us, logs = 25_000_000, (tmp_path / "blocks.tlog", tmp_path / "ticks.tlog")
    in_blocks, by_ticks = (Flight(case, tlog=path, flavour=flavour) for path in logs)

    def stop(progress: Progress) -> None:
        if progress.time_s * 1e6 >= end_us:
            in_blocks.stop()

    assert in_blocks.run(stop).sent_bytes > 100_000
    while by_ticks.time_us < end_us:
        by_ticks.tick()
    by_ticks.stop()
    by_ticks.run()
    assert logs[0].read_bytes() == logs[1].read_bytes()
