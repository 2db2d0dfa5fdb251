"""Genetic search of the damping loop's gains: the paper's coding and schedule, and what a flight
must have."""

import math

import numpy as np
import pytest
import yaml

from companion.errors import LogFormatError
from companion.estimators.baro_inertial import genetic, tuning
from companion.estimators.baro_inertial.damping_loop import DampingLoopSettings
from companion.estimators.baro_inertial.genetic import PAPER_GAINS, STRING_BITS, decode, encode
from companion.samples import Kind, SampleLog, sample
from tests.flights import Flight, flight


@pytest.fixture(scope="module")
def flown() -> Flight:
    return flight(duration_s=100.0)


@pytest.mark.parametrize(
    ("generation", "expected"),
    [
        (0, 0.11791666666666667),
        (1, 0.06104166666666667),
        (5, 0.007721354166666666),
        (10, 0.004277750651041666),
    ],
)
def test_mutation_schedule(generation: int, expected: float) -> None:
    """vectors.json 004 "pm"; the floor is one bit of 16 strings of 15."""
    assert genetic.mutation_probability(generation) == pytest.approx(expected, rel=1e-14)
    assert genetic.mutation_probability(60) == pytest.approx(
        1.0 / (genetic.POPULATION * STRING_BITS), rel=1e-9
    )


def test_coding() -> None:
    """5 bits a gene on [0, 3], [0, 1], [0, 1]; the paper's gains are on the grid."""
    assert decode(0) == (0.0, 0.0, 0.0)
    assert decode(2**STRING_BITS - 1) == (3.0, 1.0, 1.0)
    assert encode(PAPER_GAINS) == 0b11111_10100_11011
    np.testing.assert_allclose(
        decode(encode((3.0, 0.6452, 0.8710))), (3.0, 0.6452, 0.8710), atol=5e-5
    )
    assert all(encode(decode(string)) == string for string in range(0, 2**STRING_BITS, 37))
    assert genetic.distance(encode((3.0, 1.0, 0.0)), encode((0.0, 1.0, 1.0))) == pytest.approx(10.0)


def test_crossover_exchanges_tails() -> None:
    random = np.random.default_rng(1)
    first, second = 0b111_1111_1111_1111, 0
    seen = set()
    for _ in range(300):
        one, other = genetic._crossover(first, second, random)
        assert one ^ other == first  # each bit comes from one of the two
        seen.add(f"{one:015b}".count("01") + f"{one:015b}".count("10"))
    assert seen == {0, 1}  # one point, or copies


def test_mutation_flips_as_often_as_asked() -> None:
    random = np.random.default_rng(2)
    flipped = [genetic._mutate(0, 0.1, random).bit_count() for _ in range(4000)]
    assert np.mean(flipped) == pytest.approx(1.5, abs=3 * math.sqrt(15 * 0.09 / 4000))


def test_best_and_nearest_remain() -> None:
    """Whatever the nearest costs."""
    random = np.random.default_rng(3)
    strings = [int(string) for string in random.integers(0, 2**STRING_BITS, 60)]
    best = strings[17]
    kept = genetic._dominant(
        strings, lambda string: 0.0 if string == best else float(1 + string % 977)
    )
    nearest = min(
        (string for string in strings if string != best),
        key=lambda string: genetic.distance(string, best),
    )
    assert kept[0] == best
    assert nearest in kept
    assert len(kept) == len(set(kept)) == genetic.POPULATION


def test_search_is_repeatable_and_never_gets_worse() -> None:
    def bowl(string: int) -> float:
        return sum(
            (gain - best) ** 2 for gain, best in zip(decode(string), (1.2, 0.7, 0.1), strict=True)
        )

    shares: list[float] = []
    first = genetic.search(bowl, np.random.default_rng(5), 40, shares.append)
    assert first == genetic.search(bowl, np.random.default_rng(5), 40)
    assert first.string != genetic.search(bowl, np.random.default_rng(5), 0).string
    assert list(first.history) == sorted(first.history, reverse=True)
    assert first.cost == first.history[-1] == bowl(first.string) < 0.02
    assert shares[-1] == 1.0
    assert len(shares) == 40


def test_unstable_gains_cost_everything(flown: Flight) -> None:
    trial = tuning.Flight(flown.log())
    assert trial.cost((1.0, 0.2, 0.9)) == math.inf
    assert 0.0 < trial.cost(PAPER_GAINS) < 1.0


def test_tuned_gains_are_better_and_can_be_configured(flown: Flight) -> None:
    found = tuning.tune(flown.log(), seed=1, generations=20)
    assert found.found.cost < found.paper_cost
    assert found == tuning.tune(flown.log(), seed=1, generations=20)
    assert found.damping == tuning.damping(found.gains)
    section = yaml.safe_load(found.snippet())["estimators"]["damping-loop"]
    settings = DampingLoopSettings(**section)
    np.testing.assert_allclose((settings.k1, settings.k2, settings.k3), found.gains, rtol=1e-5)


def test_velocity_from_heights_orders_gains_alike(flown: Flight) -> None:
    """Exact GNSS, and gains that differ by more than noise within four seconds, which heights do
    not show."""
    exact = flown.copy()
    table = exact.tables[Kind.GNSS]
    table["altitude_amsl_m"] = exact.truth_m(table["time_us"])
    with_velocity = exact.copy()
    rising = with_velocity.truth_m(table["time_us"] + 500_000) - with_velocity.truth_m(
        table["time_us"] - 500_000
    )
    with_velocity.tables[Kind.GNSS]["climb_mps"] = rising
    derived, given = tuning.Flight(exact.log()), tuning.Flight(with_velocity.log())
    assert given.has_velocity
    assert not derived.has_velocity
    tried = [PAPER_GAINS, (3.0, 0.3, 0.6), (2.0, 0.1, 0.1), (0.2, 0.5, 0.09)]
    costs = [[trial.cost(gains) for gains in tried] for trial in (derived, given)]
    assert costs[0] == sorted(costs[0])
    assert costs[1] == sorted(costs[1])
    assert all(by_height < by_velocity for by_height, by_velocity in zip(*costs, strict=True))


def test_noise_of_gnss_adds_to_all_alike(flown: Flight) -> None:
    plain, noisy = flown.copy(), flown.copy()
    random = np.random.default_rng(4)
    noisy.change(
        Kind.GNSS,
        "altitude_amsl_m",
        lambda value: value + random.normal(0.0, 2.0, value.size),
        10.0,
    )
    tried = [PAPER_GAINS, (1.0, 1.0, 0.1), (0.3, 0.1, 0.01)]
    costs = [[tuning.Flight(made.log()).cost(gains) for gains in tried] for made in (plain, noisy)]
    added = np.subtract(costs[1], costs[0])
    assert added.min() > 0.05
    assert np.ptp(added) < 0.3 * added.mean()


def test_gap_of_the_barometer(flown: Flight) -> None:
    made = flown.copy().drop(Kind.PRESSURE, 50.0, 70.0).drop(Kind.IMU, 60.0, 75.0)
    assert math.isfinite(tuning.Flight(made.log()).cost(PAPER_GAINS))


@pytest.mark.parametrize(
    ("missing", "said"),
    [(Kind.IMU, "IMU"), (Kind.PRESSURE, "barometer"), (Kind.GNSS, "GNSS"), (None, "IMU")],
)
def test_a_log_that_cannot_serve(missing: Kind | None, said: str) -> None:
    made = flight(duration_s=40.0, imu_hz=50.0 if missing else 4.0)
    if missing is not None:
        made.drop(missing)
    with pytest.raises(LogFormatError, match=said):
        tuning.Flight(made.log())
    with pytest.raises(LogFormatError):
        tuning.Flight(SampleLog())


def test_only_the_last_boot_counts(flown: Flight) -> None:
    log = SampleLog()
    later = flight(duration_s=60.0, seed=7).log()
    for part in (flown.log(), later):
        log.append(Kind.STATUS, sample(Kind.STATUS, 1, reboot=1))
        for kind, row in zip(part.tables.order["kind"], part.tables.order["row"], strict=True):
            log.append(Kind(kind), part[Kind(kind)][row : row + 1])
    assert tuning.Flight(log).cost(PAPER_GAINS) == tuning.Flight(later).cost(PAPER_GAINS)
