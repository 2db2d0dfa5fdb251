"""What every estimator must do. A method in `ESTIMATORS` is tested here by what it declares, as
soon as it is there."""

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

from companion.config import Settings
from companion.estimators import ESTIMATORS, Filter, Method, run_log
from companion.estimators.judging import DELAY_HORIZON_US
from companion.kernels.atmosphere import baro_altitude_m, geopotential_m, standard_pressure_pa
from companion.samples import DTYPES, Kind, Rows, SampleLog, Verdict, readable, sample
from tests.flights import Array, Flight, Plan, flight

SENSORS = (Kind.IMU, Kind.PRESSURE, Kind.GNSS, Kind.ATTITUDE)
SETTLE_S = 60.0
FED_S = 100
FAULT_S = (100.0, 130.0)
SECOND_US = 1_000_000


@pytest.fixture(params=sorted(ESTIMATORS))
def method(request: pytest.FixtureRequest) -> Method:
    return ESTIMATORS[request.param]


class Run(NamedTuple):
    """A compiled run over a flight."""

    flight: Flight
    log: SampleLog
    estimates: Rows
    verdicts: Rows
    state: Rows

    def arrivals_s(self) -> Array:
        """When each row arrived, in seconds since the start."""
        tables = self.log.tables
        arrivals_us = np.zeros(len(self.log))
        for kind in Kind:
            chosen = tables.order["kind"] == kind
            arrivals_us[chosen] = tables[1 + kind]["arrival_us"][tables.order["row"][chosen]]
        return np.asarray((arrivals_us - arrivals_us[0]) * 1e-6, np.float64)

    def altitude_m(self, times_s: Array) -> Array:
        """The estimate as it stood at instants of arrival."""
        latest = np.searchsorted(self.arrivals_s(), times_s, side="right") - 1
        return np.asarray(self.estimates["altitude_amsl_m"][latest], np.float64)

    def errors_m(self, after_s: float = SETTLE_S) -> Array:
        """Estimate minus truth at the estimate's own times, where there is one."""
        known = np.isfinite(self.estimates["altitude_amsl_m"]) & (self.arrivals_s() >= after_s)
        rows = self.estimates[known]
        return np.asarray(
            rows["altitude_amsl_m"] - self.flight.truth_m(rows["time_us"]), np.float64
        )


def run(method: Method, made: Flight, settings: Settings | None = None) -> Run:
    log = made.log()
    return Run(made, log, *run_log(method, log, settings))


@cache
def healthy() -> Flight:
    """The default flight; copy before damaging."""
    return flight()


@cache
def healthy_run(name: str) -> Run:
    return run(ESTIMATORS[name], healthy())


def row_at(log: SampleLog, index: int) -> tuple[Kind, Rows]:
    kind, row = (int(value) for value in log.tables.order[index])
    return Kind(kind), log.tables[1 + kind][row : row + 1]


@cache
def _checkpoint(name: str) -> bytes:
    log, result = healthy().log(), Filter(ESTIMATORS[name])
    for index in range(len(log)):
        kind, row = row_at(log, index)
        if row["time_us"][0] >= healthy().start_us + FED_S * SECOND_US:
            break
        result.step(kind, row)
    return result.checkpoint()


def fed(method: Method) -> Filter:
    """A filter that has seen the first `FED_S` of the healthy flight."""
    result = Filter(method)
    result.restore(_checkpoint(method.name))
    return result


def content(state: Rows) -> bytes:
    """The state's bytes without its counters."""
    bare = np.array(state).copy()
    bare["verdicts"] = 0
    return bare.tobytes()


def total(result: Filter) -> int:
    return int(np.sum(result.state["verdicts"]))


# What it says of itself


def test_it_describes_itself(method: Method) -> None:
    assert ESTIMATORS[method.name] is method
    assert method.name == method.name.lower().replace("_", "-").replace(" ", "-")
    assert method.summary
    assert method.citation
    assert method.uses & {Kind.PRESSURE, Kind.GNSS}
    assert Kind.STATUS in method.uses, "a reboot must start it anew"
    assert method.settings().params().size == 1  # type: ignore[attr-defined]
    names = set(method.state.names or ())
    assert {"now_us", "last_us", "verdicts"} <= names
    assert not names & set(dir(np.record)), "uncompiled, such a field is a method of the record"


def test_it_knows_nothing_at_first(method: Method) -> None:
    assert not Filter(method).is_valid
    alone = flight(Plan(duration_s=20, pressure_hz=0, gnss_hz=0))
    assert np.isnan(run(method, alone).estimates["altitude_amsl_m"]).all()


# What it does with a clean stream


def test_a_clean_stream_is_used(method: Method) -> None:
    made = healthy_run(method.name)
    kinds = made.log.tables.order["kind"]
    for kind in SENSORS:
        if kind in method.uses:
            used = np.mean(made.verdicts[kinds == kind] == Verdict.USED)
            assert used >= 0.99, (kind.name, used)
        else:
            assert set(made.verdicts[kinds == kind].tolist()) <= {int(Verdict.IGNORED)}


def test_a_clean_stream_gives_the_altitude(method: Method) -> None:
    """Within any minute no worse than the worse of raw barometer and raw GNSS by more than 5 m."""
    made = healthy_run(method.name)
    tables, truth_m = made.flight.tables, made.flight.truth_m
    baro_m = np.array([baro_altitude_m(value) for value in tables[Kind.PRESSURE]["pressure_pa"]])
    raw_m = {
        "barometer": baro_m - truth_m(tables[Kind.PRESSURE]["time_us"]),
        "GNSS": tables[Kind.GNSS]["altitude_amsl_m"] - truth_m(tables[Kind.GNSS]["time_us"]),
    }
    worst_m = max(float(np.sqrt(np.mean(error**2))) for error in raw_m.values())
    rows = made.estimates[np.isfinite(made.estimates["altitude_amsl_m"])]
    elapsed_s = made.flight.elapsed_s(rows["time_us"])
    errors_m = rows["altitude_amsl_m"] - truth_m(rows["time_us"])
    for start_s in np.arange(0.0, 200.0, 20.0):
        within = (elapsed_s >= start_s) & (elapsed_s < start_s + 60.0)
        assert np.sqrt(np.mean(errors_m[within] ** 2)) <= worst_m + 5.0, start_s


def test_an_altitude_comes_with_its_spread_and_time(method: Method) -> None:
    made = healthy_run(method.name)
    known = np.isfinite(made.estimates["altitude_amsl_m"])
    assert known[made.arrivals_s() > 30.0].all()
    rows = made.estimates[known]
    assert np.isfinite(rows["altitude_sd_m"]).all()
    assert (rows["altitude_sd_m"] >= 0).all()
    assert np.isfinite(rows["climb_mps"][made.arrivals_s()[known] > 30.0]).all()
    lag_s = made.flight.elapsed_s(rows["time_us"]) - made.arrivals_s()[known]
    assert lag_s.max() <= 0.01
    assert lag_s.min() >= -1.0


def test_one_hertz_without_inertial_sensors_gives_an_altitude(method: Method) -> None:
    slow = flight(Plan(imu_hz=0, attitude_hz=0, pressure_hz=1, gnss_hz=1))
    made = run(method, slow)
    assert np.isfinite(made.altitude_m(np.arange(30.0, 259.0))).all()
    assert np.abs(made.errors_m()).max() <= 60.0  # raw barometer is 50 m off


@pytest.mark.parametrize("imu_hz", [1.0, 4.0])
def test_an_imu_too_slow_to_integrate_does_no_harm(method: Method, imu_hz: float) -> None:
    made = run(method, flight(Plan(imu_hz=imu_hz, attitude_hz=imu_hz, pressure_hz=2, gnss_hz=1)))
    assert np.isfinite(made.altitude_m(np.arange(30.0, 259.0))).all()
    assert np.abs(made.errors_m()).max() <= 60.0


# Determinism


def test_the_same_stream_gives_the_same_bytes(method: Method) -> None:
    first, second = (run(method, healthy()) for _ in range(2))
    assert first.estimates.tobytes() == second.estimates.tobytes()
    assert first.state.tobytes() == second.state.tobytes()


@pytest.mark.parametrize("shift_s", [1, 86_400, 5_000_000])
def test_nothing_depends_on_the_time_since_boot(method: Method, shift_s: int) -> None:
    plain, shifted = (
        healthy_run(method.name),
        run(method, healthy().copy().shift(shift_s * SECOND_US)),
    )
    assert (plain.verdicts == shifted.verdicts).all()
    known = np.isfinite(plain.estimates["altitude_amsl_m"])
    assert (shifted.estimates["time_us"] - plain.estimates["time_us"])[known] == pytest.approx(
        shift_s * SECOND_US
    )
    for name in ("altitude_amsl_m", "climb_mps", "altitude_sd_m"):
        np.testing.assert_allclose(
            shifted.estimates[name], plain.estimates[name], rtol=0, atol=1e-6, err_msg=name
        )


def test_live_steps_are_the_compiled_run(method: Method) -> None:
    made = flight(Plan(duration_s=40))
    compiled = run(method, made)
    live = Filter(method)
    estimates, verdicts = [], []
    for index in range(len(compiled.log)):
        verdicts.append(int(live.step(*row_at(compiled.log, index))))
        estimates.append(np.array(live.estimate).tobytes())
    assert verdicts == compiled.verdicts.tolist()
    assert b"".join(estimates) == np.array(compiled.estimates).tobytes()
    assert np.array(live.state).tobytes() == np.array(compiled.state).tobytes()


@pytest.mark.parametrize("at", [0.0, 0.1, 0.5, 0.9])
def test_a_checkpoint_continues_bit_for_bit(method: Method, at: float) -> None:
    log = flight(Plan(duration_s=30)).log()
    half = round(at * len(log))
    whole, first, second = Filter(method), Filter(method), Filter(method)
    for index in range(len(log)):
        kind, row = row_at(log, index)
        whole.step(kind, row)
        if index == half:
            second.restore(first.checkpoint())
        (first if index < half else second).step(kind, row)
    assert second.state.tobytes() == whole.state.tobytes()
    assert second.estimate.tobytes() == whole.estimate.tobytes()


def test_a_checkpoint_of_another_method_or_a_cut_one_is_refused(method: Method) -> None:
    data = Filter(method).checkpoint()
    for other in ESTIMATORS.values():
        if other is not method:
            with pytest.raises(ValueError, match="not one of"):
                Filter(other).restore(data)
    with pytest.raises(ValueError, match="cut"):
        Filter(method).restore(data[:-1])


# Bad input


def absurd(kind: Kind, time_us: int) -> list[tuple[str, Rows]]:
    """Rows that are no measurement, by what is wrong."""
    good = _good(kind, time_us)
    made: list[tuple[str, Rows]] = []

    def add(label: str, **fields: Any) -> None:
        row = good.copy()
        for name, value in fields.items():
            row[name] = value
        made.append((f"{kind.name} {label}", readable(row)))

    main = {
        Kind.IMU: "specific_force_b_mps2",
        Kind.PRESSURE: "pressure_pa",
        Kind.GNSS: "altitude_amsl_m",
        Kind.ATTITUDE: "roll_rad",
    }[kind]
    for value in (math.nan, math.inf, -math.inf, 1e300, -1e300, 1e9):
        add(f"{main} {value}", **{main: value})
    add("instance -1", instance=-1)
    add("instance 9", instance=9)
    if kind is Kind.PRESSURE:
        for value in (0.0, -1.0, 500.0, 200_000.0):
            add(f"{value} Pa", pressure_pa=value)
        add("suspect", suspect=1)
        add("of a frozen sensor", die_temperature_k=138.0)
    if kind is Kind.GNSS:
        for fix in (0, 1, 2):
            add(f"fix {fix}", fix_type=fix)
        add("suspect", suspect=1)
        add("19 km of spread", vertical_sd_m=19_000.0)
        add("no accuracy but a hopeless DOP", vertical_sd_m=math.nan, vdop=99.99, hdop=99.99)
        add("100 km up", altitude_amsl_m=100_000.0)
    if kind is Kind.IMU:
        add("one NaN axis", specific_force_b_mps2=(0.0, math.nan, -9.8))
        add("NaN rate", angular_rate_b_radps=(0.0, 0.0, math.nan))
        add("infinite rate", angular_rate_b_radps=math.inf)
    if kind is Kind.ATTITUDE:
        add("pitch NaN", pitch_rad=math.nan)
    return made


def _good(kind: Kind, time_us: int) -> Rows:
    """The healthy flight's last row of a kind before `time_us`, at that time."""
    table = healthy().tables[kind]
    row = table[np.searchsorted(table["time_us"], time_us) - 1 :][:1].copy()
    row["time_us"] = time_us
    return row


@pytest.mark.parametrize("kind", SENSORS)
def test_absurd_input_leaves_the_state_alone(method: Method, kind: Kind) -> None:
    if kind not in method.uses:
        pytest.skip("not used")
    result = fed(method)
    before, estimate, counted = content(result.state), result.estimate.tobytes(), total(result)
    for number, (label, row) in enumerate(absurd(kind, healthy().start_us + FED_S * SECOND_US), 1):
        assert result.step(kind, row) is not Verdict.USED, label
        assert content(result.state) == before, label
        assert result.estimate.tobytes() == estimate, label
        assert total(result) == counted + number, label


@pytest.mark.parametrize("kind", SENSORS)
def test_not_newer_than_the_last_of_its_kind_is_stale(method: Method, kind: Kind) -> None:
    if kind not in method.uses:
        pytest.skip("not used")
    result = fed(method)
    last_us = int(result.state["last_us"][0, kind, 0])
    before = content(result.state)
    for late_us in (0, 1, 20_000, 900_000, 10 * SECOND_US):
        assert result.step(kind, readable(_good(kind, last_us - late_us))) is Verdict.STALE
        assert content(result.state) == before


@pytest.mark.parametrize("kind", [Kind.PRESSURE, Kind.GNSS])
def test_older_than_the_delay_horizon_is_stale(method: Method, kind: Kind) -> None:
    if not {Kind.PRESSURE, Kind.GNSS} <= method.uses:
        pytest.skip("needs two kinds")
    other = Kind.GNSS if kind is Kind.PRESSURE else Kind.PRESSURE
    result = Filter(method)
    now_us = healthy().start_us + 50 * SECOND_US
    assert result.step(other, readable(_good(other, now_us))) is Verdict.USED
    before = content(result.state)
    assert result.step(kind, readable(_good(kind, now_us - DELAY_HORIZON_US - 1))) is Verdict.STALE
    assert content(result.state) == before
    assert (
        result.step(kind, readable(_good(kind, now_us - DELAY_HORIZON_US // 2)))
        is not Verdict.STALE
    )


def test_a_kind_that_it_does_not_use_is_ignored(method: Method) -> None:
    result = fed(method)
    before = result.state.tobytes()
    for kind in Kind:
        if kind not in method.uses:
            row = sample(kind, healthy().start_us + FED_S * SECOND_US)
            assert result.step(kind, row) is Verdict.IGNORED
    assert result.state.tobytes() == before


def test_a_reboot_starts_anew(method: Method) -> None:
    """Nothing is known after it, and what follows is as of a new filter, counters aside."""
    result = fed(method)
    counted = total(result)
    reboot = sample(Kind.STATUS, 3 * SECOND_US, armed=-1, landed=-1, reboot=1)
    assert result.step(Kind.STATUS, reboot) is Verdict.USED
    assert not result.is_valid
    assert total(result) == counted + 1
    fresh = Filter(method)
    fresh.step(Kind.STATUS, reboot)
    log = flight(Plan(duration_s=40, boot_s=3.0)).log()
    for index in range(len(log)):
        kind, row = row_at(log, index)
        assert result.step(kind, row) is fresh.step(kind, row)
        for name in ("altitude_amsl_m", "climb_mps", "altitude_sd_m"):
            assert np.array_equal(result.estimate[name], fresh.estimate[name], equal_nan=True), name
    assert fresh.is_valid


# Faults and what is declared


def baro_step(made: Flight) -> Flight:
    return made.change(Kind.PRESSURE, "pressure_pa", lambda value: value - 600.0, *FAULT_S)


def baro_spike(made: Flight) -> Flight:
    return made.change(
        Kind.PRESSURE, "pressure_pa", lambda value: value + 4000.0, FAULT_S[1] - 0.12, FAULT_S[1]
    )


def baro_freeze(made: Flight) -> Flight:
    return made.change(
        Kind.PRESSURE, "pressure_pa", lambda value: np.full_like(value, value[0]), *FAULT_S
    )


def gnss_step(made: Flight) -> Flight:
    return made.change(Kind.GNSS, "altitude_amsl_m", lambda value: value + 60.0, *FAULT_S)


def dropout(kind: Kind) -> Callable[[Flight], Flight]:
    return lambda made: made.drop(kind, *FAULT_S)


def imu_nan(made: Flight) -> Flight:
    return made.change(Kind.IMU, "specific_force_b_mps2", lambda value: value * math.nan, *FAULT_S)


FAULTS: dict[str, tuple[Kind, Callable[[Flight], Flight]]] = {
    "barometer spike": (Kind.PRESSURE, baro_spike),
    "barometer step": (Kind.PRESSURE, baro_step),
    "barometer freeze": (Kind.PRESSURE, baro_freeze),
    "barometer dropout": (Kind.PRESSURE, dropout(Kind.PRESSURE)),
    "GNSS step": (Kind.GNSS, gnss_step),
    "GNSS dropout": (Kind.GNSS, dropout(Kind.GNSS)),
    "IMU dropout": (Kind.IMU, dropout(Kind.IMU)),
    "IMU NaN": (Kind.IMU, imu_nan),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_minute_after_a_fault_it_is_as_if_there_had_been_none(method: Method, fault: str) -> None:
    kind, damage = FAULTS[fault]
    if kind not in method.uses:
        pytest.skip("not used")
    made = run(method, damage(healthy().copy()))
    times_s = np.arange(FAULT_S[1] + 60.0, 259.0, 0.5)
    difference_m = made.altitude_m(times_s) - healthy_run(method.name).altitude_m(times_s)
    assert np.abs(difference_m).max() <= 1.0
    kinds, arrivals_s = made.log.tables.order["kind"], made.arrivals_s()
    after = (kinds == kind) & (arrivals_s >= FAULT_S[1] + 60.0)
    assert np.mean(made.verdicts[after] == Verdict.USED) >= 0.99, "rejecting for good"


def test_a_lasting_step_of_the_barometer(method: Method) -> None:
    """A step of 50 m: learned as an offset, or kept in the altitude, as declared."""
    if Kind.PRESSURE not in method.uses:
        pytest.skip("not used")
    stepped = (
        healthy()
        .copy()
        .change(Kind.PRESSURE, "pressure_pa", lambda value: value - 600.0, FAULT_S[0])
    )
    times_s = np.arange(FAULT_S[0] + 90.0, 259.0, 0.5)
    kept_m = run(method, stepped).altitude_m(times_s) - healthy_run(method.name).altitude_m(times_s)
    if method.follows_baro_step:
        assert np.abs(kept_m).max() <= 5.0
    else:
        assert np.abs(kept_m).min() > 5.0


def test_the_datum(method: Method) -> None:
    """The same flight one kilometre higher, barometer heights and all: the same errors, if so
    declared."""
    plain, higher = healthy().copy(), healthy().copy()
    up_m = 1000.0

    def raised(pressures_pa: Any) -> Any:
        heights_m = [baro_altitude_m(float(value)) + up_m for value in pressures_pa]
        return np.array([standard_pressure_pa(geopotential_m(height_m)) for height_m in heights_m])

    higher.change(Kind.PRESSURE, "pressure_pa", raised)
    higher.change(Kind.GNSS, "altitude_amsl_m", lambda value: value + up_m)
    times_s = np.arange(SETTLE_S, 259.0, 0.5)
    change_m = (
        run(method, higher).altitude_m(times_s) - up_m - run(method, plain).altitude_m(times_s)
    )
    if method.datum_invariant:
        assert np.abs(change_m).max() <= 0.1


def test_the_table_of_dtypes_is_what_the_rows_have() -> None:
    assert {kind: table.dtype for kind, table in healthy().tables.items()} == {
        kind: DTYPES[kind] for kind in healthy().tables
    }
