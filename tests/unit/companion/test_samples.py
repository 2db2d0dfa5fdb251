"""The records: unknown is NaN, a log keeps the order of arrival, and every kind has what the
conventions ask."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.samples import (
    COMPILED,
    DTYPES,
    ESTIMATE,
    HEIGHT,
    Kind,
    SampleLog,
    Verdict,
    readable,
    rows,
    sample,
)


@pytest.mark.parametrize("kind", Kind)
def test_every_row_begins_alike(kind: Kind) -> None:
    assert (DTYPES[kind].names or ())[:3] == ("time_us", "arrival_us", "instance")


@pytest.mark.parametrize(
    "dtype",
    [*DTYPES.values(), ESTIMATE, HEIGHT],
    ids=[*(kind.name for kind in Kind), "estimate", "height"],
)
def test_names_say_their_units(dtype: np.dtype[np.void]) -> None:
    units = (
        "_us",
        "_m",
        "_mps",
        "_mps2",
        "_radps",
        "_rad",
        "_deg",
        "_pa",
        "_k",
        "_sd_m",
        "_sd_mps",
        "_sd_pa",
    )
    bare = {
        "instance",
        "suspect",
        "hdop",
        "vdop",
        "fix_type",
        "satellites",
        "downward",
        "armed",
        "landed",
        "reboot",
    }
    bare |= {"baro_scale", "drift_probabilities", "fault_probabilities", "faulty"}
    for name in dtype.names or ():
        assert name.endswith(units) or name in bare, name


@pytest.mark.parametrize("dtype", [*DTYPES.values(), ESTIMATE])
def test_fresh_rows_know_nothing(dtype: np.dtype[np.void]) -> None:
    made = rows(dtype, 3)
    assert made.shape == (3,)
    for name, (kind, *_) in (dtype.fields or {}).items():
        values = np.asarray(made[name])
        assert np.isnan(values).all() if kind.base.kind == "f" else not values.any()


def test_a_sample_has_what_was_given_and_nothing_else() -> None:
    row = sample(Kind.GNSS, 5_000_000, altitude_amsl_m=400.0, fix_type=3)
    assert (row["time_us"][0], row["arrival_us"][0], row["fix_type"][0]) == (
        5_000_000,
        5_000_000,
        3,
    )
    assert row["altitude_amsl_m"][0] == 400.0
    assert math.isnan(row["vertical_sd_m"][0])
    assert sample(Kind.IMU, 1, arrival_us=9)["arrival_us"][0] == 9
    with pytest.raises(ValueError, match="altitude"):
        sample(Kind.PRESSURE, 1, altitude=3.0)


def test_rows_read_by_name_or_by_attribute_as_the_steps_need() -> None:
    assert isinstance(readable(np.zeros(1, ESTIMATE)), np.recarray) != COMPILED
    assert isinstance(rows(ESTIMATE), np.recarray) != COMPILED


@given(st.lists(st.tuples(st.sampled_from(list(Kind)), st.integers(0, 2**40)), max_size=300))
def test_a_log_keeps_everything_in_order_of_arrival(arrivals: list[tuple[Kind, int]]) -> None:
    log = SampleLog()
    for kind, time_us in arrivals:
        log.append(kind, sample(kind, time_us))
    assert len(log) == len(arrivals)
    tables = log.tables
    found = [
        (Kind(kind), int(tables[1 + kind][row]["time_us"])) for kind, row in tables.order.tolist()
    ]
    assert found == arrivals
    for kind in Kind:
        assert tables[1 + kind].dtype == DTYPES[kind]
        assert log[kind].size == sum(each is kind for each, _ in arrivals)


def test_a_log_copies_what_it_is_given() -> None:
    """Rows of the intake are used again for the next sample."""
    log, row = SampleLog(), sample(Kind.PRESSURE, 1, pressure_pa=90_000.0)
    log.append(Kind.PRESSURE, row)
    row["pressure_pa"] = 0.0
    assert log[Kind.PRESSURE]["pressure_pa"][0] == 90_000.0


def test_truth_stays_beside_the_samples() -> None:
    log = SampleLog()
    for number in range(100):
        log.append_truth((number, float(number), 0.0))
    log.append_autopilot((7, 8.0, 9.0))
    assert len(log) == 0
    assert log.truth["altitude_amsl_m"].tolist() == [float(number) for number in range(100)]
    assert log.autopilot[0].item() == (7, 8.0, 9.0)


def test_tables_are_in_the_order_of_kinds() -> None:
    tables = SampleLog().tables
    assert tables._fields == ("order", *(kind.name.lower() for kind in Kind))
    assert [kind.value for kind in Kind] == list(range(len(Kind)))
    assert [verdict.value for verdict in Verdict] == list(range(len(Verdict)))
