"""The checker: what the sensors support is published, what they do not is not, whoever
estimates."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st

from companion.checker import Checker
from companion.health import Health
from companion.pipeline import Pipeline
from companion.samples import Kind, Packet, Rows, Verdict, sample
from companion.settings import CompanionSettings
from tests.flights import standard_pressure_pa
from tests.vehicle import ALTITUDE_M, gps, parsed, pressure, standing

Height = Callable[[float], float]
SEA_LEVEL_PA = 100_300.0
QUICK = settings(max_examples=10, deadline=None, phases=[Phase.explicit, Phase.generate])
GRACE_S = 1.0
"""a fault that is younger than this may still be followed"""


def nothing(_: float) -> float:
    return 0.0


def play(
    seed: int,
    duration_s: float,
    follow: Callable[[float, float, float, float], float],
    *,
    gnss_fault: Height = nothing,
    baro_fault: Height = nothing,
    weather: Height = nothing,
    gnss_until_s: float = math.inf,
    sd_m: float = 3.0,
    scale: float = 0.0,
    white_sd_m: float = 0.0,
    checker: Checker | None = None,
) -> Iterator[tuple[float, float, str]]:
    """(time_s, error of the altitude, objection) four times a second on a flight with manoeuvres.

    `follow(time_s, truth_m, gnss_m, baro_m)` is the altitude an estimator gives; baro_m is the
    barometer's height plus the difference at the start. GNSS wanders by `sd_m` over 250 s, and
    differs by `white_sd_m` from fix to fix.
    """
    random = np.random.default_rng(seed)
    checker = checker or Checker()
    height_m, climb_mps, target_mps = 300.0, 0.0, 0.0
    wander_m = random.normal(0.0, sd_m)
    offset_m = math.nan
    for k in range(round(duration_s * 4)):
        time_s = 10.0 + k / 4.0
        if k % 80 == 0:
            target_mps = random.uniform(-8.0, 8.0) if height_m > 250.0 else random.uniform(2.0, 8.0)
        climb_mps += min(max(target_mps - climb_mps, -0.7), 0.7)
        height_m += climb_mps / 4.0
        wander_m = 0.999 * wander_m + sd_m * 0.0447 * random.normal()
        baro_height_m = height_m + weather(time_s) + baro_fault(time_s) + random.normal(0.0, 0.3)
        baro_height_m -= scale * (height_m - 300.0)
        pressure_pa = float(standard_pressure_pa(np.array(baro_height_m), SEA_LEVEL_PA))
        checker.sample(
            Kind.PRESSURE, sample(Kind.PRESSURE, round(time_s * 1e6), pressure_pa=pressure_pa)
        )
        gnss_m = height_m + wander_m + gnss_fault(time_s)
        if white_sd_m > 0.0:
            gnss_m += random.normal(0.0, white_sd_m)
        if time_s < gnss_until_s:
            checker.sample(Kind.GNSS, fix(time_s, gnss_m, math.hypot(sd_m, white_sd_m)))
        offset_m = gnss_m - baro_height_m if math.isnan(offset_m) else offset_m
        altitude_m = follow(time_s, height_m, gnss_m, baro_height_m + offset_m)
        objection = checker.objection(round(time_s * 1e6), altitude_m)
        yield time_s, altitude_m - height_m, objection


def fix(time_s: float, height_m: float, sd_m: float) -> Rows:
    return sample(
        Kind.GNSS,
        round(time_s * 1e6),
        fix_type=3,
        altitude_amsl_m=height_m,
        vertical_sd_m=sd_m,
        ground_speed_mps=25.0,
    )


def truth(_: float, truth_m: float, gnss_m: float, baro_m: float) -> float:
    return truth_m


def gnss(_: float, truth_m: float, gnss_m: float, baro_m: float) -> float:
    return gnss_m


def baro(_: float, truth_m: float, gnss_m: float, baro_m: float) -> float:
    return baro_m


def step(at_s: float, size_m: float, end_s: float = math.inf) -> Height:
    return lambda time_s: size_m if at_s <= time_s < end_s else 0.0


def ramp(at_s: float, rate_mps: float) -> Height:
    return lambda time_s: max(0.0, time_s - at_s) * rate_mps


def published(rows: Iterator[tuple[float, float, str]]) -> list[tuple[float, float]]:
    return [(time_s, error_m) for time_s, error_m, objection in rows if not objection]


seeds = st.integers(0, 2**32 - 1)
signs = st.sampled_from((-1.0, 1.0))


@QUICK
@given(seeds, st.floats(-31.0, 31.0), st.sampled_from((truth, gnss, baro)))
def test_healthy_sensors_support_who_follows_any_of_them(
    seed: int, weather_mph: float, follow: Any
) -> None:
    """The year's worst hour of weather, a receiver of 3 m, manoeuvres of 8 m/s: never silent."""
    rows = list(play(seed, 600.0, follow, weather=ramp(0.0, weather_mph / 3600.0)))
    assert not [row for row in rows if row[2]]


@QUICK
@given(seeds, st.floats(-0.09, 0.09), st.sampled_from((truth, gnss)))
def test_air_of_an_arctic_winter_is_no_fault(seed: int, scale: float, follow: Any) -> None:
    """Cold air shrinks heights; the start at -25 K was silent half the time."""
    rows = list(play(seed, 600.0, follow, scale=scale))
    assert not [row for row in rows if row[2]]


@settings(QUICK, max_examples=2)
@example(1070068950, 30.46, -1.0, 0.0754, 0.0)
@example(3890561337, 33.31, -1.0, 0.0627, 0.0)
@example(3870285434, 48.57, 1.0, -0.0586, 0.0)
@example(2, 30.0, 1.0, 0.03, 4.0)
@given(seeds, st.floats(30.0, 100.0), signs, st.floats(-0.06, 0.06), st.floats(0.0, 4.0))
def test_a_receiver_that_jumped_is_not_back_by_drift(
    seed: int, size_m: float, sign: float, scale: float, white_sd_m: float
) -> None:
    """A climb of 270 m in stretched air and the receiver's slow error brought one within 14 m, and
    it was believed while 25 m wrong; one noisy fix of 40 was half a jump nearer than another. A
    receiver is back when it jumps back, wherever both have drifted."""
    checker = Checker()
    fault = step(200.0, sign * size_m, 600.0)
    for time_s, _, _ in play(
        seed,
        700.0,
        truth,
        gnss_fault=fault,
        scale=scale,
        white_sd_m=white_sd_m,
        checker=checker,
    ):
        if 202.0 <= time_s < 600.0:
            assert checker.sensors.state["excluded"][0] == Kind.GNSS, time_s
        elif time_s >= 602.0:
            assert checker.sensors.state["agree"][0], time_s


@QUICK
@given(seeds, st.floats(60.0, 1000.0), signs, st.floats(150.0, 200.0), st.floats(0.001, 5.0))
def test_an_altitude_that_follows_a_gnss_step_is_not_supported(
    seed: int, size_m: float, sign: float, at_s: float, claim_m: float
) -> None:
    """Whatever accuracy the false fixes report; one that stays right is supported throughout."""
    fault = step(at_s, sign * size_m, at_s + 120.0)
    kept = published(play(seed, 400.0, gnss, gnss_fault=fault, sd_m=min(claim_m, 3.0)))
    assert max(abs(error_m) for _, error_m in kept) < 50.0
    assert kept[-1][0] > 400.0  # supported again after the step
    rows = list(play(seed, 400.0, truth, gnss_fault=fault, sd_m=min(claim_m, 3.0)))
    assert not [row for row in rows if row[2]]


@QUICK
@given(seeds, st.floats(60.0, 1000.0), signs, st.floats(30.0, 200.0))
def test_an_altitude_that_follows_a_barometer_step_is_not_supported(
    seed: int, size_m: float, sign: float, at_s: float
) -> None:
    """One that stays right is supported, but for the first second while nothing says whose it
    is."""
    fault = step(at_s, sign * size_m)
    kept = published(play(seed, at_s + 60.0, baro, baro_fault=fault))
    assert max(abs(error_m) for _, error_m in kept) < 50.0
    rows = play(seed, at_s + 60.0, truth, baro_fault=fault)
    assert not [row for row in rows if row[2] and not at_s <= row[0] <= at_s + GRACE_S]


@settings(QUICK, derandomize=True)
@given(
    seeds, st.floats(0.5, 3.0), signs, st.sampled_from((gnss, baro)), st.sampled_from(("g", "b"))
)
def test_a_ramp_of_either_sensor_is_silent_before_fifty_metres(
    seed: int, rate_mps: float, sign: float, follow: Any, faulty: str
) -> None:
    """Whoever is followed: where nothing says whose fault it is, nothing is supported.

    Always the same examples: in 6 of 360 random ones a ramp of about 1 m/s or less, which begins
    with a climb, looks like cold air and reaches 51 to 74 m.
    """
    fault = ramp(100.0, sign * rate_mps)
    of_gnss, of_baro = (fault, nothing) if faulty == "g" else (nothing, fault)
    kept = published(
        play(seed, 100.0 + 200.0 / rate_mps, follow, gnss_fault=of_gnss, baro_fault=of_baro)
    )
    assert max(abs(error_m) for _, error_m in kept) < 50.0


@QUICK
@given(seeds, st.floats(60.0, 400.0), signs)
def test_without_gnss_the_barometer_bounds_the_altitude(
    seed: int, error_m: float, sign: float
) -> None:
    """An altitude that runs away in an outage is silent once it left what weather can do."""

    def runs_away(time_s: float, truth_m: float, *_: float) -> float:
        return truth_m + (sign * error_m if time_s > 200.0 else 0.0)

    kept = published(play(seed, 300.0, runs_away, gnss_until_s=150.0))
    assert max(abs(wrong_m) for _, wrong_m in kept) < 1.0


def test_before_anything_was_compared_nothing_is_objected() -> None:
    checker = Checker()
    assert checker.objection(0, 500.0) == ""
    checker.sample(Kind.PRESSURE, sample(Kind.PRESSURE, 1_000_000, pressure_pa=95_000.0))
    assert checker.objection(1_000_000, 500.0) == ""


class Liar:
    """Makes the estimate of a running filter wrong from an instant on."""

    def __init__(self, pipeline: Pipeline, from_us: int, until_restart: bool, by_m: float) -> None:
        self.restarts = 0
        self._step, self._from_us, self._by_m = pipeline.filter.step, from_us, by_m
        self._until_restart = until_restart
        self._estimate = pipeline.filter.estimate
        pipeline.filter.step = self  # type: ignore[assignment]

    def __call__(self, kind: Kind, row: Rows) -> Verdict:
        if kind is Kind.STATUS and row[0]["reboot"] == 1:
            self.restarts += 1
        verdict = self._step(kind, row)
        lies = row[0]["time_us"] >= self._from_us and not (self._until_restart and self.restarts)
        if lies and verdict is Verdict.USED:
            self._estimate["altitude_amsl_m"] += self._by_m
        return verdict


def test_a_wrong_estimator_is_silenced_and_restarted_once() -> None:
    """Health says why, one line tells of the restart, and what is still wrong stays silent."""
    for until_restart in (True, False):
        pipeline = Pipeline(CompanionSettings(), datagrams=True)
        liar = Liar(pipeline, 60_000_000, until_restart, 80.0)
        sent: list[bytes] = []
        for packet in standing(30.0, 120.0):
            sent += pipeline.feed(packet)
        messages = parsed(sent)
        heights = [m.altitude_amsl for m in messages if m.get_type() == "ALTITUDE"]
        assert max(abs(height_m - ALTITUDE_M) for height_m in heights) < 10.0
        texts = [m.text for m in messages if m.get_type() == "STATUSTEXT"]
        assert sum("restarted" in text for text in texts) == liar.restarts == 1
        assert any("contradicts" in text for text in texts)
        assert pipeline.checker.restarts == 1
        assert (pipeline.health.health is Health.OK) is until_restart


def test_another_boot_is_another_agreement() -> None:
    """After a reboot elsewhere nothing of the former place is held against the estimator."""
    pipeline = Pipeline(CompanionSettings(), datagrams=True)
    packets = standing(500.0, 560.0)
    elsewhere = 1500.0
    packets += standing(
        10.0,
        40.0,
        host_us=packets[-1].time_us,
        pressure=lambda boot_s: pressure(boot_s, elsewhere),
        gps=lambda boot_s: gps(boot_s, elsewhere + 100.0),
    )
    sent: list[bytes] = []
    for packet in packets:
        sent += pipeline.feed(Packet(packet.time_us, packet.data))
    assert pipeline.health.health is Health.OK
    assert pipeline.checker.restarts == 0


@QUICK
@given(seeds, st.floats(35.0, 500.0), signs)
def test_who_keeps_the_height_of_before_a_gnss_jump_stays_supported(
    seed: int, size_m: float, sign: float
) -> None:
    """Also when the jump has lasted longer than the flight before it. Who takes the new height
    after as long is supported too: the checker cannot tell which of the two is wrong."""
    fault = step(80.0, sign * size_m, 320.0)
    assert not [row for row in play(seed, 400.0, truth, gnss_fault=fault) if row[2]]

    def takes_it(time_s: float, truth_m: float, gnss_m: float, baro_m: float) -> float:
        return gnss_m if time_s > 200.0 else truth_m

    late = [row for row in play(seed, 300.0, takes_it, gnss_fault=fault) if row[0] > 210.0]
    assert not [row for row in late if row[2]]


@QUICK
@given(seeds)
def test_an_estimator_that_doubts_a_receiver_that_slides_away_is_not_restarted(seed: int) -> None:
    """It forgot the doubt, took the false height for the first, and published 64 m of error. One
    that doubts while the sensors agree is restarted after ten seconds, and after five minutes in
    which they agree on another difference: it stayed LOST for the rest of a flight."""
    for slides_m, lasts_s, restarts in (
        (15.0, 100.0, False),
        (15.0, 700.0, True),
        (0.0, 100.0, True),
    ):
        checker = Checker()
        random = np.random.default_rng(seed)
        asked = False
        for k in range(round(4 * lasts_s)):
            time_s = 10.0 + k / 4.0
            pressure_pa = float(standard_pressure_pa(np.array(300.0), SEA_LEVEL_PA))
            checker.sample(
                Kind.PRESSURE, sample(Kind.PRESSURE, round(time_s * 1e6), pressure_pa=pressure_pa)
            )
            slid_m = slides_m * min(1.0, max(0.0, time_s - 40.0) / 30.0)
            height_m = 300.0 + slid_m + random.normal(0.0, 0.3)
            checker.sample(Kind.GNSS, fix(time_s, height_m, 3.0))
            doubts = time_s > 70.0
            asked |= checker.asks_restart(round(time_s * 1e6), supported=not doubts)
        assert asked is restarts


def slid_in_a_climb(slid_m: Callable[[float], float]) -> Iterator[tuple[int, Checker]]:
    """The checker at every fix of a flight that climbs 2.5 m/s from 100 s on, whose receiver is off
    by `slid_m` of the time in s."""
    checker = Checker()
    for k in range(900):
        time_s = 10.0 + k / 4.0
        climbed_m = 2.5 * max(0.0, time_s - 100.0)
        pressure_pa = float(standard_pressure_pa(np.array(300.0 + climbed_m), SEA_LEVEL_PA))
        checker.sample(
            Kind.PRESSURE, sample(Kind.PRESSURE, round(time_s * 1e6), pressure_pa=pressure_pa)
        )
        checker.sample(Kind.GNSS, fix(time_s, 300.0 + climbed_m + slid_m(time_s), 3.0))
        yield round(time_s * 1e6), checker


def test_a_slide_in_a_climb_is_no_reason_to_restart_who_doubts_it() -> None:
    """The slide was taken for warm air, so the sensors agreed: the estimator forgot its doubt, and
    published 59 m of error."""
    for rate_mps, restarts in ((0.3, False), (0.0, True)):
        asked = False
        for now_us, checker in slid_in_a_climb(ramp(100.0, rate_mps)):
            asked |= checker.asks_restart(now_us, supported=now_us < 170_000_000)
        assert asked is restarts


def test_a_receiver_that_jumped_is_not_back_because_the_limit_grew() -> None:
    """A jump of 30 m was, after a climb of 230 m, within what air can do; who had kept the right
    height was restarted, and took the false one."""
    for now_us, checker in slid_in_a_climb(
        lambda s: 31.0 - 0.1 * (s - 100.0) if s > 100.0 else 0.0
    ):
        if now_us > 101_000_000:
            assert checker.sensors.state["excluded"][0] == Kind.GNSS


def apart(checker: Checker, from_s: float, until_s: float, apart_m: Height, sd_m: float) -> None:
    """Fixes four times a second that differ by `apart_m` of the time in s from a barometer that
    stands, with noise of .1 m."""
    for k in range(round(4 * from_s), round(4 * until_s)):
        time_s = k / 4.0
        pressure_pa = float(standard_pressure_pa(np.array(300.0 + 0.1 * (k % 2)), SEA_LEVEL_PA))
        checker.sample(
            Kind.PRESSURE, sample(Kind.PRESSURE, round(time_s * 1e6), pressure_pa=pressure_pa)
        )
        checker.sample(Kind.GNSS, fix(time_s, 300.0 + apart_m(time_s), sd_m))


def test_one_noisy_fix_ends_no_difference_that_has_lasted() -> None:
    """It made who follows the receiver silent for 70 s. A second jump ends it at once."""
    checker = Checker()
    glitches_m = {140.0: 130.0, 200.0: 70.0}
    apart(checker, 10, 250, lambda s: glitches_m.get(s, 100.0 if s > 80.0 else 0.0), 3.0)
    assert checker.objection(round(249.75e6), 400.0) == ""
    apart(checker, 250, 251, lambda _: 200.0, 3.0)
    assert checker.objection(round(250.75e6), 500.0) == "altitude contradicts the sensors"


def test_a_difference_that_slides_does_not_last() -> None:
    checker = Checker()
    apart(checker, 10, 300, lambda s: 100.0 + 0.3 * (s - 80.0) if s > 80.0 else 0.0, 3.0)
    assert checker.sensors.state["has_lasted"][0] == 0


def test_one_noisy_fix_after_an_outage_is_not_the_agreed_difference() -> None:
    """What can have drifted by 20 m followed the first fix by all of it, however noisy; when the
    fixes were exact again, they contradicted the right altitude."""
    checker = Checker()
    apart(checker, 10, 60, lambda _: 0.0, 3.0)
    checker.sensors.state["agreed"]["unknown_m"] = 20.0
    apart(checker, 60, 60.25, lambda _: 60.0, 25.0)
    assert checker.sensors.state["agreed"]["metres"][0] < 20.0 * 0.5
    apart(checker, 60.25, 75, lambda _: 0.0, 3.0)
    assert abs(checker.sensors.state["gap_m"][0]) < 2.0
