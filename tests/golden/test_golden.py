"""The golden change indicator: fails when an estimator's numbers moved, and says how to accept
it."""

import pytest

from companion.estimators import ESTIMATORS
from tests.golden import COLUMNS, FLIGHTS, FOLDER, lines, path_of, samples

ACCEPT = "if the change is meant: python -m tests.golden --update, and say why in the commit"


@pytest.mark.parametrize("flight", FLIGHTS)
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_numbers_are_those_of_the_last_commit(flight: str, estimator: str) -> None:
    path = path_of(flight, estimator)
    assert path.exists(), f"{path.relative_to(FOLDER)} is missing; {ACCEPT}"
    kept = path.read_text(encoding="utf-8").splitlines()
    found = list(lines(ESTIMATORS[estimator], samples(flight)))
    moved = [
        f"- {before}\n+ {after}"
        for before, after in zip(kept, found, strict=False)
        if not is_same(before, after)
    ]
    shown = "\n".join(moved[:4])
    assert not moved, (
        f"{flight}/{estimator}: {len(moved)} of {len(kept)} rows moved; {ACCEPT}\n{shown}"
    )
    assert len(kept) == len(found), f"{flight}/{estimator}: another number of rows; {ACCEPT}"


def test_no_file_of_an_estimator_that_is_gone() -> None:
    stems = {path.stem for flight in FLIGHTS for path in (FOLDER / flight).glob("*.csv")}
    assert stems <= set(ESTIMATORS), ACCEPT


def is_same(before: str, after: str) -> bool:
    """Whether two lines differ by rounding alone: one unit of the last decimal, which another
    processor's arithmetic may turn."""
    if before == after:
        return True
    cells = before.split(","), after.split(",")
    units = [0.1, *(10.0**-decimals for decimals in COLUMNS.values())]
    if any(len(row) != len(units) for row in cells):
        return False
    return all(
        one == other or (one != "" and other != "" and near(one, other, unit))
        for one, other, unit in zip(*cells, units, strict=True)
    )


def near(one: str, other: str, unit: float) -> bool:
    try:
        return unit < 1.0 and abs(float(one) - float(other)) < 1.5 * unit
    except ValueError:
        return False
