"""The vertical bank on synthetic flights: accuracy, honesty, and what each part is for."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.estimators.method import Filter, run_log
from companion.estimators.vertical_bank import steps as vb
from companion.estimators.vertical_bank.settings import VerticalBankSettings, crossing_sigma
from companion.estimators.vertical_bank.state import STATE
from companion.samples import FaultySensor, Kind, Rows, Verdict, sample
from tests.flights import Flight, Plan, flight

Array = NDArray[np.float64]


def fly(made: Flight, settings: VerticalBankSettings | None = None) -> tuple[Rows, Array, Array]:
    """Estimates after every sample, their errors, and the seconds of each."""
    estimates, _, _ = run_log(vb.METHOD, made.log(), settings)
    known = np.isfinite(estimates["altitude_amsl_m"])
    estimates = estimates[known]
    return (
        estimates,
        estimates["altitude_amsl_m"] - made.truth_m(estimates["time_us"]),
        made.elapsed_s(estimates["time_us"]),
    )


def rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_follows_a_flight_and_knows_how_well() -> None:
    estimates, error, elapsed_s = fly(flight())
    late = elapsed_s > 60.0
    assert rms(error[late]) < 1.5
    assert 0.02 < np.mean((error[late] / estimates["altitude_sd_m"][late]) ** 2) < 1.4
    sums = estimates["drift_probabilities"].sum(axis=1)
    np.testing.assert_allclose(sums, 1.0, atol=1e-9)


@pytest.mark.parametrize("hectopascals", [-12.0, 12.0])
def test_sea_level_pressure_is_not_trusted(hectopascals: float) -> None:
    made = flight(duration_s=160.0)
    scaled = made.copy().change(
        Kind.PRESSURE, "pressure_pa", lambda p: p * (1.0 + hectopascals / 1013.25)
    )
    one, _, elapsed_s = fly(made)
    other, _, _ = fly(scaled)
    apart = np.abs(one["altitude_amsl_m"] - other["altitude_amsl_m"])[elapsed_s > 60.0]
    assert apart.max() < 0.1


def test_without_imu_and_with_a_slow_one() -> None:
    made = flight()
    whole = rms(fly(made)[1][2000:])
    for imu_hz in (0.0, 4.0):
        estimates, error, elapsed_s = fly(flight(imu_hz=imu_hz))
        assert rms(error[elapsed_s > 60.0]) < whole + 0.5
        assert np.isfinite(estimates["climb_mps"]).all()


def test_slow_imu_is_ignored_and_said_so() -> None:
    filter_ = Filter(vb.METHOD)
    for k in range(40):
        row = sample(
            Kind.IMU,
            250_000 * (k + 1),
            specific_force_b_mps2=(0.0, 0.0, -9.81),
            angular_rate_b_radps=(0, 0, 0),
        )
        assert filter_.step(Kind.IMU, row) is Verdict.IGNORED


def test_nothing_is_known_before_a_height() -> None:
    filter_ = Filter(vb.METHOD)
    row = sample(
        Kind.IMU, 1_000_000, specific_force_b_mps2=(0.0, 0.0, -9.81), angular_rate_b_radps=(0, 0, 0)
    )
    filter_.step(Kind.IMU, row)
    assert not filter_.is_valid
    filter_.step(Kind.PRESSURE, sample(Kind.PRESSURE, 1_100_000, pressure_pa=95_000.0))
    assert filter_.estimate["altitude_sd_m"][0] > 100.0


def test_vertical_velocity_helps() -> None:
    made = flight(gnss_sd_m=6.0, imu_hz=0.0, pressure_hz=2.0)
    with_climb = made.copy()
    climb = np.gradient(made.truth_m(made.tables[Kind.GNSS]["time_us"]), 0.2)
    with_climb.tables[Kind.GNSS]["climb_mps"] = climb
    without_sd = fly(made)[0]["climb_sd_mps"][-1]
    assert fly(with_climb)[0]["climb_sd_mps"][-1] < without_sd


def test_a_claim_that_gets_better_takes_the_slow_error_with_it() -> None:
    """The first minute of fixes slides from 700 m to the truth, and says so."""
    made = flight(duration_s=200.0)
    fixes = made.tables[Kind.GNSS]
    left_m = 700.0 * np.clip(1.0 - made.elapsed_s(fixes["time_us"]) / 60.0, 0.0, 1.0)
    fixes["altitude_amsl_m"] += left_m
    fixes["vertical_sd_m"] = np.maximum(fixes["vertical_sd_m"], left_m)
    estimates, error, elapsed_s = fly(made)
    late = elapsed_s > 80.0
    assert rms(error[late]) < 5.0
    assert np.mean((error[late] / estimates["altitude_sd_m"][late]) ** 2) < 1.4


@pytest.mark.parametrize("claims_m", [(9.0, 9.0), (8.1, 9.9), (8.0, 10.0)])
def test_a_claim_that_jitters_does_not_whiten_the_slow_error(claims_m: tuple[float, float]) -> None:
    """Six metres that wander for four minutes stay six metres, however the reported accuracy
    jitters around them."""
    nees = []
    for seed in range(6):
        made = flight(duration_s=300.0)
        fixes, rng = made.tables[Kind.GNSS], np.random.default_rng(seed)
        keep, wander_m = np.exp(-0.2 / 250.0), 6.0 * rng.standard_normal()
        for k in range(fixes.size):
            wander_m = keep * wander_m + 6.0 * np.sqrt(1.0 - keep**2) * rng.standard_normal()
            fixes["altitude_amsl_m"][k] += wander_m
            fixes["vertical_sd_m"][k] = claims_m[k % 2]
        estimates, error, elapsed_s = fly(made)
        late = elapsed_s > 100.0
        nees.append(np.mean((error[late] / estimates["altitude_sd_m"][late]) ** 2))
    assert 0.2 < np.mean(nees) < 2.0


def test_late_fixes_meet_their_own_time() -> None:
    """A fix that is 0.4 s old in a 4 m/s climb: uncompensated that is 1.6 m."""
    prompt, late = flight(duration_s=90.0, gnss_age_s=0.05), flight(duration_s=90.0, gnss_age_s=0.4)
    climbing = 60.0
    one, two = fly(prompt), fly(late)
    apart = np.mean(one[1][one[2] > climbing]) - np.mean(two[1][two[2] > climbing])
    assert abs(apart) < 0.15


@pytest.mark.parametrize("pressure_hz", [0.0, 20.0])
def test_inertial_integrals_belong_to_the_instant_of_the_channels(pressure_hz: float) -> None:
    """A biased accelerometer integrates to 80 m/s; taken for another instant by 10 ms, that would
    be 0.8 m."""
    straight, biased = (
        flight(pressure_hz=pressure_hz, force_bias_mps2=bias) for bias in (0.0, 0.3)
    )
    (one, _, elapsed_s), (other, _, _) = fly(straight), fly(biased)
    apart = (other["altitude_amsl_m"] - one["altitude_amsl_m"])[elapsed_s > 200.0]
    assert abs(np.mean(apart)) < 0.15


def test_lasting_baro_step_is_learned() -> None:
    made = flight().change(Kind.PRESSURE, "pressure_pa", lambda p: p - 170.0, 120.0)  # 15 m
    _, error, elapsed_s = fly(made)
    assert np.abs(error[elapsed_s > 60.0]).max() < 3.0


def test_step_costs_little_and_checkpoint_is_small() -> None:
    assert STATE.itemsize < 64 * 1024


# Integrity


def exclusions(made: Flight) -> list[tuple[float, int]]:
    """(seconds, `FaultySensor`) of every change of the excluded sensor."""
    estimates, _, elapsed_s = fly(made)
    changes = np.flatnonzero(np.diff(estimates["faulty"])) + 1
    return [(float(elapsed_s[k]), int(estimates["faulty"][k])) for k in changes]


def higher(step_m: float) -> Any:
    """A change of pressures by what a barometer reads `step_m` higher for."""
    return lambda p: p * (1.0 - step_m * 1.2e-4)


def test_a_healthy_flight_excludes_no_sensor() -> None:
    assert exclusions(flight()) == []


@pytest.mark.parametrize("step_m", [-30.0, 15.0, 40.0])
def test_baro_step_is_excluded_within_a_second_and_used_again(step_m: float) -> None:
    made = flight().change(Kind.PRESSURE, "pressure_pa", higher(step_m), 120.0)
    (onset_s, fault), (back_s, _) = exclusions(made)
    assert fault == FaultySensor.BAROMETER
    assert onset_s - 120.0 <= 1.0
    assert 5.0 <= back_s - onset_s <= 20.0


@pytest.mark.parametrize("imu_hz", [10.0, 25.0, 50.0])
def test_baro_ramp_does_little_harm(imu_hz: float) -> None:
    """A metre a second for a minute: while nothing says whose it is, the level covers it. 34 m
    were published while a storm of 0.25 m/s was as probable as one of 0.1 m/s is now."""
    made = flight(imu_hz=imu_hz)
    elapsed_s = made.elapsed_s(made.tables[Kind.PRESSURE]["time_us"])
    ramp_m = np.clip(elapsed_s - 120.0, 0.0, 60.0)
    made.tables[Kind.PRESSURE]["pressure_pa"] *= 1.0 - ramp_m * 1.2e-4
    estimates, error, elapsed_s = fly(made)
    late = elapsed_s > 60.0
    assert (np.abs(error) < estimates["protection_level_m"])[late].all()
    told = late & (estimates["protection_level_m"] < 50.0)
    assert np.abs(error[told]).max() < 40.0


def test_an_imu_that_shakes_between_its_samples_is_trusted_less() -> None:
    """With the noise of a quiet one, it would make the barometer look wrong."""
    made = flight(imu_hz=10.0, force_sd_mps2=1.0)
    assert exclusions(made) == []
    spread_m = [fly(each)[0]["climb_sd_mps"][-1] for each in (flight(imu_hz=10.0), made)]
    assert spread_m[1] > 2.0 * spread_m[0]


def test_without_integrity_no_sensor_is_excluded() -> None:
    made = flight().change(Kind.GNSS, "altitude_amsl_m", lambda h: h + 30.0, 100.0)
    estimates, error, elapsed_s = fly(made, VerticalBankSettings(integrity=False))
    assert set(estimates["faulty"]) == {0}
    assert np.abs(error[elapsed_s > 140.0] - 30.0).max() < 10.0, "the receiver is followed"


def test_frozen_barometer_in_a_climb() -> None:
    made = flight()
    chosen = made.within(Kind.PRESSURE, 40.0, 75.0)
    pressures = made.tables[Kind.PRESSURE]["pressure_pa"]
    pressures[chosen] = pressures[np.flatnonzero(chosen)[0]]
    (onset_s, fault), (back_s, _) = exclusions(made)
    assert fault == FaultySensor.BAROMETER
    assert onset_s - 40.0 <= 1.0
    assert back_s <= 75.0 + 15.0


def test_noise_and_spikes_of_the_barometer_are_nobodys_fault() -> None:
    rng = np.random.default_rng(1)
    noisy = flight().change(
        Kind.PRESSURE, "pressure_pa", lambda p: p + rng.normal(0, 10.0, p.shape), 120.0, 180.0
    )
    spiky = flight().change(
        Kind.PRESSURE, "pressure_pa", lambda p: np.where(rng.random(p.shape) < 0.01, p - 500, p)
    )
    for made in (noisy, spiky):
        assert exclusions(made) == []
        assert np.abs(fly(made)[1][3000:]).max() < 4.0


def test_gnss_step_is_excluded_and_stays_so_while_it_is_wrong() -> None:
    made = flight().change(Kind.GNSS, "altitude_amsl_m", lambda h: h + 30.0, 120.0, 220.0)
    (onset_s, fault), (back_s, _) = exclusions(made)
    assert fault == FaultySensor.GNSS
    assert onset_s - 120.0 <= 1.5
    assert 220.0 <= back_s <= 230.0
    _, error, elapsed_s = fly(made)
    assert np.abs(error[elapsed_s > 60.0]).max() < 6.0


def test_barometer_that_was_silent_may_come_back_with_another_datum() -> None:
    """540 m after ten seconds: learned anew, no sensor is excluded and the height stays."""
    made = (
        flight()
        .drop(Kind.PRESSURE, 120.0, 130.0)
        .change(Kind.PRESSURE, "pressure_pa", lambda p: p - 6000.0, 120.0)
    )
    assert exclusions(made) == []
    _, error, elapsed_s = fly(made)
    assert np.abs(error[elapsed_s > 60.0]).max() < 6.0


def test_value_that_repeats_at_rest_is_a_measurement() -> None:
    """A barometer that reads the same for minutes on the ground keeps the height while there is no
    GNSS."""
    made = flight(Plan(duration_s=120)).drop(Kind.GNSS, 60.0, 120.0)
    for name, kind in (("pressure_pa", Kind.PRESSURE), ("altitude_amsl_m", Kind.GNSS)):
        made.tables[kind][name] = made.tables[kind][name][0]
    made.tables[Kind.IMU]["angular_rate_b_radps"] = 0.0
    made.tables[Kind.IMU]["specific_force_b_mps2"] = (0.0, 0.0, -9.806)
    estimates, _, _ = fly(made)
    assert estimates["altitude_sd_m"][-1] < 5.0
    assert estimates["faulty"][-1] == FaultySensor.NONE


@pytest.mark.parametrize("step_m", [30.0, -30.0])
def test_gnss_that_jumped_stays_out_for_as_long_as_it_is_wrong(step_m: float) -> None:
    """Ten minutes: the spread of the height without it has long grown beyond the step."""
    made = flight(Plan(duration_s=800))
    wrong = made.within(Kind.GNSS, 120.0, 720.0)
    made.tables[Kind.GNSS]["altitude_amsl_m"][wrong] += step_m
    estimates, error, elapsed_s = fly(made)
    settled = (elapsed_s > 122.0) & (elapsed_s < 719.0)
    assert (estimates["faulty"][settled] == FaultySensor.GNSS).all()
    assert np.abs(error[elapsed_s > 60.0]).max() < 15.0
    assert (estimates["faulty"][elapsed_s > 730.0] == FaultySensor.NONE).all()


@pytest.mark.parametrize("rate_mps", [2.0, -2.0])
def test_gnss_that_slides_does_not_come_back_while_it_moves(rate_mps: float) -> None:
    made = flight()
    wrong = made.within(Kind.GNSS, 120.0, 200.0)
    elapsed_s = made.elapsed_s(made.tables[Kind.GNSS]["time_us"])
    made.tables[Kind.GNSS]["altitude_amsl_m"][wrong] += rate_mps * (elapsed_s[wrong] - 120.0)
    estimates, error, elapsed_s = fly(made)
    named = (elapsed_s > 120.0) & (estimates["faulty"] == FaultySensor.GNSS)
    assert elapsed_s[named][0] - 120.0 <= 20.0
    assert (
        estimates["faulty"][(elapsed_s > elapsed_s[named][0]) & (elapsed_s < 199.0)]
        == FaultySensor.GNSS
    ).all()
    assert np.abs(error[elapsed_s > 60.0]).max() < 20.0


def test_weather_is_nobodys_fault() -> None:
    """A pressure fall of 0.2 m/s, twice what the worst front does."""
    made = flight()
    elapsed_s = made.elapsed_s(made.tables[Kind.PRESSURE]["time_us"])
    made.tables[Kind.PRESSURE]["pressure_pa"] *= (
        1.0 - 0.2 * np.clip(elapsed_s - 100.0, 0.0, None) * 1.2e-4
    )
    assert exclusions(made) == []
    estimates, error, after_s = fly(made)
    assert np.abs(error[after_s > 60.0]).max() < 8.0
    assert estimates["baro_rate_mps"][-1] == pytest.approx(0.2, abs=0.1)


def test_wrong_imu_is_excluded_by_the_two_others() -> None:
    made = flight()
    force = made.tables[Kind.IMU]["specific_force_b_mps2"]
    force[made.within(Kind.IMU, 120.0, 150.0), 2] -= 2.0
    found = [(seconds, fault) for seconds, fault in exclusions(made) if fault == FaultySensor.IMU]
    assert found
    assert found[0][0] - 120.0 <= 5.0
    _, error, elapsed_s = fly(made)
    assert np.abs(error[elapsed_s > 160.0]).max() < 4.0


@pytest.mark.parametrize("wrong_mps2", [-15.0, -3.0, 3.0, 15.0])
@pytest.mark.parametrize("outage_s", [0.0, 60.0])
def test_an_imu_that_goes_wild_does_not_carry_the_height_away(
    wrong_mps2: float, outage_s: float
) -> None:
    """For a minute, and with GNSS or without: the others know better within seconds."""
    made = flight(duration_s=300.0)
    made.tables[Kind.IMU]["specific_force_b_mps2"][made.within(Kind.IMU, 120.0, 180.0), 2] -= (
        wrong_mps2
    )
    made.drop(Kind.GNSS, 115.0, 115.0 + outage_s)
    _, error, elapsed_s = fly(made)
    assert np.abs(error[elapsed_s > 60.0]).max() < 40.0
    assert np.abs(error[elapsed_s > 130.0]).max() < 25.0
    assert np.abs(error[elapsed_s > 240.0]).max() < 8.0


def lost() -> Flight:
    """The barometer freezes in the climb, and GNSS jumps 200 m for the rest of the flight."""
    made = flight(duration_s=300.0).change(
        Kind.PRESSURE, "pressure_pa", lambda p: p * 0 + p[0], 50.0
    )
    return made.change(Kind.GNSS, "altitude_amsl_m", lambda h: h + 200.0, 80.0)


def test_two_wrong_sensors_are_covered_by_the_level() -> None:
    """Barometer frozen and GNSS jumped: what the IMU alone still knows is told with its doubt."""
    estimates, error, elapsed_s = fly(lost())
    late = elapsed_s > 60.0
    assert (np.abs(error) < estimates["protection_level_m"])[late].all()
    assert np.abs(error[late & (estimates["protection_level_m"] < 50.0)]).max() < 35.0


def test_height_above_takeoff_with_two_wrong_sensors_is_as_good_as_the_height() -> None:
    made = lost().stand()
    estimates, error, elapsed_s = fly(made)
    late = elapsed_s > 95.0
    above_m = estimates["height_above_takeoff_m"] - (
        made.truth_m(estimates["time_us"]) - made.plan.start_m
    )
    assert np.abs(above_m - error)[late].max() < 10.0


@pytest.mark.parametrize(
    "shift_m",
    [
        -20.0,
        15.0,
        30.0,
    ],
)
def test_barometer_that_shifts_while_gnss_is_away_is_found_out_when_it_returns(
    shift_m: float,
) -> None:
    made = flight(duration_s=260.0).drop(Kind.GNSS, 115.0, 124.0)
    pressure = made.tables[Kind.PRESSURE]
    pressure["pressure_pa"] -= (
        11.5 * shift_m * np.clip((made.elapsed_s(pressure["time_us"]) - 119.0) / 1.5, 0.0, 1.0)
    )
    _, error, elapsed_s = fly(made)
    assert np.abs(error[elapsed_s > 130.0]).max() < 5.0


@pytest.mark.parametrize(("shift_m", "over_s"), [(50.0, 2.0), (300.0, 20.0)])
@pytest.mark.parametrize("outage_s", [40.0, 100.0])
def test_barometer_that_shifts_against_the_imu_in_an_outage_makes_the_height_unknown(
    shift_m: float, over_s: float, outage_s: float
) -> None:
    """Nothing tells which of the two is wrong: silent, until GNSS is back, and then right."""
    made = flight(duration_s=300.0).drop(Kind.GNSS, 115.0, 115.0 + outage_s)
    pressure = made.tables[Kind.PRESSURE]
    share = np.clip((made.elapsed_s(pressure["time_us"]) - 125.0) / over_s, 0.0, 1.0)
    pressure["pressure_pa"] *= 1.0 - 1.2e-4 * shift_m * share
    estimates, error, elapsed_s = fly(made)
    told = (elapsed_s > 60.0) & (estimates["protection_level_m"] < 50.0)
    assert np.abs(error[told]).max() < 35.0
    assert told[elapsed_s > 125.0 + outage_s].mean() > 0.9
    assert np.abs(error[elapsed_s > 125.0 + outage_s]).max() < 10.0


def test_exclusion_of_an_imu_that_died_ends_and_gnss_is_monitored_again() -> None:
    made = flight(duration_s=260.0)
    made.tables[Kind.IMU]["specific_force_b_mps2"][made.within(Kind.IMU, 100.0, 103.0), 2] -= 15.0
    made.drop(Kind.IMU, 103.0)
    fixes = made.tables[Kind.GNSS]
    fixes["altitude_amsl_m"] += 2.0 * np.clip(made.elapsed_s(fixes["time_us"]) - 150.0, 0.0, 100.0)
    _, error, elapsed_s = fly(made)
    assert np.abs(error[elapsed_s > 110.0]).max() < 20.0


def test_barometer_frozen_from_the_start_is_found_out() -> None:
    made = flight().change(Kind.PRESSURE, "pressure_pa", lambda p: p * 0 + p[0])
    _, error, elapsed_s = fly(made)
    assert FaultySensor.BAROMETER in {fault for _, fault in exclusions(made)}
    assert np.abs(error[elapsed_s > 60.0]).max() < 10.0


def with_redundant(made: Flight, kind: Kind, offset: Any) -> Flight:
    """With a second instance of a sensor, a millisecond later and by `offset` different."""
    table = made.tables[kind]
    second = table.copy()
    second["instance"], second["time_us"] = 1, table["time_us"] + 1000
    name = "pressure_pa" if kind is Kind.PRESSURE else "altitude_amsl_m"
    second[name] += offset
    both = np.concatenate([table, second])
    made.tables[kind] = both[np.argsort(both["time_us"], kind="stable")]
    return made


def test_second_receiver_stands_in() -> None:
    made = with_redundant(flight(), Kind.GNSS, 4.0)
    table = made.tables[Kind.GNSS]
    wrong = (table["instance"] == 0) & made.within(Kind.GNSS, 120.0, 260.0)
    table["altitude_amsl_m"][wrong] += 40.0
    estimates, error, elapsed_s = fly(made)
    assert np.abs(error[elapsed_s > 60.0]).max() < 5.0
    assert estimates["altitude_sd_m"][-1] < 3.5


def test_second_barometer_stands_in() -> None:
    made = with_redundant(flight(), Kind.PRESSURE, 50.0)
    keep = (made.tables[Kind.PRESSURE]["instance"] == 1) | ~made.within(Kind.PRESSURE, 120.0, 260.0)
    made.tables[Kind.PRESSURE] = made.tables[Kind.PRESSURE][keep]
    estimates, error, elapsed_s = fly(made)
    assert np.abs(error[elapsed_s > 60.0]).max() < 3.0
    assert estimates["climb_sd_mps"][-1] < 0.3


def test_height_above_takeoff_without_arming_is_that_of_the_first_climb() -> None:
    made = flight().stand()
    estimates, _, elapsed_s = fly(made)
    late = elapsed_s > 40.0
    height = made.truth_m(estimates["time_us"]) - made.plan.start_m
    assert rms((estimates["height_above_takeoff_m"] - height)[late]) < 1.0
    assert np.isnan(estimates["height_above_takeoff_m"][elapsed_s < 15.0]).all()


def test_height_above_takeoff_counts_from_arming() -> None:
    made = flight()
    status = made.tables[Kind.STATUS]
    status["armed"] = made.elapsed_s(status["time_us"]) >= 10.0
    estimates, _, elapsed_s = fly(made)
    late = elapsed_s > 12.0
    height = made.truth_m(estimates["time_us"]) - made.plan.start_m
    assert rms((estimates["height_above_takeoff_m"] - height)[late]) < 0.8


def restarted(made: Flight, at_s: float, clock_s: float) -> Flight:
    """A restart of the estimator at `at_s`, where the vehicle's clock then reads `clock_s`."""
    row = sample(Kind.STATUS, round(clock_s * 1e6), armed=-1, landed=-1, reboot=1)
    row["arrival_us"] = np.interp(
        at_s,
        *(made.elapsed_s(made.tables[Kind.IMU]["time_us"]), made.tables[Kind.IMU]["arrival_us"]),
    )
    made.tables[Kind.STATUS] = np.concatenate([made.tables[Kind.STATUS], row])
    return made


def test_a_restart_in_flight_keeps_the_place_of_the_takeoff() -> None:
    """The checker restarts an estimator that it does not support; the vehicle's clock goes on."""
    at_s = 120.0
    made = flight().stand()
    estimates, _, elapsed_s = fly(restarted(made, at_s, made.plan.boot_s + at_s))
    height = made.truth_m(estimates["time_us"]) - made.plan.start_m
    late = elapsed_s > at_s + 5.0
    assert np.abs(estimates["height_above_takeoff_m"] - height)[late].max() < 6.0


def test_a_flight_that_is_first_heard_in_the_air_has_no_takeoff() -> None:
    """The climbs of a vehicle that moves, or says that it flies, do not begin on the ground."""
    moving, hovering = flight(), flight().stand(1e9)
    hovering.tables[Kind.STATUS]["landed"] = 0
    for made in (moving, hovering):
        assert np.isnan(fly(made)[0]["height_above_takeoff_m"]).all()


def test_a_reboot_of_the_vehicle_forgets_the_takeoff() -> None:
    made = flight().stand()
    for kind, table in made.tables.items():  # what is heard from 120 s on is of a new boot
        made.tables[kind] = table[made.elapsed_s(table["time_us"]) < 120.0]
    estimates, _, _ = run_log(vb.METHOD, restarted(made, 119.9, 1.0).log())
    assert np.isnan(estimates["height_above_takeoff_m"][-1])


def test_protection_level_covers_and_grows_with_a_smaller_risk() -> None:
    made = flight()
    estimates, error, elapsed_s = fly(made)
    late = elapsed_s > 30.0
    assert (np.abs(error) < estimates["protection_level_m"])[late].all()
    assert np.median(estimates["protection_level_m"][late]) < 25.0
    safer, _, _ = fly(made, VerticalBankSettings(integrity_risk_probability=1e-5))
    assert (safer["protection_level_m"] > estimates["protection_level_m"])[late].all()


@pytest.mark.parametrize("claimed_m", [11.0, 19.0, 26.0])
def test_a_receiver_that_reports_a_large_spread_is_published(claimed_m: float) -> None:
    made = flight().change(Kind.GNSS, "vertical_sd_m", lambda _: claimed_m)
    estimates, _, elapsed_s = fly(made)
    late = elapsed_s > 10.0
    assert (estimates["protection_level_m"] > 50.0)[late].any()
    assert (estimates["protection_level_m"] <= estimates["alert_limit_m"])[late].all()


def test_without_a_receiver_the_alert_limit_is_the_setting() -> None:
    made = flight().change(Kind.GNSS, "vertical_sd_m", lambda _: 19.0).drop(Kind.GNSS, 100.0, 400.0)
    estimates, _, elapsed_s = fly(made)
    away = (elapsed_s > 110.0) & (elapsed_s < 290.0)
    assert (estimates["alert_limit_m"][away] == 50.0).all()
    assert (estimates["protection_level_m"] > 50.0)[away].all()


@pytest.mark.parametrize("rate_per_h", [1e-1, 1e-3, 1e-5])
def test_crossing_sigma_inverts_the_rate(rate_per_h: float) -> None:
    k, time_s = crossing_sigma(rate_per_h, 250.0), 250.0
    rate = 3600.0 / time_s * 2.0 * k / np.sqrt(2.0 * np.pi) * np.exp(-0.5 * k * k)
    assert rate == pytest.approx(rate_per_h, rel=1e-6)


@pytest.mark.slow
def test_hours_of_the_model_are_estimated_consistently() -> None:
    """Thirty hours of flight as the bank assumes flights to be: NEES of height near 1, no false
    alarm."""
    from sim.studies.goals.sensor_level import fly as fly_hour
    from sim.studies.goals.sensor_level import hour

    nees, exceeded, alarmed = [], 0, []
    for seed in range(30):
        estimates, error, elapsed_s = fly_hour(hour(seed))
        late = elapsed_s > 60.0
        nees.append(np.mean((error[late] / estimates["altitude_sd_m"][late]) ** 2))
        exceeded += bool((np.abs(error[late]) > estimates["protection_level_m"][late]).any())
        alarmed += [seed] if estimates["faulty"].any() else []
    assert 0.7 < np.mean(nees) < 1.4
    assert exceeded <= 2  # 0.03 allocated; the mixture's tails are heavier than its Gaussian
    assert set(alarmed) <= {24}
    if alarmed:
        pytest.xfail(
            "hour 24 is one of the two in 3000 that name a healthy sensor: its static port and lag "
            "err by two sigma of their priors, and a receiver that slides explains that; the level "
            "covers it"
        )


def test_doubt_in_the_datum_widens_what_is_published_and_nothing_else() -> None:
    made = flight()
    doubted = made.copy()
    doubted.tables[Kind.GNSS]["vertical_sd_m"] = np.hypot(1.5, 19.0)
    doubted.tables[Kind.GNSS]["datum_sd_m"] = 19.0
    one, _, elapsed_s = fly(made)
    other, _, _ = fly(doubted)
    late = elapsed_s > 10.0
    np.testing.assert_allclose(other["altitude_amsl_m"], one["altitude_amsl_m"], atol=1e-6)
    expected = np.hypot(one["altitude_sd_m"], 19.0)
    np.testing.assert_allclose(other["altitude_sd_m"][late], expected[late], rtol=1e-6)
    assert (other["protection_level_m"] <= other["alert_limit_m"])[late].all()


@pytest.mark.parametrize("fix_type", [5, 6])
def test_a_fix_of_a_better_type_that_swings_by_metres_counts_as_a_plain_one(fix_type: int) -> None:
    """Over a metre to and fro in sixteen seconds, as in a recorded simulation that says RTK."""
    made = flight()
    gnss = made.tables[Kind.GNSS]
    gnss["fix_type"], gnss["vertical_sd_m"] = fix_type, 0.3
    elapsed_s = made.elapsed_s(gnss["time_us"])
    gnss["altitude_amsl_m"] = made.truth_m(gnss["time_us"]) + 1.2 * np.sin(elapsed_s * 0.4)
    assert FaultySensor.GNSS not in {fault for _, fault in exclusions(made)}
    estimates, error, seconds = fly(made)
    late = seconds > 60.0
    assert rms(error[late]) < 2.5
    assert (estimates["altitude_sd_m"][late] > 1.0).all()


def at_rest(swings_m: float, claims_m: float) -> Rows:
    """The last estimate over five minutes on the ground, where a receiver swings over 90 s."""
    running, random = Filter(vb.METHOD), np.random.default_rng(4)
    for k in range(1500):
        time_us, noise_pa = 1_000_000 + 200_000 * k, random.normal(0.0, 3.0)
        running.step(Kind.PRESSURE, sample(Kind.PRESSURE, time_us, pressure_pa=95e3 + noise_pa))
        swing_m = swings_m * math.sqrt(2.0) * math.sin(math.tau * 0.2 * k / 90.0)
        fix = sample(
            Kind.GNSS,
            time_us,
            altitude_amsl_m=540.0 + swing_m,
            vertical_sd_m=claims_m,
            ground_speed_mps=0.1,
            fix_type=3,
        )
        running.step(Kind.GNSS, fix)
    return running.state


def test_a_receiver_that_swings_at_rest_is_trusted_less_than_it_reports() -> None:
    """Recorded: reports of .8 m, swings of 5 m. A receiver that is as good as it says stays so."""
    swings, steady, honest = at_rest(5.0, 0.8), at_rest(0.5, 0.8), at_rest(4.0, 4.0)
    assert 3.5 < math.sqrt(swings["bank"]["slow_m2"][0]) < 5.0
    assert math.sqrt(steady["bank"]["slow_m2"][0]) == pytest.approx(2.5, abs=0.05)
    assert math.sqrt(honest["bank"]["slow_m2"][0]) == pytest.approx(4.0, abs=0.1)


def test_rtk_fixes_without_an_imu_are_as_good_as_with_one() -> None:
    """Centimetres at five fixes a second: their own differences tell how the vehicle manoeuvres."""
    made = flight(imu_hz=0.0)
    fixes, random = made.tables[Kind.GNSS], np.random.default_rng(8)
    fixes["altitude_amsl_m"] = made.truth_m(fixes["time_us"]) + random.normal(0.0, 0.01, fixes.size)
    fixes["vertical_sd_m"], fixes["fix_type"] = 0.01, 6
    estimates, error, elapsed_s = fly(made)
    late = elapsed_s > 60.0
    assert rms(error[late]) < 0.05
    assert 0.4 < rms(error[late]) / rms(estimates["altitude_sd_m"][late]) < 2.0
    assert np.median(estimates["protection_level_m"][late]) < 0.5
    assert not estimates["faulty"].any()
