"""The vehicle's clock as its stamps tell it: wraps, restarts, gaps, damage, dates, repeats; and
what becomes a row."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.intake import (
    Clockwork,
    Intake,
    IntakeSettings,
    SampleReject,
    VehicleClock,
    vehicle_clock,
)
from companion.intake.vehicle_clock import WRAP_MS
from companion.mavlink import convert
from companion.mavlink.convert import Reading, TimeBase
from companion.samples import Kind, Rows
from tests import vehicle

TICK, DOUBT, REBOOT = Clockwork
SECOND_US = 1_000_000
UNIX_US = 1_700_000_000 * SECOND_US
GPS, IMU = 24, 27
WRAP_US = WRAP_MS * 1000


def boot(stamp_s: float) -> Reading:
    return Reading(
        Kind.PRESSURE, TimeBase.BOOT, round(stamp_s * 1e3) * 1000, 0, (101325.0, 300.0, 0)
    )


def either(stamp_us: int) -> Reading:
    return convert.raw_imu(vehicle.raw_imu(stamp_us * 1e-6), 1.0)[0]._replace(stamp_us=stamp_us)


class Bench:
    def __init__(self, **changes: float) -> None:
        self.clock = VehicleClock(IntakeSettings(**changes))

    def hear(self, stamp_s: float) -> Clockwork:
        """A stamp that counts from boot."""
        return self.clock.place(boot(stamp_s), 29)[0]

    def run(self, start_s: float, end_s: float, step_s: float = 0.1) -> list[Clockwork]:
        return [self.hear(float(stamp_s)) for stamp_s in np.arange(start_s, end_s, step_s)]

    def map(self, stamp_us: int, source: int = GPS) -> float:
        """Where a stamp of any base lands, in seconds."""
        clockwork, time_us = self.clock.place(either(stamp_us), source)
        assert clockwork is TICK
        return time_us * 1e-6

    @property
    def now_s(self) -> float:
        return self.clock.now_us * 1e-6


def running(until_s: float = 100.0, **changes: float) -> Bench:
    bench = Bench(**changes)
    assert set(bench.run(until_s - 10.0, until_s)) == {TICK}
    assert bench.now_s == pytest.approx(until_s, abs=0.11)
    return bench


class TestBootClock:
    def test_it_follows_the_newest_stamp(self) -> None:
        bench = running(100.0)
        assert bench.hear(100.5) is TICK
        assert bench.hear(100.2) is TICK
        assert bench.now_s == 100.5

    def test_reordering_keeps_every_stamp_as_it_is(self) -> None:
        bench = running(100.0)
        for stamp_s in (101.0, 100.6, 101.4, 100.8):
            assert bench.clock.place(boot(stamp_s), 29) == (TICK, round(stamp_s * SECOND_US))
        assert bench.clock.reboots == 0

    @pytest.mark.parametrize("damaged_s", [5.0, 85.0, 103.0, 108.0, 4_000.0, 4_294_967.295])
    def test_one_damaged_stamp_does_nothing(self, damaged_s: float) -> None:
        bench = running(100.0)
        assert bench.hear(damaged_s) is DOUBT
        assert bench.now_s == pytest.approx(99.9)
        assert set(bench.run(100.0, 105.0)) == {TICK}
        assert bench.clock.reboots == 0

    @settings(deadline=None, max_examples=100)
    @given(
        damage=st.lists(
            st.integers(0, 2**32 - 1), min_size=1, max_size=20, unique_by=lambda ms: ms // 10_000
        )
    )
    def test_single_damaged_stamps_never_move_the_clock(self, damage: list[int]) -> None:
        """Two stamps that agree with each other are a reboot, so no two are near each other."""
        bench = running(100.0)
        good_s = 100.0
        for stamp_ms in damage:
            bench.hear(stamp_ms * 1e-3)
            good_s += 0.1
            bench.hear(good_s)
        assert bench.clock.reboots == 0
        assert bench.now_s == pytest.approx(good_s, abs=2.0)

    @pytest.mark.parametrize("restart_s", [0.1, 3.0, 50.0, 85.0])
    def test_two_consistent_stamps_are_a_reboot(self, restart_s: float) -> None:
        bench = running(100.0)
        assert bench.hear(restart_s) is DOUBT
        assert bench.hear(restart_s + 0.1) is REBOOT
        assert bench.clock.reboots == 1
        assert set(bench.run(restart_s + 0.2, restart_s + 5)) == {TICK}
        assert bench.clock.reboots == 1

    @pytest.mark.parametrize("late_s", [2.5, 3.0, 9.9])
    def test_late_copies_over_a_second_path_are_no_reboot(self, late_s: float) -> None:
        """mavlink-router: every message comes again some seconds later, in bursts."""
        bench = running(100.0)
        for k in range(200):
            stamp_s = 100.0 + 0.1 * k
            assert bench.hear(stamp_s) is TICK
            if k % 10 == 0:
                for late in range(10):
                    copy_s = stamp_s - late_s + 0.1 * late
                    assert bench.clock.place(boot(copy_s), 29) == (
                        TICK,
                        boot(copy_s).stamp_us,
                    )
        assert bench.clock.reboots == 0
        assert bench.now_s == pytest.approx(stamp_s)

    @pytest.mark.parametrize("late_s", [2.5, 3.0, 9.9])
    def test_late_copies_that_go_on_alone_are_no_reboot(self, late_s: float) -> None:
        """The first path ends; the second brings what is still on its way, and then more."""
        bench = running(100.0)
        for k in range(20):
            bench.hear(100.0 + 0.1 * k)
            bench.hear(100.0 + 0.1 * k - late_s)
        last_s = 101.9
        assert set(bench.run(last_s - late_s + 0.1, last_s + 5.0)) == {TICK}
        assert bench.clock.reboots == 0
        assert bench.now_s == pytest.approx(last_s + 5.0, abs=0.2)

    def test_late_copies_of_a_fix_keep_their_time(self) -> None:
        bench = running(100.0)
        for k in range(100):
            stamp_us = round((100.0 + 0.1 * k) * SECOND_US)
            bench.hear(stamp_us / SECOND_US)
            assert bench.map(stamp_us) == pytest.approx(stamp_us / SECOND_US)
            if k > 50:
                assert bench.map(stamp_us - 4_000_000) == pytest.approx(stamp_us / SECOND_US - 4.0)

    def test_no_stamp_is_now(self) -> None:
        bench = running(100.0)
        assert bench.clock.place(boot(0.0), 29) == (TICK, bench.clock.now_us)

    def test_a_day_between_two_stamps_is_another_session(self) -> None:
        """One file, two flights: the boot clock goes on by minutes, the recorder's by a day."""
        clock = VehicleClock(IntakeSettings())
        day_us = 86_400 * SECOND_US
        for k in range(100):
            assert clock.place(boot(30.0 + 0.1 * k), 29, k * 100_000)[0] is TICK
        heard = [clock.place(boot(400.0 + 0.1 * k), 29, day_us + k * 100_000)[0] for k in range(10)]
        assert heard == [DOUBT, REBOOT] + [TICK] * 8

    def test_microseconds_in_a_field_of_milliseconds_are_told_and_not_used(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Ten a second, 1000 times too fast, beside stamps that are right."""
        clock, told = VehicleClock(IntakeSettings()), []
        monkeypatch.setattr(vehicle_clock.logger, "warning", lambda *args: told.append(args))
        for k in range(200):
            arrival_us, boot_s = UNIX_US + k * 100_000, 30.0 + 0.1 * k
            clock.place(boot(boot_s), 29, arrival_us)
            clock.place(boot((boot_s * 1000.0) % 4e6), 30, arrival_us + 10)
        assert clock.now_us == pytest.approx(boot_s * SECOND_US, abs=SECOND_US)
        assert clock.place(boot(1234.0), 30, arrival_us + 20) == (TICK, clock.now_us)
        assert len(told) == 1

    def test_two_stamps_that_disagree_are_no_reboot(self) -> None:
        bench = running(100.0)
        assert [bench.hear(stamp_s) for stamp_s in (50.0, 20.0, 70.0, 30.0)] == [DOUBT] * 4
        assert bench.hear(100.1) is TICK
        assert bench.clock.reboots == 0

    @pytest.mark.parametrize("gap_s", [2.5, 60.0, 3600.0, 1_000_000.0])
    def test_a_gap_is_no_reboot(self, gap_s: float) -> None:
        bench = running(100.0)
        assert bench.hear(100.0 + gap_s) is DOUBT
        assert bench.hear(100.1 + gap_s) is TICK
        assert bench.now_s == pytest.approx(100.1 + gap_s)
        assert bench.clock.reboots == 0

    def test_a_stream_with_a_message_every_three_seconds_is_followed(self) -> None:
        bench = running(100.0)
        heard = [bench.hear(100.0 + 3.0 * number) for number in range(20)]
        assert heard.count(TICK) >= 9
        assert bench.now_s >= 150.0
        assert bench.clock.reboots == 0

    def test_boots_that_overlap_in_a_log_settle_on_the_newer(self) -> None:
        bench = running(100.0)
        heard = [bench.hear(stamp_s) for stamp_s in (5.0, 100.1, 5.1, 100.2, 5.2, 5.3, 5.4, 5.5)]
        assert heard.count(REBOOT) == 1
        assert bench.now_s == pytest.approx(5.5)


class TestWrap:
    def test_boot_milliseconds_go_on_after_49_days(self) -> None:
        bench = running(WRAP_MS * 1e-3 - 1.0)
        for number in range(40):
            stamp_ms = (WRAP_MS - 1000 + number * 100) % WRAP_MS
            assert bench.hear(stamp_ms * 1e-3) is TICK
        assert bench.now_s == pytest.approx(WRAP_MS * 1e-3 + 2.9)
        assert bench.clock.reboots == 0

    def test_stamps_reordered_across_the_wrap(self) -> None:
        bench = running(WRAP_MS * 1e-3 - 0.2)
        order_ms = [WRAP_MS - 100, 50, WRAP_MS - 50, 100, WRAP_MS - 20, 150]
        times = [bench.clock.place(boot((stamp % WRAP_MS) * 1e-3), 29) for stamp in order_ms]
        expected_ms = [
            WRAP_MS - 100,
            WRAP_MS + 50,
            WRAP_MS - 50,
            WRAP_MS + 100,
            WRAP_MS - 20,
            WRAP_MS + 150,
        ]
        assert times == [(TICK, stamp * 1000) for stamp in expected_ms]

    def test_a_damaged_stamp_near_the_wrap_does_nothing(self) -> None:
        bench = running(WRAP_MS * 1e-3 - 5.0)
        assert bench.hear(300.0) is DOUBT
        assert set(bench.run(WRAP_MS * 1e-3 - 5.0, WRAP_MS * 1e-3 - 1.0)) == {TICK}
        assert bench.hear(0.5) is TICK
        assert bench.now_s == pytest.approx(WRAP_MS * 1e-3 + 0.5)

    def test_a_reboot_after_the_wrap_begins_at_zero(self) -> None:
        bench = running(WRAP_MS * 1e-3 - 0.2)
        for number in range(10_000):
            bench.hear(number * 0.1)
        assert bench.now_s > WRAP_MS * 1e-3
        assert [bench.hear(3.0), bench.hear(3.1)] == [DOUBT, REBOOT]
        assert bench.now_s == pytest.approx(3.1)
        assert set(bench.run(3.2, 10.0)) == {TICK}
        assert bench.now_s == pytest.approx(10.0, abs=0.11)

    def test_micro_seconds_do_not_wrap(self) -> None:
        bench = running(WRAP_MS * 1e-3 - 0.2)
        bench.hear(0.5)
        assert bench.map(WRAP_US + 700_000) == pytest.approx(WRAP_MS * 1e-3 + 0.7)


class TestOtherBases:
    def test_stamps_from_boot(self) -> None:
        bench = running(100.0)
        assert bench.map(100_050_000) == pytest.approx(100.05)
        assert bench.map(99_500_000) == pytest.approx(99.5)

    def test_unix_stamps_by_system_time(self) -> None:
        bench = running(100.0)
        bench.clock.note_unix(UNIX_US, 100 * SECOND_US)
        assert bench.map(UNIX_US - 150_000) == pytest.approx(99.85)
        assert bench.map(UNIX_US + 50_000) == pytest.approx(100.05)

    def test_unix_stamps_without_system_time_take_the_base_of_the_first(self) -> None:
        bench = running(100.0)
        assert bench.map(UNIX_US) == pytest.approx(99.9)
        assert bench.map(UNIX_US + 200_000) == pytest.approx(100.1)
        assert bench.map(UNIX_US + 100_000) == pytest.approx(100.0)

    @pytest.mark.parametrize("with_system_time", [True, False])
    @pytest.mark.parametrize("ahead_s", [0.8, 1.01, 1.9, 3.0, 18.0])
    def test_stamps_that_ran_ahead_are_right_again_within_seconds(
        self, ahead_s: float, with_system_time: bool
    ) -> None:
        """A leap second learned late: 20 s ahead, then right. Every later fix is in time again, and
        at most one is left out."""
        bench, doubts = running(100.0), 0
        if with_system_time:
            bench.clock.note_unix(UNIX_US, 100 * SECOND_US)
        for k in range(500):
            stamp_s = 100.0 + 0.1 * k
            bench.hear(stamp_s)
            wrong_s = ahead_s if 120.0 <= stamp_s < 140.0 else 0.0
            stamp_us = UNIX_US + round((stamp_s - 100.0 - 0.1 + wrong_s) * SECOND_US)
            clockwork, placed_us = bench.clock.place(either(stamp_us), GPS)
            doubts += clockwork is DOUBT
            if stamp_s > 144.0 or 124.0 < stamp_s < 140.0:
                assert placed_us / SECOND_US == pytest.approx(stamp_s, abs=0.7)
        assert doubts <= 1
        assert bench.now_s < 151.0

    @pytest.mark.parametrize("base_us", [0, UNIX_US], ids=["from boot", "own"])
    @pytest.mark.parametrize("gap_s", [1.5, 2.5, 60.0])
    def test_a_stamp_that_comes_first_after_a_gap_keeps_its_base(
        self, gap_s: float, base_us: int
    ) -> None:
        """The cable was out, and the fix is the first to come: it waits for the boot stamps."""
        bench = running(100.0)
        end_s = round(100.0 + gap_s, 1)
        assert bench.map(base_us + 100 * SECOND_US) == pytest.approx(bench.now_s)
        placed = []
        for k in range(8):
            stamp_us = base_us + round((end_s + 0.1 * k) * SECOND_US)
            placed.append(bench.clock.place(either(stamp_us), GPS))
            bench.hear(end_s + 0.1 * k + 0.05)
        for k, (clockwork, time_us) in enumerate(placed):
            assert clockwork is TICK or k < 2
            if clockwork is TICK:
                assert time_us / SECOND_US == pytest.approx(end_s + 0.1 * k, abs=0.11)
        assert bench.now_s == pytest.approx(end_s + 0.75, abs=0.11)

    def test_a_gap_after_which_nothing_counts_from_boot(self) -> None:
        """Only fixes go on: after a second they are used as before."""
        bench = running(100.0)
        bench.map(100 * SECOND_US)
        stamps_us = [110 * SECOND_US + 200_000 * k for k in range(20)]
        verdicts = [bench.clock.place(either(stamp_us), GPS)[0] for stamp_us in stamps_us]
        assert verdicts == 5 * [DOUBT] + 15 * [TICK]

    def test_sources_have_bases_of_their_own(self) -> None:
        bench = running(100.0)
        assert bench.map(UNIX_US, GPS) == pytest.approx(99.9)
        assert bench.map(7 * SECOND_US, IMU) == pytest.approx(99.9)
        assert bench.map(UNIX_US + 50_000, GPS) == pytest.approx(99.95)
        assert bench.map(7_050_000, IMU) == pytest.approx(99.95)

    def test_a_system_time_of_zero_or_of_1970_says_nothing(self) -> None:
        bench = running(100.0)
        bench.clock.note_unix(0, 100 * SECOND_US)
        bench.clock.note_unix(5 * SECOND_US, 100 * SECOND_US)
        assert bench.map(UNIX_US) == pytest.approx(99.9)

    def test_the_year_2908_is_only_a_base(self) -> None:
        year_2908_us = 29_600_000_000 * SECOND_US
        bench = running(100.0)
        bench.clock.note_unix(year_2908_us, 100 * SECOND_US)
        assert bench.map(year_2908_us + 50_000) == pytest.approx(100.05)

    def test_no_stamp_at_all_is_now(self) -> None:
        bench = running(100.0)
        assert bench.map(0) == pytest.approx(99.9)
        bench.hear(101.0)
        assert bench.map(0) == pytest.approx(101.0)

    def test_a_dead_receiver_that_repeats_its_stamp_stays_where_it_was(self) -> None:
        bench = running(100.0)
        first_s = bench.map(99_800_000)
        for number in range(600):
            if number % 5 == 0:
                bench.hear(100.0 + number * 0.2)
            assert bench.map(99_800_000) == first_s == pytest.approx(99.8)
        assert bench.clock.reboots == 0
        assert bench.now_s > 200

    def test_a_dead_receiver_alone_on_the_line_is_no_reboot(self) -> None:
        bench = running(100.0)
        bench.map(99_800_000)
        bench.hear(103.0)
        bench.hear(103.1)
        for _ in range(100):
            bench.map(99_800_000)
        assert bench.clock.reboots == 0

    @pytest.mark.parametrize("offset_s", [-4.0, -3.0, 3.0, 4.0, 30.0])
    def test_a_stream_with_a_clock_of_its_own_never_moves_the_vehicles(
        self, offset_s: float
    ) -> None:
        """RAW_IMU that counts from some seconds before or after boot must not be taken for
        restarts."""
        bench = running(100.0)
        for number in range(500):
            stamp_s = 100.0 + 0.1 * number
            assert bench.hear(stamp_s) is TICK
            placed_s = bench.map(round((stamp_s + offset_s) * SECOND_US), IMU)
            assert placed_s == pytest.approx(stamp_s, abs=0.2)
        assert bench.clock.reboots == 0

    def test_nothing_is_placed_before_the_boot_clock_is_known(self) -> None:
        bench = Bench()
        assert bench.clock.place(either(UNIX_US), GPS)[0] is DOUBT
        assert bench.clock.place(either(5 * SECOND_US), GPS)[0] is DOUBT
        assert bench.hear(5.0) is TICK

    def test_a_reboot_forgets_the_bases(self) -> None:
        bench = running(100.0)
        bench.clock.note_unix(UNIX_US, 100 * SECOND_US)
        bench.map(UNIX_US)
        bench.hear(3.0)
        assert bench.hear(3.1) is REBOOT
        assert bench.map(UNIX_US + 20 * SECOND_US) == pytest.approx(3.1)

    def test_a_crystal_that_runs_fast_does_not_run_away(self) -> None:
        """50 ppm for two days is 9 s: a GNSS clock against the autopilot's must not end in false
        restarts."""
        bench, doubts = running(100.0), 0
        for minute in range(2 * 24 * 60):
            stamp_s = 100.0 + 60.0 * minute
            for tick in range(3):
                bench.hear(stamp_s + 0.1 * tick)
            stamp_us = UNIX_US + round(60.0 * minute * 1.00005 * SECOND_US)
            clockwork, placed_us = bench.clock.place(either(stamp_us), GPS)
            doubts += clockwork is DOUBT
            assert clockwork is DOUBT or abs(placed_us * 1e-6 - stamp_s) <= 1.5
        assert doubts <= 10
        assert bench.clock.reboots == 0

    @settings(deadline=None, max_examples=200)
    @given(
        stamps=st.lists(
            st.integers(0, 2**64 - 1) | st.integers(97_000_000, 110_000_000), max_size=20
        )
    )
    def test_any_stamps_leave_the_clock_near_the_boot_stamps(self, stamps: list[int]) -> None:
        bench = running(100.0)
        good_s = 100.0
        for stamp_us in stamps:
            bench.clock.place(either(stamp_us), GPS)
            good_s += 0.1
            assert bench.hear(good_s) is TICK
        assert bench.clock.reboots == 0
        assert bench.now_s == pytest.approx(good_s, abs=2.0)


class TestRows:
    def take(
        self, intake: Intake, reading: Reading, source: int = 29
    ) -> tuple[Rows | None, Rows | None]:
        time_us, reboot = intake.place(reading, source, UNIX_US)
        return (None if time_us is None else intake.row(reading, time_us, UNIX_US)), reboot

    def converted(self, message: Any) -> Reading:
        (reading,) = convert.CONVERTERS[type(message).id](message)
        return reading

    def test_a_row_has_its_values_and_times(self) -> None:
        row, reboot = self.take(
            Intake(IntakeSettings()), self.converted(vehicle.pressure(12.5, press_abs=950.0))
        )
        assert row is not None
        assert reboot is None
        assert (row["time_us"][0], row["arrival_us"][0], row["instance"][0]) == (
            12_500_000,
            UNIX_US,
            0,
        )
        assert row["pressure_pa"][0] == pytest.approx(95_000.0)

    def test_a_gnss_height_is_older_than_its_stamp(self) -> None:
        intake = Intake(IntakeSettings(gnss_latency_s=0.2))
        self.take(intake, boot(100.0))
        row, _ = self.take(intake, self.converted(vehicle.gps(100.0)), GPS)
        assert row is not None
        assert row["time_us"][0] == 99_800_000

    def test_what_cannot_be_placed_is_counted(self) -> None:
        intake = Intake(IntakeSettings())
        assert self.take(intake, self.converted(vehicle.heartbeat())) == (None, None)
        assert self.take(intake, self.converted(vehicle.gps(5.0)), GPS) == (None, None)
        self.take(intake, boot(100.0))
        assert self.take(intake, boot(4.0)) == (None, None)
        assert intake.counters == {SampleReject.NO_CLOCK: 2, SampleReject.CLOCK: 1}

    def test_a_reboot_comes_with_the_sample_that_proves_it(self) -> None:
        intake = Intake(IntakeSettings())
        self.take(intake, boot(100.0))
        self.take(intake, boot(3.0))
        row, reboot = self.take(intake, boot(3.1))
        assert row is not None
        assert reboot is not None
        assert (reboot["reboot"][0], reboot["armed"][0], reboot["time_us"][0]) == (1, -1, 3_100_000)
        assert row["time_us"][0] == 3_100_000

    def test_an_instance_beyond_the_table_is_left_out(self) -> None:
        intake = Intake(IntakeSettings())
        assert self.take(intake, boot(1.0)._replace(instance=4)) == (None, None)

    def test_the_hosts_clock_has_no_say(self) -> None:
        """The same stamps with any arrivals give the same rows, arrivals aside."""
        arrivals = [0, UNIX_US, UNIX_US - 10**12, 5]
        intakes = [Intake(IntakeSettings()), Intake(IntakeSettings())]
        for number in range(40):
            reading = boot(10 + 0.1 * number)
            placed = [
                intake.place(reading, 29, arrival)[0]
                for intake, arrival in zip(intakes, (number, arrivals[number % 4]), strict=True)
            ]
            assert placed[0] == placed[1] is not None
        assert not math.isnan(intakes[0].clock.now_us)
