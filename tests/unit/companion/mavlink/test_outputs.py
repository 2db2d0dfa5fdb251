"""What we send: the fields of ALTITUDE, when it is sent and when not, the DEBUG family, texts, the
version."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.estimators import ESTIMATORS
from companion.health import Health
from companion.kernels.atmosphere import baro_altitude_m
from companion.mavlink.codec import Encoder, Message, mavlink
from companion.mavlink.continuity import Leap, Monotonic
from companion.mavlink.debug import NAMED, state_floats
from companion.mavlink.outputs import Outputs, heartbeat
from companion.mavlink.schedule import Schedule
from companion.mavlink.sections import PublishSettings
from companion.mavlink.texts import StatusTexts
from companion.samples import ESTIMATE, Kind, Rows, Verdict, rows, sample
from companion.settings import CompanionSettings
from tests import vehicle
from tests.flights import standard_pressure_pa
from tests.vehicle import (
    ALTITUDE_M,
    Outcome,
    Vehicle,
    feed,
    home,
    merged,
    parsed,
    pressure,
    standing,
)

NAN = math.nan
SECOND_US = 1_000_000


def pascals(altitude_m: float) -> float:
    return float(standard_pressure_pa(np.array(altitude_m), 101_325.0))


def configured(**publish: Any) -> CompanionSettings:
    return CompanionSettings().with_changes(publish=publish)


def estimate(
    time_s: float = 10.0, altitude_m: float = 500.0, sd_m: float = 2.0, **fields: float
) -> Rows:
    row = rows(ESTIMATE)
    row["time_us"], row["altitude_amsl_m"], row["altitude_sd_m"] = (
        round(time_s * SECOND_US),
        altitude_m,
        sd_m,
    )
    row["climb_mps"] = 0.0
    for name, value in fields.items():
        row[name] = value
    return row


class Bench:
    """Outputs, and a vehicle at 500 m whose estimate follows."""

    def __init__(self, **publish: Any) -> None:
        self.outputs = Outputs(PublishSettings(**publish))

    def take(self, kind: Kind, time_s: float, altitude_m: float = 500.0, **values: Any) -> None:
        row = sample(kind, round(time_s * SECOND_US), **values)
        self.outputs.sample(kind, row, Verdict.USED, estimate(time_s, altitude_m))

    def altitude(
        self, time_s: float, altitude_m: float = 500.0, health: Health = Health.OK
    ) -> Message | None:
        return self.outputs.altitude(
            round(time_s * SECOND_US), health, estimate(time_s, altitude_m)
        )

    def field(self, name: str, time_s: float, altitude_m: float = 500.0) -> float:
        message = self.altitude(time_s, altitude_m)
        assert message is not None
        return float(getattr(message, name))


class TestMonotonic:
    def test_it_begins_at_zero_and_follows_the_barometer(self) -> None:
        monotonic = Monotonic()
        for tick, height_m in enumerate([500.0, 510.0, 490.0, 540.0]):
            monotonic.update(1, 0, tick * SECOND_US, pascals(height_m))
            assert monotonic.altitude_m == pytest.approx(height_m - 500.0, abs=1e-6)

    @pytest.mark.parametrize("pressure_after_pa", [pascals(510.0), pascals(800.0), 50_500.0])
    def test_a_reboot_leaves_no_step(self, pressure_after_pa: float) -> None:
        monotonic = Monotonic()
        monotonic.update(1, 0, 100 * SECOND_US, pascals(500.0))
        monotonic.update(1, 0, 101 * SECOND_US, pascals(510.0))
        monotonic.update(2, 0, 3 * SECOND_US, pressure_after_pa)
        assert monotonic.altitude_m == pytest.approx(10.0)

    def test_a_second_barometer_that_is_always_there_changes_nothing(self) -> None:
        """Two used in turn, 8 m apart: their offset is not motion, and the motion is not lost in
        joining."""
        monotonic = Monotonic()
        for tick in range(100):
            climbed_m = float(tick)
            monotonic.update(1, 0, tick * 100_000, pascals(500.0 + climbed_m))
            monotonic.update(1, 1, tick * 100_000 + 50_000, pascals(508.0 + climbed_m))
            assert monotonic.altitude_m == pytest.approx(climbed_m, abs=1e-6)

    def test_a_second_barometer_takes_over_without_a_step(self) -> None:
        monotonic = Monotonic()
        monotonic.update(1, 0, 0, pascals(500.0))
        monotonic.update(1, 1, 1 * SECOND_US, pascals(560.0))
        assert monotonic.altitude_m == 0.0
        monotonic.update(1, 1, 3 * SECOND_US, pascals(565.0))
        assert monotonic.altitude_m == pytest.approx(0.0)
        monotonic.update(1, 1, 4 * SECOND_US, pascals(570.0))
        assert monotonic.altitude_m == pytest.approx(5.0)

    def test_a_jump_of_a_faulty_one_is_no_step(self) -> None:
        monotonic = Monotonic()
        monotonic.update(1, 0, 0, 50_500.0)
        monotonic.update(1, 0, 60 * SECOND_US, pascals(500.0))
        assert monotonic.altitude_m == pytest.approx(0.0)
        monotonic.update(1, 0, 61 * SECOND_US, pascals(512.0))
        assert monotonic.altitude_m == pytest.approx(12.0)

    def test_a_fast_descent_is_no_jump(self) -> None:
        monotonic = Monotonic()
        for second in range(60):
            monotonic.update(1, 0, second * SECOND_US, pascals(8000.0 - 100.0 * second))
        assert monotonic.altitude_m == pytest.approx(-5900.0, abs=1e-3)

    def test_without_a_barometer_it_is_unknown(self) -> None:
        monotonic = Monotonic()
        assert math.isnan(monotonic.at(0))
        monotonic.update(1, 0, 0, pascals(500.0))
        assert monotonic.at(2 * SECOND_US) == 0.0
        assert math.isnan(monotonic.at(2 * SECOND_US + 1))

    @settings(deadline=None, max_examples=50)
    @given(
        st.lists(
            st.tuples(
                st.sampled_from(["same", "reboot", "other", "fault"]),
                st.floats(-40, 40),
                st.floats(300, 60_000),
            ),
            max_size=40,
        )
    )
    def test_whatever_happens_it_moves_no_further_than_a_barometer_can(
        self, events: list[tuple[str, float, float]]
    ) -> None:
        monotonic, boots, instance, time_us, height_m = Monotonic(), 1, 0, 0, 500.0
        monotonic.update(boots, instance, time_us, pascals(height_m))
        for event, move_m, fault_pa in events:
            before_m = monotonic.altitude_m
            boots += event == "reboot"
            instance = 1 - instance if event == "other" else instance
            time_us = 0 if event == "reboot" else time_us + SECOND_US
            height_m += move_m
            monotonic.update(
                boots, instance, time_us, fault_pa if event == "fault" else pascals(height_m)
            )
            assert abs(monotonic.altitude_m - before_m) <= 110.0 + 1e-6


class TestFields:
    def test_amsl_is_the_estimate_and_time_is_its_own(self) -> None:
        message = Bench().altitude(12.25, 512.5)
        assert message is not None
        assert (message.time_usec, message.altitude_amsl) == (12_250_000, 512.5)

    def test_local_begins_at_zero(self) -> None:
        bench = Bench()
        assert bench.field("altitude_local", 10.0, 500.0) == 0.0
        assert bench.field("altitude_local", 11.0, 530.0) == pytest.approx(30.0)
        bench.outputs.restart()
        assert bench.field("altitude_local", 1.0, 540.0) == 0.0

    def test_local_counts_from_the_first_valid_estimate_even_while_silent(self) -> None:
        bench = Bench()
        bench.outputs.vehicle_altitude(10 * SECOND_US)
        assert bench.altitude(10.0, 500.0) is None
        assert bench.field("altitude_local", 20.0, 520.0) == pytest.approx(20.0)

    def test_relative_is_unknown_without_home_and_arming(self) -> None:
        assert math.isnan(Bench().field("altitude_relative", 10.0))

    def test_relative_is_above_home(self) -> None:
        bench = Bench()
        bench.take(Kind.HOME, 10.0, altitude_amsl_m=430.0)
        assert bench.field("altitude_relative", 10.0, 500.0) == pytest.approx(70.0)
        bench.take(Kind.HOME, 11.0, altitude_amsl_m=450.0)
        assert bench.field("altitude_relative", 11.0, 500.0) == pytest.approx(50.0)

    def test_relative_is_above_the_arming_point_without_home(self) -> None:
        bench = Bench()
        bench.take(Kind.STATUS, 10.0, 500.0, armed=0)
        bench.take(Kind.STATUS, 11.0, 501.0, armed=1)
        bench.take(Kind.STATUS, 12.0, 520.0, armed=1)
        assert bench.field("altitude_relative", 12.0, 521.0) == pytest.approx(20.0)
        bench.take(Kind.HOME, 13.0, altitude_amsl_m=400.0)
        assert bench.field("altitude_relative", 13.0, 521.0) == pytest.approx(121.0)

    def test_a_vehicle_met_in_the_air_was_not_armed_here(self) -> None:
        bench = Bench()
        bench.take(Kind.STATUS, 10.0, 900.0, armed=1)
        bench.take(Kind.STATUS, 11.0, 900.0, armed=-1)
        bench.take(Kind.STATUS, 12.0, 900.0, armed=1)
        assert math.isnan(bench.field("altitude_relative", 12.0, 900.0))

    def test_the_arming_point_of_an_old_estimate_is_unknown(self) -> None:
        bench = Bench()
        bench.take(Kind.STATUS, 10.0, armed=0)
        row = sample(Kind.STATUS, 20 * SECOND_US, armed=1)
        bench.outputs.sample(Kind.STATUS, row, Verdict.USED, estimate(12.0))
        assert math.isnan(bench.field("altitude_relative", 20.0))

    def test_a_reboot_voids_home_and_arming_point(self) -> None:
        bench = Bench()
        bench.take(Kind.HOME, 10.0, altitude_amsl_m=430.0)
        bench.outputs.restart()
        assert math.isnan(bench.field("altitude_relative", 1.0))

    @pytest.mark.parametrize("home_m", [NAN, -1500.0, 20_000.0])
    def test_an_absurd_home_is_not_believed(self, home_m: float) -> None:
        bench = Bench()
        bench.take(Kind.HOME, 10.0, altitude_amsl_m=home_m)
        assert math.isnan(bench.field("altitude_relative", 10.0))

    def clearance(self, bench: Bench, time_s: float = 10.0) -> float:
        message = bench.altitude(time_s)
        assert message is not None
        assert message.bottom_clearance == pytest.approx(message.altitude_terrain, nan_ok=True)
        return float(message.bottom_clearance)

    def test_clearance_by_a_range_finder(self) -> None:
        bench = Bench()
        assert math.isnan(self.clearance(bench, 9.0))
        bench.take(Kind.RANGE, 10.0, distance_m=20.0, downward=1)
        assert self.clearance(bench) == pytest.approx(20.0)

    @pytest.mark.parametrize(
        ("roll_deg", "pitch_deg", "expected_m"),
        [(60, 0, 10.0), (0, -60, 10.0), (45, 45, 10.0), (0, 0, 20.0), (180, 0, NAN), (NAN, 0, NAN)],
    )
    def test_clearance_is_corrected_for_tilt(
        self, roll_deg: float, pitch_deg: float, expected_m: float
    ) -> None:
        bench = Bench()
        bench.take(Kind.RANGE, 10.0, distance_m=20.0, downward=1)
        bench.take(
            Kind.ATTITUDE, 10.0, roll_rad=math.radians(roll_deg), pitch_rad=math.radians(pitch_deg)
        )
        assert self.clearance(bench) == pytest.approx(expected_m, nan_ok=True)

    def test_a_range_finder_that_looks_elsewhere_saw_nothing_or_fell_silent(self) -> None:
        forward, blind, old = Bench(), Bench(), Bench()
        forward.take(Kind.RANGE, 10.0, distance_m=20.0, downward=0)
        blind.take(Kind.RANGE, 9.9, distance_m=20.0, downward=1)
        blind.take(Kind.RANGE, 10.0, distance_m=NAN, downward=1)
        old.take(Kind.RANGE, 8.9, distance_m=20.0, downward=1)
        assert all(math.isnan(self.clearance(bench)) for bench in (forward, blind, old))


class TestWhen:
    @settings(deadline=None, max_examples=50)
    @given(
        rate_hz=st.floats(0.5, 50),
        steps=st.lists(st.integers(1_000, 400_000), min_size=5, max_size=200),
    )
    def test_slots_never_exceed_the_rate_and_take_the_first_update(
        self, rate_hz: float, steps: list[int]
    ) -> None:
        schedule, period_us = Schedule(rate_hz), round(1e6 / rate_hz)
        now_us, taken = 5_000_000, []
        for step_us in steps:
            now_us += step_us
            if schedule.takes(now_us):
                taken.append(now_us)
            else:
                assert now_us < taken[-1] + period_us
        assert len(taken) - 1 <= (now_us - taken[0]) / period_us + 1

    @pytest.mark.parametrize(
        ("updates_hz", "rate_hz", "expected_hz"),
        [(20, 10, 10), (50, 10, 10), (5, 10, 5), (25, 10, 10)],
    )
    def test_rate_on_vehicle_time(
        self, updates_hz: float, rate_hz: float, expected_hz: float
    ) -> None:
        schedule = Schedule(rate_hz)
        taken = sum(
            schedule.takes(round(tick * 1e6 / updates_hz))
            for tick in range(round(100 * updates_hz))
        )
        assert taken == pytest.approx(100 * expected_hz, rel=0.01)

    def test_a_clock_that_went_back_starts_anew(self) -> None:
        schedule = Schedule(10)
        assert schedule.takes(500 * SECOND_US)
        assert schedule.takes(3 * SECOND_US)
        assert not schedule.takes(3 * SECOND_US + 50_000)

    def test_lost_is_silent(self) -> None:
        bench = Bench(altitude="always")
        assert bench.altitude(10.0, health=Health.LOST) is None
        assert bench.altitude(10.1, altitude_m=NAN) is None
        assert bench.altitude(10.2, health=Health.DEGRADED) is not None

    def test_never_is_never(self) -> None:
        bench = Bench(altitude="never")
        assert all(bench.altitude(10.0 + tick) is None for tick in range(5))

    def test_auto_leaves_the_word_to_a_vehicle_that_sends_altitude(self) -> None:
        bench, always = Bench(altitude="auto"), Bench(altitude="always")
        for each in (bench, always):
            each.outputs.vehicle_altitude(10 * SECOND_US)
        assert bench.altitude(10.0) is None
        assert bench.altitude(14.9) is None
        assert bench.altitude(15.0) is not None
        assert always.altitude(10.0) is not None

    def test_auto_on_a_stream(self) -> None:
        """PX4 sends 141 itself: ours stops, the DEBUG family goes on."""
        theirs = (
            2.0,
            lambda boot_s: mavlink.MAVLink_altitude_message(round(boot_s * 1e6), 0, 1, 2, 3, 4, 5),
        )
        outcome = feed(standing(30, 50, altitude=theirs))
        assert outcome.names().count("ALTITUDE") <= 1
        assert outcome.names().count("NAMED_VALUE_FLOAT") > 10

    def test_our_own_altitude_that_comes_back_silences_nobody(self) -> None:
        ours = (5.0, lambda boot_s: mavlink.MAVLink_altitude_message(1, 0, 1, 2, 3, 4, 5))
        silent: Any = dict.fromkeys(("heartbeat", "pressure", "gps", "imu"))
        echo = standing(30, 50, vehicle=Vehicle(1, 191), altitude=ours, **silent)
        assert feed(merged(standing(30, 50), echo)).names().count("ALTITUDE") > 50


class TestLeap:
    def heard(self, heights_m: list[float], step_s: float = 0.2) -> list[bool]:
        """Which of a row of altitudes may go out."""
        leap = Leap()
        return [
            not leap.withholds(round((10 + number * step_s) * SECOND_US), height_m)
            for number, height_m in enumerate(heights_m)
        ]

    def test_a_single_leap_is_withheld(self) -> None:
        assert self.heard([500, 501, 1040, 502, 503]) == [True, True, False, True, True]

    def test_one_that_stays_is_published_after_two_seconds(self) -> None:
        heard = self.heard([500.0] * 5 + [1040.0] * 20)
        assert heard == [True] * 5 + [False] * 10 + [True] * 10

    def test_wild_altitudes_never_are(self) -> None:
        assert (
            self.heard([500.0] + [9000.0 * (number % 3 + 1) for number in range(60)])
            == [True] + [False] * 60
        )

    def test_a_fast_vehicle_is_followed(self) -> None:
        assert all(self.heard([8000 - 100.0 * second for second in range(60)], 1.0))

    def test_a_restarted_clock_starts_anew(self) -> None:
        leap = Leap()
        assert not leap.withholds(500 * SECOND_US, 500.0)
        assert not leap.withholds(3 * SECOND_US, 3000.0)

    def test_on_a_stream(self) -> None:
        """An estimator that keeps its correction over a gap of the barometer errs once when another
        one comes back."""
        bench = Bench(altitude_hz=5)
        sent = [
            bench.altitude(10 + 0.2 * number, 1040.0 if number == 7 else 500.0)
            for number in range(12)
        ]
        assert [message is None for message in sent] == [number == 7 for number in range(12)]


class TestOnTheWire:
    """A stock pymavlink receiver reads all of it."""

    def test_altitude_of_a_standing_vehicle(self) -> None:
        outcome = feed(standing(30, 60, home=(1.0, lambda boot_s: home(480.0))))
        messages = [message for message in parsed(outcome.sent) if message.get_type() == "ALTITUDE"]
        assert len(messages) == len(outcome.altitudes) > 100
        for message in messages:
            assert message.get_srcSystem() == 1
            assert message.get_srcComponent() == 191
            assert message.altitude_amsl == pytest.approx(ALTITUDE_M, abs=3.0)
            assert message.altitude_relative == pytest.approx(20.0, abs=3.0)
            assert message.altitude_monotonic == pytest.approx(0.0, abs=0.1)
            assert 30e6 <= message.time_usec <= 60e6
            assert math.isnan(message.bottom_clearance)
        times = [message.time_usec for message in messages]
        assert np.diff(times).min() >= 100_000

    def test_names_are_short_and_unique(self) -> None:
        outcome = feed(standing(30, 40))
        named = [
            m
            for m in parsed(outcome.sent)
            if m.get_type() in ("NAMED_VALUE_FLOAT", "DEBUG_VECT", "DEBUG_FLOAT_ARRAY")
        ]
        names: dict[str, set[str]] = {}
        for message in named:
            names.setdefault(message.name, set()).add(message.get_type())
        assert {
            "klHealth",
            "klAltSd",
            "klClimb",
            "klBaroOff",
            "klQnhHpa",
            "klVpl",
            "kollsman",
            "klState",
        } <= set(names)
        assert set(NAMED) <= set(names)
        assert all(0 < len(name) <= 10 and len(kinds) == 1 for name, kinds in names.items())

    def test_the_protection_level_goes_out(self) -> None:
        messages = parsed(feed(standing(30, 45)).sent)
        named = [m for m in messages if m.get_type() == "NAMED_VALUE_FLOAT" and m.name == "klVpl"]
        states = [m for m in messages if m.get_type() == "DEBUG_FLOAT_ARRAY"]
        assert 1.0 < named[-1].value < 50.0
        assert states[-1].data[-1] == named[-1].value

    def test_debug_values_are_what_they_say(self) -> None:
        messages = parsed(feed(standing(30, 45)).sent)
        last = {m.name: m.value for m in messages if m.get_type() == "NAMED_VALUE_FLOAT"}
        assert last["klHealth"] == Health.OK
        assert last["klQnhHpa"] == pytest.approx(vehicle.SEA_LEVEL_PA * 0.01, abs=0.5)
        baro_m = baro_altitude_m(vehicle.hectopascals(ALTITUDE_M) * 100.0)
        assert last["klBaroOff"] == pytest.approx(ALTITUDE_M - baro_m, abs=3.0)
        vector = [m for m in messages if m.get_type() == "DEBUG_VECT"][-1]
        assert (vector.x, vector.y) == pytest.approx((ALTITUDE_M, 0.0), abs=3.0)
        assert vector.z == pytest.approx(last["klAltSd"])

    def test_in_lost_only_the_health_is_told(self) -> None:
        outcome = feed(standing(30, 40, gps=None, pressure=None, attitude=(5.0, vehicle.attitude)))
        assert set(outcome.names()) == {"NAMED_VALUE_FLOAT"}
        assert {message.name for message in parsed(outcome.sent)} == {"klHealth"}

    @pytest.mark.parametrize(("version", "magic"), [(1, 0xFE), (2, 0xFD)])
    def test_we_answer_in_the_version_heard(self, version: int, magic: int) -> None:
        outcome = feed(standing(30, 40, vehicle=Vehicle(version=version)))
        assert {frame[0] for frame in outcome.sent} == {magic}
        assert "ALTITUDE" in outcome.names()
        assert ("DEBUG_FLOAT_ARRAY" in outcome.names()) == (version == 2)

    def test_configured_off(self) -> None:
        outcome = feed(
            standing(30, 40), configured(altitude="never", debug=False, statustext=False)
        )
        assert outcome.sent == []

    def test_a_chosen_rate(self) -> None:
        outcome = feed(standing(30, 60), configured(altitude_hz=1.0))
        assert len(outcome.altitudes) == pytest.approx(27, abs=2)

    @pytest.mark.parametrize(
        ("health", "status"), [(Health.OK, 4), (Health.DEGRADED, 4), (Health.LOST, 5)]
    )
    def test_our_heartbeat(self, health: Health, status: int) -> None:
        message = heartbeat(health)
        assert (message.type, message.autopilot, message.system_status) == (18, 8, status)

    @pytest.mark.parametrize("reason", ["short", "x" * 80, "Höhe über Grund"])
    def test_texts_fit(self, reason: str) -> None:
        texts = StatusTexts()
        texts.say("health", Health.DEGRADED, 4, f"Kollsman DEGRADED: {reason}")
        (message,) = texts.due(0)
        (read,) = parsed([Encoder(1, 191).encode(message)])
        assert read.text.startswith("Kollsman DEGRADED: ")
        assert len(read.text) <= 50


def filled(state: Rows, value: Callable[[tuple[int, ...]], Any]) -> Rows:
    for name, (kind, *_) in (state.dtype.fields or {}).items():
        if kind.base.kind == "f":
            state[name] = value(state[name].shape)
    return state


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize("value", [0.0, NAN, math.inf, -math.inf, 1e39, -1e300])
def test_any_state_of_any_estimator_fits_the_array(name: str, value: float) -> None:
    method = ESTIMATORS[name]
    state = filled(method.init(method.settings().params()), lambda shape: np.full(shape, value))  # type: ignore[attr-defined]
    floats = state_floats(state)
    assert len(floats) == 58
    message = mavlink.MAVLink_debug_float_array_message(1, b"klState", 0, floats)
    (read,) = parsed([Encoder(1, 191).encode(message)])
    assert len(read.data) == 58


@settings(deadline=None, max_examples=100)
@given(climb_mps=st.floats(), baro_offset_m=st.floats(), sd_m=st.floats(0, 30))
def test_any_estimate_can_be_told(climb_mps: float, baro_offset_m: float, sd_m: float) -> None:
    outputs = Outputs(PublishSettings())
    row = estimate(10.0, 500.0, sd_m, climb_mps=climb_mps, baro_offset_m=baro_offset_m)
    section: Any = CompanionSettings().section("adaptive-fusion")
    state = ESTIMATORS["adaptive-fusion"].init(section.params())
    encoder = Encoder(1, 191)
    messages = outputs.debug(10 * SECOND_US, Health.OK, row, state)
    assert (
        len(parsed([encoder.encode(message) for message in messages]))
        == len(messages)
        == 4 + len(NAMED)
    )


def test_an_outcome_has_what_tests_need() -> None:
    """`Outcome` must see every sample: a missing one would make the scenario tests pass for
    nothing."""
    outcome: Outcome = feed(standing(30, 33, pressure=(5.0, pressure)))
    assert len(outcome.samples) == len(outcome.health) == len(outcome.rows) > 40


def test_ours_comes_back_beside_heights_of_the_vehicle_at_another_phase() -> None:
    """GLOBAL_POSITION_INT comes at 10 Hz, 20 ms beside our slots, and fills in for two seconds of
    LOST: once we are OK again, our own ALTITUDE is sent at its rate."""
    outputs = Outputs(CompanionSettings().publish)
    estimate = rows(ESTIMATE)
    sent = 0
    for tick in range(500):
        now_us = 10_000_000 + tick * 10_000
        health = Health.LOST if tick < 200 else Health.OK
        if tick % 10 == 2:
            message = mavlink.MAVLink_global_position_int_message(
                now_us // 1000, 470000000, 80000000, 500000, 200000, 0, 0, 0, 0
            )
            outputs.own_height(message, now_us, health)
        if tick % 5 == 0:
            estimate["time_us"], estimate["altitude_amsl_m"] = now_us, 500.0
            sent += outputs.altitude(now_us, health, estimate) is not None
    assert sent >= 28
