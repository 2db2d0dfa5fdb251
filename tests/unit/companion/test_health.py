"""OK, DEGRADED, LOST: each rule, its hysteresis, and one STATUSTEXT a transition."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.health import Health, HealthMonitor, HealthSettings
from companion.samples import ESTIMATE, Kind, Rows, Verdict, rows
from tests import vehicle
from tests.vehicle import changes, feed, parsed, standing

OK, DEGRADED, LOST = Health
SECOND_US = 1_000_000
USES = (Kind.PRESSURE, Kind.GNSS, Kind.STATUS)


def estimate(time_s: float, altitude_m: float = 500.0, sd_m: float = 2.0) -> Rows:
    row = rows(ESTIMATE)
    row["time_us"], row["altitude_amsl_m"], row["altitude_sd_m"] = (
        round(time_s * SECOND_US),
        altitude_m,
        sd_m,
    )
    return row


class Bench:
    """A monitor, its vehicle time, and sensors that work unless told otherwise."""

    def __init__(self, uses: tuple[Kind, ...] = USES, **settings: float) -> None:
        self.monitor = HealthMonitor(HealthSettings(**settings), uses)
        self.time_s = 10.0
        self.history: list[Health] = []
        self.transitions = 0
        self.fresh_s = self.time_s

    def run(
        self,
        duration_s: float,
        *,
        pressure: Verdict | None = Verdict.USED,
        gnss: Verdict | None = Verdict.USED,
        altitude_m: float = 500.0,
        sd_m: float = 2.0,
        stale: bool = False,
    ) -> Health:
        """Ten updates a second of vehicle time; the health at the end."""
        for _ in range(round(duration_s * 10)):
            self.time_s += 0.1
            now_us = round(self.time_s * SECOND_US)
            for kind, verdict in ((Kind.PRESSURE, pressure), (Kind.GNSS, gnss)):
                if verdict is not None:
                    self.monitor.sample(kind, verdict, now_us, now_us)
            if not stale:
                self.fresh_s = self.time_s
            self.transitions += self.monitor.assess(
                now_us, estimate(self.fresh_s, altitude_m, sd_m)
            )
            self.history.append(self.monitor.health)
        return self.monitor.health

    def seconds_until(self, health: Health, **conditions: Any) -> float:
        """How long the conditions take to lead to `health`."""
        start_s = self.time_s
        while self.monitor.health is not health and self.time_s - start_s < 60:
            self.run(0.1, **conditions)
        return self.time_s - start_s


def healthy(**options: Any) -> Bench:
    bench = Bench(**options)
    assert bench.run(5.0) is OK
    return bench


def test_it_begins_lost_and_recovers_after_two_seconds() -> None:
    bench = Bench()
    assert bench.monitor.health is LOST
    assert bench.seconds_until(OK) == pytest.approx(2.1, abs=0.11)
    assert list(changes(bench.history)) == [LOST, OK]
    assert bench.transitions == 1


def test_our_own_interruption_is_no_loss() -> None:
    """Continued from a checkpoint: the estimate of before counts until the first sample renews it,
    and not for longer than it would have without the interruption."""
    bench = healthy()
    bench.monitor.shift(20 * SECOND_US)
    bench.time_s += 20.0
    assert bench.run(0.2, pressure=None, gnss=None, stale=True) is OK
    assert bench.run(1.0) is OK
    stays_silent = healthy()
    stays_silent.monitor.shift(20 * SECOND_US)
    stays_silent.time_s += 20.0
    assert stays_silent.run(6.0, pressure=None, gnss=None, stale=True) is LOST


def test_a_mere_silence_is_over_after_one_second() -> None:
    """An unplugged cable says nothing against the height; an uncertain height does."""
    for sd_m, expected_s in ((2.0, 1.1), (31.0, 2.1)):
        bench = healthy()
        host_us = round(bench.time_s * SECOND_US)
        bench.monitor.alive(host_us)
        bench.time_s += 4.0
        assert bench.monitor.age(host_us + 4 * SECOND_US, lambda: "")
        assert bench.monitor.health is LOST
        bench.run(0.1, sd_m=sd_m)
        bench.monitor.alive(round(bench.time_s * SECOND_US))
        assert bench.seconds_until(OK) == pytest.approx(expected_s, abs=0.21)


def test_a_silence_that_ends_just_before_the_limit_is_a_mere_silence_too() -> None:
    """Heard again after 2.9 s, but the first height comes after 3.1 s."""
    bench = healthy()
    host_us = round(bench.time_s * SECOND_US)
    for since_s in (0.0, 2.9, 3.05):
        bench.monitor.alive(host_us + round(since_s * SECOND_US))
    bench.time_s += 3.1
    assert bench.monitor.age(round(bench.time_s * SECOND_US), lambda: "")
    assert bench.monitor.reason == "vehicle heard, but no barometer and no GNSS"
    assert bench.seconds_until(OK) == pytest.approx(1.1, abs=0.21)


@pytest.mark.parametrize(
    ("conditions", "after_s", "expected", "reason"),
    [
        ({"gnss": None}, 2.0, DEGRADED, "GNSS height silent"),
        ({"pressure": None}, 2.0, DEGRADED, "barometer silent"),
        ({"gnss": Verdict.INVALID}, 2.0, DEGRADED, "GNSS height invalid"),
        ({"gnss": Verdict.STALE}, 2.0, DEGRADED, "GNSS height stale"),
        ({"pressure": Verdict.GATED}, 2.0, DEGRADED, "barometer gated"),
        ({"sd_m": 15.1}, 0.0, DEGRADED, "altitude uncertain by 15 m"),
        ({"sd_m": 30.1}, 0.0, LOST, "altitude uncertain by 30 m"),
        ({"stale": True}, 5.0, LOST, "no usable height for 5 s"),
        ({"pressure": None, "gnss": None}, 5.0, LOST, "no usable height for 5 s"),
        ({"pressure": Verdict.INVALID, "gnss": Verdict.INVALID}, 5.0, LOST, "no usable height for "
            "5 s"),
        ({"altitude_m": math.nan}, 0.0, LOST, "no altitude yet"),
        ({"altitude_m": math.inf}, 0.0, LOST, "no altitude yet"),
        ({"sd_m": math.nan}, 0.0, LOST, "no altitude yet"),
        ({"sd_m": math.inf}, 0.0, LOST, "no altitude yet"),
        ({"altitude_m": 1e30}, 0.0, LOST, "altitude impossible"),
        ({"altitude_m": -5000.0}, 0.0, LOST, "altitude impossible"),
    ],
)  # fmt: skip
def test_each_rule_and_when_it_strikes(
    conditions: dict[str, Any], after_s: float, expected: Health, reason: str
) -> None:
    bench = healthy()
    assert bench.seconds_until(expected, **conditions) == pytest.approx(after_s + 0.1, abs=0.11)
    assert bench.monitor.reason == reason


def test_a_turn_for_the_worse_takes_effect_at_once_one_for_the_better_waits() -> None:
    bench = healthy()
    assert bench.run(0.1, sd_m=40) is LOST
    assert bench.seconds_until(OK) == pytest.approx(2.1, abs=0.11)
    assert bench.run(0.1, sd_m=20) is DEGRADED
    assert bench.seconds_until(OK) == pytest.approx(2.1, abs=0.11)


def test_a_relapse_starts_the_wait_anew() -> None:
    bench = healthy()
    bench.run(0.1, sd_m=20)
    for _ in range(20):
        assert bench.run(1.5) is DEGRADED
        assert bench.run(0.1, sd_m=20) is DEGRADED
    assert bench.seconds_until(OK) == pytest.approx(2.1, abs=0.11)


def test_from_lost_it_becomes_what_it_is_after_the_wait() -> None:
    bench = healthy()
    bench.run(1.0, sd_m=40)
    assert bench.run(1.9, sd_m=20) is LOST
    assert bench.run(0.3, sd_m=20) is DEGRADED


def test_a_spread_that_hovers_at_the_limit_does_not_flutter() -> None:
    bench = healthy()
    before = bench.transitions
    for tick in range(600):
        bench.run(0.1, sd_m=14.9 if tick % 2 else 15.1)
    assert bench.monitor.health is DEGRADED
    assert bench.transitions - before == 1


def test_a_slow_gnss_is_enough() -> None:
    bench = healthy()
    for tick in range(300):
        bench.run(0.1, gnss=Verdict.USED if tick % 15 == 0 else None)
    assert set(bench.history[50:]) == {OK}


def test_only_the_kinds_that_the_estimator_uses_are_missed() -> None:
    bench = Bench(uses=(Kind.PRESSURE, Kind.IMU))
    assert bench.run(5.0, gnss=None) is OK
    assert bench.seconds_until(LOST, gnss=None, pressure=None) == pytest.approx(5.1, abs=0.11)


def test_an_estimator_without_heights_of_its_own_is_judged_by_its_estimate() -> None:
    bench = Bench(uses=(Kind.IMU,))
    assert bench.run(5.0, pressure=None, gnss=None) is OK


def test_an_inertial_estimate_that_outlives_every_height_is_lost() -> None:
    """Its time goes on, so only the verdicts tell."""
    bench = healthy()
    assert bench.run(4.9, pressure=None, gnss=None) is DEGRADED
    assert bench.run(0.3, pressure=None, gnss=None) is LOST


def test_a_reboot_forgets_every_instant() -> None:
    bench = healthy()
    bench.time_s = 1.0
    bench.monitor.restart()
    now_us = SECOND_US
    bench.monitor.assess(now_us, estimate(0.0, math.nan))
    assert bench.monitor.health is LOST
    assert bench.seconds_until(OK) == pytest.approx(2.1, abs=0.2)


def test_silence_on_the_hosts_clock_is_lost_once() -> None:
    bench = healthy()
    heard_us = round(bench.time_s * SECOND_US)
    bench.monitor.alive(heard_us)
    assert bench.monitor.age(heard_us + 4 * SECOND_US, str) is True
    assert bench.monitor.age(heard_us + 5 * SECOND_US, str) is False
    assert (bench.monitor.health, bench.monitor.reason) == (LOST, "nothing heard")
    assert bench.seconds_until(OK) == pytest.approx(1.1, abs=0.11)  # a mere silence: half as long


@settings(deadline=None, max_examples=50)
@given(
    st.lists(
        st.tuples(st.sampled_from([1.0, 20.0, 50.0, math.nan]), st.floats(0.1, 4.0)), max_size=12
    )
)
def test_whatever_happens_improvement_takes_two_seconds(phases: list[tuple[float, float]]) -> None:
    bench = Bench()
    for sd_m, duration_s in phases:
        bench.run(duration_s, sd_m=sd_m)
    history = np.array([int(health) for health in bench.history])
    better = np.flatnonzero(np.diff(history) < 0)
    worse = np.flatnonzero(np.diff(history) > 0)
    for index in better:
        since = worse[worse < index].max(initial=-1)
        assert index - since >= 20
    assert bench.transitions == better.size + worse.size


def test_one_statustext_a_transition() -> None:
    """A minute without GNSS in three: DEGRADED and back, and a word for each change that a pilot
    can read."""
    outage = (5.0, lambda boot_s: None if 60 <= boot_s < 120 else vehicle.gps(boot_s))
    outcome = feed(standing(30, 180, gps=outage))
    texts = [message.text for message in parsed(outcome.sent) if message.get_type() == "STATUSTEXT"]
    assert list(changes(outcome.health)) == [LOST, OK, DEGRADED, OK]
    assert [text.split(":")[0] for text in texts] == [
        "Kollsman OK",
        "Kollsman DEGRADED",
        "Kollsman OK",
    ]
    assert "GNSS height" in texts[1]
    assert all(len(text) <= 50 for text in texts)


def test_rare_heartbeats_are_no_loss_while_sensors_flow() -> None:
    """Links drop heartbeats, and some autopilots send one in five seconds: its samples show that it
    lives."""
    rare = (0.2, lambda boot_s: vehicle.heartbeat())
    outcome = feed(standing(30, 70, heartbeat=rare))
    assert list(changes(outcome.health)) == [LOST, OK]


class Ages:
    """A monitor on the host's clock."""

    def __init__(self) -> None:
        self.monitor = HealthMonitor(HealthSettings(), USES)
        self.host_s = 0.0
        self.run(5.0)
        assert self.monitor.health is OK

    def run(
        self,
        duration_s: float,
        *,
        alive: bool = True,
        heights: bool = True,
        verdict: Verdict = Verdict.USED,
        speed: float = 1.0,
        others: str = "",
    ) -> list[Health]:
        """The health after each tenth of a second of the host's clock."""
        history = []
        for _ in range(round(duration_s * 10)):
            self.host_s += 0.1
            host_us = round(self.host_s * SECOND_US)
            vehicle_us = round(self.host_s * speed * SECOND_US)
            if alive:
                self.monitor.alive(host_us)
            if alive and heights:
                for kind in (Kind.PRESSURE, Kind.GNSS):
                    self.monitor.sample(kind, verdict, vehicle_us, host_us)
                self.monitor.assess(vehicle_us, estimate(vehicle_us / SECOND_US))
            self.monitor.age(host_us, lambda: others)
            history.append(self.monitor.health)
        return history


@pytest.mark.parametrize(
    ("conditions", "after_s", "reason"),
    [
        ({"alive": False}, 3.0, "nothing heard"),
        ({"alive": False, "others": "255/190"}, 3.0, "vehicle silent, heard: 255/190"),
        ({"heights": False}, 3.0, "vehicle heard, but no barometer and no GNSS"),
    ],
)
def test_silence_of_the_vehicle_is_lost_on_the_hosts_clock(
    conditions: dict[str, Any], after_s: float, reason: str
) -> None:
    """Whoever else talks, and though the vehicle's clock stands still."""
    bench = Ages()
    history = bench.run(6.0, **conditions)
    assert history.index(LOST) == pytest.approx(10 * after_s, abs=1)
    assert set(history[history.index(LOST) :]) == {LOST}
    assert bench.monitor.reason == reason
    assert bench.run(2.5)[-1] is OK  # as after SIGCONT


@pytest.mark.parametrize("speed", [0.25, 1.0, 20.0])
def test_simulations_at_other_speeds_are_not_silent(speed: float) -> None:
    bench = Ages()
    bench.monitor.restart()
    assert set(bench.run(30.0, speed=speed)[100:]) == {OK}


def test_samples_that_are_never_used_are_no_height_on_the_hosts_clock_either() -> None:
    """A vehicle whose stamps stand still sends the newest value for ever."""
    bench = Ages()
    history = []
    for _ in range(8):
        bench.host_s += 1.0
        host_us = round(bench.host_s * SECOND_US)
        bench.monitor.alive(host_us)
        bench.monitor.sample(Kind.PRESSURE, Verdict.STALE, 5 * SECOND_US, host_us)
        bench.monitor.age(host_us, str)
        history.append(bench.monitor.health)
    assert history == [OK] * 5 + [LOST] * 3
