"""The vertical bank's hypotheses about faults: how they begin, what they need, how they end."""

import math
from typing import Any

import numpy as np
import pytest

from companion.estimators.method import Filter, run_log
from companion.estimators.vertical_bank import steps as vb
from companion.estimators.vertical_bank.beginning import bank_start
from companion.estimators.vertical_bank.channel import OFFSET
from companion.estimators.vertical_bank.hypotheses import (
    on_baro_surprise,
    on_gnss_surprise,
    search,
)
from companion.estimators.vertical_bank.inertial import has_seen, inertial_start, take_acceleration
from companion.estimators.vertical_bank.mixture import BA, GN, MO, RE, N
from companion.estimators.vertical_bank.settings import VerticalBankSettings
from companion.intake import restart_row
from companion.samples import FaultySensor, Kind
from tests.flights import Flight, flight


def bank_and_params() -> tuple[Any, Any]:
    params = VerticalBankSettings().params().view(np.recarray)
    bank = vb.METHOD.init(params).view(np.recarray)[0].bank
    bank_start(bank, params[0])
    bank.now_us, bank.slow_m2 = 100_000_000, 9.0
    bank.outage = bank.blind = 0
    return bank, params[0]


def test_what_explains_a_surprise_finds_a_slot_among_more_probable_slides() -> None:
    """Four slides of a thousandth each filled the table: a jump was then followed by 100 m."""
    bank, params = bank_and_params()
    bank.weight[GN:BA] = 1e-3
    on_gnss_surprise(bank, params, False, 0.2, False)
    assert bank.jumped[GN:BA].sum() == 1
    assert bank.weight[GN:BA].min() < 1e-5


def test_a_search_takes_no_slot_of_what_is_more_probable() -> None:
    bank, params = bank_and_params()
    bank.weight[GN:BA] = 1e-2
    bank.searched_us = bank.now_us - 10_000_000
    search(bank, params)
    assert bank.weight[GN:BA].min() > 4e-3


def test_a_surprise_may_be_the_end_of_a_fault_that_was_not_the_most_probable() -> None:
    bank, params = bank_and_params()
    bank.weight[GN] = 1e-2
    on_gnss_surprise(bank, params, False, 0.2, False)
    assert bank.weight[RE:N].max() == pytest.approx(1e-2 * 30.0 / 3600.0 * 0.2)


def test_a_barometer_may_return_to_the_offset_that_it_had() -> None:
    """As a jump of any size, its end was as improbable as a new fault."""
    bank, params = bank_and_params()
    bank.x[:, OFFSET] = 12.0
    search(bank, params)
    wrong = BA + int(bank.weight[BA:MO].argmax())
    bank.x[wrong, OFFSET] = 60.0
    bank.weight[RE:N] = 0.0
    weight = bank.weight[wrong]
    on_baro_surprise(bank, params, False, 0.1, math.nan, 1.0)
    well = RE + int(bank.weight[RE:N].argmax())
    assert bank.weight[well] == pytest.approx(weight * 30.0 / 3600.0 * 0.1)
    assert bank.x[well, OFFSET] == 12.0


def test_an_offset_that_is_where_it_was_has_nothing_to_return_from() -> None:
    """A step of 15 m was taken for the return of a fault that was a thousandth probable."""
    bank, params = bank_and_params()
    bank.x[:, OFFSET] = 12.0
    search(bank, params)
    bank.x[BA + int(bank.weight[BA:MO].argmax()), OFFSET] = 16.0
    bank.weight[RE:N] = 0.0
    on_baro_surprise(bank, params, False, 0.1, math.nan, 1.0)
    assert bank.weight[RE:N].max() == 0.0


@pytest.mark.parametrize("weather", [(1.0, 0.0, 0.0), (0.5, 0.3, 0.2)])
def test_a_fault_that_nothing_shows_becomes_more_probable(weather: tuple[float, ...]) -> None:
    """Each search made it as probable anew as the most probable weather allows: in mixed weather it
    stayed below the risk, and a blind altitude was published for a minute."""
    bank, params = bank_and_params()
    bank.outage = bank.blind = 1
    bank.weight[:3] = weather
    for _ in range(6):
        bank.searched_us = bank.now_us - 10_000_000
        search(bank, params)
    assert bank.weight[MO - 1] == pytest.approx(6 * 0.13 * 10.0 / 3600.0, rel=0.01)


def test_a_fault_that_nothing_shows_explains_no_reading() -> None:
    """While GNSS is away and the vehicle is blind, the unseen fault kept a jump of the barometer
    from being supposed: 71 m were published."""
    bank, params = bank_and_params()
    bank.outage = bank.blind = 1
    bank.H[OFFSET] = 1.0
    bank.weight[MO - 1] = 0.01
    bank.P[MO - 1, OFFSET, OFFSET] = 1e6
    on_baro_surprise(bank, params, True, 0.1, 50.0, 1.0)
    assert bank.weight[BA : MO - 1].max() > 0.0


@pytest.mark.parametrize(
    ("seed", "rate_mps", "start_s", "lasts_s"),
    [(858, -1.0, 113.8, 39.0), (889, 1.0, 103.6, 48.3), (17, -1.0, 115.8, 30.7)],
)
def test_a_barometer_that_slides_and_jumps_home_is_not_held_against_the_receiver(
    seed: int, rate_mps: float, start_s: float, lasts_s: float
) -> None:
    """The receiver stayed named after the jump, with a height 40 to 57 m wrong and a spread of
    6 m."""
    made = flight(imu_hz=25.0, pressure_hz=10.0, seed=seed)
    pressure = made.tables[Kind.PRESSURE]
    hit = made.within(Kind.PRESSURE, start_s, start_s + lasts_s)
    elapsed_s = made.elapsed_s(pressure["time_us"][hit]) - start_s
    pressure["pressure_pa"][hit] -= 11.6 * rate_mps * elapsed_s
    estimates, _, _ = run_log(vb.METHOD, made.log())
    after = made.elapsed_s(estimates["time_us"]) > start_s + lasts_s + 10.0
    error_m = estimates["altitude_amsl_m"] - made.truth_m(estimates["time_us"])
    assert not estimates["faulty"][after].any()
    assert np.abs(error_m[after]).max() < 10.0


def frozen(made: Flight, start_s: float, end_s: float) -> Flight:
    chosen = made.within(Kind.PRESSURE, start_s, end_s)
    pressures = made.tables[Kind.PRESSURE]["pressure_pa"]
    pressures[chosen] = pressures[np.flatnonzero(chosen)[0]]
    return made


def named_s(made: Flight, fault: FaultySensor) -> float:
    """Seconds of the first estimate that names a sensor, which must be this one."""
    estimates, _, _ = run_log(vb.METHOD, made.log())
    assert set(estimates["faulty"]) <= {0, fault}
    return float(made.elapsed_s(estimates["time_us"])[np.argmax(estimates["faulty"] == fault)])


@pytest.mark.parametrize("imu_hz", [0.0, 50.0])
@pytest.mark.parametrize("pressure_hz", [10.0, 20.0])
def test_a_frozen_barometer_is_named_within_half_a_second(
    imu_hz: float, pressure_hz: float
) -> None:
    """In a climb of 4 m/s: a stream that never repeated has repeated four times."""
    made = frozen(flight(imu_hz=imu_hz, pressure_hz=pressure_hz), 40.0, 60.0)
    assert 0.0 < named_s(made, FaultySensor.BAROMETER) - 40.0 <= 0.55


@pytest.mark.parametrize("resolution_pa", [10.0, 30.0, 100.0])
def test_chance_repeats_of_a_coarse_stream_are_nobodys_fault(resolution_pa: float) -> None:
    """A tenth of a hectopascal, and a whole one: 8 m, two seconds of the climb. They were held
    against the barometer for most of the flight."""
    made = flight()
    pressures = made.tables[Kind.PRESSURE]["pressure_pa"]
    pressures[:] = np.round(pressures / resolution_pa) * resolution_pa
    estimates, _, _ = run_log(vb.METHOD, made.log())
    assert not estimates["faulty"].any()


def test_a_stream_that_is_sent_twice_as_often_as_it_is_measured_may_repeat_once() -> None:
    made = flight(pressure_hz=20.0)
    pressures = made.tables[Kind.PRESSURE]["pressure_pa"]
    pressures[1::2] = pressures[: pressures[1::2].size * 2 : 2]
    estimates, _, _ = run_log(vb.METHOD, made.log())
    assert not estimates["faulty"].any()
    assert 0.0 < named_s(frozen(made, 40.0, 60.0), FaultySensor.BAROMETER) - 40.0 <= 1.0


def test_an_imu_that_was_away_denies_no_motion() -> None:
    """After a gap of every sensor the barometer alone was held against the IMU: a chance surprise
    made the height unknown."""
    params = VerticalBankSettings().params().view(np.recarray)
    imu = vb.METHOD.init(params).view(np.recarray)[0].imu
    inertial_start(imu, params[0])
    for time_us in (*range(20_000, 1_000_000, 20_000), *range(6_000_000, 6_200_000, 20_000)):
        take_acceleration(imu, params[0], 0.02, time_us, 0.0)
    assert has_seen(imu, 6_200_000, 0.15)
    assert not has_seen(imu, 6_200_000, 5.0)


@pytest.mark.parametrize("imu_hz", [0.0, 10.0])
@pytest.mark.parametrize(("step_m", "rate_mps"), [(30.0, 2.0), (30.0, 0.5), (-30.0, -1.0)])
def test_a_receiver_that_slides_after_a_jump_does_not_take_the_height_along(
    imu_hz: float, step_m: float, rate_mps: float
) -> None:
    """It was taken to stay where it jumped to, so the height followed by up to 115 m; and it stayed
    excluded when it was right again."""
    made = flight(imu_hz=imu_hz, pressure_hz=10.0)
    elapsed_s = made.elapsed_s(made.tables[Kind.GNSS]["time_us"])
    wrong = (elapsed_s >= 100.0) & (elapsed_s < 150.0)
    error_m = step_m + rate_mps * (elapsed_s - 100.0)
    made.tables[Kind.GNSS]["altitude_amsl_m"][wrong] += error_m[wrong]
    estimates, _, _ = run_log(vb.METHOD, made.log())
    off_m = estimates["altitude_amsl_m"] - made.truth_m(estimates["time_us"])
    elapsed_s = made.elapsed_s(estimates["time_us"])
    assert np.abs(off_m[elapsed_s > 60.0]).max() < 15.0
    assert not estimates["faulty"][elapsed_s > 190.0].any()


@pytest.mark.parametrize(
    ("imu_hz", "step_m", "rate_mps", "start_s", "lasts_s", "seed"),
    [(25.0, 30.0, -1.0, 97.4, 28.9, 343), (2.0, -30.0, 0.5, 102.4, 50.5, 895)],
)
def test_a_receiver_that_slides_back_to_where_it_was_is_used_again(
    imu_hz: float, step_m: float, rate_mps: float, start_s: float, lasts_s: float, seed: int
) -> None:
    """It stood still again, a metre off, and stayed excluded for minutes: nothing jumps when such
    a fault ends."""
    made = flight(imu_hz=imu_hz, pressure_hz=10.0, seed=seed)
    gnss = made.tables[Kind.GNSS]
    hit = made.within(Kind.GNSS, start_s, start_s + lasts_s)
    elapsed_s = made.elapsed_s(gnss["time_us"][hit]) - start_s
    gnss["altitude_amsl_m"][hit] += step_m + rate_mps * elapsed_s
    estimates, _, _ = run_log(vb.METHOD, made.log())
    excluded = estimates["faulty"] == FaultySensor.GNSS
    late = made.elapsed_s(estimates["time_us"]) > start_s + lasts_s + 40.0
    assert excluded.any()
    assert not excluded[late].any()


@pytest.mark.parametrize("imu_hz", [0.0, 2.0, 50.0])
@pytest.mark.parametrize(("step_m", "start_s"), [(15.0, 50.0), (-15.0, 50.0), (15.0, 120.0)])
def test_a_barometer_step_that_no_vehicle_can_fly_is_named_within_half_a_second(
    imu_hz: float, step_m: float, start_s: float
) -> None:
    """Without an IMU the step was taken for a climb, in level flight and in one: 13 m of error, and
    never named."""
    made = flight(imu_hz=imu_hz, pressure_hz=10.0)
    made.tables[Kind.PRESSURE]["pressure_pa"][made.within(Kind.PRESSURE, start_s, 150.0)] -= (
        11.6 * step_m
    )
    assert 0.0 < named_s(made, FaultySensor.BAROMETER) - start_s <= 0.5
    estimates, _, _ = run_log(vb.METHOD, made.log())
    off_m = estimates["altitude_amsl_m"] - made.truth_m(estimates["time_us"])
    assert np.abs(off_m[made.elapsed_s(estimates["time_us"]) > 40.0]).max() < 10.0


@pytest.mark.parametrize("imu_hz", [0.0, 50.0])
def test_single_wild_heights_of_a_barometer_are_nobodys_fault(imu_hz: float) -> None:
    made = flight(imu_hz=imu_hz, pressure_hz=10.0)
    made.tables[Kind.PRESSURE]["pressure_pa"][50::97] -= 11.6 * 40.0
    estimates, _, _ = run_log(vb.METHOD, made.log())
    off_m = estimates["altitude_amsl_m"] - made.truth_m(estimates["time_us"])
    assert not estimates["faulty"].any()
    assert np.abs(off_m[made.elapsed_s(estimates["time_us"]) > 40.0]).max() < 10.0


@pytest.mark.parametrize("imu_hz", [0.0, 2.0])
def test_without_an_imu_a_blocked_port_is_not_published_as_a_receiver_that_slides(
    imu_hz: float,
) -> None:
    """The port leaks with 90 s and opens again: both say that the other slides, and no IMU says
    which. GNSS was named, and 117 m of error had a level of 24 m."""
    made = flight(imu_hz=imu_hz, pressure_hz=10.0, duration_s=900.0)
    elapsed_s = made.elapsed_s(made.tables[Kind.PRESSURE]["time_us"])
    off_m = (
        2.5
        * np.clip(elapsed_s - 200.0, 0.0, 90.0)
        * np.exp(-np.maximum(0.0, elapsed_s - 400.0) / 90.0)
    )
    made.tables[Kind.PRESSURE]["pressure_pa"] *= np.exp(-off_m / 8400.0)
    estimates, _, _ = run_log(vb.METHOD, made.log())
    off_m = np.abs(estimates["altitude_amsl_m"] - made.truth_m(estimates["time_us"]))
    level_m = estimates["protection_level_m"]
    is_published = (level_m <= 50.0) & (made.elapsed_s(estimates["time_us"]) > 60.0)
    assert not (off_m > 50.0)[is_published].any()


def test_a_dead_barometer_leaves_a_receiver_that_reports_too_much_in_use() -> None:
    """A simulator's receiver swings by metres and says RTK fixed. Its type was believed again after
    ten minutes; beside a barometer that was dead by then it was excluded, and the height ran off
    by kilometres."""
    made = frozen(flight(duration_s=1300.0), 120.0, 1300.0)
    gnss = made.tables[Kind.GNSS]
    gnss["fix_type"], gnss["vertical_sd_m"] = 6, 0.3
    elapsed_s = made.elapsed_s(gnss["time_us"])
    swings_m = np.sin(elapsed_s * 0.5) + 3.0 * np.sin(elapsed_s * 0.02)
    gnss["altitude_amsl_m"] = made.truth_m(gnss["time_us"]) + swings_m
    estimates, _, _ = run_log(vb.METHOD, made.log())
    late = made.elapsed_s(estimates["time_us"]) > 130.0
    error_m = estimates["altitude_amsl_m"] - made.truth_m(estimates["time_us"])
    assert np.abs(error_m[late]).max() < 6.0
    assert (np.abs(error_m) < estimates["protection_level_m"])[late].all()
    assert (estimates["fault_probabilities"][late, 1] < 0.5).all()


@pytest.mark.parametrize("rate_mps", [2.0, -2.0])
@pytest.mark.parametrize("start_s", [40.0, 130.0])
def test_a_precise_receiver_that_slides_is_named(start_s: float, rate_mps: float) -> None:
    """RTK fixed, spoofed: the IMU was named within a second, then the barometer, and the height
    went along with a spread of centimetres."""
    made = flight()
    gnss = made.tables[Kind.GNSS]
    gnss["fix_type"], gnss["vertical_sd_m"] = 6, 0.3
    elapsed_s = made.elapsed_s(gnss["time_us"])
    slide_m = rate_mps * np.clip(elapsed_s - start_s, 0.0, 60.0)
    noise_m = np.random.default_rng(3).normal(0.0, 0.05, elapsed_s.size)
    gnss["altitude_amsl_m"] = made.truth_m(gnss["time_us"]) + noise_m + slide_m
    estimates, _, _ = run_log(vb.METHOD, made.log())
    seconds = made.elapsed_s(estimates["time_us"])
    error_m = np.abs(estimates["altitude_amsl_m"] - made.truth_m(estimates["time_us"]))
    during = (seconds > start_s) & (seconds < start_s + 60.0)
    assert (estimates["faulty"][(seconds > start_s + 12.0) & during] == FaultySensor.GNSS).all()
    assert error_m[during].max() < 8.0


def test_a_restart_in_flight_keeps_what_is_known_of_the_receiver() -> None:
    """Its fix type was believed again aloft, where nothing showed at once that it swings."""
    made = flight()
    gnss = made.tables[Kind.GNSS]
    gnss["fix_type"], gnss["vertical_sd_m"] = 6, 0.3
    elapsed_s = made.elapsed_s(gnss["time_us"])
    swings_m = np.where(elapsed_s < 100.0, 2.0 * np.sin(elapsed_s * 0.4), 2.0)
    gnss["altitude_amsl_m"] = made.truth_m(gnss["time_us"]) + swings_m
    running = Filter(vb.METHOD)
    log = made.log()
    order = log.tables.order
    restarts_us = int(made.start_us + 120e6)
    for entry in np.asarray(order):
        kind = Kind(int(entry["kind"]))
        row = log[kind][entry["row"] : entry["row"] + 1]
        if restarts_us and row[0]["time_us"] > restarts_us:
            running.step(Kind.STATUS, restart_row(restarts_us, restarts_us))
            restarts_us = 0
        running.step(kind, row)
    assert running.estimate["altitude_sd_m"][0] > 1.0
